#include "saltus/outer/problem.h"

#include <algorithm>

#include "base/table.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {
namespace {

// Throws if there is an error, with what was found and what was expected.
void Check(const std::string& error) {
  if (!error.empty()) throw std::invalid_argument("Problem: " + error);
}

// Returns the index of a name among those that name_of gives to 0, ..., size - 1. Throws if there is none.
template <typename NameOf>
int IndexOf(const std::string& what, const std::string& name, int size, const NameOf& name_of) {
  std::vector<std::string> names;
  for (int i = 0; i < size; ++i) {
    names.push_back(name_of(i));
    if (names.back() == name) return i;
  }
  const std::string known = names.empty() ? "none, as there are none" : Joined(names);
  throw std::invalid_argument(what + ": found '" + name + "', expected some of " + known);
}

HybridInput SetInitialMode(const MechanicalSystem& system, HybridInput guess) {
  if (guess.mode != 0) return guess;
  Check(Validate(guess, system.hybrid()));
  std::vector<double> control(system.hybrid().num_controls());
  std::copy_n(guess.control.begin(), std::min(control.size(), guess.control.size()), control.begin());
  const MechanicalSystem::Start start = system.FindMode(guess.initial, control, guess.parameters, guess.begin);
  if (start.mode < 0) Check(start.reason);
  guess.mode = start.mode;
  return guess;
}

}  // namespace

Problem::Problem(const MechanicalSystem& system, HybridInput guess)
    : Problem(HybridProblem{system.hybrid(), SetInitialMode(system, std::move(guess))}) {}

Problem::Problem(HybridProblem problem) : parts_(std::move(problem)) {
  Check(Validate(parts_));
  // Functions that read what is not there throw now, rather than within a solver.
  const HybridInput& guess = parts_.guess;
  std::vector<double> control(parts_.system.num_controls()), slope(guess.initial.size());
  if (!guess.control.empty()) control.assign(guess.control.begin(), guess.control.begin() + control.size());
  const ModePoint at = {guess.mode, guess.begin, guess.initial.data(), control.data(), guess.parameters.data()};
  parts_.system.functions().Flow(at, slope.data());
  for (int guard = 0; guard < parts_.system.num_guards(guess.mode); ++guard) {
    parts_.system.functions().Guard(at, guard);
  }
}

Problem& Problem::AddEffort(double weight) {
  AddTerm(MakeEffortCost(weight, parts_.system.num_controls()));
  return *this;
}

Problem& Problem::AddDuration(double weight) {
  AddTerm(MakeDurationCost(weight));
  return *this;
}

Problem& Problem::Free(const FreeVariables& free) {
  const HybridSystem& system = parts_.system;
  HybridFree made;
  made.control = free.control || !free.controls.empty();
  if (!free.controls.empty()) {
    made.control_min.assign(system.num_controls(), -std::numeric_limits<double>::infinity());
    made.control_max.assign(system.num_controls(), std::numeric_limits<double>::infinity());
  }
  for (const BoundedVariable& bounded : free.controls) {
    const int i =
        IndexOf("controls", bounded.name, system.num_controls(), [&](int c) { return system.ControlName(c); });
    made.control_min[i] = bounded.min;
    made.control_max[i] = bounded.max;
  }
  const auto add = [](const std::vector<BoundedVariable>& from,
                      const char* what,
                      int size,
                      const auto& name_of,
                      std::vector<int>* indices,
                      std::vector<double>* min,
                      std::vector<double>* max) {
    for (const BoundedVariable& bounded : from) {
      indices->push_back(IndexOf(what, bounded.name, size, name_of));
      min->push_back(bounded.min);
      max->push_back(bounded.max);
    }
  };
  const int mode = parts_.guess.mode;
  add(
      free.initial,
      "initial",
      system.state_size(mode),
      [&](int i) { return system.StateName(mode, i); },
      &made.initial,
      &made.initial_min,
      &made.initial_max);
  add(
      free.parameters,
      "parameters",
      system.num_parameters(),
      [&](int i) { return system.ParameterName(i); },
      &made.parameters,
      &made.parameters_min,
      &made.parameters_max);
  if (free.duration) {
    made.duration = true;
    if (free.duration->min != -std::numeric_limits<double>::infinity()) made.duration_min = free.duration->min;
    made.duration_max = free.duration->max;
  }
  std::swap(parts_.free, made);
  const std::string error = Validate(parts_);
  if (!error.empty()) std::swap(parts_.free, made);
  Check(error);
  return *this;
}

Problem::Shape Problem::ShapeOf(const Place& place, HybridTerm::Role role) const {
  const HybridSystem& system = parts_.system;
  const int states = system.state_size(parts_.guess.mode);
  for (int mode = 0; mode < system.num_modes(); ++mode) {
    if (system.state_size(mode) != states) {
      throw std::invalid_argument(
          "Problem: found modes with states of different sizes, expected one size; add a HybridTerm of a mode to "
          "parts().terms");
    }
  }
  const bool each = place.at == HybridTerm::Timing::kEachInterval;
  const bool cost = role == HybridTerm::Role::kCost || role == HybridTerm::Role::kValue;
  return {.at = place.at,
          .states = states,
          .controls = each ? system.num_controls() : 0,
          .parameters = system.num_parameters(),
          .integrated = each && cost,
          .squared = role == HybridTerm::Role::kCost,
          .name = "term " + std::to_string(parts_.terms.size())};
}

std::vector<int> Problem::BlocksOf(const Shape& shape) {
  std::vector<int> sizes = {shape.states};
  if (shape.controls > 0) sizes.push_back(shape.controls);
  if (shape.parameters > 0) sizes.push_back(shape.parameters);
  sizes.push_back(1);
  if (shape.at == HybridTerm::Timing::kEachInterval) sizes.push_back(1);
  return sizes;
}

void Problem::EvaluateAtGuess(const Shape& shape, const std::function<void(const double* const*)>& function) const {
  const HybridInput& guess = parts_.guess;
  std::vector<double> control(shape.controls);
  if (!guess.control.empty()) control.assign(guess.control.begin(), guess.control.begin() + shape.controls);
  const double time = guess.begin + guess.duration, length = guess.duration / guess.num_intervals;
  std::vector<const double*> blocks = {guess.initial.data()};
  if (shape.controls > 0) blocks.push_back(control.data());
  if (shape.parameters > 0) blocks.push_back(guess.parameters.data());
  blocks.push_back(&time);
  blocks.push_back(&length);
  function(blocks.data());
}

void Problem::AddTerm(const Place& place, HybridTerm::Role role, const Shape& shape,
                      std::shared_ptr<const ceres::CostFunction> function) {
  HybridTerm term{.name = shape.name,
                  .at = place.at,
                  .role = role,
                  .event = place.guard,
                  .before = place.before,
                  .always = role == HybridTerm::Role::kInequality && place.at == HybridTerm::Timing::kEachInterval,
                  .with_state = true,
                  .with_control = shape.controls > 0,
                  .with_parameters = shape.parameters > 0,
                  .with_time = true,
                  .with_length = place.at == HybridTerm::Timing::kEachInterval,
                  .function = std::move(function)};
  AddTerm(std::move(term));
}

void Problem::AddTerm(HybridTerm term) {
  parts_.terms.push_back(std::move(term));
  const std::string error = Validate(parts_);
  if (!error.empty()) parts_.terms.pop_back();
  Check(error);
}

}  // namespace saltus
