// The audit of a black box.
#include "saltus/audit/black_box.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "audit/blackbox/black_box_head_on.h"
#include "audit/blackbox/black_box_simulator.h"
#include "audit/gradient/own_differences.h"
#include "audit/gradient/statistics.h"
#include "saltus/control/objective.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

using Motion = BlackBoxFindings::Motion;

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

// Precision. Displacements 2^-14, 2^-15, ... of a position, over a few steps of free flight.
constexpr int kLargestPower = 14, kSmallestPower = 58, kFlight = 3;
constexpr int kDoubleBits = 53, kFloatBits = 24, kBitsLost = 4;  // of a format, that rounding in a few steps may take
// Of a gradient by differences from answers with more noise than this; within that, errors are rounding.
constexpr double kMuchNoise = 1e-11, kNoisyTolerance = 1e-2, kNoisyRounding = 3e-3;
constexpr double kOwnTolerance = 300;  // noises of a gradient that the simulator gives

// Refinement by differences: fewer levels, as each gradient costs many rollouts.
constexpr int kLevels = 5, kMostLevels = 6;
// The motion.
constexpr int kMotionLevels = 4, kMotionSamples = 9;
constexpr double kMotionOrder = 0.5, kMotionFar = 1e-2, kExactMotion = 1e-9, kMotionNoise = 300;
// The width sweep: widths in what moves in a step.
constexpr double kNarrowFrom = 1e-3, kNarrowTo = 5e-2, kNoisyFrom = 3e-2, kNoisyTo = 0.2, kWideFrom = 2, kWideTo = 8;
constexpr double kRebounds = 0.5, kLost = 0.5;

// Relative noise of the answers: what is left of the final position of a disc when what a displacement does to it is
// taken off. Epsilon if nothing is to be seen.
double FindNoise(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits, const StopRequest& stop) {
  Question flight{Question::Kind::kSimulate,
                  kFlight * traits.grid_steps,
                  kFlight * traits.grid_steps * scene.dt(),
                  InitialState(scene),
                  InitialControl(scene, kFlight * traits.grid_steps),
                  {}};
  int index = -1;
  for (int i = 0; i < 4 * scene.num_bodies(); ++i) {
    if (i % 4 > 1 || scene.bodies[i / 4].fixed) continue;
    if (index < 0 || std::abs(flight.initial[i]) > std::abs(flight.initial[index])) index = i;
  }
  if (index < 0) return kEpsilon;
  const double scale = std::max(std::abs(flight.initial[index]), scene.bodies[index / 4].radius);
  std::vector<Question> questions = {flight};
  for (int power = kLargestPower; power <= kSmallestPower; ++power) {
    questions.push_back(flight);
    questions.back().initial[index] += std::ldexp(scale, -power);
  }
  const std::vector<Answer> answers = box->Ask(scene, questions, stop);
  const auto moved = [&](std::size_t i) { return answers[i].final[index] - answers[0].final[index]; };
  const auto displaced = [&](std::size_t i) { return questions[i].initial[index] - flight.initial[index]; };
  for (const Answer& answer : answers) {
    if (!answer.error.empty()) return kEpsilon;
  }
  const double slope = moved(1) / displaced(1);
  double noise = 0;
  for (std::size_t i = 1; i < answers.size(); ++i) {
    noise = std::max(noise, std::abs(moved(i) - slope * displaced(i)));
  }
  return std::max(kEpsilon, noise / scale);
}

// Of the format that has that noise, or just those that the noise leaves.
int BitsOf(double noise) {
  const int bits = static_cast<int>(std::lround(-std::log2(noise)));
  for (const int format : {kDoubleBits, kFloatBits}) {
    if (bits >= format - kBitsLost && bits <= format + 1) return format;
  }
  return bits;
}

// How fast the two of a pair are accelerated towards each other by the scene's forces, in a state of all discs.
double AccelerationIn(const Scene& scene, const Candidate& pair, const std::vector<double>& state) {
  const auto position = [&](int i) { return Vec2d(state[4 * i], state[4 * i + 1]); };
  const Vec2d of_a = InitialAcceleration(scene, pair.a);
  if (pair.plane) return -Dot(Vec2d(scene.planes[pair.b].normal.normalized()), of_a);
  return Dot(Vec2d((position(pair.b) - position(pair.a)).normalized()),
             Vec2d(of_a - InitialAcceleration(scene, pair.b)));
}

// The first in the exact motion; or else the first two discs, or a disc and a plane.
std::optional<Meeting> FirstMeeting(const Scene& scene, const std::optional<ModelGradient>& reference) {
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
    return Meeting{pair, run.ok ? AccelerationIn(scene, pair, run.end) : 0.0};
  }
  const auto moving = std::find_if(scene.bodies.begin(), scene.bodies.end(), [](const Body& b) { return !b.fixed; });
  if (moving == scene.bodies.end()) return std::nullopt;
  const int a = static_cast<int>(moving - scene.bodies.begin());
  if (scene.num_bodies() > 1) return Meeting{{a, a == 0 ? 1 : 0, false}};
  if (!scene.planes.empty()) return Meeting{{a, 0, true}};
  return std::nullopt;
}

// Losses at ever more steps beside the exact one.
void StudyMotion(BlackBox* box, const Scene& scene, const BlackBoxTraits& traits, const ModelGradient& exact,
                 const StopRequest& stop, BlackBoxFindings* findings) {
  std::vector<Question> questions;
  std::vector<int> steps;
  for (int level = 0; level < kMotionLevels; ++level) {
    for (int sample = 0; sample < kMotionSamples; ++sample) {
      const int own = (std::max(1, scene.steps / traits.grid_steps) << level) + sample;
      steps.push_back(own * traits.grid_steps);
      questions.push_back({Question::Kind::kSimulate,
                           steps.back(),
                           scene.duration,
                           InitialState(scene),
                           InitialControl(scene, steps.back()),
                           {}});
    }
  }
  const std::vector<Answer> answers = box->Ask(scene, questions, stop);
  std::vector<double> counts, medians;
  const double floor = std::max(kExactMotion, kMotionNoise * findings->noise);
  double largest = 0;
  for (int level = 0; level < kMotionLevels; ++level) {
    std::vector<double> errors;
    double log_steps = 0;
    for (int i = level * kMotionSamples; i < (level + 1) * kMotionSamples; ++i) {
      if (!answers[i].error.empty()) return;
      const double loss = TerminalLoss(scene.objective, answers[i].final, 4) +
                          EffortLoss(scene.objective, questions[i].control, scene.duration / steps[i]);
      errors.push_back(std::abs(loss - exact.loss) / exact.loss_scale);
      log_steps += std::log(steps[i]) / kMotionSamples;
    }
    const auto [smallest, worst] = std::minmax_element(errors.begin(), errors.end());
    findings->levels.push_back({std::exp(log_steps), Median(errors), *smallest, *worst});
    counts.push_back(findings->levels.back().steps);
    medians.push_back(std::max(Median(errors), floor));
    largest = std::max(largest, *worst);
  }
  if (largest <= floor) {
    findings->motion = Motion::kExact;
  } else if (-PowerOf(counts, medians) >= kMotionOrder && medians.back() < kMotionFar) {
    findings->motion = Motion::kConverges;
  } else {
    findings->motion = medians.back() <= floor ? Motion::kConverges : Motion::kDoesNotConverge;
  }
}

AskingOptions AskingWith(const BlackBoxFindings& findings) { return {.noise = findings.noise}; }

RefinementOptions RefinementOf(const BlackBoxFindings& findings, RefinementOptions options) {
  options.parameters = false;
  if (findings.own_gradient) {
    options.tolerance = std::max(options.tolerance, kOwnTolerance * findings.noise);
    options.rounding = std::max(options.rounding, kOwnTolerance * findings.noise);
    return options;
  }
  options.levels = std::min(options.levels, kLevels);
  options.most_levels = std::min(options.most_levels, kMostLevels);
  options.most_intervals = AskingOptions().segments;
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
  return options;
}

std::string Format(const char* format, double a, double b = 0) {
  char text[200];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

void Remark(const ModelAudit& audit, BlackBoxFindings* findings) {
  std::vector<std::string>& remarks = findings->remarks;
  const bool agrees = audit.own && audit.own->agreement == Agreement::kAgrees;
  if (findings->own_gradient && agrees && IsWrong(audit.verdict)) {
    remarks.push_back("agrees with differences, and is wrong: no gradient check finds this");
  }
  if (findings->motion == Motion::kDoesNotConverge) {
    remarks.push_back(
        Format("its motion does not converge to the exact one: the loss is off by %.2g of its scale at "
               "%.0f steps",
               findings->levels.back().error,
               findings->levels.back().steps));
  }
  if (findings->head_on && findings->finer && findings->head_on->e > kRebounds &&
      findings->finer->e < kLost * findings->head_on->e) {
    remarks.push_back(
        Format("the rebound depends on the step: %.3f of the closing speed, and %.3f with ten times as many steps",
               findings->head_on->e,
               findings->finer->e));
  }
  if (findings->precision_found < kDoubleBits) {
    remarks.push_back(
        Format("answers have %.0f bits: narrower differences than those used are noise", findings->precision_found));
  }
}

// Differences know the control by segments only.
ModelGradient AsMeasured(ModelGradient gradient, const BlackBoxFindings& findings) {
  const int segments = AskingOptions().segments;
  if (findings.own_gradient || gradient.num_steps % segments != 0) return gradient;
  gradient.gradient.control = CoarsenControl(gradient.gradient.control, gradient.num_steps, segments);
  gradient.num_steps = segments;
  return gradient;
}

// What the box could not be asked for any more, though it could before.
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

Contact MeasuredContactOf(const std::shared_ptr<BlackBox>& box, const Scene& scene, const StopRequest& stop) {
  const BlackBoxTraits traits = TraitsFor(box.get(), scene);
  const bool asked = traits.error.empty() && traits.not_applicable.empty();
  return ContactOf(box, traits, {.noise = asked ? FindNoise(box.get(), scene, traits, stop) : 0.0});
}

ModelAudit AuditBlackBox(const std::shared_ptr<BlackBox>& box, const Scene& scene,
                         const std::optional<ModelGradient>& reference, const AuditOptions& options) {
  const StopRequest& stop = options.stop;
  ModelAudit audit;
  audit.gradient.contact = box->name();
  BlackBoxFindings& findings = audit.black_box.emplace();
  const BlackBoxTraits traits = TraitsFor(box.get(), scene);
  findings.says = traits.name;
  findings.own_gradient = traits.gradient;
  findings.refused = traits.error.empty() && !traits.not_applicable.empty();
  const auto interrupted = [&] { return audit.interrupted = stop && stop(); };
  if (traits.error.empty() && !findings.refused) {
    findings.noise = FindNoise(box.get(), scene, traits, stop);
    findings.precision_found = BitsOf(findings.noise);
  }
  const Contact contact = ContactOf(box, traits, AskingWith(findings));
  audit.gradient = ComputeGradient(contact, scene, Precision::kDouble, stop);
  if (HasFailed(box.get(), scene, &audit) || !audit.gradient.ok()) {
    if (interrupted()) audit.gradient.reason = kStopped;
    return audit;
  }
  if (reference && !reference->ambiguous.empty()) {
    audit.verdict = Verdict::kAmbiguous;
    audit.ambiguous = reference->ambiguous;
    audit.spread = reference->spread;
    return audit;
  }
  if (const std::optional<Meeting> meeting = FirstMeeting(scene, reference)) {
    const HeadOnImpact impact(box, scene, *meeting, findings.noise, stop);
    ContactRecognition recognition;
    recognition.words = impact.reason();
    if (impact.reason().empty()) {
      findings.head_on = impact.Measure(1);
      findings.finer = impact.Measure(10);
      recognition = RecogniseOnBench(impact, impact.step(), impact.FarBefore(), scene.contact.restitution);
    }
    if (interrupted()) return audit;
    audit.recognition = std::move(recognition);
  }
  if (traits.gradient) {
    OwnDifferences own = CompareWithOwnDifferences(contact, scene, stop);
    if (interrupted()) return audit;
    audit.own = std::move(own);
  }
  if (reference) {
    audit.error = CompareGradients(AsMeasured(audit.gradient, findings), *reference);
    StudyMotion(box.get(), scene, traits, *reference, stop, &findings);
    RefinementStudy refinement = StudyRefinement(contact, scene, RefinementOf(findings, options.refinement), stop);
    if (interrupted()) return audit;
    audit.verdict = refinement.verdict;
    audit.refinement = std::move(refinement);
    if (options.attribution && traits.step && IsWrong(audit.verdict)) {
      AskingOptions touching = AskingWith(findings);
      touching.touches = true;
      Attribution attribution =
          AttributeError(ContactOf(box, traits, touching), scene, {stop, options.attribution_seconds, options.status});
      if (interrupted()) return audit;
      audit.attribution = std::move(attribution);
    }
  }
  if (options.width_sweep || !reference || !traits.gradient) {
    WidthSweepStudy widths = SweepWidths(contact, scene, WidthsOf(findings, options.widths), stop);
    if (interrupted()) return audit;
    if (!reference) audit.verdict = widths.verdict;
    audit.widths = std::move(widths);
  }
  if (!HasFailed(box.get(), scene, &audit)) Remark(audit, &findings);
  return audit;
}

}  // namespace saltus
