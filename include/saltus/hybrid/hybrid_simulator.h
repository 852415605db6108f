// Simulation of a hybrid system with located events, and exact derivatives of the simulated motion.
//
// An event of a guard happens at the first time at which the guard, once armed, falls through zero; the reset of the
// guard then gives the next mode and its state. On entry into a mode a guard
//
//   above zero                                          is armed;
//   at zero, if its first nonzero derivative is > 0,    is armed once it is above zero;
//   at zero, if that is < 0,                            has an event without time passing;
//   below zero                                          has a transition without time passing, which belongs to the
//                                                       event before it.
//
// These transitions come before events of other guards that are at zero. "At zero" means within 1e-11 of the size of
// the terms of the guard. At the start a guard below zero is an error. After an event at the final time, the final
// state is that after the event.
//
// Between events the flow is integrated by a Runge-Kutta method of order 8 (hybrid/runge_kutta.h) with a fixed number
// of equal steps in each control interval. A step with an event ends at the event, and the next step ends where the
// first would have ended. The motion is therefore a smooth function of its input until the sequence of events changes.
//
// A guard that is below zero at the end of a step has an event in this step. A guard that falls below zero and returns
// within one step is found if it falls at the beginning of the step and rises at its end, and if the cubic through its
// values and rates there comes closer to zero than half of the smaller value. The number of steps is chosen so that
// these cubics agree with the guards at a point of each step, whose place varies; ReasonInaccurate() names a guard for
// which this takes too many steps.
//
// A pulse of the flow and a dip of a guard that are much shorter than all steps are found in recorded functions
// (saltus.HybridSystem of Python, files), whose bounds over a step are known, unless they are as short as rounding
// errors of the time. Steps near them are shorter than others: they divide control intervals. ReasonInaccurate() names
// one that given steps miss. Functions in C++ are known at the stages of the steps alone, and a pulse between these is
// missed: declare a switch where it begins and ends, or divide the intervals there (HybridOptions::divisions).
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_system.h"

namespace saltus {

// The data that a motion depends on. Times are in the system's unit of time.
struct HybridInput {
  int mode = 0;                         // at the beginning
  std::vector<double> initial = {};     // state at the beginning, of the size of that mode
  std::vector<double> parameters = {};  // P
  double duration = 0;                  // > 0
  int num_intervals = 1;                // K > 0 intervals, on each of which the control is constant
  std::vector<double> control = {};     // K x m, row-major: row k acts in interval k; none: zeros
  // K positive numbers, proportional to the lengths of the intervals; none: the intervals have equal lengths.
  // Derivatives by the duration are those with constant proportions.
  std::vector<double> lengths = {};
  double begin = 0;  // time at which the motion begins; it ends at begin + duration

  // Returns the times at which the control intervals begin, and the final time: K + 1 numbers.
  std::vector<double> Times() const;
};

struct HybridOptions {
  // Tolerance of the integration for the relative error of the final state and of the event times. The first rollout
  // chooses the number of steps for it, which then stays the same; RolloutAccurately checks it again.
  double tolerance = 1e-12;
  // Integration steps in each control interval; 0: the simulator chooses. IntegrationError and ReasonInaccurate report
  // the error of a given number. A motion fails if its steps are so long that they leave the equations of closed
  // contacts.
  int steps_per_interval = 0;
  // Times within the motion, as fractions of the duration in (0, 1), rising, that divide control intervals: each part
  // of an interval has as many steps as an interval that is not divided. The simulator adds those between which steps
  // see pulses of recorded functions, if it chooses their number.
  std::vector<double> divisions = {};
  // Whether a guard below zero at the start is armed once it is above zero, instead of an error.
  bool wait_behind_guards = false;
  int most_events = 100000;  // a motion with more events fails
  // Largest number of events of one guard in one mode without time passing. With more of them, or if such an event
  // leads back to the same state, the motion goes on in the mode that the system names (OnAccumulation), or fails.
  int most_repeats = 100;
  std::function<bool()> stop = {};  // called at each step of the integration; true ends the rollout, which fails
};

struct HybridEvent {
  double time = 0;
  int mode = 0, guard = 0, next_mode = 0;  // guard -1: the control jumps (HybridSimulator::switches())
  double rate = 0;                         // derivative of the guard by time, just before the event
  std::span<const double> before, after;   // states, valid until the next rollout
  bool immediate = false;                  // whether it follows the event before it without time passing
  bool is_switch = false;                  // whether only the flow changes (HybridFunctions::num_switches)
};

// A guard that reaches zero without crossing it. The motion goes on without an event.
struct HybridGrazing {
  double time = 0;
  int mode = 0, guard = 0;
};

// Guards that reach zero at times that differ by less than the error of an integration, 1e-12 of what the guards are
// computed from. Their events happen in the order of their times or, if rounding does not separate these, of their
// numbers.
struct HybridTie {
  double time = 0;
  int mode = 0;
  std::vector<int> guards;
  // The largest difference of a component between the states of different orders; infinite if their modes differ. The
  // result is ambiguous if it is not zero within rounding.
  double spread = 0;
  bool ambiguous = false;
};

// The derivatives of one number by the input of a motion: n0, K x m (row-major) and P numbers, and the duration.
struct HybridGradient {
  std::vector<double> initial, control, parameters;
  double duration = 0;
};

// The derivatives of a function of a motion by its arguments, which the adjoint takes. Empty vectors are zero.
struct HybridCotangent {
  std::vector<double> final_state;
  std::vector<std::vector<double>> nodes;          // K: by the state at the beginning of each control interval
  std::vector<std::vector<double>> before, after;  // by the states before and after each event of events()
  std::vector<double> event_times;                 // by the time of each event
  bool by_parameters = true;                       // whether the derivatives by the parameters are wanted, or are zero
};

// The derivatives of states and events; row-major, D = n0 + K m + P + 1 columns [initial control parameters
// duration], where n0 is the size of the initial state.
struct HybridSensitivity {
  int columns = 0;                         // D
  std::vector<double> final_state;         // (size of the final state) x D
  std::vector<std::vector<double>> nodes;  // K: of the states at the beginning of each control interval
  std::vector<std::vector<double>> after;  // of the states after the events, whose times vary as well
  std::vector<std::vector<double>> times;  // of the times of the events, D each
};

// Simulates a system, and differentiates its last motion. Not thread-safe; several simulators may share a system.
class HybridSimulator {
 public:
  explicit HybridSimulator(HybridSystem system, HybridOptions options = {});
  HybridSimulator(HybridSimulator&&) noexcept;
  ~HybridSimulator();

  const HybridSystem& system() const;

  // Simulates. Returns false if there is no motion, or if Validate(input, system) refuses the input; FailureReason()
  // then returns the reason, with mode, guard and time.
  bool Rollout(const HybridInput& input);
  // Simulates, and chooses the number of steps anew if that of an earlier rollout does not suffice for the tolerance.
  // The check costs about half a rollout.
  bool RolloutAccurately(const HybridInput& input);
  // Returns the reason why the last rollout returned false; empty if it returned true.
  const std::string& FailureReason() const;
  // Returns the approximate time at which events accumulate (Zeno behaviour). Rollout has then returned false, unless
  // the system names a mode in which the motion goes on.
  std::optional<double> accumulation() const;

  // Results of the last rollout or, if it failed, of the part of the motion before the failure.
  // Spans are valid until the next rollout.
  int final_mode() const;
  std::span<const double> final_state() const;
  const std::vector<HybridEvent>& events() const;
  // Changes of the mode at jumps of the control, such as that of a closed contact whose force jumps; without states,
  // and with guard -1.
  const std::vector<HybridEvent>& switches() const;
  const std::vector<HybridGrazing>& grazings() const;
  const std::vector<HybridTie>& ties() const;
  // Return mode and state at the beginning of control interval k, or at the end for k = K, after events there.
  int ModeAt(int k) const;
  std::span<const double> StateAt(int k) const;
  // Return time, mode and state at the beginning of each step of the integration, 0 <= step < num_steps().
  int num_steps() const;
  double StepTime(int step) const;
  int StepMode(int step) const;
  std::span<const double> StepState(int step) const;
  // Returns whether a step is the reset of the next event; it takes no time, and its state is that before the reset.
  bool IsReset(int step) const;

  // Returns why the motion has no derivative by its input, or only one-sided ones; empty if it has. Reasons are guards
  // that graze, and an event at the start or at the final time; ties, events where the control jumps, and resets onto
  // another guard, if states or derivatives differ from side to side, which costs about two gradients to check; resets
  // that jump at the state of their own event; and ReasonNotFinite().
  std::string ReasonNotDifferentiable() const;
  // Returns why the derivatives computed last are not finite: the first function of the system along the motion whose
  // derivative is not finite, with its mode, time and variables. Empty if all are finite, or if none were computed
  // since the last rollout. A caller must not use derivatives that are not finite.
  const std::string& ReasonNotFinite() const;

  // Returns the number of steps in a control interval, after the first rollout.
  int steps_per_interval() const;
  // Returns the times that divide control intervals (HybridOptions), with those that the simulator has added.
  const std::vector<double>& divisions() const;
  // Returns options with which a simulator takes the steps of the last rollout between two times of it: their number in
  // a control interval, and the times between that divide it, as parts of the time from `begin` to `end`.
  HybridOptions StepsBetween(double begin, double end) const;
  // Makes the next rollout choose the number of steps anew, unless it is given.
  void ResetStepChoice();
  // Returns the largest relative difference of final state and event times from those of a rollout with twice as many
  // steps and with halves of steps that end at events; infinite if the events (of a mechanical system, the final mode)
  // differ. It costs that rollout, unless the last one has chosen the number of steps. Precondition: the last rollout
  // succeeded.
  double IntegrationError();
  // Returns why the integration error is above the tolerance (rounding, a flow that is not smooth, or too few given
  // steps), and which guard changes faster than the steps resolve, so that events may be missed; empty if neither is
  // the case. It costs as much as IntegrationError. Precondition: the last rollout succeeded.
  std::string ReasonInaccurate();

  // Returns the gradient of a function of the last motion, given its derivatives by its arguments, by one reverse
  // sweep, whose cost does not depend on the number of controls. Precondition: the rollout succeeded.
  HybridGradient Adjoint(const HybridCotangent& cotangent);
  // Returns the gradient of a function of the final state with this cotangent.
  HybridGradient Adjoint(std::span<const double> final_cotangent);

  // Returns all derivatives of the last motion, by forward sweeps, at about D times the cost of a rollout. Those by the
  // parameters are zero unless `by_parameters`. Precondition: the rollout succeeded.
  HybridSensitivity Sensitivity(bool by_parameters = true);
  // Returns the derivatives over each control interval. Their columns are [state at its beginning, its control],
  // final_state is that at its end, and `after` and `times` are those of its events. The first interval has the events
  // at the start, too. There are no nodes.
  std::vector<HybridSensitivity> IntervalSensitivities();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string Validate(const HybridInput& input, const HybridSystem& system);

// Returns the closed form of the saltation matrix of an event,
//
//   Xi = D_x R + (f+ - D_x R f- - D_t R) D_x g / (D_t g + D_x g f-),     n+ x n-, row-major,
//
// at the state x before it, with control u, where R is the reset, g the guard, and f- and f+ the flow before and after.
// The adjoint does not use it. Precondition: the reset leads to a mode that exists, and the guard's rate is not zero.
std::vector<double> SaltationMatrix(const HybridSystem& system, int mode, int guard, double t,
                                    std::span<const double> x, std::span<const double> u, std::span<const double> p);

}  // namespace saltus
