// What the solvers by step shooting share.
#pragma once

#include <ceres/iteration_callback.h>
#include <ceres/solver.h>

#include <memory>
#include <vector>

#include "control/objective_cost.h"
#include "control/step_shooting.h"
#include "saltus/control/step_cost.h"
#include "saltus/solve/solver.h"

namespace saltus {

// The costs of all steps of a simulator, which must outlive it.
std::unique_ptr<StepCost> MakeStepCost(const Simulator& simulator);

// Null if the objective has no terminal terms.
std::unique_ptr<TerminalCost> MakeTerminalCost(const Simulator& simulator);

// Levenberg-Marquardt with a sparse factorization that gives the same bits every time.
ceres::Solver::Options SparseOptions(int iterations);

// Reads the decision variables where an iteration has left the variables. To be called before those who look at them.
class ReadDecisions final : public ceres::IterationCallback {
 public:
  ReadDecisions(const StepShooting* variables, std::vector<double>* z) : variables_(variables), z_(z) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    *z_ = variables_->Decisions();
    return ceres::SOLVER_CONTINUE;
  }

 private:
  const StepShooting* variables_;
  std::vector<double>* z_;
};

}  // namespace saltus
