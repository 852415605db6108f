#include "solve/search/phase_search.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "control/control_bounds.h"
#include "scene/units.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_run.h"
#include "solve/search/mode_search.h"
#include "solve/search/search_solve.h"
#include "solve/search/search_starts.h"
#include "solve/search/sequence_search.h"
#include "solve/shooting/single_shooting_solvers.h"

namespace saltus {
namespace {

using Finding = FindingOf<Trial>;

// Constants of random starts, for searches by ceres_phases.
constexpr int kStarts = 8;  // at random
constexpr int kIntervalsOfStarts = 60;
constexpr double kPromising = 1.3;  // times the loss of an optimum, that of a start which may lead to a better one
constexpr size_t kMostSolves = 3;   // from such starts

// The problem without what closed arcs and shooting do not take; hard terms are costs.
Scene Relaxed(const Scene& given) {
  Scene scene = ReplaceRegionsByTargets(given);
  scene.control.max.clear();
  scene.control.max_norm.clear();
  scene.control.max_torque.clear();
  scene.no_contact.clear();
  scene.objective.running.clear();
  scene.objective.via.clear();
  scene.objective.duration.reset();
  for (TerminalTerm& term : scene.objective.terminal) {
    if (!term.hard) continue;
    term.hard = false;
    term.weight = 1;  // in natural units
  }
  scene.objective.limits.clear();
  return scene;
}

// The problem of a search, for SequenceSearch.
class DiscSearch {
 public:
  using Run = PhaseRun;
  static constexpr char kLeftOut[] = "neighbours far from a touch";

  DiscSearch(const PhaseRun& run, const SolveRequest& request) : run_(run), request_(request), scene_(run.scene()) {}

  RelaxedOptima<PhaseRun> SolveRelaxed(const SolverOptions& options) const {
    RelaxedOptima<PhaseRun> optima;
    SolveRequest relaxed{Relaxed(scene_), request_.contact};
    if (!UnsupportedByEventPhases(relaxed).empty()) return optima;
    const SolveReport found = SolveByModeSearch(relaxed, options);
    optima.evaluations = found.work.evaluations;
    if (found.searched) optima.work = found.searched->work;
    if (found.solution.control.empty()) return optima;
    Trial& trial = optima.best.emplace(Trial{found.solution.control, found.solution.durations, {}});
    if (trial.durations.empty()) trial.durations.assign(scene_.steps, scene_.dt());
    Simulate(scene_, &trial);
    optima.is_bound = !scene_.objective.duration && !HasGoalRegion(scene_);
    for (const LocalOptimum& other : found.optima) optima.others.emplace_back(other.loss, other.sequence);
    return optima;
  }

  std::optional<Trial> BeginAtRandom(std::uint64_t seed, int number) const {
    const std::optional<Scene> begun = saltus::BeginAtRandom(scene_, seed, number);
    if (!begun) return std::nullopt;
    Trial trial = GuessTrial(*begun);
    if (scene_.optimize != Optimize::kControl) trial.initial = InitialState(*begun);
    return trial;
  }

  std::vector<ContactSequence> NeighboursOf(const Trial& trial, bool* left_out) const {
    Scene scene = scene_;
    scene.duration = DurationOf(trial);
    return saltus::NeighboursOf(scene, trial, left_out);
  }

  Finding SolveAlong(Trial from, const SearchStartOf<Run>& start, double /*most_loss*/, SolverOptions options) const {
    options.sequences.given = start.sequence;
    Finding finding;
    PhaseRun run("mode_search", request_, options, run_.ClampToBounds(std::move(from)));
    if (auto refused = run.StartFailure()) {
      finding.report = std::move(*refused);
      return finding;
    }
    finding.report = UpdateBySteps(&run, request_);
    Trial& trial = finding.trial;
    trial.control = finding.report.solution.control;
    trial.durations = finding.report.solution.durations;
    if (scene_.optimize != Optimize::kControl) trial.initial = finding.report.solution.initial_state;
    Simulate(scene_, &trial);
    return finding;
  }

  // Whatever the constraints; but a start of ceres_phases keeps the bounds of components, on few intervals.
  int Shoot(SolverOptions options, Trial* trial, bool is_start = false) const {
    SolveRequest relaxed{Relaxed(BeginningAs(*trial, scene_)), request_.contact};
    if (is_start) {
      relaxed.scene.control.max = scene_.control.max;
      relaxed.scene.steps = std::min(scene_.steps, kIntervalsOfStarts);
    }
    options.limits.memory = run_.options().limits.memory;
    options.limits.impacts = kMostImpactsOfMotion;
    if (scene_.optimize == Optimize::kControl) options.guess = ControlGuess{trial->control, trial->durations};
    const SolveReport report = SolveByCeresLm(relaxed, options);
    if (report.history.losses.empty()) return report.work.evaluations;
    if (scene_.optimize == Optimize::kControl) {
      trial->control = report.solution.control;
      trial->durations.assign(relaxed.scene.steps, relaxed.scene.dt());
    } else {
      trial->initial = report.solution.initial_state;
    }
    Simulate(scene_, trial);
    return report.work.evaluations;
  }

  double WorkByRollout() const { return saltus::WorkByRollout(scene_); }
  double WorkBySteps() const { return saltus::WorkBySteps(scene_); }
  bool AllCostsAreSquares() const { return scene_.objective.IsSumOfSquares(); }
  double LossForUser(double loss) const { return ConvertLoss(loss, scene_.units, {}); }
  LocalOptimum OptimumOf(const Trial& trial) const {
    LocalOptimum found{trial.exact.contacts, trial.exact.loss, {}};
    for (const Event& event : trial.exact.events) found.times.push_back(event.time);
    return found;
  }

 private:
  const PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
};

// Returns random motions, after shooting within the bounds, whose merit is below `most`; best first.
std::vector<Trial> PromisingStarts(const DiscSearch& search, const PhaseRun& run, double most) {
  SolverOptions own;
  own.monitor.stop = run.options().monitor.stop;
  own.limits.iterations = sequence_search::kIterationsShooting;
  std::vector<Trial> starts;
  for (int i = 0; i < kStarts && !(own.monitor.stop && own.monitor.stop()); ++i) {
    std::optional<Trial> start = search.BeginAtRandom(SearchOptions{}.seed, i);
    if (!start) break;
    search.Shoot(own, &*start, /*is_start=*/true);
    if (run.MeritOf(*start) < most) starts.push_back(std::move(*start));
  }
  std::ranges::stable_sort(starts, {}, [&](const Trial& start) { return run.MeritOf(start); });
  return starts;
}

// Whether a report is better than another; constraints come before losses.
bool IsBetter(const SolveReport& report, const SolveReport& than) {
  const bool mine = report.solution.violation <= kFeasible, other = than.solution.violation <= kFeasible;
  if (!mine || !other) return mine || (!other && report.solution.violation < than.solution.violation);
  return report.solution.loss < than.solution.loss - kSameOptimum * std::abs(than.solution.loss);
}

}  // namespace

SolveReport SolveByPhasesFromStarts(const SolveRequest& request, const SolverOptions& options) {
  const auto begin = std::chrono::steady_clock::now();
  const SolveReport first = SolveByCeresPhases(request, options);
  const bool given = !options.sequences.search || options.sequences.given || options.guess;
  bool interrupted = first.termination == Termination::kInterrupted;
  if (given || interrupted || first.solution.control.empty() || first.work.iterations >= options.limits.iterations) {
    return first;
  }
  if (!request.scene.control.IsBounded() || AllPairs(request.scene).empty()) return first;

  SolverOptions own = options;
  own.monitor.callback = nullptr;
  const PhaseRun run("ceres_phases", request, own);
  Trial end{first.solution.control, first.solution.durations, {}, first.solution.initial_state};
  run.Simulate(&end);
  std::vector<ContactSequence> tried = {end.exact.contacts};
  SolveReport best = first;
  int iterations = first.work.iterations;
  for (const Trial& start : PromisingStarts(DiscSearch(run, request), run, kPromising * run.MeritOf(end))) {
    if (interrupted || iterations >= options.limits.iterations || tried.size() > kMostSolves) break;
    if (std::ranges::count(tried, start.exact.contacts) > 0) continue;
    tried.push_back(start.exact.contacts);
    SolverOptions from = own;
    from.guess = ControlGuess{start.control, start.durations};
    from.limits.iterations = options.limits.iterations - iterations;
    if (options.monitor.callback) {
      from.monitor.callback = [&](int iteration, double loss) {
        return options.monitor.callback(iterations + iteration, loss);
      };
    }
    SolveReport found = SolveByCeresPhases(request, from);
    iterations += found.work.iterations;
    interrupted = found.termination == Termination::kInterrupted;
    if (found.history.losses.empty() || !IsBetter(found, best)) continue;
    best = std::move(found);
    best.reason = "from a random start" + (best.reason.empty() ? "" : "; " + best.reason);
  }
  if (interrupted || (options.monitor.stop && options.monitor.stop())) best.termination = Termination::kInterrupted;
  best.guess.loss = best.history.losses.front() = first.guess.loss;
  best.guess.violation = first.guess.violation;
  best.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return best;
}

SolveReport SearchByPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("mode_search", request, options);
  if (auto refused = run.MotionFailure()) return *refused;
  return SequenceSearch(&run, DiscSearch(run, request)).Search();
}

}  // namespace saltus
