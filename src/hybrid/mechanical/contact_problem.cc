#include "hybrid/mechanical/contact_problem.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "base/linear_algebra.h"
#include "contact/solvers/complementarity.h"

namespace saltus {
namespace {

constexpr double kRedundant = 1e-10;  // pivots of rows that depend on others, of the largest
constexpr double kTolerance = 1e-10;  // of inequalities, of the largest term
constexpr double kDiffers = 1e-7;     // accelerations of two solutions, of the largest term

double FloorOf(const ContactProblem& problem, int contact) {
  return problem.floor.empty() ? 0.0 : problem.floor[contact];
}

// The forces if the contacts have this status, whether or not they satisfy the inequalities; nothing if there are none.
std::optional<Eigen::VectorXd> ForcesOf(const ContactProblem& problem, const std::string& status) {
  const int k = problem.size();
  // Unknowns are normal forces of closed contacts and tangential ones of those that stick, with a row that vanishes
  // each.
  std::vector<int> rows;
  Eigen::MatrixXd span = Eigen::MatrixXd::Zero(2 * k, 2 * k);
  Eigen::VectorXd fixed = Eigen::VectorXd::Zero(2 * k);
  for (int i = 0; i < k; ++i) {
    const char is = status[i];
    const double slip = -problem.friction[i] * TangentSign(is);
    const auto column = static_cast<Eigen::Index>(rows.size());
    if (IsAtFloor(is)) {
      fixed[2 * i] = FloorOf(problem, i);
      fixed[2 * i + 1] = slip * fixed[2 * i];
    } else {
      span(2 * i, column) = 1;
      span(2 * i + 1, column) = slip;
      rows.push_back(2 * i);
    }
    if (is != 's' && is != 'S') continue;
    span(2 * i + 1, static_cast<Eigen::Index>(rows.size())) = 1;
    rows.push_back(2 * i + 1);
  }
  const auto r = static_cast<Eigen::Index>(rows.size());
  if (r == 0) return fixed;
  const Eigen::MatrixXd forces = span.leftCols(r), responses = Multiply(problem.W, forces);
  const Eigen::VectorXd before = problem.W * fixed + problem.given;
  Eigen::MatrixXd matrix(r, r);
  Eigen::VectorXd right(r);
  for (Eigen::Index i = 0; i < r; ++i) {
    matrix.row(i) = responses.row(rows[i]);
    right[i] = -before[rows[i]];
  }
  Eigen::VectorXd solution(r);
  LeastNormSolver(matrix, kRedundant).Solve(right, solution);
  const double size = right.cwiseAbs().maxCoeff();
  if (!((matrix * solution - right).cwiseAbs().maxCoeff() <= 1e-8 * size)) return std::nullopt;
  return fixed + forces * solution;
}

// Whether forces satisfy the inequalities of a status.
bool Holds(const ContactProblem& problem, const std::string& status, const Eigen::VectorXd& force,
           const Eigen::VectorXd& w, double most_force, double most_w) {
  const double f_zero = kTolerance * most_force, w_zero = kTolerance * most_w;
  for (int i = 0; i < problem.size(); ++i) {
    if (IsAtFloor(status[i]) ? w[2 * i] < -w_zero : force[2 * i] - FloorOf(problem, i) < -f_zero) return false;
    const bool sticks = status[i] == 's' || status[i] == 'S';
    if (sticks && std::abs(force[2 * i + 1]) > problem.friction[i] * force[2 * i] + f_zero) return false;
    if (problem.sliding[i] == 0 && TangentSign(status[i]) * w[2 * i + 1] < -w_zero) return false;
  }
  return true;
}

// What a contact may be, the possibility that shall be named first if several are one.
std::string PossibilitiesOf(const ContactProblem& problem, int contact) {
  if (!problem.has_friction[contact]) return "no";
  if (problem.sliding[contact] != 0) return problem.sliding[contact] > 0 ? "+o" : "-o";
  return FloorOf(problem, contact) > 0 ? "s+-SPM" : "s+-o";
}

// The status that the forces of Lemke's method have.
std::string StatusOf(const ContactProblem& problem, const Eigen::VectorXd& force) {
  const double most_force = force.cwiseAbs().maxCoeff();
  std::string status;
  for (int i = 0; i < problem.size(); ++i) {
    const double f_n = force[2 * i], f_t = force[2 * i + 1], bound = problem.friction[i] * f_n;
    if (!(f_n > kTolerance * most_force)) {
      status += 'o';
    } else if (!problem.has_friction[i]) {
      status += 'n';
    } else if (problem.sliding[i] != 0) {
      status += problem.sliding[i] > 0 ? '+' : '-';
    } else {
      status += std::abs(f_t) < bound * (1 - 1e-9) ? 's' : f_t < 0 ? '+' : '-';
    }
  }
  return status;
}

}  // namespace

ContactSolution HoldContacts(const ContactProblem& problem) {
  ContactProblem smooth = problem;
  std::fill(smooth.friction.begin(), smooth.friction.end(), 0.0);
  const std::string status(problem.friction.size(), 'n');
  return {status, ForcesOf(smooth, status).value_or(Eigen::VectorXd::Zero(problem.given.size()))};
}

std::vector<ContactSolution> SolveContactProblem(const ContactProblem& problem) {
  std::vector<ContactSolution> solutions;
  const int k = problem.size();
  const auto accelerations = [&](const Eigen::VectorXd& force) -> Eigen::VectorXd {
    return problem.W * force + problem.given;
  };
  // The largest terms: of w those that add up to it.
  const auto try_status = [&](const std::string& status) {
    const std::optional<Eigen::VectorXd> force = ForcesOf(problem, status);
    if (!force || !force->allFinite()) return;
    const Eigen::VectorXd w = accelerations(*force);
    const double most_force = force->cwiseAbs().maxCoeff();
    const double most_w = problem.given.cwiseAbs().maxCoeff() + (problem.W.cwiseAbs() * force->cwiseAbs()).maxCoeff();
    if (!Holds(problem, status, *force, w, most_force, most_w)) return;
    for (const ContactSolution& known : solutions) {
      if ((accelerations(known.force) - w).cwiseAbs().maxCoeff() <= kDiffers * most_w) return;
    }
    solutions.push_back({status, *force});
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
    return solutions;
  }
  std::vector<double> friction = problem.friction;
  for (int i = 0; i < k; ++i) {
    if (!problem.has_friction[i]) friction[i] = 0;
  }
  const std::optional<Eigen::VectorXd> found = SolveFrictionalLcp(friction, problem.W, problem.given, problem.sliding);
  if (!found) return solutions;
  const std::string status = StatusOf(problem, *found);
  try_status(status);
  if (solutions.empty()) solutions.push_back({status, *found});
  return solutions;
}

}  // namespace saltus
