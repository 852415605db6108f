// Moves impacts along the nodes of the time grid, for runs that have stalled where the loss has a kink: see
// ceres_shooting.h.
#pragma once

#include <optional>
#include <vector>

#include "solve/shooting/path_problem.h"
#include "solve/solve_run.h"

namespace saltus {

class NodeSearch {
 public:
  // Starts at decision variables z of that loss. Precondition: forces are optimized, and the model has exact impact
  // times.
  NodeSearch(SolveRun* run, const std::vector<double>& z, double loss);

  // True if there was an impact. Each iteration of Ceres is recorded with the best loss so far; `iterations`
  // are allowed in all.
  bool Run(int iterations);

  const std::vector<double>& z() const { return z_; }
  double loss() const { return loss_; }
  bool interrupted() const { return interrupted_; }
  bool exhausted() const { return iterations_left_ <= 0; }
  int num_jacobians() const { return num_jacobians_; }
  const std::vector<Arrival>& arrivals() const { return arrivals_; }

  // The theta that balances the one-sided gradients best, and the largest component that is left, as a part of that of
  // the early one. Precondition: the search has ended with one arrival.
  struct Balance {
    double theta = 0;
    double residual = 0;
  };
  std::optional<Balance> BalanceGradients();

 private:
  // Best z with the impacts on these nodes, if that is better than what there is.
  bool TryNodes(const std::vector<Arrival>& arrivals);
  bool Move(size_t which, int direction);
  // Newton's method along the nodes, on which the loss is smooth: across them is a kink, at which steps of Ceres that
  // leave a node by rounding are refused.
  void Polish();
  // Decision variables near z with the impacts on the nodes to rounding, where Ceres leaves them nearly; z if that
  // fails.
  std::vector<double> PutOntoNodes(std::vector<double> z, const std::vector<Arrival>& arrivals);

  SolveRun* run_;
  std::vector<double> z_;
  double loss_;
  std::vector<Arrival> arrivals_;
  int iterations_left_ = 0;
  int num_jacobians_ = 0;
  bool interrupted_ = false;
};

}  // namespace saltus
