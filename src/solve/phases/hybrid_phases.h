// A problem of a hybrid system as solvers along sequences of events want it (phase_plan.h), and the first of these:
// ceres_phases.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "control/hybrid_shooting.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "solve/phases/hybrid_transcription.h"
#include "solve/phases/phase_plan.h"
#include "solve/phases/sequence_run.h"

namespace saltus {

// A control on intervals of any lengths, an initial state and parameters, and their exact simulation.
struct HybridMotion {
  std::vector<double> control, durations, initial, parameters;
  struct Exact {
    bool ok = false;
    bool moves = false;  // there is a motion, to which a term may not apply
    std::string reason;  // if not ok
    double loss = INFINITY;
    double violation = 0;      // of constraints and bounds: the largest
    std::string worst;         // the constraint that is violated most
    bool only_impacts = true;  // every event takes its own time and crosses zero: no transitions at once, no grazing
    std::vector<ModeEvent> contacts;
    std::vector<HybridEvent> events;  // their states are not valid
  } exact;
  std::vector<double> guess_states = {};  // of a guess: HybridProblem::guess_states
};

// The motion of an input, not simulated.
HybridMotion MotionOf(const HybridInput& input);

class HybridPhaseRun final : public SequenceRun {
 public:
  using Event = ModeEvent;
  using Motion = HybridMotion;
  class Transcriber;
  static constexpr double kUneven = 1.25;     // a step so many times the mean one is too long
  static constexpr bool kHoldsGuards = true;  // at the ends of all steps, beside those of events that are to stay open

  // Precondition: UnsupportedByHybridPhases(problem) is empty. From the guess of the problem, or another motion, which
  // is simulated; along a sequence that is given, or that of the motion.
  HybridPhaseRun(std::string_view solver, const HybridProblem& problem, const SolverOptions& options,
                 std::optional<HybridMotion> start = std::nullopt,
                 std::optional<std::vector<ModeEvent>> sequence = std::nullopt);

  // With the intervals of this run's control.
  const HybridProblem& problem() const { return problem_; }
  const HybridMotion& guess() const { return guess_; }
  const std::optional<std::vector<ModeEvent>>& given_sequence() const { return sequence_; }
  const HybridScales& scales() const { return scales_; }
  int num_steps() const { return problem_.guess.num_intervals; }
  int control_width() const { return problem_.system.num_controls(); }
  // Returns a report if there is nothing to start from, with the reason; otherwise std::nullopt.
  std::optional<SolveReport> StartFailure();

  // Returns the input on which the motion depends.
  HybridInput InputOf(const HybridMotion& motion) const;
  void Simulate(HybridMotion* motion) const;
  double ViolationOf(const HybridMotion& motion) const;
  double MeritOf(const HybridMotion& motion) const;
  void MoveWithin(HybridMotion* motion) const;
  HybridMotion ClampToBounds(HybridMotion motion) const;
  void BlendStart(const HybridMotion& to, const HybridMotion& from, double part, HybridMotion* between) const;

  // Plans a sequence. An event that the motion lacks is put between its neighbours, where its guard is smallest.
  // The plan is on the grid of the motion if the problem is, if the sequence has more phases than the grid intervals,
  // or if it has no events and the lengths of the intervals are given.
  void PlanAlong(const std::vector<ModeEvent>& sequence, const HybridMotion& motion, PlanOf<ModeEvent>* plan,
                 std::vector<double>* times) const;
  // Whether there is something to start from: a motion, to which the terms need not apply if a sequence is given, or
  // states.
  bool Starts() const {
    const auto& exact = guess_.exact;
    return exact.ok || (sequence_ && exact.moves && exact.only_impacts) || !guess_.guess_states.empty();
  }
  // Whether each event is one of the mode that the event before it leads to, and the terms apply to such a motion.
  bool IsPossible(const PlanOf<ModeEvent>& plan) const { return IsPossible(plan.Sequence()); }
  bool IsPossible(const std::vector<ModeEvent>& sequence) const;
  std::vector<std::pair<size_t, int>> RegimesAtBorders(const PlanOf<ModeEvent>&, const HybridMotion&) const {
    return {};
  }
  // Returns the plan on the intervals of the motion that it starts from, with the times of its cuts, if the control
  // jumps into other modes at their ends.
  std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> PlansWithJumpsOnGrid(const PlanOf<ModeEvent>& plan,
                                                                                      const HybridMotion& motion) const;
  // Returns plans with one event more, each with the times of its cuts, for every guard that the motion meets at zero
  // without an event: guards are held above zero at the ends of steps.
  std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> PlansThroughTouches(const HybridMotion& motion) const;
  // Returns the plans on the grid of a motion, each with the times of its cuts, in which the events that leave the ends
  // of their intervals for a lower loss, by the certificate, are before them, and behind; none if no event does. Their
  // sequences are those of the exact motions with these ends moved a little.
  std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> PlansOnGrid(const HybridMotion& motion);

  bool HasCertificate() const { return true; }
  const Certificate& Certify(const HybridMotion& motion);
  // Directions have the control, and then the free components of the initial state, the free parameters and the
  // duration if it is free.
  size_t DirectionSize(const HybridMotion& motion) const;
  std::vector<HybridMotion> SearchBothSides(const HybridMotion& motion, const std::vector<double>& direction) const;

  // Returns the reason why a motion, or a term at it, has no finite derivative; empty if it has, or without a motion.
  std::string ReasonNoDerivative(const HybridMotion& motion) const;

  std::string NameOf(const ModeEvent& event) const;
  std::string NameOf(const std::vector<ModeEvent>& sequence) const;
  std::string NameOf(const PlanOf<ModeEvent>& plan) const;
  std::string NamesOf(const std::vector<PlanOf<ModeEvent>>& plans) const;
  std::string KinksOf(const PlanOf<ModeEvent>& plan) const;
  std::string DescribeMiss(const HybridMotion& motion) const;
  std::string ReasonNotRealized(const HybridMotion& motion, const std::vector<ModeEvent>& sequence) const;

  SolveReport Finish(const HybridMotion& motion, double loss, Termination termination, std::string reason = {});

 private:
  void BeginWhereMotionGoes();
  void FindScales();
  void RaiseUnnoticedSizes();

  HybridProblem problem_;
  std::unique_ptr<HybridShooting> shooting_;
  HybridScales scales_;
  HybridMotion guess_;
  std::optional<std::vector<ModeEvent>> sequence_;
  struct Certified {
    HybridMotion motion;
    Certificate certificate;
  };
  std::optional<Certified> certified_;  // the last motion that was
};

// Returns the reason why a problem has no phases; empty if it has.
std::string UnsupportedByHybridPhases(const HybridProblem& problem);

// Solves along the events of the initial guess, which are updated (sequence_update.h), with a cost for every step
// (hybrid_transcription.h). Converged means: an optimum along its sequence, and the exact roll-out has these events and
// violates no constraint. Precondition: UnsupportedByHybridPhases() is empty.
SolveReport SolveHybridByPhases(const HybridProblem& problem, const SolverOptions& options);

// Solves in this way by the interior-point method of IPOPT, with the Hessian of the Lagrangian (interior_point.h).
std::string UnsupportedByInteriorPoint(const HybridProblem& problem);
SolveReport SolveHybridByInteriorPoint(const HybridProblem& problem, const SolverOptions& options);

SolveReport UpdateHybridSequence(HybridPhaseRun* run);

// Returns the report of a guess that its certificate proves to be a local optimum; nothing of another.
std::optional<SolveReport> RecogniseGuess(std::string_view solver, const HybridProblem& problem,
                                          const SolverOptions& options);

// Returns the numbers of control intervals of solves from coarse to fine; the last is that of the guess.
std::vector<int> GridsOf(const HybridProblem& problem, const SolverOptions& options);

// Returns the problem with the guess on equal intervals, of which each has the control in its middle.
HybridProblem ResampleOnGrid(HybridProblem problem, int intervals);

}  // namespace saltus
