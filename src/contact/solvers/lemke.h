// Lemke's method for linear complementarity problems, dense and small: where iterations go in circles.
#pragma once

#include <Eigen/Core>
#include <optional>

namespace saltus {

// A z >= 0 with w = M z + q >= 0 and z.w = 0, where the method finds one; it does not within `most_pivots`, or where it
// ends on a ray. For the M of contacts with friction (Stewart and Trinkle 1996) a ray means that there is none, unless
// some slide. Source: Cottle, Pang, Stone, The Linear Complementarity Problem, algorithm 4.4.5. Precondition: M is
// square, as large as q, and all is finite.
std::optional<Eigen::VectorXd> SolveByLemke(const Eigen::MatrixXd& M, const Eigen::VectorXd& q, int most_pivots);

}  // namespace saltus
