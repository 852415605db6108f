#include "solve/phases/sequence_mending.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "control/control_bounds.h"
#include "simulate/impact.h"
#include "solve/phases/motion_merit.h"

namespace saltus {
namespace {

constexpr int kMostAttempts = 60;
constexpr int kPatience = 5;           // attempts after which nothing better than an optimum is expected
constexpr int kMostStarts = 5;         // of one plan
constexpr double kBetterStart = 0.99;  // of the merit of an earlier one
constexpr double kVanished = 1e-3;     // of the horizon: a phase so short wants to be none
constexpr double kActive = 1e-6;       // ... or is none, at an optimum
constexpr double kOutOfOrder = 1e-9;   // of the horizon
constexpr double kGrazes = 1e-4;       // of the scene's speed, at which an impact wants to be none
constexpr double kNearBorder = 1e-2;   // of the sliding velocity between slip and stick

// What is tried first.
enum class Rank { kBetterMotion, kIndicated, kTie, kHold };

struct Task {
  PhasePlan plan;
  PlanStart start;
  Rank rank = Rank::kIndicated;
};

bool Contains(const ContactSequence& pairs, const Candidate& pair) {
  return std::find(pairs.begin(), pairs.end(), pair) != pairs.end();
}

class Mending {
 public:
  Mending(PhaseRun* run, const TryPlan& try_plan) : run_(*run), scene_(run->scene()), try_(try_plan) {}

  SolveReport Solve() {
    const SolverOptions& options = run_.options();
    const bool mends = options.search && !options.sequence;
    lowest_ = WithinBounds(run_.guess());
    if (!lowest_.exact.ok) lowest_ = run_.guess();
    Add(TaskAlong(SequenceFor(options, run_.guess()), run_.guess()));
    if (lowest_.control != run_.guess().control && lowest_.exact.only_impacts) {
      Add(TaskAlong(SequenceFor(options, lowest_), lowest_));
    }
    for (int attempts = 0; attempts < kMostAttempts && !interrupted_ && !run_.IsOutOfIterations(); ++attempts) {
      if (HasOptimum() && idle_ >= kPatience) tasks_.clear();
      if (tasks_.empty()) LeaveSaddleOfBest();
      if (tasks_.empty() && !best_) Restore();
      if (tasks_.empty()) break;
      const Task task = TakeNext();
      if (MayTry(task)) Attempt(task, mends);
    }
    if (mends && !interrupted_ && !EndsWithBest()) TakeLowest();
    return Report();
  }

 private:
  bool HasOptimum() const { return best_ && best_->converged; }

  // ------------------------------------------------------------------------------------------------- merit of motions

  double Merit(const Trial& trial) const { return MeritOf(scene_, trial); }
  Trial WithinBounds(const Trial& trial) const { return saltus::WithinBounds(scene_, run_.terms(), trial); }

  // A motion that meets the constraints is better than one that does not, whatever their losses.
  void Meet(const Trial& trial) {
    const bool meets = MeetsConstraints(trial), met = MeetsConstraints(lowest_);
    if (meets == met ? Merit(trial) < Merit(lowest_) : meets) lowest_ = trial;
  }

  // ------------------------------------------------------------------------------------------------------------ tasks

  Task TaskAlong(ContactSequence sequence, const Trial& trial) const {
    std::erase_if(sequence, [&](const Candidate& c) { return IsForbidden(scene_, c); });
    Scene scene = scene_;
    scene.duration = DurationOf(trial);
    const std::vector<double> impacts = GuessFrom(scene, FlightOf(scene, trial), sequence).times;
    std::vector<double> instants;
    for (const ViaTerm& via : scene_.objective.via) instants.push_back(via.time);
    std::sort(instants.begin(), instants.end());
    Task task;
    task.start.trial = trial;
    for (size_t k = 0, i = 0; k < impacts.size() || i < instants.size();) {
      const bool impact = i == instants.size() || (k < impacts.size() && impacts[k] < instants[i]);
      task.start.times.push_back(impact ? impacts[k] : instants[i]);
      task.plan.cuts.push_back(impact ? std::optional(sequence[k]) : std::nullopt);
      ++(impact ? k : i);
    }
    task.plan.tied.assign(task.plan.cuts.size(), false);
    task.plan.modes.resize(task.plan.cuts.size());
    return task;
  }

  // A plan is tried again only from better motions: than those from which it was, and than what came of it. It is held
  // once.
  bool MayTry(const Task& task) const {
    const bool hold = task.rank == Rank::kHold;
    const double merit = Merit(task.start.trial);
    int starts = 0;
    for (const Tried& tried : tried_) {
      if (!(tried.plan == task.plan)) continue;
      if (hold ? tried.held : ++starts >= kMostStarts || !(merit < tried.merit)) return false;
    }
    return true;
  }

  void Add(Task task) {
    if (MayTry(task)) tasks_.push_back(std::move(task));
  }

  // The last one of the first rank.
  Task TakeNext() {
    const auto ahead = [](const Task& a, const Task& b) { return a.rank < b.rank; };
    const auto next = std::prev(std::min_element(tasks_.rbegin(), tasks_.rend(), ahead).base());
    Task task = std::move(*next);
    tasks_.erase(next);
    return task;
  }

  // ---------------------------------------------------------------------------------------------------------- attempts

  void Attempt(const Task& task, bool mends) {
    bool left = false;
    if (passed_.empty() || !(passed_.back() == task.plan)) passed_.push_back(task.plan);
    const PlanAttempt attempt = try_(task.plan, task.start, [&](const auto& times, const auto& speeds) {
      left = mends && task.rank != Rank::kHold && Leaves(task.plan, times, speeds);
      return !left;
    });
    run_.report().evaluations += attempt.jacobians;
    interrupted_ = attempt.interrupted;
    if (!attempt.valid) return;
    if (!left) {
      last_ = attempt;
      last_plan_ = task.plan;
    }
    Meet(attempt.trial);
    Remember(task, attempt, left);
    const bool better = attempt.feasible() && IsBetter(attempt);
    idle_ = better ? 0 : idle_ + 1;
    if (better) {
      best_ = attempt;
      best_plan_ = task.plan;
      if (attempt.converged) std::erase_if(tasks_, [](const Task& other) { return other.rank >= Rank::kTie; });
    }
    if (!mends || interrupted_ || (attempt.feasible() && attempt.converged && !better)) return;
    std::vector<Task> next = Moves(task, attempt, left);
    for (size_t i = next.size(); i-- > 0;) Add(std::move(next[i]));
    if (left && !HasOptimum()) tasks_.push_back({task.plan, task.start, Rank::kHold});
  }

  bool IsBetter(const PlanAttempt& attempt) const {
    if (!best_) return true;
    const double same = kHardlyBetter * std::abs(best_->loss());
    if (attempt.converged && !best_->converged) return attempt.loss() <= best_->loss() + same;
    return attempt.loss() < best_->loss() - same;
  }

  void Remember(const Task& task, const PlanAttempt& attempt, bool left) {
    double merit = kBetterStart * Merit(task.start.trial);
    if (!left && attempt.converged) merit = attempt.feasible() ? attempt.loss() : -1;
    tried_.push_back({task.plan, merit, task.rank == Rank::kHold});
  }

  static bool IsShort(const std::vector<double>& times, size_t k, double least) {
    return times[k + 1] - times[k] <= least * times.back();
  }

  // Whether a solve is on its way out of its plan.
  bool Leaves(const PhasePlan& plan, const std::vector<double>& times, const std::vector<double>& speeds) const {
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.tied[k] && IsShort(times, k, -kOutOfOrder)) return true;
      if (plan.cuts[k] && speeds[k] > kGrazes) return true;
    }
    return false;
  }

  // What to go on with after a solve, best first.
  std::vector<Task> Moves(const Task& task, const PlanAttempt& attempt, bool left) const {
    std::vector<Task> moves;
    const Trial& trial = attempt.trial;
    if (!attempt.feasible()) {
      if (const auto better = WalkTo(scene_, run_.terms(), trial, task.start.trial)) {
        moves.push_back(WithApart(TaskAlong(better->exact.contacts, *better), task.plan.apart));
        moves.back().rank = Rank::kBetterMotion;
      }
    }
    // One that has not converged has gone astray, if nothing stopped it.
    const bool trusted = left || attempt.converged || attempt.feasible();
    const PlanStart start = trusted ? PlanStart{{attempt.times.begin(), attempt.times.end() - 1}, trial} : task.start;
    DropGrazes(task.plan, attempt, start, &moves);
    Reorder(task.plan, attempt, start, &moves);
    SplitModes(task.plan, attempt, start, &moves);
    if (!attempt.realized && std::isfinite(Merit(trial))) {
      moves.push_back(WithApart(TaskAlong(trial.exact.contacts, trial), task.plan.apart));
      for (const Candidate& met : trial.exact.contacts) {  // those forbidden are kept apart in any case
        if (Contains(task.plan.Sequence(), met) || Contains(task.plan.apart, met)) continue;
        moves.push_back({task.plan, start});
        moves.back().plan.apart.push_back(met);
      }
    }
    return moves;
  }

  static Task WithApart(Task task, const ContactSequence& apart) {
    const ContactSequence met = task.plan.Sequence();
    for (const Candidate& pair : apart) {
      if (!Contains(met, pair)) task.plan.apart.push_back(pair);
    }
    return task;
  }

  static void Drop(size_t k, Task* task) {
    task->plan.cuts.erase(task->plan.cuts.begin() + k);
    task->plan.tied.erase(task->plan.tied.begin() + k);
    task->plan.modes.erase(task->plan.modes.begin() + k);
    task->start.times.erase(task->start.times.begin() + k);
  }

  void DropGrazes(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start,
                  std::vector<Task>* moves) const {
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.cuts[k] || attempt.speeds[k] < -kGrazes) continue;
      Task task{plan, start};
      Drop(k, &task);
      // Beside another impact of the pair nothing keeps the two apart.
      const bool beside =
          (k > 0 && plan.cuts[k - 1] == plan.cuts[k]) || (k + 1 < plan.cuts.size() && plan.cuts[k + 1] == plan.cuts[k]);
      if (!beside && !Contains(task.plan.apart, *plan.cuts[k])) task.plan.apart.push_back(*plan.cuts[k]);
      moves->push_back(std::move(task));
    }
  }

  void Reorder(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start,
               std::vector<Task>* moves) const {
    const double least = attempt.converged ? kActive : kVanished;
    const size_t cuts = plan.cuts.size();
    const std::vector<double>& times = attempt.times;
    for (size_t k = 0; k + 1 < cuts; ++k) {
      if (plan.tied[k] || !IsShort(times, k, least) || plan.cuts[k] == plan.cuts[k + 1]) continue;
      Task task{plan, start};
      std::swap(task.plan.cuts[k], task.plan.cuts[k + 1]);
      std::swap(task.plan.modes[k], task.plan.modes[k + 1]);
      task.plan.tied[k] = task.plan.tied[k + 1] = false;
      const double middle = 0.5 * (start.times[k] + start.times[k + 1]);
      if (start.times[k] > start.times[k + 1]) {
        std::swap(task.start.times[k], task.start.times[k + 1]);
      } else if (plan.cuts[k] && plan.cuts[k + 1]) {
        task.start.times[k] = task.start.times[k + 1] = middle;
      }
      moves->push_back(std::move(task));
      if (!plan.cuts[k] || !plan.cuts[k + 1]) continue;
      moves->push_back({plan, start, Rank::kTie});
      moves->back().plan.tied[k] = true;
      moves->back().start.times[k] = moves->back().start.times[k + 1] = middle;
    }
    // At the end, the later ones first.
    Task task{plan, start};
    while (!task.plan.cuts.empty() && task.plan.cuts.back() && !task.plan.tied.back()) {
      const size_t k = task.plan.cuts.size() - 1;
      if (times.back() - times[k] > least * times.back()) break;
      moves->push_back(task);
      moves->back().plan.tied[k] = true;
      moves->back().start.times[k] = DurationOf(start.trial);
      Drop(k, &task);
      moves->push_back(task);
    }
    for (Task& move : *moves) MakeRise(&move.start.times, DurationOf(move.start.trial));
  }

  // Between slip and stick the loss has a kink, which a solve that does not know of it never leaves.
  void SplitModes(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start,
                  std::vector<Task>* moves) const {
    if (attempt.converged || !attempt.realized || scene_.contact.friction == 0) return;
    const Flight flight = FlightOf(scene_, attempt.trial);
    auto hit = flight.hits().begin();
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.cuts[k]) continue;
      const Impact<double>& impact = (hit++)->impact;
      const double most = MakeImpactConstants(scene_, *plan.cuts[k]).MostDrag() * std::abs(impact.speed);
      if (plan.modes[k] || std::abs(std::abs(impact.sliding) - most) > kNearBorder * most) continue;
      for (const ContactMode mode : {ContactMode::kStick, ContactMode::kSlip}) {
        moves->push_back({plan, start});
        moves->back().plan.modes[k] = mode;
      }
    }
  }

  // Times that rise within [0, end].
  static void MakeRise(std::vector<double>* times, double end) {
    double least = 0;
    for (double& time : *times) least = time = std::clamp(time, least, std::max(least, end));
  }

  // --------------------------------------------------------------------------------------------------------------- end

  void LeaveSaddleOfBest() {
    if (!HasOptimum() || saddles_ >= kMostSaddles) return;
    if (!run_.terms().empty()) return;  // the certificate is of the scene's objective
    if (scene_.optimize != Optimize::kControl) return;
    const Certificate certificate = CertifyTrial(scene_, best_->trial);
    if (!certificate.IsSaddle()) return;
    ++saddles_;
    const std::vector<Trial> aside = LeaveSaddle(scene_, best_->trial, *certificate.curvature);
    idle_ = 0;
    for (size_t i = aside.size(); i-- > 0;) {
      Meet(aside[i]);
      if (!aside[i].exact.only_impacts) continue;
      tasks_.push_back(TaskAlong(aside[i].exact.contacts, aside[i]));
      tasks_.back().rank = Rank::kBetterMotion;
    }
  }

  bool MeetsConstraints(const Trial& trial) const { return ViolationOf(scene_, trial) <= kFeasible; }
  bool IsOpen(const Trial& trial) const { return trial.exact.ok && !MeetsConstraints(trial); }

  // The smallest miss of hard terms, whatever the loss, along the sequence of the motion that misses them least so far.
  // If there is hardly any, everything is tried again from there.
  void Restore() {
    constexpr double kHardlyAny = 1e-3;  // in natural units
    if (restored_ || !IsOpen(lowest_) || !std::isfinite(Merit(lowest_))) return;
    restored_ = true;
    Task task = TaskAlong(lowest_.exact.contacts, lowest_);
    task.plan.only_violation = true;
    const PlanAttempt attempt = try_(task.plan, task.start, [](const auto&, const auto&) { return true; });
    interrupted_ = attempt.interrupted;
    if (!attempt.valid || !(attempt.violation < ViolationOf(scene_, lowest_))) return;
    lowest_ = attempt.trial;
    if (attempt.violation > kHardlyAny) return;
    tried_.clear();
    Add(TaskAlong(lowest_.exact.contacts, lowest_));
  }

  bool EndsWithBest() const {
    return HasOptimum() && !(Merit(lowest_) < best_->loss() - kHardlyBetter * std::abs(best_->loss()));
  }

  // The best motion that was met may be an optimum along its own sequence, if impacts that appeared change nothing.
  void TakeLowest() {
    if (!run_.terms().empty() || scene_.optimize != Optimize::kControl || IsOpen(lowest_)) return;
    if (!lowest_.exact.ok || !lowest_.exact.only_impacts) return;
    const Certificate certificate = CertifyTrial(scene_, lowest_);
    if (!certificate.IsStationary() || certificate.IsSaddle()) return;
    best_plan_ = TaskAlong(lowest_.exact.contacts, lowest_).plan;
    if (passed_.empty() || !(passed_.back() == best_plan_)) passed_.push_back(best_plan_);
    best_.emplace();
    best_->trial = lowest_;
    best_->valid = best_->converged = best_->realized = true;
  }

  SolveReport Report() {
    std::string reason;
    const Termination termination = Judge(&reason);
    if (saddles_ > 0) reason = DescribeSaddle(reason);
    if (passed_.size() > 1)
      reason += (reason.empty() ? "sequences passed: " : "; sequences passed: ") + NamesOf(scene_, passed_);
    const Trial& result = termination == Termination::kConverged ? best_->trial : lowest_;
    return run_.Finish(result, result.exact.loss, termination, std::move(reason));
  }

  Termination Judge(std::string* reason) {
    if (interrupted_) return Termination::kInterrupted;
    if (tried_.empty()) {
      *reason = "no motion along " + NameOf(scene_, passed_.front()) + " was found to start from";
      return Termination::kFailed;
    }
    if (EndsWithBest()) {
      Certify();
      return Termination::kConverged;
    }
    if (HasOptimum()) {
      *reason = "no optimum found is better than a motion that is none";
    } else if (IsOpen(lowest_)) {
      *reason = "no motion along " + ContactSequenceToString(scene_, lowest_.exact.contacts) +
                " that meets all constraints was found; the least violation is " + DescribeMiss(scene_, lowest_);
    } else if (!best_ && last_ && !last_->realized) {
      *reason = WhyNotRealized(scene_, last_->trial.exact, last_plan_.Sequence());
    }
    if (reason->empty()) *reason = "no solve along a sequence tried has ended at an optimum";
    return run_.IsOutOfIterations() ? Termination::kIterationLimit : Termination::kNoProgress;
  }

  // Beside the conditions of impacts at different times in between, at some speed: where the loss has a kink.
  void Certify() {
    if (!run_.terms().empty() || scene_.optimize != Optimize::kControl) return;
    if (scene_.objective.effort == 0 && !scene_.control.IsBounded()) return;
    Certificate certificate = CertifyTrial(scene_, best_->trial);
    const bool kinks = best_plan_.HasTies() || best_plan_.HasModes() || !best_plan_.apart.empty();
    if (kinks && !certificate.IsStationary()) {
      certificate = {};
      certificate.reason =
          KinksOf(scene_, best_plan_) + ", where the loss has a kink: the conditions are those where it has none";
    }
    run_.report().certificate = std::move(certificate);
  }

  PhaseRun& run_;
  const Scene& scene_;
  const TryPlan& try_;
  // A plan, and the merit below which another start is worth while.
  struct Tried {
    PhasePlan plan;
    double merit;
    bool held;
  };
  std::vector<Task> tasks_;
  std::vector<Tried> tried_;
  std::vector<PhasePlan> passed_;
  std::optional<PlanAttempt> best_, last_;
  PhasePlan best_plan_, last_plan_;
  Trial lowest_;  // the best of all motions met
  int saddles_ = 0;
  bool restored_ = false;
  int idle_ = 0;  // attempts since something better was found
  bool interrupted_ = false;
};

}  // namespace

SolveReport SolveMending(PhaseRun* run, const TryPlan& try_plan) { return Mending(run, try_plan).Solve(); }

}  // namespace saltus
