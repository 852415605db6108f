#include "identify/statistics.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "base/linear_algebra.h"
#include "base/statistics.h"

namespace saltus {
namespace {

// A direction of parameters with a larger standard error, in units of a change that matters, is not determined.
constexpr double kOpen = 0.5;
// The share of a parameter in such directions from which on it is not determined either.
constexpr double kShare = 0.04;
// The number of standard deviations by which a mean square may exceed that of noise.
constexpr double kMostMeanSquare = 2.5;
// The degrees of freedom that a stated sigma is worth.
constexpr double kStated = 20;
// The answers of either kind from which on the number of runs is about normal.
constexpr int kNormal = 10;
// The least eigenvalue of information, over the largest, of full rank.
constexpr double kRank = 1e-14;

// The median length of a vector of as many standard normal numbers.
double MedianLength(Eigen::Index entries) {
  constexpr double kLengths[] = {0.674489750, 1.177410023, 1.538172254, 1.832132867};
  return kLengths[entries - 1];
}

// Returns the changes of the unknowns that matter, at the point of a fit.
Eigen::VectorXd ScalesOf(const FitProblem& problem, const FitResult& fit) {
  const std::vector<double> values = problem.ValuesAt(fit.point.coordinates);
  Eigen::VectorXd scales(values.size());
  for (std::size_t u = 0; u < values.size(); ++u) {
    scales[static_cast<Eigen::Index>(u)] = problem.unknowns[u].ScaleAt(values[u]);
  }
  return scales;
}

// Derivatives of a sample's standardised residual, those by unknowns per change that matters, with the residual itself
// behind those by unknowns that are not of a law.
Eigen::MatrixXd ScaledJacobian(const FitProblem& problem, const Eigen::VectorXd& scales, const FitSample& sample,
                               const Eigen::MatrixXd& derivative, const Eigen::VectorXd& residual) {
  Eigen::MatrixXd jacobian = WeightsOf(problem, sample).asDiagonal() * derivative;
  jacobian.leftCols(scales.size()) *= scales.asDiagonal();
  const Eigen::Index others = jacobian.cols() - problem.num_plain();
  Eigen::MatrixXd all(jacobian.rows(), jacobian.cols() + 1);
  all << jacobian.leftCols(problem.num_plain()), residual, jacobian.rightCols(others);
  return all;
}

// The information on the unknowns other than a law's, and the gradient of the cost by them, after elimination of the
// law's unknowns and the initial states. Per change that matters.
struct Information {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd gradient;
};
Information InformationOnUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto num_unknowns = static_cast<Eigen::Index>(problem.unknowns.size());
  const Eigen::VectorXd scales = ScalesOf(problem, fit);
  const Eigen::Index columns = problem.num_columns() + 1;
  std::vector<Eigen::MatrixXd> normal(fit.point.segments.size(), Eigen::MatrixXd::Zero(columns, columns));
  ForEachSample(problem, fit, [&](int s, int i, const FitSample& sample, const Eigen::VectorXd& residual) {
    const double weight = EvaluateLoss(problem, loss_scale, residual.squaredNorm()).rho[1];
    AddGram(weight, ScaledJacobian(problem, scales, sample, fit.motion[s].derivative[i], residual), &normal[s]);
  });
  const Eigen::Index plain = problem.num_plain();
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(num_unknowns + 1, num_unknowns + 1);
  for (const Eigen::MatrixXd& one : normal) all += SchurComplement(one, num_unknowns + 1);
  if (const auto& learned = problem.learned) {
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

// The distance from a bound within which an unknown is at it, in changes that matter.
constexpr double kAtBound = 1e-9;

// Whether the samples push an unknown, which is to change by `step`, to its bound or beyond.
bool IsAtBound(const FitUnknown& unknown, double value, double step, double scale) {
  const auto is_beyond = [&](double room, double towards) { return room < std::max(kAtBound * scale, towards); };
  return is_beyond(value - unknown.low, -step) || is_beyond(unknown.high - value, step);
}

// Sums over numbers of samples: the force of the loss, which is its derivative by the residual, squared, and the
// derivative of this force, the slope.
struct LossSums {
  int entries = 0;
  double squares = 0, slopes = 0, squared_slopes = 0;

  void Add(const LossAt& loss, double squared, int size) {
    // Along the residual, and across it.
    const double along = loss.rho[1] + 2 * loss.rho[2] * squared, across = loss.rho[1];
    squares += loss.rho[1] * loss.rho[1] * squared;
    slopes += along + (size - 1) * across;
    squared_slopes += along * along + (size - 1) * across * across;
    entries += size;
  }
  double Slope() const { return slopes / std::max(1, entries); }
};

// The mean slope and the mean square of the force of a sample's numbers.
struct LossMeans {
  double slope = 1, square = 1;
};

// The covariance of ConfidenceOf(), for means of `inner` samples and of outliers.
Eigen::MatrixXd CovarianceOf(const FitProblem& problem, const FitResult& fit, const std::vector<bool>& held,
                             const LossMeans& inner, const LossMeans& outer) {
  const Eigen::VectorXd scales = ScalesOf(problem, fit);
  std::vector<Eigen::Index> columns;  // of unknowns that are not held, per change that matters
  for (Eigen::Index u = 0; u < scales.size(); ++u) {
    if (held.empty() || !held[u]) columns.push_back(u);
  }
  const auto count = static_cast<Eigen::Index>(columns.size()), all = scales.size();
  const auto width = count + static_cast<Eigen::Index>(problem.free_initial.size());
  if (count == 0) return {};
  const auto for_each = [&](const auto& visit) {
    ForEachSample(problem, fit, [&](int s, int i, const FitSample& sample, const Eigen::VectorXd& residual) {
      const Eigen::VectorXd weights = WeightsOf(problem, sample);
      const Eigen::MatrixXd by = weights.asDiagonal() * fit.motion[s].derivative[i];
      Eigen::MatrixXd jacobian(weights.size(), width);
      jacobian.leftCols(count) = by.leftCols(all)(Eigen::all, columns) * scales(columns).asDiagonal();
      jacobian.rightCols(width - count) = by.rightCols(width - count);
      visit(s, residual.norm() > problem.options.outlier ? outer : inner, jacobian);
    });
  };
  std::vector<Eigen::MatrixXd> normal(fit.point.segments.size(), Eigen::MatrixXd::Zero(width, width));
  for_each([&](int s, const LossMeans& mean, const Eigen::MatrixXd& jacobian) {
    AddGram(mean.slope, jacobian, &normal[s]);
  });
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(count, count), B = A;
  std::vector<Eigen::MatrixXd> eliminated;  // initial states by unknowns
  for (const Eigen::MatrixXd& one : normal) {
    A += SchurComplement(one, count);
    eliminated.push_back(LeastNormSolutions(one.bottomRightCorner(width - count, width - count),
                                            one.bottomLeftCorner(width - count, count)));
  }
  for_each([&](int s, const LossMeans& mean, const Eigen::MatrixXd& jacobian) {
    AddGram(mean.square, jacobian.leftCols(count) - jacobian.rightCols(width - count) * eliminated[s], &B);
  });
  // The prior of what is learned counts as a number that was measured.
  if (const auto& learned = problem.learned) {
    for (Eigen::Index c = 0; c < count; ++c) {
      if (columns[c] < problem.num_plain()) continue;
      const double weight = std::pow(scales[columns[c]] / learned->spread, 2);
      A(c, c) += inner.slope * weight;
      B(c, c) += inner.square * weight;
    }
  }
  const SymmetricEigen eigen = EigenOf(A);
  if (!(eigen.values[0] > kRank * eigen.values[count - 1])) return {};
  const Eigen::MatrixXd inverse = eigen.vectors * eigen.values.cwiseInverse().asDiagonal() * eigen.vectors.transpose();
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(all, all);
  covariance(columns, columns) = scales(columns).asDiagonal() * (inverse * B * inverse) * scales(columns).asDiagonal();
  return covariance;
}

// The probability of outliers that follow each other by chance: that of kSystematic standard deviations.
constexpr double kByChance = 1.35e-3;
// The outliers in a row from which on their common sign counts.
constexpr std::size_t kLongRun = 3;

double LogBinomial(int n, int k) { return std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0); }

// Returns the probability that `some` of `all` samples, in random order, form at most so many runs (Stevens 1939).
double ProbabilityOfRuns(int some, int all, int most) {
  double probability = 0;
  for (int runs = 1; runs <= std::min({most, some, all - some + 1}); ++runs) {
    probability +=
        std::exp(LogBinomial(some - 1, runs - 1) + LogBinomial(all - some + 1, runs) - LogBinomial(all, some));
  }
  return probability;
}

// Counts runs of the same answer.
struct RunCounter {
  int yes = 0, no = 0, runs = 0;
  bool last = false;

  void Add(bool answer) {
    if (runs == 0 || answer != last) ++runs;
    last = answer;
    ++(answer ? yes : no);
  }
};
Runs RunsOf(const RunCounter& at) {
  const double n = at.yes + at.no, product = 2.0 * at.yes * at.no;
  const double variance = n > 1 ? product * (product - n) / (n * n * (n - 1)) : 0;
  return {at.runs, at.yes + at.no, 1 + product / n, std::sqrt(variance)};
}

// Returns the sum; or one of the counts, if the sum hides that it is systematic beside so many others.
template <typename Key>
Runs SumOf(const std::map<Key, RunCounter>& all) {
  Runs sum;
  double variance = 0;
  for (const auto& [key, at] : all) {
    const Runs one = RunsOf(at);
    sum.found += one.found;
    sum.signs += one.signs;
    sum.expected += one.expected;
    variance += one.deviation * one.deviation;
  }
  sum.deviation = std::sqrt(variance);
  if (sum.Systematic()) return sum;
  // The probability of more than d deviations is about exp(-d^2 / 2).
  const double most = std::sqrt(kSystematic * kSystematic + 2 * std::log(std::max<std::size_t>(1, all.size())));
  for (const auto& [key, at] : all) {
    const Runs one = RunsOf(at);
    if (std::min(at.yes, at.no) >= kNormal && one.found < one.expected - most * one.deviation) return one;
  }
  return sum;
}

}  // namespace

double MisfitOf(const FitProblem& problem, const FitResult& fit) {
  std::vector<double> lengths;
  std::size_t numbers = 0;
  ForEachSample(problem, fit, [&](int, int, const FitSample&, const Eigen::VectorXd& residual) {
    lengths.push_back(residual.norm() / MedianLength(residual.size()));
    numbers += residual.size();
  });
  const std::size_t passed = std::min(lengths.size() * fit.num_fitted / numbers, lengths.size() - 1);
  std::ranges::nth_element(lengths, lengths.begin() + passed);
  return Median({lengths.begin() + passed, lengths.end()});
}

double OutlierShareOf(const FitProblem& problem, const FitResult& fit) {
  int outliers = 0, samples = 0;
  ForEachSample(problem, fit, [&](int, int, const FitSample&, const Eigen::VectorXd& residual) {
    outliers += residual.norm() > problem.options.outlier;
    ++samples;
  });
  return static_cast<double>(outliers) / samples;
}

double ExtentOf(const FitProblem& problem, const FitResult& fit) {
  struct Box {
    Eigen::VectorXd low, high;
    void Extend(const Eigen::VectorXd& point) {
      low = low.size() == 0 ? point : low.cwiseMin(point);
      high = high.size() == 0 ? point : high.cwiseMax(point);
    }
    double Diagonal() const { return (high - low).norm(); }
  };
  struct Boxes {
    Box samples, motion;
  };
  std::map<std::pair<int, int>, Boxes> boxes;  // by recording and quantity
  ForEachSample(problem, fit, [&](int s, int i, const FitSample& sample, const Eigen::VectorXd&) {
    Boxes& at = boxes[{fit.point.segments[s].recording, sample.quantity}];
    const auto add = [&](const Eigen::VectorXd& to, Box* box) {
      box->Extend(to.cwiseQuotient(sample.unit).head(sample.num_positions));
    };
    add(sample.value, &at.samples);
    add(sample.value + fit.motion[s].miss[i], &at.motion);
  });
  double extent = 0;
  for (const auto& [key, at] : boxes) {
    extent = std::max(extent, std::min(at.samples.Diagonal(), at.motion.Diagonal()));
  }
  return extent;
}

Runs CountRuns(const FitProblem& problem, const FitResult& fit) {
  std::map<std::tuple<int, int, Eigen::Index>, RunCounter> all;  // by segment, quantity and coordinate
  ForEachSample(problem, fit, [&](int s, int, const FitSample& sample, const Eigen::VectorXd& residual) {
    if (residual.norm() > problem.options.outlier) return;
    for (Eigen::Index j = 0; j < sample.num_positions; ++j) all[{s, sample.quantity, j}].Add(residual[j] > 0);
  });
  return SumOf(all);
}

OutlierRuns FindOutlierRuns(const FitProblem& problem, const FitResult& fit) {
  std::map<int, std::vector<Eigen::VectorXd>> residuals;  // by quantity; zero of samples that are no outliers
  ForEachSample(problem, fit, [&](int, int, const FitSample& sample, const Eigen::VectorXd& residual) {
    const double counts = residual.norm() > problem.options.outlier;
    residuals[sample.quantity].push_back(counts * residual.head(sample.num_positions));
  });
  std::size_t samples = 0, outliers = 0, runs = 0, one_sided = 0;
  double largest = 0;
  for (const auto& [quantity, all] : residuals) {
    samples += all.size();
    for (std::size_t i = 0; i < all.size();) {
      std::size_t end = i;
      Eigen::VectorXd signs = Eigen::VectorXd::Zero(all[i].size());
      for (; end < all.size() && !all[end].isZero(0); ++end) {
        largest = std::max(largest, all[end].norm());
        signs += all[end].cwiseSign();
      }
      const std::size_t length = end - i;
      i = end + 1;
      if (length == 0) continue;
      ++runs;
      outliers += length;
      const bool has_one_sign = signs.cwiseAbs().maxCoeff() == static_cast<double>(length);
      if (length >= kLongRun && has_one_sign) one_sided += length;
    }
  }
  if (outliers == 0) return {};
  const double chance =
      ProbabilityOfRuns(static_cast<int>(outliers), static_cast<int>(samples), static_cast<int>(runs));
  const bool are_one_sided = 2 * one_sided > outliers;
  return {chance < kByChance, largest, are_one_sided};
}

Openness FindOpenUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  const auto count = static_cast<Eigen::Index>(problem.unknowns.size());
  Openness open{std::vector<Determination>(count, Determination::kDetermined), std::vector<std::vector<int>>(count)};
  if (problem.num_plain() == 0) return open;
  const Information information = InformationOnUnknowns(problem, fit, loss_scale);
  const SymmetricEigen eigen = EigenOf(information.matrix);
  const double scatter = ConfidenceOf(problem, fit, loss_scale).scatter;
  const Eigen::Index plain = problem.num_plain();
  Eigen::MatrixXd share = Eigen::MatrixXd::Zero(plain, plain);  // the projection on what is open
  for (Eigen::Index k = 0; k < plain; ++k) {
    if (eigen.values[k] * kOpen * kOpen > scatter) continue;
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
  const std::vector<double> values = problem.ValuesAt(fit.point.coordinates);
  for (Eigen::Index i = 0; i < plain; ++i) {
    const FitUnknown& unknown = problem.unknowns[i];
    const double value = values[i], scale = unknown.ScaleAt(value);
    const bool determined = open.determination[i] == Determination::kDetermined;
    if (determined && IsAtBound(unknown, value, scale * step[i], scale)) {
      open.determination[i] = Determination::kAtBound;
    }
  }
  return open;
}

Confidence ConfidenceOf(const FitProblem& problem, const FitResult& fit, double loss_scale,
                        const std::vector<bool>& held) {
  LossSums inner, outer;
  double squares = 0;  // without outliers, and without the loss
  ForEachSample(problem, fit, [&](int, int, const FitSample&, const Eigen::VectorXd& residual) {
    const double squared = residual.squaredNorm();
    const bool is_outlier = residual.norm() > problem.options.outlier;
    if (!is_outlier) squares += squared;
    (is_outlier ? outer : inner)
        .Add(EvaluateLoss(problem, loss_scale, squared), squared, static_cast<int>(residual.size()));
  });
  // Learned parameters have a prior, and so take no degrees of freedom of the samples.
  const auto learned = static_cast<double>(problem.unknowns.size()) - problem.num_plain();
  const int left = inner.entries - fit.num_fitted;
  Confidence confidence;
  confidence.scatter = squares / std::max(1, left);
  confidence.degrees = confidence.interval_degrees = left + learned;
  // The standard deviation of the mean square of normal errors is sqrt(2 / degrees).
  confidence.is_noise =
      confidence.degrees > 0 && confidence.scatter <= 1 + kMostMeanSquare * std::sqrt(2 / confidence.degrees);
  const double slope = inner.Slope();
  double mean = inner.squares / std::max(1, left);  // of the squared force
  if (confidence.is_noise && problem.states_sigma) {
    mean = (kStated * slope + inner.squares) / (kStated + std::max(1, left));
    confidence.interval_degrees += kStated;
  }
  if (!(slope > 0)) return confidence;
  const double variance = inner.squared_slopes / inner.entries - slope * slope;
  const double correction = 1 + fit.num_fitted * variance / (inner.entries * slope * slope);
  const LossMeans inside{slope, correction * correction * mean};
  const LossMeans outside{std::max(0.0, outer.Slope()), outer.squares / std::max(1, outer.entries)};
  confidence.covariance = CovarianceOf(problem, fit, held, inside, outside);
  return confidence;
}

double StudentQuantile(double degrees) {
  // The formula 26.7.5 of Abramowitz and Stegun for quantiles of Student's t.
  const double z = 1.959963985, z2 = z * z, n = degrees;
  const double g1 = z * (z2 + 1) / 4;
  const double g2 = z * ((5 * z2 + 16) * z2 + 3) / 96;
  const double g3 = z * (((3 * z2 + 19) * z2 + 17) * z2 - 15) / 384;
  const double g4 = z * ((((79 * z2 + 776) * z2 + 1482) * z2 - 1920) * z2 - 945) / 92160;
  return z + (g1 + (g2 + (g3 + g4 / n) / n) / n) / n;
}

}  // namespace saltus
