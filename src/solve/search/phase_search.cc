#include "solve/search/phase_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "control/control_bounds.h"
#include "saltus/control/objective.h"
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

// The problem without what closed arcs and shooting do not take; hard terms are costs.
Scene Relaxed(Scene scene) {
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
  return scene;
}

// What is searched, for SequenceSearch.
class DiscSearch {
 public:
  using Run = PhaseRun;
  static constexpr char kLeftOut[] = "neighbours far from a touch";

  DiscSearch(const PhaseRun& run, const SolveRequest& request) : run_(run), request_(request), scene_(run.scene()) {}

  RelaxedOptima<PhaseRun> SolveRelaxed(const SolverOptions& options) const {
    RelaxedOptima<PhaseRun> optima;
    SolveRequest relaxed{Relaxed(scene_), request_.contact};
    if (!WhyNotEventPhases(relaxed).empty()) return optima;
    const SolveReport found = SolveByModeSearch(relaxed, options);
    optima.evaluations = found.evaluations;
    if (found.searched) optima.work = found.searched->work;
    if (found.control.empty()) return optima;
    Trial& trial = optima.best.emplace(Trial{found.control, found.durations, {}, {}});
    if (trial.durations.empty()) trial.durations.assign(scene_.steps, scene_.dt());
    Simulate(scene_, request_.terms, &trial);
    optima.is_bound = !scene_.objective.duration;
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

  Finding SolveAlong(Trial from, const std::optional<ContactSequence>& sequence, SolverOptions options) const {
    options.sequence = sequence;
    Finding finding;
    PhaseRun run("mode_search", request_, options, run_.WithinBounds(std::move(from)));
    if (auto refused = run.WhyNotStart()) {
      finding.report = std::move(*refused);
      return finding;
    }
    finding.report = MendBySteps(&run, request_);
    Trial& trial = finding.trial;
    trial.control = finding.report.control;
    trial.durations = finding.report.durations;
    if (scene_.optimize != Optimize::kControl) trial.initial = finding.report.initial_state;
    Simulate(scene_, request_.terms, &trial);
    return finding;
  }

  // Whatever the constraints.
  int Shoot(SolverOptions options, Trial* trial) const {
    SolveRequest relaxed{Relaxed(BeginningAs(*trial, scene_)), request_.contact};
    options.memory_limit = run_.options().memory_limit;
    options.most_impacts = kMostImpactsOfMotion;
    if (scene_.optimize == Optimize::kControl) options.guess = ControlGuess{trial->control, trial->durations};
    const SolveReport report = SolveByCeresLm(relaxed, options);
    if (report.losses.empty()) return report.evaluations;
    if (scene_.optimize == Optimize::kControl) {
      trial->control = report.control;
      trial->durations.assign(scene_.steps, scene_.dt());
    } else {
      trial->initial = report.initial_state;
    }
    Simulate(scene_, request_.terms, trial);
    return report.evaluations;
  }

  double WorkByRollout() const { return saltus::WorkByRollout(scene_); }
  double WorkBySteps() const { return saltus::WorkBySteps(scene_); }
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

}  // namespace

SolveReport SearchByPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("mode_search", request, options);
  if (auto refused = run.WhyNoMotion()) return *refused;
  return SequenceSearch(&run, DiscSearch(run, request)).Search();
}

}  // namespace saltus
