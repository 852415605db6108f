#include "phase_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "ceres_lm.h"
#include "ceres_phases.h"
#include "control/control_bounds.h"
#include "control/parallel_for.h"
#include "mode_search.h"
#include "motion_merit.h"
#include "phase_plan.h"
#include "phase_run.h"
#include "physics/units.h"
#include "saltus/control/objective.h"
#include "search_solve.h"
#include "search_starts.h"
#include "task_line.h"

namespace saltus {
namespace {

constexpr int kIterationsMending = 1000;
constexpr int kIterationsAlong = 300;     // of a neighbour, which begins near an optimum
constexpr int kIterationsShooting = 30;   // from starts of its own
constexpr double kShareRelaxed = 0.3;     // of the time, for the problem without constraints
constexpr size_t kMostRelaxedOptima = 8;  // whose sequences are tried
constexpr double kSameLoss = 1e-6;        // relative: the same optimum of a sequence

// Where a solve begins: a motion, or what is to be made one by ceres_lm; along a sequence, or that of the motion.
struct Start {
  Trial trial;
  bool shoot = false;
  std::optional<ContactSequence> sequence = std::nullopt;
};

struct Finding {
  Trial trial;
  SolveReport report;
};

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

class PhaseSearch {
 public:
  PhaseSearch(PhaseRun* run, const SolveRequest& request)
      : run_(*run), request_(request), scene_(run->scene()), options_(run->options()) {
    options_.stop = StopAfter(options_.search_options.seconds, run->options().stop);
    searched_.complete = true;
  }

  SolveReport Search() {
    SolveAll({{run_.guess(), false, run_.options().sequence}});
    if (!options_.search) return Report();
    std::vector<Start> along;
    SolveAll(FirstStarts(&along));
    SolveAll(std::move(along));
    while (!end_ && best_) {
      std::vector<Start> neighbours = NeighboursOfBest();
      if (neighbours.empty()) break;
      SolveAll(std::move(neighbours));
    }
    return Report();
  }

 private:
  // What a limit ends.
  enum class End { kInterrupt, kTime, kIterations };

  bool Stopped() const { return options_.stop && options_.stop(); }
  double BestLoss() const { return best_ ? best_->trial.exact.loss : run_.report().losses.front(); }

  void Leave(const std::string& why) {
    searched_.complete = false;
    if (left_.find(why) == std::string::npos) left_ += (left_.empty() ? "" : ", ") + why;
  }

  // ----------------------------------------------------------------------------------------------------------- starts

  std::vector<Start> FirstStarts(std::vector<Start>* along) {
    std::vector<Start> starts;
    SearchRelaxed(&starts, along);
    const SearchOptions& search = options_.search_options;
    for (int i = 0; i < search.starts; ++i) {
      const std::optional<Scene> begun = BeginAtRandom(scene_, search.seed, i);
      if (!begun) break;
      Trial trial = GuessTrial(*begun);
      if (scene_.optimize != Optimize::kControl) trial.initial = InitialState(*begun);
      starts.push_back({std::move(trial), true});
    }
    searched_.starts = 1 + static_cast<int>(starts.size());
    return starts;
  }

  void SearchRelaxed(std::vector<Start>* starts, std::vector<Start>* along) {
    SolveRequest relaxed{Relaxed(scene_), request_.contact};
    if (end_ || !WhyNotEventPhases(relaxed).empty()) return;
    SolverOptions own = options_;
    own.callback = nullptr;
    own.status = nullptr;
    own.sequence.reset();
    own.guess.reset();
    own.search_options.seconds *= kShareRelaxed;
    const SolveReport found = SolveByModeSearch(relaxed, own);
    run_.report().evaluations += found.evaluations;
    if (found.control.empty()) return;
    Trial trial{found.control, found.durations, {}, {}};
    if (trial.durations.empty()) trial.durations.assign(scene_.steps, scene_.dt());
    Simulate(scene_, request_.terms, &trial);
    starts->push_back({trial, false});
    // What is left out only makes them dearer, but for a free duration: those that are dearer already are no use.
    const bool prunes = best_ && !scene_.objective.duration;
    for (const LocalOptimum& other : found.optima) {
      if (along->size() == kMostRelaxedOptima || (prunes && !(other.loss < BestLoss()))) break;
      if (other.sequence != trial.exact.contacts) along->push_back({trial, false, other.sequence});
    }
  }

  std::vector<Start> NeighboursOfBest() {
    const Trial& trial = best_->trial;
    if (!trial.exact.only_impacts || std::count(expanded_.begin(), expanded_.end(), trial.exact.contacts) > 0)
      return {};
    expanded_.push_back(trial.exact.contacts);
    Scene scene = scene_;
    scene.duration = DurationOf(trial);
    bool left_out = false;
    std::vector<Start> starts;
    for (ContactSequence& next : NeighboursOf(scene, trial, &left_out)) {
      if (std::count(tried_.begin(), tried_.end(), next) > 0) continue;
      starts.push_back({trial, false, std::move(next)});
    }
    if (left_out) Leave("neighbours far from a touch");
    return starts;
  }

  // ----------------------------------------------------------------------------------------------------------- solves

  void SolveAll(const std::vector<Start>& starts) {
    auto next = starts.begin();
    TaskLine<const Start*, Finding> line;
    line.draw = [&]() -> std::optional<const Start*> {
      if (Stopped()) EndByStop();
      if (end_ || next == starts.end()) return std::nullopt;
      if (drawn_++ < options_.iterations) return &*next++;
      end_ = End::kIterations;
      return std::nullopt;
    };
    line.solve = [this](const Start* start) { return Stopped() ? Finding{} : SolveFrom(*start); };
    line.look = [this](const Start* start, Finding finding) {
      if (finding.report.solver.empty()) return EndByStop();  // not begun
      if (start->sequence) tried_.push_back(*start->sequence);
      Look(std::move(finding));
      if (!run_.Record(BestLoss())) end_ = End::kInterrupt;
    };
    line.WorkOff(NumThreads(options_.threads));
    if (Stopped()) EndByStop();
  }

  void EndByStop() {
    const StopRequest& interrupt = run_.options().stop;
    end_ = interrupt && interrupt() ? End::kInterrupt : End::kTime;
  }

  Finding SolveFrom(const Start& start) const {
    SolverOptions own;
    own.stop = options_.stop;
    own.sequence = start.sequence;
    own.search = options_.search;
    own.iterations = start.sequence ? kIterationsAlong : kIterationsMending;
    const Trial begin = WithinBounds(scene_, request_.terms, start.shoot ? Shoot(start.trial) : start.trial);
    PhaseRun run("mode_search", request_, own, begin);
    Finding finding;
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

  // Towards the targets, whatever the constraints.
  Trial Shoot(const Trial& from) const {
    SolveRequest relaxed{Relaxed(BeginningAs(from, scene_)), request_.contact};
    SolverOptions own;
    own.stop = options_.stop;
    own.memory_limit = options_.memory_limit;
    own.most_impacts = kMostImpactsOfMotion;
    own.iterations = kIterationsShooting;
    if (scene_.optimize == Optimize::kControl) own.guess = ControlGuess{from.control, from.durations};
    const SolveReport report = SolveByCeresLm(relaxed, own);
    if (report.losses.empty()) return from;
    Trial trial = from;
    if (scene_.optimize == Optimize::kControl) {
      trial.control = report.control;
      trial.durations.assign(scene_.steps, scene_.dt());
    } else {
      trial.initial = report.initial_state;
    }
    Simulate(scene_, request_.terms, &trial);
    return trial;
  }

  void Look(Finding finding) {
    ++solves_;
    run_.report().evaluations += finding.report.evaluations;
    if (run_.options().status) {
      run_.options().status(std::to_string(solves_) + " solves, best " +
                            std::to_string(ConvertLoss(BestLoss(), scene_.units, {})));
    }
    const Trial& trial = finding.trial;
    const bool optimal = finding.report.termination == Termination::kConverged;
    if (!trial.exact.ok) {
      if (!best_) KeepReason(finding.report);
      return;
    }
    if (optimal) Keep(trial);
    if (!best_ || IsBetter(finding)) {
      best_ = std::move(finding);
    }
  }

  // Optima that meet all constraints come before what does not.
  bool IsBetter(const Finding& finding) const {
    const auto feasible = [&](const Trial& trial) { return ViolationOf(scene_, trial) <= kFeasible; };
    const bool mine = feasible(finding.trial), other = feasible(best_->trial);
    if (mine != other) return mine;
    const double merit = MeritOf(scene_, finding.trial), least = MeritOf(scene_, best_->trial);
    if (merit < least - kSameLoss * std::abs(least)) return true;
    const auto converged = [](const Finding& f) { return f.report.termination == Termination::kConverged; };
    return merit < least + kSameLoss * std::abs(least) && converged(finding) && !converged(*best_);
  }

  void KeepReason(const SolveReport& report) {
    if (reason_.empty()) reason_ = report.reason;
  }

  void Keep(const Trial& trial) {
    LocalOptimum found{trial.exact.contacts, trial.exact.loss, {}};
    for (const Event& event : trial.exact.events) found.times.push_back(event.time);
    for (const LocalOptimum& known : optima_) {
      const double difference = std::abs(known.loss - found.loss);
      if (known.sequence == found.sequence && difference <= kSameLoss * std::abs(found.loss)) return;
    }
    optima_.push_back(std::move(found));
  }

  // -------------------------------------------------------------------------------------------------------------- end

  SolveReport Report() {
    if (end_ == End::kIterations) Leave("the limit of iterations");
    if (end_ == End::kTime) Leave("the limit of time");
    if (end_ == End::kInterrupt) searched_.complete = false;
    std::stable_sort(optima_.begin(), optima_.end(), [](const auto& a, const auto& b) { return a.loss < b.loss; });
    searched_.sequences = static_cast<int>(tried_.size());
    const size_t found = optima_.size();
    run_.report().optima = std::move(optima_);
    if (options_.search) run_.report().searched = searched_;
    const std::string limits = left_.empty() ? "" : "; not complete: " + left_;
    if (!best_) {
      const Trial& guess = run_.guess();
      const Termination none = end_ == End::kInterrupt ? Termination::kInterrupted : Termination::kNoProgress;
      return run_.Finish(guess, guess.exact.loss, none, reason_ + limits);
    }
    SolveReport& best = best_->report;
    const bool converged = best.termination == Termination::kConverged;
    run_.report().certificate = std::move(best.certificate);
    if (auto& certificate = run_.report().certificate; certificate && converged) {
      certificate->sequences_searched = searched_.sequences;
      if (options_.search && end_ != End::kInterrupt) certificate->scope = Certificate::Scope::kBestOfSearched;
    }
    Termination end = best.termination;
    if (end_ == End::kInterrupt) end = Termination::kInterrupted;
    if (end_ == End::kIterations) end = Termination::kIterationLimit;
    const Trial trial = best_->trial;
    const std::string sequence = ContactSequenceToString(scene_, trial.exact.contacts);
    const std::string reason =
        converged ? "best of " + std::to_string(found) + " optima, along " + sequence : best.reason;
    return run_.Finish(trial, trial.exact.loss, end, reason + limits);
  }

  PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
  SolverOptions options_;  // with its own limits
  std::optional<Finding> best_;
  std::vector<LocalOptimum> optima_;
  std::vector<ContactSequence> tried_;     // that were given to a solve
  std::vector<ContactSequence> expanded_;  // whose neighbours are tried
  std::string reason_;                     // why nothing was found
  std::string left_;                       // what limits have kept it from
  Searched searched_;
  int drawn_ = 0, solves_ = 0;
  std::optional<End> end_;
};

}  // namespace

SolveReport SearchByPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("mode_search", request, options);
  if (auto refused = run.WhyNoMotion()) return *refused;
  return PhaseSearch(&run, request).Search();
}

}  // namespace saltus
