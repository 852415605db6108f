// Step shooting: the states between steps are variables too, and each step of the simulator is a cost of its own.
//
//   variables   states x_0 .. x_K and forces u_0 .. u_{K-1} of K steps
//   defects     c_k = x_{k+1} - f(x_k, u_k), to be closed: zero of all of them is one rollout
//   residuals   those of the terminal terms at x_K, and sqrt(effort dt) u_k
//
// The objective is a set of cost functions: sums of squares whose halves Ceres minimizes, so that the loss is twice the
// cost. Ceres has no equality constraints: solvers decide how the defects are closed, and add the costs for it
// (StepCost, step_cost.h).
#pragma once

#include <ceres/cost_function.h>
#include <ceres/problem.h>

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/control/step_cost.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The cost of the terminal terms. Parameter block: the final state, B * body_size numbers.
class TerminalCost final : public ceres::CostFunction {
 public:
  // Precondition: objective.IsSumOfSquares() and there is at least one term.
  TerminalCost(const Objective& objective, int num_bodies, int body_size);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  Objective objective_;
  int body_size_;
  Eigen::MatrixXd jacobian_;
};

// The residual scale * u, for the effort. Parameter block: u, `size` numbers.
class EffortCost final : public ceres::CostFunction {
 public:
  EffortCost(double scale, int size);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  double scale_;
};

class StepShooting {
 public:
  // States and forces are those of the last rollout of `shooting`, which was at the decision variables z and must
  // outlive the object. The objective must be a sum of squares.
  StepShooting(const SingleShooting* shooting, std::span<const double> z);

  const SingleShooting& shooting() const { return *shooting_; }
  const Simulator& simulator() const { return shooting_->simulator(); }
  int num_steps() const { return simulator().num_steps(); }
  int state_size() const { return simulator().state_size(); }

  double* State(int k) { return &states_[static_cast<size_t>(k) * state_size()]; }
  // Returns the parameter blocks of a StepCost of step k.
  std::vector<double*> StepBlocks(int k);

  // Returns the decision variables of single shooting among the variables.
  std::vector<double> Decisions() const;

  // Hands over the effort of each step with its forces; none if these are given.
  void AddEffort(const std::function<void(std::unique_ptr<ceres::CostFunction> cost, double* forces)>& add);

  // Holds constant what is not to be optimized. Precondition: all steps have been added to the problem.
  void HoldConstants(ceres::Problem* problem);

 private:
  const SingleShooting* shooting_;
  std::vector<double> states_;         // (K + 1) x state size
  std::vector<double> control_;        // K x C x 2
  std::vector<int> decision_indices_;  // indices in x_0 of the decision variables, unless these are forces
};

// Makes the cost of any step of a simulator, which must outlive it.
std::unique_ptr<StepCost> MakeStepCost(const Simulator& simulator);

// Makes the cost of the terminal terms; null if the objective has none.
std::unique_ptr<TerminalCost> MakeTerminalCost(const Simulator& simulator);

// Returns the states of the simulator's last rollout, (K + 1) x state size.
std::vector<double> StatesOf(const Simulator& simulator);

// Returns the largest component of the defect of each step, in the scene's units of length or speed. `states` is
// (K + 1) x state size.
std::vector<double> LargestDefects(const Simulator& simulator, std::span<const double> states,
                                   std::span<const double> control);

}  // namespace saltus
