// What a solve along a sequence of impacts is asked for, where it begins and what it finds.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "solve/phases/phase_solution.h"

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

  bool feasible() const;  // realized, and within what may be left of hard constraints
  double loss() const { return trial.exact.loss; }
};

// One solve along a plan. `may_go_on` is asked after each iteration with PlanAttempt's times and speeds, if the solver
// can leave the plan on the way; where it says no, that is the end, and no interruption.
using MayGoOn = std::function<bool(const std::vector<double>& times, const std::vector<double>& speeds)>;
using TryPlan = std::function<PlanAttempt(const PhasePlan&, const PlanStart&, const MayGoOn& may_go_on)>;

// The hard term that is missed most, and by how much in the scene's units. Precondition: trial.exact.ok.
struct Miss {
  double size = 0;
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
};
Miss LargestMiss(const Scene& scene, const Trial& trial);
// Its size; infinite if the trial has not run, or what must not touch has.
double ViolationOf(const Scene& scene, const Trial& trial);
// The same, or the largest distance of the control from its bounds, if that is more; 0 if the scene and the user state
// no constraints, whatever the motion.
double ViolationOfAll(const Scene& scene, const Trial& trial);
// Whether the scene forbids the pair to touch.
bool IsForbidden(const Scene& scene, const Candidate& c);
double DurationOf(const Trial& trial);
// Force k of a trial holds at its time. The trial must outlive it.
std::function<double(int entry, double t)> ForcesOf(const Scene& scene, const Trial& trial);

// In words: a plan; several in their order; the kinks of the loss that it holds on to; what the trial misses most.
std::string NameOf(const Scene& scene, const PhasePlan& plan);
std::string NamesOf(const Scene& scene, const std::vector<PhasePlan>& plans);
std::string KinksOf(const Scene& scene, const PhasePlan& plan);
std::string DescribeMiss(const Scene& scene, const Trial& trial);

}  // namespace saltus
