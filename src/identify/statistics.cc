#include "identify/statistics.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
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

// Derivatives of a sample's standardised residual, those by unknowns per change that matters, with the residual itself
// behind those by unknowns that are not of a law.
Eigen::MatrixXd ScaledJacobian(const FitProblem& problem, const Scene& scene, const Sample& sample,
                               const Eigen::MatrixXd& derivative, const Eigen::VectorXd& residual) {
  const Eigen::VectorXd weights = WeightsOf(problem, sample);
  Eigen::MatrixXd jacobian = weights.asDiagonal() * derivative.topRows(weights.size());
  for (std::size_t u = 0; u < problem.unknowns.size(); ++u) jacobian.col(u) *= ScaleOf(problem.unknowns[u], scene);
  const Eigen::Index others = jacobian.cols() - problem.num_plain;
  Eigen::MatrixXd all(jacobian.rows(), jacobian.cols() + 1);
  all << jacobian.leftCols(problem.num_plain), residual, jacobian.rightCols(others);
  return all;
}

// The information on the unknowns but for a law's, and the gradient of the cost by them, what a law's and the initial
// states take of both left out. Per change that matters.
struct Information {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd gradient;
};
Information InformationOnUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto num_unknowns = static_cast<Eigen::Index>(problem.unknowns.size());
  const Scene scene = problem.SceneAt(fit.point.coordinates);
  const auto columns = num_unknowns + 1 + static_cast<Eigen::Index>(4 * problem.free_bodies.size());
  std::vector<Eigen::MatrixXd> normal(fit.point.segments.size(), Eigen::MatrixXd::Zero(columns, columns));
  ForEachSample(problem, fit, [&](int s, int i, const Sample& sample, const Eigen::VectorXd& residual) {
    const double weight = EvaluateLoss(problem.options->loss, loss_scale, residual.squaredNorm()).rho[1];
    AddGram(weight, ScaledJacobian(problem, scene, sample, fit.motion[s].derivative[i], residual), &normal[s]);
  });
  const Eigen::Index plain = problem.num_plain;
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(num_unknowns + 1, num_unknowns + 1);
  for (const Eigen::MatrixXd& one : normal) all += SchurComplement(one, num_unknowns + 1);
  if (const auto learned = LearnedStartOf(*problem.options)) {
    const double weight = 1 / (learned->spread * learned->spread);
    for (Eigen::Index i = plain; i < num_unknowns; ++i) {
      all(i + 1, i + 1) += weight;
      const double pull = weight * (fit.point.coordinates[i] - learned->parameters[i - plain]);
      all(i + 1, plain) += pull;
      all(plain, i + 1) += pull;
    }
  }
  all = SchurComplement(all, plain + 1);
  return {all.topLeftCorner(plain, plain), all.col(plain).head(plain)};
}

// How near to a bound an unknown is at it, in changes that matter.
constexpr double kAtBound = 1e-9;

// Whether the samples push an unknown, which is to change by `step`, to its bound or beyond.
bool IsAtBound(const Unknown& unknown, double value, double step, double scale) {
  if (!HasBounds(unknown)) return false;
  const auto is_beyond = [&](double room, double towards) { return room < std::max(kAtBound * scale, towards); };
  return is_beyond(value, -step) || (unknown.kind == Unknown::Kind::kRestitution && is_beyond(1 - value, step));
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
  std::size_t numbers = 0;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    lengths.push_back(residual.norm() / MedianLength(static_cast<int>(residual.size())));
    numbers += residual.size();
  });
  const std::size_t passed = std::min(lengths.size() * fit.num_fitted / numbers, lengths.size() - 1);
  std::ranges::nth_element(lengths, lengths.begin() + passed);
  return Median({lengths.begin() + passed, lengths.end()});
}

double OutlierShareOf(const FitProblem& problem, const FitResult& fit) {
  int outliers = 0, samples = 0;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    outliers += residual.norm() > problem.options->outlier;
    ++samples;
  });
  return static_cast<double>(outliers) / samples;
}

double ExtentOf(const FitProblem& problem, const FitResult& fit) {
  struct Boxes {
    Eigen::AlignedBox2d samples, motion;
  };
  std::map<std::pair<int, int>, Boxes> boxes;  // by recording and disc
  ForEachSample(problem, fit, [&](int s, int i, const Sample& sample, const Eigen::VectorXd&) {
    Boxes& at = boxes[{fit.point.segments[s].recording, sample.body}];
    at.samples.extend(sample.position);
    at.motion.extend(Vec2d(fit.motion[s].state[i].head<2>()));
  });
  double extent = 0;
  for (const auto& [key, at] : boxes) {
    extent = std::max(extent, std::min(at.samples.diagonal().norm(), at.motion.diagonal().norm()));
  }
  return extent;
}

Runs CountRuns(const FitProblem& problem, const FitResult& fit) {
  struct Signs {
    int above = 0, below = 0, runs = 0;
    bool last = false;
  };
  std::map<std::tuple<int, int, int>, Signs> all;  // by segment, disc and coordinate
  ForEachSample(problem, fit, [&](int s, int, const Sample& sample, const Eigen::VectorXd& residual) {
    if (residual.norm() > problem.options->outlier) return;
    for (int j = 0; j < 2; ++j) {
      Signs& signs = all[{s, sample.body, j}];
      const bool above = residual[j] > 0, first = signs.runs == 0;
      if (first || above != signs.last) ++signs.runs;
      signs.last = above;
      ++(above ? signs.above : signs.below);
    }
  });
  Runs runs;
  double variance = 0;
  for (const auto& [key, signs] : all) {
    const double n = signs.above + signs.below, product = 2.0 * signs.above * signs.below;
    runs.found += signs.runs;
    runs.signs += static_cast<int>(n);
    runs.expected += 1 + product / n;
    if (n > 1) variance += product * (product - n) / (n * n * (n - 1));
  }
  runs.deviation = std::sqrt(variance);
  return runs;
}

Openness FindOpenUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto count = static_cast<Eigen::Index>(problem.unknowns.size());
  Openness open{std::vector<Determination>(count, Determination::kDetermined), std::vector<std::vector<int>>(count)};
  if (problem.num_plain == 0) return open;
  const Information information = InformationOnUnknowns(problem, fit, loss_scale);
  const SymmetricEigen eigen = EigenOf(information.matrix);
  const double factor = ConfidenceOf(problem, fit, loss_scale).factor;
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
  const Eigen::VectorXd step = LeastNormSolution(information.matrix, -information.gradient);
  const Scene scene = problem.SceneAt(fit.point.coordinates);
  for (Eigen::Index i = 0; i < plain; ++i) {
    const Unknown& unknown = problem.unknowns[i];
    const double scale = ScaleOf(unknown, scene), value = ValueOf(unknown, scene);
    const bool determined = open.determination[i] == Determination::kDetermined;
    if (determined && IsAtBound(unknown, value, scale * step[i], scale)) {
      open.determination[i] = Determination::kAtBound;
    }
  }
  return open;
}

Confidence ConfidenceOf(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  double squares = 0, slopes = 0, squared_slopes = 0;
  int entries = 0;
  ForEachSample(problem, fit, [&](int, int, const Sample&, const Eigen::VectorXd& residual) {
    const double squared = residual.squaredNorm();
    const LossAt loss = EvaluateLoss(problem.options->loss, loss_scale, squared);
    squares += loss.rho[1] * loss.rho[1] * squared;
    // The derivative of the loss's force along the residual, and across it.
    const double along = loss.rho[1] + 2 * loss.rho[2] * squared, across = loss.rho[1];
    const auto others = static_cast<double>(residual.size() - 1);
    slopes += along + others * across;
    squared_slopes += along * along + others * across * across;
    entries += static_cast<int>(residual.size());
  });
  const double mean = slopes / entries, variance = squared_slopes / entries - mean * mean;
  const double correction = 1 + fit.num_fitted * variance / (entries * mean * mean);
  const double scatter = squares / std::max(1.0, slopes - fit.num_fitted);
  // What is learned has a prior, and takes no number of the samples.
  const auto learned = static_cast<double>(problem.unknowns.size()) - problem.num_plain;
  return {scatter, correction * correction * scatter / (mean * mean), slopes - fit.num_fitted + learned};
}

double StudentQuantile(double degrees) {
  // Abramowitz and Stegun, 26.7.5.
  const double z = 1.959963985, z2 = z * z, n = degrees;
  const double g1 = z * (z2 + 1) / 4;
  const double g2 = z * ((5 * z2 + 16) * z2 + 3) / 96;
  const double g3 = z * (((3 * z2 + 19) * z2 + 17) * z2 - 15) / 384;
  const double g4 = z * ((((79 * z2 + 776) * z2 + 1482) * z2 - 1920) * z2 - 945) / 92160;
  return z + (g1 + (g2 + (g3 + g4 / n) / n) / n) / n;
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
  const double factor = ConfidenceOf(problem, fit, loss_scale).factor;
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
