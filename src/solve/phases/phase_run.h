// The problems of solvers along sequences of impacts: a scene of discs as phase_plan.h wants a problem, and what such
// solvers do around their algorithm: time, simulate the initial guess, collect losses, ask the callback, write the
// report.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "saltus/solve/solver.h"
#include "solve/phases/phase_plan.h"
#include "solve/phases/phase_solution.h"
#include "solve/phases/scene_phases.h"
#include "solve/phases/sequence_run.h"

namespace saltus {

using PhasePlan = PlanOf<Candidate>;
using PlanStart = PlanStartOf<Trial>;
using PlanAttempt = PlanAttemptOf<Trial>;

// Exact motions of a scene, which must outlive this object.
class DiscMotions {
 public:
  explicit DiscMotions(const Scene& scene) : scene_(&scene) {}

  void Simulate(Trial* trial) const { saltus::Simulate(*scene_, trial); }
  bool IsRealized(const Trial& trial, const ContactSequence& sequence, const std::vector<double>& times) const {
    return HasEvents(trial.exact, sequence, times, scene_->duration);
  }
  // Returns the violation of hard terms in the scene's units; infinite if the trial has not run, or if a pair that must
  // not touch has.
  double ViolationOf(const Trial& trial) const;
  // The exact model moves an impact that is a little after a node there.
  double NodeMargin(const Trial& trial) const;
  static int SideOf(const Candidate&) { return 1; }

 private:
  const Scene* scene_;
};

class PhaseRun final : public SequenceRun, private DiscMotions {
 public:
  using Event = Candidate;
  using Motion = Trial;
  class Transcriber;
  static constexpr double kUneven = 2;         // a step so many times the mean one is too long
  static constexpr bool kHoldsGuards = false;  // at the ends of all steps, beside those of events that are to stay open

  PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options);
  // Begins with a motion in place of the initial guess.
  PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options, Trial start);

  const Scene& scene() const { return scene_; }
  const Trial& guess() const { return guess_; }
  const std::optional<ContactSequence>& given_sequence() const { return options_.sequences.given; }
  int num_steps() const { return scene_.steps; }
  int control_width() const { return scene_.control_width(); }
  // Return a report if there is nothing to start from, with the reason; otherwise std::nullopt. The second also refuses
  // a motion with other contacts than impacts, the third an empty sequence too.
  std::optional<SolveReport> MotionFailure();
  std::optional<SolveReport> StartFailure();
  std::optional<SolveReport> SequenceFailure(const ContactSequence& sequence);

  // Simulates the control of a trial.
  using DiscMotions::Simulate;
  using DiscMotions::ViolationOf;
  // The loss, and what is left of hard constraints. Infinite if there is no motion, or one with other contacts.
  double MeritOf(const Trial& trial) const;
  // Moves the forces into their bounds; the second simulates what has changed.
  void MoveWithin(Trial* trial) const;
  Trial ClampToBounds(Trial trial) const;
  // Puts the start of `between` at a part of the way from one motion to another.
  void BlendStart(const Trial& to, const Trial& from, double part, Trial* between) const;

  // The plan of a sequence, without forbidden impacts, and when its cuts are in a motion: in one of that sequence, or
  // where pairs come nearest.
  void PlanAlong(ContactSequence sequence, const Trial& trial, PhasePlan* plan, std::vector<double>* times) const;
  // Whether its events can follow one another.
  bool IsPossible(const PhasePlan&) const { return true; }
  // The impacts that are nearly between slip and stick, with each of the two.
  std::vector<std::pair<size_t, int>> RegimesAtBorders(const PhasePlan& plan, const Trial& trial) const;
  // Nothing but the exact roll-out holds gaps of discs open, so that they do not just close at an optimum.
  std::vector<std::pair<PhasePlan, std::vector<double>>> PlansThroughTouches(const Trial&) const { return {}; }
  std::vector<std::pair<PhasePlan, std::vector<double>>> PlansWithJumpsOnGrid(const PhasePlan&, const Trial&) const {
    return {};
  }
  // The transcription of discs has no plans on a grid.
  std::vector<std::pair<PhasePlan, std::vector<double>>> PlansOnGrid(const Trial&) const { return {}; }

  // Whether the conditions of the certificate are those of this problem.
  bool HasCertificate() const;
  // Whether an optimum is certified, and its certificate refutes it.
  bool IsRefuted(const Trial& optimum) {
    return certifies() && Certify(optimum).verdict == Certificate::Verdict::kNotStationary;
  }
  // The certificate of the last control is kept: an optimum is certified by its solve, for saddles, and in the end.
  const Certificate& Certify(const Trial& trial);
  // Directions have the shape of the control.
  size_t DirectionSize(const Trial& trial) const { return trial.control.size(); }
  std::vector<Trial> SearchBothSides(const Trial& trial, const std::vector<double>& direction) const {
    return saltus::SearchBothSides(scene_, trial, direction);
  }

  // Returns the reason why a motion has no finite derivative; motions of discs have one.
  std::string ReasonNoDerivative(const Trial&) const { return ""; }

  // In words: a sequence; a plan; several in their order; the kinks of the loss that it holds on to; what the trial
  // misses most; where the exact run departs from the sequence.
  std::string NameOf(const ContactSequence& sequence) const { return ContactSequenceToString(scene_, sequence); }
  std::string NameOf(const PhasePlan& plan) const;
  std::string NamesOf(const std::vector<PhasePlan>& plans) const;
  std::string KinksOf(const PhasePlan& plan) const;
  std::string DescribeMiss(const Trial& trial) const;
  std::string ReasonNotRealized(const Trial& trial, const ContactSequence& sequence) const {
    return saltus::ReasonNotRealized(scene_, trial.exact, sequence);
  }

  SolveReport Finish(const Trial& trial, double loss, Termination termination, std::string reason = {});

 private:
  const Scene& scene_;
  Trial guess_;
  struct Certified {
    std::vector<double> control, durations;
    Certificate certificate;
  };
  std::optional<Certified> certified_;
};

// The transcriptions of one plan, and the motions of what they find.
class PhaseRun::Transcriber : public DiscMotions {
 public:
  Transcriber(const PhaseRun& run, const PhasePlan& plan, const PlanStart& start);
  Transcriber(const Transcriber&) = delete;  // motions refer to its scene

  double duration() const { return scene_.duration; }
  // Pairs that must not touch, except at the cuts.
  const ContactSequence& apart() const { return apart_; }
  // Gaps that stay at zero are those of events, or apart.
  bool HoldBorders(HybridTranscription* /*transcription*/, const Trial& /*trial*/) { return false; }
  std::string borders() const { return ""; }
  std::unique_ptr<HybridTranscription> Make(const PlanStart& start, const std::vector<double>& overlaps,
                                            const std::vector<int>& steps, double margin) const {
    return phases_->Make(start.trial, start.times, overlaps, steps, margin);
  }
  void TakeControl(const HybridTranscription& transcription, Trial* trial) const {
    phases_->TakeControl(transcription, trial);
  }

 private:
  void AimAtConstraints(const Trial& start);

  Scene scene_;
  ContactSequence apart_;
  std::optional<ScenePhases> phases_;
};

using TryPlan = TryPlanOf<PhaseRun>;

}  // namespace saltus
