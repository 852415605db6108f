#include "solve/phases/hybrid_transcription.h"

#include <ceres/cost_function.h>
#include <ceres/manifold.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/statistics.h"

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
  double At(double const* const* blocks) const {
    return one_block ? blocks[0][0] : blocks[0][0] + part * (blocks[1][0] - blocks[0][0]);
  }
  // The derivative by block i.
  double By(int i) const { return one_block ? 1 : i == 1 ? part : 1 - part; }
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

// The sizes that are not 0.
std::vector<int> Joined(std::initializer_list<int> sizes) {
  std::vector<int> joined;
  for (const int size : sizes) {
    if (size > 0) joined.push_back(size);
  }
  return joined;
}

// The defect of a step. Blocks: state, control and parameters if there are any, begin and end of the phase, next state.
class StepRows final : public Rows {
 public:
  StepRows(const HybridFunctions& functions, RungeKutta* integrator, int mode, int index, int count, bool projects,
           std::vector<double> sizes)
      : Rows(static_cast<int>(sizes.size()), Joined({functions.state_size(mode),
                                                     functions.layout().num_controls,
                                                     functions.layout().num_parameters,
                                                     1,
                                                     1,
                                                     functions.state_size(mode)})),
        functions_(functions),
        integrator_(*integrator),
        mode_(mode),
        index_(index),
        count_(count),
        projects_(projects),
        scale_(Eigen::Map<const Eigen::VectorXd>(sizes.data(), sizes.size()).cwiseInverse()) {}

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = num_residuals(), m = functions_.layout().num_controls, P = functions_.layout().num_parameters;
    const int of_control = 1, of_parameters = of_control + (m > 0), times = of_parameters + (P > 0);
    const double begin = blocks[times][0], end = blocks[times + 1][0], part = static_cast<double>(index_) / count_;
    const double *u = m > 0 ? blocks[of_control] : nullptr, *p = P > 0 ? blocks[of_parameters] : nullptr;
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[of_parameters] != nullptr;
    const FlowStep step{
        {mode_, begin + part * (end - begin), blocks[0], u, p, by_parameters}, (end - begin) / count_, projects_};
    Eigen::VectorXd after(n);
    Matrix by;
    if (jacobians != nullptr) {
      by = integrator_.Jacobian(step, after.data());
    } else {
      integrator_.Step(step, after.data());
    }
    Eigen::Map<Eigen::VectorXd>(rows, n) =
        scale_.cwiseProduct(Eigen::Map<const Eigen::VectorXd>(blocks[times + 2], n) - after);
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    by = -(scale_.asDiagonal() * by);
    Put(jacobians, 0, by.leftCols(n));
    if (m > 0) Put(jacobians, of_control, by.middleCols(n + 1 + P, m));
    if (by_parameters) Put(jacobians, of_parameters, by.middleCols(n + 1, P));
    Put(jacobians, times, (1 - part) * by.col(n) - by.rightCols(1) / count_);
    Put(jacobians, times + 1, part * by.col(n) + by.rightCols(1) / count_);
    Put(jacobians, times + 2, Matrix(scale_.asDiagonal()));
    return true;
  }

 private:
  const HybridFunctions& functions_;
  RungeKutta& integrator_;
  int mode_, index_, count_;
  bool projects_;
  Eigen::VectorXd scale_;
};

// Rows offset + factor g of some guards of a mode, all or none of which depend on the control. Blocks: state, control
// if they depend on it, parameters if there are any, and the time.
class GuardRows final : public Rows {
 public:
  struct Row {
    int guard;
    double offset, factor;
  };
  GuardRows(const HybridFunctions& functions, int mode, std::vector<Row> rows, const TimeOf& time)
      : Rows(static_cast<int>(rows.size()),
             Joined({functions.state_size(mode),
                     functions.ReadsControl(mode, rows[0].guard) ? functions.layout().num_controls : 0,
                     functions.layout().num_parameters,
                     1,
                     time.one_block ? 0 : 1})),
        functions_(functions),
        reads_control_(functions.ReadsControl(mode, rows[0].guard)),
        mode_(mode),
        guards_(std::move(rows)),
        time_(time) {}

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(mode_), P = functions_.layout().num_parameters,
              m = functions_.layout().num_controls;
    const int of_parameters = 1 + reads_control_, times = of_parameters + (P > 0);
    const double *u = reads_control_ ? blocks[1] : nullptr, *p = P > 0 ? blocks[of_parameters] : nullptr;
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[of_parameters] != nullptr;
    const ModePoint at{mode_, time_.At(blocks + times), blocks[0], u, p, by_parameters};
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
    const auto place = [&](const Row& row) { return one ? 0 : row.guard; };
    for (size_t i = 0; i < guards_.size(); ++i) {
      rows[i] = guards_[i].offset + guards_[i].factor * values[place(guards_[i])];
    }
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    for (size_t i = 0; i < guards_.size(); ++i) {
      const auto gradient = gradients.row(place(guards_[i]));
      const double factor = guards_[i].factor;
      const auto put = [&](int block, const auto& derivative) {
        if (jacobians[block] == nullptr) return;
        Eigen::Map<Eigen::RowVectorXd>(jacobians[block] + i * derivative.size(), derivative.size()) = derivative;
      };
      put(0, factor * gradient.head(n));
      if (reads_control_) put(1, factor * gradient.tail(m));
      if (by_parameters) put(of_parameters, factor * gradient.segment(n + 1, P));
      for (int k = 0; k < time_.num_blocks(); ++k) put(times + k, factor * time_.By(k) * gradient.segment(n, 1));
    }
    return true;
  }

 private:
  const HybridFunctions& functions_;
  bool reads_control_;
  int mode_;
  std::vector<Row> guards_;
  TimeOf time_;
};

// The defect of a reset. Blocks: state before, parameters if there are any, time, state after. `control` acts before
// it; where it matters, for the next mode only, that follows from the guards of the phase behind.
class ResetRows final : public Rows {
 public:
  ResetRows(const HybridFunctions& functions, const ModeEvent& event, const double* control,
            const std::vector<double>& sizes)
      : Rows(static_cast<int>(sizes.size()), Joined({functions.state_size(event.mode),
                                                     functions.layout().num_parameters,
                                                     1,
                                                     functions.state_size(event.next_mode)})),
        functions_(functions),
        event_(event),
        control_(control),
        scale_(Eigen::Map<const Eigen::VectorXd>(sizes.data(), sizes.size()).cwiseInverse()) {}

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const int n = functions_.state_size(event_.mode), after = num_residuals(), P = functions_.layout().num_parameters;
    const int most = functions_.most_states();
    const int time = 1 + (P > 0);
    Eigen::VectorXd x_plus = Eigen::VectorXd::Constant(most, NAN);
    Matrix jacobian(most, n + 1 + P);
    const bool by_parameters = P > 0 && jacobians != nullptr && jacobians[1] != nullptr;
    const ModePoint at{event_.mode, blocks[time][0], blocks[0], control_, P > 0 ? blocks[1] : nullptr, by_parameters};
    const int next = functions_.ResetJacobian(at, event_.guard, x_plus.data(), jacobian.data());
    if (next != event_.next_mode && !functions_.CreatesModes()) return false;
    Eigen::Map<Eigen::VectorXd>(rows, after) =
        scale_.cwiseProduct(Eigen::Map<const Eigen::VectorXd>(blocks[time + 1], after) - x_plus.head(after));
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    const Matrix by = -(scale_.asDiagonal() * jacobian.topRows(after));
    Put(jacobians, 0, by.leftCols(n));
    if (by_parameters) Put(jacobians, 1, by.rightCols(P));
    Put(jacobians, time, by.col(n));
    Put(jacobians, time + 1, Matrix(scale_.asDiagonal()));
    return true;
  }

 private:
  const HybridFunctions& functions_;
  ModeEvent event_;
  const double* control_;
  Eigen::VectorXd scale_;
};

// A term of the problem. Blocks: state, control and parameters if it reads them; the time, or begin and end of the
// phase, if it reads the time or the length.
class TermRows final : public Rows {
 public:
  TermRows(const HybridTerm& term, const TimeOf& time, int intervals, double least, double scale)
      : Rows(term.function->num_residuals(), Blocks(term, time)),
        term_(term),
        time_(time),
        intervals_(intervals),
        least_(least),
        scale_(scale) {}

  bool Evaluate(double const* const* blocks, double* rows, double** jacobians) const override {
    const bool timed = term_.with_time || term_.with_length;
    const int own = static_cast<int>(parameter_block_sizes().size()) - (timed ? time_.num_blocks() : 0);
    double const* const* times = blocks + own;
    double time = 0, length = 0;
    bool grows = false;
    if (timed) {
      time = time_.At(times);
      length = time_.one_block ? 0 : (times[1][0] - times[0][0]) / intervals_;
      grows = length > least_;
      length = std::max(length, least_);
    }
    std::vector<const double*> in(blocks, blocks + own);
    if (term_.with_time) in.push_back(&time);
    if (term_.with_length) in.push_back(&length);
    const int count = num_residuals();
    std::vector<double*> out(jacobians != nullptr ? in.size() : 0);
    Eigen::VectorXd by_time(count), by_length(count);
    for (int i = 0; i < own && jacobians != nullptr; ++i) out[i] = jacobians[i];
    if (jacobians != nullptr && term_.with_time) out[own] = by_time.data();
    if (jacobians != nullptr && term_.with_length) out.back() = by_length.data();
    if (!term_.function->Evaluate(in.data(), rows, jacobians != nullptr ? out.data() : nullptr)) return false;
    for (int i = 0; i < count; ++i) rows[i] *= scale_;
    if (!AreFinite(rows)) return false;
    if (jacobians == nullptr) return true;
    for (int i = 0; i < own; ++i) {
      if (jacobians[i] == nullptr) continue;
      for (int j = 0; j < count * parameter_block_sizes()[i]; ++j) jacobians[i][j] *= scale_;
    }
    for (int i = 0; timed && i < time_.num_blocks(); ++i) {
      Eigen::VectorXd by = Eigen::VectorXd::Zero(count);
      if (term_.with_time) by += time_.By(i) * by_time;
      if (term_.with_length && grows) by += (i == 1 ? 1.0 : -1.0) / intervals_ * by_length;
      Put(jacobians, own + i, scale_ * by);
    }
    return true;
  }

 private:
  static std::vector<int> Blocks(const HybridTerm& term, const TimeOf& time) {
    std::vector<int> sizes = term.function->parameter_block_sizes();
    sizes.resize(sizes.size() - term.with_time - term.with_length);
    if (term.with_time || term.with_length) sizes.resize(sizes.size() + time.num_blocks(), 1);
    return sizes;
  }

  const HybridTerm term_;
  TimeOf time_;
  int intervals_;
  double least_, scale_;
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
    Matrix by = Matrix::Zero(num_residuals(), parameter_block_sizes()[0]);
    for (size_t i = 0; i < bounds_.size(); ++i) {
      const Bound& bound = bounds_[i];
      rows[i] = bound.sign * (blocks[0][bound.component] - bound.at) / bound.size;
      by(static_cast<int>(i), bound.component) = bound.sign / bound.size;
    }
    if (jacobians != nullptr) Put(jacobians, 0, by);
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
                                         double margin)
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
  valid_ = Lay(start);
  if (!valid_) return;
  FindScalesOfNewModes();
  AddSteps();
  HoldWhatIsGiven();
  if (plan.on_grid) HoldGrid();
  AddEvents(overlaps);
  AddGuards(margin);
  AddTerms();
  AddBounds();
}

bool HybridTranscription::Lay(const Start& start) {
  const int m = functions_.layout().num_controls;
  nodes_.push_back(start.initial);
  for (int j = 0; j < num_phases(); ++j) {
    Phase& phase = phases_[j];
    const double begin = *Begin(j), length = *End(j) - begin;
    const int count = phase.intervals * substeps_;
    phase.first_node = static_cast<int>(nodes_.size()) - 1;
    phase.first_control = static_cast<int>(controls_.size()) - (GoesOn(j) ? 1 : 0);
    for (int k = 0; k < count; ++k) {
      if (k % substeps_ == 0 && !GoesOn(j)) {
        const double whole = *End(LastOfInterval(j)) - begin;
        const double middle = begin + (k / substeps_ + 0.5) * whole / phase.intervals;
        std::vector<double>& u = controls_.emplace_back(m);
        for (int i = 0; i < m; ++i) u[i] = start.control(i, middle);
      }
      const std::vector<double>& x = nodes_.back();
      const FlowStep step{
          {phase.mode, begin + k * length / count, x.data(), controls_.back().data(), parameters_.data()},
          length / count,
          Projects(j, k)};
      std::vector<double> next(x.size());
      if (start.states.empty()) {
        integrator_.Step(step, next.data());
      } else {
        Interpolate(start.states, (begin + (k + 1) * length / count) / times_.back(), &next);
      }
      nodes_.push_back(std::move(next));
    }
    phase.last_node = static_cast<int>(nodes_.size()) - 1;
    if (j + 1 == num_phases()) break;
    if (!plan_.cuts[j]) continue;
    const ModeEvent& event = *plan_.cuts[j];
    if (event.mode != phase.mode) return false;
    if (event.is_switch()) continue;
    std::vector<double> after(functions_.most_states(), NAN);
    const double* u = controls_.empty() ? nullptr : controls_.back().data();
    const int next =
        functions_.Reset({event.mode, *End(j), nodes_.back().data(), u, parameters_.data()}, event.guard, after.data());
    if (next != event.next_mode && !functions_.CreatesModes()) return false;
    after.resize(functions_.state_size(event.next_mode));
    nodes_.push_back(std::move(after));
  }
  return std::ranges::all_of(nodes_, AllFinite);
}

void HybridTranscription::AddSteps() {
  for (int j = 0; j < num_phases(); ++j) {
    const Phase& phase = phases_[j];
    const int count = phase.intervals * substeps_;
    for (int k = 0; k < count; ++k) {
      std::vector<double*> blocks = {nodes_[phase.first_node + k].data()};
      if (!controls_.front().empty()) blocks.push_back(controls_[phase.first_control + k / substeps_].data());
      if (!parameters_.empty()) blocks.push_back(parameters_.data());
      blocks.insert(blocks.end(), {Begin(j), End(j), nodes_[phase.first_node + k + 1].data()});
      lagrangian_.Add(std::make_unique<StepRows>(
                          functions_, &integrator_, phase.mode, k, count, Projects(j, k), scales_.state[phase.mode]),
                      {.equalities = static_cast<int>(scales_.state[phase.mode].size()), .affine_blocks = 1},
                      blocks);
    }
  }
}

void HybridTranscription::HoldWhatIsGiven() {
  ceres::Problem& ceres = lagrangian_.problem();
  const auto hold = [&](std::vector<double>& block, const std::vector<int>& free) {
    ceres.AddParameterBlock(block.data(), static_cast<int>(block.size()));
    if (free.empty()) {
      ceres.SetParameterBlockConstant(block.data());
    } else if (free.size() < block.size()) {
      std::vector<int> held;
      for (int i = 0; i < static_cast<int>(block.size()); ++i) {
        if (std::find(free.begin(), free.end(), i) == free.end()) held.push_back(i);
      }
      ceres.SetManifold(block.data(), new ceres::SubsetManifold(static_cast<int>(block.size()), held));
    }
  };
  hold(nodes_.front(), problem_.free.initial);
  if (!parameters_.empty()) hold(parameters_, problem_.free.parameters);
  if (!problem_.free.control && !controls_.front().empty()) {
    for (std::vector<double>& u : controls_) ceres.SetParameterBlockConstant(u.data());
  }
  ceres.SetParameterBlockConstant(&times_.front());
  if (!problem_.free.duration) ceres.SetParameterBlockConstant(&times_.back());
}

// Holds the ends of control intervals where they are, as parts of the duration.
void HybridTranscription::HoldGrid() {
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (EndsWithEvent(j)) continue;
    if (!problem_.free.duration) {
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
    const int count = std::max(phase.intervals * substeps_, 1);
    for (int node = phase.first_node; node <= phase.last_node; ++node) {
      const double t = *Begin(j) + (*End(j) - *Begin(j)) * (node - phase.first_node) / count;
      const double* u = ControlBefore(node - phase.first_node, phase);
      const ModePoint at{phase.mode, t, nodes_[node].data(), u, parameters_.data()};
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

// The control of the interval that ends at or behind a node of a phase.
double* HybridTranscription::ControlBefore(int node, const Phase& phase) {
  const int interval = phase.first_control + (std::max(node, 1) - 1) / substeps_;
  return controls_[std::min<size_t>(interval, controls_.size() - 1)].data();
}

void HybridTranscription::AddEvents(const std::vector<double>& overlaps) {
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (!EndsWithEvent(j)) continue;
    const ModeEvent& event = *plan_.cuts[j];
    double *before = nodes_[phases_[j].last_node].data(), *after = nodes_[phases_[j + 1].first_node].data();
    std::vector<double*> blocks = {before};
    double* control = ControlBefore(phases_[j].last_node - phases_[j].first_node, phases_[j]);
    if (functions_.ReadsControl(event.mode, event.guard)) blocks.push_back(control);
    if (!parameters_.empty()) blocks.push_back(parameters_.data());
    blocks.push_back(End(j));
    lagrangian_.Add(
        std::make_unique<GuardRows>(
            functions_,
            event.mode,
            std::vector<GuardRows::Row>{{event.guard, overlaps[j], 1 / scales_.guard[event.mode][event.guard]}},
            TimeOf{}),
        {.equalities = 1},
        blocks);
    if (functions_.ReadsControl(event.mode, event.guard)) blocks.erase(blocks.begin() + 1);
    blocks.push_back(after);
    const std::vector<double>& sizes = scales_.state[event.next_mode];
    lagrangian_.Add(std::make_unique<ResetRows>(functions_, event, control, sizes),
                    {.equalities = static_cast<int>(sizes.size()), .affine_blocks = 1},
                    blocks);
  }
}

// At the ends of steps; where the phase ends with an event, not of its guard. Those that depend on the control are
// evaluated together, as they depend on the same forces.
void HybridTranscription::AddGuards(double margin) {
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
      const auto add = [&](int k, double* control) {
        std::vector<GuardRows::Row> rows;
        for (const int guard : guards) {
          if (k == count && EndsWithEvent(j) && plan_.cuts[j]->guard == guard) continue;
          const bool apart = std::any_of(plan_.apart.begin(), plan_.apart.end(), [&](const ModeEvent& event) {
            return event.mode == phase.mode && event.guard == guard;
          });
          rows.push_back({guard, apart ? margin : 0.0, -1 / scales_.guard[phase.mode][guard]});
        }
        if (rows.empty()) return;
        const int size = static_cast<int>(rows.size());
        std::vector<double*> blocks = {nodes_[phase.first_node + k].data()};
        if (reads_control) blocks.push_back(control);
        if (!parameters_.empty()) blocks.push_back(parameters_.data());
        blocks.insert(blocks.end(), {Begin(j), End(j)});
        const TimeOf time{static_cast<double>(k) / count, false};
        lagrangian_.Add(
            std::make_unique<GuardRows>(functions_, phase.mode, std::move(rows), time), {.inequalities = size}, blocks);
      };
      for (int k = 1; k <= count; ++k) add(k, ControlBefore(k, phase));
      // At the beginnings of intervals, under the new control.
      for (int k = 0; reads_control && k < phase.intervals; ++k) {
        add(k * substeps_, controls_[phase.first_control + k].data());
      }
    }
  }
}

void HybridTranscription::AddTerms() {
  const double root = 1 / std::sqrt(scales_.loss);
  const auto add = [&](const HybridTerm& term,
                       int node,
                       int control,
                       const TimeOf& time,
                       int intervals,
                       const std::vector<double*>& times) {
    std::vector<double*> blocks;
    if (term.with_state) {
      if (term.function->parameter_block_sizes()[0] != static_cast<int>(nodes_[node].size())) return;
      blocks.push_back(nodes_[node].data());
    }
    if (term.with_initial) blocks.push_back(nodes_[phases_.front().first_node].data());
    if (term.with_control) blocks.push_back(controls_[control].data());
    if (term.with_parameters) blocks.push_back(parameters_.data());
    if (term.with_time || term.with_length) blocks.insert(blocks.end(), times.begin(), times.end());
    const int rows = term.function->num_residuals();
    RowRoles roles;
    double scale = 1;
    if (term.role == HybridTerm::Role::kCost) {
      scale = root * (plan_.only_violation ? kCostOfViolation : 1);
    } else if (term.role == HybridTerm::Role::kValue) {
      roles.values = rows;
      scale = root * root * (plan_.only_violation ? kCostOfViolation * kCostOfViolation : 1);
    } else if (term.role == HybridTerm::Role::kInequality) {
      roles.inequalities = rows;
      roles.are_goals = term.at == HybridTerm::At::kEnd;
      roles.are_curved = term.with_control && blocks.size() == 1;
    } else if (!plan_.only_violation) {
      roles.equalities = rows;
    }
    lagrangian_.Add(std::make_unique<TermRows>(term, time, intervals, LeastLength(), scale), roles, blocks);
  };
  for (const HybridTerm& term : problem_.terms) {
    int interval = -1;  // of the control, that of the phase
    if (term.at == HybridTerm::At::kEnd) {
      add(term, phases_.back().last_node, -1, {}, 1, {End(num_phases() - 1)});
      continue;
    }
    for (int j = 0, found = 0; j < num_phases(); ++j) {
      const Phase& phase = phases_[j];
      if (term.at == HybridTerm::At::kEvent) {
        const bool counts = EndsWithEvent(j) && term.CountsAt(functions_, plan_.cuts[j]->mode, plan_.cuts[j]->guard);
        if (!counts || (found++ != term.occurrence && term.occurrence >= 0)) continue;
        add(term, term.before ? phase.last_node : phases_[j + 1].first_node, -1, {}, 1, {End(j)});
        continue;
      }
      if (GoesOn(j)) continue;
      ++interval;
      if (term.interval >= 0 && term.interval != interval) continue;  // of plans on the grid alone
      if (term.mode >= 0 && term.mode != functions_.BaseMode(phase.mode)) continue;
      for (int k = 0; k < phase.intervals; ++k) {
        add(term,
            phase.first_node + k * substeps_,
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
    const bool is_given = plan_.on_grid && !GoesOn(j) && !EndsWithEvent(j);
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
                       const std::vector<double>& max) {
    std::vector<BoundRows::Bound> bounds = BoundsOf(components, min, max);
    const int rows = static_cast<int>(bounds.size());
    if (rows > 0)
      lagrangian_.Add(std::make_unique<BoundRows>(size, std::move(bounds)),
                      {.inequalities = rows, .affine_blocks = 1, .are_bounds = true},
                      {block});
  };
  std::vector<int> all(functions_.layout().num_controls);
  std::iota(all.begin(), all.end(), 0);
  for (std::vector<double>& u : controls_) {
    if (free.control) add(u.data(), static_cast<int>(u.size()), all, free.control_min, free.control_max);
  }
  add(nodes_.front().data(), static_cast<int>(nodes_.front().size()), free.initial, free.initial_min, free.initial_max);
  add(parameters_.data(),
      static_cast<int>(parameters_.size()),
      free.parameters,
      free.parameters_min,
      free.parameters_max);
  if (free.duration) add(&times_.back(), 1, {0}, {free.duration_min}, {free.duration_max});
}

double HybridTranscription::LeastLength() const {
  int intervals = 0;
  for (const Phase& phase : phases_) intervals += phase.intervals;
  return kLeastLength * problem_.guess.duration / intervals;
}

AugmentedLagrangian::Summary HybridTranscription::Minimize(AugmentedLagrangian::Options options) {
  int steps = 0;
  for (const Phase& phase : phases_) steps = std::max(steps, phase.intervals * substeps_);
  options.weight_of_costs = kWeightOfCosts;
  options.most_open = kMostOpen;
  options.gain = kGain;
  options.change_of_multipliers = kChangeOfMultipliers;
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

std::vector<double> HybridTranscription::CutSpeeds() const {
  std::vector<double> speeds, slope;
  for (int j = 0; j + 1 < num_phases(); ++j) {
    if (!EndsWithEvent(j)) {
      speeds.push_back(-1);  // no guard grazes
      continue;
    }
    const ModeEvent& event = *plan_.cuts[j];
    const std::vector<double>& x = nodes_[phases_[j].last_node];
    const int control = std::max(phases_[j].first_control + phases_[j].intervals - 1, 0);
    const double t = times_[boundary_[j + 1]];
    slope.resize(x.size());
    const ModePoint at{event.mode, t, x.data(), controls_[control].data(), parameters_.data()};
    functions_.Flow(at, slope.data());
    double rate = 0;
    functions_.GuardRate(at, event.guard, slope.data(), &rate);
    speeds.push_back(rate * problem_.guess.duration / scales_.guard[event.mode][event.guard]);
  }
  return speeds;
}

void HybridTranscription::Control(std::vector<double>* control, std::vector<double>* durations) const {
  control->clear();
  durations->clear();
  for (const std::vector<double>& u : controls_) control->insert(control->end(), u.begin(), u.end());
  for (int j = 0; j < num_phases(); ++j) {
    const int intervals = phases_[j].intervals;
    const double length = times_[boundary_[j + 1]] - times_[boundary_[j]];
    if (GoesOn(j)) {
      durations->back() += length;
    } else {
      durations->insert(durations->end(), intervals, length / intervals);
    }
  }
}

}  // namespace saltus
