#include "hybrid/greatest_values.h"

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace saltus {
namespace {

using Matrix = RungeKutta::Matrix;

constexpr double kSameTime = 1e-15;  // of a part: times that are not told apart
constexpr int kMostTrials = 100;
constexpr int kLeastParts = 8;  // of a control interval

// The greatest values of the function of a term. Parameter blocks: those of the term, which are the state, the control
// and the parameters, if the system has any, the time of the beginning and the length of the interval.
class GreatestValuesOfTerm final : public ceres::CostFunction {
 public:
  GreatestValuesOfTerm(std::shared_ptr<const ceres::CostFunction> function, HybridSystem system, int mode, int parts)
      : function_(std::move(function)), system_(std::move(system)), mode_(mode), parts_(parts) {
    *mutable_parameter_block_sizes() = function_->parameter_block_sizes();
    set_num_residuals(2 * function_->num_residuals());
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const int m = system_.num_controls(), P = system_.num_parameters();
    const double* const* block = parameters;
    FlowStep step{{.mode = mode_, .x = *block++}};
    if (m > 0) step.u = *block++;
    if (P > 0) step.p = *block++;
    step.t = **block++;
    step.h = **block;
    GreatestValues greatest(system_.functions(),
                            function_->num_residuals(),
                            parts_,
                            [this](const ModePoint& at, double length, double* values, Matrix* by) {
                              return Values(at, length, values, by);
                            });
    Matrix by;
    if (!greatest.Find(step, residuals, jacobians != nullptr ? &by : nullptr)) return false;
    if (jacobians == nullptr) return true;
    double** jacobian = jacobians;
    ForEachBlock([&](int first, int size) {
      if (*jacobian != nullptr) Eigen::Map<Matrix>(*jacobian, by.rows(), size) = by.middleCols(first, size);
      ++jacobian;
    });
    return true;
  }

 private:
  // Calls visit(first, size) with the columns in [x t p u h] of each parameter block.
  template <typename Visitor>
  void ForEachBlock(const Visitor& visit) const {
    const int n = parameter_block_sizes()[0], m = system_.num_controls(), P = system_.num_parameters();
    visit(0, n);
    if (m > 0) visit(n + 1 + P, m);
    if (P > 0) visit(n + 1, P);
    visit(n, 1);
    visit(n + 1 + P + m, 1);
  }

  bool Values(const ModePoint& at, double length, double* values, Matrix* by) const {
    std::vector<const double*> blocks = {at.x};
    if (at.u != nullptr) blocks.push_back(at.u);
    if (at.p != nullptr) blocks.push_back(at.p);
    blocks.insert(blocks.end(), {&at.t, &length});
    std::vector<Matrix> of_blocks;
    std::vector<double*> jacobians;
    for (const int size : parameter_block_sizes()) of_blocks.emplace_back(function_->num_residuals(), size);
    for (Matrix& of_block : of_blocks) jacobians.push_back(of_block.data());
    if (!function_->Evaluate(blocks.data(), values, jacobians.data())) return false;
    auto of_block = of_blocks.begin();
    ForEachBlock([&](int first, int size) { by->middleCols(first, size) = *of_block++; });
    return true;
  }

  const std::shared_ptr<const ceres::CostFunction> function_;
  const HybridSystem system_;
  const int mode_, parts_;
};

}  // namespace

bool HybridFunctions::LeastGuard(const FlowStep& step, int guard, double* value, double* gradient) const {
  GreatestValues greatest(*this, 1, 1, [&](const ModePoint& at, double, double* opposite, Matrix* by) {
    by->setZero();
    *opposite = -GuardGradient(at, guard, by->data());
    *by = -*by;
    return true;
  });
  double values[2];  // of the opposite, before the end and there
  Matrix by;
  if (!greatest.Find(step, values, gradient != nullptr ? &by : nullptr)) return false;
  const int place = values[1] > values[0] ? 1 : 0;
  *value = -values[place];
  if (gradient != nullptr) Eigen::Map<Eigen::RowVectorXd>(gradient, by.cols()) = -by.row(place);
  return true;
}

GreatestValues::GreatestValues(const HybridFunctions& system, int count, int parts, Functions functions)
    : system_(system), count_(count), parts_(parts), functions_(std::move(functions)), integrator_(system) {}

FlowStep GreatestValues::StepTo(const Place& place) const {
  const double length = step_.h / parts_;
  FlowStep step = step_;
  step.t += place.part * length;
  step.x = states_[place.part].data();
  step.h = place.share * length;
  return step;
}

bool GreatestValues::Evaluate(const Place& place, Values* values) {
  const Eigen::Index n = states_[0].size();
  Eigen::VectorXd state = states_[place.part], slope(n);
  if (place.share > 0) integrator_.Step(StepTo(place), state.data());
  ModePoint at = step_;
  at.t += (place.part + place.share) * step_.h / parts_;
  at.x = state.data();
  values->value.resize(count_);
  values->by.resize(count_, n + 2 + system_.layout().num_parameters + system_.layout().num_controls);
  if (!functions_(at, step_.h, values->value.data(), &values->by)) return false;
  system_.Flow(at, slope.data());
  values->rate = values->by.leftCols(n) * slope + values->by.col(n);
  return values->value.allFinite();
}

// Finds the time within a part at which the rate of a function falls through zero, by the Illinois method.
// Precondition: it is above zero at the beginning, and not at the end.
bool GreatestValues::FindTop(int function, int part, Values* top, double* share) {
  double low = 0, high = 1, at_low = nodes_[part].rate[function], at_high = nodes_[part + 1].rate[function];
  int side = 0;
  *top = nodes_[part];
  *share = 0;
  for (int trial = 0; trial < kMostTrials && high - low > kSameTime && top->rate[function] != 0; ++trial) {
    *share = low + (high - low) * at_low / (at_low - at_high);
    if (!Evaluate({part, *share}, top)) return false;
    const double rate = top->rate[function];
    (rate > 0 ? low : high) = *share;
    (rate > 0 ? at_low : at_high) = rate;
    if (side * rate > 0) (rate > 0 ? at_high : at_low) /= 2;
    side = rate > 0 ? 1 : -1;
  }
  return true;
}

GreatestValues::Matrix GreatestValues::StateDerivative(const Place& place) {
  const Matrix& from = states_by_[place.part];
  if (place.share == 0) return from;
  const Matrix by_step = integrator_.Jacobian(StepTo(place));
  const Eigen::Index n = from.rows(), last = from.cols() - 1;
  Matrix by = by_step.leftCols(n) * from;
  by.middleCols(n, last - n) += by_step.middleCols(n, last - n);
  by.col(last) += by_step.col(last) * place.share / parts_;
  // A derivative by the time may be infinite at the beginning, which does not move with the length.
  if (place.part > 0) by.col(last) += by_step.col(n) * place.part / parts_;
  return by;
}

bool GreatestValues::Find(const FlowStep& step, double* values, Matrix* by) {
  const Eigen::Index n = system_.state_size(step.mode);
  step_ = step;
  states_ = {Eigen::Map<const Eigen::VectorXd>(step.x, n)};
  nodes_.resize(parts_ + 1);
  for (int part = 0; part < parts_; ++part) {
    Eigen::VectorXd next = states_[part];
    integrator_.Step(StepTo({part, 1}), next.data());
    states_.push_back(std::move(next));
  }
  for (int part = 0; part <= parts_; ++part) {
    if (!Evaluate({part, 0}, &nodes_[part])) return false;
  }
  std::vector<Place> places(2 * count_, Place{parts_, 0});
  for (int row = 0; row < count_; ++row) {
    values[count_ + row] = nodes_[parts_].value[row];
    values[row] = nodes_[0].value[row];
    places[row] = {0, 0};
    for (int part = 0; part < parts_; ++part) {
      if (!(nodes_[part].rate[row] > 0 && nodes_[part + 1].rate[row] <= 0)) continue;
      Values top;
      double share = 0;
      if (!FindTop(row, part, &top, &share)) return false;
      if (!(top.value[row] > values[row])) continue;
      values[row] = top.value[row];
      places[row] = {part, share};
    }
  }
  if (by == nullptr) return true;

  const Eigen::Index last = nodes_[0].by.cols() - 1;  // the column of h
  states_by_ = {Matrix::Identity(n, last + 1)};
  for (int part = 0; part < std::ranges::max(places, {}, &Place::part).part; ++part) {
    states_by_.push_back(StateDerivative({part, 1}));
  }
  by->resize(2 * count_, last + 1);
  for (int row = 0; row < 2 * count_; ++row) {
    const Place& place = places[row];
    Values found;
    if (!Evaluate(place, &found)) return false;
    const auto of_function = found.by.row(row % count_);
    by->row(row) = of_function.leftCols(n) * StateDerivative(place);
    by->row(row).segment(n, last - n) += of_function.segment(n, last - n);
    (*by)(row, last) += of_function[last] + of_function[n] * (place.part + place.share) / parts_;
  }
  return by->allFinite();
}

std::shared_ptr<const ceres::CostFunction> FunctionIn(const HybridTerm& term, const HybridSystem& system, int mode,
                                                      int steps) {
  if (!term.always) return term.function;
  return std::make_shared<GreatestValuesOfTerm>(term.function, system, mode, std::max(kLeastParts, steps));
}

}  // namespace saltus
