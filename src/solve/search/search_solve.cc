#include "solve/search/search_solve.h"

#include <algorithm>
#include <utility>

#include "scene/units.h"
#include "solve/control_guess.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/phase_attempt.h"
#include "solve/phases/sequence_update.h"
#include "solve/search/sequence_search.h"
#include "solve/shooting/single_shooting_solvers.h"

namespace saltus {
namespace {

constexpr int kIterationsAlong = 80;  // of Ceres, along one sequence
constexpr int kIterationsMending = 1000;
constexpr double kLossChange = 0.02;  // relative, in the last steps of a solve
constexpr int kFewIntervals = 48;     // of a coarse control, at least
constexpr double kShareGain = 1e-7;   // relative: of the loss, for which intervals change their phase

void Certify(const Scene& scene, SearchFinding* finding) {
  if (!finding->certificate) finding->certificate = CertifyTrial(scene, finding->trial);
  if (!finding->certificate->IsSaddle()) return;
  finding->aside = SearchBothSides(scene, finding->trial, finding->certificate->curvature->direction);
  finding->optimal = finding->aside.empty();
}

SearchFinding SolveAlongSequence(const Scene& scene, const SolverOptions& options, const SearchTask& task) {
  PhaseMinimumOptions phase_options;
  const double each = WorkByArcs(scene, task.sequence.size());
  phase_options.iterations = IterationsWithin(task.most_work, each, kIterationsAlong);
  phase_options.callback = [&](double) { return !options.monitor.stop || !options.monitor.stop(); };
  const bool shares = task.kind == SearchTask::Kind::kShare;
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, *task.from), task.sequence);
  PhaseSolution solution = SolveAlong(scene, task.sequence, guess, phase_options, kLossChange);
  if (shares && solution.valid && solution.trial.exact.ok) {
    solution = ShareBetter(scene, std::move(solution), phase_options, kShareGain);
  }
  SearchFinding finding;
  finding.jacobians = solution.minimum.jacobians;
  finding.work = each * finding.jacobians;
  if (!solution.valid || !solution.trial.exact.ok) return finding;
  finding.optimal = solution.optimal();
  if (!finding.optimal) {
    finding.remark = ReasonNotOptimal(scene, task.sequence, solution.minimum.touches, solution.trial.exact);
  }
  finding.trial = std::move(solution.trial);
  if (finding.optimal) Certify(scene, &finding);
  return finding;
}

SearchFinding UpdateBy(const TryPlan* by_steps, PhaseRun* run) {
  const Scene& scene = run->scene();
  SolveReport report = by_steps != nullptr ? SolveWithSequenceUpdates(run, *by_steps) : UpdateByArcs(run);
  SearchFinding finding;
  finding.jacobians = report.work.evaluations;
  finding.trial.control = std::move(report.solution.control);
  finding.trial.durations = std::move(report.solution.durations);
  Simulate(scene, &finding.trial);
  const size_t impacts = run->guess().exact.contacts.size();
  finding.work = finding.jacobians * (by_steps != nullptr ? WorkBySteps(scene) : WorkByArcs(scene, impacts));
  finding.remark = std::move(report.reason);
  finding.certificate = std::move(report.certificate);
  finding.optimal = report.termination == Termination::kConverged &&
                    !(finding.certificate && finding.certificate->verdict == Certificate::Verdict::kNotStationary);
  if (finding.optimal) Certify(scene, &finding);
  return finding;
}

// Solves by arcs, which are cheap; where they find no optimum, by the transcription with a cost for every step.
SearchFinding UpdateSequence(const SolveRequest& request, const SolverOptions& options, const SearchTask& task) {
  const Trial& from = *task.from;
  SolverOptions own;
  const double by_arcs = WorkByArcs(request.scene, from.exact.contacts.size());
  own.limits.iterations = IterationsWithin(task.most_work, by_arcs, kIterationsMending);
  own.monitor.stop = options.monitor.stop;
  PhaseRun arcs("mode_search", request, own, from);
  SearchFinding finding = UpdateBy(nullptr, &arcs);
  if (finding.optimal || !finding.trial.exact.ok || !finding.trial.exact.only_impacts) return finding;
  own.limits.iterations =
      IterationsWithin(task.most_work - finding.work, WorkBySteps(request.scene), kIterationsMending);
  PhaseRun steps("mode_search", request, own, finding.trial.exact.loss < from.exact.loss ? finding.trial : from);
  const TryPlan by_steps = [&](const PhasePlan& plan, const PlanStart& start, const ContinuePredicate& may_continue) {
    return TryByTranscription(&steps, plan, start, may_continue);
  };
  SearchFinding last = UpdateBy(&by_steps, &steps);
  last.jacobians += finding.jacobians;
  last.work += finding.work;
  return last.trial.exact.ok ? last : finding;
}

// Returns the number of the scene's intervals in one interval of a coarse control.
int IntervalsInOne(int steps) {
  int number = std::max(1, steps / kFewIntervals);
  while (steps % number != 0) --number;
  return number;
}

// Solves by solvers without sequences; solvers along sequences continue from where they end.
SearchFinding Shoot(SolveRequest request, const SolverOptions& options, const SearchTask& task) {
  Scene& scene = request.scene;
  const bool given = task.from == nullptr && scene.control.initial == task.forces;
  SolverOptions own;
  if (task.from != nullptr) {
    own.guess = ControlGuess{task.from->control, task.from->durations};
  } else {
    scene.control.initial = task.forces;
  }
  own.monitor.stop = options.monitor.stop;
  own.limits.memory = options.limits.memory;
  own.limits.impacts = kMostImpactsOfMotion;
  const int steps = scene.steps;
  if (task.coarse) scene.steps /= IntervalsInOne(steps);
  SolveReport report;
  if (task.kind == SearchTask::Kind::kShoot) {
    own.limits.iterations = IterationsWithin(
        task.most_work, WorkByRollout(scene), given ? options.limits.iterations : sequence_search::kIterationsShooting);
    report = SolveByCeresLm(request, own);
  } else {
    const UnitFactors to(Units{}, scene.units);  // the rate is N^2 per unit of the loss
    own.descent.learning_rate = options.descent.learning_rate * to.force * to.force / to.loss;
    own.descent.rate_per_time = options.descent.rate_per_time;
    if (own.descent.rate_per_time) own.descent.learning_rate *= to.time;
    own.limits.iterations = IterationsWithin(task.most_work, WorkByRollout(scene), options.limits.iterations);
    report = SolveByGradientDescent(request, own);
  }
  if (report.history.best && !report.history.best->solution.control.empty()) {
    report.solution.control = std::move(report.history.best->solution.control);
  }
  SearchFinding finding;
  finding.jacobians = report.work.evaluations;
  finding.work = finding.jacobians * WorkByRollout(scene);
  finding.remark =
      "the best motion is the end of a descent, and no sequence tried has its optimum there: let the search do more "
      "work "
      "and more random starts, or start from this control";
  if (report.solution.control.empty()) return finding;
  scene.steps = steps;
  finding.trial.control = MeanOverSteps({std::move(report.solution.control), {}}, scene.control_width(), steps);
  finding.trial.durations.assign(steps, scene.dt());
  Simulate(scene, &finding.trial);
  return finding;
}

// The gap at a new impact, by how far from a touch its pair would be.
double GapAt(const Scene& scene, const Candidate& c, const EventPhases::State& x) {
  const double distance = SeparationOf(scene, c, x.p).distance - scene.bodies[c.a].radius;
  return c.plane ? distance : distance - scene.bodies[c.b].radius;
}

}  // namespace

// The work in microseconds, as measured on the problems and on generated ones.
double WorkByRollout(const Scene& scene) { return 10 + 0.02 * scene.steps * scene.num_bodies(); }

double WorkByArcs(const Scene& scene, size_t impacts) {
  const double arcs = static_cast<double>(impacts) + 1;
  return 20 + 2 * arcs * arcs * scene.num_bodies();
}

double WorkBySteps(const Scene& scene) {
  const double each = scene.optimize == Optimize::kControl ? 2 : 0.15;  // without forces there is less to solve for
  return 20 + each * scene.steps * scene.num_bodies();
}

SearchFinding SolveTask(const SolveRequest& request, const SolverOptions& options, const SearchTask& task) {
  switch (task.kind) {
    case SearchTask::Kind::kAlong:
    case SearchTask::Kind::kShare:
      return SolveAlongSequence(request.scene, options, task);
    case SearchTask::Kind::kMend:
      return UpdateSequence(request, options, task);
    case SearchTask::Kind::kShoot:
    case SearchTask::Kind::kDescend:
      return Shoot(request, options, task);
  }
  return {};
}

std::vector<ContactSequence> NeighboursOf(const Scene& scene, const Trial& trial, bool* left_out) {
  const ContactSequence& sequence = trial.exact.contacts;
  const ContactSequence pairs = AllPairs(scene);
  std::vector<ContactSequence> neighbours;
  for (size_t i = 0; i < sequence.size(); ++i) {
    neighbours.push_back(sequence);
    neighbours.back().erase(neighbours.back().begin() + i);
  }
  const size_t removals = neighbours.size();
  std::vector<size_t> places(removals);  // of the new impact
  for (const bool replaces : {false, true}) {
    for (size_t i = 0; i + replaces <= sequence.size(); ++i) {
      for (const Candidate& pair : pairs) {
        if (replaces && pair == sequence[i]) continue;
        neighbours.push_back(sequence);
        places.push_back(i);
        if (replaces) {
          neighbours.back()[i] = pair;
        } else {
          neighbours.back().insert(neighbours.back().begin() + i, pair);
        }
      }
    }
  }
  *left_out = neighbours.size() > sequence_search::kMostNeighbours;
  if (!*left_out) return neighbours;
  const Flight flight = FlightOf(scene, trial);
  std::vector<std::pair<double, size_t>> order;  // by gap
  for (size_t n = 0; n < neighbours.size(); ++n) {
    double gap = 0;
    if (n >= removals) {
      const PhaseGuess guess = GuessFrom(scene, flight, neighbours[n]);
      gap = std::max(0.0, GapAt(scene, neighbours[n][places[n]], guess.before[places[n]]));
    }
    order.push_back({gap, n});
  }
  std::sort(order.begin(), order.end());
  std::vector<ContactSequence> nearest;
  for (size_t n = 0; n < sequence_search::kMostNeighbours; ++n) {
    nearest.push_back(std::move(neighbours[order[n].second]));
  }
  return nearest;
}

}  // namespace saltus
