// The audit of a black box.
#include "saltus/audit/black_box.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

#include "audit/blackbox/black_box_simulator.h"
#include "audit/gradient/step_study.h"
#include "base/number_text.h"
#include "base/statistics.h"
#include "saltus/control/objective.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

using Motion = BlackBoxFindings::Motion;

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
constexpr int kRepeats = 5;          // questions, three of which are the same
constexpr double kDisplaced = 1e-3;  // of a radius, in a question between two that are the same

// Precision. Displacements 2^-14, 2^-15, ... of a position, over a few steps of free flight.
constexpr int kLargestPower = 14, kSmallestPower = 58, kFlight = 3;
constexpr int kDoubleBits = 53, kFloatBits = 24, kBitsLost = 4;  // of a format, that rounding in a few steps may take
// With more noise than kMuchNoise, the tolerance and the rounding of gradients by differences are these.
constexpr double kMuchNoise = 1e-11, kNoisyTolerance = 1e-2, kNoisyRounding = 3e-3;
// The largest noise by the history of the box: about a third of the noise of differences at the best widths.
constexpr double kNoisyRepeat = 1e-3;
constexpr double kOwnTolerance = 300;  // noises of a gradient that the simulator gives

// Refinement by differences: fewer levels, as each gradient costs many rollouts.
constexpr int kLevels = 5, kMostLevels = 6;
// Levels of the study of the motion.
constexpr int kMotionLevels = 4;
// Numbers of samples of a level; the first one is used if time allows.
constexpr int kSamples[] = {9, 5, 3};
constexpr int kLeastLevels = 4;
// The cost of the study of a head-on impact, in rollouts of the scene, over half of its steps.
constexpr double kHeadOnRollouts = 13.5;
constexpr int kFiner = 10;
constexpr double kMotionOrder = 0.5, kMotionFar = 1e-2, kExactMotion = 1e-9, kMotionNoise = 300;
// Widths of differences, in the displacement of a disc in one step.
constexpr double kNarrowFrom = 1e-3, kNarrowTo = 5e-2, kNoisyFrom = 3e-2, kNoisyTo = 0.2, kWideFrom = 2, kWideTo = 8;
constexpr double kLatestNarrow = 1e-2;  // where narrow widths begin at the latest, if few runs are left
constexpr int kSpeeds = 32;             // states at which speeds are measured, about
// The most runs of the simulator in one audit, unless a gradient by differences needs more for a verdict.
constexpr int kMostCalls = 2000;
constexpr double kRebounds = 0.5, kLost = 0.5;

// Forwards questions to a black box, and counts the runs that they take.
class CountedBox final : public BlackBox {
 public:
  explicit CountedBox(std::shared_ptr<BlackBox> box) : box_(std::move(box)) {}

  const std::string& name() const override { return box_->name(); }
  BlackBoxTraits Describe(const Scene& scene) override { return box_->Describe(scene); }
  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& requests,
                                       const StopRequest& stop) override {
    calls_ += std::ranges::count_if(requests,
                                    [](const BlackBoxRequest& q) { return q.kind != BlackBoxRequest::Kind::kStep; });
    return box_->Evaluate(scene, requests, stop);
  }

  std::int64_t calls() const { return calls_; }

 private:
  const std::shared_ptr<BlackBox> box_;
  std::atomic<std::int64_t> calls_ = 0;
};

// Returns the question for the final state of the scene's motion over the first `steps` of its grid.
BlackBoxRequest MakeSceneRequest(const Scene& scene, int steps) {
  return {BlackBoxRequest::Kind::kSimulate,
          steps,
          steps * scene.dt(),
          InitialState(scene),
          InitialControl(scene, steps),
          {}};
}

// Returns the relative noise of the answers: the residual of the final position of a disc as a linear function of small
// displacements of its initial position, at least the rounding of doubles.
double FindNoise(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits, const StopRequest& stop) {
  const BlackBoxRequest flight = MakeSceneRequest(scene, kFlight * traits.grid_steps);
  int index = -1;
  for (int i = 0; i < 4 * scene.num_bodies(); ++i) {
    if (i % 4 > 1 || scene.bodies[i / 4].fixed) continue;
    if (index < 0 || std::abs(flight.initial[i]) > std::abs(flight.initial[index])) index = i;
  }
  if (index < 0) return kEpsilon;
  const double scale = std::max(std::abs(flight.initial[index]), scene.bodies[index / 4].radius);
  std::vector<BlackBoxRequest> requests = {flight};
  for (int power = kLargestPower; power <= kSmallestPower; ++power) {
    requests.push_back(flight);
    requests.back().initial[index] += std::ldexp(scale, -power);
  }
  const std::vector<BlackBoxAnswer> answers = box->Evaluate(scene, requests, stop);
  const auto moved = [&](std::size_t i) { return answers[i].final[index] - answers[0].final[index]; };
  const auto displaced = [&](std::size_t i) { return requests[i].initial[index] - flight.initial[index]; };
  for (const BlackBoxAnswer& answer : answers) {
    if (!answer.error.empty()) return kEpsilon;
  }
  const double slope = moved(1) / displaced(1);
  double noise = 0;
  for (std::size_t i = 1; i < answers.size(); ++i) {
    noise = std::max(noise, std::abs(moved(i) - slope * displaced(i)));
  }
  return std::max(kEpsilon, noise / scale);
}

// Returns the number of bits of the floating-point format with that noise, or else the bits above the noise.
int BitsOf(double noise) {
  const int bits = static_cast<int>(std::lround(-std::log2(noise)));
  for (const int format : {kDoubleBits, kFloatBits}) {
    if (bits >= format - kBitsLost && bits <= format + 1) return format;
  }
  return bits;
}

// Asks one question again and again, with others in between (other initial states, no forces). Each is asked alone, so
// that one copy of a command gets them all. Different answers are a remark. Returns whether they differ by so much that
// derivatives are not known.
bool HasMemory(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits, const RefinementOptions& refinement,
               const StopRequest& stop, BlackBoxFindings* findings) {
  const int steps = std::max(1, scene.steps / traits.grid_steps) * traits.grid_steps;
  const double duration = steps * scene.dt();
  BlackBoxRequest own = MakeSceneRequest(scene, steps);
  BlackBoxRequest reversed = own, displaced = own;
  if (traits.gradient) {  // that of the loss, as some simulators know no other
    const BlackBoxAnswer end = box->Evaluate(scene, {own}, stop).front();
    if (!end.error.empty()) return false;
    own.kind = BlackBoxRequest::Kind::kGradient;
    own.final_cotangent.resize(end.final.size());
    TerminalGradient(scene.objective, end.final, 4, own.final_cotangent);
  }
  for (double& force : reversed.control) force = 0;
  for (int i = 0; i < 4 * scene.num_bodies(); ++i) {
    if (scene.bodies[i / 4].fixed) continue;
    if (i % 4 > 1) reversed.initial[i] *= -1;
    if (i % 4 < 2) displaced.initial[i] += kDisplaced * scene.bodies[i / 4].radius;
  }
  const BlackBoxRequest* const requests[kRepeats] = {&own, &reversed, &own, &displaced, &own};
  std::vector<BlackBoxAnswer> answers;
  for (const BlackBoxRequest* request : requests) {
    answers.push_back(box->Evaluate(scene, {*request}, stop).front());
    if (!answers.back().error.empty()) return false;
  }
  double extent = 0, speed = 0, difference = 0, of_gradient = 0;
  for (const std::vector<double>* x : {&own.initial, &answers[0].final}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      extent = std::max(extent, std::hypot((*x)[4 * i], (*x)[4 * i + 1]));
      speed = std::max(speed, std::hypot((*x)[4 * i + 2], (*x)[4 * i + 3]));
    }
  }
  for (const BlackBoxAnswer* again : {&answers[2], &answers[4]}) {
    for (std::size_t i = 0; i < again->final.size(); ++i) {
      const double change = std::abs(again->final[i] - answers[0].final[i]);
      difference = std::max(difference, change * (i % 4 < 2 ? 1 : duration));
    }
    const double size = Norm(answers[0].initial), change = Distance(again->initial, answers[0].initial);
    of_gradient = std::max(of_gradient, size > 0 ? change / size : change);
  }
  if ((difference == 0 && of_gradient == 0) || extent == 0) return false;
  // The finest steps of a refinement have the narrowest differences, which noise disturbs most.
  const double moved = std::ldexp(speed * scene.dt() * traits.grid_steps, 1 - kLevels);
  const double width = moved > 0 ? WidthOfDifferences(findings->noise, extent, moved) : 0;
  const double tolerance = findings->noise > kMuchNoise ? kNoisyRepeat : refinement.tolerance;
  findings->remarks.push_back(FormatNumbers(
      "answers to the same question, with others asked in between, differ by %.2g of the extent of the motion",
      difference / extent));
  if (of_gradient > 0) {
    findings->remarks.back() += FormatNumbers(", and its gradients by %.2g of their size", of_gradient);
  }
  const bool decides = difference > tolerance * width || of_gradient > refinement.tolerance;
  if (decides) {
    findings->remarks.back() += ": its derivatives are not known";
    findings->precision_found = 0;  // the noise is that of the past
  }
  return decides;
}

// Returns the relative acceleration of a pair towards each other by the scene's forces, in a state of all discs.
double AccelerationIn(const Scene& scene, const Candidate& pair, const std::vector<double>& state) {
  const auto position = [&](int i) { return Vec2d(state[4 * i], state[4 * i + 1]); };
  const Vec2d of_a = InitialAcceleration(scene, pair.a);
  if (pair.plane) return -Dot(Vec2d(scene.planes[pair.b].normal.normalized()), of_a);
  return Dot(Vec2d((position(pair.b) - position(pair.a)).normalized()),
             Vec2d(of_a - InitialAcceleration(scene, pair.b)));
}

// Returns the first contact of the exact motion; without one, the first two discs, or a disc and a plane.
std::optional<HeadOnPair> FirstCollision(const Scene& scene, const std::optional<ModelGradient>& reference) {
  const auto index_of = [](const auto& all, const std::string& name) {
    const auto found = std::find_if(all.begin(), all.end(), [&](const auto& one) { return one.name == name; });
    return found == all.end() ? -1 : static_cast<int>(found - all.begin());
  };
  if (reference && !reference->events.empty()) {
    const Event& event = reference->events.front();
    const int a = index_of(scene.bodies, event.a), b = index_of(scene.bodies, event.b);
    const Candidate pair = b >= 0 ? Candidate{a, b, false} : Candidate{a, index_of(scene.planes, event.b), true};
    Scene until = scene;
    until.duration = event.time;
    until.steps = 1;
    const ExactRun run = SimulateExactly(until, InitialState(until), InitialControl(until, 1));
    return HeadOnPair{pair, run.ok ? AccelerationIn(scene, pair, run.end) : 0.0};
  }
  const auto moving = std::find_if(scene.bodies.begin(), scene.bodies.end(), [](const Body& b) { return !b.fixed; });
  if (moving == scene.bodies.end()) return std::nullopt;
  const int a = static_cast<int>(moving - scene.bodies.begin());
  if (scene.num_bodies() > 1) return HeadOnPair{{a, a == 0 ? 1 : 0, false}};
  if (!scene.planes.empty()) return HeadOnPair{{a, 0, true}};
  return std::nullopt;
}

// Compares losses at increasing numbers of steps with the exact one.
void StudyMotion(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits, const ModelGradient& exact,
                 int samples, const StopRequest& stop, BlackBoxFindings* findings) {
  std::vector<BlackBoxRequest> requests;
  std::vector<int> steps;
  for (int level = 0; level < kMotionLevels; ++level) {
    for (int sample = 0; sample < samples; ++sample) {
      const int own = (std::max(1, scene.steps / traits.grid_steps) << level) + sample;
      steps.push_back(own * traits.grid_steps);
      requests.push_back(MakeSceneRequest(scene, steps.back()));
      requests.back().duration = scene.duration;
    }
  }
  const std::vector<BlackBoxAnswer> answers = box->Evaluate(scene, requests, stop);
  std::vector<double> counts, medians;
  const double floor = std::max(kExactMotion, kMotionNoise * findings->noise);
  double largest = 0;
  for (int level = 0; level < kMotionLevels; ++level) {
    std::vector<double> errors;
    double log_steps = 0;
    for (int i = level * samples; i < (level + 1) * samples; ++i) {
      if (!answers[i].error.empty()) return;
      const double loss = TerminalLoss(scene.objective, answers[i].final, 4) +
                          EffortLoss(scene.objective, requests[i].control, scene.duration / steps[i]);
      errors.push_back(std::abs(loss - exact.loss) / exact.loss_scale);
      log_steps += std::log(steps[i]) / samples;
    }
    const auto [smallest, worst] = std::ranges::minmax(errors);
    const RefinementLevel& added =
        findings->levels.emplace_back(RefinementLevel{std::exp(log_steps), Median(errors), smallest, worst});
    counts.push_back(added.steps);
    medians.push_back(std::max(added.error, floor));
    largest = std::max(largest, added.largest);
  }
  if (largest <= floor) {
    findings->motion = Motion::kExact;
  } else if (-FittedExponent(counts, medians) >= kMotionOrder && medians.back() < kMotionFar) {
    findings->motion = Motion::kConverges;
  } else {
    findings->motion = medians.back() <= floor ? Motion::kConverges : Motion::kDoesNotConverge;
  }
}

BlackBoxOptions WithNoise(const BlackBoxFindings& findings) { return {.noise = findings.noise}; }

RefinementOptions RefinementOf(const BlackBoxFindings& findings, RefinementOptions options) {
  options.parameters = false;
  if (findings.own_gradient) {
    options.tolerance = std::max(options.tolerance, kOwnTolerance * findings.noise);
    options.rounding = std::max(options.rounding, kOwnTolerance * findings.noise);
    return options;
  }
  options.levels = std::min(options.levels, kLevels);
  options.most_levels = std::min(options.most_levels, kMostLevels);
  options.most_intervals = BlackBoxOptions().segments;
  if (findings.noise > kMuchNoise) {
    options.tolerance = std::max(options.tolerance, kNoisyTolerance);
    options.rounding = std::max(options.rounding, kNoisyRounding);
  }
  return options;
}

WidthSweepOptions WidthsOf(const BlackBoxFindings& findings, WidthSweepOptions options) {
  const bool noisy = findings.noise > kMuchNoise;
  options.refine = 1;
  options.smallest = options.narrow_from = noisy ? kNoisyFrom : kNarrowFrom;
  options.narrow_to = noisy ? kNoisyTo : kNarrowTo;
  options.wide_from = kWideFrom;
  options.largest = options.wide_to = kWideTo;
  options.most_states = kSpeeds;
  return options;
}

void Remark(const ModelAudit& audit, BlackBoxFindings* findings) {
  std::vector<std::string>& remarks = findings->remarks;
  const bool agrees = audit.gradient_check && audit.gradient_check->agreement == Agreement::kAgrees;
  if (findings->own_gradient && agrees && IsWrong(audit.verdict)) {
    remarks.push_back("agrees with differences, and is wrong: no gradient check finds this");
  }
  if (findings->motion == Motion::kDoesNotConverge) {
    remarks.push_back(
        FormatNumbers("its motion does not converge to the exact one: the loss is off by %.2g of its scale at "
                      "%.0f steps",
                      findings->levels.back().error,
                      findings->levels.back().steps));
  }
  if (findings->head_on && findings->finer && findings->head_on->e > kRebounds &&
      findings->finer->e < kLost * findings->head_on->e) {
    remarks.push_back(FormatNumbers(
        "the rebound depends on the step: %.3f of the closing speed, and %.3f with ten times as many steps",
        findings->head_on->e,
        findings->finer->e));
  }
  if (findings->precision_found < kDoubleBits) {
    remarks.push_back(FormatNumbers("answers have %.0f bits: narrower differences than those used are noise",
                                    findings->precision_found));
  }
}

// The plan of an audit: the costs of its parts, estimated from the time of the first gradient, and the parts that fit
// into the time and into kMostCalls.
class AuditPlan {
 public:
  AuditPlan(const AuditTime& time, const CountedBox& box, const std::function<void(const std::string&)>& status)
      : time_(time), box_(box), status_(status), start_(Elapsed()) {}

  double Elapsed() const {
    if (time_.clock) return time_.clock();
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  }
  bool limited() const { return time_.seconds > 0; }
  double RemainingTime() const { return time_.seconds - (Elapsed() - start_); }
  // Whether this many more calls fit.
  bool FitsCalls(double calls) const { return static_cast<double>(box_.calls()) + calls <= kMostCalls; }

  // Sets the cost of a gradient: `seconds`, for batches of this many rollouts.
  void SetCost(double seconds, int rollouts) {
    gradient_ = seconds;
    rollouts_ = rollouts;
    rollout_ = seconds / rollouts;
  }
  // Estimated time of rollouts in batches, and of rollouts one after the other, s.
  double TimeOfRollouts(double count) const { return rollout_ * count; }
  double TimeOfSingleRollouts(double count) const { return single_ * count; }
  void SetSingleCost(double seconds) { single_ = seconds; }
  // Returns the time of a refinement, in which each level has twice the steps of the one before, s.
  double TimeOfRefinement(int levels, int samples) const { return gradient_ * samples * (std::ldexp(1, levels) - 1); }
  double TimeOfMotionStudy(int samples) const { return TimeOfRollouts(samples * (std::ldexp(1, kMotionLevels) - 1)); }

  double TimeOfStudies(int levels, int samples) const {
    return TimeOfRefinement(levels, samples) + TimeOfMotionStudy(samples);
  }
  double CallsOfStudies(int levels, int samples) const {
    return static_cast<double>(samples) * (kMotionLevels + levels * rollouts_);
  }

  // Lowers the levels and samples of the refinement, and of the study of the motion beside it, to what fits; or to the
  // fewest.
  void Fit(RefinementOptions* refinement) const {
    const auto fits = [&](int levels) {
      return Fits(TimeOfStudies(levels, refinement->samples)) && FitsCalls(CallsOfStudies(levels, refinement->samples));
    };
    for (const int samples : kSamples) {
      refinement->samples = std::min(refinement->samples, samples);
      if (fits(kLeastLevels)) break;
    }
    while (refinement->most_levels > kLeastLevels && !fits(refinement->most_levels)) --refinement->most_levels;
    refinement->levels = std::min(refinement->levels, refinement->most_levels);
  }
  bool Fits(double seconds) const { return !limited() || seconds <= RemainingTime(); }
  void ReportStatus(const std::string& what, double seconds) const {
    if (status_) status_(what + FormatNumbers(", about %.2g s", seconds));
  }

 private:
  const AuditTime& time_;
  const CountedBox& box_;
  const std::function<void(const std::string&)>& status_;
  const double start_;
  double gradient_ = 0, rollout_ = 0, single_ = 0;  // s
  int rollouts_ = 1;                                // of a gradient
};

// Returns the number of rollouts that a gradient takes.
int NumRollouts(const Scene& scene, bool own_gradient) {
  if (own_gradient) return 3;  // a rollout, and a gradient, which takes about two
  const auto moving = std::count_if(scene.bodies.begin(), scene.bodies.end(), [](const Body& b) { return !b.fixed; });
  return 1 + 2 * (4 * static_cast<int>(moving) + BlackBoxOptions().segments * scene.control_width());
}

// Returns the number of single rollouts that differences of every width take.
double NumRolloutsOfWidths(const Scene& scene, const WidthSweepOptions& options) {
  const auto moving = std::count_if(scene.bodies.begin(), scene.bodies.end(), [](const Body& b) { return !b.fixed; });
  const auto entries = 4 * moving + scene.control_width();
  // The speeds take shorter runs.
  return static_cast<double>(2 * options.NumWidths() * entries) + 0.5 * std::min(scene.steps, kSpeeds);
}

// Returns the gradient with the control averaged over the segments that differences have.
ModelGradient AveragedOverSegments(ModelGradient gradient, const BlackBoxFindings& findings) {
  const int segments = BlackBoxOptions().segments;
  if (findings.own_gradient || gradient.num_steps % segments != 0) return gradient;
  gradient.gradient.control = CoarsenControl(gradient.gradient.control, gradient.num_steps, segments);
  gradient.num_steps = segments;
  return gradient;
}

// Returns the names of the parameters by which the box gives derivatives. The cotangent of the question is zero, as
// some boxes give the gradient of the loss only.
std::vector<std::string> ParametersGiven(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits,
                                         const StopRequest& stop) {
  const int steps = std::max(1, scene.steps / traits.grid_steps) * traits.grid_steps;
  BlackBoxRequest request = MakeSceneRequest(scene, steps);
  request.kind = BlackBoxRequest::Kind::kGradient;
  request.final_cotangent.assign(4 * scene.num_bodies(), 0.0);
  request.parameters = true;
  std::vector<std::string> names;
  const BlackBoxAnswer answer = box->Evaluate(scene, {request}, stop).front();
  for (const auto& [name, value] : answer.parameters) names.push_back(name);
  return names;
}

// Whether the box no longer answers, though it did before; sets the reason.
bool HasFailed(BlackBox* box, const Scene& scene, ModelAudit* audit) {
  const BlackBoxTraits traits = TraitsFor(box, scene);
  if (!traits.error.empty()) audit->gradient.reason = traits.error;
  return !traits.error.empty();
}

}  // namespace

const char* MotionToString(Motion motion) {
  constexpr const char* kNames[] = {"unknown", "exact", "converges", "does not converge"};
  return kNames[static_cast<int>(motion)];
}

Contact MakeMeasuredContact(const std::shared_ptr<BlackBox>& box, const Scene& scene, const StopRequest& stop) {
  const BlackBoxTraits traits = TraitsFor(box.get(), scene);
  const bool asked = traits.error.empty() && traits.not_applicable.empty();
  return MakeBlackBoxContact(box, traits, {.noise = asked ? FindNoise(box.get(), scene, traits, stop) : 0.0});
}

ModelAudit AuditBlackBox(const std::shared_ptr<BlackBox>& given, const Scene& scene,
                         const std::optional<ModelGradient>& reference, const AuditOptions& options,
                         const AuditTime& time) {
  const auto box = std::make_shared<CountedBox>(given);
  const StopRequest& stop = options.stop;
  ModelAudit audit;
  audit.gradient.contact = box->name();
  BlackBoxFindings& findings = audit.black_box.emplace();
  const BlackBoxTraits traits = TraitsFor(box.get(), scene);
  findings.reported_name = traits.name;
  findings.own_gradient = traits.gradient;
  findings.refused = traits.error.empty() && !traits.not_applicable.empty();
  const auto interrupted = [&] { return audit.interrupted = stop && stop(); };
  // A study that was stopped is dropped.
  const auto keep = [&](auto found, auto* kept) {
    if (interrupted()) return false;
    *kept = std::move(found);
    return true;
  };
  if (traits.error.empty() && !findings.refused) {
    findings.noise = FindNoise(box.get(), scene, traits, stop);
    findings.precision_found = BitsOf(findings.noise);
  }
  const Contact contact = MakeBlackBoxContact(box, traits, WithNoise(findings));
  AuditPlan plan(time, *box, options.status);
  const double begin = plan.Elapsed();
  audit.gradient = ComputeGradient(contact, scene, Precision::kDouble, stop);
  if (HasFailed(box.get(), scene, &audit) || !audit.gradient.ok()) {
    if (interrupted()) audit.gradient.reason = kStopped;
    return audit;
  }
  const double asked = plan.Elapsed();
  plan.SetCost(asked - begin, NumRollouts(scene, traits.gradient));
  RefinementOptions refinement_options = RefinementOf(findings, options.refinement);
  const bool depends = HasMemory(box.get(), scene, traits, refinement_options, stop, &findings);
  plan.SetSingleCost((plan.Elapsed() - asked) / kRepeats);
  if (interrupted()) return audit;
  if (reference && !reference->ambiguous.empty()) {
    audit.verdict = Verdict::kAmbiguous;
    audit.ambiguous = reference->ambiguous;
    audit.spread = reference->spread;
    return audit;
  }
  if (depends) return audit;
  const auto too_long = [&](const std::string& what, double seconds) {
    return what + FormatNumbers(" takes about %.2g s, more than is left of the %.2g s allowed", seconds, time.seconds);
  };
  WidthSweepOptions widths = WidthsOf(findings, options.widths);
  const double of_widths = plan.TimeOfSingleRollouts(NumRolloutsOfWidths(scene, widths));
  const double of_verdict = reference ? plan.TimeOfStudies(kLeastLevels, kSamples[2]) : of_widths;
  if (!plan.Fits(of_verdict)) {
    findings.remarks.insert(findings.remarks.begin(), too_long("the shortest study that gives a verdict", of_verdict));
    return audit;
  }
  if (const std::optional<HeadOnPair> meeting = FirstCollision(scene, reference)) {
    const HeadOnImpact impact(box, scene, *meeting, findings.noise, stop);
    ContactRecognition recognition;
    recognition.words = impact.reason();
    if (impact.reason().empty()) {
      for (const auto& [found, finer] : {std::pair(&findings.head_on, 1), std::pair(&findings.finer, kFiner)}) {
        const double seconds = plan.TimeOfRollouts(finer * kHeadOnRollouts);
        if (!plan.Fits(of_verdict + seconds)) continue;
        plan.ReportStatus("head-on impact", seconds);
        *found = impact.Measure(finer);
      }
      if (impact.IgnoresForce()) {
        findings.remarks.push_back("in the scene head_on, the force on the first disc does not change its velocity");
      }
      recognition = RecogniseOnBench(impact, impact.step(), impact.FarBefore(), scene.contact.restitution);
    }
    if (!keep(std::move(recognition), &audit.recognition)) return audit;
  }
  if (traits.gradient && !keep(CheckGradient(contact, scene, stop, 1, kSpeeds), &audit.gradient_check)) return audit;
  if (reference) {
    audit.error = CompareGradients(AveragedOverSegments(audit.gradient, findings), *reference);
    plan.Fit(&refinement_options);
    if (!plan.FitsCalls(plan.CallsOfStudies(refinement_options.levels, refinement_options.samples))) {
      findings.remarks.push_back(FormatNumbers(
          "the audit takes more than %.0f runs: a gradient takes %.0f of them, and a verdict needs gradients at %.0f "
          "numbers of steps",
          kMostCalls,
          NumRollouts(scene, traits.gradient),
          refinement_options.levels * refinement_options.samples));
    }
    plan.ReportStatus("motion", plan.TimeOfMotionStudy(refinement_options.samples));
    StudyMotion(box.get(), scene, traits, *reference, refinement_options.samples, stop, &findings);
    plan.ReportStatus("refinement", plan.TimeOfRefinement(refinement_options.levels, refinement_options.samples));
    if (!keep(StudyRefinement(contact, scene, refinement_options, stop), &audit.refinement)) return audit;
    audit.verdict = audit.refinement->verdict;
    if (options.attribution && traits.step && IsWrong(audit.verdict) && plan.Fits(0)) {
      BlackBoxOptions touching = WithNoise(findings);
      touching.touches = true;
      double seconds = options.attribution_seconds;
      if (plan.limited()) seconds = seconds > 0 ? std::min(seconds, plan.RemainingTime()) : plan.RemainingTime();
      const AttributionOptions attribution{stop, seconds, options.status};
      if (!keep(AttributeError(MakeBlackBoxContact(box, traits, touching), scene, attribution), &audit.attribution))
        return audit;
    }
  }
  if (options.width_sweep || !reference || !traits.gradient) {
    const auto fits = [&] { return !reference || plan.FitsCalls(NumRolloutsOfWidths(scene, widths)); };
    const double next = std::pow(10.0, 1.0 / widths.per_decade);
    while (widths.smallest < kLatestNarrow && !fits()) widths.narrow_from = widths.smallest *= next;
    if (!plan.Fits(of_widths)) {
      findings.remarks.push_back(too_long("the comparison with differences of every width", of_widths));
    } else if (!fits()) {
      findings.remarks.push_back(
          FormatNumbers("the comparison with differences of every width takes %.0f runs, more than are left of %.0f",
                        NumRolloutsOfWidths(scene, widths),
                        kMostCalls));
    } else {
      plan.ReportStatus("differences of every width", of_widths);
      if (!keep(SweepWidths(contact, scene, widths, stop), &audit.widths)) return audit;
      if (reference) CompareWithExact(scene, *reference, &*audit.widths);
      if (!reference) audit.verdict = audit.widths->verdict;
    }
  }
  if (HasFailed(box.get(), scene, &audit)) return audit;
  Remark(audit, &findings);
  if (traits.gradient && options.refinement.parameters && plan.Fits(0)) {
    // A scene with other parameters is given to another copy of a command.
    audit.parameters = CompareParameters(contact, scene, ParametersGiven(box.get(), scene, traits, stop), stop);
  }
  return audit;
}

}  // namespace saltus
