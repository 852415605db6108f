#include "saltus/audit/gradients.h"

#include <glog/logging.h>

#include <algorithm>

#include "control/smoothed_gradient.h"
#include "saltus/control/objective.h"
#include "saltus/control/single_shooting.h"
#include "scene/units.h"

namespace saltus {
namespace {

// Returns the reason why there is no gradient. Bounds and pairs that must not touch do not change the loss.
std::string UnsupportedByGradient(const Scene& scene) {
  const std::string found = NonTerminalTerms(scene.objective);
  return found.empty() ? ""
                       : "the scene has " + found +
                             ", of which there is no gradient by shooting: take that of its hybrid problem "
                             "(saltus.hybrid_problem)";
}

// Computes loss, events and the gradient by the adjoint.
void FillIn(const Contact& contact, const Scene& scene, Precision precision, const StopRequest& stop,
            ModelGradient* result, const std::vector<double>* control = nullptr, bool with_grazes = false) {
  Scene near = NearOrigin(scene);
  if (control != nullptr) near.optimize = Optimize::kControl;
  SingleShooting shooting(MakeSimulator(contact, near, precision));
  shooting.set_stop(stop);
  result->num_steps = shooting.simulator().num_steps();
  const std::vector<double>& variables = control != nullptr ? *control : shooting.initial_guess();
  if (static_cast<int>(variables.size()) != shooting.num_variables()) {
    result->reason = "found a control of " + std::to_string(variables.size()) + " numbers, expected " +
                     std::to_string(shooting.num_variables());
    return;
  }
  if (!shooting.EvaluateAll(variables, &result->loss, &result->gradient)) {
    const std::string why = shooting.simulator().FailureReason();
    result->reason = why.empty() ? "the loss is not finite" : "the rollout fails: " + why;
    if (shooting.stopped()) result->reason = kStopped;
    return;
  }
  if (const std::string why = shooting.FailureReason(); !why.empty()) {
    result->reason = "the gradient is not finite: " + why;
    return;
  }
  result->loss = ConvertLoss(result->loss, near.units, scene.units);
  result->events = EventsOf(shooting.simulator());
  if (with_grazes) result->grazes = GrazesOf(shooting.simulator(), shooting.ControlAt(variables));
  result->ambiguous = TiesOf(shooting.simulator());
  result->num_touches = static_cast<int>(shooting.simulator().touches().size());
  result->unresolved_steps = NumUnresolvedSteps(shooting.simulator());
}

// Estimates the gradient at the initial guess; returns false if a sample is not finite, or if it was stopped.
bool Estimate(SmoothedGradient smoothed, const StopRequest& stop, std::vector<double>* gradient,
              std::vector<double>* standard_error) {
  smoothed.set_stop(stop);
  gradient->resize(smoothed.num_variables());
  standard_error->resize(smoothed.num_variables());
  return smoothed.Evaluate(smoothed.initial_guess(), 0, *gradient, *standard_error);
}

// Converts a vector of positions of all moving discs, then their velocities, then the rotations of those that spin, to
// the layout of an initial state.
std::vector<double> PerDisc(const Scene& scene, const std::vector<double>& variables) {
  std::vector<double> initial(InitialSize(scene));
  size_t next = 0;
  for (int offset : {0, 2}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (scene.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) initial[4 * i + offset + j] = variables[next++];
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].Spins()) continue;
    for (int j = 0; j < kSpin; ++j) initial[4 * scene.num_bodies() + kSpin * i + j] = variables[next++];
  }
  return initial;
}

bool Smooth(const Scene& given, Precision precision, int threads, const StopRequest& stop, ModelGradient* result) {
  const Scene scene = NearOrigin(given);
  using Variables = SmoothedGradient::Variables;
  const Surrogate& surrogate = *result->surrogate;
  std::vector<double> gradient, standard_error;
  if (!Estimate({result->contact, scene, precision, surrogate, threads, Variables::kInitialState},
                stop,
                &gradient,
                &standard_error)) {
    return false;
  }
  result->gradient.initial = PerDisc(scene, gradient);
  result->initial_error = PerDisc(scene, standard_error);
  result->gradient.parameters = {};
  if (scene.control.bodies.empty()) return true;
  Scene controlled = scene;
  controlled.optimize = Optimize::kControl;
  return Estimate({result->contact, controlled, precision, surrogate, threads},
                  stop,
                  &result->gradient.control,
                  &result->control_error);
}

}  // namespace

void SetScales(const Scene& scene, ModelGradient* gradient) {
  const UnitFactors natural(NaturalUnits(scene), scene.units);
  gradient->spins = scene.Spins();
  gradient->duration = scene.duration;
  gradient->mass = natural.mass;
  gradient->length = natural.length;
  gradient->loss_scale = natural.loss;
}

ModelGradient ComputeGradient(const Contact& contact, const Scene& scene, Precision precision, const StopRequest& stop,
                              const std::vector<double>* control, bool with_grazes) {
  ModelGradient result;
  result.contact = contact.name();
  SetScales(scene, &result);
  result.reason = ReasonNotApplicable(contact, scene);
  if (result.ok()) result.reason = UnsupportedByGradient(scene);
  if (result.ok()) FillIn(contact, scene, precision, stop, &result, control, with_grazes);
  if (result.ok() && CHECK_NOTNULL(FindContactModel(contact))->event_driven) {
    result.one_sided = OneSidedDerivatives(ToNaturalUnits(scene));
  }
  return result;
}

ModelGradient ComputeSurrogate(const Contact& contact, const Scene& scene, Precision precision,
                               const Surrogate& surrogate, int threads, const StopRequest& stop) {
  ModelGradient result;
  result.contact = contact.name();
  SetScales(scene, &result);
  result.surrogate = surrogate;
  result.reason = Validate(surrogate);
  if (result.ok()) result.reason = ReasonNotApplicable(contact, scene);
  if (result.ok()) result.reason = UnsupportedByGradient(scene);
  if (result.ok()) result.reason = ReasonNotApplicable(surrogate, contact, scene);
  if (!result.ok()) return result;
  FillIn(ApplySurrogate(surrogate, contact), scene, precision, stop, &result);
  if (!result.ok() || !surrogate.smooths()) return result;
  if (!Smooth(scene, precision, threads, stop, &result)) {
    result.reason = stop && stop() ? kStopped : "the rollout of a sample is not finite";
  }
  return result;
}

}  // namespace saltus
