#include "saltus/hybrid/hybrid_problem.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "base/number_text.h"
#include "base/table.h"
#include "hybrid/free_variables.h"

namespace saltus {
namespace {

// The residual sqrt(weight) (x_i - target), of a state of a size that is known as the program runs.
struct ComponentResidual {
  int component;
  double target, root;

  template <typename T>
  bool operator()(T const* const* blocks, T* residuals) const {
    residuals[0] = root * (blocks[0][component] - target);
    return true;
  }
};

std::string Number(int number) { return std::to_string(number); }

HybridTerm MakeComponentTerm(const std::string& name, const ComponentResidual& miss, int state_size, int mode) {
  auto function =
      std::make_shared<ceres::DynamicAutoDiffCostFunction<ComponentResidual, 4>>(new ComponentResidual(miss));
  function->AddParameterBlock(state_size);
  function->SetNumResiduals(1);
  return {.name = name + " of component " + Number(miss.component),
          .mode = mode,
          .with_state = true,
          .function = std::move(function)};
}

// The residual sqrt(weight h) u.
// sqrt(weight h) u of some components. Blocks: control, length h.
class Effort final : public ceres::CostFunction {
 public:
  Effort(double weight, int num_controls, std::vector<int> components)
      : weight_(weight), components_(std::move(components)) {
    *mutable_parameter_block_sizes() = {num_controls, 1};
    set_num_residuals(static_cast<int>(components_.size()));
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const double scale = std::sqrt(weight_ * blocks[1][0]);
    const int columns = parameter_block_sizes()[0];
    for (int i = 0; i < num_residuals(); ++i) residuals[i] = scale * blocks[0][components_[i]];
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) std::fill_n(jacobians[0], num_residuals() * columns, 0.0);
    for (int i = 0; i < num_residuals(); ++i) {
      if (jacobians[0] != nullptr) jacobians[0][i * columns + components_[i]] = scale;
      if (jacobians[1] != nullptr) jacobians[1][i] = weight_ / (2 * scale) * blocks[0][components_[i]];
    }
    return true;
  }

 private:
  double weight_;
  std::vector<int> components_;
};

struct DurationResidual {
  double weight;

  template <typename T>
  bool operator()(const T* time, T* residual) const {
    using std::sqrt;
    residual[0] = sqrt(weight * time[0]);
    return true;
  }
};

// The sizes of the function's blocks, of a term that reads states of `state_size` numbers.
std::vector<int> BlocksOf(const HybridTerm& term, const HybridProblem& problem, int state_size) {
  const HybridSystem& system = problem.system;
  std::vector<int> sizes;
  if (term.with_state) sizes.push_back(state_size);
  if (term.with_initial) sizes.push_back(static_cast<int>(problem.guess.initial.size()));
  if (term.with_control) sizes.push_back(system.num_controls());
  if (term.with_parameters) sizes.push_back(system.num_parameters());
  if (term.with_time) sizes.push_back(1);
  if (term.with_length) sizes.push_back(1);
  return sizes;
}

std::string Validate(const HybridTerm& term, const HybridProblem& problem) {
  const HybridSystem& system = problem.system;
  if (term.function == nullptr) return "found no function";
  const bool of_events = term.at == HybridTerm::Timing::kEvent;
  if (term.mode < -1 || term.mode >= system.num_modes()) {
    return "found mode " + Number(term.mode) + ", expected -1 to " + Number(system.num_modes() - 1);
  }
  if (of_events && !system.functions().CreatesModes()) {
    std::set<std::string> names;
    for (int mode = std::max(0, term.mode); mode < (term.mode < 0 ? system.num_modes() : term.mode + 1); ++mode) {
      for (int guard = 0; guard < system.num_guards(mode); ++guard) names.insert(system.GuardName(mode, guard));
    }
    if (!names.contains(term.event)) {
      return "found the event '" + term.event + "', expected " +
             (names.empty() ? "none, as there are no guards" : "some of " + Joined({names.begin(), names.end()}));
    }
  }
  if (term.at != HybridTerm::Timing::kEachInterval && (term.with_control || term.with_length)) {
    return "only a term of each interval reads a control or a length";
  }
  if (term.at != HybridTerm::Timing::kEnd && term.with_initial) return "only a term at the end reads the initial state";
  const bool of_one = term.interval != -1;
  if (of_one && (term.at != HybridTerm::Timing::kEachInterval || term.interval < 0 ||
                 term.interval >= problem.guess.num_intervals)) {
    return "found interval " + Number(term.interval) + ", expected 0 to " + Number(problem.guess.num_intervals - 1) +
           " of a term of intervals";
  }
  if (term.always) {
    const bool reads_all = term.with_state && term.with_control == (system.num_controls() > 0) &&
                           term.with_parameters == (system.num_parameters() > 0) && term.with_time && term.with_length;
    if (term.at != HybridTerm::Timing::kEachInterval || term.role != HybridTerm::Role::kInequality || !reads_all) {
      return "found a term that holds at all times, expected an inequality of each interval that reads the state, the "
             "control and the parameters if the system has any, the time and the length";
    }
  }
  // The size of a state in any mode is that of the function's block; that after an event is known with the event.
  const std::vector<int>& found = term.function->parameter_block_sizes();
  int size = found.empty() ? 0 : found[0];
  if (term.mode >= 0 && (!of_events || term.before)) size = system.state_size(term.mode);
  if (found == BlocksOf(term, problem, size)) return "";
  std::string expected, have;
  for (const int block : BlocksOf(term, problem, size)) expected += " " + Number(block);
  for (const int block : found) have += " " + Number(block);
  return "found a function of blocks of sizes" + have + ", expected" + expected;
}

std::string ValidateBounds(const std::vector<double>& min, const std::vector<double>& max, std::size_t count,
                           const char* of) {
  for (const std::vector<double>* bounds : {&min, &max}) {
    if (bounds->empty() || bounds->size() == count) continue;
    return "found " + std::to_string(bounds->size()) + " bounds of the " + of + ", expected " + std::to_string(count);
  }
  for (std::size_t i = 0; i < std::max(min.size(), max.size()); ++i) {
    const double low = i < min.size() ? min[i] : -INFINITY, high = i < max.size() ? max[i] : INFINITY;
    if (std::isnan(low) || std::isnan(high)) {
      return std::string("found NaN as a bound of the ") + of + ", expected a number; infinity is none";
    }
    if (low > high) {
      return "found the lower bound " + ToText(low, 6) + " of the " + of + " above the upper one, " + ToText(high, 6);
    }
  }
  return "";
}

std::string ValidateIndices(const std::vector<int>& indices, std::size_t count, const char* of) {
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] < 0 || indices[i] >= static_cast<int>(count)) {
      return "found number " + Number(indices[i]) + " of the " + of + ", expected 0 to " +
             Number(static_cast<int>(count) - 1);
    }
    if (std::count(indices.begin(), indices.end(), indices[i]) > 1) {
      return "found number " + Number(indices[i]) + " of the " + of + " twice";
    }
  }
  return "";
}

std::string ValidateGuessStates(const HybridProblem& problem) {
  const std::size_t size = problem.guess.initial.size(), found = problem.guess_states.size();
  if (found == 0) return "";
  if (found % size != 0 || found < 2 * size) {
    return "guess_states: found " + std::to_string(found) + " numbers, expected two or more states of " +
           std::to_string(size) + " numbers";
  }
  if (!std::all_of(problem.guess_states.begin(), problem.guess_states.end(), [](double x) { return std::isfinite(x); }))
    return "guess_states: found a number that is not finite";
  for (int mode = 0; mode < problem.system.num_modes(); ++mode) {
    if (problem.system.state_size(mode) != static_cast<int>(size)) {
      return "guess_states: found modes with states of different sizes, expected one size";
    }
  }
  return "";
}

}  // namespace

int HybridTerm::NumRows() const { return (always ? 2 : 1) * function->num_residuals(); }

bool HybridTerm::CountsAt(const HybridFunctions& functions, int of_mode, int guard) const {
  return guard >= 0 && !functions.IsSwitch(of_mode, guard) && (mode < 0 || functions.BaseMode(of_mode) == mode) &&
         functions.GuardName(of_mode, guard) == event;
}

HybridTerm MakeTerminalCost(int component, double target, double weight, int state_size, int mode) {
  return MakeComponentTerm("terminal cost", {component, target, std::sqrt(weight)}, state_size, mode);
}

HybridTerm MakeTerminalBound(int component, double bound, bool lower, int state_size, int mode) {
  HybridTerm term = MakeComponentTerm("terminal bound", {component, bound, lower ? -1.0 : 1.0}, state_size, mode);
  term.role = HybridTerm::Role::kInequality;
  return term;
}

HybridTerm MakeEffortCost(double weight, int num_controls, std::vector<int> components) {
  HybridTerm term{.name = "effort",
                  .at = HybridTerm::Timing::kEachInterval,
                  .with_control = true,
                  .with_length = true,
                  .reads_controls = components};
  if (components.empty()) {
    components.resize(num_controls);
    std::iota(components.begin(), components.end(), 0);
  }
  term.function = std::make_shared<Effort>(weight, num_controls, std::move(components));
  return term;
}

HybridTerm MakeDurationCost(double weight) {
  return {
      .name = "final time",
      .with_time = true,
      .function = std::make_shared<ceres::AutoDiffCostFunction<DurationResidual, 1, 1>>(new DurationResidual{weight})};
}

std::vector<FreeVariable> FreeVariables(const HybridFree& free, int num_controls, int num_intervals) {
  std::vector<FreeVariable> variables;
  const auto add = [&](FreeVariable::Kind kind,
                       int index,
                       const std::vector<double>& min,
                       const std::vector<double>& max,
                       std::size_t bound) {
    variables.push_back({kind, index, min.empty() ? -INFINITY : min[bound], max.empty() ? INFINITY : max[bound]});
  };
  using enum FreeVariable::Kind;
  for (int i = 0; free.control && i < num_intervals * num_controls; ++i) {
    add(kControl, i, free.control_min, free.control_max, i % num_controls);
  }
  for (std::size_t i = 0; i < free.initial.size(); ++i) {
    add(kInitial, free.initial[i], free.initial_min, free.initial_max, i);
  }
  for (std::size_t i = 0; i < free.parameters.size(); ++i) {
    add(kParameter, free.parameters[i], free.parameters_min, free.parameters_max, i);
  }
  if (free.duration) variables.push_back({kDuration, 0, free.duration_min, free.duration_max});
  return variables;
}

std::string Validate(const HybridProblem& problem) {
  const HybridSystem& system = problem.system;
  const HybridFree& free = problem.free;
  if (std::string wrong = Validate(problem.guess, system); !wrong.empty()) return wrong;
  if (problem.guess.begin != 0) return "found a motion that begins at another time than 0, expected 0";
  for (const HybridTerm& term : problem.terms) {
    if (std::string wrong = Validate(term, problem); !wrong.empty()) return term.name + ": " + wrong;
  }
  if (free.control && system.num_controls() == 0) return "the system has no control to optimise";
  for (const std::string& wrong :
       {ValidateIndices(free.initial, problem.guess.initial.size(), "initial state"),
        ValidateIndices(free.parameters, system.num_parameters(), "parameters"),
        ValidateBounds(free.control_min, free.control_max, system.num_controls(), "control"),
        ValidateBounds(free.initial_min, free.initial_max, free.initial.size(), "initial state"),
        ValidateBounds(free.parameters_min, free.parameters_max, free.parameters.size(), "parameters")}) {
    if (!wrong.empty()) return wrong;
  }
  if (free.duration) {
    if (std::string wrong = ValidateBounds({free.duration_min}, {free.duration_max}, 1, "duration"); !wrong.empty())
      return wrong;
    if (free.duration_min < 0 || free.duration_max <= 0) {
      return "found the bounds " + ToText(free.duration_min, 6) + " and " + ToText(free.duration_max, 6) +
             " of the duration, expected a lower one of at least 0 and an upper one above 0, as the duration is "
             "positive";
    }
  }
  return ValidateGuessStates(problem);
}

}  // namespace saltus
