#include "saltus/audit/gradients.h"

#include "saltus/control/single_shooting.h"
#include "saltus/dynamics/registry.h"

namespace saltus {

ModelGradient ComputeGradient(std::string_view contact, const Scene& scene, Precision precision) {
  ModelGradient result;
  result.contact = contact;
  result.reason = WhyNotApplicable(contact, scene);
  if (!result.ok()) return result;
  SingleShooting shooting(MakeSimulator(contact, scene, precision));
  result.num_steps = shooting.simulator().num_steps();
  if (!shooting.EvaluateAll(shooting.initial_guess(), &result.loss, &result.gradient)) {
    result.reason = "the rollout is not finite";
    return result;
  }
  result.events = EventsOf(shooting.simulator());
  result.num_touches = static_cast<int>(shooting.simulator().touches().size());
  return result;
}

}  // namespace saltus
