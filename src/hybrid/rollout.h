// The motion of a hybrid system, recorded on a tape. In mode m, with state x, parameters p and control u,
//
//   x' = f_m(t, x, p, u)
//   x+ = r_g(t, x-, p), and a new mode, when a guard g_m(t, x, p, u) of the mode falls through zero.
//
// The flow is integrated by a Runge-Kutta method of order 8 (runge_kutta.h), in equal steps of the control intervals,
// or of the parts into which they are divided where the flow has pulses (hidden_changes.h). A step ends at an event
// that happens within it (event_search.h), and the next one begins with the state after it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "hybrid/event_search.h"
#include "hybrid/motion_tape.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {

enum class RolloutEnd {
  kDone,
  kNotFinite,  // of the integration: more steps may help
  kRefused,    // what the user's functions return, or where the motion leads
};

// Returns the remark on a tie: "2 guards reach zero at t = 1, and <consequence>: 'a', 'b'".
TimedRemark RemarkOnTie(const HybridSystem& system, const HybridTie& tie, const std::string& consequence);

// The control interval k > 0 that begins within `margin` of its length of `time`, if the control jumps there; -1 if
// none does.
int ControlJumpNear(const HybridInput& input, int num_controls, double time, double margin);

// The steps of a motion: so many, of equal lengths, in each control interval, or in each of the parts into which times
// within it divide it. The times are parts of the duration, in order.
struct RolloutSteps {
  int per_interval = 1;
  std::span<const double> divisions = {};
};

class RolloutRun {
 public:
  RolloutRun(const HybridSystem& system, const HybridOptions& options);

  // Precondition: the input has all numbers of its control. `compare_guards`: counts the steps that do not resolve the
  // guards, which takes an evaluation of all guards for each step.
  RolloutEnd Run(const HybridInput& input, const RolloutSteps& steps, bool compare_guards = false);

  // Results of the last run.
  const MotionTape& tape() const { return tape_; }
  const std::vector<HybridEvent>& events() const { return events_; }
  const std::vector<HybridEvent>& switches() const { return switches_; }
  const std::vector<HybridGrazing>& grazings() const { return grazings_; }
  // The ties, without their spreads.
  const std::vector<HybridTie>& ties() const { return ties_; }
  const std::string& why() const { return why_; }
  std::optional<double> accumulation() const { return accumulation_; }
  const std::vector<TimedRemark>& remarks() const { return remarks_; }
  // Events at the start, and switches on which it is, if the flow jumps there: whether other inputs begin so too
  // depends on these numbers of the input.
  struct StartDependence {
    std::string what;
    std::vector<char> initial, parameters, control;  // of the first interval
  };
  const std::vector<StartDependence>& at_start() const { return at_start_; }
  // The time at which a run failed, and whether the flow failed there, at a state near the motion.
  double failure_time() const { return failure_time_; }
  bool flow_fails() const { return flow_fails_; }

  // The steps within which a guard is not the cubic through its values and rates at their ends, where that might hide
  // an event. `what`: which guard, and where.
  struct Unresolved {
    int steps = 0;
    std::string what;
    bool flies = false;  // some mode has a closed form of its flow
  };
  const Unresolved& unresolved() const { return unresolved_; }
  // Whether the steps resolve the guards, up to a few places: a guard with a kink near zero is resolved nowhere there.
  bool ResolvesGuards() const;

 private:
  // A mode and its state, with all guards as they stand. One that is at zero needs not rise before it falls.
  struct ModeState {
    int mode = 0;
    double t = 0;
    std::vector<double> x, slope;
    std::vector<GuardValue> guards;
    std::vector<char> armed, at_zero;  // armed may be kHeld: a switch on whose zero the motion stays
  };
  static constexpr char kHeld = 2;
  struct PendingEvent {
    int guard = -1;
    double s = 0;
    bool sinks = false;  // the guard is at zero at the beginning of the step, and leaves it with a rate of zero
  };
  enum class Entry { kStart, kAfterReset, kControlJump };

  void SetGrid(int steps, std::span<const double> divisions);
  bool JumpsWithControl(int guard) const;
  std::vector<int> TouchingGuards();
  bool SwitchControl();
  bool ChooseSwitchSides(Entry entry);
  bool StaysOnSwitch(const FlowStep& ahead, int guard, double fastest);
  bool JumpsFrom(const std::vector<double>& slope) const;
  bool IsWithinTie() const;
  void RemarkOnSwitches(Entry entry);
  void RemarkOnRisingGuard(int guard);
  void RemarkOnSharedSurfaces(const FlowStep& here);
  bool AllLandOn(int guard) const;
  bool StepTo(int node);
  bool SatisfiesEquations();
  bool EnterMode(Entry entry);
  bool ApplyReset(int guard, bool with_step, bool immediate);
  bool IsLastGrazing(int mode, int guard, double time) const;
  PendingEvent EarliestEvent(const FlowStep& step, const std::vector<GuardValue>& end);
  bool FlowJumpsAt(const ModePoint& at, int guard) const;
  bool TurnsBackWithControl(const FlowStep& step, int guard, double s);
  bool AreGuardAndItsSwitches(const std::vector<int>& guards) const;
  bool TakeEvent(const PendingEvent& due, const FlowStep& step);
  bool IsSecondSwitch(int other) const;
  bool Passes(int falling, int next) const;
  bool GuardsChangeWith(int guard) const;
  int NumberIn(int to, int from, int guard) const;
  bool WaitsBehindJump(int before, int guard) const;
  bool AreParallel(const ModePoint& a, int guard_a, const ModePoint& b, int guard_b) const;
  bool IsItsSwitch(int guard, int its_switch) const;
  std::vector<int> TiedGuards(const PendingEvent& due, int* first);
  void CompareGuards(const FlowStep& step);
  bool Accumulates(double until);
  void MoveToAccumulation(int period, double time);
  std::string ReasonRepeatedEvent(int guard, EventSearch::GuardStatus standing) const;
  bool ContinueAfterAccumulation(double time, int mode, int guard, const std::string& why);
  bool UpdateSlope();
  void UpdateGuards();
  double Elapsed(double time) const;
  FlowStep StepFrom(double h) const;
  TapeEntry& Record(TapeEntry::Kind kind, double h);
  bool Refuse(const std::string& what);
  bool FailAt(const FlowStep& step);
  std::string DescribeTime() const;
  std::string QualifiedGuardName(int mode, int guard) const;
  std::string DescribeContinuations(int mode, int guard) const;
  void Remark(const std::string& what, const std::string& where = "");
  StartDependence DependenceOf(int guard) const;
  void RemarkOnStart(const std::vector<int>& guards, bool first);
  void Finish();

  const HybridSystem& system_;
  const HybridFunctions& functions_;
  const HybridOptions& options_;
  EventSearch search_;
  const HybridInput* input_ = nullptr;
  int interval_ = 0;
  ModeState at_;
  std::vector<double> next_state_, next_slope_, state_within_;
  std::vector<GuardValue> next_guards_;
  MotionTape tape_;
  std::vector<HybridEvent> events_, switches_;
  std::vector<std::size_t> befores_, afters_;  // of the events, in the tape's numbers
  std::vector<HybridGrazing> grazings_;
  std::vector<HybridTie> ties_;
  bool compare_guards_ = false;
  Unresolved unresolved_;
  std::string why_;
  std::vector<TimedRemark> remarks_;
  std::vector<StartDependence> at_start_;
  std::optional<double> accumulation_;
  int accumulations_at_once_ = 0;  // at the time of the last one, before it
  RolloutEnd end_ = RolloutEnd::kDone;
  double largest_ = 0;  // of states, parameters and controls so far
  double failure_time_ = 0;
  bool flow_fails_ = false;
};

}  // namespace saltus
