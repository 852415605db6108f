#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "control/control_bounds.h"
#include "exact/two_disc_optimum.h"
#include "paper/experiments.h"
#include "programs/parallel.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {
namespace {

constexpr const char* kPerStep = "gd, rate per step";
constexpr const char* kPerTime = "gd, rate per time";
constexpr int kSteps[] = {480, 1000};

Vec2d VectorOf(const Json& json) { return {json[0].get<double>(), json[1].get<double>()}; }

// Returns the largest force, relative to the bound.
double Largest(const SolveReport& report, const BoundedReference& reference) {
  double largest = 0;
  for (size_t k = 0; k + 1 < report.solution.control.size(); k += 2) {
    const Vec2d u(report.solution.control[k], report.solution.control[k + 1]);
    if (reference.max) largest = std::max(largest, u.cwiseAbs().maxCoeff() / *reference.max);
    if (reference.max_norm) largest = std::max(largest, u.norm() / *reference.max_norm);
  }
  return largest;
}

std::string Describe(const BoundedReference& reference) {
  std::string text =
      reference.max ? Format("|u_x|, |u_y| ≤ %g N", *reference.max) : Format("|u| ≤ %g N", *reference.max_norm);
  return text + (reference.target[1] == -1 ? "" : Format(", target disc from (-1, %g)", reference.target[1]));
}

}  // namespace

Vec2d BoundedReference::Force(double time) const {
  if (time > impact_time) return {0, 0};
  Control bounds{{0}, {}};
  if (max) bounds.max = {*max};
  if (max_norm) bounds.max_norm = {*max_norm};
  return NearestWithinBounds<double>(bounds, 0, at_start + time / impact_time * (at_impact - at_start));
}

std::vector<BoundedReference> ReadBoundedReferences(const std::string& path) {
  std::ifstream file(path);
  const Json document = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  if (document.is_discarded() || !document.contains("optima")) {
    throw InputError(path + ": expected a JSON document with optima");
  }
  std::vector<BoundedReference> references;
  try {
    for (const Json& item : document["optima"]) {
      if (!item.contains("control") || !item.contains("force_unbounded")) continue;
      BoundedReference reference;
      reference.target = item.contains("target_start") ? VectorOf(item["target_start"]) : Vec2d(-1, -1);
      if (item["control"].contains("max")) reference.max = item["control"]["max"].get<double>();
      if (item["control"].contains("max_norm")) reference.max_norm = item["control"]["max_norm"].get<double>();
      reference.loss = item["loss"];
      reference.impact_time = item["impact_time"];
      reference.at_start = VectorOf(item["force_unbounded"][0]);
      reference.at_impact = VectorOf(item["force_unbounded"][1]);
      references.push_back(std::move(reference));
    }
  } catch (const Json::exception& error) {
    throw InputError(path + ": " + error.what());
  }
  return references;
}

namespace {

// A run that is compared with an optimum.
struct Entry {
  std::string label;
  Scene scene;
  std::string solver;
  SolverOptions options;
  double optimum = 0;
  const BoundedReference* reference = nullptr;  // null: without bounds
  CheckedRun run = {};
};

Entry Plan(const Scene& scene, const std::string& solver, const std::string& label, double optimum,
           const BoundedReference* reference, bool rate_per_time = false) {
  Entry entry{label, scene, solver, {}, optimum, reference};
  entry.options.descent.learning_rate = DefaultLearningRate(scene);
  entry.options.descent.rate_per_time = rate_per_time;
  if (entry.options.descent.rate_per_time) entry.options.descent.learning_rate *= scene.duration / kPublishedSteps;
  // The references are optima along the impact of the guess; of one another motion is better.
  if (reference != nullptr && solver == "ceres_phases") entry.options.guess = {InitialControl(scene, scene.steps), {}};
  entry.options.monitor.stop = IsStopRequested;
  return entry;
}

std::vector<Entry> PlanAll(const Scene& scene, const std::vector<BoundedReference>& references) {
  std::vector<Entry> entries;
  double optimum = 0;
  if (const auto exact = FindTwoDiscOptimum(scene, TwoDiscSequence::kImpact)) optimum = exact->loss;
  for (int steps : kSteps) {
    Scene task = scene;
    task.steps = steps;
    entries.push_back(Plan(task, "gd", kPerStep, optimum, nullptr));
    entries.push_back(Plan(task, "gd", kPerTime, optimum, nullptr, /*rate_per_time=*/true));
    for (const char* solver : {"ceres_lm", "ceres_phases", "ceres_event", "hmp"}) {
      entries.push_back(Plan(task, solver, solver, optimum, nullptr));
    }
  }
  for (const BoundedReference& reference : references) {
    Scene task = scene;
    task.bodies[1].position = reference.target;
    if (reference.max) task.control.max = {*reference.max};
    if (reference.max_norm) task.control.max_norm = {*reference.max_norm};
    entries.push_back(Plan(task, "gd", kPerStep, reference.loss, &reference));
    for (const char* solver : {"ceres_lm", "ceres_phases", "hmp"}) {
      if (reference.max_norm && std::string(solver) == "ceres_lm") continue;  // does not take it
      entries.push_back(Plan(task, solver, solver, reference.loss, &reference));
    }
  }
  return entries;
}

const Entry* Find(const std::vector<Entry>& entries, const BoundedReference* reference, const std::string& label,
                  int steps) {
  for (const Entry& entry : entries) {
    if (entry.reference == reference && entry.label == label && entry.scene.steps == steps) return &entry;
  }
  return nullptr;
}

std::vector<CaptionedTable> TablesOf(const std::vector<Entry>& entries) {
  Table free(ColumnsOf("steps; solver; exact loss:12; gap:3; iterations; milliseconds:3; termination"));
  Table bounded(
      ColumnsOf("bound; solver; exact loss:12; gap:3; impacts; largest force of the bound:9; iterations; "
                "milliseconds:3; termination"));
  for (const Entry& entry : entries) {
    const SolveReport& report = entry.run.report;
    if (!entry.run.exact.ok) continue;
    const double gap = entry.run.exact.loss - entry.optimum;
    const Cell coloured = Cell(gap).WithTone(gap < 1e-5 ? Tone::kGood : gap < 1e-3 ? Tone::kWarning : Tone::kBad);
    const bool is_free = entry.reference == nullptr;
    std::vector<Cell> row = {is_free ? Cell(entry.scene.steps) : Cell(Describe(*entry.reference)), entry.label};
    row.insert(row.end(), {entry.run.exact.loss, coloured});
    if (!is_free) row.insert(row.end(), {entry.run.exact.events.size(), Largest(report, *entry.reference)});
    row.insert(row.end(), {report.work.iterations, 1e3 * report.work.seconds, TerminationToString(report.termination)});
    (is_free ? free : bounded).AddRow(std::move(row));
  }
  return {{"strike",
           "Task 3 on 480 and 1000 steps, under exact dynamics: solvers by single shooting, and solvers in which "
           "the time of the impact is an unknown. `gap` is the exact loss less the optimum in continuous time.",
           std::move(free)},
          {"strike_bounded",
           "Task 3 with bounds on the force, 480 steps. Where the target disc starts at (-1, -0.6), the loss without "
           "a force is lower, 1.36: the optima are those along the impact.",
           std::move(bounded)}};
}

PaperFigure FigureOf(const std::vector<Entry>& entries, const std::vector<BoundedReference>& references) {
  Figure figure;
  for (const BoundedReference& reference : references) {
    const bool symmetric = reference.target[1] == reference.target[0];
    Panel panel{.title = Describe(reference),
                .x = {.label = "time (s)"},
                .y = {.label = symmetric ? "force, either component (N)" : "force (N), x below y", .min = -0.3}};
    for (int axis = 0; axis < (symmetric ? 1 : 2); ++axis) {
      const auto draw = [&](const std::string& label, const std::string& colour, Dash dash, double width) {
        const Entry* entry = Find(entries, &reference, label, kSteps[0]);
        if (entry == nullptr || entry->run.exact.events.empty()) return;  // one that does not strike is another motion
        Series& series = panel.series.emplace_back(ForceOf(entry->run.report, entry->scene, axis));
        series.label = label;
        series.colour = colour;
        series.dash = dash;
        series.width = width;
      };
      draw(kPerStep, "#999999", Dash::kSolid, 2);
      draw("ceres_lm", "#56B4E9", Dash::kSolid, 2);
      draw("ceres_phases", "#D55E00", Dash::kSolid, 4);
      Series analytic{.label = "analytic", .dash = Dash::kDashed};
      for (int k = 0; k <= 1000; ++k) {
        const double t = 1e-3 * k;
        if (t > reference.impact_time && !analytic.x.empty() && analytic.x.back() < reference.impact_time) {
          for (double just : {reference.impact_time, std::nextafter(reference.impact_time, 2.0)}) {
            analytic.x.push_back(just);
            analytic.y.push_back(reference.Force(just)[axis]);
          }
        }
        analytic.x.push_back(t);
        analytic.y.push_back(reference.Force(t)[axis]);
      }
      panel.series.push_back(std::move(analytic));
    }
    if (reference.max) {
      panel.reference_lines.push_back({.value = *reference.max, .label = "bound", .dash = Dash::kDotted});
    }
    figure.panels.push_back(std::move(panel));
  }
  return {
      "Task 3 with bounds on the force: what solvers find, and the analytic optimum. The force is at its bound "
      "first, and the impact comes later than without; after it a force only adds effort.",
      std::move(figure)};
}

std::vector<std::string> FindingsOf(const std::vector<Entry>& entries) {
  const auto gap = [&](const char* label, int steps) {
    const Entry* entry = Find(entries, nullptr, label, steps);
    if (entry == nullptr || !entry->run.exact.ok) return std::string("(no run)");
    return Format("%.2g", entry->run.exact.loss - entry->optimum);
  };
  return {
      "Finer steps, same problem: at 1000 steps gradient descent at the paper's rate ends " + gap(kPerStep, 1000) +
      " above the optimum after 1000 iterations, against " + gap(kPerStep, 480) +
      " at 480, only because the derivative by one step's force shrinks with the step; at the same rate per unit of "
      "time it is " +
      gap(kPerTime, 1000) + ". `ceres_phases`, a cost for every step with the impact between two of them, is " +
      gap("ceres_phases", 480) + " and " + gap("ceres_phases", 1000) +
      " above: the cost of forces that are constant over a step, which decreases with the square of the step."};
}

}  // namespace

std::optional<Section> CompareStrikes(const Scene& scene, const std::vector<BoundedReference>& references, int threads,
                                      ProgressMode mode) {
  std::vector<Entry> entries = PlanAll(scene, references);
  std::vector<std::string> names;
  for (const Entry& entry : entries) names.push_back("two_balls " + entry.label);
  Progress progress(mode, stderr, "solvers at the impact", entries.size());
  const bool done = RunJobs(names, threads, &progress, [&](int i, const SayNote&) {
    Entry& entry = entries[i];
    entry.run = SolveAndSimulate(entry.solver, {entry.scene, ExactModel()->name}, entry.options);
  });
  if (!done) return std::nullopt;
  return Section{FindingsOf(entries), TablesOf(entries), {FigureOf(entries, references)}};
}

}  // namespace saltus
