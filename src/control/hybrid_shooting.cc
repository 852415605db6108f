#include "control/hybrid_shooting.h"

#include <ceres/cost_function.h>
#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "base/number_text.h"
#include "base/random.h"
#include "base/statistics.h"
#include "base/table.h"
#include "hybrid/greatest_values.h"
#include "hybrid/motion_derivatives.h"
#include "hybrid/recorded_functions.h"

namespace saltus {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A reverse sweep for a row of the Jacobian takes as long as the forward sweep of so many columns.
constexpr int kColumnsOfRow = 4;

// The group of a term's residuals, in their order.
int GroupOf(const HybridTerm& term) {
  switch (term.role) {
    case HybridTerm::Role::kEquality:
      return 0;
    case HybridTerm::Role::kInequality:
      return 1;
    case HybridTerm::Role::kValue:
      return 2;
    default:
      return 3;
  }
}

bool IsAtEachEvent(const HybridTerm& term) { return term.at == HybridTerm::Timing::kEvent && term.occurrence < 0; }

// A cost at each event has rows for so many events. Those after the last of them share its rows, so that the number of
// rows does not change with the motion.
constexpr int kEventsWithRows = 16;

// Adds residuals to their rows: one that is shared holds the root of the sum of the squares.
void AddResiduals(std::span<const double> residuals, double* rows) {
  for (const double residual : residuals) {
    *rows = *rows == 0 ? residual : std::hypot(*rows, residual);
    ++rows;
  }
}

constexpr const char* kWayToEvents = "start from a guess that has them, or solve along a sequence with them";

}  // namespace

HybridProblem FreeAllVariables(HybridProblem problem) {
  HybridInput& guess = problem.guess;
  guess.control.resize(static_cast<std::size_t>(guess.num_intervals) * problem.system.num_controls());
  problem.free = {.control = problem.system.num_controls() > 0, .duration = true};
  problem.free.initial.resize(guess.initial.size());
  problem.free.parameters.resize(guess.parameters.size());
  std::iota(problem.free.initial.begin(), problem.free.initial.end(), 0);
  std::iota(problem.free.parameters.begin(), problem.free.parameters.end(), 0);
  return problem;
}

bool IsOnGrid(const HybridProblem& problem) {
  if (std::ranges::any_of(problem.terms, [](const HybridTerm& term) { return term.interval >= 0; })) return true;
  const std::span<const double> control(problem.guess.control);
  const size_t width = problem.system.num_controls();
  return !problem.free.control && control.size() > width &&
         !std::ranges::equal(control.subspan(width), control.first(control.size() - width));
}

HybridShooting::HybridShooting(const HybridProblem& problem)
    : problem_(problem), simulator_(problem.system, problem.integration) {
  CHECK_EQ(Validate(problem), "");
  const int width = problem_.system.num_controls();
  start_ = problem_.guess;
  if (start_.control.empty()) start_.control.assign(static_cast<std::size_t>(start_.num_intervals) * width, 0.0);
  variables_ = FreeVariables(problem_.free, width, start_.num_intervals);
  for (const FreeVariable& variable : variables_) {
    guess_.push_back(std::clamp(variable.Access(start_), variable.min, variable.max));
  }
  CountResiduals();
}

bool HybridShooting::HasRows(const HybridTerm& term) const {
  if (IsAtEachEvent(term) && !term.IsCost()) return false;
  return !(leaves_out_ && IsOfIntervalAlone(term));
}

void HybridShooting::CountResiduals() {
  int counts[] = {0, 0, 0, 0};
  for (const HybridTerm& term : problem_.terms) {
    if (!HasRows(term)) continue;
    const bool repeats = term.at == HybridTerm::Timing::kEachInterval && term.interval < 0;
    const int times = IsAtEachEvent(term) ? kEventsWithRows : repeats ? start_.num_intervals : 1;
    counts[GroupOf(term)] += times * term.function->num_residuals();
  }
  num_equalities_ = counts[0];
  num_inequalities_ = counts[1];
  num_values_ = counts[2];
  num_residuals_ = counts[0] + counts[1] + counts[2] + counts[3];
}

bool HybridShooting::IsOfIntervalAlone(const HybridTerm& term) {
  return term.role == HybridTerm::Role::kCost && term.mode < 0 && term.with_control && !term.with_state &&
         !term.with_initial && !term.with_parameters && !term.with_time;
}

bool HybridShooting::LeaveOutCostsOfIntervals() {
  leaves_out_ = std::ranges::any_of(
      problem_.terms, [this](const HybridTerm& term) { return HasRows(term) && !IsOfIntervalAlone(term); });
  CountResiduals();
  return leaves_out_;
}

HybridInput HybridShooting::InputAt(std::span<const double> z) const {
  HybridInput input = start_;
  for (std::size_t i = 0; i < z.size(); ++i) variables_[i].Access(input) = z[i];
  return input;
}

std::vector<double> HybridShooting::DurationsAt(std::span<const double> z) const {
  if (!problem_.free.duration && problem_.guess.lengths.empty()) return {};
  std::vector<double> times = InputAt(z).Times();
  std::adjacent_difference(times.begin(), times.end(), times.begin());
  times.erase(times.begin());
  return times;
}

bool HybridShooting::Rollout(std::span<const double> z, bool with_derivatives) {
  CHECK_EQ(z.size(), guess_.size());
  why_.clear();
  stopped_ = stopped_ || (stop_ && stop_());
  if (stopped_) return false;
  return RolloutOf(InputAt(z), with_derivatives);
}

bool HybridShooting::RolloutOf(HybridInput input, bool with_derivatives) {
  input_ = std::move(input);
  has_motion_ = false;
  if (why_ = Validate(input_, problem_.system); !why_.empty()) return false;
  has_motion_ = Move(input_, with_derivatives);
  return has_motion_ && FindPlaces();
}

bool HybridShooting::Move(const HybridInput& input, bool /*with_derivatives*/) {
  const bool moves = accurate_ ? simulator_.RolloutAccurately(input) : simulator_.Rollout(input);
  return moves || Fail(simulator_.FailureReason());
}

bool HybridShooting::Fail(std::string why) {
  why_ = std::move(why);
  return false;
}

bool HybridShooting::FindPlaces() {
  places_.clear();
  const int first_value = num_equalities_ + num_inequalities_;
  int next_rows[] = {0, num_equalities_, first_value, first_value + num_values_};
  const std::vector<double> times = input_.Times();
  const std::vector<HybridEvent>& events = Events();
  const HybridFunctions& functions = problem_.system.functions();
  for (const HybridTerm& term : problem_.terms) {
    int& rows = next_rows[GroupOf(term)];
    const int state_size = term.with_state ? term.function->parameter_block_sizes()[0] : 0;
    const int count = term.function->num_residuals();
    if (term.at == HybridTerm::Timing::kEvent) {
      int found = 0;
      for (std::size_t i = 0; i < events.size(); ++i) {
        if (!term.CountsAt(functions, events[i].mode, events[i].guard)) continue;
        if (found++ != term.occurrence && term.occurrence >= 0) continue;
        const std::span<const double> state = term.before ? events[i].before : events[i].after;
        if (term.with_state && static_cast<int>(state.size()) != state_size) {
          return Fail(term.name + ": found a state of " + std::to_string(state.size()) +
                      " numbers at the event at t = " + std::to_string(events[i].time) + ", expected " +
                      std::to_string(state_size));
        }
        const int before = IsAtEachEvent(term) ? count * std::min(found, kEventsWithRows) - count : 0;
        const int first_row = HasRows(term) ? rows + before : -1;
        places_.push_back({&term, term.function, -1, static_cast<int>(i), state, events[i].time, 0, first_row});
      }
      if (term.occurrence >= found) {
        return Fail(term.name + ": found " + std::to_string(found) + " events '" + term.event +
                    "' in the motion, expected at least " + std::to_string(term.occurrence + 1) + "; " + kWayToEvents);
      }
      if (HasRows(term)) rows += count * (IsAtEachEvent(term) ? kEventsWithRows : 1);
      continue;
    }
    const bool at_end = term.at == HybridTerm::Timing::kEnd;
    const int first = std::max(term.interval, 0), past = term.interval >= 0 ? first + 1 : input_.num_intervals;
    for (int k = first; k < (at_end ? 1 : past); ++k) {
      const int node = at_end ? input_.num_intervals : k, mode = ModeAt(node);
      const std::span<const double> state = StateAt(node);
      const bool counts = term.mode < 0 || term.mode == functions.BaseMode(mode);
      const bool fits = !term.with_state || static_cast<int>(state.size()) == state_size;
      if (at_end && !(counts && fits)) {
        return Fail(term.name + ": the motion ends in mode '" + problem_.system.ModeName(mode) +
                    "', where it does not apply");
      }
      // Rows of intervals in another mode stay zero.
      if (counts && fits) {
        const double length = at_end ? 0 : times[k + 1] - times[k];
        const int first_row = HasRows(term) ? rows : -1;
        places_.push_back({&term, CostInMode(term, mode), at_end ? -1 : k, -1, state, times[node], length, first_row});
      }
      if (HasRows(term)) rows += count;
    }
  }
  std::ranges::stable_partition(places_, [](const Place& place) { return place.term->IsCost(); });
  return true;
}

std::shared_ptr<const ceres::CostFunction> HybridShooting::CostInMode(const HybridTerm& term, int mode) const {
  return FunctionIn(term, problem_.system, mode, simulator_.steps_per_interval());
}

std::vector<const double*> HybridShooting::BlocksOf(const Place& place) const {
  const HybridTerm& term = *place.term;
  std::vector<const double*> blocks;
  if (term.with_state) blocks.push_back(place.state.data());
  if (term.with_initial) blocks.push_back(input_.initial.data());
  if (term.with_control) blocks.push_back(input_.control.data() + place.interval * problem_.system.num_controls());
  if (term.with_parameters) blocks.push_back(input_.parameters.data());
  if (term.with_time) blocks.push_back(&place.time);
  if (term.with_length) blocks.push_back(&place.length);
  return blocks;
}

const HybridTerm* HybridShooting::FindJumpingTerm(int event, int interval, double loss) const {
  constexpr double kRounding = 1e-9, kViolated = 1e-8;
  const HybridFunctions& functions = problem_.system.functions();
  const HybridEvent& at = Events()[event];
  const std::vector<double> times = input_.Times();
  double change = 0, size = std::abs(loss);
  const HybridTerm* last = nullptr;
  for (const HybridTerm& term : problem_.terms) {
    if (term.at != HybridTerm::Timing::kEachInterval || !term.with_state) continue;
    if (term.interval >= 0 && term.interval != interval) continue;
    const double change_before = change;
    bool violated = false;
    const auto add = [&](int mode, std::span<const double> state, double sign) {
      const bool counts = (term.mode < 0 || term.mode == functions.BaseMode(mode)) &&
                          term.function->parameter_block_sizes()[0] == static_cast<int>(state.size());
      Values values;
      const double length = times[interval + 1] - times[interval];
      const Place place{&term, CostInMode(term, mode), interval, -1, state, times[interval], length};
      if (!counts || !ValuesAt(place, false, &values)) return;
      for (const double row : values.residuals) {
        if (term.IsCost()) {
          change += sign * term.LossOf(row);
          size += std::abs(term.LossOf(row));
        } else {
          violated = violated || row > kViolated || (term.role == HybridTerm::Role::kEquality && row < -kViolated);
        }
      }
    };
    add(at.mode, at.before, -1);
    add(at.next_mode, at.after, 1);
    if (violated) return &term;
    if (change != change_before) last = &term;
  }
  return std::abs(change) <= kRounding * size ? nullptr : last;
}

std::string HybridShooting::DescribeLossJumps(double loss) const {
  constexpr double kSameTime = 1e-12;  // of the duration
  const std::vector<double> times = input_.Times();
  std::string remark;
  for (int event = 0; event < std::ssize(Events()); ++event) {
    const HybridEvent& at = Events()[event];
    const auto near = [&](double time) { return std::abs(time - at.time) <= kSameTime * input_.duration; };
    const auto node = std::ranges::find_if(times, near);
    if (node == times.end() || node + 1 == times.end()) continue;
    const HybridTerm* term = FindJumpingTerm(event, static_cast<int>(node - times.begin()), loss);
    if (term == nullptr) continue;
    remark += (remark.empty() ? "" : "; ") + ("guard '" + problem_.system.GuardName(at.mode, at.guard)) +
              "' has an event at t = " + ToText(at.time, 6) + ", where " + term->name +
              " reads the state: the loss jumps as the event crosses this time";
  }
  return remark;
}

int HybridShooting::ModeOf(const Place& place) const {
  if (place.event < 0) return ModeAt(place.interval >= 0 ? place.interval : input_.num_intervals);
  const HybridEvent& event = Events()[place.event];
  return place.term->before ? event.mode : event.next_mode;
}

std::vector<std::string> HybridShooting::NamesAt(const Place& place) const {
  const HybridTerm& term = *place.term;
  const HybridLayout& layout = problem_.system.layout();
  std::vector<std::string> names;
  const auto add_states = [&](int mode, const std::string& before) {
    for (int i = 0; i < problem_.system.state_size(mode); ++i) {
      names.push_back(before + problem_.system.functions().StateName(mode, i));
    }
  };
  const auto add = [&](const std::vector<std::string>& given, int count, const char* otherwise) {
    for (int i = 0; i < count; ++i) {
      names.push_back(given.empty() ? otherwise + ("[" + std::to_string(i) + "]") : given[i]);
    }
  };
  if (term.with_state) add_states(ModeOf(place), "");
  if (term.with_initial) add_states(input_.mode, "initial ");
  if (term.with_control) add(layout.control_names, layout.num_controls, "u");
  if (term.with_parameters) add(layout.parameter_names, layout.num_parameters, "p");
  if (term.with_time) names.emplace_back("t");
  if (term.with_length) names.emplace_back("h");
  return names;
}

Eigen::VectorXd HybridShooting::ChangeAt(const Place& place, const HybridSensitivity* motion,
                                         const std::vector<double>& direction) {
  const std::vector<int>& sizes = place.function->parameter_block_sizes();
  Values one;
  for (const int size : sizes) one.jacobians.emplace_back(size);
  Eigen::VectorXd change = Eigen::VectorXd::Zero(std::accumulate(sizes.begin(), sizes.end(), 0));
  Eigen::Index row = 0;
  for (std::vector<double>& block : one.jacobians) {
    for (double& number : block) {
      number = 1;
      Derivative of_number = MakeUndefinedDerivative();
      PullBack(place, one, Eigen::RowVectorXd::Ones(1), &of_number);
      const HybridGradient by = TotalOf(std::move(of_number), motion);
      for (std::size_t j = 0; j < variables_.size(); ++j) change[row] += variables_[j].Access(by) * direction[j];
      number = 0;
      ++row;
    }
  }
  return change;
}

// Costs whose slopes differ from side to side of the motion, as the variables change along a direction.
std::string HybridShooting::DescribeLossKinks() {
  std::vector<double> direction;
  NormalStream random(1);
  for (std::size_t j = 0; j < variables_.size(); ++j) direction.push_back(random.Next());
  std::optional<HybridSensitivity> motion;
  std::string remark;
  const HybridTerm* last = nullptr;  // that was named
  for (const Place& place : places_) {
    const auto* cost = dynamic_cast<const RecordedCost*>(place.function.get());
    if (cost == nullptr || !place.term->IsCost() || place.term == last) continue;
    const std::vector<const double*> blocks = BlocksOf(place);
    const std::vector<std::string> names = cost->UndecidedAt(blocks, NamesAt(place));
    Values values;
    if (names.empty() || !ValuesAt(place, true, &values)) continue;
    if (!motion) motion = simulator_.Sensitivity(!problem_.free.parameters.empty());
    const bool forward = place.event < 0 || !place.term->before;
    const Eigen::VectorXd change = ChangeAt(place, forward ? &*motion : nullptr, direction);
    if (!change.allFinite()) continue;
    Eigen::VectorXd here(change.size()), slope = Eigen::VectorXd::Zero(1);
    const auto loss_of = [&](std::span<const double> residuals) {
      double loss = 0;
      for (const double residual : residuals) loss += place.term->LossOf(residual);
      return Eigen::VectorXd::Constant(1, loss);
    };
    Eigen::Index begin = 0;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      const auto size = static_cast<Eigen::Index>(cost->parameter_block_sizes()[i]);
      const auto rows = static_cast<Eigen::Index>(values.residuals.size());
      here.segment(begin, size) = Eigen::Map<const Eigen::VectorXd>(blocks[i], size);
      const Eigen::VectorXd of_block =
          Eigen::Map<const Matrix>(values.jacobians[i].data(), rows, size) * change.segment(begin, size);
      for (Eigen::Index row = 0; row < rows; ++row) {
        slope[0] += place.term->SlopeOf(values.residuals[row]) * of_block[row];
      }
      begin += size;
    }
    const auto beside = [&](double part) -> std::optional<Eigen::VectorXd> {
      const Eigen::VectorXd there = here + part * change;
      std::vector<const double*> moved;
      std::vector<double> residuals(values.residuals.size());
      const double* next = there.data();
      for (const int size : cost->parameter_block_sizes()) {
        moved.push_back(next);
        next += size;
      }
      cost->Evaluate(moved.data(), residuals.data(), nullptr);
      return loss_of(residuals);
    };
    if (!HasKinkAlong(loss_of(values.residuals), slope, (1 + here.norm()) / (1 + change.norm()), beside)) continue;
    last = place.term;
    remark += (remark.empty() ? "" : "; ") + last->name + " is not smooth " + DescribePlace(place) + ", where " +
              Joined(names, ", ", "'") + (names.size() == 1 ? " is" : " are") +
              " zero: its derivatives differ from side to side";
  }
  return remark;
}

std::string HybridShooting::DescribeJumpsAndKinks(double loss) {
  std::string remark = DescribeLossJumps(loss);
  const std::string kinks = DescribeLossKinks();
  return remark + (remark.empty() || kinks.empty() ? "" : "; ") + kinks;
}

std::string HybridShooting::TermsWithoutEvents() const {
  std::string remark;
  for (const HybridTerm& term : problem_.terms) {
    const auto counts = [&](const HybridEvent& event) {
      return term.CountsAt(problem_.system.functions(), event.mode, event.guard);
    };
    if (term.at != HybridTerm::Timing::kEvent || std::ranges::any_of(Events(), counts)) continue;
    const std::string where = term.mode < 0 ? "" : " in mode '" + problem_.system.ModeName(term.mode) + "'";
    remark += (remark.empty() ? "" : "; ") + term.name + " has no effect, as the motion has no events '" + term.event +
              "'" + where + "; " + kWayToEvents;
  }
  return remark;
}

bool HybridShooting::ValuesAt(const Place& place, bool with_jacobians, Values* values) const {
  const std::vector<const double*> blocks = BlocksOf(place);
  const int rows = place.function->num_residuals();
  values->residuals.resize(rows);
  values->jacobians.clear();
  std::vector<double*> jacobians;
  for (const int size : place.function->parameter_block_sizes()) {
    if (with_jacobians) jacobians.push_back(values->jacobians.emplace_back(rows * size).data());
  }
  return place.function->Evaluate(
             blocks.data(), values->residuals.data(), with_jacobians ? jacobians.data() : nullptr) &&
         AllFinite(values->residuals);
}

// Describes the place where a term is evaluated, such as "at t = 1 in mode 'flight'".
std::string HybridShooting::DescribePlace(const Place& place) const {
  return "at t = " + ToText(place.time, 10) + " in mode '" + problem_.system.ModeName(ModeOf(place)) + "'";
}

bool HybridShooting::FailAt(const Place& place) {
  return Fail(place.term->name + ": the function has no finite value " + DescribePlace(place));
}

// Says why a derivative is not finite: checks the terms first, then the motion.
bool HybridShooting::FailAtDerivatives() {
  Values values;
  for (const Place& place : places_) {
    if (!ValuesAt(place, true, &values)) return FailAt(place);
    if (std::ranges::all_of(values.jacobians, AllFinite)) continue;
    return Fail(place.term->name + ": the function has no finite derivative " + DescribePlace(place));
  }
  const std::string& why = simulator_.ReasonNotFinite();
  return Fail(why.empty() ? "the derivatives of the loss overflow" : why);
}

bool HybridShooting::Simulate(const HybridInput& input, Outcome* outcome) {
  why_.clear();
  *outcome = {};
  if (!RolloutOf(input)) return false;
  Values values;
  for (const Place& place : places_) {
    if (!ValuesAt(place, false, &values)) return FailAt(place);
    for (const double r : values.residuals) {
      if (place.term->IsCost()) {
        outcome->loss += place.term->LossOf(r);
        continue;
      }
      const double violation = place.term->role == HybridTerm::Role::kEquality ? std::abs(r) : r;
      if (!(violation <= outcome->violation)) {
        outcome->violation = violation;
        outcome->worst = place.term->name;
      }
    }
  }
  return (std::isfinite(outcome->loss) && !std::isnan(outcome->violation)) || Fail("the loss is not finite");
}

bool HybridShooting::EvaluateTerms(std::vector<TermAt>* terms) {
  terms->clear();
  Values values;
  for (const Place& place : places_) {
    if (!ValuesAt(place, true, &values)) return FailAt(place);
    if (!std::ranges::all_of(values.jacobians, AllFinite)) return FailAtDerivatives();
    TermAt& at = terms->emplace_back(
        TermAt{place.term, place.function, place.interval, place.event, values.residuals, values.jacobians, {}});
    const std::vector<int>& sizes = place.term->function->parameter_block_sizes();
    const std::vector<const double*> blocks = BlocksOf(place);
    for (std::size_t i = 0; i < blocks.size(); ++i) at.blocks.emplace_back(blocks[i], blocks[i] + sizes[i]);
  }
  return true;
}

HybridShooting::Derivative HybridShooting::MakeUndefinedDerivative() const {
  Derivative none;
  none.direct.initial.resize(input_.initial.size());
  none.direct.control.resize(input_.control.size());
  none.direct.parameters.resize(problem_.system.num_parameters());
  none.cotangent.by_parameters = !problem_.free.parameters.empty();
  return none;
}

void HybridShooting::PullBack(const Place& place, const Values& values, const Eigen::RowVectorXd& weights,
                              Derivative* sum) const {
  const HybridTerm& term = *place.term;
  auto jacobian = values.jacobians.begin();
  const auto next = [&] {
    const Eigen::Map<const Matrix> J(jacobian->data(), weights.size(), jacobian->size() / weights.size());
    ++jacobian;
    return Eigen::RowVectorXd(weights * J);
  };
  const auto add = [](const Eigen::RowVectorXd& by, double* to) {
    for (const double one : by) *to++ += one;
  };
  if (term.with_state) {
    const Eigen::RowVectorXd by_state = next();
    std::vector<double>* state = StateIn(&sum->cotangent, place);
    state->resize(by_state.size());
    add(by_state, state->data());
    sum->reads_motion = true;
  }
  if (term.with_initial) add(next(), sum->direct.initial.data());
  if (term.with_control) add(next(), sum->direct.control.data() + place.interval * problem_.system.num_controls());
  if (term.with_parameters) add(next(), sum->direct.parameters.data());
  if (term.with_time && place.event >= 0) {
    sum->cotangent.event_times.resize(Events().size());
    sum->cotangent.event_times[place.event] += next()[0];
    sum->reads_motion = true;
  } else if (term.with_time) {
    sum->direct.duration += next()[0] * place.time / input_.duration;
  }
  if (term.with_length) sum->direct.duration += next()[0] * (place.length / input_.duration);
}

HybridGradient HybridShooting::TotalOf(Derivative of, const HybridSensitivity* motion) {
  if (!of.reads_motion) return std::move(of.direct);
  HybridGradient through;
  if (motion == nullptr) {
    through = Adjoint(of.cotangent);
  } else {
    Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(motion->columns);
    const auto add = [&](std::span<const double> by, const std::vector<double>& rows) {
      const auto size = static_cast<Eigen::Index>(by.size());
      if (size == 0) return;
      row += Eigen::Map<const Eigen::RowVectorXd>(by.data(), size) *
             Eigen::Map<const Matrix>(rows.data(), size, motion->columns);
    };
    add(of.cotangent.final_state, motion->final_state);
    for (std::size_t k = 0; k < of.cotangent.nodes.size(); ++k) add(of.cotangent.nodes[k], motion->nodes[k]);
    for (std::size_t i = 0; i < of.cotangent.after.size(); ++i) add(of.cotangent.after[i], motion->after[i]);
    for (std::size_t i = 0; i < of.cotangent.event_times.size(); ++i) {
      add({&of.cotangent.event_times[i], 1}, motion->times[i]);
    }
    const double* next = row.data();
    for (auto [to, size] : {std::pair(&through.initial, of.direct.initial.size()),
                            std::pair(&through.control, of.direct.control.size()),
                            std::pair(&through.parameters, of.direct.parameters.size())}) {
      to->assign(next, next + size);
      next += size;
    }
    through.duration = *next;
  }
  const auto add = [](const std::vector<double>& from, std::vector<double>* to) {
    for (std::size_t i = 0; i < to->size(); ++i) (*to)[i] += from[i];
  };
  add(through.control, &of.direct.control);
  add(through.parameters, &of.direct.parameters);
  add(through.initial, &of.direct.initial);
  of.direct.duration += through.duration;
  return std::move(of.direct);
}

bool HybridShooting::Evaluate(std::span<const double> z, double* loss, double* gradient) {
  if (!Rollout(z, gradient != nullptr)) return false;
  *loss = 0;
  Derivative sum = MakeUndefinedDerivative();
  Values values;
  for (const Place& place : places_) {
    if (!place.term->IsCost()) continue;
    if (!ValuesAt(place, gradient != nullptr, &values)) return FailAt(place);
    Eigen::RowVectorXd slopes(values.residuals.size());
    for (std::size_t i = 0; i < values.residuals.size(); ++i) {
      *loss += place.term->LossOf(values.residuals[i]);
      slopes[static_cast<Eigen::Index>(i)] = place.term->SlopeOf(values.residuals[i]);
    }
    if (gradient != nullptr) PullBack(place, values, slopes, &sum);
  }
  if (!std::isfinite(*loss)) return Fail("the loss is not finite");
  if (gradient == nullptr) return true;
  if (sum.reads_motion) ++num_adjoints_;
  const HybridGradient by = TotalOf(std::move(sum), nullptr);
  for (std::size_t i = 0; i < variables_.size(); ++i) gradient[i] = variables_[i].Access(by);
  return AllFinite({gradient, variables_.size()}) || FailAtDerivatives();
}

bool HybridShooting::EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) {
  if (!Rollout(z)) return false;
  std::fill_n(residuals, num_residuals_, 0.0);
  Values values;
  for (const Place& place : places_) {
    if (place.first_row < 0) continue;
    if (!ValuesAt(place, false, &values)) return FailAt(place);
    AddResiduals(values.residuals, residuals + place.first_row);
  }
  if (jacobian != nullptr) ResidualJacobian(jacobian);
  return why_.empty();
}

// Returns the part of a cotangent that belongs to the state at a place.
std::vector<double>* HybridShooting::StateIn(HybridCotangent* cotangent, const Place& place) const {
  if (place.interval >= 0) {
    cotangent->nodes.resize(input_.num_intervals);
    return &cotangent->nodes[place.interval];
  }
  if (place.event < 0) return &cotangent->final_state;
  std::vector<std::vector<double>>& of_events = place.term->before ? cotangent->before : cotangent->after;
  of_events.resize(Events().size());
  return &of_events[place.event];
}

void HybridShooting::ResidualJacobian(double* jacobian) {
  ++num_adjoints_;
  const std::size_t columns =
      input_.initial.size() + input_.control.size() + problem_.system.num_parameters() + 1;  // of all of the input
  std::size_t rows_of_motion = 0;
  for (const Place& place : places_) {
    const bool of_motion = place.term->with_state || (place.event >= 0 && place.term->with_time);
    if (place.first_row >= 0 && of_motion) rows_of_motion += place.term->function->num_residuals();
  }
  std::optional<HybridSensitivity> motion;
  if (kColumnsOfRow * rows_of_motion >= columns) motion = simulator_.Sensitivity(!problem_.free.parameters.empty());
  Eigen::Map<Matrix> out(jacobian, num_residuals_, num_variables());
  out.setZero();
  std::vector<Values> values(places_.size());
  std::vector<double> residuals(num_residuals_, 0.0);
  for (std::size_t i = 0; i < places_.size(); ++i) {
    if (places_[i].first_row < 0) continue;
    if (!ValuesAt(places_[i], true, &values[i])) {
      out.setConstant(std::numeric_limits<double>::quiet_NaN());
      FailAt(places_[i]);
      return;
    }
    AddResiduals(values[i].residuals, &residuals[places_[i].first_row]);
  }
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const Place& place = places_[i];
    if (place.first_row < 0) continue;
    const bool forward = motion && !(place.event >= 0 && place.term->before);
    const auto rows = static_cast<Eigen::Index>(values[i].residuals.size());
    for (Eigen::Index row = 0; row < rows; ++row) {
      const double own = values[i].residuals[row], all = residuals[place.first_row + row];
      Derivative of_row = MakeUndefinedDerivative();
      PullBack(place, values[i], (own == all ? 1 : own / all) * Eigen::RowVectorXd::Unit(rows, row), &of_row);
      const HybridGradient by = TotalOf(std::move(of_row), forward ? &*motion : nullptr);
      for (std::size_t j = 0; j < variables_.size(); ++j) out(place.first_row + row, j) += variables_[j].Access(by);
    }
  }
  if (!out.allFinite()) FailAtDerivatives();
}

}  // namespace saltus
