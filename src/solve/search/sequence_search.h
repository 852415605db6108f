// A search over sequences of events by solves that update their sequence (sequence_update.h), whatever the system.
//
// The solves begin from
//
//   the initial guess
//   the best motion of a relaxed problem, if there is one, and the sequences of its other optima
//   motions at random
//
// and go on along the neighbours of the best optimum, whose sequences have one event inserted, removed or replaced,
// each from that optimum, until none is better.
//
// Rule, by which a search is complete: the neighbours of the best optimum, and of those before it, are all tried; or
// the loss is a sum of squares and zero.
// Limits, which leave it incomplete: `iterations` solves, SearchOptions, an interrupt, neighbours left out of very
// many. Solves are looked at in one order, whatever the threads (task_queue.h).
//
// Problem is what is searched (of a scene in phase_search.cc, of a hybrid system in hybrid_search.cc):
//
//   Run                                        as of phase_plan.h
//   SolveRelaxed(options)                      the optima of the relaxed problem
//   BeginAtRandom(seed, number)                a motion, or nothing if there is nothing to be drawn
//   NeighboursOf(trial, &left_out)             the sequences
//   Shoot(options, &trial)                     a motion nearer to the targets, by shooting; the gradients computed
//   SolveAlong(trial, start, most_loss, options)  one solve from a motion, the start or that of Shoot, which is given
//   up
//                                              where no optimum has a loss below `most_loss`; this and Shoot are called
//                                              by several threads at the same time
//   WorkByRollout(), WorkBySteps()             of a gradient by shooting and of a Jacobian, as SearchOptions::work
//   AllCostsAreSquares(), LossForUser(loss), OptimumOf(trial), kLeftOut
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/parallel_for.h"
#include "saltus/solve/solver.h"
#include "solve/phases/sequence_run.h"
#include "solve/search/task_queue.h"

namespace saltus {

// Where a solve begins: a motion, or what is to be made one by shooting; along a sequence, or that of the motion.
template <typename Run>
struct SearchStartOf {
  typename Run::Motion trial;
  bool shoot = false;
  std::optional<std::vector<typename Run::Event>> sequence = std::nullopt;
  bool is_guess = false;  // the start of the user, which is not given up for others
};

template <typename Motion>
struct FindingOf {
  Motion trial;
  SolveReport report;
  int shooting = 0;  // gradients of the solve by shooting before it
};

template <typename Run>
struct RelaxedOptima {
  std::optional<typename Run::Motion> best;
  std::vector<std::pair<double, std::vector<typename Run::Event>>> others;  // their losses and sequences, best first
  bool is_bound = false;  // what is left out only makes a sequence dearer
  int evaluations = 0;
  double work = 0;
};

// In words: the optimum that a search ends with, of all that it has found.
inline std::string BestOf(size_t optima) {
  return optima == 1 ? "the only optimum found" : "best of " + std::to_string(optima) + " optima";
}
// Returns `iterations`, or as many as the work allows if each takes `each`, at least one.
inline int IterationsWithin(double most_work, double each, int iterations) {
  return static_cast<int>(std::min<double>(iterations, std::max(1.0, most_work / each)));
}

inline constexpr double kSameOptimum = 1e-6;  // relative, between losses along one sequence

// Common parts of all searches: their limits, which are `iterations` solves, SearchOptions and an interrupt; and the
// optima that they have found.
class LimitedSearch {
 protected:
  // The limits that end a search.
  enum class End { kInterrupt, kTime, kWork, kIterations };

  explicit LimitedSearch(const SolverOptions& options) : options_(options), interrupt_(options.monitor.stop) {
    options_.monitor.stop = StopAfter(options.sequences.limits.seconds, interrupt_);
    searched_.complete = true;
  }

  bool Stopped() const { return options_.monitor.stop && options_.monitor.stop(); }
  void EndByStop() { end_ = interrupt_ && interrupt_() ? End::kInterrupt : End::kTime; }

  // Counts one more solve: the work that it may take (SearchOptions::work), or nothing where a limit ends the search.
  std::optional<double> CountDrawn() {
    const double most_work = options_.sequences.limits.work;
    if (most_work > 0 && searched_.work >= most_work) {
      end_ = End::kWork;
    } else if (drawn_++ >= options_.limits.iterations) {
      end_ = End::kIterations;
    } else {
      return most_work > 0 ? most_work - searched_.work : std::numeric_limits<double>::infinity();
    }
    return std::nullopt;
  }

  // Notes that something is not tried, and why.
  void AddLimitRemark(const std::string& why) {
    searched_.complete = false;
    if (!why.empty() && left_.find(why) == std::string::npos) left_ += (left_.empty() ? "" : ", ") + why;
  }
  // Returns the parts that limits have prevented; empty if there are none. The search is over.
  std::string LimitsAtEnd() {
    static constexpr const char* kLimits[] = {"", "the limit of time", "the limit of work", "the limit of iterations"};
    if (end_) AddLimitRemark(kLimits[static_cast<int>(*end_)]);
    return left_.empty() ? "" : "not complete: " + left_;
  }

  // In words, after each solve.
  std::string Status(double best_loss) const {
    return std::to_string(solves_) + (solves_ == 1 ? " solve" : " solves") + ", best loss " + std::to_string(best_loss);
  }

  // Returns the known optimum of the sequence that is the same as `found`, null if there is none.
  LocalOptimum* KnownAs(const LocalOptimum& found) {
    const auto known = std::ranges::find_if(optima_, [&](const LocalOptimum& other) {
      return other.sequence == found.sequence &&
             std::abs(other.loss - found.loss) <= kSameOptimum * std::abs(found.loss);
    });
    return known == optima_.end() ? nullptr : &*known;
  }
  std::vector<LocalOptimum> TakeOptima() {
    std::ranges::stable_sort(optima_, {}, &LocalOptimum::loss);
    return std::move(optima_);
  }

  SolverOptions options_;  // with its own limits
  std::vector<LocalOptimum> optima_;
  SearchStatistics searched_;
  int drawn_ = 0, solves_ = 0;
  std::optional<End> end_;

 private:
  StopRequest interrupt_;
  std::string left_;  // what limits have kept it from
};

namespace sequence_search {

inline constexpr double kShareRelaxed = 0.3;     // of the limits, for the problem without constraints
inline constexpr size_t kMostRelaxedOptima = 8;  // whose sequences are tried
inline constexpr int kIterationsUpdating = 1000;
inline constexpr int kIterationsAlong = 400;    // of a neighbour, which begins near an optimum
inline constexpr int kIterationsShooting = 30;  // from random starts
inline constexpr size_t kMostNeighbours = 200;  // of a sequence, that are tried
inline constexpr double kZero = 1e-12;          // of the loss of the initial guess
inline constexpr double kMuchWorse = 2;         // relative excess of a loss over that of the best optimum

}  // namespace sequence_search

template <typename Problem>
class SequenceSearch : LimitedSearch {
 public:
  SequenceSearch(typename Problem::Run* run, const Problem& problem)
      : LimitedSearch(run->options()), run_(*run), problem_(problem) {}

  SolveReport Search() {
    searched_.starts = 1;
    SolveAll({{run_.guess(), false, run_.given_sequence(), /*is_guess=*/true}});
    if (!options_.sequences.search || IsZero()) return Report();
    std::vector<Start> along;
    SolveAll(FirstStarts(&along));
    SolveAll(std::move(along));
    while (!end_ && best_ && !IsZero()) {
      std::vector<Start> neighbours = NeighboursOfBest();
      if (neighbours.empty()) break;
      SolveAll(std::move(neighbours));
    }
    return Report();
  }

 private:
  using Trial = typename Problem::Run::Motion;
  using Sequence = std::vector<typename Problem::Run::Event>;
  using Start = SearchStartOf<typename Problem::Run>;
  using Finding = FindingOf<Trial>;

  // The next start to solve from, the work that the solve may take (SearchOptions::work), and the loss above which an
  // optimum is of no use.
  struct Draw {
    const Start* start;
    double most_work, most_loss;
  };

  // Whether no motion can have a lower loss.
  bool IsZero() const {
    const double first = run_.report().history.losses.front();
    return best_ && std::isfinite(first) && problem_.AllCostsAreSquares() && MeetsConstraints(best_->trial) &&
           best_->report.termination == Termination::kConverged &&
           best_->trial.exact.loss <= sequence_search::kZero * first;
  }

  double BestLoss() const { return best_ ? best_->trial.exact.loss : run_.report().history.losses.front(); }

  // ----------------------------------------------------------------------------------------------------------- starts

  std::vector<Start> FirstStarts(std::vector<Start>* along) {
    std::vector<Start> starts;
    SearchRelaxed(&starts, along);
    for (int i = 0; i < options_.sequences.limits.starts && !Stopped(); ++i) {
      std::optional<Trial> trial = problem_.BeginAtRandom(options_.sequences.limits.seed, i);
      if (!trial) break;
      starts.push_back({std::move(*trial), true});
    }
    searched_.starts = 1 + static_cast<int>(starts.size());
    return starts;
  }

  void SearchRelaxed(std::vector<Start>* starts, std::vector<Start>* along) {
    if (end_) return;
    SolverOptions own = options_;
    own.monitor.callback = nullptr;
    own.monitor.status = nullptr;
    own.sequences.given.reset();
    own.guess.reset();
    own.sequences.limits.seconds *= sequence_search::kShareRelaxed;
    own.sequences.limits.work *= sequence_search::kShareRelaxed;
    RelaxedOptima<typename Problem::Run> found = problem_.SolveRelaxed(own);
    run_.report().work.evaluations += found.evaluations;
    searched_.work += found.work;
    if (!found.best) return;
    starts->push_back({*found.best, false});
    // Sequences whose loss without constraints is higher are of no use, as constraints only raise it.
    const bool prunes = best_ && found.is_bound && MeetsConstraints(best_->trial);
    for (auto& [loss, sequence] : found.others) {
      if (along->size() == sequence_search::kMostRelaxedOptima || (prunes && !(loss < BestLoss()))) break;
      if (sequence != found.best->exact.contacts) along->push_back({*found.best, false, std::move(sequence)});
    }
  }

  std::vector<Start> NeighboursOfBest() {
    const Trial& trial = best_->trial;
    if (!trial.exact.only_impacts || std::count(expanded_.begin(), expanded_.end(), trial.exact.contacts) > 0) {
      return {};
    }
    expanded_.push_back(trial.exact.contacts);
    bool left_out = false;
    std::vector<Start> starts;
    for (Sequence& next : problem_.NeighboursOf(trial, &left_out)) {
      if (std::count(tried_.begin(), tried_.end(), next) > 0) continue;
      starts.push_back({trial, false, std::move(next)});
    }
    if (left_out) AddLimitRemark(Problem::kLeftOut);
    return starts;
  }

  // ----------------------------------------------------------------------------------------------------------- solves

  void SolveAll(const std::vector<Start>& starts) {
    auto next = starts.begin();
    TaskQueue<Draw, Finding> line;
    line.draw = [&]() -> std::optional<Draw> {
      if (Stopped()) EndByStop();
      if (end_ || next == starts.end() || IsZero()) return std::nullopt;
      const std::optional<double> most_work = CountDrawn();
      if (!most_work) return std::nullopt;
      const Start& start = *next++;
      return Draw{&start, *most_work, LossLimit(start)};
    };
    line.solve = [this](const Draw& draw) { return Stopped() ? Finding{} : SolveFrom(draw); };
    line.look = [this](const Draw& draw, Finding finding) {
      if (finding.report.solver.empty()) return EndByStop();  // not begun
      if (const auto& sequence = draw.start->sequence) {
        tried_.push_back(*sequence);
        AddIfNew(*sequence, &searched_along_);
      }
      ConsumeResult(std::move(finding));
      if (!run_.Record(BestLoss())) end_ = End::kInterrupt;
    };
    line.RunAll(NumThreads(options_.threads));
    if (Stopped()) EndByStop();
  }

  // Near the best optimum a sequence of its neighbourhood has to be better; elsewhere other optima are reported too.
  double LossLimit(const Start& start) const {
    if (!best_ || start.is_guess || !MeetsConstraints(best_->trial)) return INFINITY;
    const double loss = best_->trial.exact.loss;
    return loss + (start.sequence ? kSameOptimum : sequence_search::kMuchWorse) * std::abs(loss);
  }

  Finding SolveFrom(const Draw& draw) const {
    const auto& [start_of_draw, most_work, most_loss] = draw;
    const Start& start = *start_of_draw;
    SolverOptions own;
    own.monitor.stop = options_.monitor.stop;
    own.sequences.search = options_.sequences.search;
    Trial from = start.trial;
    int shooting = 0;
    if (start.shoot) {
      own.limits.iterations =
          IterationsWithin(most_work, problem_.WorkByRollout(), sequence_search::kIterationsShooting);
      shooting = problem_.Shoot(own, &from);
    }
    own.limits.iterations =
        IterationsWithin(most_work,
                         problem_.WorkBySteps(),
                         start.sequence ? sequence_search::kIterationsAlong : sequence_search::kIterationsUpdating);
    Finding finding = problem_.SolveAlong(std::move(from), start, most_loss, own);
    finding.shooting = shooting;
    return finding;
  }

  void ConsumeResult(Finding finding) {
    ++solves_;
    run_.report().work.evaluations += finding.report.work.evaluations + finding.shooting;
    searched_.work +=
        finding.report.work.evaluations * problem_.WorkBySteps() + finding.shooting * problem_.WorkByRollout();
    if (options_.monitor.status) options_.monitor.status(Status(problem_.LossForUser(BestLoss())));
    const Trial& trial = finding.trial;
    if (!trial.exact.ok) {
      if (!best_ && reason_.empty()) reason_ = finding.report.reason;
      return;
    }
    AddIfNew(trial.exact.contacts, &searched_along_);
    if (finding.report.termination == Termination::kConverged) {
      LocalOptimum found = problem_.OptimumOf(trial);
      if (!KnownAs(found)) optima_.push_back(std::move(found));
    }
    if (!best_ || IsBetter(finding)) best_ = std::move(finding);
  }

  bool MeetsConstraints(const Trial& trial) const { return run_.ViolationOf(trial) <= kFeasible; }

  static void AddIfNew(const Sequence& sequence, std::vector<Sequence>* sequences) {
    if (std::count(sequences->begin(), sequences->end(), sequence) == 0) sequences->push_back(sequence);
  }

  // Whether a finding is better; optima that meet all constraints come first.
  bool IsBetter(const Finding& finding) const {
    const bool mine = MeetsConstraints(finding.trial), other = MeetsConstraints(best_->trial);
    if (mine != other) return mine;
    const double merit = run_.MeritOf(finding.trial), least = run_.MeritOf(best_->trial);
    if (merit < least - kSameOptimum * std::abs(least)) return true;
    const auto converged = [](const Finding& f) { return f.report.termination == Termination::kConverged; };
    return merit < least + kSameOptimum * std::abs(least) && converged(finding) && !converged(*best_);
  }

  // -------------------------------------------------------------------------------------------------------------- end

  SolveReport Report() {
    const std::string limits = LimitsAtEnd();
    const auto with_limits = [&](const std::string& reason) {
      return reason + (reason.empty() || limits.empty() ? "" : "; ") + limits;
    };
    searched_.sequences = static_cast<int>(searched_along_.size());
    const size_t found = optima_.size();
    run_.report().optima = TakeOptima();
    if (options_.sequences.search) run_.report().searched = searched_;
    if (!best_) {
      const Trial& guess = run_.guess();
      const Termination none = end_ == End::kInterrupt ? Termination::kInterrupted : Termination::kNoProgress;
      return run_.Finish(guess, guess.exact.loss, none, with_limits(reason_));
    }
    SolveReport& best = best_->report;
    const bool converged = best.termination == Termination::kConverged;
    run_.report().certificate = std::move(best.certificate);
    if (auto& certificate = run_.report().certificate; certificate && converged) {
      certificate->sequences_searched = searched_.sequences;
      if (options_.sequences.search && end_ != End::kInterrupt) {
        certificate->scope = Certificate::Scope::kBestOfSearched;
      }
    }
    Termination end = best.termination;
    if (end_ == End::kInterrupt) end = Termination::kInterrupted;
    if (end_ == End::kIterations) end = Termination::kIterationLimit;
    const Trial trial = best_->trial;
    const std::string sequence = run_.NameOf(trial.exact.contacts);
    const std::string zero =
        options_.sequences.search && IsZero() ? ", with a loss of zero, which ends the search" : "";
    const std::string reason = converged ? BestOf(found) + ", along " + sequence + zero : best.reason;
    return run_.Finish(trial, trial.exact.loss, end, with_limits(reason));
  }

  typename Problem::Run& run_;
  const Problem& problem_;
  std::optional<Finding> best_;
  std::vector<Sequence> tried_;           // that were given to a solve
  std::vector<Sequence> searched_along_;  // these, and those that solves have ended with
  std::vector<Sequence> expanded_;        // whose neighbours are tried
  std::string reason_;                    // why nothing was found
};

}  // namespace saltus
