// Simulation of a hybrid system with located events, and exact derivatives of what is simulated.
//
// An event of a guard happens at the first time at which the guard, once armed, falls through zero; the reset of the
// guard then gives the next mode and its state. On entry into a mode a guard
//
//   above zero                                          is armed;
//   at zero, if its first nonzero derivative is > 0,    is armed once it is above zero;
//   at zero, if that is < 0,                            has an event at once;
//   below zero                                          has a transition at once, which is one reset with the first.
//
// Transitions at once come before events of other guards that are at zero.
//
// "At zero" means within 1e-11 of the size of its terms. At the start a guard below zero is an error. An event at the
// final time counts: the final state is that after it.
//
// Between events the flow is integrated by a Runge-Kutta method of order 8 (hybrid/runge_kutta.h) with a fixed number
// of equal steps in each control interval; a step that meets an event ends there, and the next one ends where it would
// have. So the motion is a smooth function of its input until the sequence of events changes.
//
// Events are found by these rules. A guard that is below zero at the end of a step has its event in it. One that falls
// below zero and returns within one step is found if it falls at the beginning of the step and rises at the end, and
// the cubic through its values and rates there comes within a half of the smaller value of zero. The number of steps is
// chosen so that these cubics agree with the guards at a point of each step, whose place varies; WhyInaccurate() names
// a guard for which that takes too many steps. A dip that is much shorter than all steps may be missed.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_system.h"

namespace saltus {

// The data that a motion depends on.
struct HybridInput {
  int mode = 0;                         // at the beginning
  std::vector<double> initial = {};     // state at the beginning, of the size of that mode
  std::vector<double> parameters = {};  // P
  double duration = 0;                  // > 0
  int num_intervals = 1;                // K > 0 intervals, on each of which the control is held
  std::vector<double> control = {};     // K x m, row-major; none: zeros
  // K positive numbers, proportional to the lengths of the intervals; none: the intervals have equal lengths.
  // Derivatives with respect to the duration keep the proportions.
  std::vector<double> lengths = {};
  double begin = 0;  // time at which the motion begins; it ends at begin + duration

  // The times at which the control intervals begin, and that of the end: K + 1 numbers.
  std::vector<double> Times() const;
};

struct HybridOptions {
  // Relative error of the final state and of the event times, of the integration. The number of steps is chosen for it
  // in the first rollout, and kept; RolloutAccurately checks it again.
  double tolerance = 1e-12;
  // Integration steps of each control interval; 0: chosen. A given number is taken: IntegrationError and WhyInaccurate
  // tell how good it is. A motion fails where its steps are so long that they leave the equations of closed contacts.
  int steps_per_interval = 0;
  // A guard below zero at the start is armed once it is above zero, in the place of an error.
  bool wait_behind_guards = false;
  int most_events = 100000;  // a motion with more of them fails
  // Events of one guard in one mode without time passing. With more of them, or where its event leads back to the state
  // in which it began, the motion goes on in the mode that the system names (OnAccumulation), or fails.
  int most_repeats = 100;
  std::function<bool()> stop = {};  // asked at each step of the integration; true ends the rollout, which fails
};

struct HybridEvent {
  double time = 0;
  int mode = 0, guard = 0, next_mode = 0;
  double rate = 0;                        // of the guard in time, just before
  std::span<const double> before, after;  // states, valid until the next rollout
  bool at_once = false;                   // it follows the one before it without time passing
  bool is_switch = false;                 // the flow changes (HybridFunctions::num_switches), and the state does not
};

// A guard that reaches zero and does not cross it: the motion goes on as if it had not.
struct HybridGrazing {
  double time = 0;
  int mode = 0, guard = 0;
};

// Guards that reach zero together: at times that differ by less than the error of an integration, 1e-12 of what the
// guards are computed from. Their events are taken in the order of their times, and of those that rounding does not
// separate in the order of their numbers.
struct HybridTie {
  double time = 0;
  int mode = 0;
  std::vector<int> guards;
  // The largest difference of a component between the states that other orders lead to; infinite if they lead to other
  // modes. The result is ambiguous if it is not zero within rounding.
  double spread = 0;
  bool ambiguous = false;
};

// Derivatives by the data of a motion. Sizes as in HybridInput.
struct HybridGradient {
  std::vector<double> initial, control, parameters;
  double duration = 0;
};

// The derivative of a function of a motion by what it reads. An empty vector stands for zeros.
struct HybridCotangent {
  std::vector<double> final_state;
  std::vector<std::vector<double>> nodes;          // by the state at the beginning of each control interval
  std::vector<std::vector<double>> before, after;  // by the states before and after each event
  std::vector<double> event_times;                 // by the time of each event
};

// The derivatives of states and events; row-major, D = n0 + K m + P + 1 columns [initial control parameters
// duration].
struct HybridSensitivity {
  int columns = 0;
  std::vector<double> final_state;         // (size of the final state) x D
  std::vector<std::vector<double>> nodes;  // of the states at the beginning of each control interval
  std::vector<std::vector<double>> after;  // of the states after the events, at the events' own times
  std::vector<std::vector<double>> times;  // of the times of the events, D each
};

class HybridSimulator {
 public:
  explicit HybridSimulator(HybridSystem system, HybridOptions options = {});
  HybridSimulator(HybridSimulator&&) noexcept;
  ~HybridSimulator();

  const HybridSystem& system() const;

  // Simulates. Returns false if there is no motion, and for an input that WhatIsWrongWith(input, system) refuses, which
  // is not simulated; WhyFailed() then gives the reason, with mode, guard and time.
  bool Rollout(const HybridInput& input);
  // Does so with the accuracy that the options ask for, whatever was simulated before: where the number of steps is
  // kept from an earlier rollout and is not enough, it is chosen anew. The check costs about half a rollout.
  bool RolloutAccurately(const HybridInput& input);
  const std::string& WhyFailed() const;
  // The time, about, at which events accumulate in a motion (Zeno behaviour). Rollout has returned false then, unless
  // the system names a mode in which the motion goes on.
  std::optional<double> accumulation() const;

  // Results of the last rollout; if it failed, of the motion before that.
  int final_mode() const;
  std::span<const double> final_state() const;
  const std::vector<HybridEvent>& events() const;
  // Where the mode changes as the control jumps, as that of a closed contact whose force is another one then: without
  // states, and with guard -1.
  const std::vector<HybridEvent>& switches() const;
  const std::vector<HybridGrazing>& grazings() const;
  const std::vector<HybridTie>& ties() const;
  // Mode and state at the beginning of control interval k, or at the end for k = K: after events there.
  int ModeAt(int k) const;
  std::span<const double> StateAt(int k) const;
  // Times, modes and states at the beginning of each step of the integration.
  int num_steps() const;
  double StepTime(int step) const;
  int StepMode(int step) const;
  std::span<const double> StepState(int step) const;
  // Whether a step is the reset of the next event; it takes no time, and its state is that before the reset.
  bool IsReset(int step) const;

  // Why the motion has no derivative by its input, or only one-sided ones; empty if it has: guards that graze, an event
  // at the start or at the final time; ties, events where the control jumps, and resets onto another guard, if the
  // states or their derivatives differ from side to side. Costs about two gradients if there are any of the latter. And
  // WhyNotFinite().
  std::string WhyNotDifferentiable() const;
  // Why numbers of the derivatives computed last are not finite: the first function of the system along the motion
  // whose derivative is not, with its mode, time and variables. Empty if all are finite, or none were computed since
  // the last rollout. A caller must not use derivatives that are not finite.
  const std::string& WhyNotFinite() const;

  // Steps in a control interval, after the first rollout.
  int steps_per_interval() const;
  // Chooses the number of steps anew in the next rollout, unless it is given.
  void ChooseStepsAnew();
  // The largest relative difference of final state and event times to those of a rollout with twice as many steps, and
  // with halves of steps that events cut; infinite if it has other events (a mechanical system: another final mode).
  // Costs that rollout, unless the last one has chosen the number of steps. Precondition: the last rollout succeeded.
  double IntegrationError();
  // Why the integration error is above the tolerance (rounding, a flow that is not smooth, or too few given steps), and
  // which guard changes faster than the steps resolve, so that events may be missed; empty if neither is so. Costs as
  // much as IntegrationError. Precondition: the last rollout succeeded.
  std::string WhyInaccurate();

  // The derivative of a function of the last motion, given its derivative by what it reads: one reverse sweep, whose
  // cost does not depend on the number of controls. Precondition: the rollout succeeded.
  HybridGradient Adjoint(const HybridCotangent& cotangent);
  // Returns the gradient of a function of the final state with this cotangent.
  HybridGradient Adjoint(std::span<const double> final_cotangent);

  // All derivatives by forward sweeps; costs D times more.
  HybridSensitivity Sensitivity();
  // The derivatives over each control interval k: its columns are [state at its beginning, its control], final_state is
  // that at its end, and `after` and `times` are of the events in it. The first interval has the events at the start,
  // too. There are no nodes.
  std::vector<HybridSensitivity> IntervalSensitivities();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string WhatIsWrongWith(const HybridInput& input, const HybridSystem& system);

// The closed form of the saltation matrix of an event,
//
//   Xi = D_x R + (f+ - D_x R f- - D_t R) D_x g / (D_t g + D_x g f-),     n+ x n-, row-major,
//
// at the state x before it, with control u. The adjoint does not use it. Precondition: the reset leads to a mode that
// exists, and the guard's rate is not zero.
std::vector<double> SaltationMatrix(const HybridSystem& system, int mode, int guard, double t,
                                    std::span<const double> x, std::span<const double> u, std::span<const double> p);

}  // namespace saltus
