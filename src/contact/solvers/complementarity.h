// Linear complementarity problems, and functions that their iterations share.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <optional>
#include <span>

namespace saltus {

// One sweep of projected Gauss-Seidel: calls relax(row) for each row in turn, which solves the row with all others held
// and returns by how much its unknown has changed. Returns the largest change.
template <typename Relax>
double GaussSeidelSweep(std::ptrdiff_t num_rows, const Relax& relax, bool backwards = false) {
  double change = 0;
  for (std::ptrdiff_t j = 0; j < num_rows; ++j) {
    change = std::max(change, relax(backwards ? num_rows - 1 - j : j));
  }
  return change;
}

// Decides how many rows change their class in a step of principal pivoting: all that violate it, while their number
// falls; after kBlockPatience steps in which it does not, only one (Judice and Pires 1994). Changes of one row by a
// fixed rule are finite for matrices with positive principal minors (Murty 1974), block steps are fast.
class BlockPivoting {
 public:
  // Whether all rows change, of which `num_wrong` violate their class.
  bool ChangesAll(std::size_t num_wrong);

 private:
  std::size_t fewest_ = std::numeric_limits<std::size_t>::max();
  int patience_ = 0;
};

// Lemke's method, dense: z >= 0 with w = M z + q >= 0 and z.w = 0. Returns std::nullopt if it does not arrive within
// `most_pivots` or ends on a ray. For the M of contacts with friction (Stewart and Trinkle 1996) a ray means that there
// is no solution, unless some contacts slide. Source: Cottle, Pang, Stone, The Linear Complementarity Problem,
// algorithm 4.4.5. Precondition: M is square, as large as q, and all numbers are finite.
std::optional<Eigen::VectorXd> SolveByLemke(const Eigen::MatrixXd& M, const Eigen::VectorXd& q, int most_pivots);

// The forces of contacts with friction as a complementarity problem (Stewart and Trinkle 1996), by Lemke's method:
// normal and tangential of one contact after the other, with
//
//   0 <= f_n  _|_  b_n >= 0,   |f_t| <= mu f_n,   b = R f + a
//
// and f_t against the sign in `sliding` or, where that is 0, against the motion that would begin. `friction` has mu of
// each contact, `responses` is R, `given` is a, of the same order as the forces. Returns std::nullopt if no forces are
// found, or if the problem has more than kMostComplementaryRows rows (thresholds.h): one for each contact, three more
// for each that does not slide.
std::optional<Eigen::VectorXd> SolveFrictionalLcp(std::span<const double> friction, const Eigen::MatrixXd& responses,
                                                  const Eigen::VectorXd& given, std::span<const int> sliding);

}  // namespace saltus
