#include "audit/attribution/step_map.h"

#include <glog/logging.h>

#include <algorithm>
#include <limits>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

// Returns A of dx' = A dx over `bodies`, rotation included.
Eigen::MatrixXd DenseOver(const StepLinearization& step, const std::vector<int>& bodies) {
  const int size = step.body_size;
  const int n = static_cast<int>(bodies.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n * size, n * size);
  const auto local = [&](int body) {
    const auto at = std::find(bodies.begin(), bodies.end(), body);
    return at == bodies.end() ? -1 : static_cast<int>(at - bodies.begin()) * size;
  };
  for (size_t f = 0; f < step.flying.size(); ++f) {
    const int at = local(step.flying[f]);
    if (at < 0) continue;
    const Eigen::Matrix2d identity = Eigen::Matrix2d::Identity();
    A.block<2, 2>(at, at) = step.free.pp * identity;
    A.block<2, 2>(at, at + 2) = step.free.pv * identity;
    A.block<2, 2>(at + 2, at) = step.free.vp * identity;
    A.block<2, 2>(at + 2, at + 2) = step.free.vv * identity;
    if (size > 4) A.block(at + 4, at + 4, size - 4, size - 4) = step.rotation[f];
  }
  for (const StepLinearization::Island& island : step.islands) {
    for (size_t i = 0; i < island.bodies.size(); ++i) {
      for (size_t j = 0; j < island.bodies.size(); ++j) {
        const int row = local(island.bodies[i]), column = local(island.bodies[j]);
        if (row < 0 || column < 0) continue;
        A.block(row, column, size, size) = island.A.block(i * size, j * size, size, size);
      }
    }
  }
  return A;
}

}  // namespace

int NumbersOfDisc(const Scene& scene) { return scene.Spins() ? 4 + kSpin : 4; }

Eigen::VectorXd StateScales(const Scene& scene, const std::vector<int>& bodies, double time) {
  const int size = NumbersOfDisc(scene);
  Eigen::VectorXd scales(size * bodies.size());
  for (size_t i = 0; i < bodies.size(); ++i) {
    const double radius = scene.bodies[bodies[i]].radius;
    const double of_disc[] = {1, 1, time, time, radius, radius * time};
    for (int j = 0; j < size; ++j) scales[size * i + j] = of_disc[j];
  }
  return scales;
}

StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                 const std::vector<int>* bodies) {
  StepMap map;
  std::vector<double> x(begin.begin(), begin.end()), next(x.size()), u(simulator.force_size());
  std::vector<Touch> touches;
  StepLinearization linearization;
  Eigen::MatrixXd A;
  for (int k = 0; k < steps && !(k > 0 && simulator.stopped()); ++k) {
    force(k, u);
    if (bodies != nullptr) {
      simulator.Linearize(x, u, /*with_parameters=*/false, &linearization);
      const Eigen::MatrixXd step = DenseOver(linearization, *bodies);
      A = k == 0 ? step : Multiply(step, A);
    }
    touches.clear();
    simulator.Step(x, u, next, &touches);
    for (const Touch& touch : touches) map.touches.push_back({k, touch});
    std::swap(x, next);
  }
  map.end = x;
  if (bodies == nullptr) return map;
  const int n = static_cast<int>(bodies->size()), size = simulator.body_size(), kept = NumbersOfDisc(simulator.scene());
  map.A.resize(kept * n, kept * n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) map.A.block(kept * i, kept * j, kept, kept) = A.block(i * size, j * size, kept, kept);
  }
  return map;
}

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
