#include "solve/phases/phase_solution.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "control/control_bounds.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"
#include "simulate/flight.h"
#include "solve/control_guess.h"
#include "solve/hmp.h"
#include "solve/phases/phase_plan.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

EventPhases::State MotionsOf(const DiscStates& x) { return {{x.p.begin(), x.p.end()}, {x.v.begin(), x.v.end()}}; }

double GapOf(const Scene& scene, const Candidate& c, const DiscStates& x) {
  return SeparationOf(scene, c, x.p).distance - MakeImpactConstants(scene, c).contact_distance;
}

// When the pair is nearest inside (from, to).
double NearestTime(const Scene& scene, const Flight& flight, const Candidate& c, double from, double to) {
  constexpr int kSamples = 24;
  double best = 0.5 * (from + to), least = std::numeric_limits<double>::infinity();
  for (int i = 1; i < kSamples; ++i) {
    const double t = from + (to - from) * i / kSamples;
    const double gap = GapOf(scene, c, flight.StatesBefore(t));
    if (gap < least) {
      least = gap;
      best = t;
    }
  }
  return best;
}

bool IsPushed(const Scene& scene, int body) {
  return std::find(scene.control.bodies.begin(), scene.control.bodies.end(), body) != scene.control.bodies.end();
}

// Gives a pushed disc of the pair such a velocity that the two approach.
void MakeApproach(const Scene& scene, const Candidate& c, DiscStates* x) {
  const Vec2d normal = SeparationOf(scene, c, x->p).normal;
  const double speed = Dot(normal, x->v[c.a]) - (c.plane ? 0.0 : Dot(normal, x->v[c.b]));
  const double least =
      (MakeImpactConstants(scene, c).contact_distance + std::abs(GapOf(scene, c, *x))) / scene.duration;
  if (speed < -least) return;
  if (IsPushed(scene, c.a)) {
    x->v[c.a] -= (speed + least) * normal;
  } else if (!c.plane && IsPushed(scene, c.b)) {
    x->v[c.b] += (speed + least) * normal;
  }
}

// Makes a minimum exact: from its augmented Lagrangian, or from slow steps, to a zero of the costate conditions near by
// (hmp.h), which replaces it and is converged, if there is one with a loss that differs by at most `loss_change` of it.
void Polish(const EventPhases& phases, double loss_change, PhaseMinimum* minimum) {
  constexpr int kMostIterations = 30;
  constexpr double kResidual = 1e-9;  // of the largest costate
  const HmpRoot root = FindHmpRoot(phases, minimum->z, kMostIterations);
  Path<double> path;
  if (!root.valid || !(root.residual <= kResidual * root.scale) || !phases.Unroll(root.z.data(), &path)) return;
  const double loss = phases.Loss(path);
  if (!(std::abs(loss - minimum->loss) <= loss_change * std::abs(loss))) return;
  for (const PhaseImpact<double>& impact : path.impacts) {
    if (!(impact.impact.speed < 0)) return;
  }
  minimum->z = root.z;
  minimum->loss = loss;
  minimum->converged = true;
  minimum->jacobians += root.jacobians;
}

// One solve on given intervals; all but the exact run of the trial is filled. False if there is no motion.
bool SolveOn(const Scene& scene, const std::vector<int>& intervals, const PhaseGuess* guess,
             const PhaseMinimumOptions& options, double loss_change, PhaseSolution* solution) {
  const EventPhases phases(scene, solution->sequence, intervals);
  PhaseMinimum& minimum = solution->minimum;
  PlanAttemptOf<Trial>& attempt = solution->attempt;
  std::vector<double> z = guess != nullptr ? phases.Variables(guess->times, guess->before, guess->end) : minimum.z;
  minimum = MinimizeLoss(phases, std::move(z), options);
  if (minimum.valid && !minimum.interrupted && !minimum.touches && !(phases.num_gaps() == 0 && minimum.converged)) {
    minimum.converged = false;
    Polish(phases, loss_change, &minimum);
  }
  attempt.jacobians += minimum.jacobians;
  attempt.interrupted = minimum.interrupted;
  attempt.converged = minimum.converged;
  Path<double> path;
  if (!minimum.valid || !phases.Unroll(minimum.z.data(), &path)) return false;
  attempt.times.clear();
  attempt.speeds.clear();
  for (const PhaseImpact<double>& impact : path.impacts) {
    attempt.times.push_back(impact.time);
    attempt.speeds.push_back(impact.impact.speed);
  }
  attempt.times.push_back(scene.duration);
  solution->intervals = intervals;
  phases.Control(path, &attempt.trial.control, &attempt.trial.durations);
  return true;
}

void SimulateSolution(const Scene& scene, PhaseSolution* solution) {
  PlanAttemptOf<Trial>& attempt = solution->attempt;
  attempt.valid = true;
  Simulate(scene, &attempt.trial);
  const std::vector<double> impacts(attempt.times.begin(), attempt.times.end() - 1);
  attempt.realized = HasEvents(attempt.trial.exact, solution->sequence, impacts, scene.duration);
}

}  // namespace

bool IsExact(const SolveRequest& request) {
  // Phases have impacts of Newton's restitution.
  const ModelTraits* model = FindContactModel(request.contact);
  return model != nullptr && model->event_driven && model->rebound == Rebound::kRestitution;
}

std::string WayByRollouts(const Scene& scene) {
  const Control& control = scene.control;
  const bool has_components = !control.max.empty() || !control.max_torque.empty(), has_norm = !control.max_norm.empty();
  const std::string takes = has_norm         ? "use gd"
                            : has_components ? "use ceres_lm or gd"
                                             : "use ceres_lm, ceres_lbfgs or gd";
  const std::string constraints = ConstraintsOf(scene.objective);
  if (!constraints.empty()) return takes + " with costs in place of the " + constraints;
  return scene.no_contact.empty() ? takes : takes + " without no_contact";
}

std::string UnsupportedByPhases(const Scene& scene) {
  if (const std::string reason = ReasonNothingToOptimize(scene); !reason.empty()) return reason;
  if (!scene.objective.IsSumOfSquares()) {
    return "the loss has a linear term and is no sum of squares: use gd or ceres_lbfgs";
  }
  const std::string beyond = NonPlaneGeometry(scene);
  return beyond.empty()
             ? ""
             : "the scene has " + beyond + "; this solver supports discs and planes only: " + WayByRollouts(scene);
}

std::string UnsupportedByExactPhases(const SolveRequest& request) {
  if (!IsExact(request)) return "this solver requires exact impacts (contact model event)";
  if (std::string reason = UnsupportedByPhases(request.scene); !reason.empty()) return reason;
  if (request.scene.Spins()) {
    return "the scene has discs that spin; the flight that this solver eliminates has no rotation: use ceres_phases";
  }
  if (request.scene.optimize == Optimize::kControl) return "";
  return "this solver optimizes a control only, and the scene optimizes something else: use ceres_lm or ceres_phases";
}

std::string UnsupportedByEventPhases(const SolveRequest& request) {
  if (std::string reason = UnsupportedByExactPhases(request); !reason.empty()) return reason;
  if (request.scene.objective.effort == 0) {
    return "without a cost of effort the best control is not unique: give objective.effort, or use ceres_phases";
  }
  return "";
}

std::vector<double> InitialOf(const Scene& scene, const Trial& trial) {
  return trial.initial.empty() ? InitialState(scene) : trial.initial;
}

Scene BeginningAs(const Trial& trial, Scene scene) {
  for (size_t i = 0; i < scene.bodies.size() && !trial.initial.empty(); ++i) {
    Body& body = scene.bodies[i];
    const double *x = &trial.initial[4 * i], *rotation = &trial.initial[4 * scene.bodies.size() + kSpin * i];
    body.position = {x[0], x[1]};
    body.velocity = {x[2], x[3]};
    if (!body.Spins()) continue;
    body.angle = rotation[0];
    body.angular_velocity = rotation[1];
  }
  return scene;
}

void Simulate(const Scene& scene, Trial* trial) {
  trial->exact = SimulateUpTo(kMostImpactsOfMotion, scene, InitialOf(scene, *trial), trial->control, trial->durations);
}

Trial GuessTrial(const Scene& scene, const std::optional<ControlGuess>& given) {
  Trial trial{InitialControl(scene, scene.steps), std::vector<double>(scene.steps, scene.dt()), {}};
  if (given) {
    trial.control = given->control;
    trial.durations = LengthsOf(*given, scene);
  }
  Simulate(scene, &trial);
  return trial;
}

Flight FlightOf(const Scene& scene, const Trial& trial) {
  return Flight(scene, InitialOf(scene, trial), trial.control, trial.durations, trial.exact);
}

PhaseGuess GuessFrom(const Scene& scene, const Flight& flight, const ContactSequence& sequence) {
  PhaseGuess guess;
  ContactSequence met;
  for (const Flight::Hit& hit : flight.hits()) met.push_back(hit.contact);
  const std::vector<int> hit = LongestCommon(sequence, met);
  const int n = static_cast<int>(sequence.size());
  guess.times.resize(n);
  for (int k = 0; k < n;) {
    if (hit[k] >= 0) {
      guess.times[k] = flight.hits()[hit[k]].time;
      guess.before.push_back(MotionsOf(flight.hits()[hit[k]].before));
      ++k;
      continue;
    }
    int end = k;  // of a run of new impacts, which share the time between their neighbours
    while (end < n && hit[end] < 0) ++end;
    const double from = k > 0 ? guess.times[k - 1] : 0.0;
    const double to = end < n ? flight.hits()[hit[end]].time : scene.duration;
    const double share = (to - from) / (end - k);
    for (int i = k; i < end; ++i) {
      const double begin = from + (i - k) * share;
      guess.times[i] = NearestTime(scene, flight, sequence[i], begin, begin + share);
      DiscStates x = flight.StatesBefore(guess.times[i]);
      MakeApproach(scene, sequence[i], &x);
      guess.before.push_back(MotionsOf(x));
    }
    k = end;
  }
  guess.end = MotionsOf(flight.end());
  return guess;
}

Certificate CertifyTrial(const Scene& scene, const Trial& trial) {
  return Certify(scene, InitialState(scene), trial.control, trial.durations);
}

std::vector<Trial> SearchBothSides(const Scene& scene, const Trial& trial, const std::vector<double>& direction) {
  // The size of the control, in the mean over time; at least a force that moves a disc by its radius.
  double size = 0;
  const size_t width = scene.control_width();
  for (size_t i = 0; i < trial.control.size(); ++i) {
    size += trial.durations[i / width] * trial.control[i] * trial.control[i];
  }
  size = std::sqrt(size);
  for (int body : scene.control.bodies) {
    const Body& disc = scene.bodies[body];
    size = std::max(size, disc.mass * disc.radius * std::pow(scene.duration, -1.5));
  }
  return StepsToBothSides(trial, size, [&](double length, Trial* moved) {
    for (size_t i = 0; i < moved->control.size(); ++i) moved->control[i] += length * direction[i];
    MoveWithinBounds(scene, moved->control);
    Simulate(scene, moved);
  });
}

std::string ReasonNotRealized(const Scene& scene, const ExactRun& run, const ContactSequence& sequence) {
  if (!run.ok) return run.reason;
  if (!run.only_impacts) return "in simulation of the solution discs rest on or graze each other or a plane";
  const std::string planned = ContactSequenceToString(scene, sequence);
  const std::string met = ContactSequenceToString(scene, run.contacts);
  if (planned == met) return "in simulation the impacts " + planned + " are at other times than in the solution";
  return "the optimum for the sequence " + planned + " is not physical: in simulation the sequence is " + met;
}

std::string ReasonNotOptimal(const Scene& scene, const ContactSequence& sequence, bool touches, const ExactRun& run) {
  if (!touches) return ReasonNotRealized(scene, run, sequence);
  return "in the best motion for the sequence " + ContactSequenceToString(scene, sequence) +
         " a pair just touches, where the loss has a kink: conditions of optimality are not checked";
}

PhaseSolution SolveAlong(const Scene& scene, const ContactSequence& sequence, const PhaseGuess& guess,
                         const PhaseMinimumOptions& options, double loss_change) {
  PhaseSolution solution;
  solution.sequence = sequence;
  std::vector<int> intervals = DistributeIntervals(scene, sequence, guess.times);
  // A second round distributes the intervals anew if the lengths of phases have changed much.
  for (int round = 0; round < 2; ++round) {
    if (intervals.empty()) return solution;
    if (!SolveOn(scene, intervals, round == 0 ? &guess : nullptr, options, loss_change, &solution)) return solution;
    const std::span<const double> impacts(solution.attempt.times.data(), sequence.size());
    std::vector<int> better = DistributeIntervals(scene, sequence, impacts);
    if (!solution.minimum.converged || solution.minimum.touches || better == intervals) break;
    intervals = std::move(better);
  }
  SimulateSolution(scene, &solution);
  return solution;
}

PhaseSolution ShareBetter(const Scene& scene, PhaseSolution best, const PhaseMinimumOptions& options,
                          double least_gain) {
  constexpr int kMostTries = 60;
  const int phases = static_cast<int>(best.intervals.size());
  int tries = 0;
  for (int moved = std::max(1, scene.steps / 16); moved > 0; moved /= 2) {
    for (bool better = true; better && tries < kMostTries;) {
      better = false;
      for (int from = 0; from < phases; ++from) {
        for (const int to : {from - 1, from + 1}) {
          std::vector<int> intervals = best.intervals;
          if (to < 0 || to >= phases || intervals[from] <= moved + 1 || ++tries > kMostTries) continue;
          intervals[from] -= moved;
          intervals[to] += moved;
          const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, best.attempt.trial), best.sequence);
          PhaseSolution next;
          next.sequence = best.sequence;
          if (!SolveOn(scene, intervals, &guess, options, 1e-2, &next)) continue;
          SimulateSolution(scene, &next);
          next.attempt.jacobians += best.attempt.jacobians;
          const bool gains = next.attempt.trial.exact.ok &&
                             next.attempt.trial.exact.loss < (1 - least_gain) * best.attempt.trial.exact.loss;
          if (!gains || (best.optimal() && !next.optimal())) {
            best.attempt.jacobians = next.attempt.jacobians;
            continue;
          }
          best = std::move(next);
          better = true;
        }
      }
    }
  }
  return best;
}

ContactSequence SequenceFor(const SolverOptions& options, const Trial& guess) {
  return options.sequences.given ? *options.sequences.given : guess.exact.contacts;
}

}  // namespace saltus
