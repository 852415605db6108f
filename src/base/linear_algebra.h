// Decompositions and products of dense matrices. Eigen's templates for them are compiled once, in the files of this
// folder, and not in every file that solves a linear system.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <optional>
#include <span>
#include <variant>

namespace saltus {

// Reads matrices and vectors of any storage, blocks included, without a copy.
using ConstMatrixRef = Eigen::Ref<const Eigen::MatrixXd>;
using ConstVectorRef = Eigen::Ref<const Eigen::VectorXd>;
using MatrixRef = Eigen::Ref<Eigen::MatrixXd>;
using VectorRef = Eigen::Ref<Eigen::VectorXd>;

// ---------------------------------------------------------------------------------------------------------------------
// Complete orthogonal decomposition: least squares solutions of least norm. Pivots below `threshold` times the largest
// one count as zero; without a threshold, those that are no more than rounding. Matrices of up to kMostSmallRows rows
// and columns take no memory from the heap (but a little if their rank is not full).
inline constexpr int kMostSmallRows = 16;

class LeastNormSolver {
 public:
  explicit LeastNormSolver(const ConstMatrixRef& matrix, std::optional<double> threshold = {});
  // `solution` may be `right`.
  void Solve(const ConstVectorRef& right, VectorRef solution) const;

 private:
  using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostSmallRows, kMostSmallRows>;
  std::variant<Eigen::CompleteOrthogonalDecomposition<Small>, Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd>>
      decomposition_;
};

Eigen::VectorXd LeastNormSolution(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);
// Returns the solution of least norm for each column of `right`.
Eigen::MatrixXd LeastNormSolutions(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right);

// Sets `inverse`, a matrix of the size of the square `matrix`, to its Moore-Penrose pseudo-inverse.
void PseudoInvert(const ConstMatrixRef& matrix, std::optional<double> threshold, MatrixRef inverse);
Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& matrix);
Eigen::MatrixXf PseudoInverse(const Eigen::MatrixXf& matrix);
// Overwrites an n x n matrix, stored by rows, with its pseudo-inverse.
void PseudoInvertRows(int n, std::span<double> matrix, double threshold);

// Returns M_11 - M_12 M_22^+ M_21 of a symmetric information matrix M, whose block M_11 belongs to the first `count`
// parameters: the information on these when the other parameters are unknown too.
Eigen::MatrixXd SchurComplement(const Eigen::MatrixXd& information, Eigen::Index count);

// ---------------------------------------------------------------------------------------------------------------------
// Square systems.

// Solves by Gauss elimination with partial pivoting.
Eigen::VectorXd SolveLu(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);
// Solves by the same elimination for each column of `right`.
Eigen::MatrixXd SolveLuColumns(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right);
// Solves by Gauss elimination with full pivoting, for matrices that may be nearly singular.
Eigen::VectorXd SolveFullPivotLu(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);
// Solves by the Cholesky decomposition. Returns std::nullopt if the matrix is not positive definite.
std::optional<Eigen::VectorXd> SolveCholesky(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);
// Solves without heap memory: overwrites the matrix with its Cholesky factor and `right` with the solutions.
void SolveCholeskyInPlace(MatrixRef matrix, MatrixRef right);

// The Cholesky decomposition L L^T of a symmetric n x n matrix, for several right-hand sides. Precondition of all
// members but ok(): ok().
class CholeskySolver {
 public:
  explicit CholeskySolver(const Eigen::MatrixXd& matrix);
  // Returns false if the matrix is not positive definite.
  bool ok() const { return factor_.info() == Eigen::Success; }
  // Returns the solution for each column of `right`.
  Eigen::MatrixXd Solve(const Eigen::MatrixXd& right) const;
  // Returns L^{-1} right.
  Eigen::VectorXd SolveLower(const Eigen::VectorXd& right) const;
  // Returns the natural logarithm of the determinant of the matrix.
  double LogDeterminant() const;

 private:
  Eigen::LLT<Eigen::MatrixXd> factor_;
};

// Solves by the decomposition L D L^T, for symmetric matrices that are semidefinite.
Eigen::VectorXd SolveLdlt(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);

// ---------------------------------------------------------------------------------------------------------------------
// Least squares, null spaces, eigenvalues.

// The least squares solution, for matrices of full rank, by a QR decomposition with column pivoting.
Eigen::VectorXd LeastSquaresSolution(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);

// An orthonormal basis of the vectors that all rows of a matrix are orthogonal to: of all, if it has no rows.
Eigen::MatrixXd NullSpace(const Eigen::MatrixXd& rows);

// Eigenvalues of a symmetric matrix in rising order, and its eigenvectors, of length 1, as columns in the same order. A
// matrix without rows has none.
struct SymmetricEigen {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
SymmetricEigen EigenOf(const Eigen::MatrixXd& symmetric);

// ---------------------------------------------------------------------------------------------------------------------
// Products of matrices of which each is large or of unknown size.

Eigen::MatrixXd Multiply(const ConstMatrixRef& a, const ConstMatrixRef& b);
// Returns a^T b.
Eigen::MatrixXd MultiplyTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b);
// Returns a b^T.
Eigen::MatrixXd MultiplyByTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b);
// These products use no heap memory. `product` has the size of the product and is none of the factors.
void Multiply(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product);
void MultiplyTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product);
void MultiplyByTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product);
// sum += a b.
void AddProduct(const ConstMatrixRef& a, const ConstMatrixRef& b, Eigen::MatrixXd* sum);
// sum += weight a^T a.
void AddGram(double weight, const Eigen::MatrixXd& a, Eigen::MatrixXd* sum);

}  // namespace saltus
