#include "saltus/simulate/simulator.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "scene/path_motion.h"

namespace saltus {
namespace {

void CheckSizes(const StepLinearization& linearization, std::size_t x, std::size_t force, std::size_t next) {
  const std::size_t num_bodies = linearization.inverse_mass.size();
  CHECK_EQ(x, num_bodies * linearization.body_size);
  CHECK_EQ(next, num_bodies * linearization.body_size);
  CHECK_EQ(force, linearization.force_size());
}

}  // namespace

void StepLinearization::Apply(std::span<const double> x, std::span<const double> force, std::span<double> next) const {
  CheckSizes(*this, x.size(), force.size(), next.size());
  const int rotation_size = body_size - 4;
  for (size_t f = 0; f < flying.size(); ++f) {
    const int i = flying[f];
    for (int j = 0; j < 2; ++j) {
      const double p = x[i * body_size + j];
      const double v = x[i * body_size + 2 + j];
      const double a = inverse_mass[i] * force[2 * i + j];
      next[i * body_size + j] = free.pp * p + free.pv * v + free.pa * a;
      next[i * body_size + 2 + j] = free.vp * p + free.vv * v + free.va * a;
    }
    if (rotation_size == 0) continue;
    const Eigen::Map<const Eigen::VectorXd> from(&x[i * body_size + 4], rotation_size);
    Eigen::Map<Eigen::VectorXd> to(&next[i * body_size + 4], rotation_size);
    to = rotation[f] * from;
    if (has_torques) to += force[2 * inverse_mass.size() + i] * by_torque[f];
  }
  for (const Island& island : islands) {
    const int n = static_cast<int>(island.bodies.size());
    Eigen::VectorXd from(n * body_size), push((has_torques ? 3 : 2) * n);
    for (int i = 0; i < n; ++i) {
      std::copy_n(&x[island.bodies[i] * body_size], body_size, from.data() + i * body_size);
      std::copy_n(&force[2 * island.bodies[i]], 2, push.data() + 2 * i);
      if (has_torques) push[2 * n + i] = force[2 * inverse_mass.size() + island.bodies[i]];
    }
    const Eigen::VectorXd to = island.A * from + island.B * push;
    for (int i = 0; i < n; ++i) {
      std::copy_n(to.data() + i * body_size, body_size, &next[island.bodies[i] * body_size]);
    }
  }
}

void StepLinearization::ApplyTranspose(std::span<const double> next, std::span<double> x,
                                       std::span<double> force) const {
  CheckSizes(*this, x.size(), force.size(), next.size());
  const int rotation_size = body_size - 4;
  for (size_t f = 0; f < flying.size(); ++f) {
    const int i = flying[f];
    for (int j = 0; j < 2; ++j) {
      const double p = next[i * body_size + j];
      const double v = next[i * body_size + 2 + j];
      x[i * body_size + j] = free.pp * p + free.vp * v;
      x[i * body_size + 2 + j] = free.pv * p + free.vv * v;
      force[2 * i + j] = inverse_mass[i] * (free.pa * p + free.va * v);
    }
    if (rotation_size == 0) continue;
    const Eigen::Map<const Eigen::VectorXd> from(&next[i * body_size + 4], rotation_size);
    Eigen::Map<Eigen::VectorXd>(&x[i * body_size + 4], rotation_size) = rotation[f].transpose() * from;
    if (has_torques) force[2 * inverse_mass.size() + i] = by_torque[f].dot(from);
  }
  for (const Island& island : islands) {
    const int n = static_cast<int>(island.bodies.size());
    Eigen::VectorXd from(n * body_size);
    for (int i = 0; i < n; ++i) {
      std::copy_n(&next[island.bodies[i] * body_size], body_size, from.data() + i * body_size);
    }
    const Eigen::VectorXd to = island.A.transpose() * from;
    const Eigen::VectorXd push = island.B.transpose() * from;
    for (int i = 0; i < n; ++i) {
      std::copy_n(to.data() + i * body_size, body_size, &x[island.bodies[i] * body_size]);
      std::copy_n(push.data() + 2 * i, 2, &force[2 * island.bodies[i]]);
      if (has_torques) force[2 * inverse_mass.size() + island.bodies[i]] = push[2 * n + i];
    }
  }
}

void StepLinearization::ToDense(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const {
  const int num_bodies = static_cast<int>(inverse_mass.size());
  const int size = num_bodies * body_size;
  A->resize(size, size);
  const auto forces = static_cast<Eigen::Index>(force_size());
  B->resize(size, forces);
  Eigen::VectorXd next = Eigen::VectorXd::Zero(size), x(size), force(forces);
  for (int row = 0; row < size; ++row) {
    next[row] = 1;
    ApplyTranspose(
        {next.data(), static_cast<size_t>(size)}, {x.data(), static_cast<size_t>(size)}, {force.data(), force_size()});
    A->row(row) = x;
    B->row(row) = force;
    next[row] = 0;
  }
}

std::string Simulator::FailureReason() const {
  if (!failure_) return "";
  RolloutFailure failure = *failure_;
  if (failure.reason.empty()) {
    failure.reason = "the state is not finite";
    std::vector<double> x(state_size());
    for (int k = 0; k <= num_steps_ && failure.step < 0; ++k) {
      GetState(k, x);
      const auto wrong = std::find_if(x.begin(), x.end(), [](double value) { return !std::isfinite(value); });
      if (wrong == x.end()) continue;
      failure.step = std::max(0, k - 1);
      failure.body = static_cast<int>(wrong - x.begin()) / body_size();
    }
  }
  const std::string where = failure.step < 0 ? "" : "step " + std::to_string(failure.step) + " of ";
  std::string why = where + std::string(traits().name) + ": ";
  why += failure.reason;
  if (failure.body >= 0) why += " (" + scene_.bodies[failure.body].name + ")";
  return why;
}

void Simulator::Adjoint(std::span<const double> cotangent, bool with_parameters, Sensitivity* sensitivity) {
  sensitivity->initial.resize(initial_size());
  sensitivity->control.resize(control_size());
  if (!with_parameters) sensitivity->parameters = {};
  AdjointInto(cotangent,
              {sensitivity->initial, sensitivity->control, with_parameters ? &sensitivity->parameters : nullptr});
}

void Simulator::ExpandForce(std::span<const double> control, int k, std::span<double> force) const {
  CHECK(k >= 0 && k < num_steps_) << "found step " << k << ", expected 0 to " << num_steps_ - 1;
  // A control of fewer steps is enough, such as that of one step in a cost.
  CHECK_GE(control.size(), (k + std::size_t{1}) * control_width());
  CHECK_EQ(static_cast<int>(force.size()), force_size());
  std::fill(force.begin(), force.end(), 0.0);
  const double* u = control.data() + scene_.ForceIndex(k, 0);
  for (int body : scene_.control.bodies) {
    force[2 * body] = *u++;
    force[2 * body + 1] = *u++;
  }
  for (int body : scene_.control.torque_bodies) force[2 * num_bodies() + body] = *u++;
}

void Simulator::SelectControl(std::span<const double> force, std::span<double> row) const {
  CHECK_EQ(static_cast<int>(force.size()), force_size());
  CHECK_EQ(static_cast<int>(row.size()), control_width());
  double* u = row.data();
  for (int body : scene_.control.bodies) u = std::copy_n(&force[2 * body], 2, u);
  for (int body : scene_.control.torque_bodies) *u++ = force[2 * num_bodies() + body];
}

double ContactDerivative(const SceneParameter& parameter, const ParameterGradient& gradient) {
  const PairConstants<double> of_scene{gradient.restitution, gradient.friction};
  const PairConstants<double>& by = gradient.pairs.empty() ? of_scene : gradient.pairs[parameter.component];
  return parameter.kind == SceneParameter::Kind::kRestitution ? by.restitution : by.friction;
}

int InitialSize(const Scene& scene) { return (scene.Spins() ? 4 + kSpin : 4) * scene.num_bodies(); }

std::vector<double> ToInitial(std::span<const double> state, int num_bodies) {
  const std::size_t bodies = num_bodies, size = state.size() / bodies;
  std::vector<double> initial;
  for (std::size_t i = 0; i < bodies; ++i) initial.insert(initial.end(), &state[i * size], &state[i * size] + 4);
  for (std::size_t i = 0; i < bodies && size == 4 + kSpin; ++i) {
    initial.insert(initial.end(), &state[i * size] + 4, &state[i * size] + size);
  }
  return initial;
}

std::vector<double> ToState(std::span<const double> initial, int num_bodies) {
  const std::size_t bodies = num_bodies, rotation = initial.size() / bodies - 4;
  std::vector<double> state;
  for (std::size_t i = 0; i < bodies; ++i) {
    const double *moves = initial.data() + 4 * i, *turns = initial.data() + 4 * bodies + rotation * i;
    state.insert(state.end(), moves, moves + 4);
    state.insert(state.end(), turns, turns + rotation);
  }
  return state;
}

std::vector<double> InitialState(const Scene& scene) {
  std::vector<double> state;
  for (const Body& body : scene.bodies) {
    const Vec2d velocity = body.path ? PathMotion(*body.path).SampleAt(0).velocity : body.velocity;
    state.insert(state.end(), {body.position[0], body.position[1], velocity[0], velocity[1]});
  }
  if (!scene.Spins()) return state;
  for (const Body& body : scene.bodies) state.insert(state.end(), {body.angle, body.angular_velocity});
  return state;
}

std::vector<double> InitialControl(const Scene& scene, int num_steps) {
  std::vector<double> control;
  control.reserve(static_cast<size_t>(num_steps) * scene.control_width());
  for (int k = 0; k < num_steps; ++k) {
    for (const Vec2d& force : scene.control.initial) control.insert(control.end(), {force[0], force[1]});
    for (int t = 0; t < scene.num_torques(); ++t) {
      control.push_back(scene.control.initial_torque[t] / scene.bodies[scene.control.torque_bodies[t]].radius);
    }
  }
  return control;
}

}  // namespace saltus
