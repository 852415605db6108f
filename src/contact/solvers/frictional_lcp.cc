#include "contact/solvers/frictional_lcp.h"

#include <vector>

#include "base/linear_algebra.h"
#include "contact/solvers/lemke.h"

namespace saltus {
namespace {

constexpr int kPivotsPerRow = 10;

}  // namespace

// As Stewart and Trinkle 1996: unknown is of each contact its normal force, and of each that does not slide what acts
// to the left and to the right, and how fast it begins to slide.
std::optional<Eigen::VectorXd> SolveFrictionalLcp(std::span<const double> friction, const Eigen::MatrixXd& responses,
                                                  const Eigen::VectorXd& given, std::span<const int> sliding) {
  const int n = static_cast<int>(sliding.size());
  std::vector<int> resting;
  for (int k = 0; k < n; ++k) {
    if (sliding[k] == 0 && friction[k] > 0) resting.push_back(k);
  }
  const int size = n + 3 * static_cast<int>(resting.size());
  if (size > kMostComplementaryRows) return std::nullopt;
  Eigen::MatrixXd forces = Eigen::MatrixXd::Zero(2 * n, size);  // of unknowns
  for (int k = 0; k < n; ++k) {
    forces(2 * k, k) = 1;
    forces(2 * k + 1, k) = -friction[k] * sliding[k];
  }
  for (int i = 0; i < static_cast<int>(resting.size()); ++i) {
    forces(2 * resting[i] + 1, n + 3 * i) = -1;
    forces(2 * resting[i] + 1, n + 3 * i + 1) = 1;
  }
  const Eigen::MatrixXd accelerations = Multiply(responses, forces);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd constant = Eigen::VectorXd::Zero(size);
  for (int k = 0; k < n; ++k) {
    matrix.row(k) = accelerations.row(2 * k);
    constant[k] = given[2 * k];
  }
  for (int i = 0; i < static_cast<int>(resting.size()); ++i) {
    const int k = resting[i], left = n + 3 * i, right = left + 1, speed = left + 2;
    matrix.row(left) = -accelerations.row(2 * k + 1);
    matrix.row(right) = accelerations.row(2 * k + 1);
    constant[left] = -given[2 * k + 1];
    constant[right] = given[2 * k + 1];
    matrix(left, speed) = matrix(right, speed) = 1;
    matrix(speed, k) = friction[k];
    matrix(speed, left) = matrix(speed, right) = -1;
  }
  const std::optional<Eigen::VectorXd> found = SolveByLemke(matrix, constant, kPivotsPerRow * size);
  if (!found) return std::nullopt;
  return forces * *found;
}

}  // namespace saltus
