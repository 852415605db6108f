#include "sequence_mending.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>

#include "control/control_bounds.h"
#include "saltus/control/objective.h"

namespace saltus {
namespace {

constexpr int kMostAttempts = 60;
constexpr int kPatience = 5;           // attempts after which nothing better than an optimum is expected
constexpr int kMostStarts = 5;         // of one plan
constexpr double kBetterStart = 0.99;  // of the merit of an earlier one
constexpr double kFeasible = 1e-8;     // largest violation on the exact roll-out
constexpr double kVanished = 1e-3;     // of the horizon: a phase so short wants to be none
constexpr double kActive = 1e-6;       // ... or is none, at an optimum
constexpr double kOutOfOrder = 1e-9;   // of the horizon
constexpr double kGrazes = 1e-4;       // of the scene's speed, at which an impact wants to be none
constexpr double kNearBorder = 1e-2;   // of the sliding velocity between slip and stick
constexpr double kMissWeight = 1e3;    // of hard constraints beside the loss, in natural units
constexpr int kHalvings = 8;           // on the way from one motion to another
constexpr double kSameLoss = 1e-9;

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

bool IsForbidden(const Scene& scene, const Candidate& c) {
  return std::find(scene.no_contact.begin(), scene.no_contact.end(), NoContact{c.a, c.b, c.plane}) !=
         scene.no_contact.end();
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
    for (int attempts = 0; attempts < kMostAttempts && !interrupted_ && !OutOfIterations(); ++attempts) {
      if (HasOptimum() && idle_ >= kPatience) tasks_.clear();
      if (tasks_.empty()) LeaveSaddleOfBest();
      if (tasks_.empty() && !best_) Restore();
      if (tasks_.empty()) break;
      const Task task = TakeNext();
      if (MayTry(task)) Attempt(task, mends);
    }
    return Report();
  }

 private:
  bool HasOptimum() const { return best_ && best_->converged; }
  bool OutOfIterations() const {
    return static_cast<int>(run_.report().losses.size()) > std::max(1, run_.options().iterations);
  }

  // ------------------------------------------------------------------------------------------------- merit of motions

  // Of a real motion: the loss, and what is left of hard constraints. Infinite if there is none.
  double Merit(const Trial& trial) const {
    if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
    const double violation = ViolationOf(scene_, trial);
    return trial.exact.loss + kMissWeight * violation * violation;
  }

  Trial WithinBounds(Trial trial) const {
    const std::vector<double> control = trial.control;
    MoveWithinBounds(scene_.control, trial.control);
    if (trial.control == control) return trial;
    Simulate(scene_, run_.terms(), &trial);
    return trial;
  }

  void Meet(const Trial& trial) {
    if (Merit(trial) < Merit(lowest_)) lowest_ = trial;
  }

  // The best motion on the way from one to another whose forces are known, if it is better than the first.
  std::optional<Trial> WalkTo(const Trial& to, const Trial& from) const {
    std::optional<Trial> best;
    double least = Merit(WithinBounds(from));
    if (std::isfinite(least)) least -= kSameLoss * std::abs(least);
    const auto before = ForcesOf(scene_, from);
    const double stretch = DurationOf(from) / DurationOf(to);
    double part = 1;
    for (int i = 0; i <= kHalvings; ++i, part /= 2) {
      Trial between = to;
      for (size_t j = 0; j < to.initial.size(); ++j) {
        between.initial[j] = part * to.initial[j] + (1 - part) * InitialOf(scene_, from)[j];
      }
      const double factor = part + (1 - part) * stretch;
      double begin = 0;
      for (size_t k = 0; k < to.durations.size(); ++k) {
        for (int c = 0; c < scene_.num_controlled(); ++c) {
          const Vec2d old = before(c, stretch * (begin + 0.5 * to.durations[k]));
          for (int j = 0; j < 2; ++j) {
            double& u = between.control[2 * (k * scene_.num_controlled() + c) + j];
            u = part * u + (1 - part) * old[j];
          }
        }
        begin += to.durations[k];
        between.durations[k] *= factor;
      }
      MoveWithinBounds(scene_.control, between.control);
      Simulate(scene_, run_.terms(), &between);
      const double merit = Merit(between);
      if (!(merit < least)) continue;
      least = merit;
      best = std::move(between);
    }
    return best;
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
    const double same = kSameLoss * std::abs(best_->loss());
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
      if (const auto better = WalkTo(trial, task.start.trial)) {
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
      if (!Contains(task.plan.Sequence(), *plan.cuts[k])) task.plan.apart.push_back(*plan.cuts[k]);
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
      const double most = scene_.contact.friction * (1 + scene_.contact.restitution) * std::abs(impact.speed);
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

  bool IsOpen(const Trial& trial) const { return trial.exact.ok && !(ViolationOf(scene_, trial) <= kFeasible); }

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

  SolveReport Report() {
    std::string reason;
    const Termination termination = Judge(&reason);
    if (saddles_ > 0) reason = DescribeSaddle(reason);
    if (passed_.size() > 1) reason += (reason.empty() ? "" : "; ") + Passed();
    const Trial& result = termination == Termination::kConverged ? best_->trial : lowest_;
    return run_.Finish(result, result.exact.loss, termination, std::move(reason));
  }

  Termination Judge(std::string* reason) {
    if (interrupted_) return Termination::kInterrupted;
    if (tried_.empty()) {
      *reason = "no motion along " + NameOf(passed_.front()) + " was found to start from";
      return Termination::kFailed;
    }
    if (HasOptimum() && !(Merit(lowest_) < best_->loss() - kSameLoss * std::abs(best_->loss()))) {
      Certify();
      return Termination::kConverged;
    }
    if (best_ && HasOptimum()) {
      *reason = "no optimum found is better than a motion that is none";
    } else if (IsOpen(lowest_)) {
      *reason = "no motion along " + ContactSequenceToString(scene_, lowest_.exact.contacts) +
                " that meets all constraints was found; the least violation is " + DescribeMiss();
    } else if (!best_ && last_ && !last_->realized) {
      *reason = WhyNotRealized(scene_, last_->trial.exact, last_plan_.Sequence());
    }
    if (OutOfIterations()) return Termination::kIterationLimit;
    if (reason->empty()) *reason = "steps have become too small";
    return Termination::kNoProgress;
  }

  // Beside the conditions of impacts at different times in between, at some speed: where the loss has a kink.
  void Certify() {
    if (!BeyondTerminalCost(scene_).empty() || scene_.objective.effort == 0 || !run_.terms().empty()) return;
    if (scene_.optimize != Optimize::kControl) return;
    Certificate certificate = CertifyTrial(scene_, best_->trial);
    const bool kinks = best_plan_.HasTies() || best_plan_.HasModes() || !best_plan_.apart.empty();
    if (kinks && !certificate.IsStationary()) {
      certificate = {};
      certificate.reason = Kinks() + ", where the loss has a kink: the conditions are those where it has none";
    }
    run_.report().certificate = std::move(certificate);
  }

  std::string Kinks() const {
    std::string text;
    const auto add = [&](const std::string& what) { text += (text.empty() ? "" : ", ") + what; };
    for (const Candidate& pair : best_plan_.apart) add(ContactSequenceToString(scene_, {pair}) + " just touch");
    if (best_plan_.HasTies()) {
      add(best_plan_.tied.back() ? "an impact is at the final time" : "impacts are at the same time");
    }
    if (best_plan_.HasModes()) add("an impact is between slip and stick");
    return text;
  }

  // Of the constraint that the best motion misses most.
  std::string DescribeMiss() const {
    const Miss miss = LargestMiss(scene_, lowest_);
    if (lowest_.own.violation > miss.size) {
      char part[40];
      std::snprintf(part, sizeof part, "%.6g", lowest_.own.violation);
      return std::string(part) + " of its scale, by " + lowest_.own.worst;
    }
    const bool position = miss.quantity == TerminalTerm::Quantity::kPosition;
    const double unit = position ? scene_.units.length : scene_.units.speed();
    char text[40];
    std::snprintf(text, sizeof text, "%.6g", miss.size * unit);
    return std::string(text) + (position ? " m" : " m/s") + ", by " + scene_.bodies[miss.body].name;
  }

  std::string NameOf(const PhasePlan& plan) const { return NameFrom(plan, 0); }

  // Without the first impacts.
  std::string NameFrom(const PhasePlan& plan, size_t first) const {
    const ContactSequence sequence = plan.Sequence();
    std::string text = ContactSequenceToString(scene_, {sequence.begin() + first, sequence.end()});
    if (plan.HasTies()) text += plan.tied.back() ? " (at the final time)" : " (some at the same time)";
    for (size_t k = 0; k < plan.cuts.size(); ++k) {
      if (!plan.modes[k]) continue;
      text += ", " + ContactSequenceToString(scene_, {*plan.cuts[k]});
      text += *plan.modes[k] == ContactMode::kSlip ? " slips" : " sticks";
    }
    for (const Candidate& pair : plan.apart) text += ", " + ContactSequenceToString(scene_, {pair}) + " apart";
    return text;
  }

  std::string Passed() const {
    constexpr size_t kLong = 8;  // impacts, of which those are left out that the sequence before has too
    std::string text = "sequences passed: ";
    for (size_t i = 0; i < passed_.size(); ++i) {
      const ContactSequence sequence = passed_[i].Sequence();
      size_t same = 0;
      if (i > 0 && sequence.size() > kLong) {
        const ContactSequence before = passed_[i - 1].Sequence();
        const auto [mine, other] = std::mismatch(sequence.begin(), sequence.end(), before.begin(), before.end());
        same = std::min<size_t>(mine - sequence.begin(), sequence.size() - 1);
      }
      text += i > 0 ? "; " : "";
      if (same > 0) text += "(" + std::to_string(same) + " the same) ";
      text += NameFrom(passed_[i], same);
    }
    return text;
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
  Trial lowest_;  // of all motions met
  int saddles_ = 0;
  bool restored_ = false;
  int idle_ = 0;  // attempts since something better was found
  bool interrupted_ = false;
};

}  // namespace

ContactSequence PhasePlan::Sequence() const {
  ContactSequence sequence;
  for (const auto& cut : cuts) {
    if (cut) sequence.push_back(*cut);
  }
  return sequence;
}

bool PhasePlan::HasTies() const { return std::find(tied.begin(), tied.end(), true) != tied.end(); }

bool PhasePlan::HasModes() const {
  return std::any_of(modes.begin(), modes.end(), [](const auto& mode) { return mode.has_value(); });
}

bool PlanAttempt::feasible() const { return realized && violation <= kFeasible; }

double DurationOf(const Trial& trial) { return std::accumulate(trial.durations.begin(), trial.durations.end(), 0.0); }

std::function<Vec2d(int c, double t)> ForcesOf(const Scene& scene, const Trial& trial) {
  std::vector<double> ends(trial.durations.size());
  std::partial_sum(trial.durations.begin(), trial.durations.end(), ends.begin());
  return [&scene, &trial, ends = std::move(ends)](int c, double t) {
    const size_t last = ends.size() - 1;
    const size_t k = std::min<size_t>(std::upper_bound(ends.begin(), ends.end(), t) - ends.begin(), last);
    const double* u = &trial.control[2 * (k * scene.num_controlled() + c)];
    return Vec2d(u[0], u[1]);
  };
}

Miss LargestMiss(const Scene& scene, const Trial& trial) {
  Miss largest;
  const Flight flight = FlightOf(scene, trial);
  const auto consider = [&](const DiscStates& x, const auto& term) {
    const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
    const double size = (q - term.target).norm();
    if (size > largest.size) largest = {size, term.body, term.quantity};
  };
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.hard) consider(flight.end(), term);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) consider(flight.Before(term.time), term);
  }
  return largest;
}

double ViolationOf(const Scene& scene, const Trial& trial) {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  const ContactSequence& met = trial.exact.contacts;
  if (std::any_of(met.begin(), met.end(), [&](const Candidate& c) { return IsForbidden(scene, c); })) {
    return std::numeric_limits<double>::infinity();
  }
  return std::max(trial.own.violation, scene.objective.HasConstraints() ? LargestMiss(scene, trial).size : 0.0);
}

SolveReport SolveMending(PhaseRun* run, const TryPlan& try_plan) { return Mending(run, try_plan).Solve(); }

}  // namespace saltus
