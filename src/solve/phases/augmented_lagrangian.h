// Constrained nonlinear least squares on Ceres, which does not support constraints:
//
//   minimize sum |f(x)|^2 + sum v(x)   subject to   c(x) = 0,  d(x) <= 0
//
// by an augmented Lagrangian whose residuals stay least squares. With a weight w and a multiplier l for each row,
//
//   equality     sqrt(w) (c + l / w),          after each solve  l += w c
//   inequality   sqrt(w) max(0, d + l / w),    after each solve  l = max(0, l + w d)
//   value        v - v' + 1/2,                 after each solve  v' = v
//
// The square of the last has the derivative of v at v = v'. w grows tenfold from solve to solve. At the end 2 l is the
// multiplier of the Lagrangian sum |f|^2 + ....
//
// Rows are expected to be of order one: variables and functions without units (e.g. Nocedal, Wright, "Numerical
// Optimization", chapter 17).
#pragma once

#include <ceres/cost_function.h>
#include <ceres/problem.h>

#include <cmath>
#include <functional>
#include <memory>
#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

// The roles of the rows of a function, in this order: equalities, inequalities, costs that are values, and then costs
// that are squares of rows.
struct RowRoles {
  int equalities = 0;
  int inequalities = 0;
  int values = 0;
  // The last parameter blocks, of this number, enter by affine terms that no other block multiplies.
  int affine_blocks = 0;
  // Each row is an inequality of one component, in which it is affine.
  bool are_bounds = false;
  // The rows are curved inequalities of one parameter block. Their curvature, times their multipliers, counts in steps,
  // along directions in which it is positive: steps without it are too long, as along the border of a disc.
  bool are_curved = false;
  // The inequalities have the weight of equalities from the first solve on: without them it would be of another motion.
  bool are_goals = false;
};

// A function of parameter blocks, with the roles of its rows.
struct ConstrainedFunction {
  const ceres::CostFunction* function = nullptr;
  RowRoles roles;
  std::vector<double*> blocks;
};

class AugmentedLagrangian {
 public:
  enum class Algorithm { kLeastSquares, kInteriorPoint };
  struct Options {
    // kInteriorPoint solves the problem by interior_point.h, which reads `iterations`, `tolerance`, `callback`,
    // `stop` and `is_shooting` alone.
    Algorithm algorithm = Algorithm::kLeastSquares;
    // Whether states are eliminated. Slopes of rows are then those of whole motions.
    bool is_shooting = false;
    int iterations = 200;                                    // of all solves together, at most
    int rounds = 24;                                         // solves, at most
    double equality_weight = 1e4, inequality_weight = 1e-2;  // of the first solve
    // The weight of equalities in the first solve relative to the costs that lie ahead; 0: equality_weight is it.
    double weight_of_costs = 0;
    double tolerance = 1e-9;  // largest violation of a row
    double radius = 1e8;      // of the trust region at first, after the first solve
    // The relative change of the cost that ends the third solve and later ones, which leaves conditions of first order
    // open by its root.
    double gain = 3e-14;
    // If the last solve changes a multiplier by more than this part of the largest, the multipliers that leave least of
    // the gradient take their place, for one more solve.
    double change_of_multipliers = INFINITY;
    // If the first solve leaves a row open by more than this, or gains nothing, it is repeated from the start, with
    // those multipliers of equalities in the place of zero that leave least of the gradient there: costates, if the
    // start meets the equalities.
    double most_open = INFINITY;
    // Whether the start is one of many. It is then given up where constraints stay far from met, and solves before they
    // are nearly met are not accurate.
    bool one_of_many = false;
    // A minimum of the augmented Lagrangian above this ends the solve: no optimum near by has lower costs.
    double most_cost = INFINITY;
    // Called after each iteration with the costs; false interrupts.
    std::function<bool(double cost)> callback = nullptr;
    // Asked while derivatives are evaluated, of which many steps have many; true interrupts.
    std::function<bool()> stop = nullptr;
    std::function<void()> after_round = nullptr;  // called after each solve

    // For phases of up to so many steps. Along a longer one open defects add up and weigh more, and damping, whose part
    // in a motion of the whole phase grows with its square, would take more iterations.
    void ScaleTo(int steps);
  };
  struct Summary {
    bool usable = false;     // no solve failed
    bool converged = false;  // no row is violated by more than the tolerance, and the last solve gained nothing more
    bool interrupted = false;
    double cost = 0;       // squares and values together
    double violation = 0;  // largest of a row
    int iterations = 0, jacobians = 0;
  };

  AugmentedLagrangian();
  ~AugmentedLagrangian();

  // Adds a function of parameter blocks that outlive this object.
  void Add(std::unique_ptr<ceres::CostFunction> function, const RowRoles& roles, const std::vector<double*>& blocks);
  // For constant blocks and bounds.
  ceres::Problem& problem() { return problem_; }
  const ceres::Problem& problem() const { return problem_; }

  // Minimises from the present parameter blocks, and leaves them at the best point.
  Summary Minimize(const Options& options);

 private:
  class Weighted;
  struct Weights {
    double equality = 0, inequality = 0;
  };

  Summary MinimizeLeastSquares(const Options& options);
  std::vector<ConstrainedFunction> Functions() const;
  bool EstimateMultipliers(bool clips);
  void WeighByCosts(double factor);
  double Cost() const;
  double LargestWeight() const;
  double UpdateMultipliers(double* cost, double* lagrangian, double* change);
  double LargestMultiplier() const;
  std::vector<double> Values() const;
  void SetValues(const std::vector<double>& values);

  Weights weights_;
  ceres::Problem problem_;
  std::vector<std::pair<Weighted*, std::vector<double*>>> functions_;
};

// Returns how a solver that was allowed so many iterations has ended.
Termination TerminationOf(const AugmentedLagrangian::Summary& summary, int iterations);

}  // namespace saltus
