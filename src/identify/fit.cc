#include "identify/fit.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <algorithm>
#include <map>
#include <memory>
#include <utility>

#include "base/number_text.h"
#include "base/parallel_for.h"
#include "identify/unknowns.h"

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
  auto loss = MakeLoss(problem.options->loss, scale);
  if (!problem.drops_outliers) return loss;
  return std::make_unique<CutLoss>(std::move(loss), problem.options->outlier);
}

// The parameter blocks of a fit in one array, in the order in which the problem gets them.
class Blocks {
 public:
  Blocks(const FitProblem& problem, FitPoint* point) : problem_(problem), point_(*point), values_(point->coordinates) {
    for (const Segment& segment : point->segments) {
      for (const int body : problem.free_bodies) {
        const double* initial = &segment.initial[4 * body];
        values_.insert(values_.end(), initial, initial + 4);
      }
    }
  }

  double* coordinate(std::size_t u) { return &values_[u]; }
  // Returns the initial state of the `number`-th free disc.
  double* initial(std::size_t segment, std::size_t number) {
    return &values_[point_.coordinates.size() + 4 * (segment * problem_.free_bodies.size() + number)];
  }
  void CopyToPoint() {
    std::copy_n(values_.begin(), point_.coordinates.size(), point_.coordinates.begin());
    for (std::size_t s = 0; s < point_.segments.size(); ++s) {
      for (std::size_t b = 0; b < problem_.free_bodies.size(); ++b) {
        std::copy_n(initial(s, b), 4, &point_.segments[s].initial[4 * problem_.free_bodies[b]]);
      }
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
    for (MotionAtSamples& motion : motion_) motion.reason = "a parameter diverged from its start value";
    if (!IsNearStart()) return;
    const Scene scene = problem_.SceneAt(point_.coordinates);
    const std::optional<ImpactLaw> law = problem_.LawAt(point_.coordinates);
    const std::optional<EventFunctions> events = problem_.EventsAt(point_.coordinates);
    const int count = static_cast<int>(motion_.size());
    ParallelFor(std::min(NumThreads(problem_.options->threads), count), count, [&](int, int i) {
      const Segment& segment = point_.segments[i];
      motion_[i] =
          MoveThrough(problem_.contact, scene, segment, problem_.RequestOf(segment, law, events), with_jacobians);
    });
  }

  const std::vector<MotionAtSamples>& motion() const { return motion_; }
  int evaluations() const { return evaluations_; }

 private:
  // Whether the unknowns are near their start. A parameter that the data do not determine could go anywhere.
  bool IsNearStart() const {
    for (std::size_t u = 0; u < start_.size(); ++u) {
      if (HasBounds(problem_.unknowns[u]) && !(std::abs(point_.coordinates[u] - start_[u]) < kFarthest)) return false;
    }
    return true;
  }

  const FitProblem& problem_;
  const FitPoint& point_;
  Blocks& blocks_;
  const std::vector<double> start_;
  std::vector<MotionAtSamples> motion_;
  bool has_jacobians_ = false;
  int evaluations_ = 0;
};

// One sample. Blocks: each unknown, then those of the segment's free discs.
class SampleCost final : public ceres::CostFunction {
 public:
  SampleCost(const FitProblem& problem, const Motions& motions, const Segment& segment, int s, int i)
      : problem_(problem), motions_(motions), segment_(segment), s_(s), i_(i) {
    set_num_residuals(problem.SampleAt(segment, i).velocity ? 4 : 2);
    for (std::size_t u = 0; u < problem.unknowns.size(); ++u) mutable_parameter_block_sizes()->push_back(1);
    for (std::size_t b = 0; b < problem.free_bodies.size(); ++b) mutable_parameter_block_sizes()->push_back(4);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const MotionAtSamples& motion = motions_.motion()[s_];
    if (!motion.ok) return false;
    const Sample& sample = problem_.SampleAt(segment_, i_);
    const Eigen::VectorXd residual = ResidualOf(problem_, sample, motion.state[i_]);
    std::copy(residual.begin(), residual.end(), residuals);
    if (jacobians == nullptr) return true;
    const Eigen::VectorXd weights = WeightsOf(problem_, sample);
    const int num_unknowns = static_cast<int>(problem_.unknowns.size());
    for (std::size_t block = 0; block < parameter_block_sizes().size(); ++block) {
      if (jacobians[block] == nullptr) continue;
      const int b = static_cast<int>(block);
      const bool shared = b < num_unknowns;
      const int width = shared ? 1 : 4, column = shared ? b : num_unknowns + 4 * (b - num_unknowns);
      const double slope = shared ? SlopeAt(problem_.unknowns[b], parameters[b][0]) : 1;
      for (int row = 0; row < num_residuals(); ++row) {
        for (int j = 0; j < width; ++j) {
          jacobians[block][row * width + j] = slope * weights[row] * motion.derivative[i_](row, column + j);
        }
      }
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
  options.max_num_iterations = problem.options->max_iterations;
  // Weights of a network move along valleys in which the cost does not change.
  options.function_tolerance = LearnedStartOf(*problem.options) ? std::max(gain, kSmallGain) : gain;
  options.parameter_tolerance = 1e-10;
  options.gradient_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  options.linear_solver_type = num_segments == 1 ? ceres::DENSE_QR : ceres::SPARSE_NORMAL_CHOLESKY;
  return options;
}

// Adds a prior, which keeps learned parameters near their start if the data do not determine them.
void AddPrior(const FitProblem& problem, Blocks* blocks, ceres::Problem* ceres_problem) {
  const std::optional<LearnedStart> learned = LearnedStartOf(*problem.options);
  if (!learned) return;
  const ceres::Matrix weight = ceres::Matrix::Constant(1, 1, 1 / learned->spread);
  for (std::size_t i = 0; i < learned->parameters.size(); ++i) {
    const ceres::Vector start = ceres::Vector::Constant(1, learned->parameters[i]);
    double* coordinate = blocks->coordinate(problem.num_plain + i);
    ceres_problem->AddResidualBlock(new ceres::NormalPrior(weight, start), nullptr, coordinate);
  }
}

// Returns the number of unknowns that are not held, and of initial states; at most the numbers measured of a disc.
int NumFitted(const FitProblem& problem, const FitPoint& point, const std::vector<bool>& held) {
  auto count = static_cast<int>(problem.unknowns.size() - std::ranges::count(held, true));
  for (const Segment& segment : point.segments) {
    std::map<int, int> measured;  // numbers of each disc
    for (int i = 0; i < segment.last - segment.first; ++i) {
      const Sample& sample = problem.SampleAt(segment, i);
      measured[sample.body] += sample.velocity ? 4 : 2;
    }
    for (const int body : problem.free_bodies) count += std::min(4, measured[body]);
  }
  return count;
}

}  // namespace

Scene FitProblem::SceneAt(const std::vector<double>& coordinates) const {
  Scene at = scene;
  for (std::size_t u = 0; u < unknowns.size(); ++u)
    SetValue(unknowns[u], FromCoordinate(unknowns[u], coordinates[u]), &at);
  return at;
}

std::optional<ImpactLaw> FitProblem::LawAt(const std::vector<double>& coordinates) const {
  std::optional<ImpactLaw> law = options->law;
  if (law) law->parameters.assign(coordinates.begin() + num_plain, coordinates.end());
  return law;
}

std::optional<EventFunctions> FitProblem::EventsAt(const std::vector<double>& coordinates) const {
  std::optional<EventFunctions> events = options->events;
  if (events) events->parameters.assign(coordinates.begin() + num_plain, coordinates.end());
  return events;
}

std::optional<LearnedStart> LearnedStartOf(const IdentifyOptions& options) {
  if (options.law) return LearnedStart{options.law->parameters, options.law->spread};
  if (options.events) return LearnedStart{options.events->parameters, options.events->spread};
  return std::nullopt;
}

Eigen::VectorXd WeightsOf(const FitProblem& problem, const Sample& sample) {
  Eigen::VectorXd weights(sample.velocity ? 4 : 2);
  weights.head(2).setConstant(1 / (sample.sigma > 0 ? sample.sigma : problem.sigma));
  if (sample.velocity) {
    weights.tail(2).setConstant(1 / (sample.sigma_velocity > 0 ? sample.sigma_velocity : problem.sigma_velocity));
  }
  return weights;
}

Eigen::VectorXd ResidualOf(const FitProblem& problem, const Sample& sample, const Eigen::Vector4d& state) {
  Eigen::VectorXd residual = WeightsOf(problem, sample);
  residual.head(2).array() *= (state.head<2>() - sample.position).array();
  if (sample.velocity) residual.tail(2).array() *= (state.tail<2>() - *sample.velocity).array();
  return residual;
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
    for (std::size_t b = 0; b < problem.free_bodies.size(); ++b) of_segment.push_back(blocks.initial(s, b));
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
  IterationReport report(*problem.options);
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
  for (const MotionAtSamples& motion : result.motion) {
    if (motion.ok) continue;
    result.ok = false;
    result.reason = motion.reason;
  }
  result.evaluations = motions.evaluations();
  return result;
}

}  // namespace saltus
