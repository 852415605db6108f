#include "feedback/noisy_states.h"

#include <algorithm>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

constexpr double kRounding = 1e-14;   // of the largest eigenvalue: none
constexpr double kAsymmetry = 1e-10;  // of the largest entry: rounding

}  // namespace

bool IsFinite(const LinearMotion& motion) {
  return std::ranges::all_of(motion.intervals,
                             [](const LinearInterval& at) { return at.A.allFinite() && at.B.allFinite(); });
}

bool TakeEventsBehindGuards(const HybridSystem& system, double t, std::span<const double> control,
                            std::span<const double> parameters, int* mode, Eigen::VectorXd* x,
                            std::vector<HybridEvent>* events, Eigen::MatrixXd* saltation) {
  constexpr int kMostEvents = 100;
  const HybridFunctions& f = system.functions();
  std::vector<double> slope(f.most_states()), after(f.most_states());
  const auto here = [&] { return ModePoint{*mode, t, x->data(), control.data(), parameters.data()}; };
  *mode = f.ModeAfterControlJump(here());
  for (int count = 0; *mode >= 0 && count < kMostEvents; ++count) {
    f.Flow(here(), slope.data());
    int guard = 0;
    const int num_guards = system.num_guards(*mode);
    double rate = 0;
    for (; guard < num_guards; ++guard) {
      const double value = f.GuardRate(here(), guard, slope.data(), &rate);
      if (value < 0 && rate < 0) break;
    }
    if (guard == num_guards) return true;
    const int next = f.Reset(here(), guard, after.data());
    if (next < 0 || next >= system.num_modes()) return false;
    if (saltation) {
      const std::vector<double> xi = SaltationMatrix(
          system, *mode, guard, t, {x->data(), static_cast<std::size_t>(x->size())}, control, parameters);
      *saltation = Eigen::Map<const RowMajor>(xi.data(), xi.size() / x->size(), x->size()) * *saltation;
    }
    if (events) events->push_back({t, *mode, guard, next, rate, {}, {}, /*immediate=*/true});
    *x = Eigen::Map<const Eigen::VectorXd>(after.data(), system.state_size(next));
    *mode = next;
  }
  return false;
}

std::string ValidateSymmetric(const Eigen::MatrixXd& matrix, Eigen::Index size, bool definite) {
  if (matrix.rows() != size || matrix.cols() != size) {
    return "found a matrix of " + std::to_string(matrix.rows()) + " x " + std::to_string(matrix.cols()) +
           ", expected " + std::to_string(size) + " x " + std::to_string(size);
  }
  if (!matrix.allFinite()) return "found a number that is not finite";
  if (size == 0) return "";
  const double largest = matrix.cwiseAbs().maxCoeff();
  if ((matrix - matrix.transpose()).cwiseAbs().maxCoeff() > kAsymmetry * largest) {
    return "found a matrix that is not symmetric";
  }
  const double least = EigenOf(matrix).values[0];
  if (definite ? !(least > 0) : least < -kAsymmetry * largest) {
    return "found the eigenvalue " + std::to_string(least) + ", expected " +
           (definite ? "a positive definite matrix" : "a positive semidefinite matrix");
  }
  return "";
}

Eigen::MatrixXd RootOfCovariance(const Eigen::MatrixXd& covariance) {
  const Eigen::Index n = covariance.rows();
  if (n == 0) return {};
  const SymmetricEigen of = EigenOf(covariance);
  const double least = kRounding * of.values[n - 1];
  const Eigen::Index rank = (of.values.array() > std::max(least, 0.0)).count();
  return of.vectors.rightCols(rank) * of.values.tail(rank).cwiseSqrt().asDiagonal();
}

}  // namespace saltus
