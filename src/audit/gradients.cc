#include "saltus/audit/gradients.h"

#include <glog/logging.h>

#include "saltus/control/single_shooting.h"
#include "saltus/control/smoothed_gradient.h"
#include "saltus/dynamics/registry.h"
#include "saltus/physics/units.h"

namespace saltus {
namespace {

// Loss, events and the adjoint's gradient.
void FillIn(std::string_view contact, const Scene& scene, Precision precision, ModelGradient* result) {
  const Scene near = NearOrigin(scene);
  SingleShooting shooting(MakeSimulator(contact, near, precision));
  result->num_steps = shooting.simulator().num_steps();
  if (!shooting.EvaluateAll(shooting.initial_guess(), &result->loss, &result->gradient)) {
    result->reason = "the rollout is not finite";
    return;
  }
  result->loss = ConvertLoss(result->loss, near.units, scene.units);
  result->events = EventsOf(shooting.simulator());
  result->num_touches = static_cast<int>(shooting.simulator().touches().size());
}

// The estimate about the initial guess; false if a sample is not finite.
bool Estimate(SmoothedGradient smoothed, std::vector<double>* gradient, std::vector<double>* standard_error) {
  gradient->resize(smoothed.num_variables());
  standard_error->resize(smoothed.num_variables());
  return smoothed.Evaluate(smoothed.initial_guess(), 0, *gradient, *standard_error);
}

// From the positions of all discs that move, then their velocities, to B x 4 numbers.
std::vector<double> PerDisc(const Scene& scene, const std::vector<double>& variables) {
  std::vector<double> initial(4 * scene.num_bodies());
  size_t next = 0;
  for (int offset : {0, 2}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (scene.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) initial[4 * i + offset + j] = variables[next++];
    }
  }
  return initial;
}

bool Smooth(const Scene& given, Precision precision, int threads, ModelGradient* result) {
  const Scene scene = NearOrigin(given);
  using Variables = SmoothedGradient::Variables;
  const Surrogate& surrogate = *result->surrogate;
  std::vector<double> gradient, standard_error;
  if (!Estimate({result->contact, scene, precision, surrogate, threads, Variables::kInitialState},
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
  return Estimate(
      {result->contact, controlled, precision, surrogate, threads}, &result->gradient.control, &result->control_error);
}

}  // namespace

void SetScales(const Scene& scene, ModelGradient* gradient) {
  const UnitFactors natural(NaturalUnits(scene), scene.units);
  gradient->duration = scene.duration;
  gradient->mass = natural.mass;
  gradient->loss_scale = natural.loss;
}

ModelGradient ComputeGradient(std::string_view contact, const Scene& scene, Precision precision) {
  ModelGradient result;
  result.contact = contact;
  SetScales(scene, &result);
  result.reason = WhyNotApplicable(contact, scene);
  if (result.ok()) FillIn(contact, scene, precision, &result);
  return result;
}

ModelGradient ComputeSurrogate(std::string_view contact, const Scene& scene, Precision precision,
                               const Surrogate& surrogate, int threads) {
  CHECK(WhyNotValid(surrogate).empty()) << WhyNotValid(surrogate);
  ModelGradient result;
  result.contact = contact;
  SetScales(scene, &result);
  result.surrogate = surrogate;
  result.reason = WhyNotApplicable(contact, scene);
  if (result.ok()) result.reason = WhyNotApplicable(surrogate, contact, scene);
  if (!result.ok()) return result;
  FillIn(ContactWith(surrogate, contact), scene, precision, &result);
  if (!result.ok() || !surrogate.smooths()) return result;
  if (!Smooth(scene, precision, threads, &result)) result.reason = "the rollout of a sample is not finite";
  return result;
}

}  // namespace saltus
