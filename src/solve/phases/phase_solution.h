// Common parts of the solvers on event phases: their starts, one solve along a sequence, and the check that its result
// is a motion in simulation.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "simulate/flight.h"
#include "solve/phases/phase_minimum.h"
#include "solve/phases/phase_plan.h"

namespace saltus {

// Whether the contact model is one of exact events.
bool IsExact(const SolveRequest& request);

// Returns the solvers by rollouts that take a scene, and what is to be changed for them, as a remedy.
std::string WayByRollouts(const Scene& scene);

// Return the reasons why a scene has no phases between impacts, why exact phases do not support a request, and why arcs
// in closed form between impacts do not; empty if they do.
std::string UnsupportedByPhases(const Scene& scene);
std::string UnsupportedByExactPhases(const SolveRequest& request);
std::string UnsupportedByEventPhases(const SolveRequest& request);

// A control on intervals of any length, and what it does in exact dynamics.
struct Trial {
  std::vector<double> control, durations;
  ExactRun exact;
  std::vector<double> initial = {};  // where it is to be found; empty: the scene's
};

std::vector<double> InitialOf(const Scene& scene, const Trial& trial);
// The scene that begins as the trial does.
Scene BeginningAs(const Trial& trial, Scene scene);

// More impacts than this are no motion to go on from: their phases would be shorter than any step, and to align two
// such sequences takes the product of their lengths.
inline constexpr int kMostImpactsOfMotion = 1000;

// Runs trial->control, up to so many impacts.
void Simulate(const Scene& scene, Trial* trial);
// The control to start from: `given`, or else the scene's.
Trial GuessTrial(const Scene& scene, const std::optional<ControlGuess>& given = std::nullopt);
// Precondition: trial.exact.ok.
Flight FlightOf(const Scene& scene, const Trial& trial);

// Where to start along a sequence.
struct PhaseGuess {
  std::vector<double> times;               // of the impacts, rising
  std::vector<EventPhases::State> before;  // just before each
  EventPhases::State end;
};
// Makes a guess from a flight along another sequence: impacts that both have, in order, are kept. A new one is put
// where its pair comes nearest between its neighbours, and a pushed disc is given a velocity towards the other.
PhaseGuess GuessFrom(const Scene& scene, const Flight& flight, const ContactSequence& sequence);

// The outcome of a solve along a sequence.
struct PhaseSolution {
  ContactSequence sequence;
  PhaseMinimum minimum;
  std::vector<int> intervals;    // of each phase
  PlanAttemptOf<Trial> attempt;  // along a plan of these impacts: if valid, all else is filled
  bool optimal() const { return attempt.valid && attempt.converged && attempt.realized; }
};
// With piecewise constant forces on Scene::steps intervals. Not valid if there are too few of them, or the guess is of
// no use. The last steps, to a zero of the costate conditions (hmp.h), may change the loss by the part `loss_change`.
PhaseSolution SolveAlong(const Scene& scene, const ContactSequence& sequence, const PhaseGuess& guess,
                         const PhaseMinimumOptions& options, double loss_change = 1e-4);
// Returns the solution with intervals moved from phases to those beside them, as long as that lowers the loss by the
// part `least_gain` of it. An optimum stays one. Precondition: best.attempt is valid, and its trial.exact.ok.
PhaseSolution ShareBetter(const Scene& scene, PhaseSolution best, const PhaseMinimumOptions& options,
                          double least_gain);

Certificate CertifyTrial(const Scene& scene, const Trial& trial);

// Returns better motions on both sides of a motion along a direction of its control (StepsToBothSides).
std::vector<Trial> SearchBothSides(const Scene& scene, const Trial& trial, const std::vector<double>& direction);

// For a person: where the exact run departs from the sequence.
std::string ReasonNotRealized(const Scene& scene, const ExactRun& run, const ContactSequence& sequence);
// For a person: why a minimum along the sequence that touches, or whose control does not run so, is no optimum.
std::string ReasonNotOptimal(const Scene& scene, const ContactSequence& sequence, bool touches, const ExactRun& run);

// The sequence that the options ask for; that of the initial guess unless one is given.
ContactSequence SequenceFor(const SolverOptions& options, const Trial& guess);

}  // namespace saltus
