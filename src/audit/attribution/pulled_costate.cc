#include "audit/attribution/pulled_costate.h"

#include <glog/logging.h>

#include <limits>

#include "audit/attribution/step_map.h"

namespace saltus {

PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda) {
  const int size = NumbersOfDisc(simulator->scene()), all = simulator->num_bodies();
  CHECK_EQ(simulator->body_size(), size);
  const auto n = static_cast<Eigen::Index>(bodies.size());
  const bool runs =
      simulator->Rollout(ToInitial(begin, all), InitialControl(simulator->scene(), simulator->num_steps()));
  const auto pull_back = [&](bool by_velocities) -> Eigen::VectorXd {
    Eigen::VectorXd pulled = Eigen::VectorXd::Constant(size * n, std::numeric_limits<double>::quiet_NaN());
    if (!runs) return pulled;
    std::vector<double> cotangent(simulator->state_size()), initial(simulator->state_size());
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = 0; j < size; ++j) {
        if (IsRate(j) == by_velocities) cotangent[size * bodies[i] + j] = lambda[size * i + j];
      }
    }
    SensitivityView by;
    by.initial = initial;
    simulator->AdjointInto(cotangent, by);
    const std::vector<double> state = ToState(initial, all);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = 0; j < size; ++j) pulled[size * i + j] = state[size * bodies[i] + j];
    }
    return pulled;
  };
  return {pull_back(false), pull_back(true)};
}

}  // namespace saltus
