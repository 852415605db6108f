// The linearization of a motion of discs.
#include <glog/logging.h>

#include <Eigen/Core>
#include <numeric>
#include <vector>

#include "feedback/near_misses.h"
#include "feedback/scene_intervals.h"
#include "saltus/feedback/regulator.h"

namespace saltus {

LinearMotion Linearize(const Simulator& motion, std::span<const double> control) {
  return Linearize(SceneIntervals(motion), control);
}

LinearMotion Linearize(const SceneIntervals& motion, std::span<const double> control) {
  const Simulator& simulator = motion.simulator();
  const int n = simulator.state_size();
  const auto width = static_cast<std::size_t>(simulator.control_width());
  CHECK_EQ(control.size(), motion.size() * width);
  // The columns of the derivatives by forces that belong to a row of the control.
  std::vector<double> numbers(simulator.force_size()), columns(width), force(numbers.size());
  std::iota(numbers.begin(), numbers.end(), 0);
  simulator.SelectControl(numbers, columns);
  const std::vector<SceneEvent> events = PlannedEvents(motion);
  auto event = events.begin();
  LinearMotion linear;
  linear.end = motion.end();
  StepLinearization step;
  Eigen::MatrixXd by_force;
  for (int k = 0; k < motion.size(); ++k) {
    LinearInterval& interval = linear.intervals.emplace_back(LinearInterval{.begin = motion[k].begin});
    if (motion[k].simulator == nullptr) {
      interval.A = Eigen::MatrixXd::Identity(n, n);
      interval.B = Eigen::MatrixXd::Zero(n, static_cast<Eigen::Index>(width));
      continue;
    }
    simulator.ExpandForce(control.subspan(k * width, width), 0, force);
    motion[k].simulator->Linearize(motion.State(k), force, /*with_parameters=*/false, &step);
    step.ToDense(&interval.A, &by_force);
    interval.B = Select(by_force, columns);
    const auto first = event;
    while (event != events.end() && event->label.interval == k) ++event;
    AddEventsAndNearMisses(motion, k, {first, event}, force, columns, &interval);
  }
  return linear;
}

}  // namespace saltus
