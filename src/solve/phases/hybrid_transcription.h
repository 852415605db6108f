// A motion of a hybrid system through a given sequence of events as a constrained least squares problem in which every
// step of the integration is a cost.
//
// The events divide [0, T] into phases of free length, each of equal control intervals, each of equal steps of the
// Runge-Kutta method. Unknown are the times of the events and T, the states before and after every step and every
// reset, the controls, the parameters. With h = (end - begin) / (number of steps of the phase), the rows are
//
//   step        x_{k+1} - F(x_k, u, p, t_k, h) = 0, F with the projection onto the equations of the mode, if it has any
//   event       g(t, x-, u, p) = 0 and x+ - R(t, x-, p) = 0 at the end of a phase, and the inequalities of the event
//               (HybridFunctions::EventRows), by the law of its regime if the plan has one (HybridFunctions::RegimeOf)
//   guards      g >= 0 at every node inside a phase; those that depend on the control under that on either side; of a
//               scene of discs (HybridScales::are_natural) within the steps, of pairs that are to stay apart alone
//   bounds      of controls, parameters, initial state, T, and of the lengths of phases
//   terms       those of the problem, at the nodes that they name
//
// Events happen only between phases, so every function is smooth. Rows are divided by the sizes of what they are of
// (HybridScales), as the augmented Lagrangian wants rows of order one.
//
// Where a system has several parts (HybridFunctions::Parts), each has nodes of its own, and steps and events have the
// nodes of those that they concern: a part that coasts has one step in each phase.
//
// Where the mode changes because the control jumps (ModeEvent), phases meet without rows: the guards of both say when.
// Instants, and waypoints of a scene, are at times that are given.
//
// A plan on a grid (PlanOf::on_grid) has each control interval as a phase of its own, whose ends are held: at given
// times, or with a free duration at given parts f of it by a row t - f T = 0. An event divides its interval into two
// phases with one control.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "hybrid/runge_kutta.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "solve/phases/augmented_lagrangian.h"
#include "solve/phases/divided_state.h"
#include "solve/phases/phase_plan.h"

namespace saltus {

// An event of a guard in a mode, whose reset leads to a mode; or with guard -1 a jump of the control.
struct ModeEvent {
  int mode = 0, guard = 0, next_mode = 0;
  bool is_switch() const { return guard < 0; }
  bool operator==(const ModeEvent&) const = default;
};

// A guard that stays above zero in a mode, and times at which it does so within a step, where it may be least between
// the ends.
struct HeldGuard {
  int mode = 0, guard = 0;
  std::vector<double> times = {};
};

// Sizes of states and guards over a motion, by mode, and of its loss.
struct HybridScales {
  std::vector<std::vector<double>> state, guard;
  double loss = 1;
  // Whether the problem is one without units, a scene of discs, with rows of order one as they are: events are not
  // divided by the sizes of their guards. No guards are held at the ends of steps, but those of PlanOf::apart within
  // all steps.
  bool are_natural = false;

  double OfEvent(const ModeEvent& event) const { return are_natural ? 1 : guard[event.mode][event.guard]; }

  // Takes a state in a mode, with its control, into account; `slope` is the rate of x, which makes a difference
  // within a tenth of `duration`.
  void Add(const HybridFunctions& functions, const ModePoint& at, const double* slope, double duration);
  // Sets sizes that are zero to 1.
  void Finish();
};

class HybridTranscription {
 public:
  struct Start {
    std::vector<double> initial, parameters;
    std::vector<double> times;                               // of the cuts, rising, and the final time
    std::function<double(int component, double t)> control;  // held on intervals around t
    std::vector<double> states = {};                         // at equal times, of one size; or none
  };

  // `steps` has the number of control intervals of each phase, one more than the plan has cuts; a phase of none has no
  // length. `substeps` steps of the integration make an interval. Nodes start at the states of the start, or without
  // any on the motion from it in which the resets happen at the times of the cuts, whatever the guards. By `overlaps`,
  // relative to the sizes of the guards, events come early; by `margin` the guards of events of plan.apart stay above
  // zero inside phases, and those of `held`. The problem must outlive this object. Precondition: some
  // phase has steps.
  HybridTranscription(const HybridProblem& problem, const HybridScales& scales, const PlanOf<ModeEvent>& plan,
                      const Start& start, const std::vector<double>& overlaps, std::vector<int> steps, int substeps,
                      double margin, const std::vector<HeldGuard>& held);
  HybridTranscription(const HybridTranscription&) = delete;

  // Whether the motion that the nodes start on is finite and has the modes of the plan.
  bool valid() const { return valid_; }

  AugmentedLagrangian::Summary Minimize(AugmentedLagrangian::Options options);

  std::vector<double> CutTimes() const;
  // The rates of the guards before the events, negative if they fall, times the duration, relative to their sizes.
  std::vector<double> CutSpeeds();
  // Returns the guards that are at zero, within rounding, at nodes inside phases, each once.
  std::vector<HeldGuard> GuardsAtZero();
  double Duration() const { return times_.back(); }
  std::vector<double> InitialState() const;
  const std::vector<double>& Parameters() const { return parameters_; }
  // One row an interval, and the intervals' lengths.
  void Control(std::vector<double>* control, std::vector<double>* durations) const;

 private:
  struct Phase {
    int mode = 0, intervals = 0;
    int first_control = 0;
    std::vector<std::vector<int>> tracks = {};  // of each part: its nodes
  };

  int num_phases() const { return static_cast<int>(phases_.size()); }
  // Whether a phase begins with an event within a control interval, whose control goes on.
  bool ContinuesControl(int phase) const {
    return plan_.on_grid && phase > 0 && plan_.cuts[phase - 1] && !plan_.cuts[phase - 1]->is_switch();
  }
  // Returns the last phase of the control interval with which a phase ends.
  int LastOfInterval(int phase) const {
    while (phase + 1 < num_phases() && ContinuesControl(phase + 1)) ++phase;
    return phase;
  }
  bool EndsWithEvent(int phase) const {
    return phase + 1 < num_phases() && plan_.cuts[phase] && !plan_.cuts[phase]->is_switch();
  }
  double* Begin(int phase) { return &times_[boundary_[phase]]; }
  double* End(int phase) { return &times_[boundary_[phase + 1]]; }
  void FindParts();
  // Whether the state moves as a whole.
  bool IsOnePart() const { return parts_.size() == 1 && !parts_.front().always_moves_by_part; }
  std::vector<int> PartsOf(const ModeEvent& event) const;
  int StepsOf(int part, int phase) const;
  // Whether a part has no node at the end of a step, before which there are `step` others.
  bool CoastsThrough(int part, int phase, int step) const;
  // Returns the node of a part after some steps of a phase, or that at its beginning where the part coasts through.
  double* NodeAt(int part, int phase, int step);
  std::vector<double*> NodesAt(const std::vector<int>& parts, int phase, int step);
  std::vector<double> StateAt(int phase, int step);
  Divided DividedState(const std::vector<int>& parts, int mode) const;
  StateAtNode MakeState(const std::vector<int>& parts, int phase, int step) const;
  std::vector<double> JoinedControl(int interval) const;
  // Return the blocks of those parts that have a control, and their places in it.
  std::vector<double*> ControlBlocks(const std::vector<int>& parts, int interval);
  Divided DividedControl(const std::vector<int>& parts) const;
  std::vector<int> PartsWith(const std::vector<int>& components, std::vector<int> StatePart::*of) const;
  const HybridFunctions& LawOf(int phase) const;
  bool IsNone(const ModeEvent& event, const ModePoint& at) const;
  bool AreGiven(const std::vector<double*>& blocks) const;
  bool SetInitialValues(const Start& start);
  void AddSteps();
  void FindScalesOfNewModes();
  bool Projects(int phase, int step) const;
  int IntervalBefore(int node, const Phase& phase) const;
  void AddEvents(const std::vector<double>& overlaps);
  void AddGuards(double margin, const std::vector<HeldGuard>& held);
  void AddGuardsWithinSteps(double margin, const std::vector<HeldGuard>& held);
  void AddLeastGuard(int guard, int phase, int step, double margin);
  void KeepApart(double margin);
  void AddTerms();
  void AddBounds();
  void FixGivenValues();
  void HoldInstants();
  double LeastLength() const;

  const HybridProblem& problem_;
  const HybridFunctions& functions_;
  HybridScales scales_;
  const PlanOf<ModeEvent> plan_;
  const int substeps_;
  RungeKutta integrator_;
  bool valid_ = false;
  std::vector<std::shared_ptr<const HybridFunctions>> laws_;  // of the events at the ends of phases; null: functions_
  std::vector<Phase> phases_;
  std::vector<double> times_;  // 0, of the cuts, T
  std::vector<int> boundary_;  // of each phase and after the last one: which of the times
  std::vector<StatePart> parts_;
  std::vector<int> all_;                                    // the parts
  std::deque<std::vector<double>> nodes_;                   // states of parts; those at the start are the first
  std::vector<std::vector<std::vector<double>>> controls_;  // of each interval and part
  std::vector<double> parameters_;
  AugmentedLagrangian lagrangian_;
};

}  // namespace saltus
