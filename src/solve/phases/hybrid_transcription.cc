#include "solve/phases/hybrid_transcription.h"

#include <ceres/cost_function.h>
#include <ceres/manifold.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "base/statistics.h"
#include "hybrid/greatest_values.h"
#include "solve/phases/divided_state.h"

namespace saltus {
namespace {

using Matrix = RungeKutta::Matrix;

constexpr double kGain = 1e-14;  // of the last solve: certificates ask for conditions of first order to 1e-6
constexpr double kChangeOfMultipliers = 1e-7;
constexpr double kLeastLength = 1e-6;      // of a control interval of mean length, below which its costs do not change
constexpr double kWeightOfCosts = 400;     // of the first solve
constexpr double kMostOpen = 0.005;        // of a row after the first solve, if costs do not outweigh the motion
constexpr double kCostOfViolation = 1e-3;  // of other costs, where only violations count

// A time that is a part of the way between two blocks, or one block if `begin` is not one.
struct TimeOf {
  double part = 1;
  bool one_block = true;

  int num_blocks() const { return one_block ? 1 : 2; }
  double TimeAt(double const* const* blocks) const {
    return one_block ? blocks[0][0] : blocks[0][0] + part * (blocks[1][0] - blocks[0][0]);
  }
  // The derivative by block i.
  double BlockDerivative(int i) const { return one_block ? 1 : i == 1 ? part : 1 - part; }
};

class Rows : public ceres::CostFunction {
 protected:
  Rows(int rows, std::vector<int> blocks) {
    set_num_residuals(rows);
    *mutable_parameter_block_sizes() = std::move(blocks);
  }
  // Writes `derivative`, scaled by row, into the Jacobian of a block, if that is asked for.
  template <typename Derived>
  static void Put(double** jacobians, int block, const Eigen::MatrixBase<Derived>& derivative) {
    if (jacobians[block] == nullptr) return;
    Eigen::Map<Matrix>(jacobians[block], derivative.rows(), derivative.cols()) = derivative;
  }
  bool AreFinite(const double* rows) const { return AllFinite(std::span(rows, num_residuals())); }
};

// The defect of a step of a part. Blocks: its states, its control and the parameters if there are any, begin and end of
// the phase, next states.
class StepRows final : public Rows {
 public:
  // `only`: the part is the only one.
  StepRows(const HybridFunctions& functions, RungeKutta* integrator, int mode, const StatePart& part, int part_index,
           bool only, int index, int count, bool projects, const std::vector<double>& sizes)
      : Rows(static_cast<int>(part.states.size()), {}),
        functions_(functions),
        integrator_(*integrator),
        mode_(mode),
        part_(part_index),
        only_(only),
        index_(index),
        count_(count),
        projects_(projects),
        num_controls_(static_cast<int>(part.controls.size())),
        scale_(part.states.size()) {
    const int n = num_residuals(), P = functions.layout().num_parameters;
    for (const int size : {n, num_controls_, P, 1, 1, n}) {
      if (size > 0) mutable_parameter_block_sizes()->push_back(size);
    }
    for (int i = 0; i < n; ++i) scale_[i] = 1 / sizes[part.states[i]];
  }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = num_residuals(), m = num_controls_, P = functions_.layout().num_parameters;
    const int of_control = 1, of_parameters = of_control + (m > 0), times = of_parameters + (P > 0);
    const double begin = blocks[times][0], end = blocks[times + 1][0], part = static_cast<double>(index_) / count_;
    const double *u = m > 0 ? blocks[of_control] : nullptr, *p = P > 0 ? blocks[of_parameters] : nullptr;
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[of_parameters] != nullptr;
    const FlowStep step{
        {mode_, begin + part * (end - begin), blocks[0], u, p, by_parameters}, (end - begin) / count_, projects_};
    after_.resize(n);
    if (!only_) {
      by_.resize(n, n + 2 + P + m);
      functions_.MovePart(part_, step, after_.data(), jacobians != nullptr ? by_.data() : nullptr);
    } else if (jacobians != nullptr) {
      by_ = integrator_.Jacobian(step, after_.data());
    } else {
      integrator_.Step(step, after_.data());
    }
    Eigen::Map<Eigen::VectorXd>(rows, n) =
        scale_.cwiseProduct(Eigen::Map<const Eigen::VectorXd>(blocks[times + 2], n) - after_);
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    for (int i = 0; i < n; ++i) by_.row(i) *= -scale_[i];
    Put(jacobians, 0, by_.leftCols(n));
    if (m > 0) Put(jacobians, of_control, by_.middleCols(n + 1 + P, m));
    if (by_parameters) Put(jacobians, of_parameters, by_.middleCols(n + 1, P));
    Put(jacobians, times, (1 - part) * by_.col(n) - by_.rightCols(1) / count_);
    Put(jacobians, times + 1, part * by_.col(n) + by_.rightCols(1) / count_);
    if (jacobians[times + 2] == nullptr) return true;
    Eigen::Map<Matrix> by_next(jacobians[times + 2], n, n);
    by_next.setZero();
    by_next.diagonal() = scale_;
    return true;
  }

 private:
  const HybridFunctions& functions_;
  RungeKutta& integrator_;
  int mode_, part_;
  bool only_;
  int index_, count_;
  bool projects_;
  int num_controls_;
  Eigen::VectorXd scale_;
  mutable Eigen::VectorXd after_;  // a transcription is evaluated by one thread
  mutable Matrix by_;
};

// Rows offset + factor g of some guards of a mode, all or none of which depend on the control. Blocks: state, control
// if they depend on it, parameters if there are any, and the time.
class GuardRows final : public Rows {
 public:
  struct Row {
    int guard;
    double offset, factor;
  };
  GuardRows(const HybridFunctions& functions, int mode, std::vector<Row> rows, StateAtNode state, Divided control,
            const TimeOf& time)
      : Rows(static_cast<int>(rows.size()), {}),
        functions_(functions),
        reads_control_(functions.ReadsControl(mode, rows[0].guard)),
        mode_(mode),
        guards_(std::move(rows)),
        state_(std::move(state)),
        control_(std::move(control)),
        time_(time),
        u_(control_.size()) {
    std::vector<int>& sizes = *mutable_parameter_block_sizes();
    state_.AppendSizes(&sizes);
    if (reads_control_) control_.AppendSizes(&sizes);
    if (functions.layout().num_parameters > 0) sizes.push_back(functions.layout().num_parameters);
    sizes.resize(sizes.size() + time.num_blocks(), 1);
  }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(mode_), P = functions_.layout().num_parameters,
              m = functions_.layout().num_controls;
    const int of_control = state_.num_blocks(),
              of_parameters = of_control + (reads_control_ ? control_.num_parts() : 0), times = of_parameters + (P > 0);
    if (reads_control_) control_.Join(blocks + of_control, u_.data());
    const double *u = reads_control_ ? u_.data() : nullptr, *p = P > 0 ? blocks[of_parameters] : nullptr;
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[of_parameters] != nullptr;
    const double* x = state_.Read(blocks, blocks + times, p, jacobians != nullptr);
    const ModePoint at{mode_, time_.TimeAt(blocks + times), x, u, p, by_parameters};
    const bool one = guards_.size() == 1;
    const int all = one ? 1 : functions_.num_guards(mode_);
    Eigen::VectorXd values(all);
    Matrix gradients(all, n + 1 + P + m);
    if (one && jacobians == nullptr) {
      values[0] = functions_.Guard(at, guards_[0].guard);
    } else if (one) {
      values[0] = functions_.GuardGradient(at, guards_[0].guard, gradients.data());
    } else if (jacobians != nullptr) {
      functions_.GuardGradients(at, values.data(), gradients.data());
    } else {
      const std::vector<double> still(n, 0.0);
      std::vector<GuardValue> found(all);
      functions_.GuardRates(at, still.data(), found.data());
      for (int guard = 0; guard < all; ++guard) values[guard] = found[guard].value;
    }
    Matrix by(guards_.size(), gradients.cols());
    for (size_t i = 0; i < guards_.size(); ++i) {
      const int place = one ? 0 : guards_[i].guard;
      rows[i] = guards_[i].offset + guards_[i].factor * values[place];
      by.row(static_cast<Eigen::Index>(i)) = guards_[i].factor * gradients.row(place);
    }
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    Matrix of_parameter = by_parameters ? Matrix(by.middleCols(n + 1, P)) : Matrix::Zero(by.rows(), P);
    Matrix by_times(by.rows(), 2);
    for (int k = 0; k < 2; ++k) by_times.col(k) = (k < time_.num_blocks() ? time_.BlockDerivative(k) : 0) * by.col(n);
    state_.Put(by.leftCols(n), jacobians, &of_parameter, &by_times);
    if (reads_control_) control_.Put(by.rightCols(m), jacobians + of_control);
    if (by_parameters) Put(jacobians, of_parameters, of_parameter);
    for (int k = 0; k < time_.num_blocks(); ++k) Put(jacobians, times + k, by_times.col(k));
    return true;
  }

 private:
  const HybridFunctions& functions_;
  bool reads_control_;
  int mode_;
  std::vector<Row> guards_;
  mutable StateAtNode state_;
  Divided control_;
  TimeOf time_;
  mutable Eigen::VectorXd u_;
};

// The row margin - g / size of a guard where it is least within a step. Blocks: state at the beginning, control and
// parameters if there are any, begin and end of the phase.
class LeastGuardRow final : public Rows {
 public:
  // `step`: its index, of so many in the phase.
  LeastGuardRow(const HybridFunctions& functions, int mode, int guard, StateAtNode state, Divided control, int step,
                int count, double margin, double size)
      : Rows(1, {}),
        functions_(functions),
        mode_(mode),
        guard_(guard),
        state_(std::move(state)),
        control_(std::move(control)),
        index_(step),
        count_(count),
        margin_(margin),
        size_(size),
        u_(control_.size(), 0.0) {
    std::vector<int>& sizes = *mutable_parameter_block_sizes();
    state_.AppendSizes(&sizes);
    control_.AppendSizes(&sizes);
    if (functions.layout().num_parameters > 0) sizes.push_back(functions.layout().num_parameters);
    sizes.insert(sizes.end(), {1, 1});
  }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(mode_), m = functions_.layout().num_controls,
              P = functions_.layout().num_parameters;
    const int of_control = state_.num_blocks(), of_parameters = of_control + control_.num_parts(),
              times = of_parameters + (P > 0);
    const double begin = blocks[times][0], end = blocks[times + 1][0], part = static_cast<double>(index_) / count_;
    const double* p = P > 0 ? blocks[of_parameters] : nullptr;
    const double* x = state_.Read(blocks, blocks + times, p, jacobians != nullptr);
    control_.Join(blocks + of_control, u_.data());
    const FlowStep step{{mode_, begin + part * (end - begin), x, u_.data(), p}, (end - begin) / count_};
    double least = 0;
    Matrix row(1, n + 2 + P + m);
    if (!functions_.LeastGuard(step, guard_, &least, jacobians != nullptr ? row.data() : nullptr)) return false;
    rows[0] = margin_ - least / size_;
    if (jacobians == nullptr) return true;
    row /= -size_;
    Matrix by_parameters = row.middleCols(n + 1, P), by_times(1, 2);
    by_times << (1 - part) * row(0, n) - row(0, n + 1 + P + m) / count_,
        part * row(0, n) + row(0, n + 1 + P + m) / count_;
    state_.Put(row.leftCols(n), jacobians, &by_parameters, &by_times);
    control_.Put(row.middleCols(n + 1 + P, m), jacobians + of_control);
    if (P > 0) Put(jacobians, of_parameters, by_parameters);
    for (int k = 0; k < 2; ++k) Put(jacobians, times + k, by_times.col(k));
    return true;
  }

 private:
  const HybridFunctions& functions_;
  const int mode_, guard_;
  mutable StateAtNode state_;
  const Divided control_;
  const int index_, count_;
  const double margin_, size_;
  mutable std::vector<double> u_;
};

// The inequalities of an event. Blocks: state before, parameters if there are any, time.
class EventRows final : public Rows {
 public:
  EventRows(const HybridFunctions& functions, const ModeEvent& event, StateAtNode before)
      : Rows(functions.num_event_rows(event.mode, event.guard), {}),
        functions_(functions),
        event_(event),
        before_(std::move(before)) {
    std::vector<int>& sizes = *mutable_parameter_block_sizes();
    before_.AppendSizes(&sizes);
    if (functions.layout().num_parameters > 0) sizes.push_back(functions.layout().num_parameters);
    sizes.push_back(1);
  }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(event_.mode), P = functions_.layout().num_parameters;
    const int of_parameters = before_.num_blocks(), time = of_parameters + (P > 0);
    const double* p = P > 0 ? blocks[of_parameters] : nullptr;
    const ModePoint at{event_.mode, blocks[time][0], before_.Read(blocks, nullptr, p, false), nullptr, p};
    Matrix by(num_residuals(), n + 1 + P);
    functions_.EventRows(at, event_.guard, rows, jacobians != nullptr ? by.data() : nullptr);
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    before_.Put(by.leftCols(n), jacobians, nullptr, nullptr);
    if (P > 0) Put(jacobians, of_parameters, by.rightCols(P));
    Put(jacobians, time, by.col(n));
    return true;
  }

 private:
  const HybridFunctions& functions_;
  const ModeEvent event_;
  mutable StateAtNode before_;
};

// Whether a reset leads to another mode than planned. The piece of the mode may be another one where the state after
// the reset is at a switch, on whose side the guards of the phase behind keep it.
bool LeadsElsewhere(const HybridFunctions& functions, int next, int planned) {
  if (functions.CreatesModes()) return false;
  return next < 0 || functions.BaseMode(next) != functions.BaseMode(planned);
}

// The defect of a reset of the parts that it changes. Blocks: state before, parameters if there are any, time, state
// after. `control` acts before it; where it matters, for the next mode only, that follows from the guards of the phase
// behind.
class ResetRows final : public Rows {
 public:
  ResetRows(const HybridFunctions& functions, const ModeEvent& event, StateAtNode before, Divided after,
            std::vector<const double*> control_blocks, Divided control, const std::vector<double>& sizes)
      : Rows(0, {}),
        functions_(functions),
        event_(event),
        before_(std::move(before)),
        after_(std::move(after)),
        control_blocks_(std::move(control_blocks)),
        control_(std::move(control)) {
    std::vector<int>& blocks = *mutable_parameter_block_sizes();
    before_.AppendSizes(&blocks);
    if (functions.layout().num_parameters > 0) blocks.push_back(functions.layout().num_parameters);
    blocks.push_back(1);
    after_.AppendSizes(&blocks);
    for (int part = 0; part < after_.num_parts(); ++part) {
      rows_.insert(rows_.end(), after_[part].begin(), after_[part].end());
    }
    set_num_residuals(static_cast<int>(rows_.size()));
    scale_.resize(num_residuals());
    for (int i = 0; i < num_residuals(); ++i) scale_[i] = 1 / sizes[rows_[i]];
  }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(event_.mode), count = num_residuals(), P = functions_.layout().num_parameters;
    const int most = functions_.most_states();
    const int of_parameters = before_.num_blocks(), time = of_parameters + (P > 0);
    Eigen::VectorXd x_plus = Eigen::VectorXd::Constant(most, NAN), x(after_.size()), u(control_.size());
    Matrix jacobian(most, n + 1 + P);
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[of_parameters] != nullptr;
    const double* p = P > 0 ? blocks[of_parameters] : nullptr;
    const double* before = before_.Read(blocks, nullptr, p, false);
    control_.Join(control_blocks_.data(), u.data());
    const ModePoint at{event_.mode, blocks[time][0], before, u.data(), p, by_parameters};
    const int next = functions_.ResetJacobian(at, event_.guard, x_plus.data(), jacobian.data());
    if (LeadsElsewhere(functions_, next, event_.next_mode)) return false;
    after_.Join(blocks + time + 1, x.data());
    for (int i = 0; i < count; ++i) rows[i] = scale_[i] * (x[rows_[i]] - x_plus[rows_[i]]);
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    Matrix by(count, n + 1 + P), by_after = Matrix::Zero(count, x.size());
    for (int i = 0; i < count; ++i) {
      by.row(i) = -scale_[i] * jacobian.row(rows_[i]);
      by_after(i, rows_[i]) = scale_[i];
    }
    before_.Put(by.leftCols(n), jacobians, nullptr, nullptr);
    if (by_parameters) Put(jacobians, of_parameters, by.rightCols(P));
    Put(jacobians, time, by.col(n));
    after_.Put(by_after, jacobians + time + 1);
    return true;
  }

 private:
  const HybridFunctions& functions_;
  ModeEvent event_;
  mutable StateAtNode before_;
  Divided after_;
  std::vector<const double*> control_blocks_;
  Divided control_;
  std::vector<int> rows_;  // components of the state after
  Eigen::VectorXd scale_;
};

// A term of the problem. Blocks: state, initial state, control and parameters if it reads them; the time, or begin and
// end of the phase, if it reads the time or the length, or the state of a part that coasts.
class TermRows final : public Rows {
 public:
  // `function` is FunctionIn() of the term.
  TermRows(const HybridTerm& term, std::shared_ptr<const ceres::CostFunction> function,
           std::optional<StateAtNode> state, std::optional<StateAtNode> initial, Divided control, int num_parameters,
           const TimeOf& time, int intervals, double least, double scale)
      : Rows(function->num_residuals(), {}),
        term_(term),
        function_(std::move(function)),
        state_(std::move(state)),
        initial_(std::move(initial)),
        control_(std::move(control)),
        time_(time),
        intervals_(intervals),
        least_(least),
        scale_(scale),
        coasts_(state_ && state_->Coasts()),
        timed_(term.with_time || term.with_length || coasts_),
        num_parameters_(term.with_parameters || coasts_ ? num_parameters : 0) {
    std::vector<int>& sizes = *mutable_parameter_block_sizes();
    if (state_) state_->AppendSizes(&sizes);
    if (initial_) initial_->AppendSizes(&sizes);
    if (term.with_control) control_.AppendSizes(&sizes);
    of_parameters_ = static_cast<int>(sizes.size());
    if (num_parameters_ > 0) sizes.push_back(num_parameters_);
    if (timed_) sizes.resize(sizes.size() + time.num_blocks(), 1);
    u_.setZero(control_.size());
    for (const int size : function_->parameter_block_sizes()) by_.emplace_back(num_residuals(), size);
    for (Matrix& derivative : by_) out_.push_back(derivative.data());
    by_times_.resize(num_residuals(), 2);
    by_parameters_.resize(num_residuals(), num_parameters_);
  }

  bool is_timed() const { return timed_; }
  bool reads_parameters() const { return num_parameters_ > 0; }

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int times = of_parameters_ + (num_parameters_ > 0), count = num_residuals();
    const double* p = num_parameters_ > 0 ? blocks[of_parameters_] : nullptr;
    const bool derives = jacobians != nullptr;
    double time = 0, length = 0;
    bool grows = false;
    if (timed_) {
      time = time_.TimeAt(blocks + times);
      length = time_.one_block ? 0 : (blocks[times + 1][0] - blocks[times][0]) / intervals_;
      grows = length > least_;
      length = std::max(length, least_);
    }
    in_.clear();
    int block = 0;
    if (state_) {
      in_.push_back(state_->Read(blocks, blocks + times, p, derives));
      block += state_->num_blocks();
    }
    if (initial_) {
      in_.push_back(initial_->Read(blocks + block, nullptr, nullptr, false));
      block += initial_->num_blocks();
    }
    if (term_.with_control) {
      control_.Join(blocks + block, u_.data());
      in_.push_back(u_.data());
    }
    if (term_.with_parameters) in_.push_back(p);
    if (term_.with_time) in_.push_back(&time);
    if (term_.with_length) in_.push_back(&length);
    if (!function_->Evaluate(in_.data(), rows, derives ? out_.data() : nullptr)) return false;
    for (int i = 0; i < count; ++i) rows[i] *= scale_;
    if (!AreFinite(rows)) return false;
    if (!derives) return true;
    for (Matrix& derivative : by_) derivative *= scale_;
    Matrix &by_times = by_times_, &by_parameters = by_parameters_;
    by_times.setZero();
    by_parameters.setZero();
    auto next = by_.begin();
    double** jacobian = jacobians;
    if (state_) {
      state_->Put(*next++, jacobian, &by_parameters, &by_times);
      jacobian += state_->num_blocks();
    }
    if (initial_) {
      initial_->Put(*next++, jacobian, &by_parameters, &by_times);
      jacobian += initial_->num_blocks();
    }
    if (term_.with_control) control_.Put(*next++, jacobian);
    if (term_.with_parameters) by_parameters += *next++;
    if (num_parameters_ > 0) Put(jacobians, of_parameters_, by_parameters);
    for (int i = 0; timed_ && i < time_.num_blocks(); ++i) {
      if (term_.with_time) by_times.col(i) += time_.BlockDerivative(i) * *next;
      if (term_.with_length && grows) by_times.col(i) += (i == 1 ? 1.0 : -1.0) / intervals_ * by_.back();
      Put(jacobians, times + i, by_times.col(i));
    }
    return true;
  }

 private:
  const HybridTerm term_;
  const std::shared_ptr<const ceres::CostFunction> function_;
  mutable std::optional<StateAtNode> state_, initial_;
  Divided control_;
  TimeOf time_;
  int intervals_;
  double least_, scale_;
  bool coasts_, timed_;
  int num_parameters_;  // that are read
  int of_parameters_ = 0;
  // The blocks of the term's function, and its derivatives by them and by blocks of this one.
  mutable std::vector<const double*> in_;
  mutable Eigen::VectorXd u_;
  mutable std::vector<Matrix> by_;
  mutable std::vector<double*> out_;
  mutable Matrix by_times_, by_parameters_;
};

// Rows min - z and z - max of the components that have bounds, relative to their sizes.
class BoundRows final : public Rows {
 public:
  struct Bound {
    int component;
    double sign, at, size;  // sign (z - at) <= 0
  };
  BoundRows(int block, std::vector<Bound> bounds)
      : Rows(static_cast<int>(bounds.size()), {block}), bounds_(std::move(bounds)) {}
  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int columns = parameter_block_sizes()[0];
    double* by = jacobians != nullptr ? jacobians[0] : nullptr;
    if (by != nullptr) std::fill_n(by, bounds_.size() * columns, 0.0);
    for (size_t i = 0; i < bounds_.size(); ++i) {
      const Bound& bound = bounds_[i];
      rows[i] = bound.sign * (blocks[0][bound.component] - bound.at) / bound.size;
      if (by != nullptr) by[i * columns + bound.component] = bound.sign / bound.size;
    }
    return true;
  }

 private:
  std::vector<Bound> bounds_;
};

// (begin - end) / size <= 0.
class LengthRow final : public Rows {
 public:
  explicit LengthRow(double size) : Rows(1, {1, 1}), size_(size) {}
  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    rows[0] = (blocks[0][0] - blocks[1][0]) / size_;
    for (int i = 0; jacobians != nullptr && i < 2; ++i) {
      if (jacobians[i] != nullptr) jacobians[i][0] = (i == 0 ? 1 : -1) / size_;
    }
    return true;
  }

 private:
  double size_;
};

// (time - part end) / size = 0.
class PartRow final : public Rows {
 public:
  PartRow(double part, double size) : Rows(1, {1, 1}), part_(part), size_(size) {}
  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    rows[0] = (blocks[0][0] - part_ * blocks[1][0]) / size_;
    for (int i = 0; jacobians != nullptr && i < 2; ++i) {
      if (jacobians[i] != nullptr) jacobians[i][0] = (i == 0 ? 1 : -part_) / size_;
    }
    return true;
  }

 private:
  double part_, size_;
};

// Returns the bounds of the components of a block, in the order of the bounds.
std::vector<BoundRows::Bound> BoundsOf(const std::vector<int>& components, const std::vector<double>& min,
                                       const std::vector<double>& max) {
  std::vector<BoundRows::Bound> bounds;
  for (size_t i = 0; i < components.size(); ++i) {
    const double low = min.empty() ? -INFINITY : min[i], high = max.empty() ? INFINITY : max[i];
    const double size = std::isfinite(high - low) && high > low ? high - low : 1;
    if (std::isfinite(low)) bounds.push_back({components[i], -1, low, size});
    if (std::isfinite(high)) bounds.push_back({components[i], 1, high, size});
  }
  return bounds;
}

// Whether some of the events are of a guard in a mode.
template <typename Event>
bool IsOfGuard(const std::vector<Event>& events, int mode, int guard) {
  return std::ranges::any_of(events, [&](const Event& e) { return e.mode == mode && e.guard == guard; });
}

// Sets `x` to the value at a part of the whole time, in [0, 1], of states at equal times, linear in between.
void Interpolate(const std::vector<double>& states, double part, std::vector<double>* x) {
  const size_t n = x->size(), rows = states.size() / n;
  const double place = std::clamp(part, 0.0, 1.0) * static_cast<double>(rows - 1);
  const size_t row = std::min(static_cast<size_t>(place), rows - 2);
  const double weight = place - static_cast<double>(row);
  for (size_t i = 0; i < n; ++i) (*x)[i] = (1 - weight) * states[row * n + i] + weight * states[(row + 1) * n + i];
}

}  // namespace

void HybridScales::Add(const HybridFunctions& functions, const ModePoint& at, const double* slope, double duration) {
  const int mode = at.mode;
  const double time = 0.1 * duration;
  if (mode >= static_cast<int>(state.size())) {
    state.resize(mode + 1);
    guard.resize(mode + 1);
  }
  state[mode].resize(functions.state_size(mode));
  guard[mode].resize(functions.num_guards(mode));
  std::vector<GuardValue> guards(guard[mode].size());
  functions.GuardRates(at, slope, guards.data());
  for (size_t i = 0; i < state[mode].size(); ++i) {
    state[mode][i] = std::max({state[mode][i], std::abs(at.x[i]), time * std::abs(slope[i])});
  }
  for (size_t i = 0; i < guard[mode].size(); ++i) {
    guard[mode][i] = std::max({guard[mode][i], std::abs(guards[i].value), time * std::abs(guards[i].rate)});
  }
}

void HybridScales::Finish() {
  for (auto* of_modes : {&state, &guard}) {
    for (std::vector<double>& scales : *of_modes) {
      for (double& scale : scales) {
        if (!(scale > 0) || !std::isfinite(scale)) scale = 1;
      }
    }
  }
}

HybridTranscription::HybridTranscription(const HybridProblem& problem, const HybridScales& scales,
                                         const PlanOf<ModeEvent>& plan, const Start& start,
                                         const std::vector<double>& overlaps, std::vector<int> steps, int substeps,
                                         double margin, const std::vector<HeldGuard>& held)
    : problem_(problem),
      functions_(problem.system.functions()),
      scales_(scales),
      plan_(plan),
      substeps_(substeps),
      integrator_(functions_),
      parameters_(start.parameters) {
  CHECK_EQ(steps.size(), plan.cuts.size() + 1);
  times_ = {0.0};
  boundary_ = {0};
  for (size_t j = 0; j < steps.size(); ++j) {
    Phase phase;
    phase.mode = j == 0 ? problem.guess.mode : plan.cuts[j - 1] ? plan.cuts[j - 1]->next_mode : phases_.back().mode;
    phase.intervals = steps[j];
    phases_.push_back(phase);
    if (steps[j] > 0) {
      times_.push_back(start.times[j]);
    } else {
      times_.back() = start.times[j];
    }
    boundary_.push_back(static_cast<int>(times_.size()) - 1);
  }
  FindParts();
  for (const std::optional<int>& regime : plan.regimes) {
    laws_.push_back(regime ? functions_.RegimeOf(*regime) : nullptr);
  }
  laws_.resize(plan.cuts.size());
  valid_ = SetInitialValues(start);
  if (!valid_) return;
  FindScalesOfNewModes();
  AddSteps();
  FixGivenValues();
  HoldInstants();
  AddEvents(overlaps);
  if (scales_.are_natural) {
    KeepApart(margin);
  } else {
    AddGuards(margin, held);
    AddGuardsWithinSteps(margin, held);
  }
  AddTerms();
  AddBounds();
}

// Finds the parts that are the same in the modes of all phases; one, of all, if they differ.
void HybridTranscription::FindParts() {
  const auto same = [](const StatePart& a, const StatePart& b) {
    return a.states == b.states && a.controls == b.controls && a.motion == b.motion;
  };
  parts_ = functions_.Parts(phases_.front().mode);
  for (const Phase& phase : phases_) {
    if (std::ranges::equal(parts_, functions_.Parts(phase.mode), same)) continue;
    parts_ = functions_.HybridFunctions::Parts(phases_.front().mode);  // those of the initial state
    break;
  }
  all_.resize(parts_.size());
  std::iota(all_.begin(), all_.end(), 0);
}

std::vector<int> HybridTranscription::PartsOf(const ModeEvent& event) const {
  return IsOnePart() ? all_ : functions_.PartsOf(event.mode, event.guard);
}

int HybridTranscription::StepsOf(int part, int phase) const {
  const int steps = phases_[phase].intervals * substeps_;
  if (parts_[part].motion == StatePart::Motion::kRests) return 0;
  return parts_[part].motion == StatePart::Motion::kCoasts ? std::min(steps, 1) : steps;
}

bool HybridTranscription::CoastsThrough(int part, int phase, int step) const {
  return parts_[part].motion == StatePart::Motion::kCoasts && step > 0 && step < phases_[phase].intervals * substeps_;
}

double* HybridTranscription::NodeAt(int part, int phase, int step) {
  const std::vector<int>& track = phases_[phase].tracks[part];
  const int last = static_cast<int>(track.size()) - 1;
  return nodes_[track[step == phases_[phase].intervals * substeps_ ? last
                      : CoastsThrough(part, phase, step)           ? 0
                                                                   : std::min(step, last)]]
      .data();
}

std::vector<double*> HybridTranscription::NodesAt(const std::vector<int>& parts, int phase, int step) {
  std::vector<double*> nodes;
  for (const int part : parts) nodes.push_back(NodeAt(part, phase, step));
  return nodes;
}

std::vector<double> HybridTranscription::StateAt(int phase, int step) {
  const Phase& of = phases_[phase];
  std::vector<double> x(functions_.state_size(of.mode));
  if (IsOnePart()) {  // which is larger or smaller in other modes
    std::copy_n(NodeAt(0, phase, step), x.size(), x.begin());
    return x;
  }
  const int count = of.intervals * substeps_;
  for (int part = 0; part < static_cast<int>(parts_.size()); ++part) {
    const double* node = NodeAt(part, phase, step);
    std::vector<double> moved;
    if (CoastsThrough(part, phase, step)) {
      moved.resize(parts_[part].states.size());
      const double length = (*End(phase) - *Begin(phase)) * step / count;
      functions_.MovePart(
          part, FlowStep{{of.mode, *Begin(phase), node, nullptr, parameters_.data()}, length}, moved.data(), nullptr);
      node = moved.data();
    }
    for (const int component : parts_[part].states) x[component] = *node++;
  }
  return x;
}

std::vector<double> HybridTranscription::JoinedControl(int interval) const {
  std::vector<double> u(functions_.layout().num_controls);
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    for (std::size_t i = 0; i < parts_[part].controls.size(); ++i) {
      u[parts_[part].controls[i]] = controls_[interval][part][i];
    }
  }
  return u;
}

std::vector<double*> HybridTranscription::ControlBlocks(const std::vector<int>& parts, int interval) {
  std::vector<double*> blocks;
  for (const int part : parts) {
    if (!parts_[part].controls.empty()) blocks.push_back(controls_[interval][part].data());
  }
  return blocks;
}

Divided HybridTranscription::DividedControl(const std::vector<int>& parts) const {
  std::vector<std::vector<int>> controls;
  for (const int part : parts) {
    if (!parts_[part].controls.empty()) controls.push_back(parts_[part].controls);
  }
  return {functions_.layout().num_controls, std::move(controls)};
}

// Returns the parts with some of the components of the state or of the control; all parts, if there are none.
std::vector<int> HybridTranscription::PartsWith(const std::vector<int>& components,
                                                std::vector<int> StatePart::*of) const {
  if (components.empty()) return all_;
  std::vector<int> parts;
  for (const int part : all_) {
    if (std::ranges::find_first_of(parts_[part].*of, components) != (parts_[part].*of).end()) parts.push_back(part);
  }
  return parts;
}

// Returns the functions of the event at the end of a phase.
const HybridFunctions& HybridTranscription::LawOf(int phase) const {
  return laws_[phase] != nullptr ? *laws_[phase] : functions_;
}

// Whether a zero of a guard is no event, as that of discs that separate.
bool HybridTranscription::IsNone(const ModeEvent& event, const ModePoint& at) const {
  std::vector<double> rows(functions_.num_event_rows(event.mode, event.guard));
  functions_.EventRows(at, event.guard, rows.data(), nullptr);
  return std::ranges::any_of(rows, [](double row) { return row > 0; });
}

bool HybridTranscription::SetInitialValues(const Start& start) {
  std::vector<int> last;  // node of each part
  const auto add = [&](int part, const std::vector<double>& x) {
    std::vector<double>& node = nodes_.emplace_back();
    for (const int component : parts_[part].states) node.push_back(x[component]);
    return static_cast<int>(nodes_.size()) - 1;
  };
  for (const int part : all_) last.push_back(add(part, start.initial));
  for (int j = 0; j < num_phases(); ++j) {
    Phase& phase = phases_[j];
    const double begin = *Begin(j), length = *End(j) - begin;
    const int count = phase.intervals * substeps_;
    phase.first_control = static_cast<int>(controls_.size()) - (ContinuesControl(j) ? 1 : 0);
    for (int k = 0; k < phase.intervals && !ContinuesControl(j); ++k) {
      const double whole = *End(LastOfInterval(j)) - begin;
      const double middle = begin + (k + 0.5) * whole / phase.intervals;
      std::vector<std::vector<double>>& control = controls_.emplace_back();
      for (const StatePart& part : parts_) {
        std::vector<double>& block = control.emplace_back();
        for (const int i : part.controls) block.push_back(start.control(i, middle));
      }
    }
    phase.tracks.resize(parts_.size());
    for (const int part : all_) {
      std::vector<int>& track = phase.tracks[part];
      track.push_back(last[part]);
      const int steps = StepsOf(part, j);
      for (int k = 0; k < steps; ++k) {
        const std::vector<double>& x = nodes_[track.back()];
        const double* u = controls_[phase.first_control + k / substeps_][part].data();
        const FlowStep step{
            {phase.mode, begin + k * length / steps, x.data(), u, parameters_.data()}, length / steps, Projects(j, k)};
        std::vector<double> next(x.size());
        if (!start.states.empty()) {
          std::vector<double> whole(start.initial.size());
          Interpolate(start.states, (begin + (k + 1) * length / steps) / times_.back(), &whole);
          track.push_back(add(part, whole));
          continue;
        }
        if (IsOnePart()) {
          integrator_.Step(step, next.data());
        } else {
          functions_.MovePart(part, step, next.data(), nullptr);
        }
        nodes_.push_back(std::move(next));
        track.push_back(static_cast<int>(nodes_.size()) - 1);
      }
      last[part] = track.back();
    }
    if (j + 1 == num_phases()) break;
    if (!plan_.cuts[j]) continue;
    const ModeEvent& event = *plan_.cuts[j];
    if (event.mode != phase.mode) return false;
    if (event.is_switch()) continue;
    std::vector<double> after(functions_.most_states(), NAN);
    const std::vector<double> before = StateAt(j, count);
    const std::vector<double> u =
        controls_.empty() ? std::vector<double>() : JoinedControl(static_cast<int>(controls_.size()) - 1);
    const ModePoint at{event.mode, *End(j), before.data(), u.data(), parameters_.data()};
    const int next = LawOf(j).Reset(at, event.guard, after.data());
    if (LeadsElsewhere(functions_, next, event.next_mode)) return false;
    if (IsNone(event, at)) std::ranges::copy(before, after.begin());
    for (const int part : PartsOf(event)) {
      if (IsOnePart()) {
        nodes_.emplace_back(after.begin(), after.begin() + functions_.state_size(event.next_mode));
        last[part] = static_cast<int>(nodes_.size()) - 1;
      } else {
        last[part] = add(part, after);
      }
    }
  }
  return std::ranges::all_of(nodes_, AllFinite);
}

void HybridTranscription::AddSteps() {
  for (int j = 0; j < num_phases(); ++j) {
    const Phase& phase = phases_[j];
    for (const int i : all_) {
      const int count = StepsOf(i, j);
      const StatePart part = IsOnePart() ? functions_.HybridFunctions::Parts(phase.mode).front() : parts_[i];
      for (int k = 0; k < count; ++k) {
        std::vector<double*> blocks = {nodes_[phase.tracks[i][k]].data()};
        if (!part.controls.empty()) blocks.push_back(controls_[phase.first_control + k / substeps_][i].data());
        if (!parameters_.empty()) blocks.push_back(parameters_.data());
        blocks.insert(blocks.end(), {Begin(j), End(j), nodes_[phase.tracks[i][k + 1]].data()});
        lagrangian_.Add(std::make_unique<StepRows>(functions_,
                                                   &integrator_,
                                                   phase.mode,
                                                   part,
                                                   i,
                                                   IsOnePart(),
                                                   k,
                                                   count,
                                                   Projects(j, k),
                                                   scales_.state[phase.mode]),
                        {.equalities = static_cast<int>(part.states.size()), .affine_blocks = 1},
                        blocks);
      }
    }
  }
}

void HybridTranscription::FixGivenValues() {
  ceres::Problem& ceres = lagrangian_.problem();
  const auto hold = [&](std::vector<double>& block, const std::vector<int>& held) {
    ceres.AddParameterBlock(block.data(), static_cast<int>(block.size()));
    if (held.size() == block.size()) {
      ceres.SetParameterBlockConstant(block.data());
    } else if (!held.empty()) {
      ceres.SetManifold(block.data(), new ceres::SubsetManifold(static_cast<int>(block.size()), held));
    }
  };
  // The places in a block of the components that are not free.
  const auto rest = [](const std::vector<int>& components, const std::vector<int>& free) {
    std::vector<int> held;
    for (std::size_t i = 0; i < components.size(); ++i) {
      if (std::ranges::find(free, components[i]) == free.end()) held.push_back(static_cast<int>(i));
    }
    return held;
  };
  for (const int part : all_) hold(nodes_[part], rest(parts_[part].states, problem_.free.initial));
  if (!parameters_.empty()) {
    std::vector<int> all(parameters_.size());
    std::iota(all.begin(), all.end(), 0);
    hold(parameters_, rest(all, problem_.free.parameters));
  }
  for (std::size_t k = 0; k < controls_.size() && !problem_.free.control; ++k) {
    for (double* block : ControlBlocks(all_, static_cast<int>(k))) ceres.SetParameterBlockConstant(block);
  }
  ceres.SetParameterBlockConstant(&times_.front());
  if (!problem_.free.duration) ceres.SetParameterBlockConstant(&times_.back());
}

// Holds instants where they are; the ends of control intervals as parts of the duration.
void HybridTranscription::HoldInstants() {
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (plan_.on_grid ? EndsWithEvent(j) : plan_.cuts[j].has_value()) continue;
    if (!plan_.on_grid || !problem_.free.duration) {
      lagrangian_.problem().SetParameterBlockConstant(End(j));
      continue;
    }
    lagrangian_.Add(std::make_unique<PartRow>(*End(j) / times_.back(), problem_.guess.duration),
                    {.equalities = 1, .affine_blocks = 2},
                    {End(j), &times_.back()});
  }
}

// The modes that the motion of the scales does not have, from that on which the nodes start.
void HybridTranscription::FindScalesOfNewModes() {
  const size_t known = scales_.state.size();
  std::vector<bool> is_new(functions_.num_modes());
  for (size_t mode = 0; mode < is_new.size(); ++mode) is_new[mode] = mode >= known || scales_.state[mode].empty();
  std::vector<double> slope(functions_.most_states());
  for (int j = 0; j < num_phases(); ++j) {
    const Phase& phase = phases_[j];
    if (!is_new[phase.mode]) continue;
    const int count = phase.intervals * substeps_;
    for (int k = 0; k <= count; ++k) {
      const double t = *Begin(j) + (*End(j) - *Begin(j)) * k / std::max(count, 1);
      const std::vector<double> x = StateAt(j, k), u = JoinedControl(IntervalBefore(k, phase));
      const ModePoint at{phase.mode, t, x.data(), u.data(), parameters_.data()};
      functions_.Flow(at, slope.data());
      scales_.Add(functions_, at, slope.data(), problem_.guess.duration);
    }
  }
  scales_.Finish();
}

// Whether a step is projected. The last one before an event is so by the guard and the reset.
bool HybridTranscription::Projects(int phase, int step) const {
  const bool to_event = EndsWithEvent(phase) && step + 1 == phases_[phase].intervals * substeps_;
  return functions_.Projects(phases_[phase].mode) && !to_event;
}

// The interval that ends at or behind a node of a phase.
int HybridTranscription::IntervalBefore(int node, const Phase& phase) const {
  const int interval = phase.first_control + (std::max(node, 1) - 1) / substeps_;
  return std::min(interval, static_cast<int>(controls_.size()) - 1);
}

void HybridTranscription::AddEvents(const std::vector<double>& overlaps) {
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (!EndsWithEvent(j)) continue;
    const ModeEvent& event = *plan_.cuts[j];
    const int count = phases_[j].intervals * substeps_;
    const std::vector<int> parts = PartsOf(event);
    if (scales_.are_natural && parts.empty()) {  // at a time that is given
      lagrangian_.problem().SetParameterBlockConstant(End(j));
      continue;
    }
    const double size = scales_.OfEvent(event), overlap = overlaps[j] * scales_.guard[event.mode][event.guard] / size;
    const StateAtNode before = MakeState(parts, j, count);
    std::vector<double*> blocks = NodesAt(parts, j, count);
    const std::vector<double*> control = ControlBlocks(all_, IntervalBefore(count, phases_[j]));
    std::vector<double*> with_control = blocks;
    if (functions_.ReadsControl(event.mode, event.guard)) {
      with_control.insert(with_control.end(), control.begin(), control.end());
    }
    for (std::vector<double*>* all : {&blocks, &with_control}) {
      if (!parameters_.empty()) all->push_back(parameters_.data());
      all->push_back(End(j));
    }
    lagrangian_.Add(std::make_unique<GuardRows>(functions_,
                                                event.mode,
                                                std::vector<GuardRows::Row>{{event.guard, overlap, 1 / size}},
                                                before,
                                                DividedControl(all_),
                                                TimeOf{}),
                    {.equalities = 1},
                    with_control);
    if (parts.empty()) continue;  // the event is at a given time and changes no state
    const HybridFunctions& law = LawOf(j);
    if (const int rows = law.num_event_rows(event.mode, event.guard); rows > 0) {
      lagrangian_.Add(std::make_unique<EventRows>(law, event, before), {.inequalities = rows}, blocks);
    }
    const std::vector<double*> after = NodesAt(parts, j + 1, 0);
    blocks.insert(blocks.end(), after.begin(), after.end());
    auto reset = std::make_unique<ResetRows>(law,
                                             event,
                                             before,
                                             DividedState(parts, event.next_mode),
                                             std::vector<const double*>(control.begin(), control.end()),
                                             DividedControl(all_),
                                             scales_.state[event.next_mode]);
    const int rows = reset->num_residuals();
    lagrangian_.Add(std::move(reset), {.equalities = rows, .affine_blocks = static_cast<int>(after.size())}, blocks);
  }
}

// At the ends of steps; where the phase ends with an event, not of its guard. Those that depend on the control are
// evaluated together, as they depend on the same forces.
void HybridTranscription::AddGuards(double margin, const std::vector<HeldGuard>& held) {
  for (int j = 0; j < num_phases(); ++j) {
    const Phase& phase = phases_[j];
    const int count = phase.intervals * substeps_;
    std::vector<std::vector<int>> groups;
    std::vector<int> of_control;
    for (int guard = 0; guard < functions_.num_guards(phase.mode); ++guard) {
      if (functions_.ReadsControl(phase.mode, guard)) {
        of_control.push_back(guard);
      } else {
        groups.push_back({guard});
      }
    }
    if (!of_control.empty()) groups.push_back(of_control);
    for (const std::vector<int>& guards : groups) {
      const bool reads_control = functions_.ReadsControl(phase.mode, guards[0]);
      const std::vector<int> parts = guards.size() == 1 ? PartsOf({phase.mode, guards[0]}) : all_;
      const auto add = [&](int k, int interval) {
        std::vector<GuardRows::Row> rows;
        for (const int guard : guards) {
          if (k == count && EndsWithEvent(j) && plan_.cuts[j]->guard == guard) continue;
          const bool apart = IsOfGuard(plan_.apart, phase.mode, guard) || IsOfGuard(held, phase.mode, guard);
          rows.push_back({guard, apart ? margin : 0.0, -1 / scales_.guard[phase.mode][guard]});
        }
        if (rows.empty()) return;
        const int size = static_cast<int>(rows.size());
        std::vector<double*> blocks = NodesAt(parts, j, k);
        if (reads_control) {
          const std::vector<double*> control = ControlBlocks(all_, interval);
          blocks.insert(blocks.end(), control.begin(), control.end());
        }
        if (!parameters_.empty()) blocks.push_back(parameters_.data());
        blocks.insert(blocks.end(), {Begin(j), End(j)});
        const TimeOf time{static_cast<double>(k) / count, false};
        lagrangian_.Add(
            std::make_unique<GuardRows>(
                functions_, phase.mode, std::move(rows), MakeState(parts, j, k), DividedControl(all_), time),
            {.inequalities = size},
            blocks);
      };
      for (int k = 1; k <= count; ++k) add(k, IntervalBefore(k, phase));
      // At the beginnings of intervals, under the new control.
      for (int k = 0; reads_control && k < phase.intervals; ++k) add(k * substeps_, phase.first_control + k);
    }
  }
}

// In the steps in which the times are, of systems of one part.
void HybridTranscription::AddGuardsWithinSteps(double margin, const std::vector<HeldGuard>& held) {
  for (int j = 0; j < num_phases() && IsOnePart(); ++j) {
    const Phase& phase = phases_[j];
    const int count = phase.intervals * substeps_;
    const double begin = *Begin(j), length = *End(j) - begin;
    for (const HeldGuard& one : held) {
      std::set<int> steps;
      for (const double time : one.times) {
        const bool inside = one.mode == phase.mode && length > 0 && time > begin && time < begin + length;
        if (inside) steps.insert(std::min(static_cast<int>(count * (time - begin) / length), count - 1));
      }
      for (const int k : steps) AddLeastGuard(one.guard, j, k, margin);
    }
  }
}

void HybridTranscription::AddLeastGuard(int guard, int phase, int step, double margin) {
  const Phase& of = phases_[phase];
  const std::vector<int> parts = PartsOf({of.mode, guard});
  std::vector<double*> blocks = NodesAt(parts, phase, step);
  const std::vector<double*> control = ControlBlocks(parts, of.first_control + step / substeps_);
  blocks.insert(blocks.end(), control.begin(), control.end());
  if (!parameters_.empty()) blocks.push_back(parameters_.data());
  blocks.insert(blocks.end(), {Begin(phase), End(phase)});
  lagrangian_.Add(std::make_unique<LeastGuardRow>(functions_,
                                                  of.mode,
                                                  guard,
                                                  MakeState(parts, phase, step),
                                                  DividedControl(parts),
                                                  step,
                                                  of.intervals * substeps_,
                                                  margin,
                                                  scales_.guard[of.mode][guard]),
                  {.inequalities = 1},
                  blocks);
}

// Holds the guards of plan.apart within all steps, except in phases that an event of theirs begins or ends.
void HybridTranscription::KeepApart(double margin) {
  for (const ModeEvent& apart : plan_.apart) {
    const auto happens_at = [&](int k) {
      return k >= 0 && k + 1 < num_phases() && plan_.cuts[k] && plan_.cuts[k]->guard == apart.guard;
    };
    for (int j = 0; j < num_phases(); ++j) {
      if (phases_[j].mode != apart.mode || happens_at(j - 1) || happens_at(j)) continue;
      for (int k = 0; k < phases_[j].intervals * substeps_; ++k) AddLeastGuard(apart.guard, j, k, margin);
    }
  }
}

std::vector<HeldGuard> HybridTranscription::GuardsAtZero() {
  constexpr double kAtZero = 1e-8;  // of the size of a guard
  std::vector<HeldGuard> found;
  for (int j = 0; j < num_phases(); ++j) {
    const Phase& phase = phases_[j];
    const int count = phase.intervals * substeps_;
    for (int step = 0; step < count; ++step) {
      const std::vector<double> u = JoinedControl(phase.first_control + step / substeps_);
      for (const int k : {step, step + 1}) {
        const std::vector<double> x = StateAt(j, k);
        const double t = *Begin(j) + (*End(j) - *Begin(j)) * k / count;
        for (int guard = 0; guard < functions_.num_guards(phase.mode); ++guard) {
          if (k == count && EndsWithEvent(j) && plan_.cuts[j]->guard == guard) continue;
          if (IsOfGuard(found, phase.mode, guard)) continue;
          const double value = functions_.Guard({phase.mode, t, x.data(), u.data(), parameters_.data()}, guard);
          if (std::abs(value) <= kAtZero * scales_.guard[phase.mode][guard]) found.push_back({phase.mode, guard});
        }
      }
    }
  }
  return found;
}

Divided HybridTranscription::DividedState(const std::vector<int>& parts, int mode) const {
  if (IsOnePart()) return {functions_.state_size(mode), {functions_.HybridFunctions::Parts(mode).front().states}};
  std::vector<std::vector<int>> states;
  for (const int part : parts) states.push_back(parts_[part].states);
  return {functions_.state_size(mode), std::move(states)};
}

StateAtNode HybridTranscription::MakeState(const std::vector<int>& parts, int phase, int step) const {
  std::vector<bool> coasts;
  for (const int part : parts) coasts.push_back(CoastsThrough(part, phase, step));
  const Phase& of = phases_[phase];
  const double part_of_phase = static_cast<double>(step) / std::max(of.intervals * substeps_, 1);
  return {functions_, of.mode, DividedState(parts, of.mode), parts, std::move(coasts), part_of_phase};
}

bool HybridTranscription::AreGiven(const std::vector<double*>& blocks) const {
  const ceres::Problem& ceres = lagrangian_.problem();
  return std::ranges::all_of(
      blocks, [&](double* block) { return ceres.HasParameterBlock(block) && ceres.IsParameterBlockConstant(block); });
}

void HybridTranscription::AddTerms() {
  const double root = 1 / std::sqrt(scales_.loss);
  // At a node of a phase, with the control of an interval.
  const auto add = [&](const HybridTerm& term,
                       int phase,
                       int node,
                       int control,
                       const TimeOf& time,
                       int intervals,
                       const std::vector<double*>& times) {
    const int n = functions_.state_size(phases_[phase].mode);
    if (term.with_state && term.function->parameter_block_sizes()[0] != n) return;
    std::vector<double*> blocks;
    const auto append = [&](const std::vector<double*>& more) {
      blocks.insert(blocks.end(), more.begin(), more.end());
    };
    std::optional<StateAtNode> state, initial;
    const std::vector<int> read = PartsWith(term.reads_states, &StatePart::states);
    const std::vector<int> pushed = PartsWith(term.reads_controls, &StatePart::controls);
    if (term.with_state) {
      state.emplace(MakeState(read, phase, node));
      append(NodesAt(read, phase, node));
    }
    if (term.with_initial) {
      initial.emplace(MakeState(all_, 0, 0));
      append(NodesAt(all_, 0, 0));
    }
    if (term.with_control) append(ControlBlocks(pushed, control));
    const int rows = term.NumRows();
    RowRoles roles;
    double scale = 1;
    if (term.role == HybridTerm::Role::kCost) {
      scale = root * (plan_.only_violation ? kCostOfViolation : 1);
    } else if (term.role == HybridTerm::Role::kValue) {
      roles.values = rows;
      scale = root * root * (plan_.only_violation ? kCostOfViolation * kCostOfViolation : 1);
    } else if (term.role == HybridTerm::Role::kInequality) {
      roles.inequalities = rows;
      const bool limits_states = scales_.are_natural && !term.with_control;
      roles.are_goals = term.at == HybridTerm::Timing::kEnd || limits_states;
    } else if (!plan_.only_violation) {
      roles.equalities = rows;
    }
    auto function = std::make_unique<TermRows>(term,
                                               FunctionIn(term, problem_.system, phases_[phase].mode, substeps_),
                                               std::move(state),
                                               std::move(initial),
                                               DividedControl(pushed),
                                               functions_.layout().num_parameters,
                                               time,
                                               intervals,
                                               LeastLength(),
                                               scale);
    if (function->reads_parameters()) blocks.push_back(parameters_.data());
    if (function->is_timed()) append(times);
    if (term.role == HybridTerm::Role::kInequality) roles.are_curved = term.with_control && blocks.size() == 1;
    if (!term.IsCost() && AreGiven(blocks)) return;
    lagrangian_.Add(std::move(function), roles, blocks);
  };
  for (const HybridTerm& term : problem_.terms) {
    int interval = -1;  // of the control, that of the phase
    if (term.at == HybridTerm::Timing::kEnd) {
      const int last = num_phases() - 1;
      add(term, last, phases_[last].intervals * substeps_, -1, {}, 1, {End(last)});
      continue;
    }
    for (int j = 0, found = 0; j < num_phases(); ++j) {
      const Phase& phase = phases_[j];
      if (term.at == HybridTerm::Timing::kEvent) {
        const bool counts = EndsWithEvent(j) && term.CountsAt(functions_, plan_.cuts[j]->mode, plan_.cuts[j]->guard);
        if (!counts || (found++ != term.occurrence && term.occurrence >= 0)) continue;
        if (term.before) {
          add(term, j, phase.intervals * substeps_, -1, {}, 1, {End(j)});
        } else {
          add(term, j + 1, 0, -1, {}, 1, {End(j)});
        }
        continue;
      }
      if (ContinuesControl(j)) continue;
      ++interval;
      if (term.interval >= 0 && term.interval != interval) continue;  // of plans on the grid alone
      if (term.mode >= 0 && term.mode != functions_.BaseMode(phase.mode)) continue;
      for (int k = 0; k < phase.intervals; ++k) {
        add(term,
            j,
            k * substeps_,
            phase.first_control + k,
            {static_cast<double>(k) / phase.intervals, false},
            phase.intervals,
            {Begin(j), End(LastOfInterval(j))});
      }
    }
  }
}

void HybridTranscription::AddBounds() {
  for (int j = 0; j < num_phases(); ++j) {
    const bool is_given = plan_.on_grid && !ContinuesControl(j) && !EndsWithEvent(j);
    if (phases_[j].intervals == 0 || is_given) continue;
    lagrangian_.Add(std::make_unique<LengthRow>(problem_.guess.duration),
                    {.inequalities = 1, .affine_blocks = 2},
                    {Begin(j), End(j)});
  }
  const HybridFree& free = problem_.free;
  const auto add = [&](double* block,
                       int size,
                       const std::vector<int>& components,
                       const std::vector<double>& min,
                       const std::vector<double>& max,
                       bool are_goals = false) {
    std::vector<BoundRows::Bound> bounds = BoundsOf(components, min, max);
    for (BoundRows::Bound& bound : bounds) bound.size *= scales_.are_natural ? 0.5 : 1;  // that of one side
    const int rows = static_cast<int>(bounds.size());
    if (rows > 0)
      lagrangian_.Add(std::make_unique<BoundRows>(size, std::move(bounds)),
                      {.inequalities = rows, .affine_blocks = 1, .are_bounds = true, .are_goals = are_goals},
                      {block});
  };
  // The bounds of the components of a block that are free.
  const auto of_block =
      [](const std::vector<int>& components, const std::vector<int>& variables, const std::vector<double>& bounds) {
        std::vector<double> found;
        for (std::size_t i = 0; i < variables.size() && !bounds.empty(); ++i) {
          if (std::ranges::find(components, variables[i]) != components.end()) found.push_back(bounds[i]);
        }
        return found;
      };
  const auto places = [](const std::vector<int>& components, const std::vector<int>& variables) {
    std::vector<int> found;
    for (const int variable : variables) {
      const auto place = std::ranges::find(components, variable);
      if (place != components.end()) found.push_back(static_cast<int>(place - components.begin()));
    }
    return found;
  };
  const auto add_part = [&](std::vector<double>* block,
                            const std::vector<int>& components,
                            const std::vector<int>& variables,
                            const std::vector<double>& min,
                            const std::vector<double>& max) {
    add(block->data(),
        static_cast<int>(block->size()),
        places(components, variables),
        of_block(components, variables, min),
        of_block(components, variables, max));
  };
  std::vector<int> all(functions_.layout().num_controls);
  std::iota(all.begin(), all.end(), 0);
  for (std::size_t k = 0; k < controls_.size() && free.control; ++k) {
    for (const int part : all_) {
      add_part(&controls_[k][part], parts_[part].controls, all, free.control_min, free.control_max);
    }
  }
  for (const int part : all_) {
    add_part(&nodes_[part], parts_[part].states, free.initial, free.initial_min, free.initial_max);
  }
  add(parameters_.data(),
      static_cast<int>(parameters_.size()),
      free.parameters,
      free.parameters_min,
      free.parameters_max,
      /*are_goals=*/true);
  if (!free.duration) return;
  if (scales_.are_natural) {  // steps end at the bounds, as a motion that is longer by far has other events
    lagrangian_.problem().SetParameterLowerBound(&times_.back(), 0, free.duration_min);
    lagrangian_.problem().SetParameterUpperBound(&times_.back(), 0, free.duration_max);
  } else {
    add(&times_.back(), 1, {0}, {free.duration_min}, {free.duration_max});
  }
}

double HybridTranscription::LeastLength() const {
  int intervals = 0;
  for (const Phase& phase : phases_) intervals += phase.intervals;
  return kLeastLength * problem_.guess.duration / intervals;
}

AugmentedLagrangian::Summary HybridTranscription::Minimize(AugmentedLagrangian::Options options) {
  int steps = 0;
  for (const Phase& phase : phases_) steps = std::max(steps, phase.intervals * substeps_);
  // Steps of parts are linear in all but their length, and need no caution unless that is free.
  if (!scales_.are_natural) {
    if (IsOnePart() || problem_.free.duration) options.weight_of_costs = kWeightOfCosts;
    options.most_open = kMostOpen;
    options.gain = kGain;
    options.change_of_multipliers = kChangeOfMultipliers;
  }
  options.most_cost /= scales_.loss;
  options.ScaleTo(steps);
  if (options.callback) {
    options.callback = [this, callback = options.callback](double cost) { return callback(cost * scales_.loss); };
  }
  AugmentedLagrangian::Summary summary = lagrangian_.Minimize(options);
  summary.cost *= scales_.loss;
  return summary;
}

std::vector<double> HybridTranscription::CutTimes() const {
  std::vector<double> times;
  for (size_t k = 0; k < plan_.cuts.size(); ++k) times.push_back(times_[boundary_[k + 1]]);
  return times;
}

std::vector<double> HybridTranscription::CutSpeeds() {
  std::vector<double> speeds, slope;
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (!EndsWithEvent(j)) {
      speeds.push_back(-1);  // no guard grazes
      continue;
    }
    const ModeEvent& event = *plan_.cuts[j];
    const std::vector<double> x = StateAt(j, phases_[j].intervals * substeps_);
    const std::vector<double> u = JoinedControl(std::max(phases_[j].first_control + phases_[j].intervals - 1, 0));
    const double t = times_[boundary_[j + 1]];
    slope.resize(x.size());
    const ModePoint at{event.mode, t, x.data(), u.data(), parameters_.data()};
    functions_.Flow(at, slope.data());
    double rate = 0;
    functions_.GuardRate(at, event.guard, slope.data(), &rate);
    speeds.push_back(rate * problem_.guess.duration / scales_.OfEvent(event));
  }
  return speeds;
}

std::vector<double> HybridTranscription::InitialState() const {
  std::vector<double> x(problem_.guess.initial.size());
  for (const int part : all_) {
    const double* node = nodes_[part].data();
    for (const int component : parts_[part].states) x[component] = *node++;
  }
  return x;
}

void HybridTranscription::Control(std::vector<double>* control, std::vector<double>* durations) const {
  control->clear();
  durations->clear();
  for (int k = 0; k < static_cast<int>(controls_.size()); ++k) {
    const std::vector<double> u = JoinedControl(k);
    control->insert(control->end(), u.begin(), u.end());
  }
  for (int j = 0; j < num_phases(); ++j) {
    const int intervals = phases_[j].intervals;
    const double length = times_[boundary_[j + 1]] - times_[boundary_[j]];
    if (ContinuesControl(j)) {
      durations->back() += length;
    } else {
      durations->insert(durations->end(), intervals, length / intervals);
    }
  }
}

}  // namespace saltus
