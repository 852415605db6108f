#include "sequence_mending.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>

namespace saltus {
namespace {

constexpr int kMostAttempts = 40;
constexpr int kMostStarts = 5;            // of one plan
constexpr double kBetterStart = 0.99;     // of the merit of an earlier one
constexpr double kFeasible = 1e-8;        // largest violation on the exact roll-out
constexpr double kVanished = 1e-3;        // of the horizon: a phase so short wants to be none
constexpr double kActive = 1e-6;          // ... or is none, at an optimum
constexpr double kOutOfOrder = 1e-9;      // of the horizon
constexpr double kGrazes = 1e-4;          // of the scene's speed, at which an impact wants to be none
constexpr double kMissWeight = 1e3;       // of hard constraints beside the loss, in natural units
constexpr int kHalvings = 8;              // on the way from one motion to another
constexpr double kSameLoss = 1e-9;

struct Task {
  PhasePlan plan;
  PlanStart start;
  bool hold = false;   // the solve is not to leave the plan
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
    Add(TaskAlong(SequenceFor(options, run_.guess()), run_.guess()));
    lowest_ = run_.guess();
    for (int attempts = 0; attempts < kMostAttempts && !tasks_.empty(); ++attempts) {
      if (static_cast<int>(run_.report().losses.size()) > options.iterations) break;
      const Task task = std::move(tasks_.back());
      tasks_.pop_back();
      Attempt(task, mends);
      if (interrupted_) break;
      if (tasks_.empty()) LeaveSaddleOfBest();
    }
    return Report();
  }

 private:
  // ------------------------------------------------------------------------------------------------- merit of motions

  // Of a real motion: the loss, and what is left of hard constraints. Infinite if there is none.
  double Merit(const Trial& trial) const {
    if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
    const double violation = ViolationOf(scene_, trial);
    return trial.exact.loss + kMissWeight * violation * violation;
  }

  void Meet(const Trial& trial) {
    if (Merit(trial) < Merit(lowest_)) lowest_ = trial;
  }

  // The best motion on the way from one to another whose forces are known, if it is better than the first.
  std::optional<Trial> WalkTo(const Trial& to, const Trial& from) const {
    std::optional<Trial> best;
    double least = Merit(from);
    if (std::isfinite(least)) least -= kSameLoss * std::abs(least);
    const auto before = ForcesOf(scene_, from);
    const double stretch = DurationOf(from) / DurationOf(to);
    double part = 1;
    for (int i = 0; i <= kHalvings; ++i, part /= 2) {
      Trial between = to;
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
      between.exact = SimulateExactly(scene_, InitialState(scene_), between.control, between.durations);
      const double merit = Merit(between);
      if (!(merit < least)) continue;
      least = merit;
      best = std::move(between);
    }
    return best;
  }

  // ------------------------------------------------------------------------------------------------------------ tasks

  Task TaskAlong(const ContactSequence& sequence, const Trial& trial) const {
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
    return task;
  }

  // A plan is tried again only from better motions.
  bool MayTry(const PhasePlan& plan, double merit) const {
    int starts = 0;
    for (const auto& [known, known_merit] : tried_) {
      if (known == plan && (++starts >= kMostStarts || !(merit < kBetterStart * known_merit))) return false;
    }
    return true;
  }

  void Add(Task task) {
    const double merit = Merit(task.start.trial);
    if (!MayTry(task.plan, merit)) return;
    tried_.emplace_back(task.plan, merit);
    tasks_.push_back(std::move(task));
  }

  // ---------------------------------------------------------------------------------------------------------- attempts

  void Attempt(const Task& task, bool mends) {
    bool left = false;
    if (passed_.empty() || !(passed_.back() == task.plan)) passed_.push_back(task.plan);
    const PlanAttempt attempt = try_(task.plan, task.start, [&](const auto& times, const auto& speeds) {
      left = mends && !task.hold && Leaves(task.plan, times, speeds);
      return !left;
    });
    run_.report().evaluations += attempt.jacobians;
    if (getenv("MEND_DEBUG")) {  // DEBUG
      std::string t;  // DEBUG
      for (size_t k = 0; k < task.plan.tied.size(); ++k) if (task.plan.tied[k]) t += " tied" + std::to_string(k);  // DEBUG
      for (auto& c : task.plan.apart) t += " apart " + ContactSequenceToString(scene_, {c});  // DEBUG
      std::string n = NameOf(task.plan);  // DEBUG
      fprintf(stderr, "%s%s hold %d | start merit %.9g its %zu left %d conv %d real %d viol %.3g loss %.12g met %s\n", n.size() > 90 ? n.substr(n.size() - 90).c_str() : n.c_str(), t.c_str(), task.hold, Merit(task.start.trial), run_.report().losses.size(), left, attempt.converged, attempt.realized, attempt.violation, attempt.trial.exact.loss, attempt.realized ? "" : ContactSequenceToString(scene_, attempt.trial.exact.contacts).substr(0, 100).c_str());  // DEBUG
    }  // DEBUG
    interrupted_ = attempt.interrupted;
    if (!attempt.valid) return;
    if (!left) last_ = attempt;
    Meet(attempt.trial);
    const bool better = attempt.feasible() && (!best_ || attempt.loss() < best_->loss());
    if (better) {
      best_ = attempt;
      best_plan_ = task.plan;
    }
    if (!mends || interrupted_ || (attempt.feasible() && attempt.converged && !better)) return;
    std::vector<Task> next = Moves(task, attempt, left);
    for (size_t i = next.size(); i-- > 0;) Add(std::move(next[i]));
    if (left) tasks_.insert(tasks_.begin(), {task.plan, task.start, true});
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
      }
    }
    // One that has not converged has gone astray, if nothing stopped it.
    const bool trusted = left || attempt.converged || attempt.feasible();
    const PlanStart start = trusted ? PlanStart{{attempt.times.begin(), attempt.times.end() - 1}, trial} : task.start;
    DropGrazes(task.plan, attempt, start, &moves);
    Reorder(task.plan, attempt, start, &moves);
    if (!attempt.realized && std::isfinite(Merit(trial))) {
      moves.push_back(WithApart(TaskAlong(trial.exact.contacts, trial), task.plan.apart));
      for (const Candidate& met : trial.exact.contacts) {
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
      task.plan.tied[k] = task.plan.tied[k + 1] = false;
      const double middle = 0.5 * (start.times[k] + start.times[k + 1]);
      if (start.times[k] > start.times[k + 1]) {
        std::swap(task.start.times[k], task.start.times[k + 1]);
      } else if (plan.cuts[k] && plan.cuts[k + 1]) {
        task.start.times[k] = task.start.times[k + 1] = middle;
      }
      moves->push_back(std::move(task));
      if (!plan.cuts[k] || !plan.cuts[k + 1]) continue;
      moves->push_back({plan, start});
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

  // Times that rise within [0, end].
  static void MakeRise(std::vector<double>* times, double end) {
    double least = 0;
    for (double& time : *times) least = time = std::clamp(time, least, std::max(least, end));
  }

  // --------------------------------------------------------------------------------------------------------------- end

  void LeaveSaddleOfBest() {
    if (!best_ || !best_->converged || saddles_ >= kMostSaddles) return;
    const Certificate certificate = CertifyTrial(scene_, best_->trial);
    if (!certificate.IsSaddle()) return;
    ++saddles_;
    const std::vector<Trial> aside = LeaveSaddle(scene_, best_->trial, *certificate.curvature);
    for (size_t i = aside.size(); i-- > 0;) {
      Meet(aside[i]);
      if (aside[i].exact.only_impacts) Add(TaskAlong(aside[i].exact.contacts, aside[i]));
    }
  }

  SolveReport Report() {
    if (!last_ && !best_) {
      return run_.Finish(run_.guess(),
                         run_.guess().exact.loss,
                         interrupted_ ? Termination::kInterrupted : Termination::kFailed,
                         interrupted_ ? "" : "no motion along " + NameOf(passed_.front()) + " was found to start from");
    }
    std::string reason;
    Termination termination = Judge(&reason);
    if (passed_.size() > 1) reason = (reason.empty() ? "" : reason + "; ") + Passed();
    const Trial& trial = best_ ? best_->trial : last_->trial;
    return run_.Finish(trial, trial.exact.loss, termination, std::move(reason));
  }

  Termination Judge(std::string* reason) {
    if (interrupted_) return Termination::kInterrupted;
    const PlanAttempt& result = best_ ? *best_ : *last_;
    if (best_ && best_->converged) return Termination::kConverged;
    return Termination::kNoProgress;
  }

  std::string NameOf(const PhasePlan& plan) const {
    std::string text = ContactSequenceToString(scene_, plan.Sequence());
    return text;
  }

  std::string Passed() const {
    std::string text = "sequences passed: ";
    for (size_t i = 0; i < passed_.size(); ++i) text += (i > 0 ? "; " : "") + NameOf(passed_[i]);
    return text;
  }

  PhaseRun& run_;
  const Scene& scene_;
  const TryPlan& try_;
  std::vector<Task> tasks_;                            // the last one is next
  std::vector<std::pair<PhasePlan, double>> tried_;    // with the merit of where they started
  std::vector<PhasePlan> passed_;
  std::optional<PlanAttempt> best_, last_;
  PhasePlan best_plan_;
  Trial lowest_;  // of all motions met
  int saddles_ = 0;
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

bool PlanAttempt::feasible() const { return realized && violation <= kFeasible; }

double DurationOf(const Trial& trial) {
  return std::accumulate(trial.durations.begin(), trial.durations.end(), 0.0);
}

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

double ViolationOf(const Scene& scene, const Trial& trial) {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  for (const NoContact& pair : scene.no_contact) {
    if (Contains(trial.exact.contacts, {pair.a, pair.b, pair.plane})) return std::numeric_limits<double>::infinity();
  }
  if (!scene.objective.HasConstraints()) return 0;
  const Flight flight = FlightOf(scene, trial);
  double violation = 0;
  const auto miss = [&](const DiscStates& x, const auto& term) {
    const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
    violation = std::max(violation, (q - term.target).norm());
  };
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.hard) miss(flight.end(), term);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) miss(flight.Before(term.time), term);
  }
  return violation;
}

SolveReport SolveMending(PhaseRun* run, const TryPlan& try_plan) { return Mending(run, try_plan).Solve(); }

}  // namespace saltus
