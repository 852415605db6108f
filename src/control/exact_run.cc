#include "saltus/control/exact_run.h"

#include <glog/logging.h>

#include "saltus/control/objective.h"
#include "saltus/dynamics/registry.h"

namespace saltus {

ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control) {
  ExactRun run;
  const ModelTraits* exact = nullptr;
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.event_driven) exact = &traits;
  }
  if (exact == nullptr) {
    run.reason = "no event-driven contact model is registered";
    return run;
  }
  Scene resampled = scene;
  if (scene.num_controlled() > 0) {
    CHECK_EQ(control.size() % (2 * scene.num_controlled()), 0u);
    resampled.steps = static_cast<int>(control.size() / (2 * scene.num_controlled()));
  }
  run.reason = WhyNotApplicable(exact->name, resampled);
  if (!run.reason.empty()) return run;
  const std::unique_ptr<Simulator> simulator = MakeSimulator(exact->name, resampled, Precision::kDouble);
  if (!simulator->Rollout(initial, control)) {
    run.reason = "the exact rollout is not finite";
    return run;
  }
  std::vector<double> x(simulator->state_size());
  simulator->GetState(simulator->num_steps(), x);
  run.ok = true;
  run.loss = TerminalLoss(scene.objective, x, simulator->body_size()) +
             EffortLoss(scene.objective, control, simulator->step());
  run.events = EventsOf(*simulator);
  return run;
}

}  // namespace saltus
