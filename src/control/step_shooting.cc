#include "control/step_shooting.h"

#include <ceres/manifold.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>

namespace saltus {

StepShooting::StepShooting(const SingleShooting* shooting, std::span<const double> z)
    : shooting_(shooting), states_(StatesOf(shooting->simulator())), control_(shooting->ControlAt(z)) {
  const Scene& scene = shooting->scene();
  if (scene.optimize != Optimize::kVelocity && scene.optimize != Optimize::kPosition) return;
  const int offset = scene.optimize == Optimize::kVelocity ? 2 : 0;
  for (int body : scene.free) {
    for (int j = 0; j < 2; ++j) decision_indices_.push_back(body * simulator().body_size() + offset + j);
  }
  for (int body : scene.free_spin) decision_indices_.push_back(body * simulator().body_size() + 5);
}

std::vector<double*> StepShooting::StepBlocks(int k) {
  const int forces = simulator().control_width();
  if (forces == 0) return {State(k), State(k + 1)};
  return {State(k), &control_[static_cast<size_t>(k) * forces], State(k + 1)};
}

std::vector<double> StepShooting::Decisions() const {
  if (shooting_->scene().optimize == Optimize::kControl) return control_;
  std::vector<double> z;
  for (int index : decision_indices_) z.push_back(states_[index]);
  return z;
}

void StepShooting::AddEffort(const std::function<void(std::unique_ptr<ceres::CostFunction>, double*)>& add) {
  const Scene& scene = shooting_->scene();
  if (scene.optimize != Optimize::kControl || scene.objective.effort == 0) return;
  const double scale = std::sqrt(scene.objective.effort * simulator().step());
  const int forces = simulator().control_width();
  for (int k = 0; k < num_steps(); ++k) {
    add(std::make_unique<EffortCost>(scale, forces), StepBlocks(k)[1]);
  }
}

void StepShooting::HoldConstants(ceres::Problem* problem) {
  if (shooting_->scene().optimize == Optimize::kControl) {
    problem->SetParameterBlockConstant(State(0));
    return;
  }
  std::vector<int> held;
  for (int i = 0; i < state_size(); ++i) {
    if (std::find(decision_indices_.begin(), decision_indices_.end(), i) == decision_indices_.end()) held.push_back(i);
  }
  problem->SetManifold(State(0), new ceres::SubsetManifold(state_size(), held));
  if (simulator().num_controlled() == 0) return;
  for (int k = 0; k < num_steps(); ++k) problem->SetParameterBlockConstant(StepBlocks(k)[1]);
}

std::unique_ptr<StepCost> MakeStepCost(const Simulator& simulator) {
  return std::make_unique<StepCost>(std::shared_ptr<const Simulator>(std::shared_ptr<void>(), &simulator));
}

std::unique_ptr<TerminalCost> MakeTerminalCost(const Simulator& simulator) {
  const Objective& objective = simulator.scene().objective;
  if (objective.terminal.empty()) return nullptr;
  return std::make_unique<TerminalCost>(objective, simulator.num_bodies(), simulator.body_size());
}

std::vector<double> StatesOf(const Simulator& simulator) {
  const size_t size = simulator.state_size();
  std::vector<double> states((simulator.num_steps() + 1) * size);
  for (int k = 0; k <= simulator.num_steps(); ++k) simulator.GetState(k, {&states[k * size], size});
  return states;
}

std::vector<double> LargestDefects(const Simulator& simulator, std::span<const double> states,
                                   std::span<const double> control) {
  const size_t size = simulator.state_size();
  CHECK_EQ(states.size(), (simulator.num_steps() + 1) * size);
  std::vector<double> force(simulator.force_size()), next(size), largest(simulator.num_steps());
  for (int k = 0; k < simulator.num_steps(); ++k) {
    simulator.ExpandForce(control, k, force);
    simulator.Step(states.subspan(k * size, size), force, next);
    for (size_t i = 0; i < size; ++i) {
      const double defect = std::abs(states[(k + 1) * size + i] - next[i]);
      if (!(defect <= largest[k])) largest[k] = defect;  // so that one that is not a number is seen
    }
  }
  return largest;
}

}  // namespace saltus
