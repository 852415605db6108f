// Multipliers that leave least of a gradient g along the rows of constraints J:
//
//   minimize |g + J^T l|   over l,        J J^T l = -J g
//
// A variable that all steps of a phase share, as its length, would fill J J^T, and its factors would take cubic time.
// It is split into K copies, one for some rows each, that further rows hold equal. With the multipliers m of these,
//
//   sum_k K (g_k + J_k^T l + m_k - m_(k-1))^2,   sum_k g_k = g,   m_0 = m_K = 0
//
// is least over m where all terms are equal, and then is (g + J^T l)^2 of the one variable. The factors of the larger
// system take time linear in the steps.
#pragma once

#include <Eigen/SparseCore>

namespace saltus {

// Returns one multiplier for each row of `constraints`, or an empty vector if the equations cannot be solved. Rows of
// neighbouring steps are expected to be neighbours.
Eigen::VectorXd LeastMultipliers(const Eigen::SparseMatrix<double, Eigen::RowMajor>& constraints,
                                 const Eigen::VectorXd& gradient);

// Returns the rows that the Gauss-Newton step from `rows` leaves, as their Jacobian has them; numbers that are not
// finite if the normal equations cannot be solved.
Eigen::VectorXd RowsAfterStep(const Eigen::SparseMatrix<double, Eigen::RowMajor>& jacobian,
                              const Eigen::VectorXd& rows);

}  // namespace saltus
