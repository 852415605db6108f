// The greatest values of functions along a flow, for inequalities that hold at all times.
#pragma once

#include <functional>
#include <memory>

#include "hybrid/runge_kutta.h"
#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// Finds the greatest values of functions along the flow of a mode, which is integrated in equal parts of a step. Before
// the end of the step the greatest value of a function is at the beginning, or where its rate falls through zero within
// a part; of several such times within one part one is found. Each value is differentiated at its time, on which it
// does not depend to first order.
class GreatestValues {
 public:
  using Matrix = RungeKutta::Matrix;
  // Computes the values of all functions at a point of a step of this length, and their derivatives by [x t p u] and by
  // the length. Returns false if they have none.
  using Functions = std::function<bool(const ModePoint& at, double length, double* values, Matrix* by)>;

  // Precondition: parts > 0. The system must outlive this object.
  GreatestValues(const HybridFunctions& system, int count, int parts, Functions functions);

  // Sets `values` to the greatest ones before the end of the step, and behind them to those at its end; unless `by` is
  // null, a row each of it to their derivatives by [x t p u h] of the step. Returns false if they are not finite.
  bool Find(const FlowStep& step, double* values, Matrix* by);

 private:
  // A time in the step: a share of a part.
  struct Place {
    int part = 0;
    double share = 0;
  };
  struct Values {
    Eigen::VectorXd value, rate;
    Matrix by;
  };

  FlowStep StepTo(const Place& place) const;
  bool Evaluate(const Place& place, Values* values);
  bool FindTop(int function, int part, Values* top, double* share);
  Matrix StateDerivative(const Place& place);

  const HybridFunctions& system_;
  const int count_, parts_;
  const Functions functions_;
  RungeKutta integrator_;
  FlowStep step_;
  std::vector<Eigen::VectorXd> states_;  // at the beginnings of the parts, and the end
  std::vector<Matrix> states_by_;        // their derivatives by [x t p u h], as far as they are known
  std::vector<Values> nodes_;            // of the functions there
};

// Returns the function of a term in a control interval that begins in a mode and has so many steps of the integration,
// with the parameter blocks of the term: that of the term; of one that holds at all times, its greatest values and then
// those at the end. The latter have rows of their own because a function that is at its bound for a while has all its
// values there: with one row, whose derivative jumps with the time of the greatest value, solvers do not converge.
std::shared_ptr<const ceres::CostFunction> FunctionIn(const HybridTerm& term, const HybridSystem& system, int mode,
                                                      int steps);

}  // namespace saltus
