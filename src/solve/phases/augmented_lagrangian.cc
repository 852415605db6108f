#include "solve/phases/augmented_lagrangian.h"

#include <ceres/crs_matrix.h>
#include <ceres/solver.h>

#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "base/linear_algebra.h"
#include "base/statistics.h"
#include "solve/phases/interior_point.h"
#include "solve/phases/least_multipliers.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double kWidth = 1e-6;      // of differences, relative to the size of a variable
constexpr double kGrowth = 10;       // of the weights, from solve to solve
constexpr double kStalled = 0.5;     // of the violation that the solve before has left
constexpr double kHopeless = 0.1;    // of a row after kManyIterations, where a motion is one of many
constexpr int kManyIterations = 50;  // of all solves together
constexpr int kMostStalled = 2;      // solves one after the other, where a motion is one of many
constexpr double kNearlyMet = 1e-3;  // a larger violation stalls where constraints cannot be met, not for multipliers
constexpr int kMostEstimates = 3;    // of multipliers, where solves stall: each may cost as much as a solve
constexpr double kShareOfInequalities = 0.01;  // of the weight of equalities that follows the costs
constexpr int kShortPhase = 332;               // steps
constexpr double kLeastGain = 0.01;            // of the costs
constexpr double kLeastCost = 0.025;           // of those of the start: smaller ones ahead count as these
constexpr double kPredictingWeight = 1e7;      // of linearized equalities that a step meets
constexpr double kNoWeight = 1e-300;
// A weight times the rounding of a row is an error of its multiplier: weights grow to this multiple of the largest
// multiplier, and where that is small they need no more to dominate the costs.
constexpr double kLargestWeight = 1e7;
constexpr double kNearlySameCost = 1e-5;  // so near to an optimum steps need no damping
constexpr double kExactGain = 0.1;        // of the gain that ends solves: with multipliers from the conditions
constexpr double kSameCost = 1e-10;       // relative change of the cost from solve to solve
constexpr double kNoCost = 1e-18;  // relative to the cost at the start: squares that become zero change by all they are
// The first solve is nearly linear, and damping would only slow it down.
constexpr double kFirstRadius = 1e8;  // of the trust region, in the first solve
constexpr double kLastRadius = 1e16;  // near an optimum: steps are those of Gauss-Newton
// The relative changes of the cost that end the first solves, which only prepare the next.
constexpr double kFirstGains[] = {1e-3, 1e-6};
constexpr int kLast = static_cast<int>(std::size(kFirstGains));
constexpr int kAccurate = 1;        // the first solve whose minimum tells of the costs of an optimum
constexpr double kGainsAhead = 10;  // of the last iteration of a solve: what is left to its minimum, at most

Eigen::SparseMatrix<double, Eigen::RowMajor> SparseRowsOf(const ceres::CRSMatrix& matrix) {
  return Eigen::Map<const Eigen::SparseMatrix<double, Eigen::RowMajor>>(matrix.num_rows,
                                                                        matrix.num_cols,
                                                                        static_cast<Eigen::Index>(matrix.values.size()),
                                                                        matrix.rows.data(),
                                                                        matrix.cols.data(),
                                                                        matrix.values.data());
}

ceres::Problem::Options ProblemOptions() {
  ceres::Problem::Options options;
  options.disable_all_safety_checks = true;  // they cost as much as the solve
  return options;
}

}  // namespace

// A function whose constrained rows are weighted and shifted by their multipliers.
class AugmentedLagrangian::Weighted final : public ceres::CostFunction {
 public:
  Weighted(std::unique_ptr<ceres::CostFunction> function, const RowRoles& roles, const Weights* weights)
      : function_(std::move(function)),
        roles_(roles),
        weights_(weights),
        multipliers_(roles.equalities + roles.inequalities, 0.0),
        references_(roles.values, NAN) {
    // The rows of the curvature come last, are zero, and have its root as their Jacobian.
    set_num_residuals(function_->num_residuals() + (roles.are_curved ? function_->parameter_block_sizes()[0] : 0));
    *mutable_parameter_block_sizes() = function_->parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (jacobians != nullptr && IsInactive(parameters, residuals)) {
      std::fill_n(residuals, num_residuals(), 0.0);
      for (size_t block = 0; block < parameter_block_sizes().size(); ++block) {
        if (jacobians[block] == nullptr) continue;
        std::fill_n(jacobians[block], num_residuals() * parameter_block_sizes()[block], 0.0);
      }
      return true;
    }
    if (!function_->Evaluate(parameters, residuals, jacobians) || !IsFinite(residuals, jacobians)) return false;
    if (roles_.are_curved) AddCurvature(parameters[0], residuals, jacobians == nullptr ? nullptr : jacobians[0]);
    for (int i = 0; i < roles_.values; ++i) {
      double& row = residuals[num_constraints() + i];
      row += 0.5 - (std::isnan(references_[i]) ? row : references_[i]);
    }
    for (int row = 0; row < num_constraints(); ++row) {
      const bool equality = row < roles_.equalities;
      const double weight = WeightOf(row);
      const double shifted = residuals[row] + multipliers_[row] / weight;
      const double scale = equality || shifted > 0 ? std::sqrt(weight) : 0.0;
      residuals[row] = scale * shifted;
      for (size_t block = 0; jacobians != nullptr && block < parameter_block_sizes().size(); ++block) {
        if (jacobians[block] == nullptr) continue;
        const int size = parameter_block_sizes()[block];
        for (int j = row * size; j < (row + 1) * size; ++j) jacobians[block][j] *= scale;
      }
    }
    return true;
  }

  double Cost(const std::vector<double*>& blocks) const {
    if (num_residuals() == num_constraints()) return 0;
    std::vector<double> rows(num_residuals());
    if (!function_->Evaluate(blocks.data(), rows.data(), nullptr)) return INFINITY;
    double cost = 0;
    for (int row = num_constraints(); row < num_residuals(); ++row) cost += CostOf(row, rows[row]);
    return cost;
  }

  // Sets the references of values to where the blocks stand.
  void SetReferences(const std::vector<double*>& blocks) {
    if (references_.empty()) return;
    std::vector<double> rows(num_residuals());
    if (!function_->Evaluate(blocks.data(), rows.data(), nullptr)) return;
    std::copy_n(rows.begin() + num_constraints(), references_.size(), references_.begin());
  }

  const ceres::CostFunction& function() const { return *function_; }
  const RowRoles& roles() const { return roles_; }

  int num_equalities() const { return roles_.equalities; }
  void ClearMultipliers() { std::fill(multipliers_.begin(), multipliers_.end(), 0.0); }
  int num_constraints() const { return roles_.equalities + roles_.inequalities; }
  // Sets a multiplier; that of an inequality is not negative.
  void SetMultiplier(int row, double multiplier) {
    multipliers_[row] = row < roles_.equalities ? multiplier : std::max(0.0, multiplier);
  }

  double LargestMultiplier() const { return Largest(multipliers_); }

  // Moves the multipliers on, adds the costs to *cost and the augmented Lagrangian before that to *lagrangian, and
  // raises *change to the largest change of a multiplier. Returns the largest violation.
  double Update(const std::vector<double*>& blocks, double* cost, double* lagrangian, double* change) {
    std::vector<double> rows(num_residuals());
    if (!function_->Evaluate(blocks.data(), rows.data(), nullptr)) return INFINITY;
    double violation = 0;
    for (int row = 0; row < num_residuals(); ++row) {
      if (row >= num_constraints()) {
        *cost += CostOf(row, rows[row]);
        *lagrangian += CostOf(row, rows[row]);
        continue;
      }
      const bool equality = row < roles_.equalities;
      const double before = multipliers_[row];
      SetMultiplier(row, before + WeightOf(row) * rows[row]);
      *lagrangian += (multipliers_[row] * multipliers_[row] - before * before) / WeightOf(row);
      *change = std::max(*change, std::abs(multipliers_[row] - before));
      violation = std::max(violation, equality ? std::abs(rows[row]) : rows[row]);
    }
    return violation;
  }

 private:
  double WeightOf(int row) const {
    return row < roles_.equalities || roles_.are_goals ? weights_->equality : weights_->inequality;
  }
  double CostOf(int row, double value) const { return row < num_constraints() + roles_.values ? value : value * value; }

  // Whether all rows are inequalities that hold, whose Jacobian counts nothing and may cost much. Overwrites `rows`.
  bool IsInactive(double const* const* parameters, double* rows) const {
    if (roles_.inequalities < function_->num_residuals()) return false;
    if (!function_->Evaluate(parameters, rows, nullptr)) return false;
    for (int row = 0; row < roles_.inequalities; ++row) {
      if (!std::isfinite(rows[row]) || rows[row] + multipliers_[row] / WeightOf(row) > 0) return false;
    }
    return true;
  }

  // Writes rows of zero whose Jacobian is the root of the positive part of the Hessian of the rows times their
  // multipliers, by differences of their gradient.
  void AddCurvature(const double* block, double* rows, double* jacobian) const {
    const int count = num_constraints(), size = parameter_block_sizes()[0];
    std::fill_n(rows + count, size, 0.0);
    if (jacobian == nullptr) return;
    Eigen::VectorXd multipliers(count);
    for (int row = 0; row < count; ++row) {
      multipliers[row] = std::max(0.0, multipliers_[row] + WeightOf(row) * rows[row]);
    }
    Eigen::Map<Matrix> root(jacobian + count * size, size, size);
    root.setZero();
    if (multipliers.isZero(0)) return;
    const Eigen::Map<const Matrix> by(jacobian, count, size);
    const Eigen::VectorXd gradient = by.transpose() * multipliers;
    std::vector<double> moved(block, block + size), moved_rows(count);
    Matrix moved_by(count, size);
    const double* blocks[] = {moved.data()};
    double* out[] = {moved_by.data()};
    Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(size, size);
    for (int i = 0; i < size; ++i) {
      moved[i] += kWidth * std::max(std::abs(block[i]), 1 / std::max(by.col(i).cwiseAbs().maxCoeff(), kWidth));
      const bool is_finite = function_->Evaluate(blocks, moved_rows.data(), out) && moved_by.allFinite();
      if (is_finite) hessian.col(i) = (moved_by.transpose() * multipliers - gradient) / (moved[i] - block[i]);
      moved[i] = block[i];
    }
    const SymmetricEigen eigen = EigenOf(0.5 * (hessian + hessian.transpose()));
    root = eigen.values.cwiseMax(0.0).cwiseSqrt().asDiagonal() * eigen.vectors.transpose();
  }

  // Ceres would write all numbers of a function to standard error.
  bool IsFinite(const double* residuals, double** jacobians) const {
    const int rows = function_->num_residuals();
    bool all = AllFinite(std::span(residuals, rows));
    for (size_t block = 0; all && jacobians != nullptr && block < parameter_block_sizes().size(); ++block) {
      const int size = rows * parameter_block_sizes()[block];
      all = jacobians[block] == nullptr || AllFinite(std::span(jacobians[block], size));
    }
    return all;
  }

  std::unique_ptr<ceres::CostFunction> function_;
  RowRoles roles_;
  const Weights* weights_;
  std::vector<double> multipliers_, references_;
};

void AugmentedLagrangian::Options::ScaleTo(int steps) {
  const double length = std::max(1.0, static_cast<double>(steps) / kShortPhase);
  equality_weight *= length;
  weight_of_costs *= length;
  radius *= length * length;
}

AugmentedLagrangian::AugmentedLagrangian() : problem_(ProblemOptions()) {}
AugmentedLagrangian::~AugmentedLagrangian() = default;

void AugmentedLagrangian::Add(std::unique_ptr<ceres::CostFunction> function, const RowRoles& roles,
                              const std::vector<double*>& blocks) {
  auto weighted = std::make_unique<Weighted>(std::move(function), roles, &weights_);
  functions_.emplace_back(weighted.get(), blocks);
  problem_.AddResidualBlock(weighted.release(), nullptr, blocks);
}

// Sets the multipliers to those that leave least of the gradient of the costs along equalities and those inequalities
// that are violated, where negative ones become zero if `clips`. Otherwise inequalities that have a multiplier count
// too, and nothing is changed if one of them comes out negative. Returns whether multipliers have been set.
bool AugmentedLagrangian::EstimateMultipliers(bool clips) {
  for (const auto& [function, blocks] : functions_) {
    if (clips) function->ClearMultipliers();
  }
  const Weights weights = std::exchange(weights_, {1, 1});  // rows are those of the functions
  std::vector<double> rows, gradient;
  ceres::CRSMatrix jacobian;
  const bool evaluated = problem_.Evaluate({}, nullptr, &rows, nullptr, &jacobian);
  weights_ = weights;
  if (!evaluated) return false;
  Eigen::VectorXd by_costs = Eigen::VectorXd::Zero(jacobian.num_cols);
  std::vector<Eigen::Triplet<double>> entries;
  std::vector<std::pair<Weighted*, int>> constrained;  // rows of functions
  int row = 0;
  for (const auto& [function, blocks] : functions_) {
    for (int i = 0; i < function->num_residuals(); ++i, ++row) {
      const bool is_cost = i >= function->num_constraints();
      const bool counts = !is_cost && (i < function->num_equalities() || rows[row] > 0);
      for (int k = jacobian.rows[row]; k < jacobian.rows[row + 1]; ++k) {
        if (counts) entries.emplace_back(constrained.size(), jacobian.cols[k], jacobian.values[k]);
        if (is_cost) by_costs[jacobian.cols[k]] += rows[row] * jacobian.values[k];
      }
      if (counts) constrained.emplace_back(function, i);
    }
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> constraints(static_cast<Eigen::Index>(constrained.size()),
                                                           jacobian.num_cols);
  constraints.setFromTriplets(entries.begin(), entries.end());
  const Eigen::VectorXd multipliers = LeastMultipliers(constraints, by_costs);
  const auto is_negative = [&](Eigen::Index i) {
    const auto& [function, of_row] = constrained[static_cast<size_t>(i)];
    return of_row >= function->num_equalities() && multipliers[i] < 0;
  };
  for (Eigen::Index i = 0; !clips && i < multipliers.size(); ++i) {
    if (is_negative(i)) return false;
  }
  for (const auto& [function, blocks] : functions_) function->ClearMultipliers();
  for (Eigen::Index i = 0; i < multipliers.size(); ++i) {
    const auto& [function, of_row] = constrained[static_cast<size_t>(i)];
    function->SetMultiplier(of_row, multipliers[i]);
  }
  return true;
}

std::vector<double> AugmentedLagrangian::Values() const {
  std::vector<double*> blocks;
  problem_.GetParameterBlocks(&blocks);
  std::vector<double> values;
  for (const double* block : blocks) values.insert(values.end(), block, block + problem_.ParameterBlockSize(block));
  return values;
}

void AugmentedLagrangian::SetValues(const std::vector<double>& values) {
  std::vector<double*> blocks;
  problem_.GetParameterBlocks(&blocks);
  auto next = values.begin();
  for (double* block : blocks) {
    const int size = problem_.ParameterBlockSize(block);
    std::copy_n(next, size, block);
    next += size;
  }
}

double AugmentedLagrangian::Cost() const {
  double cost = 0;
  for (const auto& [function, blocks] : functions_) cost += function->Cost(blocks);
  return cost;
}

double AugmentedLagrangian::UpdateMultipliers(double* cost, double* lagrangian, double* change) {
  double violation = 0;
  *cost = *lagrangian = *change = 0;
  for (const auto& [function, blocks] : functions_) {
    violation = std::max(violation, function->Update(blocks, cost, lagrangian, change));
  }
  return violation;
}

double AugmentedLagrangian::LargestMultiplier() const {
  double multiplier = 0;
  for (const auto& [function, blocks] : functions_) multiplier = std::max(multiplier, function->LargestMultiplier());
  return multiplier;
}

double AugmentedLagrangian::LargestWeight() const {
  return kLargestWeight * std::clamp(LargestMultiplier(), 1 / kLargestWeight, 1.0);
}

AugmentedLagrangian::Summary AugmentedLagrangian::Minimize(const Options& options) {
  return options.algorithm == Algorithm::kInteriorPoint ? MinimizeByInteriorPoint(Functions(), options, &problem_)
                                                        : MinimizeLeastSquares(options);
}

std::vector<ConstrainedFunction> AugmentedLagrangian::Functions() const {
  std::vector<ConstrainedFunction> functions;
  for (const auto& [weighted, blocks] : functions_) {
    functions.push_back({&weighted->function(), weighted->roles(), blocks});
  }
  return functions;
}

// Sets the first weight of equalities to a multiple of the costs to which a Gauss-Newton step leads that meets the
// linearized equalities. A step that gains the part g of the costs leaves curved constraints open in proportion to g: a
// weight far above the costs / g makes steps short, and one far below lets the costs outweigh the constraints.
void AugmentedLagrangian::WeighByCosts(double factor) {
  for (const auto& [function, blocks] : functions_) function->SetReferences(blocks);
  const Weights weights = std::exchange(weights_, {kPredictingWeight, kNoWeight});
  std::vector<double> rows;
  ceres::CRSMatrix jacobian;
  const bool evaluated = problem_.Evaluate({}, nullptr, &rows, nullptr, &jacobian);
  weights_ = weights;
  if (!evaluated) return;
  const Eigen::VectorXd start = Eigen::Map<const Eigen::VectorXd>(rows.data(), static_cast<Eigen::Index>(rows.size()));
  const Eigen::VectorXd end = RowsAfterStep(SparseRowsOf(jacobian), start);
  const double cost = Cost();
  double predicted = cost;
  Eigen::Index row = 0;
  for (const auto& [function, blocks] : functions_) {
    for (int i = 0; i < function->num_residuals(); ++i, ++row) {
      if (i >= function->num_constraints()) predicted += end[row] * end[row] - start[row] * start[row];
    }
  }
  const double size = std::abs(cost);
  double ahead = std::isfinite(predicted) ? std::abs(predicted) : size, gain = 1;
  if (size > 0) {
    gain = std::clamp((size - ahead) / size, kLeastGain, 1.0);
    ahead = std::clamp(ahead, kLeastCost * size, size);
  }
  if (ahead > 0 && std::isfinite(ahead)) weights_.equality = factor * ahead / gain;
  weights_.inequality = kShareOfInequalities * weights_.equality;
}

AugmentedLagrangian::Summary AugmentedLagrangian::MinimizeLeastSquares(const Options& options) {
  const std::vector<double> start = Values();
  weights_ = {options.equality_weight, options.inequality_weight};
  Summary result;
  if (options.weight_of_costs > 0) WeighByCosts(options.weight_of_costs);
  struct Converged {
    std::vector<double> values;
    double change, cost, violation;
  };
  std::optional<Converged> first_optimum;  // before the multipliers are those of the conditions of first order
  AfterIteration watch([&](const ceres::IterationSummary& summary) {
    if (summary.iteration == 0) return true;  // of another solve
    ++result.iterations;
    result.interrupted = options.callback && !options.callback(Cost());
    // Ceres ends where an accepted step gains too little. One that is rejected by as little is so by rounding errors,
    // which damping does not correct.
    const bool changes = std::abs(summary.cost_change) > options.gain * std::abs(summary.cost);
    return !result.interrupted && !(first_optimum && !summary.step_is_successful && !changes);
  });
  ceres::Solver::Options ceres_options;
  ceres_options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  ceres_options.max_trust_region_radius = 1e16;
  ceres_options.logging_type = ceres::SILENT;
  ceres_options.gradient_tolerance = 0;
  ceres_options.parameter_tolerance = 1e-15;
  ceres_options.update_state_every_iteration = options.callback != nullptr;
  ceres_options.callbacks = {&watch};
  const double least_change = kNoCost * std::abs(Cost());
  bool estimated = false, near = false, nearly_settled = false;
  int estimates = 0, stalls = 0;  // where solves stall
  for (int round = 0; round < options.rounds; ++round) {
    const bool crawls = options.one_of_many && result.violation > kNearlyMet;
    ceres_options.function_tolerance = crawls ? kFirstGains[0] : round < kLast ? kFirstGains[round] : options.gain;
    if (first_optimum) ceres_options.function_tolerance = kExactGain * options.gain;
    // Damping is in proportion to the weights, and would leave unchanged what changes the cost by no more than
    // rounding.
    ceres_options.initial_trust_region_radius = nearly_settled ? kLastRadius
                                                : round == 0   ? kFirstRadius
                                                               : options.radius;
    ceres_options.max_num_iterations = options.iterations - result.iterations;
    for (const auto& [function, blocks] : functions_) function->SetReferences(blocks);
    ceres::Solver::Summary summary;
    ceres::Solve(ceres_options, &problem_, &summary);
    result.jacobians += summary.num_jacobian_evaluations;
    if (summary.termination_type == ceres::FAILURE) break;
    result.usable = true;
    const double before = result.cost, open_before = result.violation;
    double lagrangian = 0, change_of_multipliers = 0;
    result.violation = UpdateMultipliers(&result.cost, &lagrangian, &change_of_multipliers);
    // An optimum whose multipliers are unknown: with those of zero, greater weights would lead away from it.
    near = near || (round == 0 && !estimated && result.iterations == 0);
    const double gain_ahead = kGainsAhead * ceres_options.function_tolerance * std::abs(lagrangian);
    const int accurate = options.one_of_many ? 0 : kAccurate;
    if (round >= accurate && lagrangian - gain_ahead > options.most_cost) break;
    const bool is_far = result.violation > options.most_open && !options.one_of_many;
    if (round == 0 && !estimated && (near || is_far)) {
      estimated = true;
      SetValues(start);
      EstimateMultipliers(true);
      if (!result.interrupted && result.iterations < options.iterations) {
        --round;
        continue;
      }
    }
    if (options.after_round) options.after_round();
    if (result.interrupted || result.iterations >= options.iterations) {
      if (first_optimum) SetValues(first_optimum->values);
      break;
    }
    if (options.one_of_many && result.violation > kNearlyMet) {
      stalls = round > 0 && result.violation > kStalled * open_before ? stalls + 1 : 0;
      if (stalls == kMostStalled || (result.iterations > kManyIterations && result.violation > kHopeless)) break;
    }
    const double same = std::max(kSameCost * std::abs(result.cost), least_change);
    // With a weight that follows the costs, the first solves may end at the same cost, to which they are not accurate.
    const int earliest = near || options.weight_of_costs > 0 ? kLast : 1;
    const double change = std::abs(result.cost - before);
    nearly_settled = result.violation <= options.tolerance && change <= kNearlySameCost * std::abs(result.cost);
    result.converged = result.violation <= options.tolerance && round >= earliest && change <= same;
    if (first_optimum) {  // the solve with multipliers from the conditions of first order
      if (result.converged && change_of_multipliers < first_optimum->change) break;
      SetValues(first_optimum->values);
      result.converged = true;
      result.cost = first_optimum->cost;
      result.violation = first_optimum->violation;
      break;
    }
    // Multipliers that still change follow from the conditions of first order sooner than from further solves.
    const bool settled = change_of_multipliers <= options.change_of_multipliers * LargestMultiplier();
    if (result.converged) {
      if (settled || !EstimateMultipliers(false)) break;
      first_optimum = {Values(), change_of_multipliers, result.cost, result.violation};
      continue;
    }
    const double most = LargestWeight();
    // Two inequalities that are nearly the same, as at a touch on the node between two steps, end with the multiplier
    // of both on one of them. Each solve would move it there by their difference times the weight only.
    const bool nearly = result.violation > options.tolerance && result.violation <= kNearlyMet;
    const bool stalled = weights_.inequality >= most && result.violation > kStalled * open_before;
    if (nearly && stalled && ++estimates <= kMostEstimates) EstimateMultipliers(true);
    weights_.equality = std::min(most, kGrowth * weights_.equality);
    weights_.inequality = std::min(most, kGrowth * weights_.inequality);
  }
  return result;
}

Termination TerminationOf(const AugmentedLagrangian::Summary& summary, int iterations) {
  if (!summary.usable) return Termination::kFailed;
  if (summary.interrupted) return Termination::kInterrupted;
  if (summary.converged) return Termination::kConverged;
  return summary.iterations >= iterations ? Termination::kIterationLimit : Termination::kNoProgress;
}

}  // namespace saltus
