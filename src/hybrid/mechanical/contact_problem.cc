#include "hybrid/mechanical/contact_problem.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "contact/solvers/complementarity.h"
#include "contact/thresholds.h"

namespace saltus {
namespace {

constexpr double kRedundant = 1e-10;  // pivots of rows that depend on others, of the largest
constexpr double kAtLimit = 1e-12;    // of forces: the distance to a limit that is none
constexpr double kOfLargest = 1e-16;  // of the largest force: forces that are zero, as those of bodies at rest
constexpr double kTolerance = 1e-10;  // of accelerations that are zero, of the largest term
constexpr double kOfTerms = 1e-14;    // rounding errors of what is given, of its terms
constexpr double kDiffers = 1e-7;     // accelerations of two solutions, of the largest term
// Tolerances for zero accelerations in a solution that a search finds: the first that gives one with the conditions
// counts. The smallest are those of bodies that part little, beside others that press.
constexpr std::array kStands = {1e-10, 1e-8, 1e-6, 1e-12, 1e-14};
constexpr int kMostSweeps = 10000;     // of projected Gauss-Seidel
constexpr double kRelaxed = 1e-14;     // of forces: their change in the last one
constexpr double kCoupled = 1e-12;     // |matrix_ij| / sqrt(matrix_ii matrix_jj) that is not rounding
constexpr double kMovesNothing = 0.5;  // eigenvalues of a projection are 0 or 1
constexpr double kPivot = 1e-9;        // pivots of a basis that are zero, of the largest
constexpr double kShare = 1e-11;       // shares of the sum of a basis, which is 1, that are zero
constexpr int kLargeBlock = 32;        // forces: more are solved for without those that move nothing between two bodies
constexpr double kOfStress = 1e-9;     // of a stress of length 1: a force that has a part in it
constexpr int kMostExchanges = 32;     // of rows of a basis, until its inverse is computed anew
constexpr double kDrift = 1e4;         // of rounding errors of a new inverse: those of one that has been changed

double FloorOf(const ContactProblem& problem, int contact) {
  return problem.floor.empty() ? 0.0 : problem.floor[contact];
}

Eigen::VectorXd TermsOf(const ContactProblem& problem) {
  return problem.terms.size() > 0 ? problem.terms : Eigen::VectorXd(problem.given.cwiseAbs());
}

bool HasStick(const ContactProblem& problem, int contact) {
  return problem.has_friction[contact] && problem.friction[contact] > 0;
}

// The forces if the contacts have a status, whether or not they satisfy the inequalities.
struct TriedForces {
  Eigen::VectorXd force, tolerance;  // of each contact, normal and tangential in turn
  bool stressed = false;             // the forces of least norm are past a limit
};

double SmallestLimit(const ForceLimits& limits, const Eigen::VectorXd& force) {
  return limits.rows.rows() == 0 ? 0.0 : (limits.rows * force + limits.constants).minCoeff();
}

// Returns the forces of contacts with this status, std::nullopt if there are none.
std::optional<TriedForces> ForcesOf(const ContactProblem& problem, const std::string& status) {
  const int k = problem.size();
  // Unknowns are normal forces of closed contacts and tangential ones of those that stick, with a row that vanishes
  // each.
  std::vector<int> rows;
  std::vector<UnknownForces> unknown;
  Eigen::MatrixXd span = Eigen::MatrixXd::Zero(2 * k, 2 * k);
  TriedForces tried{.force = Eigen::VectorXd::Zero(2 * k), .tolerance = Eigen::VectorXd::Zero(2 * k)};
  Eigen::VectorXd& fixed = tried.force;
  for (int i = 0; i < k; ++i) {
    const char is = status[i];
    const double slip = -problem.friction[i] * TangentSign(is);
    UnknownForces of{.friction = problem.friction[i], .known = FloorOf(problem, i)};
    const auto column = static_cast<Eigen::Index>(rows.size());
    if (IsAtFloor(is)) {
      fixed[2 * i] = FloorOf(problem, i);
      fixed[2 * i + 1] = slip * fixed[2 * i];
    } else {
      span(2 * i, column) = 1;
      span(2 * i + 1, column) = slip;
      of.normal = column;
      rows.push_back(2 * i);
    }
    if (is == 's' || is == 'S') {
      of.tangent = static_cast<Eigen::Index>(rows.size());
      span(2 * i + 1, of.tangent) = 1;
      rows.push_back(2 * i + 1);
    }
    unknown.push_back(of);
  }
  const auto r = static_cast<Eigen::Index>(rows.size());
  if (r == 0) return tried;
  const Eigen::MatrixXd forces = span.leftCols(r), responses = Multiply(problem.W, forces);
  const Eigen::VectorXd before = problem.W * fixed + problem.given, all_terms = TermsOf(problem);
  Eigen::MatrixXd matrix(r, r);
  Eigen::VectorXd right(r), terms(r);
  for (Eigen::Index i = 0; i < r; ++i) {
    matrix.row(i) = responses.row(rows[i]);
    right[i] = -before[rows[i]];
    terms[i] = all_terms[rows[i]];
  }
  Eigen::VectorXd solution(r);
  BlockSolver(matrix, kRedundant).Solve(right, solution);
  const double size = right.cwiseAbs().maxCoeff();
  if (!((matrix * solution - right).cwiseAbs().maxCoeff() <= 1e-8 * size + kOfTerms * terms.maxCoeff())) {
    return std::nullopt;
  }
  Eigen::VectorXd tolerance = ForceTolerances(matrix, solution, terms);
  if (rows.size() > 1) {
    const Eigen::MatrixXd stresses = InternalStresses(matrix);
    if (stresses.cols() > 0 && (responses * stresses).cwiseAbs().maxCoeff() <= 1e-8 * responses.cwiseAbs().maxCoeff()) {
      tried.stressed = SmallestLimit(LimitsOf(unknown, r), solution) < -tolerance.maxCoeff();
      solution = SplitForces(solution, stresses, unknown).force;
      tolerance = ForceTolerances(matrix, solution, terms);
    }
  }
  const double rounding = kOfLargest * solution.cwiseAbs().maxCoeff();
  for (Eigen::Index i = 0; i < r; ++i) tried.tolerance[rows[i]] = std::max(tolerance[i], rounding);
  tried.force += forces * solution;
  return tried;
}

// The largest terms that add up to w.
double LargestTerm(const ContactProblem& problem, const Eigen::VectorXd& force) {
  return problem.given.cwiseAbs().maxCoeff() + (problem.W.cwiseAbs() * force.cwiseAbs()).maxCoeff();
}

// Whether forces satisfy the inequalities of a status.
bool Holds(const ContactProblem& problem, const std::string& status, const TriedForces& tried, const Eigen::VectorXd& w,
           double w_zero) {
  const Eigen::VectorXd& force = tried.force;
  for (int i = 0; i < problem.size(); ++i) {
    const double f_zero = std::max(tried.tolerance[2 * i], tried.tolerance[2 * i + 1]);
    if (IsAtFloor(status[i]) ? w[2 * i] < -w_zero : force[2 * i] - FloorOf(problem, i) < -f_zero) return false;
    const bool sticks = status[i] == 's' || status[i] == 'S';
    if (sticks && problem.friction[i] * force[2 * i] - std::abs(force[2 * i + 1]) < -f_zero) return false;
    if (problem.sliding[i] != 0) continue;
    if (TangentSign(status[i]) * w[2 * i + 1] < -w_zero) return false;
    if (status[i] == 'n' && problem.has_friction[i] && std::abs(w[2 * i + 1]) > w_zero) return false;
  }
  return true;
}

// Returns the possible states of a contact; the first one is named if several satisfy the conditions.
std::string PossibilitiesOf(const ContactProblem& problem, int contact) {
  if (!problem.has_friction[contact]) return "no";
  if (problem.sliding[contact] != 0) return problem.sliding[contact] > 0 ? "+o" : "-o";
  const std::string closed = HasStick(problem, contact) ? "s+-" : "n+-";
  return closed + (FloorOf(problem, contact) > 0 ? (HasStick(problem, contact) ? "SPM" : "PM") : "o");
}

// The status with as many contacts closed and sticking as accelerations w allow, of which those up to w_zero are zero.
std::string StatusOfMotion(const ContactProblem& problem, const Eigen::VectorXd& w, double w_zero) {
  std::string status;
  for (int i = 0; i < problem.size(); ++i) {
    const double w_n = w[2 * i], w_t = w[2 * i + 1];
    if (w_n > w_zero) {
      status += 'o';
    } else if (!problem.has_friction[i]) {
      status += 'n';
    } else if (problem.sliding[i] != 0) {
      status += problem.sliding[i] > 0 ? '+' : '-';
    } else {
      status += std::abs(w_t) > w_zero ? (w_t > 0 ? '+' : '-') : HasStick(problem, i) ? 's' : 'n';
    }
  }
  return status;
}

// Returns the forces to which projected Gauss-Seidel leads, which often finds some where Lemke's method does not, as
// where several contacts neither approach nor part; whether they solve the problem is for the caller to see.
Eigen::VectorXd RelaxForces(const ContactProblem& problem) {
  Eigen::VectorXd force = Eigen::VectorXd::Zero(problem.given.size());
  const auto relax = [&](std::ptrdiff_t row) {
    if (!(problem.W(row, row) > 0)) return 0.0;
    const std::ptrdiff_t contact = row / 2;
    const double before = force[row], limit = problem.friction[contact] * force[2 * contact];
    const double free = before - (problem.W.col(row).dot(force) + problem.given[row]) / problem.W(row, row);
    const int sliding = problem.sliding[contact];
    force[row] = row % 2 == 0 ? std::max(free, 0.0) : sliding != 0 ? -sliding * limit : std::clamp(free, -limit, limit);
    return std::abs(force[row] - before);
  };
  for (int count = 0; count < kMostSweeps; ++count) {
    if (GaussSeidelSweep(force.size(), relax) <= kRelaxed * force.cwiseAbs().maxCoeff()) break;
  }
  return force;
}

// Maximizes the smallest number of constants + slopes y by the dual simplex method. Returns y and the rows that are the
// smallest, one more than y has components. The first of these rows enclose y, so that the method can begin with them.
Eigen::VectorXd MaximizeSmallest(const Eigen::MatrixXd& slopes, const Eigen::VectorXd& constants,
                                 std::vector<Eigen::Index>* tight) {
  const Eigen::Index d = slopes.cols(), m = slopes.rows();
  tight->resize(d + 1);
  for (Eigen::Index i = 0; i <= d; ++i) (*tight)[i] = i;
  Eigen::MatrixXd matrix(d + 1, d + 1), inverse;
  Eigen::VectorXd right(d + 1), solution(d + 1);
  const int patience = static_cast<int>(4 * m);
  int exchanges = kMostExchanges;  // since the inverse was computed, which an exchange of a row changes by rank one
  for (int count = 0; count < 4 * patience; ++count) {
    if (exchanges >= kMostExchanges) {
      exchanges = 0;
      for (Eigen::Index i = 0; i <= d; ++i) {
        matrix.row(i) << slopes.row((*tight)[i]), -1;
        right[i] = -constants[(*tight)[i]];
      }
      inverse = SolveLuColumns(matrix, Eigen::MatrixXd::Identity(d + 1, d + 1));
    }
    solution = inverse * right;
    const double rounding = 1e-14 * std::max(right.cwiseAbs().maxCoeff(), solution.cwiseAbs().maxCoeff());
    const Eigen::VectorXd left = slopes * solution.head(d) + constants - Eigen::VectorXd::Constant(m, solution[d]);
    // The row that is smallest, or after many steps the first of those that are too small, which cannot cycle.
    Eigen::Index entering = 0;
    const double least = left.minCoeff(&entering);
    if (!(least < -kDrift * rounding) && exchanges > 0) {
      exchanges = kMostExchanges;
      continue;
    }
    if (!(least < -rounding)) break;
    for (Eigen::Index i = 0; count >= patience && i < entering; ++i) {
      if (left[i] < -rounding) entering = i;
    }
    Eigen::RowVectorXd row(d + 1);
    row << slopes.row(entering), -1;
    const Eigen::RowVectorXd of_sum = -inverse.row(d), of_row = row * inverse;
    // The row that leaves has the largest pivot of those whose shares of the sum vanish first, up to rounding (Harris).
    const double smallest = kPivot * of_row.cwiseAbs().maxCoeff();
    double first = std::numeric_limits<double>::infinity();
    for (Eigen::Index i = 0; i <= d; ++i) {
      if (of_row[i] > smallest) first = std::min(first, (std::max(of_sum[i], 0.0) + kShare) / of_row[i]);
    }
    Eigen::Index leaving = -1;
    for (Eigen::Index i = 0; i <= d; ++i) {
      if (!(of_row[i] > smallest) || of_sum[i] > first * of_row[i]) continue;
      if (leaving < 0 || of_row[i] > of_row[leaving]) leaving = i;
    }
    if (leaving < 0) break;
    (*tight)[leaving] = entering;
    right[leaving] = -constants[entering];
    Eigen::RowVectorXd change = of_row / of_row[leaving];
    change[leaving] -= 1 / of_row[leaving];
    inverse -= Eigen::VectorXd(inverse.col(leaving)) * change;
    ++exchanges;
  }
  return solution.head(d);
}

// The vectors that a matrix maps to zero, and all others: orthonormal bases.
struct KernelSplit {
  Eigen::MatrixXd kernel, others;
};
KernelSplit SplitKernel(const Eigen::MatrixXd& matrix) {
  const Eigen::Index size = matrix.cols();
  if (matrix.size() == 0) return {Eigen::MatrixXd::Identity(size, size), Eigen::MatrixXd(size, 0)};
  const LeastNormSolver solver(matrix, kRedundant);
  Eigen::MatrixXd projection(size, size);
  Eigen::VectorXd column(size);
  for (Eigen::Index j = 0; j < size; ++j) {
    solver.Solve(matrix.col(j), column);
    projection.col(j) = Eigen::VectorXd::Unit(size, j) - column;
  }
  const SymmetricEigen eigen = EigenOf(0.5 * (projection + projection.transpose()));
  const Eigen::Index count = (eigen.values.array() > kMovesNothing).count();
  return {eigen.vectors.rightCols(count), eigen.vectors.leftCols(size - count)};
}

// Splits forces into those that move nothing between two bodies, whose columns have zeros in the same rows, and all
// others: orthonormal bases.
KernelSplit SplitLocally(const Eigen::MatrixXd& matrix) {
  const Eigen::Index size = matrix.cols();
  std::map<std::vector<Eigen::Index>, std::vector<Eigen::Index>> pairs;
  for (Eigen::Index j = 0; j < size; ++j) {
    std::vector<Eigen::Index> rows;
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      if (matrix(i, j) != 0) rows.push_back(i);
    }
    pairs[std::move(rows)].push_back(j);
  }
  KernelSplit split{Eigen::MatrixXd::Zero(size, size), Eigen::MatrixXd::Zero(size, size)};
  Eigen::Index still = 0, moving = 0;
  for (const auto& [rows, columns] : pairs) {
    const KernelSplit of_pair = SplitKernel(matrix(rows, columns));
    for (Eigen::Index j = 0; j < of_pair.kernel.cols(); ++j) split.kernel(columns, still++) = of_pair.kernel.col(j);
    for (Eigen::Index j = 0; j < of_pair.others.cols(); ++j) split.others(columns, moving++) = of_pair.others.col(j);
  }
  split.kernel.conservativeResize(size, still);
  split.others.conservativeResize(size, moving);
  return split;
}

}  // namespace

BlockSolver::BlockSolver(const Eigen::MatrixXd& matrix, double threshold) {
  const Eigen::Index size = matrix.rows();
  std::vector<Eigen::Index> block(size);
  std::iota(block.begin(), block.end(), 0);
  for (Eigen::Index i = 0; i < size; ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      if (matrix(i, j) == 0 && matrix(j, i) == 0) continue;
      const auto [low, high] = std::minmax({block[i], block[j]});
      std::replace(block.begin(), block.end(), high, low);
    }
  }
  for (Eigen::Index first = 0; first < size; ++first) {
    if (block[first] != first) continue;
    std::vector<Eigen::Index> rows;
    for (Eigen::Index i = first; i < size; ++i) {
      if (block[i] == first) rows.push_back(i);
    }
    const Eigen::MatrixXd of_block = matrix(rows, rows);
    std::optional<Eigen::MatrixXd> moving;
    if (of_block.rows() > kLargeBlock) moving = SplitLocally(of_block).others;
    LeastNormSolver solver(moving ? Multiply(of_block, *moving) : of_block, threshold);
    blocks_.push_back({std::move(rows), std::move(moving), std::move(solver)});
  }
}

void BlockSolver::Solve(const Eigen::VectorXd& right, Eigen::VectorXd& solution) const {
  solution.resize(right.size());
  for (const Block& block : blocks_) {
    Eigen::VectorXd part = right(block.rows);
    if (block.moving && !part.isZero(0)) {
      Eigen::VectorXd amounts(block.moving->cols());
      block.solver.Solve(part, amounts);
      part = *block.moving * amounts;
    } else if (!part.isZero(0)) {
      block.solver.Solve(part, part);
    }
    solution(block.rows) = part;
  }
}

ForceLimits LimitsOf(const std::vector<UnknownForces>& contacts, Eigen::Index num_forces) {
  ForceLimits limits{Eigen::MatrixXd::Zero(3 * static_cast<Eigen::Index>(contacts.size()), num_forces),
                     Eigen::VectorXd::Zero(3 * static_cast<Eigen::Index>(contacts.size()))};
  Eigen::Index row = 0;
  for (const UnknownForces& of : contacts) {
    if (of.normal >= 0) {
      limits.rows(row, of.normal) = 1;
      limits.constants[row++] = -of.known;
    }
    for (const double side : {-1.0, 1.0}) {
      if (of.tangent < 0) break;
      limits.rows(row, of.tangent) = side;
      if (of.normal >= 0) {
        limits.rows(row, of.normal) = of.friction;
      } else {
        limits.constants[row] = of.friction * of.known;
      }
      ++row;
    }
  }
  limits.rows.conservativeResize(row, num_forces);
  limits.constants.conservativeResize(row);
  return limits;
}

Eigen::VectorXd ForceTolerances(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& force,
                                const Eigen::VectorXd& terms) {
  const Eigen::VectorXd diagonal = matrix.diagonal().cwiseAbs();
  Eigen::VectorXd tolerances(force.size());
  for (Eigen::Index i = 0; i < force.size(); ++i) {
    double most = 0;
    for (Eigen::Index j = 0; j < force.size(); ++j) {
      if (i != j && std::abs(matrix(i, j)) <= kCoupled * std::sqrt(diagonal[i] * diagonal[j])) continue;
      most = std::max(most, kAtLimit * std::abs(force[j]));
      if (diagonal[j] > 0) most = std::max(most, kOfTerms * terms[j] / diagonal[j]);
    }
    tolerances[i] = most;
  }
  return tolerances;
}

Eigen::MatrixXd InternalStresses(const Eigen::MatrixXd& matrix) {
  // Stresses of one pair of bodies each come first, so that they share no contacts.
  const KernelSplit local = SplitLocally(matrix);
  const Eigen::MatrixXd others = SplitKernel(Multiply(matrix, local.others)).kernel;
  Eigen::MatrixXd stresses(matrix.rows(), local.kernel.cols() + others.cols());
  stresses << local.kernel, Multiply(local.others, others);
  return stresses;
}

namespace {

// Splits the forces of a group of contacts, with limits that LimitsOf has for them.
ForceSplit::Group SplitGroup(const Eigen::MatrixXd& stresses, const std::vector<UnknownForces>& contacts,
                             Eigen::VectorXd* force) {
  const ForceLimits limits = LimitsOf(contacts, force->size());
  const Eigen::Index d = stresses.cols(), m = limits.rows.rows();
  double normals = 0, friction = 0;
  Eigen::RowVectorXd sum = Eigen::RowVectorXd::Zero(force->size());
  for (const UnknownForces& of : contacts) {
    friction = std::max(friction, of.friction);
    normals += std::abs(of.known);
    if (of.normal < 0) continue;
    normals += std::abs((*force)[of.normal]);
    sum[of.normal] = -1;
  }
  ForceSplit::Group split;
  // The solution is closer to x than the bounds that enclose it.
  const double bound = 10 * static_cast<double>(force->size()) * (1 + friction) * (force->cwiseAbs().sum() + normals);
  if (!(bound > 0) || !std::isfinite(bound)) return split;
  Eigen::MatrixXd slopes(d + 2 + m, d);
  Eigen::VectorXd constants(d + 2 + m);
  slopes.topRows(d + 2) << Eigen::MatrixXd::Identity(d, d), Eigen::RowVectorXd::Constant(d, -1), sum * stresses;
  for (Eigen::Index i = 0; i < m; ++i) {
    slopes.row(d + 2 + i).setZero();
    for (Eigen::Index j = 0; j < force->size(); ++j) {  // most of the factors are zero
      if (limits.rows(i, j) != 0) slopes.row(d + 2 + i) += limits.rows(i, j) * stresses.row(j);
    }
  }
  constants << Eigen::VectorXd::Constant(d + 1, bound), 2 * normals + sum * *force,
      limits.rows * *force + limits.constants;
  std::vector<Eigen::Index> tight;
  const Eigen::VectorXd stress = MaximizeSmallest(slopes, constants, &tight);
  const Eigen::VectorXd found = *force + stresses * stress;
  // Rounding errors of many stresses may lead the search astray.
  if (!(SmallestLimit(limits, found) >= SmallestLimit(limits, *force))) return split;
  *force = found;
  split.by_stress.resize(d + 1, d + 1);
  for (Eigen::Index i = 0; i <= d; ++i) {
    split.by_stress.row(i) << slopes.row(tight[i]), -1;
    split.tight.push_back(std::max<Eigen::Index>(tight[i] - (d + 2), -1));
  }
  return split;
}

}  // namespace

ForceSplit SplitForces(const Eigen::VectorXd& force, const Eigen::MatrixXd& stresses,
                       const std::vector<UnknownForces>& contacts) {
  const Eigen::Index d = stresses.cols();
  // Each contact has a part in some stresses, and stresses in which one contact has a part belong to one group.
  std::vector<Eigen::Index> group(d);
  std::iota(group.begin(), group.end(), 0);
  std::vector<Eigen::Index> first_of(contacts.size(), -1), limit_of;
  Eigen::Index limit = 0;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    limit_of.push_back(limit);
    limit += (contacts[i].normal >= 0 ? 1 : 0) + (contacts[i].tangent >= 0 ? 2 : 0);
    for (Eigen::Index j = 0; j < d; ++j) {
      const bool has_part = (contacts[i].normal >= 0 && std::abs(stresses(contacts[i].normal, j)) > kOfStress) ||
                            (contacts[i].tangent >= 0 && std::abs(stresses(contacts[i].tangent, j)) > kOfStress);
      if (!has_part) continue;
      if (first_of[i] < 0) first_of[i] = j;
      const auto [low, high] = std::minmax({group[j], group[first_of[i]]});
      std::replace(group.begin(), group.end(), high, low);
    }
  }
  ForceSplit split{.force = force};
  for (Eigen::Index number = 0; number < d; ++number) {
    if (group[number] != number) continue;
    std::vector<Eigen::Index> columns, rows, limits;
    std::vector<std::size_t> numbers;
    for (Eigen::Index j = number; j < d; ++j) {
      if (group[j] == number) columns.push_back(j);
    }
    std::vector<UnknownForces> members;
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      if (first_of[i] < 0 || group[first_of[i]] != number) continue;
      UnknownForces member = contacts[i];
      for (Eigen::Index* row : {&member.normal, &member.tangent}) {
        if (*row < 0) continue;
        rows.push_back(*row);
        *row = std::ssize(rows) - 1;
      }
      const Eigen::Index count = (member.normal >= 0 ? 1 : 0) + (member.tangent >= 0 ? 2 : 0);
      for (Eigen::Index k = 0; k < count; ++k) limits.push_back(limit_of[i] + k);
      members.push_back(member);
      numbers.push_back(i);
    }
    Eigen::VectorXd of_group = force(rows);
    ForceSplit::Group found = SplitGroup(stresses(rows, columns), members, &of_group);
    split.force(rows) = of_group;
    if (found.tight.empty()) continue;
    for (Eigen::Index& tight : found.tight) tight = tight < 0 ? tight : limits[tight];
    found.stresses = std::move(columns);
    found.contacts = std::move(numbers);
    split.groups.push_back(std::move(found));
  }
  return split;
}

std::optional<ContactSolution> HoldContacts(const ContactProblem& problem, const std::vector<char>& sticks,
                                            double still) {
  ContactProblem held = problem;
  std::fill(held.friction.begin(), held.friction.end(), 0.0);
  std::string status;
  for (const char stick : sticks) status += stick != 0 ? 's' : 'n';
  const std::optional<TriedForces> tried = ForcesOf(held, status);
  if (tried) return ContactSolution{status, tried->force};
  for (int i = 0; i < problem.size(); ++i) {
    if (std::abs(problem.given[2 * i]) > still || (sticks[i] && std::abs(problem.given[2 * i + 1]) > still)) return {};
  }
  return ContactSolution{status, Eigen::VectorXd::Zero(problem.given.size())};
}

bool IsTooLarge(const ContactProblem& problem) {
  int rows = problem.size();
  for (int i = 0; i < problem.size(); ++i) rows += HasStick(problem, i) && problem.sliding[i] == 0 ? 3 : 0;
  return rows > internal::kMostComplementaryRows;
}

std::vector<ContactSolution> SolveContactProblem(const ContactProblem& problem) {
  struct Found {
    ContactSolution solution;
    bool stressed = false;
  };
  std::vector<Found> all;
  const int k = problem.size();
  const double terms = kOfTerms * TermsOf(problem).maxCoeff();
  const auto accelerations = [&](const Eigen::VectorXd& force) -> Eigen::VectorXd {
    return problem.W * force + problem.given;
  };
  const auto try_status = [&](const std::string& status) {
    const std::optional<TriedForces> tried = ForcesOf(problem, status);
    if (!tried || !tried->force.allFinite()) return;
    const Eigen::VectorXd w = accelerations(tried->force);
    const double most_w = LargestTerm(problem, tried->force);
    if (!Holds(problem, status, *tried, w, kTolerance * most_w + terms)) return;
    for (Found& known : all) {
      const double differs = (accelerations(known.solution.force) - w).cwiseAbs().maxCoeff();
      if (differs > kDiffers * most_w + terms) continue;
      known.stressed = known.stressed && tried->stressed;
      return;
    }
    all.push_back({{status, tried->force}, tried->stressed});
  };
  if (k <= kMostTriedContacts) {
    std::vector<std::string> possible;
    for (int i = 0; i < k; ++i) possible.push_back(PossibilitiesOf(problem, i));
    std::vector<std::size_t> at(k, 0);
    for (bool more = true; more;) {
      std::string status;
      for (int i = 0; i < k; ++i) status += possible[i][at[i]];
      try_status(status);
      more = false;
      for (int i = k - 1; i >= 0 && !more; --i) {
        more = ++at[i] < possible[i].size();
        if (!more) at[i] = 0;
      }
    }
  } else if (!IsTooLarge(problem)) {
    std::vector<double> friction = problem.friction;
    for (int i = 0; i < k; ++i) {
      if (!problem.has_friction[i]) friction[i] = 0;
    }
    // Without a search: contacts that do not approach need no forces, and those of bodies at rest all stay closed, and
    // stick unless they slide.
    const double zero = kTolerance * problem.given.cwiseAbs().maxCoeff() + terms;
    if (problem.given(Eigen::seq(0, Eigen::last, 2)).minCoeff() >= -zero) {
      all.push_back({{StatusOfMotion(problem, problem.given, zero), Eigen::VectorXd::Zero(2 * k)}, false});
    } else {
      try_status(StatusOfMotion(problem, Eigen::VectorXd::Zero(2 * k), 0));
    }
    const auto try_motion = [&](const std::optional<Eigen::VectorXd>& found) {
      for (std::size_t i = 0; found && all.empty() && i < kStands.size(); ++i) {
        try_status(StatusOfMotion(problem, accelerations(*found), kStands[i] * LargestTerm(problem, *found) + terms));
      }
    };
    if (all.empty()) try_motion(SolveFrictionalLcp(friction, problem.W, problem.given, problem.sliding));
    if (all.empty()) try_motion(RelaxForces(problem));
  }
  const bool needs_stress = std::ranges::all_of(all, &Found::stressed);
  std::vector<ContactSolution> solutions;
  for (Found& found : all) {
    if (needs_stress || !found.stressed) solutions.push_back(std::move(found.solution));
  }
  return solutions;
}

}  // namespace saltus
