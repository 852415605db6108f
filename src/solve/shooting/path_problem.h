// Step shooting along a feasible path: a problem of Ceres whose variables are states and forces, and whose costs are
// evaluated not where Ceres believes the states to be, but where a rollout of the forces brings them.
//
// All defects c_k = x_{k+1} - f(x_k, u_k) are then zero at every iterate, and what a step promises is compared with
// what its rollout keeps. A step minimizes the linearized terminal and effort terms plus those of the Lagrangian,
//
//   sum_k |w c_k + y_k / w|^2,   y_{K-1} = -r_x^T r(x_K),   y_{k-1} = (df_k/dx)^T y_k,
//
// with the costates y of the path, so that it vanishes exactly where the gradient of the loss does, and the gradient
// that Ceres computes is that of the loss by the forces.
//
// Impacts can be held on nodes of the time grid: the gap that free flight would leave at the node, from two nodes
// before, is one more residual, of weight w.
#pragma once

#include <ceres/iteration_callback.h>
#include <ceres/solver.h>

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <vector>

#include "saltus/control/single_shooting.h"

namespace saltus {

// An impact that is to happen on a node of the time grid, 2 <= node <= K.
struct Arrival {
  int node = 0;
  Candidate candidate;
};

class PathProblem {
 public:
  // Starts at the decision variables z, where the last rollout of `shooting` has been; it must outlive the object.
  // Precondition: the model has exact free flight and impact times, and forces are optimized, if there are arrivals.
  PathProblem(SingleShooting* shooting, const std::vector<double>& z, std::vector<Arrival> arrivals = {});
  ~PathProblem();

  // Levenberg-Marquardt. Callbacks find the decision variables of the iterate in z().
  ceres::Solver::Summary Minimize(int iterations, double function_tolerance,
                                  const std::vector<ceres::IterationCallback*>& callbacks);

  const std::vector<double>& z() const { return z_; }
  // Returns the loss of the last rollout.
  double loss() const;

  struct LinearGaps {
    Eigen::VectorXd values;    // the gap at each arrival, m
    Eigen::MatrixXd jacobian;  // by the forces, m / N: a row for each arrival
  };
  // Linearizes the gaps at z(). Precondition: Minimize was called. Returns std::nullopt if the last rollout or its
  // Jacobians are not finite, or if an interrupt has left them out.
  std::optional<LinearGaps> LinearizeGaps() const;

 private:
  struct Parts;
  std::vector<double> z_;
  std::unique_ptr<Parts> parts_;
};

}  // namespace saltus
