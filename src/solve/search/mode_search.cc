#include "solve/search/mode_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "base/parallel_for.h"
#include "saltus/control/objective.h"
#include "scene/units.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_run.h"
#include "solve/search/loss_bound.h"
#include "solve/search/phase_search.h"
#include "solve/search/search_solve.h"
#include "solve/search/search_starts.h"
#include "solve/search/sequence_search.h"
#include "solve/search/task_queue.h"

namespace saltus {
namespace {

constexpr double kBound = 3;           // times the best loss
constexpr double kNoLoss = 1e-12;      // in natural units: to be compared with nothing smaller
constexpr double kProved = 1e-8;       // relative, between the best loss and a lower bound
constexpr int kPatience = 150;         // solves after which nothing better is expected
constexpr int kMoreStarts = 3;         // times the starts, that are tried then
constexpr int kMostRounds = 4;         // of more starts
constexpr int kRoundsAtEnd = 2;        // of them, where no neighbours are left
constexpr int kMorePatience = 100;     // solves after those
constexpr double kLongWork = 1e6;      // of a search (SearchOptions::work), from which on it may be a long one
constexpr double kLongPatience = 1e7;  // work of as many solves, from which on the work is compared with
constexpr double kPatienceWork = 5;    // times the work at which the search was last better
constexpr size_t kMoreImpacts = 8;     // than the best motion has: neighbours of motions with more are left out
constexpr int kMostMended = 12;        // motions, each the best at its time, whose sequence is mended
constexpr int kMoreMended = 2;         // others near the best, where the search has come to a stop
constexpr double kNearBest = 1.05;     // of its loss
constexpr double kApart = 1.001;       // the losses of these
constexpr double kMuchBetter = 0.99;   // of the loss of the last one: mended at once, else where the search would stop
constexpr int kAheadOfLong = 100;      // solves that go on beside one that takes as long as many
constexpr int kStarts = 3;             // motions from which a sequence is tried
constexpr size_t kMostRunnersUp = 12;

// A sequence as something to be compared.
using SequenceKey = std::vector<std::array<int, 3>>;
SequenceKey KeyOf(const ContactSequence& sequence) {
  SequenceKey key;
  for (const Candidate& c : sequence) key.push_back({c.a, c.b, c.plane});
  return key;
}

using Motion = std::shared_ptr<const Trial>;

// The sequences to be solved along, best first.
class SearchQueue {
 public:
  // `memory`, bytes: of what does not fit the last is forgotten.
  explicit SearchQueue(std::size_t memory) : memory_(memory) {}

  // Adds a solve along a sequence, from a motion that so many others of the queue share; the order is that of losses.
  // Not added if the sequence has been tried from enough motions.
  void AddSequence(const Motion& from, ContactSequence sequence, size_t sharing = 1) {
    int& starts = starts_[KeyOf(sequence)];
    if (starts >= kStarts) return;
    ++starts;
    Add(from, std::move(sequence), sharing);
  }
  // Adds a solve of a motion along its own sequence, whatever that has been tried from, if it has only impacts.
  void AddMotion(const Trial& trial) {
    if (!trial.exact.only_impacts) return;
    NoteTried(trial.exact.contacts);
    Add(std::make_shared<const Trial>(trial), trial.exact.contacts, 1);
  }
  // Counts a motion from which a sequence is tried without the queue.
  void NoteTried(const ContactSequence& sequence) { ++starts_[KeyOf(sequence)]; }

  bool empty() const { return queue_.empty(); }
  double first_loss() const { return queue_.begin()->first.first; }
  SearchTask TakeFirst() {
    auto node = queue_.extract(queue_.begin());
    bytes_ -= node.mapped().bytes;
    return std::move(node.mapped().task);
  }
  bool has_forgotten() const { return forgotten_; }

 private:
  struct Queued {
    SearchTask task;
    std::size_t bytes = 0;
  };

  void Add(const Motion& from, ContactSequence sequence, size_t sharing) {
    const double loss = from->exact.loss;
    const std::size_t motion = sizeof(Trial) + (from->control.size() + from->durations.size()) * sizeof(double);
    const std::size_t bytes = sizeof(Queued) + sequence.size() * sizeof(Candidate) + motion / sharing;
    bytes_ += bytes;
    SearchTask task{.sequence = std::move(sequence), .from = from};
    queue_.emplace(std::pair(loss, number_++), Queued{std::move(task), bytes});
    while (bytes_ > memory_ && queue_.size() > 1) {
      const auto last = std::prev(queue_.end());
      bytes_ -= last->second.bytes;
      queue_.erase(last);
      forgotten_ = true;
    }
  }

  std::size_t memory_, bytes_ = 0;
  bool forgotten_ = false;
  int number_ = 0;
  std::map<std::pair<double, int>, Queued> queue_;
  std::map<SequenceKey, int> starts_;  // motions from which a sequence is, or is to be, tried
};

// The best motions that are no optima, one of each sequence.
class RunnersUp {
 public:
  void ConsiderTrial(const Trial& trial) {
    const auto known = std::find_if(motions_.begin(), motions_.end(), [&](const auto& other) {
      return other.second->exact.contacts == trial.exact.contacts;
    });
    if (known != motions_.end()) {
      if (known->first <= trial.exact.loss) return;
      motions_.erase(known);
    }
    motions_.emplace(trial.exact.loss, std::make_shared<const Trial>(trial));
    if (motions_.size() > kMostRunnersUp) motions_.erase(std::prev(motions_.end()));
  }
  const std::multimap<double, Motion>& by_loss() const { return motions_; }

 private:
  std::multimap<double, Motion> motions_;
};

class ModeSearch : LimitedSearch {
 public:
  ModeSearch(PhaseRun* run, const SolveRequest& request)
      : LimitedSearch(run->options()),
        run_(*run),
        request_(request),
        scene_(run->scene()),
        bound_(scene_),
        queue_(options_.sequences.limits.memory / 2) {
    const SearchOptions& search = options_.sequences.limits;
    options_.limits.memory = std::min(options_.limits.memory, search.memory / (2 * NumThreads(options_.threads)));
    searched_.lower_bound = bound_.lowest();
  }

  SolveReport Search(const ContactSequence& first) {
    best_trial_ = run_.guess();
    if (options_.sequences.search) {
      BeginWithStarts(first);
    } else {
      starts_left_.push_back(MakeGuessTask(first));
    }
    RunAll([this] { return Next(); });
    if (!end_ && HasMore()) {
      AddLimitRemark(IsLong() ? "no improvement in most of the work"
                              : "no improvement in " + std::to_string(kPatience) + " solves");
    }
    if (options_.sequences.search && !end_) {
      ShareBest();
      UpdateUnstationary();
    }
    return Report();
  }

 private:
  double BestLoss() const { return best_trial_.exact.loss; }
  double Bound() const { return kBound * BestLoss(); }
  // Whether no motion is better than the best optimum. Precondition: there is one.
  bool IsProved() const {
    const double loss = best_optimum_.exact.loss;
    return loss - bound_.lowest() <= kProved * loss;
  }
  // Whether discs or planes that could meet do not in the best motion.
  bool LacksPairs() const {
    const ContactSequence& met = best_trial_.exact.contacts;
    return std::ranges::any_of(AllPairs(scene_), [&](const Candidate& c) { return std::ranges::count(met, c) == 0; });
  }

  // ----------------------------------------------------------------------------------------------------------- solves

  SearchTask MakeGuessTask(const ContactSequence& sequence) const {
    return {.sequence = sequence, .from = std::make_shared<const Trial>(run_.guess())};
  }

  void BeginWithStarts(const ContactSequence& first) {
    const std::vector<Vec2d>& guess = scene_.control.initial;
    if (run_.guess().exact.only_impacts) {
      queue_.NoteTried(first);
      starts_left_.push_back(MakeGuessTask(first));
    }
    starts_left_.push_back({.kind = SearchTask::Kind::kShoot, .forces = guess});
    starts_left_.push_back({.kind = SearchTask::Kind::kDescend, .forces = guess});
    if (run_.guess().exact.only_impacts) AddNeighboursOf(run_.guess());
    searched_.starts = 1;
    AddStarts(0, options_.sequences.limits.starts);
  }

  // Starts from `first` on.
  void AddStarts(int first, int number, bool coarse = false) {
    for (int i = first; i < first + number; ++i) {
      starts_left_.push_back({.kind = SearchTask::Kind::kShoot,
                              .forces = SearchStart(scene_, options_.sequences.limits.seed, i),
                              .coarse = coarse});
    }
    drawn_starts_ += number;
    searched_.starts += number;
  }

  // Where the search has come to a stop: more motions at random, and as many around the best one; others near it are
  // mended. False if there are none.
  bool AddMoreStarts(bool coarse) {
    const int more = kMoreStarts * options_.sequences.limits.starts;
    if (rounds_ == kMostRounds || more == 0) return false;
    if (drawn_ + 2 * more + kMoreMended + kMorePatience > options_.limits.iterations) return false;
    ++rounds_;
    AddStarts(drawn_starts_, more, coarse);
    coarse_around_ = coarse;
    around_best_ = more;
    searched_.starts += more;
    int mended = 0;
    double last = 0;
    for (const auto& [loss, motion] : runners_up_.by_loss()) {
      if (mended == kMoreMended || loss > kNearBest * BestLoss()) break;
      if (loss < kApart * last || !mended_sequences_.insert(KeyOf(motion->exact.contacts)).second) continue;
      ++mended;
      last = loss;
      starts_left_.push_back({.kind = SearchTask::Kind::kMend, .from = motion});
    }
    last_better_ = std::max(last_better_, solves_ + 2 * more + mended - (kPatience - kMorePatience));
    return true;
  }

  // Returns the next task: first those of updates of sequences, then those that updates do not reach.
  std::optional<SearchTask> Next() {
    if (!options_.sequences.search || !starts_left_.empty() || around_best_ > 0) return TakeStart();
    if (auto mend = UpdateBest(best_is_mended_ ? 1 - kSameOptimum : kMuchBetter)) return mend;
    while (HasMore()) {
      if (solves_ - last_better_ > kPatience || IsLong()) {
        if (auto mend = UpdateBest(1 - kSameOptimum)) return mend;
        if (!IsLong() && AddMoreStarts(/*coarse=*/false)) return TakeStart();
        return std::nullopt;
      }
      SearchTask task = queue_.TakeFirst();
      if (bound_.BoundAlongSequence(task.sequence) <= Bound()) return task;
    }
    if (auto mend = UpdateBest(1 - kSameOptimum)) return mend;
    // The neighbours of the optima to which few starts lead may all be worse than a motion to which none of them leads.
    const bool may_find_more = rounds_ < kRoundsAtEnd && !IsLong() && LacksPairs() && !(HasBestOptimum() && IsProved());
    if (drawn_ == solves_ && may_find_more && AddMoreStarts(/*coarse=*/true)) return TakeStart();
    return std::nullopt;
  }

  // Solves along many impacts take so much that the patience in solves would outlast any limit.
  bool IsLong() const {
    return searched_.work > std::max(kLongWork, kPatienceWork * better_work_) &&
           searched_.work * kPatience > kLongPatience * solves_;
  }

  bool HasMore() const { return !queue_.empty() && queue_.first_loss() <= Bound(); }

  std::optional<SearchTask> TakeStart() {
    if (starts_left_.empty()) {
      if (around_best_ == 0) return std::nullopt;
      --around_best_;
      auto start = std::make_shared<Trial>();
      const ControlGuess guess{best_trial_.control, best_trial_.durations};
      start->control = ControlAround(scene_, guess, options_.sequences.limits.seed, number_of_around_++);
      start->durations = guess.durations;
      return SearchTask{.kind = SearchTask::Kind::kShoot, .from = std::move(start), .coarse = coarse_around_};
    }
    SearchTask task = std::move(starts_left_.front());
    starts_left_.pop_front();
    return task;
  }

  // The best motion, if it is no optimum and below this part of the loss of the last one: there may be a kink. One at a
  // time.
  std::optional<SearchTask> UpdateBest(double part) {
    if (mends_ || HasBestOptimum() || mended_ >= kMostMended || !best_trial_.exact.only_impacts) return std::nullopt;
    if (!(best_trial_.exact.loss < part * best_mended_)) return std::nullopt;
    ++mended_;
    mends_ = true;
    mended_sequences_.insert(KeyOf(best_trial_.exact.contacts));
    best_mended_ = best_trial_.exact.loss;
    return SearchTask{.kind = SearchTask::Kind::kMend, .from = std::make_shared<const Trial>(best_trial_)};
  }

  // The best motion, with the intervals that a share of them between phases by their lengths has left unused.
  void ShareBest() {
    const bool optimum = HasBestOptimum();
    const Trial& best = optimum ? best_optimum_ : best_trial_;
    const ContactSequence& sequence = optimum ? best.exact.contacts : best_along_;
    if (sequence.empty() || !best.exact.only_impacts) return;
    const double before = best_optimum_.exact.loss;
    std::optional<SearchTask> share{
        {.kind = SearchTask::Kind::kShare, .sequence = sequence, .from = std::make_shared<const Trial>(best)}};
    RunAll([&] { return std::exchange(share, std::nullopt); });
    const double now = best_optimum_.exact.loss;
    if (optimum && now < before) std::erase_if(optima_, [&](const auto& known) { return known.loss == before; });
  }

  // The best optimum, where arcs have left it off a condition of optimality.
  void UpdateUnstationary() {
    if (end_ || !HasBestOptimum()) return;
    if (!certificate_) certificate_ = CertifyTrial(scene_, best_optimum_);
    if (!IsOff(certificate_)) return;
    std::optional<SearchTask> mend{
        {.kind = SearchTask::Kind::kMend, .from = std::make_shared<const Trial>(best_optimum_)}};
    RunAll([&] { return std::exchange(mend, std::nullopt); });
  }

  // The result of a solve, and whether nothing has cut it short.
  struct Outcome {
    SearchFinding finding;
    bool whole = false;
  };

  void RunAll(const std::function<std::optional<SearchTask>()>& next) {
    TaskQueue<SearchTask, Outcome> line;
    line.draw = [&]() -> std::optional<SearchTask> {
      if (end_) return std::nullopt;
      std::optional<SearchTask> task = next();
      if (!task) return std::nullopt;
      const std::optional<double> most_work = CountDrawn();
      if (!most_work) return std::nullopt;
      task->most_work = *most_work;
      return task;
    };
    line.solve = [this](const SearchTask& task) {
      Outcome outcome;
      if (!Stopped()) outcome.finding = SolveTask(request_, options_, task);
      outcome.whole = !Stopped();
      return outcome;
    };
    line.look = [this](const SearchTask& task, Outcome outcome) {
      if (task.kind == SearchTask::Kind::kMend) mends_ = false;
      if (outcome.whole) {
        ConsumeResult(task, std::move(outcome.finding));
        if (!run_.Record(BestLoss())) end_ = End::kInterrupt;
      } else {
        if (outcome.finding.trial.exact.ok) ConsiderTrial(outcome.finding.trial, "");
        EndByStop();
      }
    };
    line.ahead = [](const SearchTask& task) {
      using Kind = SearchTask::Kind;
      return task.kind == Kind::kMend || task.kind == Kind::kDescend ? kAheadOfLong : 0;
    };
    line.RunAll(NumThreads(options_.threads));
  }

  // ------------------------------------------------------------------------------------------------- what solves found

  void ConsumeResult(const SearchTask& task, SearchFinding finding) {
    ++solves_;
    jacobians_ += finding.jacobians;
    searched_.work += finding.work;
    if (task.kind == SearchTask::Kind::kAlong) tried_.insert(KeyOf(task.sequence));
    ReportStatus(task);
    const Trial& trial = finding.trial;
    if (!trial.exact.ok) return;
    const bool is_best = trial.exact.loss < (1 - kSameOptimum) * BestLoss();
    if (is_best) {
      last_better_ = solves_;
      better_work_ = searched_.work;
      best_is_mended_ = task.kind == SearchTask::Kind::kMend;
      best_along_ = task.kind == SearchTask::Kind::kAlong ? task.sequence : trial.exact.contacts;
    }
    ConsiderTrial(trial, finding.remark);
    for (const Trial& aside : finding.aside) {
      ConsiderTrial(aside, "");
      if (options_.sequences.search) queue_.AddMotion(aside);
    }
    if (!trial.exact.only_impacts) return;
    if (finding.optimal) {
      Keep(trial, std::move(finding.certificate));
    } else if (task.kind != SearchTask::Kind::kMend) {
      runners_up_.ConsiderTrial(trial);
    }
    if (!options_.sequences.search) {
      if (!finding.optimal) failure_ = finding.remark;
      return;
    }
    if (task.kind != SearchTask::Kind::kAlong) {
      tried_.insert(KeyOf(trial.exact.contacts));
      if (!finding.optimal) queue_.AddMotion(trial);
    } else if (is_best && !finding.optimal) {
      queue_.AddMotion(trial);
    } else if (trial.exact.contacts != task.sequence) {  // impacts have appeared or vanished: next in turn
      queue_.AddSequence(std::make_shared<const Trial>(trial), trial.exact.contacts);
    }
    if (!IsNew(trial)) return;
    // Where discs meet again and again, each optimum has a neighbour with one impact more.
    if (trial.exact.contacts.size() > best_trial_.exact.contacts.size() + kMoreImpacts) {
      return AddLimitRemark("neighbours of motions with many more impacts than the best");
    }
    expanded_.insert(ExpansionOf(trial));
    AddNeighboursOf(trial);
  }

  void AddNeighboursOf(const Trial& trial) {
    bool left_out = false;
    const Motion motion = std::make_shared<const Trial>(trial);
    std::vector<ContactSequence> neighbours = NeighboursOf(scene_, trial, &left_out);
    const size_t sharing = neighbours.size();
    for (ContactSequence& next : neighbours) {
      queue_.AddSequence(motion, std::move(next), sharing);
    }
    if (left_out) AddLimitRemark("neighbours far from a touch");
  }

  // Motions whose neighbours are queued: by sequence and loss.
  using Expansion = std::pair<SequenceKey, double>;
  Expansion ExpansionOf(const Trial& trial) const {
    return {KeyOf(trial.exact.contacts), std::round(trial.exact.loss / (kSameOptimum * std::max(kNoLoss, BestLoss())))};
  }
  bool IsNew(const Trial& trial) const {
    return trial.exact.loss <= Bound() && !expanded_.contains(ExpansionOf(trial));
  }

  // A motion that is no optimum, or none yet, but may be better than all.
  void ConsiderTrial(const Trial& trial, const std::string& remark) {
    if (!(trial.exact.loss < best_trial_.exact.loss)) return;
    best_trial_ = trial;
    best_remark_ = remark;
  }

  static bool IsOff(const std::optional<Certificate>& certificate) {
    return certificate && certificate->verdict == Certificate::Verdict::kNotStationary;
  }

  void Keep(const Trial& trial, std::optional<Certificate> certificate) {
    LocalOptimum found{trial.exact.contacts, trial.exact.loss, {}};
    for (const Event& event : trial.exact.events) found.times.push_back(event.time);
    if (LocalOptimum* known = KnownAs(found)) {
      // The best optimum, from another solve: it may meet the conditions that the first one has missed.
      if (known->loss == best_optimum_.exact.loss && IsOff(certificate_) && certificate && !IsOff(certificate)) {
        *known = std::move(found);
        best_optimum_ = trial;
        certificate_ = std::move(certificate);
      }
      return;
    }
    if (optima_.empty() || found.loss < best_optimum_.exact.loss) {
      best_optimum_ = trial;
      certificate_ = std::move(certificate);
    }
    optima_.push_back(std::move(found));
  }

  // Whether no motion is better than the best optimum.
  bool HasBestOptimum() const {
    if (optima_.empty()) return false;
    const double loss = best_optimum_.exact.loss;
    return !(best_trial_.exact.loss < loss - kSameOptimum * std::abs(loss));
  }

  void ReportStatus(const SearchTask& task) const {
    if (!options_.monitor.status) return;
    const bool along = task.kind == SearchTask::Kind::kAlong;
    options_.monitor.status(Status(ConvertLoss(BestLoss(), scene_.units, {})) + ", the last " +
                            (along ? "along " + ContactSequenceToString(scene_, task.sequence) : "from another start"));
  }

  // -------------------------------------------------------------------------------------------------------------- end

  SolveReport Report() {
    if (queue_.has_forgotten()) AddLimitRemark("the limit of memory");
    const std::string limits = LimitsAtEnd();
    const size_t found = optima_.size();
    const bool best_is_optimum = HasBestOptimum();
    searched_.sequences = static_cast<int>(tried_.size());
    run_.report().optima = TakeOptima();
    run_.report().work.evaluations = jacobians_;
    if (options_.sequences.search) run_.report().searched = searched_;
    const Termination end = TerminationOf(best_is_optimum);
    if (!best_is_optimum) {
      std::string reason = best_remark_.empty() ? failure_ : best_remark_;
      if (reason.empty()) {
        reason = found == 0 ? "no solve ended at an optimum" : "no optimum found has a lower loss";
      }
      return run_.Finish(best_trial_, best_trial_.exact.loss, end, reason + limits);
    }
    Certify();
    return run_.Finish(
        best_optimum_,
        best_optimum_.exact.loss,
        end,
        BestOf(found) + ", along " + ContactSequenceToString(scene_, best_optimum_.exact.contacts) + limits);
  }

  Termination TerminationOf(bool best_is_optimum) const {
    if (end_ == End::kInterrupt) return Termination::kInterrupted;
    if (end_ == End::kIterations) return Termination::kIterationLimit;
    return best_is_optimum ? Termination::kConverged : Termination::kNoProgress;
  }

  // Sets the certificate of the best optimum.
  void Certify() {
    if (!certificate_) certificate_ = CertifyTrial(scene_, best_optimum_);
    certificate_->sequences_searched = searched_.sequences;
    if (options_.sequences.search && end_ != End::kInterrupt && !certificate_->IsSaddle()) {
      certificate_->scope = Certificate::Scope::kBestOfSearched;
    }
    if (certificate_->verdict == Certificate::Verdict::kStationary && IsProved()) {
      certificate_->verdict = Certificate::Verdict::kGlobal;
    }
    run_.report().certificate = std::move(certificate_);
  }

  PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
  LossBound bound_;
  std::deque<SearchTask> starts_left_;  // which come before the queue
  int around_best_ = 0;                 // starts around the best motion, which come after them
  int number_of_around_ = 0, drawn_starts_ = 0;
  RunnersUp runners_up_;
  SearchQueue queue_;
  std::set<SequenceKey> tried_, mended_sequences_;
  std::set<Expansion> expanded_;
  Trial best_optimum_;
  std::optional<Certificate> certificate_;  // of it
  Trial best_trial_;                        // of all motions met, the guess included
  ContactSequence best_along_;              // the sequence along which it was found, which it need not have
  std::string best_remark_;                 // why it is no optimum
  std::string failure_;
  double best_mended_ = std::numeric_limits<double>::infinity();  // loss of the last motion mended
  double better_work_ = 0;                                        // done when the search was last better
  int last_better_ = 0, rounds_ = 0, mended_ = 0, jacobians_ = 0;
  bool coarse_around_ = false;  // the starts around the best motion are coarse
  bool mends_ = false;          // a motion is being mended
  bool best_is_mended_ = false;
};

}  // namespace

std::string UnsupportedByModeSearch(const SolveRequest& request) {
  return IsExact(request) ? UnsupportedByCeresPhases(request) : UnsupportedByEventPhases(request);
}

SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options) {
  const bool arcs_can = NonTerminalFeatures(request.scene).empty() && UnsupportedByEventPhases(request).empty();
  if (!arcs_can) return SearchByPhases(request, options);
  PhaseRun run("mode_search", request, options);
  if (auto refused = options.sequences.search ? run.MotionFailure() : run.StartFailure()) return *refused;
  return ModeSearch(&run, request).Search(SequenceFor(options, run.guess()));
}

}  // namespace saltus
