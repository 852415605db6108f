#include "audit/pulled_costate.h"

#include <glog/logging.h>

#include <limits>

namespace saltus {

PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda) {
  CHECK_EQ(simulator->body_size(), 4);
  const auto n = static_cast<Eigen::Index>(bodies.size());
  const bool runs = simulator->Rollout(begin, InitialControl(simulator->scene(), simulator->num_steps()));
  const auto pull_back = [&](int first) -> Eigen::VectorXd {
    Eigen::VectorXd pulled = Eigen::VectorXd::Constant(4 * n, std::numeric_limits<double>::quiet_NaN());
    if (!runs) return pulled;
    std::vector<double> cotangent(simulator->state_size()), initial(simulator->state_size());
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = first; j < first + 2; ++j) cotangent[4 * bodies[i] + j] = lambda[4 * i + j];
    }
    SensitivityView by;
    by.initial = initial;
    simulator->AdjointInto(cotangent, by);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = 0; j < 4; ++j) pulled[4 * i + j] = initial[4 * bodies[i] + j];
    }
    return pulled;
  };
  return {pull_back(0), pull_back(2)};
}

}  // namespace saltus
