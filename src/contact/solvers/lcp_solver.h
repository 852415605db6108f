// Linear complementarity problems whose bounds follow other unknowns, as contacts with friction pose them.
//
// Find x and w = Lambda x - b such that in each row
//
//   normal row:                          x >= 0, w >= 0, x w = 0
//   tangent row with the normal row n:   |x| <= mu x_n;  w = 0 strictly inside,  w >= 0 at -mu x_n,  w <= 0 at +mu x_n
//
// Source: NimblePhysics 0.7.2, BoxedLcpConstraintSolver, LCPUtils, ConstrainedGroupGradientMatrices.
//
// Problems with a bound on their rows, known when compiling, are solved without memory from the heap (unless contacts
// are redundant, where Eigen takes some).
#pragma once

#include <Eigen/Core>
#include <type_traits>
#include <vector>

#include "base/bounded_vector.h"

namespace saltus {

// Matrices and lists of a problem of up to kMaxRows rows; of any number with Eigen::Dynamic.
template <int kMaxRows>
using LcpMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxRows, kMaxRows>;
template <int kMaxRows>
using LcpVector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kMaxRows, 1>;
template <typename T, int kMaxRows>
using LcpList = std::conditional_t<kMaxRows == Eigen::Dynamic, std::vector<T>, BoundedVector<T, kMaxRows>>;

template <int kMaxRows>
struct BoxedLcpUpTo {
  LcpMatrix<kMaxRows> matrix;     // Lambda, symmetric positive semidefinite
  LcpVector<kMaxRows> rhs;        // b
  LcpList<int, kMaxRows> normal;  // of each row: its normal row; of a normal row itself
  LcpVector<kMaxRows> friction;   // mu >= 0, of the contact of each row

  int size() const { return static_cast<int>(normal.size()); }
  bool IsNormal(int row) const { return normal[row] == row; }
};
using BoxedLcp = BoxedLcpUpTo<Eigen::Dynamic>;

enum class LcpClass {
  kFree,        // x = 0
  kClamping,    // w = 0
  kUpperBound,  // x = mu x_n
  kLowerBound,  // x = -mu x_n
};

// With C the clamping rows, Q is Lambda restricted to them, where rows at a bound count as +-mu times their normal:
// the impulses solve Q x_C = b_C.
template <int kMaxRows>
struct LcpSolutionUpTo {
  LcpVector<kMaxRows> x;
  LcpList<LcpClass, kMaxRows> classes;
  LcpList<int, kMaxRows> clamping;  // C, ascending
  LcpMatrix<kMaxRows> inverse;      // Q^+
  double regularization = 0;        // added to the diagonal of Lambda; 0 unless the problem has no solution
  bool fits = true;                 // false if not even the last resort gave impulses that solve their problem
};
using LcpSolution = LcpSolutionUpTo<Eigen::Dynamic>;

// The bound for which SolveBoxedLcp is instantiated, besides Eigen::Dynamic.
inline constexpr int kFewLcpRows = 8;

// Solves as the source does: classes are found by principal pivoting; the impulses are classified (below 1e-6 they are
// zero, within 1e-5 of a bound they are at it) and solved for again in their classes by the minimum-norm Q^+ b, which
// is kept if it fits to 1e-5. A problem without a solution that fits to 1e-5 gets 1e-4 on its diagonal, and if that
// does not help, loses its friction. Always returns; `fits` is false if the last resort has failed too.
template <int kMaxRows>
LcpSolutionUpTo<kMaxRows> SolveBoxedLcp(const BoxedLcpUpTo<kMaxRows>& problem);
extern template LcpSolution SolveBoxedLcp(const BoxedLcp& problem);
extern template LcpSolutionUpTo<kFewLcpRows> SolveBoxedLcp(const BoxedLcpUpTo<kFewLcpRows>& problem);

// Solves in the given classes, whatever the forces are: impulses Q^+ b if they fit to 1e-5, else those of `solution` in
// the clamping rows. Regularized where `solution` is.
LcpSolution SolveBoxedLcpInClasses(const BoxedLcp& problem, const std::vector<LcpClass>& classes,
                                   const LcpSolution& solution);

// Returns the largest violation of the conditions above by x; bounds count as reached within `at_bound`.
double LcpViolation(const BoxedLcp& problem, const Eigen::VectorXd& x, double at_bound);

}  // namespace saltus
