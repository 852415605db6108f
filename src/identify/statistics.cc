#include "identify/statistics.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/linear_algebra.h"
#include "base/statistics.h"
#include "identify/unknowns.h"

namespace saltus {
namespace {

// A direction of parameters with a larger standard error, in units of a change that matters, is not determined.
constexpr double kOpen = 0.5;
// The share of a parameter in such directions from which on it is not determined either.
constexpr double kShare = 0.04;

// The median length of a vector of as many standard normal numbers.
double MedianLength(int entries) { return entries == 2 ? 1.177410023 : 1.832132867; }

// Derivatives of a sample's standardised residual; those by unknowns per change that matters.
Eigen::MatrixXd ScaledJacobian(const FitProblem& problem, const Scene& scene, const Sample& sample,
                               const Eigen::MatrixXd& derivative) {
  const Eigen::VectorXd weights = WeightsOf(problem, sample);
  Eigen::MatrixXd jacobian = weights.asDiagonal() * derivative.topRows(weights.size());
  for (std::size_t u = 0; u < problem.unknowns.size(); ++u) jacobian.col(u) *= ScaleOf(problem.unknowns[u], scene);
  return jacobian;
}

// The information on the unknowns but for a law's, what these and the initial states take of it left out.
Eigen::MatrixXd InformationOnUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto num_unknowns = static_cast<Eigen::Index>(problem.unknowns.size());
  const Scene scene = problem.SceneAt(fit.point.coordinates);
  const auto columns = num_unknowns + static_cast<Eigen::Index>(4 * problem.free_bodies.size());
  std::vector<Eigen::MatrixXd> normal(fit.point.segments.size(), Eigen::MatrixXd::Zero(columns, columns));
  ForEachSample(problem, fit, [&](int s, int i, const Sample& sample, const Eigen::VectorXd& residual) {
    const double weight = EvaluateLoss(problem.options->loss, loss_scale, residual.squaredNorm()).rho[1];
    const Eigen::MatrixXd jacobian = ScaledJacobian(problem, scene, sample, fit.motion[s].derivative[i]);
    AddGram(weight, jacobian, &normal[s]);
  });
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(num_unknowns, num_unknowns);
  for (const Eigen::MatrixXd& all : normal) information += SchurComplement(all, num_unknowns);
  if (const auto learned = LearnedStartOf(*problem.options)) {
    const double spread = learned->spread;
    information.diagonal().tail(num_unknowns - problem.num_plain).array() += 1 / (spread * spread);
  }
  return SchurComplement(information, problem.num_plain);
}

constexpr int kPoints = 25;  // of the curve

// The standard error of what has these derivatives by the law's parameters.
double ErrorOf(const FitProblem& problem, const FitResult& fit, double factor, const std::vector<double>& slope) {
  double variance = 0;
  for (std::size_t i = 0; i < slope.size(); ++i) {
    const std::vector<double>& row = fit.covariance[problem.num_plain + i];
    for (std::size_t j = 0; j < slope.size(); ++j) variance += slope[i] * row[problem.num_plain + j] * slope[j];
  }
  return std::sqrt(std::max(0.0, factor * variance));
}

}  // namespace

double MisfitOf(const FitProblem& problem, const FitResult& fit) {
  std::vector<double> lengths;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    lengths.push_back(residual.norm() / MedianLength(static_cast<int>(residual.size())));
  });
  return Median(std::move(lengths));
}

double OutlierShareOf(const FitProblem& problem, const FitResult& fit) {
  int outliers = 0, samples = 0;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    outliers += residual.norm() > problem.options->outlier;
    ++samples;
  });
  return static_cast<double>(outliers) / samples;
}

Openness FindOpenUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto count = static_cast<Eigen::Index>(problem.unknowns.size());
  Openness open{std::vector<Determination>(count, Determination::kDetermined), std::vector<std::vector<int>>(count)};
  if (problem.num_plain == 0) return open;
  const SymmetricEigen eigen = EigenOf(InformationOnUnknowns(problem, fit, loss_scale));
  const double factor = CovarianceFactor(problem, fit, loss_scale);
  const Eigen::Index plain = problem.num_plain;
  Eigen::MatrixXd share = Eigen::MatrixXd::Zero(plain, plain);  // the projection on what is open
  for (Eigen::Index k = 0; k < plain; ++k) {
    if (eigen.values[k] * kOpen * kOpen > factor) continue;
    share += eigen.vectors.col(k) * eigen.vectors.col(k).transpose();
  }
  for (Eigen::Index i = 0; i < plain; ++i) {
    if (share(i, i) < kShare) continue;
    for (Eigen::Index j = 0; j < plain; ++j) {
      if (j != i && std::abs(share(i, j)) > kShare) open.with[i].push_back(static_cast<int>(j));
    }
    open.determination[i] = open.with[i].empty() ? Determination::kUndetermined : Determination::kCombined;
  }
  return open;
}

double CovarianceFactor(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  double squares = 0, slopes = 0;
  int entries = 0;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    const double squared = residual.squaredNorm();
    const LossAt loss = EvaluateLoss(problem.options->loss, loss_scale, squared);
    squares += loss.rho[1] * loss.rho[1] * squared;
    slopes += static_cast<double>(residual.size()) * loss.rho[1] + 2 * loss.rho[2] * squared;
    entries += static_cast<int>(residual.size());
  });
  const int unknowns =
      static_cast<int>(problem.unknowns.size() + 4 * problem.free_bodies.size() * fit.point.segments.size());
  const double mean_slope = slopes / entries;
  return squares / std::max(1, entries - unknowns) / (mean_slope * mean_slope);
}

LearnedLaw LearnedLawOf(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  LearnedLaw learned{*problem.LawAt(fit.point.coordinates), 0, {}};
  std::vector<double> approach, sliding;
  for (const MotionAtSamples& motion : fit.motion) {
    for (const Vec2d& speeds : motion.impact_speeds) {
      approach.push_back(speeds[0]);
      sliding.push_back(speeds[1]);
    }
  }
  learned.impacts = static_cast<int>(approach.size());
  if (approach.empty() || fit.covariance.empty()) return learned;
  const auto [slowest, fastest] = std::minmax_element(approach.begin(), approach.end());
  const double middle = Median(std::move(sliding));
  const double factor = CovarianceFactor(problem, fit, loss_scale);
  for (int i = 0; i < kPoints; ++i) {
    const double speed = *slowest + (*fastest - *slowest) * i / (kPoints - 1);
    const ImpactLawAt at = EvaluateLaw(learned.law, speed, middle);
    learned.curve.push_back({speed,
                             middle,
                             at.restitution,
                             ErrorOf(problem, fit, factor, at.restitution_slope),
                             at.friction,
                             ErrorOf(problem, fit, factor, at.friction_slope)});
  }
  return learned;
}

LearnedEventFunctions LearnedEventsOf(const FitProblem& problem, const FitResult& fit) {
  LearnedEventFunctions learned{*problem.EventsAt(fit.point.coordinates), {}};
  for (std::size_t s = 0; s < fit.motion.size(); ++s) {
    for (const ImpactState& impact : fit.motion[s].impacts) {
      const int body = impact.candidate.a, number = impact.candidate.b;
      const double radius = problem.scene.bodies[body].radius;
      const Vec2d &position = impact.position[0], &before = impact.velocity[0];
      const EventAt at = EvaluateEvents(learned.functions, number, position, before, radius);
      const Plane& plane = problem.scene.planes[number];
      const double gap = plane.normal.normalized().dot(Vec2d(position - plane.point)) - radius;
      learned.impacts.push_back({static_cast<int>(s), body, number, position, before, at.after, at.normal, gap});
    }
  }
  return learned;
}

}  // namespace saltus
