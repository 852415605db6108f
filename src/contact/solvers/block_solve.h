// Least squares by independent blocks: contacts that share no disc have separate systems, so the bits of each solution
// do not depend on the other blocks.
#pragma once

#include <Eigen/Core>

namespace saltus {

// Returns the x of least norm that minimises |A x - b|, by blocks of rows and columns that nonzero entries connect.
Eigen::VectorXd SolveByBlocks(const Eigen::MatrixXd& A, const Eigen::VectorXd& b);

}  // namespace saltus
