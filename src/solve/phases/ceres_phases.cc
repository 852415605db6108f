#include "solve/phases/ceres_phases.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "saltus/control/objective.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/registry.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/interior_point.h"
#include "solve/phases/phase_attempt.h"
#include "solve/phases/sequence_update.h"
#include "solve/solve_chain.h"

namespace saltus {
namespace {

using Algorithm = AugmentedLagrangian::Algorithm;

constexpr double kSameTime = 1e-6;  // of the horizon
constexpr double kNoLoss = 1e-9;    // relative: of the loss, that the last digits may cost

// The phases of a motion: its impacts and the instants of via terms, and the number of steps between them.
struct Phases {
  PhasePlan plan;
  std::vector<double> times;  // of the cuts
  std::vector<int> steps;
};

// Returns std::nullopt if two of the events coincide or if one coincides with the final time.
std::optional<Phases> PhasesOf(const Scene& scene, const Trial& trial) {
  Phases phases;
  std::vector<std::pair<double, std::optional<Candidate>>> cuts;
  for (size_t k = 0; k < trial.exact.events.size(); ++k) {
    cuts.emplace_back(trial.exact.events[k].time, trial.exact.contacts[k]);
  }
  for (const double waypoint : WaypointsOf(scene)) cuts.emplace_back(waypoint, std::nullopt);
  std::ranges::stable_sort(cuts, {}, &decltype(cuts)::value_type::first);
  for (const auto& [time, impact] : cuts) {
    phases.times.push_back(time);
    phases.plan.cuts.push_back(impact);
  }
  phases.plan.tied.resize(cuts.size());
  phases.plan.regimes.resize(cuts.size());
  double end = 0;
  int steps = 0;
  for (const double duration : trial.durations) {
    end += duration;
    ++steps;
    const size_t cut = phases.steps.size();
    if (cut == cuts.size() || std::abs(phases.times[cut] - end) > kSameTime * scene.duration) continue;
    phases.steps.push_back(steps);
    steps = 0;
  }
  if (phases.steps.size() < cuts.size() || steps == 0) return std::nullopt;
  phases.steps.push_back(steps);
  return phases;
}

bool ArcsCanTake(const SolveRequest& request) {
  const Scene& scene = request.scene;
  return scene.optimize == Optimize::kControl && scene.objective.effort > 0 && !scene.Spins() &&
         NonTerminalFeatures(scene).empty();
}

// A solve along a plan by a cost for every step. Where many iterations have not led it to the optimum, or rounding
// keeps it from the last digits, arcs in closed form go on, if the problem is one for them.
PlanAttempt TryBySteps(PhaseRun* run, bool arcs_can, const PhasePlan& plan, const PlanStart& start,
                       const ContinuePredicate& may_continue) {
  bool left = false;
  const ContinuePredicate watched = [&](const auto& times, const auto& speeds) {
    left = !may_continue(times, speeds);
    return !left;
  };
  PlanAttempt attempt = TryByTranscription(run, plan, start, watched);
  const bool kinks = plan.HasTies() || plan.HasRegimes() || !plan.apart.empty();
  const bool interior = run->algorithm() == Algorithm::kInteriorPoint;
  if (!arcs_can || interior || kinks || left || !attempt.realized || attempt.interrupted || run->IsOutOfIterations()) {
    return attempt;
  }
  if (attempt.converged) {
    if (!run->IsRefuted(attempt.trial)) return attempt;
  } else if (HasFriction(run->scene())) {
    return attempt;  // perhaps at a kink between slip and stick, which mending looks at from both sides
  }
  PlanAttempt last = TryByArcs(run, plan, {start.times, attempt.trial}, may_continue);
  last.jacobians += attempt.jacobians;
  const bool found = last.converged && last.realized && last.loss() <= attempt.loss() * (1 + kNoLoss);
  return found ? last : attempt;
}

// Continues from the optimum under exact flight along its impacts, which stay exact, to that with steps of the model.
SolveReport SolveUnderModel(const SolveRequest& request, const SolverOptions& options, Algorithm algorithm,
                            SolveReport exact) {
  exact.certificate = {};
  const auto give_up = [&](const std::string& why) {
    exact.reason = "in the exact motion, from which the solve starts: " + why;
    return exact;
  };
  if (exact.termination != Termination::kConverged) return give_up(exact.reason);
  Trial trial{exact.solution.control, exact.solution.durations, {}, exact.solution.initial_state};
  Scene scene = request.scene;
  scene.duration = DurationOf(trial);
  Simulate(scene, &trial);
  std::optional<Phases> phases = PhasesOf(scene, trial);
  if (!phases) {
    exact.termination = Termination::kNoProgress;
    return give_up("impacts are at the same time, or at the final time");
  }
  const std::unique_ptr<Simulator> flight = MakeSimulator(request.contact, request.scene, Precision::kDouble);
  for (int& steps : phases->steps) steps = std::max(1, steps / flight->traits().grid_steps);

  PhaseRun run(exact.solver, request, options);
  run.report().history.losses = exact.history.losses;
  run.report().work.evaluations = exact.work.evaluations;
  ContactSequence apart;
  for (const NoContact& pair : scene.no_contact) apart.push_back({pair.a, pair.b, pair.plane});
  const ScenePhases along(scene, phases->plan, WaypointsOf(scene), apart, flight.get());
  const std::vector<double> overlaps(phases->times.size());
  const auto transcription = along.Make(trial, phases->times, overlaps, phases->steps, /*margin=*/0);
  if (transcription == nullptr) {
    exact.termination = Termination::kFailed;
    return give_up("the steps of " + request.contact.name() + " have no motion");
  }
  AugmentedLagrangian::Options limits;
  limits.algorithm = algorithm;
  limits.iterations = std::max(1, options.limits.iterations - exact.work.iterations);
  limits.callback = [&](double cost) { return run.Record(cost); };
  const AugmentedLagrangian::Summary summary = transcription->Minimize(limits);
  run.report().work.evaluations += summary.jacobians;
  Trial found;
  along.TakeControl(*transcription, &found);
  const Termination termination = summary.interrupted ? Termination::kInterrupted
                                  : summary.converged ? Termination::kConverged
                                                      : Termination::kIterationLimit;
  SolveReport report =
      run.Finish(found, summary.cost, termination, "steps of " + request.contact.name() + " between exact impacts");
  report.solution.violation = summary.violation;  // under the contact model, which no exact run shows
  report.work.seconds += exact.work.seconds;
  return report;
}

const char* NameOf(Algorithm algorithm) { return algorithm == Algorithm::kInteriorPoint ? "ipopt" : "ceres_phases"; }

SolveReport SolveFrom(const SolveRequest& request, const SolverOptions& options, Algorithm algorithm, Trial start) {
  PhaseRun run(NameOf(algorithm), request, options, std::move(start));
  run.set_algorithm(algorithm);
  if (auto refused = run.StartFailure()) return *refused;
  SolveReport exact = UpdateBySteps(&run, request);
  return IsExact(request) ? exact : SolveUnderModel(request, options, algorithm, std::move(exact));
}

// Solves by least squares from a guess that misses a goal region. A bound is nothing to a step that does not expect to
// reach it, so that the first steps would lead to motions that have lost the goal: the first solve has a target in each
// region, and no limits, and the second begins at its optimum.
SolveReport SolveToRegions(const SolveRequest& request, const SolverOptions& options, const PhaseRun& run) {
  SolveRequest targets = request;
  targets.scene = ReplaceRegionsByTargets(request.scene);
  targets.scene.objective.limits.clear();
  PhaseRun run_to_targets("ceres_phases", targets, options, run.guess());
  if (auto refused = run_to_targets.StartFailure()) return *refused;
  const SolveReport first = UpdateBySteps(&run_to_targets, targets);
  SolveChain chain(options);
  chain.Add(first);
  Trial start = run.guess();
  if (first.solution.violation <= kFeasible) {
    start = {first.solution.control, first.solution.durations, {}, first.solution.initial_state};
    run.Simulate(&start);
  }
  const SolverOptions rest = chain.Next();
  SolveReport report = SolveFrom(request, rest, Algorithm::kLeastSquares, std::move(start));
  chain.Add(report);
  report = chain.Finish(std::move(report));
  report.guess.violation = run.ViolationOf(run.guess());
  return report;
}

}  // namespace

std::string UnsupportedByCeresPhases(const SolveRequest& request) {
  if (std::string reason = UnsupportedByPhases(request.scene); !reason.empty()) return reason;
  if (IsExact(request)) return "";
  if (!request.scene.objective.running.empty()) {
    return "running costs require exact flight (contact model event)";
  }
  const auto simulator = MakeSimulator(request.contact, request.scene, Precision::kDouble);
  const std::optional<VariableFreeFlight> over = simulator->FreeFlightOfLength(simulator->step());
  if (!over) {
    return request.contact.name() +
           " has no derivative of free flight by the length of a step, which is a variable here";
  }
  const bool turns = over->turn.pp != 0;  // linearly
  if (request.scene.num_torques() > 0 && !turns) {
    return request.contact.name() + " does not change rotations linearly, and some discs have a torque control";
  }
  return "";
}

std::string UnsupportedByInteriorPoint(const SolveRequest& request) {
  const std::string reason = ReasonNoInteriorPoint();
  return reason.empty() ? UnsupportedByCeresPhases(request) : reason;
}

SolveReport SolveByInteriorPoint(const SolveRequest& request, const SolverOptions& options) {
  return SolveByCeresPhases(request, options, Algorithm::kInteriorPoint);
}

SolveReport SolveByCeresPhases(const SolveRequest& request, const SolverOptions& options, Algorithm algorithm) {
  SolverOptions quiet = options;
  quiet.monitor.callback = nullptr;
  const PhaseRun run(NameOf(algorithm), request, quiet);
  const Trial& guess = run.guess();
  const bool misses = HasGoalRegion(request.scene) && guess.exact.ok && run.ViolationOf(guess) > kFeasible;
  return misses && algorithm == Algorithm::kLeastSquares ? SolveToRegions(request, options, run)
                                                         : SolveFrom(request, options, algorithm, guess);
}

bool HasGoalRegion(const Scene& scene) {
  return std::ranges::any_of(scene.objective.terminal,
                             [](const TerminalTerm& term) { return term.region.has_value(); });
}

Scene ReplaceRegionsByTargets(Scene scene) {
  for (TerminalTerm& term : scene.objective.terminal) {
    if (!term.region) continue;
    const Body& body = scene.bodies[term.body];
    // By quantity.
    const Vec2d starts[] = {body.position, body.velocity, {body.angle, 0.0}, {body.angular_velocity, 0.0}};
    term.target = term.region->Nearest(starts[static_cast<int>(term.quantity)]);
    const Vec2d middle = 0.5 * (term.region->min + term.region->max);
    for (int j = 0; j < 2; ++j) {
      if (std::isfinite(middle[j])) term.target[j] = middle[j];
    }
    if (term.IsRotational()) term.target[1] = 0;
    term.region.reset();
  }
  return scene;
}

SolveReport UpdateBySteps(PhaseRun* run, const SolveRequest& request) {
  const bool arcs_can = ArcsCanTake(request);
  return SolveWithSequenceUpdates(
      run, [&](const PhasePlan& plan, const PlanStart& start, const ContinuePredicate& may_continue) {
        return TryBySteps(run, arcs_can, plan, start, may_continue);
      });
}

}  // namespace saltus
