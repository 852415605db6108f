#include "solve/search/phase_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/parallel_for.h"
#include "control/control_bounds.h"
#include "saltus/control/objective.h"
#include "scene/units.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/motion_merit.h"
#include "solve/phases/phase_plan.h"
#include "solve/phases/phase_run.h"
#include "solve/search/mode_search.h"
#include "solve/search/search_solve.h"
#include "solve/search/search_starts.h"
#include "solve/search/task_line.h"
#include "solve/shooting/single_shooting_solvers.h"

namespace saltus {
namespace {

constexpr int kIterationsMending = 1000;
constexpr int kIterationsAlong = 300;     // of a neighbour, which begins near an optimum
constexpr int kIterationsShooting = 30;   // from starts of its own
constexpr double kShareRelaxed = 0.3;     // of the limits, for the problem without constraints
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
  int shooting = 0;  // gradients of the solve by ceres_lm before it
};

// What is solved next, and the work that it may take (SearchOptions::work).
struct Draw {
  const Start* start;
  double most_work;
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
  enum class End { kInterrupt, kTime, kWork, kIterations };

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
      if (!begun || Stopped()) break;
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
    own.search_options.work *= kShareRelaxed;
    const SolveReport found = SolveByModeSearch(relaxed, own);
    run_.report().evaluations += found.evaluations;
    if (found.searched) searched_.work += found.searched->work;
    if (found.control.empty()) return;
    Trial trial{found.control, found.durations, {}, {}};
    if (trial.durations.empty()) trial.durations.assign(scene_.steps, scene_.dt());
    Simulate(scene_, request_.terms, &trial);
    starts->push_back({trial, false});
    // What is left out only makes them dearer, but for a free duration: those that are dearer already are no use.
    const bool prunes = best_ && !scene_.objective.duration && MeetsConstraints(best_->trial);
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
    TaskLine<Draw, Finding> line;
    line.draw = [&]() -> std::optional<Draw> {
      if (Stopped()) EndByStop();
      if (end_ || next == starts.end()) return std::nullopt;
      const double most_work = options_.search_options.work;
      if (most_work > 0 && searched_.work >= most_work) {
        end_ = End::kWork;
        return std::nullopt;
      }
      const double left = most_work > 0 ? most_work - searched_.work : std::numeric_limits<double>::infinity();
      if (drawn_++ < options_.iterations) return Draw{&*next++, left};
      end_ = End::kIterations;
      return std::nullopt;
    };
    line.solve = [this](const Draw& draw) { return Stopped() ? Finding{} : SolveFrom(*draw.start, draw.most_work); };
    line.look = [this](const Draw& draw, Finding finding) {
      if (finding.report.solver.empty()) return EndByStop();  // not begun
      if (const auto& sequence = draw.start->sequence) {
        tried_.push_back(*sequence);
        AddIfNew(*sequence, &searched_along_);
      }
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

  Finding SolveFrom(const Start& start, double most_work) const {
    SolverOptions own;
    own.stop = options_.stop;
    own.sequence = start.sequence;
    own.search = options_.search;
    own.iterations =
        IterationsWithin(most_work, WorkBySteps(scene_), start.sequence ? kIterationsAlong : kIterationsMending);
    Finding finding;
    const Trial begin = WithinBounds(
        scene_, request_.terms, start.shoot ? Shoot(start.trial, most_work, &finding.shooting) : start.trial);
    PhaseRun run("mode_search", request_, own, begin);
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
  Trial Shoot(const Trial& from, double most_work, int* evaluations) const {
    SolveRequest relaxed{Relaxed(BeginningAs(from, scene_)), request_.contact};
    SolverOptions own;
    own.stop = options_.stop;
    own.memory_limit = options_.memory_limit;
    own.most_impacts = kMostImpactsOfMotion;
    own.iterations = IterationsWithin(most_work, WorkByRollout(scene_), kIterationsShooting);
    if (scene_.optimize == Optimize::kControl) own.guess = ControlGuess{from.control, from.durations};
    const SolveReport report = SolveByCeresLm(relaxed, own);
    *evaluations = report.evaluations;
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
    run_.report().evaluations += finding.report.evaluations + finding.shooting;
    searched_.work += finding.report.evaluations * WorkBySteps(scene_) + finding.shooting * WorkByRollout(scene_);
    if (run_.options().status) {
      run_.options().status(std::to_string(solves_) + (solves_ == 1 ? " solve" : " solves") + ", best loss " +
                            std::to_string(ConvertLoss(BestLoss(), scene_.units, {})));
    }
    const Trial& trial = finding.trial;
    const bool optimal = finding.report.termination == Termination::kConverged;
    if (trial.exact.ok) AddIfNew(trial.exact.contacts, &searched_along_);
    if (!trial.exact.ok) {
      if (!best_) KeepReason(finding.report);
      return;
    }
    if (optimal) Keep(trial);
    if (!best_ || IsBetter(finding)) {
      best_ = std::move(finding);
    }
  }

  bool MeetsConstraints(const Trial& trial) const { return ViolationOf(scene_, trial) <= kFeasible; }

  static void AddIfNew(const ContactSequence& sequence, std::vector<ContactSequence>* sequences) {
    if (std::count(sequences->begin(), sequences->end(), sequence) == 0) sequences->push_back(sequence);
  }

  // Optima that meet all constraints come before what does not.
  bool IsBetter(const Finding& finding) const {
    const bool mine = MeetsConstraints(finding.trial), other = MeetsConstraints(best_->trial);
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
    if (end_ == End::kWork) Leave("the limit of work");
    if (end_ == End::kTime) Leave("the limit of time");
    if (end_ == End::kInterrupt) searched_.complete = false;
    std::stable_sort(optima_.begin(), optima_.end(), [](const auto& a, const auto& b) { return a.loss < b.loss; });
    searched_.sequences = static_cast<int>(searched_along_.size());
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
    const std::string reason = converged ? BestOf(found) + ", along " + sequence : best.reason;
    return run_.Finish(trial, trial.exact.loss, end, reason + limits);
  }

  PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
  SolverOptions options_;  // with its own limits
  std::optional<Finding> best_;
  std::vector<LocalOptimum> optima_;
  std::vector<ContactSequence> tried_;           // that were given to a solve
  std::vector<ContactSequence> searched_along_;  // these, and those that solves have ended with
  std::vector<ContactSequence> expanded_;        // whose neighbours are tried
  std::string reason_;                           // why nothing was found
  std::string left_;                             // what limits have kept it from
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
