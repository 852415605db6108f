#include "phase_rotations.h"

#include <ceres/manifold.h>

#include <algorithm>
#include <cmath>

#include "control/phase_costs.h"
#include "phase_functions.h"

namespace saltus {

PhaseRotations::PhaseRotations(const Scene& scene)
    : scene_(scene), initial_(scene.bodies.size(), -1), last_(initial_), since_(scene.bodies.size(), 0) {}

void PhaseRotations::Add(int body) {
  const Body& disc = scene_.bodies[body];
  if (!disc.Spins()) return;
  initial_[body] = last_[body] = static_cast<int>(rotations_.size());
  rotations_.push_back({disc.radius * disc.angle, disc.radius * disc.angular_velocity});
}

int PhaseRotations::TurnTo(int body, int time, std::span<const double> times) {
  if (last_[body] < 0 || since_[body] == time) return last_[body];  // no time has passed
  const auto [way, speed] = rotations_[last_[body]];
  turns_.push_back({last_[body], static_cast<int>(rotations_.size()), since_[body], time});
  rotations_.push_back({way + (times[time] - times[since_[body]]) * speed, speed});
  last_[body] = turns_.back().to;
  since_[body] = time;
  return last_[body];
}

int PhaseRotations::Strike(int body, double gain) {
  if (last_[body] < 0) return -1;
  const auto [way, speed] = rotations_[last_[body]];
  last_[body] = static_cast<int>(rotations_.size());
  rotations_.push_back({way, speed + scene_.bodies[body].radius * gain});
  return last_[body];
}

double PhaseRotations::SpinOf(int body) const {
  return last_[body] < 0 ? 0.0 : At(last_[body])[1] / scene_.bodies[body].radius;
}

void PhaseRotations::End(int time, std::span<const double> times) {
  for (int i = 0; i < scene_.num_bodies(); ++i) TurnTo(i, time, times);
}

bool PhaseRotations::IsFree(int body) const {
  const std::vector<int>& free = scene_.free_spin;
  return scene_.optimize == Optimize::kVelocity && std::find(free.begin(), free.end(), body) != free.end();
}

void PhaseRotations::AddTo(std::span<double> times, AugmentedLagrangian* problem) {
  for (const Turn& turn : turns_) {
    problem->Add(Sized<2, 1, 1, 2>(Turning{}),
                 {.equalities = Turning::kRows},
                 {At(turn.from), &times[turn.begin], &times[turn.end], At(turn.to)});
  }
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (!term.IsOfSpin()) continue;
    const double scale = term.hard ? 1.0 : std::sqrt(term.weight);
    problem->Add(Sized<2>(RotationTarget{term.quantity, term.target[0], scale, scene_.bodies[term.body].radius}),
                 {.equalities = term.hard ? RotationTarget::kRows : 0},
                 {At(last_[term.body])});
  }
  ceres::Problem& unknowns = problem->problem();
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (initial_[i] < 0) continue;
    double* x = At(initial_[i]);
    if (!unknowns.HasParameterBlock(x)) continue;
    if (IsFree(i)) {
      unknowns.SetManifold(x, new ceres::SubsetManifold(2, {0}));
    } else {
      unknowns.SetParameterBlockConstant(x);
    }
  }
}

void PhaseRotations::CopyInitial(std::vector<double>* initial) const {
  for (size_t i = 0; i < scene_.bodies.size(); ++i) {
    // What is held keeps every bit.
    const bool is_free = initial_[i] >= 0 && IsFree(static_cast<int>(i));
    if (is_free) (*initial)[4 * scene_.bodies.size() + kSpin * i + 1] = At(initial_[i])[1] / scene_.bodies[i].radius;
  }
}

}  // namespace saltus
