#include "contact/solvers/block_solve.h"

#include <algorithm>
#include <vector>

#include "base/linear_algebra.h"

namespace saltus {

Eigen::VectorXd SolveByBlocks(const Eigen::MatrixXd& A, const Eigen::VectorXd& b) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(A.cols());
  std::vector<char> row_done(A.rows(), 0), column_done(A.cols(), 0);
  for (Eigen::Index first = 0; first < A.cols(); ++first) {
    if (column_done[first]) continue;
    std::vector<Eigen::Index> rows, columns = {first};
    column_done[first] = 1;
    for (std::size_t k = 0; k < columns.size(); ++k) {
      for (Eigen::Index i = 0; i < A.rows(); ++i) {
        if (row_done[i] || A(i, columns[k]) == 0) continue;
        row_done[i] = 1;
        rows.push_back(i);
        for (Eigen::Index j = 0; j < A.cols(); ++j) {
          if (column_done[j] || A(i, j) == 0) continue;
          column_done[j] = 1;
          columns.push_back(j);
        }
      }
    }
    if (rows.empty()) continue;
    std::sort(rows.begin(), rows.end());
    std::sort(columns.begin(), columns.end());
    const Eigen::VectorXd part = LeastNormSolution(A(rows, columns), b(rows));
    for (std::size_t k = 0; k < columns.size(); ++k) x[columns[k]] = part[static_cast<Eigen::Index>(k)];
  }
  return x;
}

}  // namespace saltus
