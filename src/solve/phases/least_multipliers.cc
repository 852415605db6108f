#include "solve/phases/least_multipliers.h"

#include <Eigen/SparseCholesky>
#include <cmath>
#include <vector>

namespace saltus {
namespace {

constexpr int kFewRows = 32, kManyRows = 256;  // that share a variable or a copy of one
constexpr double kDependent = 1e-7;            // of the diagonal: the pivot of a row that depends on others
constexpr double kRegularization = 1e-12;      // of the diagonal: rows may depend on each other

using SparseRows = Eigen::SparseMatrix<double, Eigen::RowMajor>;

// Returns the rows over all copies, with the rows that hold copies equal after those of `constraints`. Sets `gradient`
// to the gradient by the copies.
SparseRows SplitSharedVariables(const SparseRows& constraints, int most_rows, Eigen::VectorXd* gradient) {
  std::vector<int> rows_of(constraints.cols(), 0);
  for (Eigen::Index row = 0; row < constraints.rows(); ++row) {
    for (SparseRows::InnerIterator entry(constraints, row); entry; ++entry) ++rows_of[entry.col()];
  }
  struct Variable {
    Eigen::Index first_copy;
    double scale;
    int seen;
  };
  std::vector<Variable> variables;
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::Index columns = 0, rows = constraints.rows();
  for (const int count : rows_of) {
    const int copies = std::max(1, (count + most_rows - 1) / most_rows);
    const double scale = std::sqrt(copies);
    for (int copy = 1; copy < copies; ++copy, ++rows) {
      entries.emplace_back(rows, columns + copy - 1, scale);
      entries.emplace_back(rows, columns + copy, -scale);
    }
    variables.push_back({columns, scale, 0});
    columns += copies;
  }
  for (Eigen::Index row = 0; row < constraints.rows(); ++row) {
    for (SparseRows::InnerIterator entry(constraints, row); entry; ++entry) {
      Variable& variable = variables[entry.col()];
      entries.emplace_back(row, variable.first_copy + variable.seen++ / most_rows, variable.scale * entry.value());
    }
  }
  Eigen::VectorXd of_copies = Eigen::VectorXd::Zero(columns);
  for (Eigen::Index i = 0; i < gradient->size(); ++i) {
    of_copies[variables[i].first_copy] = variables[i].scale * (*gradient)[i];
  }
  *gradient = of_copies;
  SparseRows split(rows, columns);
  split.setFromTriplets(entries.begin(), entries.end());
  return split;
}

}  // namespace

// The factors of many small copies are sparse. Where rows depend on others, they would not be accurate.
Eigen::VectorXd LeastMultipliers(const SparseRows& constraints, const Eigen::VectorXd& gradient) {
  for (const int most_rows : {kFewRows, kManyRows}) {
    Eigen::VectorXd of_copies = gradient;
    const SparseRows rows = SplitSharedVariables(constraints, most_rows, &of_copies);
    Eigen::SparseMatrix<double> normal = rows * rows.transpose();
    for (Eigen::Index i = 0; i < normal.rows(); ++i) normal.coeffRef(i, i) *= 1 + kRegularization;
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factors(normal);
    if (factors.info() != Eigen::Success) return {};
    const Eigen::VectorXd diagonal = factors.permutationP() * normal.diagonal();
    const bool dependent = (factors.vectorD().array() < kDependent * diagonal.array()).any();
    if (dependent && most_rows == kFewRows) continue;
    const Eigen::VectorXd multipliers = -factors.solve(rows * of_copies);
    return multipliers.allFinite() ? multipliers.head(constraints.rows()) : Eigen::VectorXd();
  }
  return {};
}

Eigen::VectorXd RowsAfterStep(const SparseRows& jacobian, const Eigen::VectorXd& rows) {
  Eigen::SparseMatrix<double> normal = jacobian.transpose() * jacobian;
  for (Eigen::Index i = 0; i < normal.rows(); ++i) {
    double& own = normal.coeffRef(i, i);
    own = own > 0 ? own * (1 + kRegularization) : 1;
  }
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factors(normal);
  if (factors.info() != Eigen::Success) return Eigen::VectorXd::Constant(rows.size(), NAN);
  return rows - jacobian * factors.solve(jacobian.transpose() * rows);
}

}  // namespace saltus
