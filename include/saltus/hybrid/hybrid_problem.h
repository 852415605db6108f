// Optimal control problems of hybrid systems: costs and constraints as functions for Ceres, and the unknowns.
//
//   HybridProblem problem{.system = HybridSystem(BouncingBall()),
//                         .guess = {.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 50}};
//   problem.terms = {MakeTerminalCost(0, 1.0, 100.0, 2), MakeEffortCost(1.0 / 32, 1)};
//   problem.free.control = true;
//   const SolveReport report = Solve("ceres_lbfgs", problem, {});
#pragma once

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"

namespace ceres {
class CostFunction;
}

namespace saltus {

// A term of a problem: a Ceres cost function, the places at which it is evaluated, and the role of its residuals.
struct HybridTerm {
  enum class Timing { kEachInterval, kEvent, kEnd };
  // The role of the residuals r: the loss gains |r|^2 (without Ceres' half) or, for kValue, the sum of r; the other two
  // are constraints, r = 0 and r <= 0. Terms of intervals are summed, not multiplied by the length.
  enum class Role { kCost, kValue, kEquality, kInequality };

  // Returns whether the term is a part of the loss.
  bool IsCost() const { return role == Role::kCost || role == Role::kValue; }
  // Returns the contribution of a residual to the loss, and its derivative by the residual. Precondition: IsCost().
  double LossOf(double residual) const { return role == Role::kValue ? residual : residual * residual; }
  double SlopeOf(double residual) const { return role == Role::kValue ? 1 : 2 * residual; }

  std::string name = "term";  // for messages
  Timing at = Timing::kEnd;
  Role role = Role::kCost;
  // The mode in which the term counts (kEvent: the mode before the event); -1: any. A motion that ends in another mode
  // than that of a term at the end has no loss.
  int mode = -1;
  std::string event = "";  // kEvent: the name of the guard (HybridSystem::GuardName)
  // kEvent: the term counts at this occurrence of the event only, numbered from 0; -1: at all. A motion without it has
  // no loss.
  int occurrence = -1;
  // Returns whether the term counts at events of a guard in a mode. Precondition: kEvent.
  bool CountsAt(const HybridFunctions& functions, int of_mode, int guard) const;
  bool before = false;  // kEvent: the function gets the state before the reset instead of that after it
  // kEachInterval: the only interval at whose beginning the term counts; -1: all.
  int interval = -1;
  // kEachInterval: the term is an inequality that holds at all times of the intervals, along the flow of the mode in
  // which they begin. Its function reads the state, the control and the parameters if the system has any, the time,
  // and the length. It is evaluated at the end of each interval, and where it is greatest before that: the interval is
  // integrated in eight parts, or as many as the motion has steps there, and within each part a time is found at which
  // the function no longer rises. Between the ends of a part it may rise and fall twice without being seen. Solvers in
  // phases end intervals at events.
  bool always = false;

  // The function's parameter blocks, in this order, each if its member is set:
  //   the state at the beginning of the interval, at the event, or at the final time after events there
  bool with_state = false;
  //   the state at the beginning of the motion; kEnd only
  bool with_initial = false;
  //   the control of the interval; kEachInterval only
  bool with_control = false;
  //   all parameters of the system
  bool with_parameters = false;
  //   the time at which it is evaluated (1 number)
  bool with_time = false;
  //   the length of the interval (1 number); kEachInterval only
  bool with_length = false;

  // The function, which must not keep state.
  std::shared_ptr<const ceres::CostFunction> function = nullptr;
  // The components of the state and of the control on which the function depends; empty: all. Solvers in phases keep
  // problems of several parts sparse by these.
  std::vector<int> reads_states = {}, reads_controls = {};

  // Returns the number of residuals at a place: those of the function, or for a term that holds at all times twice as
  // many, the greatest ones before the end of an interval and then those at its end.
  int NumRows() const;
};

// Makes the cost weight (x_i - target)^2 at the end, of a state of `state_size` numbers; mode as in HybridTerm. In all
// four functions weights are >= 0.
HybridTerm MakeTerminalCost(int component, double target, double weight, int state_size, int mode = -1);
// Makes the constraint x_i <= bound, or bound <= x_i if it is a `lower` one, at the end.
HybridTerm MakeTerminalBound(int component, double bound, bool lower, int state_size, int mode = -1);
// Makes the cost weight int |u|^2 dt, of a control of `num_controls` numbers, or of some components of it.
HybridTerm MakeEffortCost(double weight, int num_controls, std::vector<int> components = {});
// Makes the cost weight T of the final time T.
HybridTerm MakeDurationCost(double weight);

// The unknowns of solvers, which start at the guess, and their bounds. A list of bounds is empty (no bounds) or has one
// number, which may be infinite, for each unknown.
struct HybridFree {
  bool control = false;
  std::vector<double> control_min = {}, control_max = {};  // of each of the m controls, in all intervals
  std::vector<int> initial = {};                           // components of the initial state
  std::vector<double> initial_min = {}, initial_max = {};  // of each of these
  std::vector<int> parameters = {};                        // indices
  std::vector<double> parameters_min = {}, parameters_max = {};
  bool duration = false;
  double duration_min = 0, duration_max = std::numeric_limits<double>::infinity();

  // Returns whether there is no unknown.
  bool IsEmpty() const { return !control && initial.empty() && parameters.empty() && !duration; }
};

// An optimal control problem. Units are those of the system.
struct HybridProblem {
  HybridSystem system;
  HybridInput guess;
  std::vector<HybridTerm> terms = {};
  HybridFree free = {};
  HybridOptions integration = {};
  // States at equal times from the beginning to the end of the guess, at least two, one after the other; or none.
  // Solvers in phases start from these, with the events of the guess, instead of from the motion under the control of
  // the guess. Precondition: all modes have states of the same size.
  std::vector<double> guess_states = {};
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string Validate(const HybridProblem& problem);

}  // namespace saltus
