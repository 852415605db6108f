#include "solve/phases/phase_rotations.h"

#include <ceres/manifold.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "control/model_step.h"
#include "control/phase_costs.h"
#include "solve/phases/phase_functions.h"

namespace saltus {

PhaseRotations::PhaseRotations(const Scene& scene, const Simulator* flight)
    : scene_(scene),
      flight_(flight),
      step_nodes_(scene.bodies.size()),
      initial_(scene.bodies.size(), -1),
      last_(initial_),
      since_(scene.bodies.size(), 0) {}

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

double PhaseRotations::InverseMass(int body) const {
  const Body& disc = scene_.bodies[body];
  return disc.radius * disc.radius / disc.MomentOfInertia();
}

void PhaseRotations::TurnUnder(int body, const Span& span, const Torques& torques, std::span<const double> turns,
                               std::span<const double> times) {
  const double h = span.steps == 0 ? 0.0 : (times[span.end] - times[span.begin]) / span.steps;
  for (int k = 0; k < span.steps; ++k) {
    const int torque = torques.first + k * torques.stride;
    const auto [way, speed] = rotations_[last_[body]];
    const double a = InverseMass(body) * turns[torque];
    std::array<double, 2> next = {way + h * (speed + 0.5 * h * a), speed + h * a};
    if (flight_ != nullptr) {
      const StepLinearization::FreeFlight by = flight_->FreeFlightOver(h).value().turn;
      next = {by.pp * way + by.pv * speed + by.pa * a, by.vp * way + by.vv * speed + by.va * a};
    }
    steps_.push_back({body, last_[body], static_cast<int>(rotations_.size()), span, k, torque});
    rotations_.push_back(next);
    step_nodes_[body].push_back(last_[body]);
    last_[body] = steps_.back().to;
  }
  since_[body] = span.end;
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

void PhaseRotations::AddTo(std::span<double> times, std::span<double> turns, double least,
                           AugmentedLagrangian* problem) {
  const Coordinates<double, 1> no_gravity(0.0);
  for (const Step& step : steps_) {
    const std::vector<double*> blocks = {
        At(step.from), &turns[step.torque], &times[step.span.begin], &times[step.span.end], At(step.to)};
    const StepOfPhase place{step.index, step.span.steps};
    const double inverse_mass = InverseMass(step.body), effort = scene_.objective.effort;
    std::unique_ptr<ceres::CostFunction> cost;
    if (flight_ != nullptr) {
      cost = std::make_unique<ModelStep<1>>(*flight_, place, Push{inverse_mass, effort, least});
    } else {
      cost = Sized<2, 1, 1, 1, 2>(PushedStep<1>{place, no_gravity, inverse_mass, effort, least});
    }
    problem->Add(std::move(cost), {.equalities = PushedStep<1>::kEqualities}, blocks);
  }
  for (const Turn& turn : turns_) {
    problem->Add(Sized<2, 1, 1, 2>(CoastingStep<1>{{}, no_gravity}),
                 {.equalities = CoastingStep<1>::kRows},
                 {At(turn.from), &times[turn.begin], &times[turn.end], At(turn.to)});
  }
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (!term.IsOfSpin()) continue;
    const double radius = scene_.bodies[term.body].radius;
    double* last = At(last_[term.body]);
    if (term.hard) {
      const GoalRows goal{term.quantity, term.Goal(), radius};
      const RowRoles roles{
          .equalities = goal.num_equalities(), .inequalities = goal.num_inequalities(), .are_goals = true};
      problem->Add(Dynamic(goal, roles.equalities + roles.inequalities, std::array{int{kSpin}}), roles, {last});
    } else {
      problem->Add(Sized<2>(Target<1>{term.quantity, term.target, std::sqrt(term.weight), radius}), {}, {last});
    }
  }
  ceres::Problem& unknowns = problem->problem();
  for (double& turn : turns) {
    if (scene_.optimize != Optimize::kControl) unknowns.SetParameterBlockConstant(&turn);
  }
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
    // A rotation that is held keeps every bit.
    const bool is_free = initial_[i] >= 0 && IsFree(static_cast<int>(i));
    if (is_free) (*initial)[4 * scene_.bodies.size() + kSpin * i + 1] = At(initial_[i])[1] / scene_.bodies[i].radius;
  }
}

}  // namespace saltus
