// A local optimum over sequences of events near by, for any solver along one sequence, by an active-set update of the
// sequence.
//
// A sequence that is not that of an optimum shows: events come out of order, a phase shrinks to nothing, the gap of an
// event does not close any more, or the exact roll-out has other events. Each of these says which sequences are next,
// and each is a warm start (an active set, whose members are events):
//
//   events out of order, or at the same time    swap them, or leave out both if they cannot be swapped; or hold them at
//                                               the same time
//   an event after the final time, or at it     hold it there; or leave it out
//   a graze                                     leave it out, and keep its gap open by an inequality
//   a gap that just closes at an optimum        the event that would be there
//   an event at the border of two regimes       hold it in either, by an inequality; of discs slip and stick
//   the roll-out has another event              the sequence that it has; or keep that gap open
//
// Besides, wherever a solve leaves its sequence, a line search by exact roll-outs from where it began to where it
// stands looks for a better real motion, whatever the sequence that it has: solves go on from there, each from a lower
// loss.
//
// An optimum at which the loss has a kink, as the gap of an event just closes there or two events are at the same time,
// is proved by no condition of first order. Steps along random directions look for better motions beside it, and solves
// go on from those. The loss has a kink, too, where an event is at the end of a control interval. Plans move such ends
// with their events; if the loss falls as an event leaves the end of its interval, solves go on with the intervals as
// they are, and the event within one.
//
// It does not depend on discs, modes or guards: see phase_plan.h for what it asks of a problem.
#pragma once

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/random.h"
#include "solve/phases/phase_plan.h"

namespace saltus {
namespace mending {

inline constexpr int kMostAttempts = 60;
inline constexpr int kPatience = 5;           // attempts after which nothing better than an optimum is expected
inline constexpr int kPatienceOfMany = 8;     // ... or no optimum from one of many starts
inline constexpr int kMostStarts = 5;         // of one plan
inline constexpr double kBetterStart = 0.99;  // of the merit of an earlier one
inline constexpr double kVanished = 1e-3;     // of the horizon: a phase so short wants to be none
inline constexpr double kActive = 1e-6;       // ... or is none, at an optimum
inline constexpr double kGone = 1e-5;         // ... or no solve brings it back, if it is so short in many iterations
inline constexpr int kMostVanished = 30;      // iterations, one after the other
inline constexpr double kOutOfOrder = 1e-9;   // of the horizon
inline constexpr int kMostKinks = 5;          // left one after the other
inline constexpr int kDirections = 32;        // of steps from a kink
inline constexpr int kWaves = 4;              // of every second one of these, which is smooth
inline constexpr int kMostFromKink = 4;       // of these motions are gone on from
inline constexpr double kLeavesKink = 1e-5;   // relative, by which such a step lowers the loss
inline constexpr double kGrazes = 1e-4;       // of the scale of speeds, at which an event wants to be none

// The order in which tasks are tried.
enum class Rank { kBetterMotion, kIndicated, kTie, kHold };

}  // namespace mending

template <typename Run>
class SequenceUpdate {
 public:
  SequenceUpdate(Run* run, const TryPlanOf<Run>& try_plan) : run_(*run), try_(try_plan) {}

  SolveReport Solve() {
    const SolverOptions& options = run_.options();
    const bool mends = options.sequences.search && !run_.given_sequence();
    lowest_ = run_.ClampToBounds(run_.guess());
    if (!lowest_.exact.ok) lowest_ = run_.guess();
    Add(TaskAlong(SequenceFor(run_.guess()), run_.guess()));
    if (lowest_.control != run_.guess().control && lowest_.exact.only_impacts) {
      Add(TaskAlong(SequenceFor(lowest_), lowest_));
    }
    for (int attempts = 0; attempts < mending::kMostAttempts && !interrupted_ && !run_.IsOutOfIterations();
         ++attempts) {
      if (HasOptimum() && idle_ >= mending::kPatience) tasks_.clear();
      if (run_.is_one_of_many() && idle_ >= mending::kPatienceOfMany) tasks_.clear();
      if (tasks_.empty()) LeaveSaddleOfBest();
      if (tasks_.empty() && mends) LeaveKinkOfBest();
      if (tasks_.empty()) LeaveNodesOfBest();
      if (tasks_.empty() && mends) HoldBordersOfUnrealized();
      if (tasks_.empty() && !best_) Restore();
      if (tasks_.empty()) break;
      const Task task = TakeNext();
      if (MayTry(task)) Attempt(task, mends);
    }
    if (mends && !interrupted_ && HasOptimum() && EndsWithBest() && IsAtKink()) {
      for (const Trial& aside : NeighboursBetterThanBest()) ConsiderTrial(aside);
    }
    if (mends && !interrupted_ && !EndsWithBest()) TakeLowest();
    return Report();
  }

 private:
  using Event = typename Run::Event;
  using Trial = typename Run::Motion;
  using Sequence = std::vector<Event>;
  using PhasePlan = PlanOf<Event>;
  using PlanStart = PlanStartOf<Trial>;
  using PlanAttempt = PlanAttemptOf<Trial>;
  using Rank = mending::Rank;
  struct Task {
    PhasePlan plan;
    PlanStart start;
    Rank rank = Rank::kIndicated;
  };

  static bool Contains(const Sequence& events, const Event& event) {
    return std::find(events.begin(), events.end(), event) != events.end();
  }

  bool HasOptimum() const { return best_ && best_->converged; }

  // ------------------------------------------------------------------------------------------------- merit of motions

  double Merit(const Trial& trial) const { return run_.MeritOf(trial); }

  // A motion along the sequence that the options ask for is better than any other, and of two such motions one that
  // meets the constraints, whatever their losses.
  void ConsiderTrial(const Trial& trial) {
    const auto rank = [&](const Trial& of) { return std::pair(IsAsked(of), MeetsConstraints(of)); };
    const auto now = rank(trial), before = rank(lowest_);
    if (now == before ? Merit(trial) < Merit(lowest_) : now > before) lowest_ = trial;
  }
  bool IsAsked(const Trial& trial) const {
    return !run_.given_sequence() || trial.exact.contacts == *run_.given_sequence();
  }

  // ------------------------------------------------------------------------------------------------------------ tasks

  Sequence SequenceFor(const Trial& trial) const {
    return run_.given_sequence() ? *run_.given_sequence() : trial.exact.contacts;
  }

  Task TaskAlong(Sequence sequence, const Trial& trial) const {
    Task task;
    task.start.trial = trial;
    run_.PlanAlong(std::move(sequence), trial, &task.plan, &task.start.times);
    task.plan.tied.assign(task.plan.cuts.size(), false);
    task.plan.regimes.resize(task.plan.cuts.size());
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
      if (hold ? tried.held : ++starts >= mending::kMostStarts || !(merit < tried.merit)) return false;
    }
    return true;
  }

  void Add(Task task) {
    if (run_.IsPossible(task.plan) && MayTry(task)) tasks_.push_back(std::move(task));
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
    int vanished = 0;  // iterations in which a phase is hardly any, one after the other
    if (passed_.empty() || !(passed_.back() == task.plan)) passed_.push_back(task.plan);
    const PlanAttempt attempt = try_(task.plan, task.start, [&](const auto& times, const auto& speeds) {
      vanished = HasVanished(task.plan, times) ? vanished + 1 : 0;
      const bool leaves = task.rank != Rank::kHold && Leaves(task.plan, times, speeds);
      left = mends && (leaves || vanished > mending::kMostVanished);
      return !left;
    });
    run_.report().work.evaluations += attempt.jacobians;
    interrupted_ = attempt.interrupted;
    if (!attempt.valid) return;
    if (!left) {
      last_ = attempt;
      last_plan_ = task.plan;
    }
    ConsiderTrial(attempt.trial);
    // The last iterate of a solve that is interrupted need not meet the equations of the motion, nor the constraints.
    if (interrupted_ || run_.IsOutOfIterations()) {
      const bool keeps_constraints = MeetsConstraints(lowest_);
      const auto better = LineSearch(run_, attempt.trial, task.start.trial, [&](const Trial& trial) {
        return !keeps_constraints || MeetsConstraints(trial);
      });
      if (better) ConsiderTrial(*better);
    }
    Remember(task, attempt, left);
    const double least_planned = unrealized_ ? unrealized_->first.planned_loss : INFINITY;
    if (attempt.converged && !attempt.realized && attempt.planned_loss < least_planned) {
      unrealized_ = {attempt, task.plan};
    }
    const bool better = attempt.feasible() && IsBetter(task.plan, attempt);
    const double least = std::min(Merit(task.start.trial), Merit(attempt.trial));
    const bool nearer = !HasOptimum() && least < run_.most_loss() && least < mending::kBetterStart * least_;
    if (nearer) least_ = least;
    idle_ = better || nearer ? 0 : idle_ + 1;
    found_optimum_ = found_optimum_ || (attempt.feasible() && attempt.converged);
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

  bool IsBetter(const PhasePlan& plan, const PlanAttempt& attempt) const {
    if (!best_) return true;
    const double same = kHardlyBetter * std::abs(best_->loss());
    // An optimum on the grid is one of the intervals as they are, too.
    const bool proves_more = !best_->converged || (plan.on_grid && !best_plan_.on_grid);
    if (attempt.converged && proves_more) return attempt.loss() <= best_->loss() + same;
    return attempt.loss() < best_->loss() - same;
  }

  void Remember(const Task& task, const PlanAttempt& attempt, bool left) {
    double merit = mending::kBetterStart * Merit(task.start.trial);
    if (!left && attempt.converged) merit = attempt.feasible() ? attempt.loss() : -1;
    tried_.push_back({task.plan, merit, task.rank == Rank::kHold});
  }

  static bool IsShort(const std::vector<double>& times, size_t k, double least) {
    return times[k + 1] - times[k] <= least * times.back();
  }

  // Whether a solve is on its way out of its plan. On a grid an event may leave its interval and come back.
  bool Leaves(const PhasePlan& plan, const std::vector<double>& times, const std::vector<double>& speeds) const {
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.on_grid && !plan.tied[k] && IsShort(times, k, -mending::kOutOfOrder)) return true;
      if (plan.cuts[k] && speeds[k] > mending::kGrazes) return true;
    }
    return false;
  }

  // Whether a phase between two events is hardly any.
  static bool HasVanished(const PhasePlan& plan, const std::vector<double>& times) {
    for (size_t k = 0; k + 1 < plan.cuts.size(); ++k) {
      if (!plan.on_grid && !plan.tied[k] && IsShort(times, k, mending::kGone)) return true;
    }
    return false;
  }

  // Returns the tasks that follow a solve, best first.
  std::vector<Task> Moves(const Task& task, const PlanAttempt& attempt, bool left) const {
    std::vector<Task> moves;
    const Trial& trial = attempt.trial;
    if (!attempt.feasible()) {
      if (const auto better = LineSearch(run_, trial, task.start.trial)) {
        moves.push_back(AddSeparatedPairs(TaskAlong(better->exact.contacts, *better), task.plan.apart));
        moves.back().rank = Rank::kBetterMotion;
      }
    }
    // One that has not converged has gone astray, if nothing stopped it.
    const bool trusted = left || attempt.converged || attempt.feasible();
    const PlanStart start = trusted ? PlanStart{{attempt.times.begin(), attempt.times.end() - 1}, trial} : task.start;
    // Where phases hold all guards, one that is to stay open changes only an optimum, at which it reaches zero.
    const bool keeps_apart = attempt.converged || !Run::kHoldsGuards;
    DropGrazes(task.plan, attempt, start, keeps_apart, &moves);
    Reorder(task.plan, attempt, start, &moves);
    SplitRegimes(task.plan, attempt, start, &moves);
    // Where phases of free lengths have no optimum, the intervals as they are may have one.
    if (!attempt.converged) {
      for (auto& [plan, times] : run_.PlansWithJumpsOnGrid(task.plan, task.start.trial)) {
        moves.push_back(AddSeparatedPairs({std::move(plan), {std::move(times), task.start.trial}}, task.plan.apart));
      }
    }
    if (attempt.converged && attempt.feasible()) {
      for (auto& [plan, times] : run_.PlansThroughTouches(trial)) {
        moves.push_back(AddSeparatedPairs({std::move(plan), {std::move(times), trial}}, task.plan.apart));
      }
    }
    if (!attempt.realized && std::isfinite(Merit(trial))) {
      moves.push_back(AddSeparatedPairs(TaskAlong(trial.exact.contacts, trial), task.plan.apart));
      for (const Event& met : trial.exact.contacts) {  // those forbidden are kept apart in any case
        if (!keeps_apart) break;
        if (Contains(task.plan.Sequence(), met) || Contains(task.plan.apart, met)) continue;
        moves.push_back({task.plan, start});
        moves.back().plan.apart.push_back(met);
      }
    }
    return moves;
  }

  static Task AddSeparatedPairs(Task task, const Sequence& apart) {
    const Sequence met = task.plan.Sequence();
    for (const Event& event : apart) {
      if (!Contains(met, event)) task.plan.apart.push_back(event);
    }
    return task;
  }

  static void Drop(size_t k, Task* task) {
    task->plan.cuts.erase(task->plan.cuts.begin() + k);
    task->plan.tied.erase(task->plan.tied.begin() + k);
    task->plan.regimes.erase(task->plan.regimes.begin() + k);
    task->start.times.erase(task->start.times.begin() + k);
  }

  void DropGrazes(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start, bool keeps_apart,
                  std::vector<Task>* moves) const {
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.cuts[k] || attempt.speeds[k] < -mending::kGrazes) continue;
      Task task{plan, start};
      Drop(k, &task);
      // Beside another one of the same event nothing keeps its gap open.
      const bool beside =
          (k > 0 && plan.cuts[k - 1] == plan.cuts[k]) || (k + 1 < plan.cuts.size() && plan.cuts[k + 1] == plan.cuts[k]);
      if (keeps_apart && !beside && !Contains(task.plan.apart, *plan.cuts[k])) task.plan.apart.push_back(*plan.cuts[k]);
      moves->push_back(std::move(task));
    }
  }

  void Reorder(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start,
               std::vector<Task>* moves) const {
    const double least = attempt.converged ? mending::kActive : mending::kVanished;
    const size_t cuts = plan.cuts.size();
    const std::vector<double>& times = attempt.times;
    for (size_t k = 0; k + 1 < cuts; ++k) {
      if (plan.tied[k] || !IsShort(times, k, least) || plan.cuts[k] == plan.cuts[k + 1]) continue;
      Task task{plan, start};
      std::swap(task.plan.cuts[k], task.plan.cuts[k + 1]);
      std::swap(task.plan.regimes[k], task.plan.regimes[k + 1]);
      task.plan.tied[k] = task.plan.tied[k + 1] = false;
      if (!run_.IsPossible(task.plan)) {
        Task without{plan, start};
        Drop(k + 1, &without);
        Drop(k, &without);
        moves->push_back(std::move(without));
      }
      const double middle = 0.5 * (start.times[k] + start.times[k + 1]);
      if (start.times[k] > start.times[k + 1]) {
        std::swap(task.start.times[k], task.start.times[k + 1]);
      } else if (plan.cuts[k] && plan.cuts[k + 1]) {
        task.start.times[k] = task.start.times[k + 1] = middle;
      } else if (plan.on_grid) {  // the instant stays
        task.start.times[k] = task.start.times[k + 1] = start.times[plan.cuts[k] ? k + 1 : k];
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

  // Between two regimes the loss has a kink, which a solve without regard to it never leaves.
  void SplitRegimes(const PhasePlan& plan, const PlanAttempt& attempt, const PlanStart& start,
                    std::vector<Task>* moves) const {
    if (attempt.converged || !attempt.realized) return;
    for (const auto& [cut, regime] : run_.RegimesAtBorders(plan, attempt.trial)) {
      moves->push_back({plan, start});
      moves->back().plan.regimes[cut] = regime;
    }
  }

  // Makes times rise within [0, end].
  static void MakeRise(std::vector<double>* times, double end) {
    double least = 0;
    for (double& time : *times) least = time = std::clamp(time, least, std::max(least, end));
  }

  // --------------------------------------------------------------------------------------------------------------- end

  void LeaveSaddleOfBest() {
    if (!HasOptimum() || saddles_ >= kMostSaddles || !IsToBeCertified()) return;
    const Certificate certificate = run_.Certify(best_->trial);
    if (!certificate.IsSaddle()) return;
    ++saddles_;
    ContinueFrom(run_.SearchBothSides(best_->trial, certificate.curvature->direction));
  }

  bool IsHeld() const {
    return best_plan_.HasTies() || best_plan_.HasRegimes() || !best_plan_.apart.empty() || !best_->borders.empty();
  }

  bool IsToBeCertified() const { return run_.HasCertificate() && (run_.certifies() || IsHeld()); }

  // Whether the best optimum is held where the loss has a kink, and no certificate speaks for it.
  bool IsAtKink() { return IsHeld() && !(run_.HasCertificate() && run_.Certify(best_->trial).IsStationary()); }

  void LeaveKinkOfBest() {
    if (!HasOptimum() || kinks_ >= mending::kMostKinks || !IsAtKink()) return;
    std::vector<Trial> better = NeighboursBetterThanBest();
    if (better.size() > mending::kMostFromKink) better.resize(mending::kMostFromKink);
    ContinueFrom(better);
  }

  // Returns motions beside the best optimum, best first. A motion that keeps a gap open by a margin is better with a
  // smaller one, and one whose node is at an event may be so with the event beside it, but by little.
  std::vector<Trial> NeighboursBetterThanBest() {
    std::vector<Trial> better;
    NormalStream random(static_cast<std::uint64_t>(++kinks_));
    const double least = Merit(best_->trial) - mending::kLeavesKink * std::abs(Merit(best_->trial));
    for (int i = 0; i < mending::kDirections; ++i) {
      const std::vector<double> direction = RandomDirection(i % 2 == 1, &random);
      for (Trial& aside : run_.SearchBothSides(best_->trial, direction)) {
        if (MeetsConstraints(aside) && Merit(aside) < least) better.push_back(std::move(aside));
      }
    }
    std::ranges::stable_sort(better, {}, [&](const Trial& aside) { return Merit(aside); });
    return better;
  }

  // Returns a direction for steps from the best optimum, along which a control is noise or a few waves in time.
  std::vector<double> RandomDirection(bool smooth, NormalStream* random) const {
    const size_t width = run_.control_width(), of_control = best_->trial.control.size();
    std::vector<double> direction(run_.DirectionSize(best_->trial));
    for (double& entry : direction) entry = random->Next();
    if (smooth && of_control > width) std::fill_n(direction.begin(), of_control, 0.0);
    for (int wave = 0; wave < mending::kWaves && smooth && of_control > width; ++wave) {
      const double turns = std::numbers::pi * wave / static_cast<double>(of_control - width);
      for (size_t component = 0; component < width; ++component) {
        const double size = random->Next();
        for (size_t i = component; i < of_control; i += width) {
          direction[i] += size * std::cos(turns * static_cast<double>(i - component));
        }
      }
    }
    for (double& entry : direction) entry /= std::sqrt(static_cast<double>(direction.size()));
    return direction;
  }

  // Where the loss falls as an event leaves the end of its interval, solves go on with the intervals as they are.
  void LeaveNodesOfBest() {
    if (!HasOptimum() || best_plan_.on_grid || !IsToBeCertified()) return;
    idle_ = 0;
    for (auto& [plan, times] : run_.PlansOnGrid(best_->trial)) {
      Add({std::move(plan), {std::move(times), best_->trial}});
    }
  }

  // An optimum that is better than all real motions may become one beside the borders at which its guards stay.
  void HoldBordersOfUnrealized() {
    if (!Run::kHoldsGuards || !unrealized_ || unrealized_->second.holds_borders) return;
    const auto& [attempt, plan] = *unrealized_;
    if (HasOptimum() && !(attempt.planned_loss < best_->loss() - kHardlyBetter * std::abs(best_->loss()))) return;
    Task task{plan, {{attempt.times.begin(), attempt.times.end() - 1}, attempt.trial}};
    task.plan.holds_borders = true;
    idle_ = 0;
    Add(std::move(task));
  }

  // Adds the tasks along the sequences of better motions, best first.
  void ContinueFrom(const std::vector<Trial>& better) {
    idle_ = 0;
    for (size_t i = better.size(); i-- > 0;) {
      ConsiderTrial(better[i]);
      if (!better[i].exact.only_impacts) continue;
      tasks_.push_back(TaskAlong(better[i].exact.contacts, better[i]));
      tasks_.back().rank = Rank::kBetterMotion;
    }
  }

  bool MeetsConstraints(const Trial& trial) const { return run_.ViolationOf(trial) <= kFeasible; }
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
    if (!attempt.valid) return;
    Trial trial = attempt.trial;  // whose loss and violation are those of another objective
    run_.Simulate(&trial);
    const double violation = run_.ViolationOf(trial);
    if (!(violation < run_.ViolationOf(lowest_))) return;
    lowest_ = std::move(trial);
    if (violation > kHardlyAny) return;
    tried_.clear();
    Add(TaskAlong(lowest_.exact.contacts, lowest_));
  }

  // Beside its optimum, a motion along the same sequence may have nodes that are not at the events.
  bool EndsWithBest() const {
    if (!HasOptimum()) return false;
    const bool same_sequence = lowest_.exact.contacts == best_->trial.exact.contacts;
    const double same = (same_sequence ? kSameOptimum : kHardlyBetter) * std::abs(best_->loss());
    return !(Merit(lowest_) < best_->loss() - same);
  }

  // The best motion that was met may be an optimum along its own sequence, if events that appeared change nothing.
  void TakeLowest() {
    if (!run_.HasCertificate() || IsOpen(lowest_)) return;
    if (!lowest_.exact.ok || !lowest_.exact.only_impacts) return;
    const Certificate certificate = run_.Certify(lowest_);
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
    if (passed_.size() > 1) {
      reason += (reason.empty() ? "sequences passed: " : "; sequences passed: ") + run_.NamesOf(passed_);
    }
    const Trial& result = termination == Termination::kConverged ? best_->trial : lowest_;
    return run_.Finish(result, result.exact.loss, termination, std::move(reason));
  }

  Termination Judge(std::string* reason) {
    if (interrupted_) return Termination::kInterrupted;
    if (tried_.empty() && !run_.IsOutOfIterations()) {
      *reason = ReasonNothingTried();
      return Termination::kFailed;
    }
    if (EndsWithBest()) {
      Certify();
      return Termination::kConverged;
    }
    if (*reason = run_.ReasonNoDerivative(lowest_); !reason->empty()) return Termination::kFailed;
    if (found_optimum_) {
      *reason = "no optimum found has a lower loss than the motion returned, which is no optimum";
    } else if (IsOpen(lowest_)) {
      *reason = "no feasible motion " + SequenceText(run_.NameOf(lowest_.exact.contacts)) +
                " was found; the least violation is " + run_.DescribeMiss(lowest_);
    } else if (!best_ && last_ && !(last_->converged && last_->realized)) {
      const Sequence& returned = lowest_.exact.contacts;
      *reason = last_->converged
                    ? run_.ReasonNotRealized(last_->trial, last_plan_.Sequence())
                    : "the last solve, of motions " + SequenceText(run_.NameOf(last_plan_)) + ", has not converged";
      if ((last_->converged ? last_->trial.exact.contacts : last_plan_.Sequence()) != returned) {
        *reason += "; the sequence of the motion returned is " + run_.NameOf(returned);
      }
    }
    if (reason->empty()) *reason = "no solve along the sequences tried ended at an optimum";
    if (unrealized_ && unrealized_->first.planned_loss < lowest_.exact.loss) {
      *reason += "; lower is the loss of a plan, but " +
                 run_.ReasonNotRealized(unrealized_->first.trial, unrealized_->second.Sequence());
    }
    return run_.IsOutOfIterations() ? Termination::kIterationLimit : Termination::kNoProgress;
  }

  std::string ReasonNothingTried() const {
    if (passed_.empty()) {
      return "the events of the sequence cannot follow one another, or the last one cannot end the motion";
    }
    const PhasePlan& plan = passed_.front();
    const auto phases = std::count(plan.tied.begin(), plan.tied.end(), false) + 1;
    if (phases > run_.num_steps()) {
      return "the control has " + std::to_string(run_.num_steps()) +
             (run_.num_steps() == 1 ? " interval" : " intervals") + ", and a motion " +
             SequenceText(run_.NameOf(plan)) + " has " + std::to_string(phases) +
             " phases: expected an interval for each phase, or more";
    }
    return "no motion " + SequenceText(run_.NameOf(plan)) + " was found for the solve to start from";
  }

  static std::string SequenceText(const std::string& events) {
    return events == "none" ? "without events" : "with the sequence " + events;
  }

  std::string Kinks() const {
    const std::string kinks = run_.KinksOf(best_plan_);
    if (best_->borders.empty()) return kinks;
    return (kinks.empty() ? "" : kinks + ", ") + "the guards of " + best_->borders + " stay at zero";
  }

  // Beside the conditions of events at different times in between, whose gaps close: where the loss has a kink.
  void Certify() {
    if (!IsToBeCertified()) return;
    Certificate certificate = run_.Certify(best_->trial);
    if (IsAtKink()) {
      certificate = {};
      certificate.reason = Kinks() + ", where the loss has a kink: the certificate checks conditions of a smooth loss";
    }
    run_.report().certificate = std::move(certificate);
  }

  Run& run_;
  const TryPlanOf<Run>& try_;
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
  std::optional<std::pair<PlanAttempt, PhasePlan>> unrealized_;  // the best optimum along a plan that is no real motion
  PhasePlan best_plan_, last_plan_;
  Trial lowest_;                 // the best of all motions met
  int saddles_ = 0, kinks_ = 0;  // that were left
  bool restored_ = false, found_optimum_ = false;
  double least_ = INFINITY;  // merit of the motions of attempts
  int idle_ = 0;             // attempts since something better was found
  bool interrupted_ = false;
};

// Solves from the sequence that the options ask for, or that of the initial guess; a given sequence is left only for
// that of a motion beside a saddle. Saddles are left. The report is of the best control whose exact roll-out has its
// plan, and lists in `reason` the sequences that were passed.
template <typename Run>
SolveReport SolveWithSequenceUpdates(Run* run, const TryPlanOf<Run>& try_plan) {
  return SequenceUpdate<Run>(run, try_plan).Solve();
}

}  // namespace saltus
