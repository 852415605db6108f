// Events at one time: the states that other orders of them lead to, and their derivatives on every side.
//
// Where guards reach zero together, a small change of the input separates their events, in an order that depends on
// the change. So the state after all of them is a function of the change that is smooth on each of several cones. It
// has a derivative if one linear function describes it on all of them. Follow evaluates it along one direction: it
// orders the events by their times, to first order, as the motion itself does. The jump of a control is an event whose
// time depends on the duration alone.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <vector>

#include "hybrid/event_search.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {

class TiedEvents {
 public:
  TiedEvents(const HybridSystem& system, const HybridOptions& options);

  // The state just before the events, and the guards of its mode that are at zero.
  struct Start {
    FlowStep at;         // its length is one over which guards of interest change
    double elapsed = 0;  // since the motion began
    std::vector<int> guards;
  };

  // Sets the spread of a tie between the states that other orders lead to: all orders of up to four guards; of more,
  // the order of their numbers, its reverse, and some of its rotations.
  void Compare(const Start& start, HybridTie* tie);

  // A change of the motion, to first order. The state is that at the time of the events, continued in the mode before
  // them.
  struct Direction {
    Eigen::VectorXd x, size, p, u;  // size: sums of the absolute values of the terms of x, of which rounding is a part
    // The control that follows if it jumps there; else null. With its change, and that of the time of the jump.
    const double* next_control = nullptr;
    Eigen::VectorXd next_u;
    double jump = 0;
  };
  struct Outcome {
    int mode = 0;
    std::vector<double> x;
    Eigen::VectorXd change, size;  // of x, at the time of the events, continued in the mode after them
  };
  // Returns std::nullopt if there is no such change: a guard that leaves zero with a rate of zero, an event without
  // end, a reset or a jump that leads to no mode.
  std::optional<Outcome> Follow(const Start& start, Direction direction);

  // Whether the reset of an event jumps along the flow where its guard is zero, so that rounding decides on which side
  // of the jump it is evaluated: its values just before and just behind the event differ, and do not approach each
  // other. `duration`: of the motion.
  bool JumpsAtItsEvent(const ModePoint& event, int guard, double duration) const;

  // Whether two states are the same except for the error of an integration.
  static bool SameStates(const double* a, const double* b, int size);

 private:
  using GuardStatus = EventSearch::GuardStatus;
  struct Candidate {
    int guard = 0;
    double rate = 0;
    GuardStatus standing = GuardStatus::kFalling;
  };
  // The mode in which the motion goes on in place of an event, as events of the guard accumulate: it has had one with
  // the same state, or one after which it is at zero with a rate of zero. -1 if it has not, or the system names none.
  // That of a switch at which the flows on both sides point is its zero.
  int ModeAtRest(const FlowStep& at, const Candidate& candidate) const;
  bool Bounces(const FlowStep& at, int guard, const Direction& direction, double now, int rest);
  // Moves from the zero of each switch to the side on which value(guard, rate) lies, unless that is 0, and computes the
  // slope there. Returns false if there is no such side, or the slope is not finite.
  bool LeaveSwitches(FlowStep* at, const std::function<double(int guard, double rate)>& value);
  // Finds guards that are at zero or behind on entry into a mode; returns false if one is not finite.
  bool FindCandidates(const FlowStep& at, const double* slope, double elapsed);
  // The state and mode after one order of the events; choose(n) is which of n guards comes next.
  bool Order(const Start& start, const std::function<int(int)>& choose, int* mode, std::vector<double>* x);
  bool SlopeAt(const ModePoint& at, std::vector<double>* slope) const;

  const HybridSystem& system_;
  const HybridFunctions& functions_;
  const HybridOptions& options_;
  EventSearch search_;
  struct Event {
    int mode = 0, guard = 0;
    std::vector<double> x;
  };
  std::vector<Event> happened_;
  std::vector<Candidate> candidates_;
  std::vector<GuardValue> values_;
  std::vector<double> slope_, next_, gradient_, jacobian_;
};

}  // namespace saltus
