// Least squares of what belongs together: contacts that share no disc have systems of their own, and the bits of each
// do not depend on the others.
#pragma once

#include <Eigen/Core>

namespace saltus {

// Of all x that minimise |A x - b| the shortest, for each block of rows and columns that entries other than 0 connect.
Eigen::VectorXd SolveByBlocks(const Eigen::MatrixXd& A, const Eigen::VectorXd& b);

}  // namespace saltus
