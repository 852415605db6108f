#include "mode_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "ceres_phases.h"
#include "control/parallel_for.h"
#include "loss_bound.h"
#include "phase_run.h"
#include "phase_search.h"
#include "physics/units.h"
#include "saltus/control/objective.h"
#include "search_solve.h"
#include "search_starts.h"

namespace saltus {
namespace {

constexpr int kStarts = 3;          // motions from which a sequence is tried
constexpr double kBound = 3;        // times the best loss
constexpr double kSameLoss = 1e-6;  // relative: the same optimum of a sequence
constexpr double kNoLoss = 1e-12;   // in natural units: to be compared with nothing smaller
constexpr double kProved = 1e-8;    // relative, between the best loss and a lower bound
constexpr int kPatience = 250;      // solves after which nothing better is expected
constexpr int kMoreStarts = 3;      // times the starts, that are tried then
constexpr int kMorePatience = 120;  // solves after those
constexpr int kBatch = 8;           // solves between two looks at what they found
constexpr int kMostMended = 12;     // motions whose sequence is mended

// A sequence as something to be compared.
using Key = std::vector<std::array<int, 3>>;
Key KeyOf(const ContactSequence& sequence) {
  Key key;
  for (const Candidate& c : sequence) key.push_back({c.a, c.b, c.plane});
  return key;
}

class ModeSearch {
 public:
  ModeSearch(PhaseRun* run, const SolveRequest& request)
      : run_(*run), request_(request), scene_(run->scene()), options_(run->options()), bound_(scene_) {
    const SearchOptions& search = options_.search_options;
    options_.stop = StopAfter(search.seconds, run->options().stop);
    options_.memory_limit = std::min(options_.memory_limit, search.memory / (2 * NumThreads(options_.threads)));
    searched_.lower_bound = bound_.lowest();
    searched_.complete = true;
  }

  SolveReport Search(const ContactSequence& first) {
    best_trial_ = run_.guess();
    if (!options_.search) {
      SolveBatch({AlongFrom(run_.guess(), first)});
      return Report();
    }
    SolveStarts(first);
    while (!end_) {  // the moves of mending come first, then what they do not reach
      if (MendBest()) continue;
      if (queue_.empty() || queue_.begin()->first.first > Bound()) break;
      if (solves_ - last_better_ > kPatience) {
        if (SolveMoreStarts()) continue;
        Leave("nothing better in " + std::to_string(kPatience) + " solves");
        break;
      }
      SolveNext();
    }
    if (!end_) ShareBest();
    return Report();
  }

 private:
  struct Queued {
    SearchTask task;
    std::size_t bytes = 0;
  };
  using Queue = std::map<std::pair<double, int>, Queued>;  // by exact loss of the motion it comes from, then in order

  // What a limit ends.
  enum class End { kInterrupt, kTime, kIterations };

  double BestLoss() const { return best_trial_.exact.loss; }
  double Bound() const { return kBound * BestLoss(); }
  bool Stopped() const { return options_.stop && options_.stop(); }

  // ------------------------------------------------------------------------------------------------------------ queue

  SearchTask AlongFrom(const Trial& trial, const ContactSequence& sequence) const {
    return {.sequence = sequence, .guess = GuessFrom(scene_, FlightOf(scene_, trial), sequence)};
  }

  void Add(double priority, SearchTask task) {
    const std::size_t bytes = task.bytes();
    bytes_ += bytes;
    queue_.emplace(std::pair(priority, number_++), Queued{std::move(task), bytes});
    while (bytes_ > options_.search_options.memory / 2 && queue_.size() > 1) {
      const auto last = std::prev(queue_.end());
      bytes_ -= last->second.bytes;
      queue_.erase(last);
      Leave("the limit of memory");
    }
  }

  // A sequence and where to start along it, unless it has been tried from enough motions.
  void AddSequence(double priority, SearchTask task) {
    int& starts = starts_[KeyOf(task.sequence)];
    if (starts >= kStarts) return;
    ++starts;
    Add(priority, std::move(task));
  }

  // Whatever its sequence has been tried from.
  void AddMotion(double priority, const Trial& trial) {
    if (!trial.exact.only_impacts) return;
    ++starts_[KeyOf(trial.exact.contacts)];
    Add(priority, AlongFrom(trial, trial.exact.contacts));
  }

  SearchTask TakeFirst() {
    auto node = queue_.extract(queue_.begin());
    bytes_ -= node.mapped().bytes;
    return std::move(node.mapped().task);
  }

  // Something is not tried.
  void Leave(const std::string& why) {
    searched_.complete = false;
    if (!why.empty() && left_.find(why) == std::string::npos) left_ += (left_.empty() ? "" : ", ") + why;
  }

  // ----------------------------------------------------------------------------------------------------------- solves

  void SolveStarts(const ContactSequence& first) {
    std::vector<SearchTask> tasks;
    const std::vector<Vec2d>& guess = scene_.control.initial;
    if (run_.guess().exact.only_impacts) {
      ++starts_[KeyOf(first)];
      tasks.push_back(AlongFrom(run_.guess(), first));
    }
    tasks.push_back({.kind = SearchTask::Kind::kShoot, .forces = guess});
    tasks.push_back({.kind = SearchTask::Kind::kDescend, .forces = guess});
    if (run_.guess().exact.only_impacts) AddNeighboursOf(run_.guess());
    searched_.starts = 1;
    AddStarts(0, options_.search_options.starts, &tasks);
    SolveInBatches(std::move(tasks));
  }

  // Starts from `first` on.
  void AddStarts(int first, int number, std::vector<SearchTask>* tasks) {
    for (int i = first; i < first + number; ++i) {
      tasks->push_back(
          {.kind = SearchTask::Kind::kShoot, .forces = SearchStart(scene_, options_.search_options.seed, i)});
    }
    searched_.starts += number;
  }

  // Once, where the search has come to a stop: from more motions. False if there are none.
  bool SolveMoreStarts() {
    const int starts = options_.search_options.starts;
    if (searched_.starts != 1 + starts || starts == 0) return false;
    std::vector<SearchTask> tasks;
    AddStarts(starts, kMoreStarts * starts, &tasks);
    SolveInBatches(std::move(tasks));
    last_better_ = std::max(last_better_, solves_ - (kPatience - kMorePatience));
    return true;
  }

  void SolveInBatches(std::vector<SearchTask> tasks) {
    for (size_t i = 0; i < tasks.size() && !end_; i += kBatch) {
      const auto begin = tasks.begin() + i, end = tasks.begin() + std::min(tasks.size(), i + kBatch);
      SolveBatch({std::make_move_iterator(begin), std::make_move_iterator(end)});
    }
  }

  void SolveNext() {
    std::vector<SearchTask> tasks;
    while (!queue_.empty() && tasks.size() < kBatch && queue_.begin()->first.first <= Bound()) {
      SearchTask task = TakeFirst();
      if (bound_.Along(task.sequence) <= Bound()) tasks.push_back(std::move(task));
    }
    SolveBatch(std::move(tasks));
  }

  // The best motion, if it is no optimum and its sequence has not been mended: there may be a kink.
  bool MendBest() {
    if (HasBestOptimum() || mended_ >= kMostMended || !best_trial_.exact.only_impacts) return false;
    if (!(best_trial_.exact.loss < (1 - kSameLoss) * best_mended_)) return false;
    ++mended_;
    best_mended_ = best_trial_.exact.loss;
    SolveBatch({{.kind = SearchTask::Kind::kMend, .from = std::make_shared<const Trial>(best_trial_)}});
    return true;
  }

  // The best optimum, with the intervals that a share of them between phases by their lengths has left unused.
  void ShareBest() {
    if (!HasBestOptimum() || best_optimum_.exact.contacts.empty()) return;
    const double before = best_optimum_.exact.loss;
    SolveBatch({{.kind = SearchTask::Kind::kShare,
                 .sequence = best_optimum_.exact.contacts,
                 .from = std::make_shared<const Trial>(best_optimum_)}});
    const double now = best_optimum_.exact.loss;
    if (now < before) std::erase_if(optima_, [&](const LocalOptimum& known) { return known.loss == before; });
  }

  void SolveBatch(std::vector<SearchTask> tasks) {
    const int allowed = options_.iterations - solves_;
    if (allowed < static_cast<int>(tasks.size())) {
      tasks.resize(std::max(0, allowed));
      end_ = End::kIterations;
    }
    std::vector<SearchFinding> findings(tasks.size());
    std::vector<char> whole(tasks.size(), 0);  // nothing has cut the solve short
    const auto wants_neighbours = [&](const Trial& trial) { return options_.search && IsNew(trial); };
    ParallelFor(NumThreads(options_.threads), static_cast<int>(tasks.size()), [&](int, int i) {
      if (Stopped()) return;
      findings[i] = SolveTask(request_, options_, tasks[i], wants_neighbours);
      whole[i] = !Stopped();
    });
    for (size_t i = 0; i < tasks.size(); ++i) {
      if (whole[i]) {
        Look(tasks[i], std::move(findings[i]));
        if (!run_.Record(BestLoss())) end_ = End::kInterrupt;
      } else if (findings[i].trial.exact.ok) {
        Meet(findings[i].trial, "");
      }
    }
    if (!Stopped()) return;
    const StopRequest& interrupt = run_.options().stop;
    end_ = interrupt && interrupt() ? End::kInterrupt : End::kTime;
  }

  // ------------------------------------------------------------------------------------------------- what solves found

  void Look(const SearchTask& task, SearchFinding finding) {
    ++solves_;
    jacobians_ += finding.jacobians;
    if (task.kind == SearchTask::Kind::kAlong) tried_.insert(KeyOf(task.sequence));
    Say(task);
    const Trial& trial = finding.trial;
    if (!trial.exact.ok) return;
    const bool is_best = trial.exact.loss < (1 - kSameLoss) * BestLoss();
    if (is_best) last_better_ = solves_;
    Meet(trial, finding.remark);
    for (const Trial& aside : finding.aside) {
      Meet(aside, "");
      if (options_.search) AddMotion(aside.exact.loss, aside);
    }
    if (!trial.exact.only_impacts) return;
    if (finding.optimal) Keep(trial, std::move(finding.certificate));
    if (!options_.search) {
      if (!finding.optimal) failure_ = finding.remark;
      return;
    }
    if (task.kind != SearchTask::Kind::kAlong) {
      tried_.insert(KeyOf(trial.exact.contacts));
      if (!finding.optimal) AddMotion(trial.exact.loss, trial);
    } else if (is_best && !finding.optimal) {
      AddMotion(trial.exact.loss, trial);
    } else if (trial.exact.contacts != task.sequence) {  // impacts have appeared or vanished: next in turn
      AddSequence(trial.exact.loss, AlongFrom(trial, trial.exact.contacts));
    }
    if (finding.neighbours.empty() || !IsNew(trial)) return;
    expanded_.insert(ExpansionOf(trial));
    if (finding.neighbours_left_out) Leave("neighbours far from a touch");
    for (SearchNeighbour& next : finding.neighbours) {
      AddSequence(trial.exact.loss, {.sequence = std::move(next.sequence), .guess = std::move(next.guess)});
    }
  }

  void AddNeighboursOf(const Trial& trial) {
    bool left_out = false;
    for (SearchNeighbour& next : NeighboursOf(scene_, trial, &left_out)) {
      AddSequence(trial.exact.loss, {.sequence = std::move(next.sequence), .guess = std::move(next.guess)});
    }
    if (left_out) Leave("neighbours far from a touch");
  }

  // Motions whose neighbours are queued: by sequence and loss.
  using Expansion = std::pair<Key, double>;
  Expansion ExpansionOf(const Trial& trial) const {
    return {KeyOf(trial.exact.contacts), std::round(trial.exact.loss / (kSameLoss * std::max(kNoLoss, BestLoss())))};
  }
  bool IsNew(const Trial& trial) const {
    return trial.exact.loss <= Bound() && !expanded_.contains(ExpansionOf(trial));
  }

  // A motion that is no optimum, or none yet, but may be better than all.
  void Meet(const Trial& trial, const std::string& remark) {
    if (!(trial.exact.loss < best_trial_.exact.loss)) return;
    best_trial_ = trial;
    best_remark_ = remark;
  }

  void Keep(const Trial& trial, std::optional<Certificate> certificate) {
    LocalOptimum found{trial.exact.contacts, trial.exact.loss, {}};
    for (const Event& event : trial.exact.events) found.times.push_back(event.time);
    for (const LocalOptimum& known : optima_) {
      const double difference = std::abs(known.loss - found.loss);
      if (known.sequence == found.sequence && difference <= kSameLoss * std::abs(found.loss)) return;
    }
    if (optima_.empty() || found.loss < best_optimum_.exact.loss) {
      best_optimum_ = trial;
      certificate_ = std::move(certificate);
    }
    optima_.push_back(std::move(found));
  }

  // No motion met is better than the best optimum.
  bool HasBestOptimum() const {
    if (optima_.empty()) return false;
    const double loss = best_optimum_.exact.loss;
    return !(best_trial_.exact.loss < loss - kSameLoss * std::abs(loss));
  }

  void Say(const SearchTask& task) const {
    if (!run_.options().status) return;
    const bool along = task.kind == SearchTask::Kind::kAlong;
    run_.options().status(std::to_string(solves_) + " sequences, best " +
                          std::to_string(ConvertLoss(BestLoss(), scene_.units, {})) + ", now " +
                          (along ? ContactSequenceToString(scene_, task.sequence) : "another start"));
  }

  // -------------------------------------------------------------------------------------------------------------- end

  SolveReport Report() {
    if (end_)
      Leave(*end_ == End::kIterations ? "the limit of iterations" : *end_ == End::kTime ? "the limit of time" : "");
    std::stable_sort(optima_.begin(), optima_.end(), [](const auto& a, const auto& b) { return a.loss < b.loss; });
    const size_t found = optima_.size();
    const bool best_is_optimum = HasBestOptimum();
    searched_.sequences = static_cast<int>(tried_.size());
    run_.report().optima = std::move(optima_);
    run_.report().evaluations = jacobians_;
    if (options_.search) run_.report().searched = searched_;
    const Termination end = TerminationOf(best_is_optimum);
    const std::string limits = left_.empty() ? "" : "; not complete: " + left_;
    if (!best_is_optimum) {
      std::string reason = best_remark_.empty() ? failure_ : best_remark_;
      if (reason.empty()) {
        reason = found == 0 ? "no sequence searched has an optimum" : "no optimum found is better";
      }
      return run_.Finish(best_trial_, best_trial_.exact.loss, end, reason + limits);
    }
    Certify();
    return run_.Finish(best_optimum_,
                       best_optimum_.exact.loss,
                       end,
                       "best of " + std::to_string(found) + " optima, along " +
                           ContactSequenceToString(scene_, best_optimum_.exact.contacts) + limits);
  }

  Termination TerminationOf(bool best_is_optimum) const {
    if (end_ == End::kInterrupt) return Termination::kInterrupted;
    if (end_ == End::kIterations) return Termination::kIterationLimit;
    return best_is_optimum ? Termination::kConverged : Termination::kNoProgress;
  }

  // What is known of the best optimum.
  void Certify() {
    if (!certificate_) certificate_ = CertifyTrial(scene_, best_optimum_);
    certificate_->sequences_searched = searched_.sequences;
    if (options_.search && end_ != End::kInterrupt && !certificate_->IsSaddle()) {
      certificate_->scope = Certificate::Scope::kBestOfSearched;
    }
    const double loss = best_optimum_.exact.loss;
    if (certificate_->verdict == Certificate::Verdict::kStationary && loss - bound_.lowest() <= kProved * loss) {
      certificate_->verdict = Certificate::Verdict::kGlobal;
    }
    run_.report().certificate = std::move(certificate_);
  }

  PhaseRun& run_;
  const SolveRequest& request_;
  const Scene& scene_;
  SolverOptions options_;  // with its own limits
  LossBound bound_;
  Queue queue_;
  std::size_t bytes_ = 0;      // of the queue
  std::map<Key, int> starts_;  // motions from which a sequence is, or is to be, tried
  std::set<Key> tried_;        // sequences
  std::set<Expansion> expanded_;
  std::vector<LocalOptimum> optima_;
  Trial best_optimum_;
  std::optional<Certificate> certificate_;  // of it
  Trial best_trial_;                        // of all motions met, the guess included
  std::string best_remark_;                 // why it is no optimum
  std::string failure_;
  std::string left_;  // what limits have kept it from
  Searched searched_;
  double best_mended_ = std::numeric_limits<double>::infinity();  // loss of the last motion mended
  int number_ = 0, solves_ = 0, last_better_ = 0, mended_ = 0, jacobians_ = 0;
  std::optional<End> end_;
};

}  // namespace

std::string WhyNotModeSearch(const SolveRequest& request) {
  return IsExact(request) ? WhyNotPhases(request) : WhyNotEventPhases(request);
}

SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options) {
  const bool arcs_can =
      request.terms.empty() && BeyondTerminalCost(request.scene).empty() && WhyNotEventPhases(request).empty();
  if (!arcs_can) return SearchByPhases(request, options);
  PhaseRun run("mode_search", request, options);
  if (auto refused = options.search ? run.WhyNoMotion() : run.WhyNotStart()) return *refused;
  return ModeSearch(&run, request).Search(SequenceFor(options, run.guess()));
}

}  // namespace saltus
