#include "identify/fit.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <algorithm>
#include <map>
#include <memory>
#include <utility>

#include "base/number_text.h"
#include "base/parallel_for.h"

namespace saltus {
namespace {

constexpr double kFarthest = 7;  // that a bounded unknown may go from its start, in its coordinate: 1000 times as much
constexpr double kSmallGain = 1e-5;  // of the cost, below which a law is learned: far below what noise does to it

// A loss up to a length of residuals, beyond which it is constant.
class CutLoss final : public ceres::LossFunction {
 public:
  CutLoss(std::unique_ptr<ceres::LossFunction> loss, double cut) : loss_(std::move(loss)), cut_(cut * cut) {}
  void Evaluate(double squared, double rho[3]) const override {
    loss_->Evaluate(std::min(squared, cut_), rho);
    if (squared > cut_) rho[1] = rho[2] = 0;
  }

 private:
  const std::unique_ptr<ceres::LossFunction> loss_;
  const double cut_;
};

std::unique_ptr<ceres::LossFunction> MakeLoss(RobustLoss loss, double scale) {
  switch (loss) {
    case RobustLoss::kHuber:
      return std::make_unique<ceres::HuberLoss>(scale);
    case RobustLoss::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(scale);
    case RobustLoss::kNone:
      break;
  }
  return std::make_unique<ceres::TrivialLoss>();
}
std::unique_ptr<ceres::LossFunction> MakeLoss(const FitProblem& problem, double scale) {
  auto loss = MakeLoss(problem.options.loss, scale);
  if (!problem.drops_outliers) return loss;
  return std::make_unique<CutLoss>(std::move(loss), problem.options.outlier);
}

// The parameter blocks of a fit in one array: each unknown, then the free initial numbers of each segment.
class Blocks {
 public:
  Blocks(const FitProblem& problem, FitPoint* point) : problem_(problem), point_(*point), values_(point->coordinates) {
    for (const Segment& segment : point->segments) {
      for (const auto& free : problem.free_initial) values_.push_back(segment.initial[free.number]);
    }
  }

  double* coordinate(std::size_t u) { return &values_[u]; }
  double* initial(std::size_t segment) {
    return values_.data() + point_.coordinates.size() + segment * problem_.free_initial.size();
  }
  void CopyToPoint() {
    std::copy_n(values_.begin(), point_.coordinates.size(), point_.coordinates.begin());
    for (std::size_t s = 0; s < point_.segments.size(); ++s) {
      const double* from = initial(s);
      for (const auto& free : problem_.free_initial) point_.segments[s].initial[free.number] = *from++;
    }
  }

 private:
  const FitProblem& problem_;
  FitPoint& point_;
  std::vector<double> values_;
};

// The motion of all segments at a point, for all costs at once.
class Motions final : public ceres::EvaluationCallback {
 public:
  Motions(const FitProblem& problem, FitPoint* point, Blocks* blocks)
      : problem_(problem), point_(*point), blocks_(*blocks), start_(point->coordinates) {}

  void PrepareForEvaluation(bool with_jacobians, bool is_new) override {
    if (!is_new && (has_jacobians_ || !with_jacobians) && !motion_.empty()) return;
    Compute(with_jacobians);
  }

  void Compute(bool with_jacobians) {
    ++evaluations_;
    blocks_.CopyToPoint();
    has_jacobians_ = with_jacobians;
    motion_.assign(point_.segments.size(), {});
    for (FitMotion& motion : motion_) motion.reason = "a parameter diverged from its start value";
    if (!IsNearStart()) return;
    const std::vector<double> values = problem_.ValuesAt(point_.coordinates);
    const int count = static_cast<int>(motion_.size());
    ParallelFor(std::min(NumThreads(problem_.options.threads), count), count, [&](int, int i) {
      motion_[i] = problem_.model->Move(values, point_.segments[i], with_jacobians);
    });
  }

  const std::vector<FitMotion>& motion() const { return motion_; }
  int evaluations() const { return evaluations_; }

 private:
  // Whether the unknowns are near their start. A parameter that the data do not determine could go anywhere.
  bool IsNearStart() const {
    for (std::size_t u = 0; u < start_.size(); ++u) {
      if (problem_.unknowns[u].HasBounds() && !(std::abs(point_.coordinates[u] - start_[u]) < kFarthest)) return false;
    }
    return true;
  }

  const FitProblem& problem_;
  const FitPoint& point_;
  Blocks& blocks_;
  const std::vector<double> start_;
  std::vector<FitMotion> motion_;
  bool has_jacobians_ = false;
  int evaluations_ = 0;
};

// One sample. Blocks: each unknown, then the free initial numbers of the segment, if there are any.
class SampleCost final : public ceres::CostFunction {
 public:
  SampleCost(const FitProblem& problem, const Motions& motions, const Segment& segment, int s, int i)
      : problem_(problem), motions_(motions), segment_(segment), s_(s), i_(i) {
    set_num_residuals(static_cast<int>(problem.SampleAt(segment, i).size()));
    mutable_parameter_block_sizes()->assign(problem.unknowns.size(), 1);
    if (!problem.free_initial.empty()) {
      mutable_parameter_block_sizes()->push_back(static_cast<int>(problem.free_initial.size()));
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const FitMotion& motion = motions_.motion()[s_];
    if (!motion.ok) return false;
    const Eigen::VectorXd weights = WeightsOf(problem_, problem_.SampleAt(segment_, i_));
    Eigen::Map<Eigen::VectorXd>(residuals, weights.size()) = weights.cwiseProduct(motion.miss[i_]);
    if (jacobians == nullptr) return true;
    for (std::size_t b = 0; b < parameter_block_sizes().size(); ++b) {
      if (jacobians[b] == nullptr) continue;
      const double slope = b < problem_.unknowns.size() ? problem_.unknowns[b].SlopeAt(parameters[b][0]) : 1;
      ceres::MatrixRef(jacobians[b], num_residuals(), parameter_block_sizes()[b]) =
          slope * (weights.asDiagonal() *
                   motion.derivative[i_].middleCols(static_cast<Eigen::Index>(b), parameter_block_sizes()[b]));
    }
    return true;
  }

 private:
  const FitProblem& problem_;
  const Motions& motions_;
  const Segment& segment_;
  const int s_, i_;
};

// Reports each iteration, and stops if that is asked for.
class IterationReport final : public ceres::IterationCallback {
 public:
  explicit IterationReport(const IdentifyOptions& options) : options_(options) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (options_.status) {
      options_.status("iteration " + std::to_string(summary.iteration) + ", cost " + ToText(summary.cost, 6));
    }
    return options_.stop && options_.stop() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

 private:
  const IdentifyOptions& options_;
};

ceres::Solver::Options SolverOptionsOf(const FitProblem& problem, std::size_t num_segments, double gain) {
  ceres::Solver::Options options;
  options.max_num_iterations = problem.options.max_iterations;
  // Weights of a network move along valleys in which the cost does not change.
  options.function_tolerance = problem.learned ? std::max(gain, kSmallGain) : gain;
  options.parameter_tolerance = 1e-10;
  options.gradient_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  options.linear_solver_type = num_segments == 1 ? ceres::DENSE_QR : ceres::SPARSE_NORMAL_CHOLESKY;
  return options;
}

void AddPrior(const FitProblem& problem, Blocks* blocks, ceres::Problem* ceres_problem) {
  if (!problem.learned) return;
  const ceres::Matrix weight = ceres::Matrix::Constant(1, 1, 1 / problem.learned->spread);
  double* coordinate = blocks->coordinate(problem.num_plain());
  for (const double parameter : problem.learned->parameters) {
    const ceres::Vector start = ceres::Vector::Constant(1, parameter);
    ceres_problem->AddResidualBlock(new ceres::NormalPrior(weight, start), nullptr, coordinate++);
  }
}

// Returns the number of unknowns that are not held, and of initial states; at most the numbers measured of a quantity.
int NumFitted(const FitProblem& problem, const FitPoint& point, const std::vector<bool>& held) {
  auto count = static_cast<int>(problem.unknowns.size() - std::ranges::count(held, true));
  for (const Segment& segment : point.segments) {
    std::map<int, int> measured, free;  // numbers of each quantity
    for (int i = 0; i < segment.last - segment.first; ++i) {
      const FitSample& sample = problem.SampleAt(segment, i);
      measured[sample.quantity] += static_cast<int>(sample.size());
    }
    for (const auto& one : problem.free_initial) ++free[one.quantity];
    for (const auto& [quantity, numbers] : free) count += std::min(numbers, measured[quantity]);
  }
  return count;
}

}  // namespace

std::vector<double> FitProblem::ValuesAt(const std::vector<double>& coordinates) const {
  std::vector<double> values;
  for (std::size_t u = 0; u < unknowns.size(); ++u) values.push_back(unknowns[u].FromCoordinate(coordinates[u]));
  return values;
}

Eigen::VectorXd WeightsOf(const FitProblem& problem, const FitSample& sample) {
  return (sample.sigma.array() > 0).select(sample.sigma, problem.sigma * sample.unit).cwiseInverse();
}

LossAt EvaluateLoss(const FitProblem& problem, double scale, double squared) {
  LossAt at;
  MakeLoss(problem, scale)->Evaluate(squared, at.rho);
  return at;
}

FitResult MinimizeFrom(const FitProblem& problem, const FitPoint& start, double loss_scale,
                       const std::vector<bool>& held, double gain) {
  FitResult result;
  result.point = start;
  FitPoint& point = result.point;
  Blocks blocks(problem, &point);
  Motions motions(problem, &point, &blocks);
  const auto loss = MakeLoss(problem, loss_scale);
  ceres::Problem::Options problem_options;
  problem_options.evaluation_callback = &motions;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem ceres_problem(problem_options);
  for (std::size_t s = 0; s < point.segments.size(); ++s) {
    const Segment& segment = point.segments[s];
    std::vector<double*> of_segment;
    for (std::size_t u = 0; u < point.coordinates.size(); ++u) of_segment.push_back(blocks.coordinate(u));
    if (!problem.free_initial.empty()) of_segment.push_back(blocks.initial(s));
    for (int i = 0; i < segment.last - segment.first; ++i) {
      ceres_problem.AddResidualBlock(
          new SampleCost(problem, motions, segment, static_cast<int>(s), i), loss.get(), of_segment);
    }
  }
  AddPrior(problem, &blocks, &ceres_problem);
  for (std::size_t u = 0; u < held.size(); ++u) {
    if (held[u]) ceres_problem.SetParameterBlockConstant(blocks.coordinate(u));
  }
  ceres::Solver::Options options = SolverOptionsOf(problem, point.segments.size(), gain);
  IterationReport report(problem.options);
  options.callbacks.push_back(&report);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &ceres_problem, &summary);
  motions.Compute(/*with_jacobians=*/true);
  result.ok = summary.IsSolutionUsable();
  result.converged = summary.termination_type == ceres::CONVERGENCE;
  result.reason = summary.message;
  result.cost = summary.final_cost;
  result.num_fitted = NumFitted(problem, point, held);
  result.iterations = summary.num_successful_steps + summary.num_unsuccessful_steps;
  result.motion = motions.motion();
  for (const FitMotion& motion : result.motion) {
    if (motion.ok) continue;
    result.ok = false;
    result.reason = motion.reason;
  }
  result.evaluations = motions.evaluations();
  return result;
}

}  // namespace saltus
