// The closed form of a flow that is affine with constant coefficients in the state and all that it reads:
//
//   f = xdot = A x + b t + C p + B u + d
//
// Its slope satisfies fdot = A f + b, so that a step of length h leads to x + Psi f with Psi = sum h^k A^(k-1) / k!
// (b = 0; otherwise the time is one more state), and its derivatives are I + A Psi by x and Psi C, Psi B by p and u.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "saltus/internal/runge_kutta_step.h"

namespace saltus {

class LinearFlow {
 public:
  static constexpr int kMostStates = 64;
  // A derivative of the flow by a number of [x t p u], which is the same everywhere.
  struct Entry {
    int row, column;
    double value;
  };

  // `columns`: the size of [x t p u]. Precondition: 0 < n <= kMostStates; `entries` are finite, one for each place.
  LinearFlow(int n, int columns, const std::vector<Entry>& entries);

  // Computes the state after a step from x, at which the flow is `slope`. `after` and x may be the same.
  void Step(double h, const double* x, const double* slope, double* after) const;
  // Computes its derivative by [x t p u]: n x columns, row-major.
  void Jacobian(double h, double* jacobian) const;
  // Adds to *out what a cotangent of the state after a step is by p and u, and sets out->x and out->t. `after` and
  // out->x may be the same.
  void PullBack(double h, const double* after, int num_parameters, StepCotangent* out) const;

 private:
  using Matrix = Eigen::MatrixXd;
  struct Plan {
    double parts;
    int terms;
  };
  // A or its transpose, with the terms A^(k-1) / k!, k > 1, of Psi if a power of A is zero.
  struct Series {
    std::vector<Entry> matrix;
    std::vector<std::vector<Entry>> terms;
  };
  Plan PlanOf(double h) const;
  Matrix Psi(double h) const;
  void Sweep(const Series& series, double h, double* slope, double* sum) const;

  int n_, columns_;
  int size_;                 // of A: with the time if the flow depends on it
  Series along_, back_;      // A and its transpose
  std::vector<Entry> rest_;  // the derivatives by p and u
  int nilpotent_ = 0;        // the power of A that is zero; 0: none
  double norm_ = 0;          // of A, balanced
};

}  // namespace saltus
