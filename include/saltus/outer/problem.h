// Problems in a few lines: a system, costs and constraints as lambdas, and unknowns by their names.
//
//   saltus::Problem problem(Ball(), {.initial = {50, 0}, .parameters = {9.8, 0.98}, .duration = 15});
//   problem.AddCost(saltus::kEnd, [](const auto& a) { return a.x[0] - 20.0; });
//   problem.AddInequality(saltus::kAlways, [](const auto& a) { return a.x[0] - 60.0; });
//   problem.Free({.parameters = {{"p[1]", 0.75, 1.0}}});
//   const saltus::Run run = saltus::Solve(problem);
//   std::cout << run << run.certificate();
//
// This is a layer over hybrid_problem.h, which has more features. An error in a problem throws std::invalid_argument
// with what was found and expected, std::out_of_range if a function reads a number that does not exist, or
// std::length_error if it returns no numbers, or not as many as for the guess.
#pragma once

#include <ceres/dynamic_autodiff_cost_function.h>

#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "saltus/hybrid/compact_system.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/scene/scene.h"  // before kEnd and kAlways, which its enumerators would shadow

namespace saltus {

class MechanicalSystem;

// The place of a term: the final time, all control intervals, or the events of a guard.
struct Place {
  HybridTerm::Timing at = HybridTerm::Timing::kEnd;
  std::string guard = {};  // kEvent: the name of the guard, in every mode that has one of this name
  bool before = false;     // kEvent: the function gets the state before the reset instead of that after it
};
// The final time, after events there.
inline const Place kEnd{};
// The whole motion. Costs are integrated over time, by their value at the beginning of each control interval.
// Inequalities hold at all times, between the ends of intervals too, as far as their greatest values are found
// (HybridTerm::always). Equalities hold at the beginning of each interval and, unless they read the control, at
// the end, so that their accuracy depends on the number of intervals.
inline const Place kAlways{HybridTerm::Timing::kEachInterval};
// Return the place of every event of a guard, with the state after it (OnEvent) or before it (BeforeEvent).
inline Place OnEvent(std::string guard) { return {HybridTerm::Timing::kEvent, std::move(guard)}; }
inline Place BeforeEvent(std::string guard) { return {HybridTerm::Timing::kEvent, std::move(guard), true}; }

// A variable by its name, and its bounds.
struct BoundedVariable {
  std::string name;
  double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();
};

// The unknowns of a problem. Names are those of the system, or "x[0]", "u[0]", "p[0]" where it has none. An unknown
// that is listed by its name alone has no bounds.
struct FreeVariables {
  bool control = false;                        // all components, in all intervals
  std::vector<BoundedVariable> controls = {};  // bounds of components; frees the control
  std::vector<BoundedVariable> initial = {};   // components of the initial state
  std::vector<BoundedVariable> parameters = {};
  std::optional<BoundedVariable> duration = {};  // in the system's unit of time, > 0; its name is not read
};

// A hybrid system, the input of a motion as initial guess, costs, constraints and unknowns. Functions that add
// something return *this, and throw if it is wrong.
class Problem {
 public:
  // Takes a struct with kSizes (compact_system.h), a struct as hybrid_system.h describes, or a HybridSystem; and the
  // input of the motion from which solvers start.
  template <typename S>
  Problem(S system, HybridInput guess)
      : Problem(HybridProblem{MakeHybridSystem(std::move(system)), std::move(guess)}) {}
  // Takes a mechanical system. The motion starts in the mode of its state, if the guess names none (0).
  Problem(const MechanicalSystem& system, HybridInput guess);
  // Takes over a problem.
  explicit Problem(HybridProblem problem);

  // The functions are templates, such as `[](const auto& a) { return a.x[0] - 20.0; }`, of a point At<T> with
  // the state `x`, the parameters `p`, the time `t`, and in intervals the control `u` and the length `h`. They return a
  // number or a Row. A term counts in all modes, whose states must have one size.

  // The loss gains the sum of squares (kAlways: its integral over time).
  template <typename F>
  Problem& AddCost(const Place& place, F function) {
    return Add(place, HybridTerm::Role::kCost, std::move(function));
  }
  // The loss gains the sum of the numbers themselves (kAlways: its integral over time).
  template <typename F>
  Problem& AddValue(const Place& place, F function) {
    return Add(place, HybridTerm::Role::kValue, std::move(function));
  }
  // The numbers are to be 0.
  template <typename F>
  Problem& AddEquality(const Place& place, F function) {
    return Add(place, HybridTerm::Role::kEquality, std::move(function));
  }
  // The numbers are to be at most 0.
  template <typename F>
  Problem& AddInequality(const Place& place, F function) {
    return Add(place, HybridTerm::Role::kInequality, std::move(function));
  }
  // The loss gains weight int |u|^2 dt.
  Problem& AddEffort(double weight);
  // The loss gains weight T of the final time T.
  Problem& AddDuration(double weight);

  // Sets the unknowns, in place of those that were set before. Without it nothing is free.
  Problem& Free(const FreeVariables& free);

  // Returns the problem that all this makes, to read or to change.
  HybridProblem& parts() { return parts_; }
  const HybridProblem& parts() const { return parts_; }

 private:
  // The numbers that a function of a term gets.
  struct Shape {
    HybridTerm::Timing at = HybridTerm::Timing::kEnd;
    int states = 0, controls = 0, parameters = 0;
    bool integrated = false, squared = false;  // the loss gains the integral over time; of the squares
    std::string name = {};                     // of the term
  };

  // The function of a user between parameter blocks and residuals.
  template <typename F>
  struct Residuals {
    template <typename T>
    bool operator()(T const* const* blocks, T* residuals) const {
      int written = 0;
      Visit(blocks, [&](const T& value) {
        if (written < count) residuals[written] = value;
        ++written;
      });
      if (written == count) return true;
      throw std::length_error(shape.name + ": found " + std::to_string(written) + " numbers, expected " +
                              std::to_string(count) + " as for the guess");
    }
    template <typename T, typename Visitor>
    void Visit(T const* const* blocks, const Visitor& visit) const {
      At<T> at;
      const char* const name = shape.name.c_str();
      at.x = {'x', *blocks++, shape.states, name};
      at.u = {'u', shape.controls > 0 ? *blocks++ : nullptr, shape.controls, name};
      at.p = {'p', shape.parameters > 0 ? *blocks++ : nullptr, shape.parameters, name};
      at.t = **blocks++;
      if (shape.at == HybridTerm::Timing::kEachInterval) at.h = **blocks++;
      using std::sqrt;
      const T factor = !shape.integrated ? T(1.0) : shape.squared ? T(sqrt(at.h)) : at.h;
      const auto values = function(std::as_const(at));
      if constexpr (requires { values.begin(); }) {
        for (const auto& value : values) visit(T(value * factor));
      } else {
        visit(T(values * factor));
      }
    }

    F function;
    Shape shape;
    int count = 0;  // of the numbers that the function returns
  };

  template <typename F>
  Problem& Add(const Place& place, HybridTerm::Role role, F function) {
    Residuals<F> residuals{std::move(function), ShapeOf(place, role)};
    int count = 0;
    EvaluateAtGuess(residuals.shape,
                    [&](const double* const* blocks) { residuals.Visit(blocks, [&](double) { ++count; }); });
    if (count == 0) {
      throw std::length_error(residuals.shape.name +
                              ": found a function that returns no numbers, expected one or more");
    }
    residuals.count = count;
    auto cost = std::make_shared<ceres::DynamicAutoDiffCostFunction<Residuals<F>, 4>>(new Residuals<F>(residuals));
    for (const int size : BlocksOf(residuals.shape)) cost->AddParameterBlock(size);
    cost->SetNumResiduals(count);
    AddTerm(place, role, residuals.shape, std::move(cost));
    if (place.at == HybridTerm::Timing::kEachInterval && role == HybridTerm::Role::kEquality) {
      // Equalities hold at the end, too, unless they read the control.
      bool reads_control = false;
      const Residuals<F> at_end{residuals.function, ShapeOf(kEnd, role)};
      try {
        EvaluateAtGuess(at_end.shape, [&](const double* const* blocks) { at_end.Visit(blocks, [](double) {}); });
      } catch (const std::out_of_range&) {
        reads_control = true;
      }
      if (!reads_control) Add(kEnd, role, std::move(at_end.function));
    }
    return *this;
  }

  // Throws std::invalid_argument where modes have states of different sizes.
  Shape ShapeOf(const Place& place, HybridTerm::Role role) const;
  static std::vector<int> BlocksOf(const Shape& shape);
  // Calls the function once, with the numbers of the guess.
  void EvaluateAtGuess(const Shape& shape, const std::function<void(const double* const*)>& function) const;
  void AddTerm(const Place& place, HybridTerm::Role role, const Shape& shape,
               std::shared_ptr<const ceres::CostFunction> function);
  void AddTerm(HybridTerm term);

  HybridProblem parts_;
};

}  // namespace saltus
