#include "control/hybrid_shooting.h"

#include <ceres/cost_function.h>
#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace saltus {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

}  // namespace

HybridProblem WithAllFree(HybridProblem problem) {
  HybridInput& guess = problem.guess;
  guess.control.resize(static_cast<std::size_t>(guess.num_intervals) * problem.system.num_controls());
  problem.free = {.control = problem.system.num_controls() > 0, .duration = true};
  problem.free.initial.resize(guess.initial.size());
  problem.free.parameters.resize(guess.parameters.size());
  std::iota(problem.free.initial.begin(), problem.free.initial.end(), 0);
  std::iota(problem.free.parameters.begin(), problem.free.parameters.end(), 0);
  return problem;
}

HybridShooting::HybridShooting(const HybridProblem& problem)
    : problem_(problem), simulator_(problem.system, problem.integration) {
  CHECK_EQ(WhatIsWrongWith(problem), "");
  const HybridFree& free = problem_.free;
  const HybridInput& guess = problem_.guess;
  const auto add = [&](double value, const std::vector<double>& min, const std::vector<double>& max, std::size_t i) {
    guess_.push_back(value);
    lower_.push_back(min.empty() ? -std::numeric_limits<double>::infinity() : min[i]);
    upper_.push_back(max.empty() ? std::numeric_limits<double>::infinity() : max[i]);
  };
  const int width = problem_.system.num_controls();
  for (int i = 0; free.control && i < guess.num_intervals * width; ++i) {
    add(guess.control.empty() ? 0.0 : guess.control[i], free.control_min, free.control_max, i % width);
  }
  for (std::size_t i = 0; i < free.initial.size(); ++i) {
    add(guess.initial[free.initial[i]], free.initial_min, free.initial_max, i);
  }
  for (std::size_t i = 0; i < free.parameters.size(); ++i) {
    add(guess.parameters[free.parameters[i]], free.parameters_min, free.parameters_max, i);
  }
  if (free.duration) add(guess.duration, {free.duration_min}, {free.duration_max}, 0);
  for (std::size_t i = 0; i < guess_.size(); ++i) guess_[i] = std::clamp(guess_[i], lower_[i], upper_[i]);
  for (const HybridTerm& term : problem_.terms) {
    if (term.role != HybridTerm::Role::kCost || term.at == HybridTerm::At::kEvent) continue;
    const int times = term.at == HybridTerm::At::kEachInterval ? guess.num_intervals : 1;
    num_residuals_ += times * term.function->num_residuals();
  }
}

HybridInput HybridShooting::InputAt(std::span<const double> z) const {
  const HybridFree& free = problem_.free;
  HybridInput input = problem_.guess;
  auto next = z.begin();
  if (input.control.empty()) {
    input.control.assign(static_cast<std::size_t>(input.num_intervals) * problem_.system.num_controls(), 0.0);
  }
  if (free.control) {
    for (double& number : input.control) number = *next++;
  }
  for (const int i : free.initial) input.initial[i] = *next++;
  for (const int i : free.parameters) input.parameters[i] = *next++;
  if (free.duration) input.duration = *next++;
  return input;
}

std::vector<double> HybridShooting::DurationsAt(std::span<const double> z) const {
  if (!problem_.free.duration && problem_.guess.lengths.empty()) return {};
  std::vector<double> times = InputAt(z).Times();
  std::adjacent_difference(times.begin(), times.end(), times.begin());
  times.erase(times.begin());
  return times;
}

bool HybridShooting::Rollout(std::span<const double> z) {
  CHECK_EQ(z.size(), guess_.size());
  why_.clear();
  stopped_ = stopped_ || (stop_ && stop_());
  if (stopped_) return false;
  return RolloutOf(InputAt(z));
}

bool HybridShooting::RolloutOf(HybridInput input) {
  input_ = std::move(input);
  if (why_ = WhatIsWrongWith(input_, problem_.system); !why_.empty()) return false;
  if (!simulator_.Rollout(input_)) {
    why_ = simulator_.WhyFailed();
    return false;
  }
  times_ = input_.Times();
  return FindPlaces();
}

bool HybridShooting::FindPlaces() {
  places_.clear();
  constraint_places_.clear();
  int rows = 0;
  const std::vector<HybridEvent>& events = simulator_.events();
  for (const HybridTerm& term : problem_.terms) {
    const bool is_cost = term.role == HybridTerm::Role::kCost;
    std::vector<Place>& places = is_cost ? places_ : constraint_places_;
    const int state_size = term.with_state ? term.function->parameter_block_sizes()[0] : 0;
    const int count = term.function->num_residuals();
    if (term.at == HybridTerm::At::kEvent) {
      for (std::size_t i = 0; i < events.size(); ++i) {
        if (events[i].mode != term.mode || events[i].guard != term.guard) continue;
        const std::span<const double> state = term.before ? events[i].before : events[i].after;
        if (term.with_state && static_cast<int>(state.size()) != state_size) {
          why_ = term.name + ": found a state of " + std::to_string(state.size()) +
                 " numbers at the event at t = " + std::to_string(events[i].time) + ", expected " +
                 std::to_string(state_size);
          return false;
        }
        places.push_back({&term, -1, static_cast<int>(i), state, events[i].time, -1});
      }
      continue;
    }
    const bool at_end = term.at == HybridTerm::At::kEnd;
    for (int k = 0; k < (at_end ? 1 : input_.num_intervals); ++k) {
      const int node = at_end ? input_.num_intervals : k, mode = simulator_.ModeAt(node);
      const std::span<const double> state = simulator_.StateAt(node);
      const bool counts = term.mode < 0 || term.mode == mode;
      const bool fits = !term.with_state || static_cast<int>(state.size()) == state_size;
      if (at_end && !(counts && fits)) {
        why_ =
            term.name + ": the motion ends in mode '" + problem_.system.ModeName(mode) + "', where it does not apply";
        return false;
      }
      // Rows of intervals in another mode stay zero.
      if (counts && fits) {
        places.push_back({&term, at_end ? -1 : k, -1, state, times_[node], rows});
      }
      if (is_cost) rows += count;
    }
  }
  return true;
}

std::vector<const double*> HybridShooting::BlocksOf(const Place& place, const double* length) const {
  const HybridTerm& term = *place.term;
  std::vector<const double*> blocks;
  if (term.with_state) blocks.push_back(place.state.data());
  if (term.with_control) blocks.push_back(input_.control.data() + place.interval * problem_.system.num_controls());
  if (term.with_parameters) blocks.push_back(input_.parameters.data());
  if (term.with_time) blocks.push_back(&place.time);
  if (term.with_length) blocks.push_back(length);
  return blocks;
}

bool HybridShooting::ValuesAt(const Place& place, bool with_jacobians, Values* values) const {
  const HybridTerm& term = *place.term;
  const double length = place.interval >= 0 ? times_[place.interval + 1] - times_[place.interval] : 0;
  const std::vector<const double*> blocks = BlocksOf(place, &length);
  const int rows = term.function->num_residuals();
  values->residuals.resize(rows);
  values->jacobians.clear();
  std::vector<double*> jacobians;
  for (const int size : term.function->parameter_block_sizes()) {
    if (with_jacobians) jacobians.push_back(values->jacobians.emplace_back(rows * size).data());
  }
  return term.function->Evaluate(blocks.data(), values->residuals.data(), with_jacobians ? jacobians.data() : nullptr);
}

bool HybridShooting::Simulate(const HybridInput& input, Outcome* outcome) {
  why_.clear();
  *outcome = {};
  if (!RolloutOf(input)) return false;
  Values values;
  for (const std::vector<Place>* places : {&places_, &constraint_places_}) {
    for (const Place& place : *places) {
      if (!ValuesAt(place, false, &values)) {
        why_ = place.term->name + ": the function has no value";
        return false;
      }
      for (const double r : values.residuals) {
        if (place.term->role == HybridTerm::Role::kCost) {
          outcome->loss += r * r;
          continue;
        }
        const double violation = place.term->role == HybridTerm::Role::kEquality ? std::abs(r) : r;
        if (!(violation <= outcome->violation)) {
          outcome->violation = violation;
          outcome->worst = place.term->name;
        }
      }
    }
  }
  if (std::isfinite(outcome->loss) && !std::isnan(outcome->violation)) return true;
  why_ = "the loss is not finite";
  return false;
}

bool HybridShooting::EvaluateTerms(std::vector<TermAt>* terms) const {
  terms->clear();
  Values values;
  for (const std::vector<Place>* places : {&places_, &constraint_places_}) {
    for (const Place& place : *places) {
      if (!ValuesAt(place, true, &values)) return false;
      TermAt& at =
          terms->emplace_back(TermAt{place.term, place.interval, place.event, values.residuals, values.jacobians, {}});
      const double length = place.interval >= 0 ? times_[place.interval + 1] - times_[place.interval] : 0;
      const std::vector<int>& sizes = place.term->function->parameter_block_sizes();
      const std::vector<const double*> blocks = BlocksOf(place, &length);
      for (std::size_t i = 0; i < blocks.size(); ++i) at.blocks.emplace_back(blocks[i], blocks[i] + sizes[i]);
    }
  }
  return true;
}

bool HybridShooting::Evaluate(std::span<const double> z, double* loss, double* gradient) {
  if (!Rollout(z)) return false;
  const HybridSystem& system = problem_.system;
  const int num_controls = system.num_controls(), num_parameters = system.num_parameters();
  *loss = 0;
  HybridCotangent cotangent;
  // What terms read of z themselves.
  std::vector<double> by_control(input_.control.size()), by_parameters(num_parameters);
  double by_duration = 0;
  bool reads_motion = false;
  const auto add_to = [&](std::vector<double>* sum, const double* addend, std::size_t size) {
    reads_motion = true;
    sum->resize(size);
    for (std::size_t i = 0; i < size; ++i) (*sum)[i] += addend[i];
  };
  Values values;
  for (const Place& place : places_) {
    if (!ValuesAt(place, gradient != nullptr, &values)) {
      why_ = place.term->name + ": the function has no value";
      return false;
    }
    for (const double residual : values.residuals) *loss += residual * residual;
    if (gradient == nullptr) continue;
    const HybridTerm& term = *place.term;
    auto jacobian = values.jacobians.begin();
    const auto pull_back = [&] {
      const Eigen::Map<const Eigen::RowVectorXd> r(values.residuals.data(), values.residuals.size());
      const auto width = static_cast<int>(jacobian->size() / values.residuals.size());
      const Eigen::Map<const Matrix> J((jacobian++)->data(), r.size(), width);
      return Eigen::RowVectorXd(2 * r * J);
    };
    if (term.with_state) {
      const Eigen::RowVectorXd by_state = pull_back();
      std::vector<double>* sum = &cotangent.final_state;
      if (place.interval >= 0) {
        cotangent.nodes.resize(input_.num_intervals);
        sum = &cotangent.nodes[place.interval];
      } else if (place.event >= 0) {
        std::vector<std::vector<double>>& of_events = term.before ? cotangent.before : cotangent.after;
        of_events.resize(simulator_.events().size());
        sum = &of_events[place.event];
      }
      add_to(sum, by_state.data(), by_state.size());
    }
    if (term.with_control) {
      const Eigen::RowVectorXd by = pull_back();
      for (int i = 0; i < num_controls; ++i) by_control[place.interval * num_controls + i] += by[i];
    }
    if (term.with_parameters) {
      const Eigen::RowVectorXd by = pull_back();
      for (int i = 0; i < num_parameters; ++i) by_parameters[i] += by[i];
    }
    if (term.with_time) {
      const double by = pull_back()[0];
      if (place.event >= 0) {
        reads_motion = true;
        cotangent.event_times.resize(simulator_.events().size());
        cotangent.event_times[place.event] += by;
      } else {
        by_duration += by * place.time / input_.duration;
      }
    }
    if (term.with_length) by_duration += pull_back()[0] * PartOf(place.interval);
  }
  if (!std::isfinite(*loss)) {
    why_ = "the loss is not finite";
    return false;
  }
  if (gradient == nullptr) return true;
  HybridGradient of_motion;
  if (reads_motion) {
    ++num_adjoints_;
    of_motion = simulator_.Adjoint(cotangent);
    for (std::size_t i = 0; i < by_control.size(); ++i) by_control[i] += of_motion.control[i];
    for (int i = 0; i < num_parameters; ++i) by_parameters[i] += of_motion.parameters[i];
    by_duration += of_motion.duration;
  } else {
    of_motion.initial.resize(input_.initial.size());
  }
  const HybridFree& free = problem_.free;
  if (free.control) gradient = std::copy(by_control.begin(), by_control.end(), gradient);
  for (const int i : free.initial) *gradient++ = of_motion.initial[i];
  for (const int i : free.parameters) *gradient++ = by_parameters[i];
  if (free.duration) *gradient++ = by_duration;
  return true;
}

bool HybridShooting::EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) {
  if (!Rollout(z)) return false;
  std::fill_n(residuals, num_residuals_, 0.0);
  Values values;
  for (const Place& place : places_) {
    if (place.first_row < 0) continue;
    if (!ValuesAt(place, false, &values)) {
      why_ = place.term->name + ": the function has no value";
      return false;
    }
    std::copy(values.residuals.begin(), values.residuals.end(), residuals + place.first_row);
  }
  if (!std::all_of(residuals, residuals + num_residuals_, [](double number) { return std::isfinite(number); })) {
    why_ = "the loss is not finite";
    return false;
  }
  if (jacobian != nullptr) ResidualJacobian(jacobian);
  return true;
}

void HybridShooting::ResidualJacobian(double* jacobian) {
  const HybridFree& free = problem_.free;
  const HybridSystem& system = problem_.system;
  ++num_adjoints_;
  const HybridSensitivity motion = simulator_.Sensitivity();
  // By all of the input, of which the variables are some columns.
  const int n0 = static_cast<int>(input_.initial.size()), controls = static_cast<int>(input_.control.size());
  const int first_parameter = n0 + controls, duration = motion.columns - 1;
  std::vector<int> columns;
  for (int i = 0; free.control && i < controls; ++i) columns.push_back(n0 + i);
  for (const int i : free.initial) columns.push_back(i);
  for (const int i : free.parameters) columns.push_back(first_parameter + i);
  if (free.duration) columns.push_back(duration);
  Eigen::Map<Matrix> out(jacobian, num_residuals_, num_variables());
  out.setZero();
  Values values;
  for (const Place& place : places_) {
    if (place.first_row < 0) continue;
    CHECK(ValuesAt(place, true, &values));
    const HybridTerm& term = *place.term;
    const auto rows = static_cast<int>(values.residuals.size());
    Matrix all = Matrix::Zero(rows, motion.columns);
    auto block = values.jacobians.begin();
    const auto next = [&] {
      const Eigen::Map<const Matrix> J(block->data(), rows, static_cast<int>(block->size()) / rows);
      ++block;
      return J;
    };
    if (term.with_state) {
      const std::vector<double>& by = place.interval >= 0 ? motion.nodes[place.interval] : motion.final_state;
      all += next() * Eigen::Map<const Matrix>(by.data(), static_cast<int>(place.state.size()), motion.columns);
    }
    const int m = system.num_controls();
    if (term.with_control) all.middleCols(n0 + place.interval * m, m) += next();
    if (term.with_parameters) all.middleCols(first_parameter, system.num_parameters()) += next();
    if (term.with_time) {
      all.col(duration) += next() * (place.time / input_.duration);
    }
    if (term.with_length) all.col(duration) += next() * PartOf(place.interval);
    for (std::size_t j = 0; j < columns.size(); ++j) {
      out.block(place.first_row, j, rows, 1) = all.col(columns[j]);
    }
  }
}

}  // namespace saltus
