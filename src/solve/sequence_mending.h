// A local optimum over collision sequences near by, for any solver along one sequence.
//
// A sequence that is not that of an optimum shows: impacts come out of order, a phase shrinks to nothing, the two sides
// of an impact approach each other no more, or the exact roll-out meets something else. Each of these says which
// sequences are next, and each is a warm start (an active set, whose members are impacts):
//
//   impacts out of order, or at the same time   swap them; or hold them at the same time
//   an impact after the final time, or at it    hold it there; or drop it
//   a graze                                     drop it, and keep its pair apart by an inequality
//   an impact between slip and stick            slip; or stick: each by an inequality
//   the roll-out meets something else           the sequence that it has; or keep that pair apart
//
// Besides, wherever a solve leaves its sequence, exact roll-outs on the way from where it began to where it stands look
// for a better real motion, whatever the sequence that it has: solves go on from there, each from a lower loss.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "phase_run.h"
#include "saltus/control/contact_sequence.h"

namespace saltus {

// What happens in which order.
struct PhasePlan {
  std::vector<std::optional<Candidate>> cuts;     // between phases: an impact, or the instant of the next via term
  std::vector<bool> tied;                         // by cut: no time passes until the next one, or the final time
  std::vector<std::optional<ContactMode>> modes;  // by cut: of an impact that is to slip or to stick
  ContactSequence apart;                          // pairs that stay apart, by an inequality
  bool only_violation = false;                    // hard terms as costs, and hardly any others

  ContactSequence Sequence() const;
  bool HasTies() const;
  bool HasModes() const;
  bool operator==(const PhasePlan&) const = default;
};

// Where a solve along a plan begins.
struct PlanStart {
  std::vector<double> times;  // s, of the cuts
  Trial trial;                // a real motion, or one that a solve stood at when it left its sequence
};

// What a solve along a plan finds.
struct PlanAttempt {
  bool valid = false;          // all else is filled
  std::vector<double> times;   // s, of the cuts as planned, and the final time
  std::vector<double> speeds;  // of the cuts: the normal velocity, negative if closing; 0 of instants
  Trial trial;
  bool converged = false;    // an optimum along the plan
  bool interrupted = false;  // by the user
  bool realized = false;     // the exact roll-out has the plan's impacts and no others
  double violation = 0;      // of hard constraints, on the exact roll-out, in the scene's units
  int jacobians = 0;

  bool feasible() const;
  double loss() const { return trial.exact.loss; }
};

// One solve along a plan. `may_go_on` is asked after each iteration with PlanAttempt's times and speeds, if the solver
// can leave the plan on the way; where it says no, that is the end, and no interruption.
using MayGoOn = std::function<bool(const std::vector<double>& times, const std::vector<double>& speeds)>;
using TryPlan = std::function<PlanAttempt(const PhasePlan&, const PlanStart&, const MayGoOn& may_go_on)>;

// From the sequence that the options ask for, or that of the initial guess; a sequence that is given is not left, but
// for that of a motion beside a saddle. Saddles are left. The report is of the best control whose exact roll-out has
// its plan, and says in `reason` which sequences were passed.
SolveReport SolveMending(PhaseRun* run, const TryPlan& try_plan);

// The hard term that is missed most, and by how much in the scene's units. Precondition: trial.exact.ok.
struct Miss {
  double size = 0;
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
};
Miss LargestMiss(const Scene& scene, const Trial& trial);
// Its size; infinite if the trial has not run, or what must not touch has.
double ViolationOf(const Scene& scene, const Trial& trial);
double DurationOf(const Trial& trial);
// Force k of a trial holds at its time. The trial must outlive it.
std::function<Vec2d(int c, double t)> ForcesOf(const Scene& scene, const Trial& trial);

}  // namespace saltus
