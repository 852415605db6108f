#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "base/table.h"
#include "paper/experiments.h"
#include "programs/identification.h"
#include "programs/parallel.h"
#include "saltus/identify/identify.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kNoise = 2e-3;      // m, of either coordinate
constexpr int kNodesPerSample = 4;   // 60 samples of each disc a second
constexpr double kOff = 1.3;         // the start, of the true value
constexpr double kStuck = 1.2;       // misfit that noise alone does not make
constexpr double kHonest = 3;        // standard errors
constexpr int kMostIterations = 40;  // of each part of a fit: what is stuck stays so
constexpr double kLeastBiasShown = 1e-4;

// Returns a scene in which a ball bounces off the floor and off a second ball, which is pushed to the wall and back.
Scene TrueScene() {
  Scene scene;
  scene.name = "two_bounces";
  scene.duration = 1.2;
  scene.steps = 288;
  scene.gravity = {0, -4};
  scene.bodies = {{.name = "thrown", .radius = 0.1, .mass = 1, .position = {-0.9, 0.7}, .velocity = {1.7, -0.4}},
                  {.name = "struck", .radius = 0.12, .mass = 0.6, .position = {0.15, 0.75}, .velocity = {0.1, 0.6}}};
  scene.planes = {{"floor", {0, 0}, {0, 1}}, {"wall", {0.9, 0}, {-1, 0}}};
  scene.contact = {.restitution = 0.75};
  return scene;
}

const std::vector<Unknown>& Unknowns() {
  static const std::vector<Unknown>& unknowns =
      *new std::vector<Unknown>{{Unknown::Kind::kRestitution}, {Unknown::Kind::kMass, 1}};
  return unknowns;
}

// Returns the motion of a contact model, with noise that is the same for all models; empty if there is none.
Recording Record(const std::string& contact, const Scene& scene) {
  Recording recording{contact, {}};
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()))) return recording;
  Random random(11);
  std::vector<double> x(simulator->state_size());
  const int every = kNodesPerSample * simulator->num_steps() / scene.steps;
  for (int k = every; k <= simulator->num_steps(); k += every) {
    simulator->GetState(k, x);
    for (int body = 0; body < scene.num_bodies(); ++body) {
      const double* at = &x[body * simulator->body_size()];
      recording.samples.push_back({.time = std::min(k * simulator->step(), scene.duration),
                                   .body = body,
                                   .position = Vec2d(at[0], at[1]) + kNoise * random.Normal(),
                                   .sigma = kNoise});
    }
  }
  return recording;
}

std::string FitFailure(const IdentifyReport& report) {
  const std::string verdict = FitVerdictToString(report.verdict);
  return report.reason.empty() ? verdict : verdict + ": " + report.reason;
}

constexpr int kDrops = 4;
constexpr int kUnits = 3;       // of the network
constexpr double kFastest = 8;  // m/s, about

std::vector<Recording> ReadDrops(const std::string& folder, const Scene& scene) {
  std::vector<Recording> recordings;
  for (int i = 1; i <= kDrops; ++i) {
    auto loaded = LoadRecording(folder + "/drop_" + std::to_string(i) + ".csv", scene);
    if (const auto* error = std::get_if<RecordingError>(&loaded)) throw InputError(error->ToString());
    recordings.push_back(std::get<Recording>(std::move(loaded)));
  }
  return recordings;
}

// Returns the largest error of a learned law between the slowest and the fastest impact.
double LargestError(const LearnedLaw& learned, const KnownLaw& truth) {
  double largest = 0;
  for (const LawPoint& at : learned.curve) {
    if (const auto known = truth.RestitutionAt(at.speed))
      largest = std::max(largest, std::abs(at.restitution - *known));
  }
  return largest;
}

// A fit to exact motion, in which both a model's motion and its gradient matter, or to the model's own motion, in which
// only its gradient matters.
enum class Of { kExactMotion, kOwnMotion };
struct Fit {
  std::string contact;
  Of of = Of::kExactMotion;
  std::optional<IdentifyReport> report = {};  // none: the model has no motion of the true parameters
};

void Compute(const Scene& truth, Fit* fit) {
  const bool exact = fit->of == Of::kExactMotion;
  const Recording recording = Record(exact ? std::string(ExactModel()->name) : fit->contact, truth);
  if (recording.samples.empty()) return;
  Scene guess = truth;
  for (const Unknown& unknown : Unknowns()) SetValue(unknown, kOff * ValueOf(unknown, truth), &guess);
  IdentifyOptions options;
  options.loss = RobustLoss::kNone;  // there are no outliers
  options.starts = 1;                // so that iterations are those of the gradients at hand
  options.max_iterations = kMostIterations;
  options.stop = IsStopRequested;
  fit->report = Identify(fit->contact, guess, {recording}, Unknowns(), options);
}

const Fit* Find(const std::vector<Fit>& fits, const std::string& contact, Of of) {
  const auto found = std::ranges::find_if(fits, [&](const Fit& fit) { return fit.contact == contact && fit.of == of; });
  return found == fits.end() || !found->report ? nullptr : &*found;
}

// Returns the largest |value - true value| / true value of all parameters; std::nullopt if one is not determined.
std::optional<double> LargestBias(const Fit& fit, const Scene& truth) {
  double largest = 0;
  if (fit.report->estimates.empty()) return std::nullopt;
  for (const Estimate& estimate : fit.report->estimates) {
    if (estimate.determination != Determination::kDetermined) return std::nullopt;
    const double value = ValueOf(estimate.unknown, truth);
    largest = std::max(largest, std::abs(estimate.value - value) / value);
  }
  return largest;
}

// Whether all are determined, and as close to the truth as the stated standard errors promise.
bool IsHonest(const Fit& fit, const Scene& truth) {
  return LargestBias(fit, truth) && std::ranges::all_of(fit.report->estimates, [&](const Estimate& at) {
           return std::abs(at.value - ValueOf(at.unknown, truth)) < kHonest * at.standard_error;
         });
}

CaptionedTable TableOf(const std::vector<Fit>& fits, const Scene& truth) {
  Table table(ColumnsOf("contact; recording of; restitution:4; its error:2; its standard error:2; mass:4; its error:2; "
                        "its standard error:2; misfit:3; iterations; evaluations; milliseconds:3; verdict"),
              2);
  for (const Fit& fit : fits) {
    if (!fit.report) continue;
    const IdentifyReport& report = *fit.report;
    std::vector<Cell> row = {fit.contact, fit.of == Of::kExactMotion ? "exact motion" : "its own motion"};
    for (std::size_t p = 0; p < Unknowns().size(); ++p) {
      const bool known = p < report.estimates.size() && report.estimates[p].determination == Determination::kDetermined;
      if (!known) {
        row.insert(row.end(), {Cell("not determined").WithTone(Tone::kMuted), Cell(), Cell()});
        continue;
      }
      const Estimate& estimate = report.estimates[p];
      const double error = estimate.value - ValueOf(estimate.unknown, truth);
      const double sigmas = std::abs(error) / estimate.standard_error;
      const Tone tone = sigmas < 3 ? Tone::kGood : sigmas < 10 ? Tone::kWarning : Tone::kBad;
      row.insert(row.end(), {estimate.value, Cell(error).WithTone(tone), estimate.standard_error});
    }
    const bool good = report.verdict == FitVerdict::kFits;
    row.insert(row.end(),
               {report.misfit,
                report.iterations,
                report.evaluations,
                1e3 * report.seconds,
                Cell(FitFailure(report)).WithTone(good ? Tone::kGood : Tone::kBad)});
    table.AddRow(std::move(row));
  }
  return {"parameter_fits",
          "Restitution (true value 0.75) and the mass of the struck ball (0.6 kg) under every contact model, from one "
          "start that is 30 % off: estimate, what it is off, and the standard error that the fit states. Green are "
          "errors within three of these. The misfit is the typical residual over the noise; iterations and evaluations "
          "are those of Levenberg-Marquardt, of all parts of a fit.",
          std::move(table)};
}

PaperFigure FigureOf(const std::vector<Fit>& fits, const std::vector<std::string>& contacts, const Scene& truth) {
  Figure figure;
  for (const Of of : {Of::kExactMotion, Of::kOwnMotion}) {
    Panel panel{.title = of == Of::kExactMotion ? "Recording of exact motion" : "Recording of the model's own motion",
                .x = {.label = "evaluations of motion and gradient", .log = true},
                .y = {.label = "largest relative error of a parameter", .log = true, .min = kLeastBiasShown / 2}};
    for (const std::string& contact : contacts) {
      const Fit* fit = Find(fits, contact, of);
      const std::optional<double> bias = fit == nullptr ? std::nullopt : LargestBias(*fit, truth);
      if (!bias) continue;
      Series series = Series::ForModel(
          contact, {static_cast<double>(fit->report->evaluations)}, {std::max(*bias, kLeastBiasShown)});
      series.line = false;
      panel.series.push_back(std::move(series));
    }
    panel.reference_lines.push_back({.value = kOff - 1, .label = "the start", .colour = "#999999"});
    figure.panels.push_back(std::move(panel));
  }
  return {
      "Time of a fit, and error of the parameters with which it ends. Models are missing where a parameter is not "
      "determined, as the restitution is in models that do not depend on it.",
      figure};
}

std::vector<std::string> FindingsOf(const std::vector<Fit>& fits, const std::vector<std::string>& contacts,
                                    const Scene& truth) {
  std::vector<std::string> found, stuck, honest;
  std::vector<int> evaluations;
  for (const std::string& contact : contacts) {
    const Fit *exact = Find(fits, contact, Of::kExactMotion), *own = Find(fits, contact, Of::kOwnMotion);
    if (exact == nullptr || own == nullptr) continue;
    (own->report->misfit < kStuck ? found : stuck).push_back(contact);
    if (IsHonest(*exact, truth)) honest.push_back(contact);
    if (contact != ExactModel()->name) evaluations.push_back(own->report->evaluations);
  }
  std::string cost;
  if (const Fit* exact = Find(fits, std::string(ExactModel()->name), Of::kOwnMotion);
      exact != nullptr && !evaluations.empty()) {
    const auto middle = evaluations.begin() + static_cast<std::ptrdiff_t>(evaluations.size() / 2);
    std::nth_element(evaluations.begin(), middle, evaluations.end());
    cost = " `event` takes " + std::to_string(exact->report->evaluations) +
           " evaluations to its own motion, the others " + std::to_string(*middle) + " in the middle.";
  }
  return {
      "To a recording of its own motion, every model fits with a misfit of 1 by the true parameters. The fit ends in "
      "such an optimum under " +
          JoinedNames(found) + ".",
      "It ends elsewhere, with a larger misfit, under " + JoinedNames(stuck) +
          ": the optimum is there, and the gradient does not lead to it." + cost,
      "To the recording of exact motion, both parameters are determined and within three of the standard errors that "
      "the fit itself states under " +
          JoinedNames(honest) +
          ". Under the others the motion is another one, or the fit ended elsewhere, which the stated confidence does "
          "not include."};
}

}  // namespace

std::optional<Section> FitParameters(const std::vector<std::string>& contacts, int threads, ProgressMode mode) {
  const Scene truth = TrueScene();
  std::vector<std::string> fitted, names;
  std::vector<Fit> fits;
  for (const std::string& contact : contacts) {
    if (!ReasonNotApplicable(contact, truth).empty()) continue;
    if (FindContactModel(contact)->rebound == Rebound::kPlastic) continue;
    fitted.push_back(contact);
    for (const Of of : {Of::kExactMotion, Of::kOwnMotion}) {
      fits.push_back({contact, of});
      names.push_back(contact + (of == Of::kExactMotion ? " to exact motion" : " to its own motion"));
    }
  }
  Progress progress(mode, stderr, "fits of parameters", fits.size());
  if (!RunJobs(names, threads, &progress, [&](int i, const SayNote&) { Compute(truth, &fits[i]); })) {
    return std::nullopt;
  }
  return Section{FindingsOf(fits, fitted, truth), {TableOf(fits, truth)}, {FigureOf(fits, fitted, truth)}};
}

std::optional<PaperFigure> LearnALaw() {
  const std::string folder = ShippedFile("problems/drops");
  const Scene scene = LoadScene(folder + "/drops.yaml");
  const KnownLaw truth = ReadKnownLaw(folder + "/law.csv");
  IdentifyOptions options;
  options.law = RestitutionNetwork(kUnits, kFastest, scene.contact.restitution);
  options.stop = IsStopRequested;
  const IdentifyReport report = Identify("event", scene, ReadDrops(folder, scene), {}, options);
  if (!report.law || report.law->curve.empty()) return std::nullopt;
  Figure figure = LawFigure(*report.law, truth);
  figure.panels[0].reference_lines.push_back(
      {.value = scene.contact.restitution, .label = "the start", .colour = "#999999", .dash = Dash::kDotted});
  return PaperFigure{
      "Restitution by the speed of approach, learned by a network of " + std::to_string(kUnits) + " tanh units from " +
          std::to_string(report.law->impacts) +
          " impacts of a ball that was dropped from four heights and seen 60 times a second with 1 mm of noise; known "
          "is the law that made the recordings. It " +
          FitVerdictToString(report.verdict) + "; between the slowest and the fastest impact it is off by " +
          Format("%.2g", LargestError(*report.law, truth)) + " at most.",
      std::move(figure)};
}

}  // namespace saltus
