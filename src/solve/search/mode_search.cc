#include "solve/search/mode_search.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "control/control_bounds.h"
#include "scene/units.h"
#include "solve/control_guess.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_attempt.h"
#include "solve/phases/phase_run.h"
#include "solve/phases/sequence_update.h"
#include "solve/search/loss_bound.h"
#include "solve/search/search_starts.h"
#include "solve/search/sequence_search.h"
#include "solve/shooting/single_shooting_solvers.h"

namespace saltus {
namespace {

using Finding = FindingOf<Trial>;
using Start = SearchStartOf<PhaseRun>;

constexpr int kStartsOfSequence = 3;  // motions from which a sequence is tried, along closed arcs
constexpr int kFewIntervals = 48;     // of a coarse control, at least
constexpr double kLossChange = 0.02;  // relative, in the last steps of a solve that shares intervals
constexpr double kShareGain = 1e-7;   // relative: of the loss, for which intervals change their phase

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

// Returns the number of the scene's intervals in one interval of a coarse control.
int IntervalsInOne(int steps) {
  int number = std::max(1, steps / kFewIntervals);
  while (steps % number != 0) --number;
  return number;
}

// The work of one gradient or Jacobian in microseconds, as measured on the problems and on generated ones: by a
// rollout; along so many impacts in closed arcs; with a cost for every step.
double WorkByRollout(const Scene& scene) { return 10 + 0.02 * scene.steps * scene.num_bodies(); }

double WorkByArcs(const Scene& scene, size_t impacts) {
  const double arcs = static_cast<double>(impacts) + 1;
  return 20 + 2 * arcs * arcs * scene.num_bodies();
}

double WorkBySteps(const Scene& scene) {
  const double each = scene.optimize == Optimize::kControl ? 2 : 0.15;  // without forces there is less to solve for
  return 20 + each * scene.steps * scene.num_bodies();
}

// The gap at a new impact, by how far from a touch its pair would be.
double GapAt(const Scene& scene, const Candidate& c, const EventPhases::State& x) {
  const double distance = SeparationOf(scene, c, x.p).distance - scene.bodies[c.a].radius;
  return c.plane ? distance : distance - scene.bodies[c.b].radius;
}

// The sequences that differ from that of `trial` by one impact inserted, removed or replaced by one of another pair: at
// most so many, first of all removals, then those whose new pair comes nearest to a touch. Precondition: impacts only.
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

// The problem of a search, for SequenceSearch.
class DiscSearch {
 public:
  using Run = PhaseRun;
  static constexpr char kLeftOut[] = "neighbours far from a touch";
  static constexpr char kEndOfDescent[] =
      "the best motion is the end of a descent, and no sequence tried has its optimum there: let the search do more "
      "work and more random starts, or start from this control";

  DiscSearch(const PhaseRun& run, const SolveRequest& request) : run_(run), request_(request), scene_(run.scene()) {
    if (NonTerminalFeatures(scene_).empty() && UnsupportedByEventPhases(request).empty()) bound_.emplace(scene_);
  }

  // Without constraints any motion may be returned, whatever its contacts.
  double MeritOf(const Trial& trial) const {
    return by_arcs() && trial.exact.ok ? trial.exact.loss : run_.MeritOf(trial);
  }
  double ViolationOf(const Trial& trial) const { return by_arcs() && trial.exact.ok ? 0 : run_.ViolationOf(trial); }

  RelaxedOptima<PhaseRun> SolveRelaxed(const SolverOptions& options) const {
    RelaxedOptima<PhaseRun> optima;
    if (by_arcs()) return optima;
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

  std::optional<Trial> BeginAround(const Trial& best, std::uint64_t seed, int number) const {
    if (scene_.optimize != Optimize::kControl) return std::nullopt;
    const ControlGuess guess{best.control, best.durations};
    return Trial{ControlAround(scene_, guess, seed, number), best.durations, {}};
  }

  std::vector<ContactSequence> NeighboursOf(const Trial& trial, bool* left_out) const {
    Scene scene = scene_;
    scene.duration = DurationOf(trial);
    return saltus::NeighboursOf(scene, trial, left_out);
  }

  Finding SolveFrom(Trial from, const Start& start, double most_loss, SolverOptions options) const {
    options.sequences.given = start.sequence;
    Finding finding;
    PhaseRun run("mode_search", request_, options, run_.ClampToBounds(std::move(from)));
    if (auto refused = run.StartFailure()) {
      finding.report = std::move(*refused);
      if (start.shooting != Shooting::kNone) finding.report.reason = kEndOfDescent;
      finding.trial = run.guess();
      return finding;
    }
    if (by_arcs() && start.shooting != Shooting::kNone && !start.is_guess) run.set_one_of_many(most_loss);
    run.set_certifies(start.certifies || start.effort == Start::Effort::kShare);
    const TryPlan solve_plan = [&](const PhasePlan& plan, const PlanStart& at, const ContinuePredicate& may_continue) {
      const bool arcs = by_arcs() && !plan.HasTies() && !plan.HasRegimes() && plan.apart.empty();
      PlanAttempt attempt = TryByArcs(&run, plan, at, may_continue);
      finding.work += attempt.jacobians * (arcs ? WorkByArcs(scene_, plan.cuts.size()) : WorkBySteps(scene_));
      const ExactRun& met = attempt.trial.exact;
      if (start.sequence && attempt.valid && met.ok && met.only_impacts && met.contacts != *start.sequence) {
        finding.strayed = attempt.trial;
      }
      return attempt;
    };
    if (start.effort == Start::Effort::kShare) {
      finding.report = Share(&run);
    } else if (by_arcs() && start.effort == Start::Effort::kUsual) {
      finding.report = SolveWithSequenceUpdates(&run, solve_plan);
    } else {
      finding.report = UpdateBySteps(&run, request_);
      finding.work = finding.report.work.evaluations * WorkBySteps(scene_);
    }
    Trial& trial = finding.trial;
    trial.control = finding.report.solution.control;
    trial.durations = finding.report.solution.durations;
    if (scene_.optimize != Optimize::kControl) trial.initial = finding.report.solution.initial_state;
    Simulate(scene_, &trial);
    return finding;
  }

  // Whatever the constraints.
  int Shoot(SolverOptions options, const Start& start, Trial* trial) const {
    SolveRequest relaxed{Relaxed(BeginningAs(*trial, scene_)), request_.contact};
    const bool is_coarse = start.is_more && scene_.control_width() > 0;
    if (is_coarse) relaxed.scene.steps /= IntervalsInOne(scene_.steps);
    const int gradients = Shoot(relaxed, options, start.shooting, trial);
    if (is_coarse) {
      trial->control = MeanOverSteps({trial->control, {}}, scene_.control_width(), scene_.steps);
      trial->durations.assign(scene_.steps, scene_.dt());
      Simulate(scene_, trial);
    }
    return gradients;
  }
  int Shoot(const SolveRequest& relaxed, SolverOptions options, Shooting shooting, Trial* trial) const {
    options.limits.memory = run_.options().limits.memory;
    options.limits.impacts = kMostImpactsOfMotion;
    options.descent = run_.options().descent;
    const UnitFactors to(Units{}, scene_.units);  // the rate is N^2 per unit of the loss
    options.descent.learning_rate *= to.force * to.force / to.loss;
    if (options.descent.rate_per_time) options.descent.learning_rate *= to.time;
    if (scene_.optimize == Optimize::kControl) options.guess = ControlGuess{trial->control, trial->durations};
    SolveReport report =
        shooting == Shooting::kDescent ? SolveByGradientDescent(relaxed, options) : SolveByCeresLm(relaxed, options);
    if (report.history.losses.empty()) return report.work.evaluations;
    if (scene_.optimize == Optimize::kControl) {
      const auto& best = report.history.best;
      const bool has_best = best && !best->solution.control.empty();
      trial->control = has_best ? best->solution.control : report.solution.control;
      trial->durations.assign(relaxed.scene.steps, relaxed.scene.dt());
    } else {
      trial->initial = report.solution.initial_state;
    }
    Simulate(scene_, trial);
    return report.work.evaluations;
  }

  bool by_arcs() const { return bound_.has_value(); }
  double WorkByRollout() const { return saltus::WorkByRollout(scene_); }
  double WorkOf(const Trial& from, const Start& start) const {
    if (!by_arcs() || start.effort == Start::Effort::kThorough) return WorkBySteps(scene_);
    return WorkByArcs(scene_, start.sequence ? start.sequence->size() : from.exact.contacts.size());
  }
  int starts_of_sequence() const { return by_arcs() ? kStartsOfSequence : 1; }
  bool LacksEvents(const Trial& trial) const {
    return std::ranges::any_of(AllPairs(scene_),
                               [&](const Candidate& c) { return std::ranges::count(trial.exact.contacts, c) == 0; });
  }
  bool starts_are_cheap() const { return true; }
  double long_work() const { return by_arcs() ? sequence_search::kLongWork : INFINITY; }
  bool descends_from_guess() const { return by_arcs(); }
  double lowest_loss() const { return by_arcs() ? bound_->lowest() : 0; }
  double LowestAlong(const ContactSequence& sequence) const {
    return by_arcs() ? bound_->BoundAlongSequence(sequence) : 0;
  }
  bool AllCostsAreSquares() const { return scene_.objective.IsSumOfSquares(); }
  double LossForUser(double loss) const { return ConvertLoss(loss, scene_.units, {}); }
  LocalOptimum OptimumOf(const Trial& trial) const {
    LocalOptimum found{trial.exact.contacts, trial.exact.loss, {}};
    for (const Event& event : trial.exact.events) found.times.push_back(event.time);
    return found;
  }

 private:
  // Solves along the sequence of the motion that a run begins with, with intervals moved between its phases.
  SolveReport Share(PhaseRun* run) const {
    const Trial& from = run->guess();
    const ContactSequence& sequence = *run->given_sequence();
    PhaseMinimumOptions options;
    options.iterations = run->options().limits.iterations;
    options.callback = [stop = run->options().monitor.stop](double) { return !stop || !stop(); };
    PhaseSolution shared =
        SolveAlong(scene_, sequence, GuessFrom(scene_, FlightOf(scene_, from), sequence), options, kLossChange);
    const auto is_motion = [&] { return shared.attempt.valid && shared.attempt.trial.exact.ok; };
    if (is_motion()) shared = ShareBetter(scene_, std::move(shared), options, kShareGain);
    PhasePlan plan;
    plan.cuts.assign(sequence.begin(), sequence.end());
    plan.tied.resize(sequence.size());
    plan.regimes.resize(sequence.size());
    PlanAttempt& attempt = shared.attempt;
    PolishByTranscription(
        run, plan, shared.intervals, [](const auto& /*times*/, const auto& /*speeds*/) { return true; }, &attempt);
    run->report().work.evaluations = attempt.jacobians;
    const ExactRun& exact = attempt.trial.exact;
    if (!attempt.valid || !exact.ok) return run->Finish(from, from.exact.loss, Termination::kNoProgress);
    if (attempt.converged && attempt.realized && !run->IsRefuted(attempt.trial)) {
      run->report().certificate = run->Certify(attempt.trial);
      return run->Finish(attempt.trial, exact.loss, Termination::kConverged);
    }
    return run->Finish(attempt.trial,
                       exact.loss,
                       Termination::kNoProgress,
                       ReasonNotOptimal(scene_, sequence, shared.minimum.touches, exact));
  }

  const PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
  std::optional<LossBound> bound_;  // where closed arcs take the problem
};

// Returns random motions, after shooting within the bounds, whose merit is below `most`; best first.
std::vector<Trial> PromisingStarts(const PhaseRun& run, const SolveRequest& request, double most) {
  const DiscSearch search(run, request);
  SolverOptions own;
  own.monitor.stop = run.options().monitor.stop;
  own.limits.iterations = sequence_search::kIterationsShooting;
  std::vector<Trial> starts;
  for (int i = 0; i < kStarts && !(own.monitor.stop && own.monitor.stop()); ++i) {
    std::optional<Trial> start = search.BeginAtRandom(SearchOptions{}.seed, i);
    if (!start) break;
    SolveRequest bounded{Relaxed(BeginningAs(*start, run.scene())), request.contact};
    bounded.scene.control.max = run.scene().control.max;
    bounded.scene.steps = std::min(run.scene().steps, kIntervalsOfStarts);
    search.Shoot(bounded, own, Shooting::kLeastSquares, &*start);
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
  for (const Trial& start : PromisingStarts(run, request, kPromising * run.MeritOf(end))) {
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

std::string UnsupportedByModeSearch(const SolveRequest& request) {
  return IsExact(request) ? UnsupportedByCeresPhases(request) : UnsupportedByEventPhases(request);
}

SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("mode_search", request, options);
  if (auto refused = run.MotionFailure()) return *refused;
  return SequenceSearch(&run, DiscSearch(run, request)).Search();
}

}  // namespace saltus
