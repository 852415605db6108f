#include "simulate/derivative_overflow.h"

#include <algorithm>
#include <vector>

namespace saltus {

std::string ReasonDerivativesOverflow(const Simulator& simulator, std::span<const double> control) {
  const std::string model(simulator.traits().name);
  std::vector<double> x(simulator.state_size()), force(simulator.force_size());
  const std::vector<StepTouch>& touches = simulator.touches();
  for (auto at = touches.begin(); at != touches.end() && !simulator.stopped();) {
    const int step = at->step;
    const auto next = std::find_if(at, touches.end(), [&](const StepTouch& touch) { return touch.step != step; });
    simulator.GetState(step, x);
    simulator.ExpandForce(control, step, force);
    StepLinearization linear;
    simulator.Linearize(x, force, /*with_parameters=*/false, &linear);
    const bool finite = std::ranges::all_of(linear.islands, [](const StepLinearization::Island& island) {
      return island.A.allFinite() && island.B.allFinite();
    });
    if (!finite) {
      return "step " + std::to_string(step) + " of " + model + ": the derivatives of a state overflow, as " +
             std::to_string(next - at) + " contacts happen within the step: use more `steps`";
    }
    at = next;
  }
  return model +
         ": the derivatives of the motion overflow: it depends on its start beyond what numbers hold; use a "
         "shorter duration";
}

}  // namespace saltus
