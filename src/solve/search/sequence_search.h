// A search over sequences of events by solves that update their sequence (sequence_update.h), whatever the system.
//
// The solves begin from
//
//   the initial guess, and the ends of descents from it
//   the best motion of a relaxed problem, if there is one, and the sequences of its other optima
//   motions at random
//
// and go on along the neighbours of the best motion, whose sequences have one event inserted, removed or replaced, each
// from that motion, until none is better. The best motion, if it is no optimum, is the start of a thorough solve: it
// may be an optimum with a kink. Where no neighbour is better and the best motion lacks events that could happen, up to
// kMostRounds times, more motions at random and as many around the best one are starts, of which those are solved from
// that a descent brings below kMuchWorse of the best loss. After those, neighbours of other motions below it are tried,
// best first. At last intervals of the best motion move to other phases.
//
// Solves leave it to the search to certify optima at which the loss has no kink: each once, when it is looked at. One
// that its certificate refutes, such as a saddle, is the start of a solve that certifies where it ends, and leaves it.
//
// Rule, by which a search is complete: the neighbours of all motions found below kMuchWorse of the best loss are tried,
// except for those whose lower bound is above it; or no motion can have a lower loss.
// Limits, which leave it incomplete: `iterations` solves, kPatience of them without anything better, most of the work
// without anything better, SearchOptions, an interrupt, neighbours left out of very many and those of motions with
// kMoreEvents more events than the best one. Solves are looked at in one order, whatever the threads (task_queue.h).
//
// Problem is what is searched (of a scene in mode_search.cc, of a hybrid system in hybrid_search.cc):
//
//   Run                                        as of phase_plan.h
//   MeritOf(trial), ViolationOf(trial)         as of Run, of any motion that may be returned
//   SolveRelaxed(options)                      the optima of the relaxed problem
//   BeginAtRandom(seed, number)                a motion, or nothing if there is nothing to be drawn
//   BeginAround(trial, seed, number)           a motion near another one, or nothing
//   NeighboursOf(trial, &left_out)             the sequences
//   Shoot(options, start, &trial)              a motion nearer to the targets, by shooting; the gradients computed
//   SolveFrom(trial, start, most_loss, options)  one solve from a motion, the start or that of Shoot, which is given up
//                                              where no optimum has a loss below `most_loss`; this and Shoot are called
//                                              by several threads at the same time
//   WorkByRollout(), WorkOf(start)             of a gradient by shooting and of a Jacobian, as SearchOptions::work
//   lowest_loss(), LowestAlong(sequence)       lower bounds of the loss, of all motions and along a sequence
//   LacksEvents(trial)                         whether events that could happen do not in a motion
//   starts_are_cheap()                         whether more random starts cost less than a solve, so that they go on
//                                              where the optima that starts lead to are the same again and again
//   long_work()                                the work from which on neighbours are left out after most of the work
//                                              without anything better
//   starts_of_sequence()                       the motions from which a sequence is tried
//   AllCostsAreSquares(), LossForUser(loss), OptimumOf(trial), kLeftOut
//   descends_from_guess()                      whether solves begin at ends of descents from the guess, too
//   by_arcs()                                 whether usual solves are in closed form; their intervals are shared
//                                              between phases at the end
#pragma once

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/parallel_for.h"
#include "saltus/solve/solver.h"
#include "solve/phases/sequence_run.h"
#include "solve/search/task_queue.h"

namespace saltus {

// How a start is brought nearer to the targets before its solve.
enum class Shooting { kNone, kLeastSquares, kDescent };

// Where a solve begins: a motion, or what is to be made one by shooting; along a sequence, or that of the motion.
template <typename Run>
struct SearchStartOf {
  // A solve as every other one; one of the best motion, which is worth more; one that shares the intervals of the best
  // motion better between its phases.
  enum class Effort { kUsual, kThorough, kShare };
  typename Run::Motion trial;
  Shooting shooting = Shooting::kNone;
  std::optional<std::vector<typename Run::Event>> sequence = std::nullopt;
  Effort effort = Effort::kUsual;
  bool is_guess = false;   // the start of the user, which is not given up for others
  bool is_more = false;    // one of more starts, with few intervals, solved from if shooting brings it near the best
  bool certifies = false;  // the solve certifies its optimum, as its start is one that a certificate refutes
};

// The motion that a solve ends with, if trial.exact.ok.
template <typename Motion>
struct FindingOf {
  Motion trial;
  SolveReport report;
  double work = 0;                               // as SearchOptions::work
  std::optional<Motion> shot = std::nullopt;     // the end of shooting, from which it was solved
  std::optional<Motion> strayed = std::nullopt;  // the real motion of a solve along a sequence that it does not have
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

// The parts of a search that know no motions: its limits, which are `iterations` solves, SearchOptions and an
// interrupt; and the optima that it has found.
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

  // Returns the one of several optima that is the same as `found`, null if there is none.
  static LocalOptimum* FindSame(const LocalOptimum& found, std::vector<LocalOptimum>* optima) {
    const auto known = std::ranges::find_if(*optima, [&](const LocalOptimum& other) {
      return other.sequence == found.sequence &&
             std::abs(other.loss - found.loss) <= kSameOptimum * std::abs(found.loss);
    });
    return known == optima->end() ? nullptr : &*known;
  }
  std::vector<LocalOptimum> TakeOptima() {
    std::ranges::stable_sort(optima_, {}, &LocalOptimum::loss);
    return std::move(optima_);
  }

  SolverOptions options_;                              // with its own limits
  std::vector<LocalOptimum> optima_, refuted_optima_;  // the latter are none, by their certificates
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
inline constexpr double kProved = 1e-8;         // relative, between the best loss and a lower bound
inline constexpr double kMuchWorse = 3;         // times the best loss
inline constexpr int kMostRounds = 6;           // of more starts
inline constexpr int kPatience = 150;           // solves after which nothing better is expected
inline constexpr double kLongWork = 1e6;        // of a search (SearchOptions::work), from which on it may be a long one
inline constexpr double kLongSolve = 1e5;       // work of a solve in the mean, from which on the search is long, and
inline constexpr double kPatienceWork = 2.5;    // ends after so many times the work at which it was last better
inline constexpr size_t kMoreEvents = 4;  // than the best motion has: neighbours of motions with more are left out

}  // namespace sequence_search

template <typename Problem>
class SequenceSearch : LimitedSearch {
 public:
  SequenceSearch(typename Problem::Run* run, const Problem& problem)
      : LimitedSearch(run->options()), run_(*run), problem_(problem) {
    searched_.lower_bound = problem.lowest_loss();
  }

  SolveReport Search() {
    searched_.starts = 1;
    std::vector<Start> from_guess = {{.trial = run_.guess(), .sequence = run_.given_sequence(), .is_guess = true}};
    for (const Shooting shooting : {Shooting::kLeastSquares, Shooting::kDescent}) {
      if (!options_.sequences.search || !problem_.descends_from_guess()) continue;
      from_guess.push_back({.trial = run_.guess(), .shooting = shooting, .is_guess = true});
    }
    SolveAll(from_guess);
    if (!options_.sequences.search || IsLowest()) return Report();
    std::vector<Start> along;
    SolveAll(FirstStarts(&along));
    SolveAll(along);
    while (!end_ && best_ && !IsLowest()) {
      const std::vector<Start> next = NextStarts();
      if (next.empty()) break;
      SolveAll(next);
    }
    ShareBest();
    return Report();
  }

 private:
  using Trial = typename Problem::Run::Motion;
  using Sequence = std::vector<typename Problem::Run::Event>;
  using Start = SearchStartOf<typename Problem::Run>;
  using Finding = FindingOf<Trial>;
  using Effort = typename Start::Effort;

  // The next start to solve from, the work that the solve may take (SearchOptions::work), and the loss above which an
  // optimum is of no use.
  struct Draw {
    const Start* start;
    double most_work, most_loss;
  };

  // Whether no motion can have a lower loss.
  bool IsLowest() const { return IsZero() || IsProved(); }
  bool IsZero() const {
    const double first = run_.report().history.losses.front();
    return HasOptimum() && std::isfinite(first) && problem_.AllCostsAreSquares() && MeetsConstraints(best_->trial) &&
           best_->trial.exact.loss <= sequence_search::kZero * first;
  }
  bool IsProved() const {
    const double loss = BestLoss();
    return HasOptimum() && problem_.lowest_loss() > 0 &&
           loss - problem_.lowest_loss() <= sequence_search::kProved * loss;
  }

  static bool IsOptimum(const Finding& finding) { return finding.report.termination == Termination::kConverged; }
  bool HasOptimum() const { return best_ && IsOptimum(*best_); }
  double BestLoss() const { return best_ ? best_->trial.exact.loss : run_.report().history.losses.front(); }

  // ----------------------------------------------------------------------------------------------------------- starts

  std::vector<Start> FirstStarts(std::vector<Start>* along) {
    std::vector<Start> starts;
    SearchRelaxed(&starts, along);
    for (int i = 0; i < options_.sequences.limits.starts && !Stopped(); ++i) {
      std::optional<Trial> trial = problem_.BeginAtRandom(options_.sequences.limits.seed, i);
      if (!trial) break;
      starts.push_back({.trial = std::move(*trial), .shooting = Shooting::kLeastSquares});
    }
    searched_.starts += static_cast<int>(starts.size());
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
    starts->push_back({.trial = *found.best});
    // Sequences whose loss without constraints is higher are of no use, as constraints only raise it.
    const bool prunes = best_ && found.is_bound && MeetsConstraints(best_->trial);
    for (auto& [loss, sequence] : found.others) {
      if (along->size() == sequence_search::kMostRelaxedOptima || (prunes && !(loss < BestLoss()))) break;
      if (sequence != found.best->exact.contacts)
        along->push_back({.trial = *found.best, .sequence = std::move(sequence)});
    }
  }

  std::vector<Start> NextStarts() {
    if (!refuted_.empty()) return std::exchange(refuted_, {});
    if (!HasOptimum() && best_->trial.exact.only_impacts && IsBelow(best_->trial, mended_)) {
      mended_ = problem_.MeritOf(best_->trial);
      return {{.trial = best_->trial, .effort = Effort::kThorough}};
    }
    std::vector<Start> next = FromStrayed();
    if (next.empty()) next = NeighboursOf(best_->trial);
    if (next.empty()) next = MoreStarts();
    while (next.empty() && !unexpanded_.empty() && IsOfUse(unexpanded_.begin()->first)) {
      if (!HasPatience(sequence_search::kLongWork)) break;
      const auto first = unexpanded_.extract(unexpanded_.begin());
      next = NeighboursOf(first.mapped());
    }
    return next;
  }

  // Events have appeared or vanished in solves along a sequence: solves along what really happened.
  std::vector<Start> FromStrayed() {
    std::vector<Start> starts;
    std::vector<Sequence> sequences = tried_;
    for (Trial& trial : std::exchange(strayed_, {})) {
      const Sequence& events = trial.exact.contacts;
      if (!IsOfUse(problem_.MeritOf(trial)) || HasEnough(sequences, events)) continue;
      sequences.push_back(events);
      starts.push_back({.trial = std::move(trial), .sequence = sequences.back()});
    }
    return starts;
  }

  bool IsOfUse(double merit) const { return merit < sequence_search::kMuchWorse * problem_.MeritOf(best_->trial); }
  // Whether the search has found nothing better for most of its work, of which there is at least so much.
  bool IsLong(double least) const {
    return searched_.work > std::max(least, sequence_search::kPatienceWork * better_work_) &&
           searched_.work > sequence_search::kLongSolve * solves_;
  }
  // Whether nothing better is expected any more; notes why.
  bool HasPatience(double least_work) {
    if (IsLong(least_work)) {
      AddLimitRemark("no improvement in most of the work");
    } else if (solves_ - last_better_ > sequence_search::kPatience) {
      AddLimitRemark("no improvement in " + std::to_string(sequence_search::kPatience) + " solves");
    } else {
      return true;
    }
    return false;
  }

  // The neighbours of the best motions may all be worse than one to which no start has led yet.
  std::vector<Start> MoreStarts() {
    std::vector<Start> starts;
    const SearchOptions& limits = options_.sequences.limits;
    const bool fits = drawn_ + 2 * limits.starts + sequence_search::kPatience <= options_.limits.iterations;
    if (rounds_ == sequence_search::kMostRounds || !fits || IsLong(sequence_search::kLongWork)) return starts;
    if (!problem_.LacksEvents(best_->trial) || (!problem_.starts_are_cheap() && HasAllOptima())) return starts;
    ++rounds_;
    for (int i = 0; i < limits.starts && !Stopped(); ++i) {
      const int number = rounds_ * limits.starts + i;
      for (std::optional<Trial> trial :
           {problem_.BeginAtRandom(limits.seed, number), problem_.BeginAround(best_->trial, limits.seed, number)}) {
        if (!trial) continue;
        starts.push_back({.trial = std::move(*trial), .shooting = Shooting::kLeastSquares, .is_more = true});
      }
    }
    searched_.starts += static_cast<int>(starts.size());
    return starts;
  }

  // Whether the optima that starts lead to are known, as far as one can tell from how often they led to the same ones:
  // the expected number of optima, w (s - 1) / (s - w - 2) of s starts that led to w ones, is w when rounded (Boender
  // and Rinnooy Kan 1987). The sizes of their regions of attraction are taken to be equally probable.
  bool HasAllOptima() const {
    const double w = static_cast<double>(optima_of_starts_.size()), s = optima_from_starts_;
    return s > w + 2 && w * (s - 1) < (w + 0.5) * (s - w - 2);
  }

  // Whether a sequence is among those tried as often as it may be.
  bool HasEnough(const std::vector<Sequence>& tried, const Sequence& sequence) const {
    return std::count(tried.begin(), tried.end(), sequence) >= problem_.starts_of_sequence();
  }

  // Returns starts along neighbours that are not tried enough yet; each sequence is expanded once.
  std::vector<Start> NeighboursOf(const Trial& trial) {
    const Sequence& events = trial.exact.contacts;
    if (!trial.exact.only_impacts || std::count(expanded_.begin(), expanded_.end(), events) > 0) return {};
    // Where events follow each other again and again, each optimum has a neighbour with one event more.
    if (events.size() > best_->trial.exact.contacts.size() + sequence_search::kMoreEvents) {
      AddLimitRemark("neighbours of motions with many more impacts than the best");
      return {};
    }
    expanded_.push_back(events);
    bool left_out = false;
    std::vector<Start> starts;
    for (Sequence& next : problem_.NeighboursOf(trial, &left_out)) {
      if (HasEnough(tried_, next) || !IsOfUse(problem_.LowestAlong(next))) continue;
      starts.push_back({.trial = trial, .sequence = std::move(next)});
    }
    if (left_out) AddLimitRemark(Problem::kLeftOut);
    return starts;
  }

  // The best motion, with the intervals that a share of them between phases by their lengths has left unused.
  void ShareBest() {
    if (!problem_.by_arcs() || end_ || !best_ || IsLowest()) return;
    const Trial before = best_->trial;
    const bool is_optimum = HasOptimum();
    if (!before.exact.only_impacts) return;
    std::vector<Sequence> along = {before.exact.contacts};
    if (!is_optimum && best_along_ != along[0]) along.push_back(best_along_);
    std::vector<Start> shares;
    for (const Sequence& sequence : along) {
      if (!sequence.empty()) shares.push_back({.trial = before, .sequence = sequence, .effort = Effort::kShare});
    }
    SolveAll(shares);
    if (is_optimum && best_->trial.exact.loss < before.exact.loss) {
      std::erase_if(optima_, [&](const LocalOptimum& known) { return known.loss == before.exact.loss; });
    }
    SolveAll(std::exchange(refuted_, {}));
    for (const Effort effort : {Effort::kUsual, Effort::kThorough}) {
      if (is_optimum && !HasOptimum() && !end_) SolveAll({{.trial = best_->trial, .effort = effort}});
    }
  }

  // ----------------------------------------------------------------------------------------------------------- solves

  void SolveAll(const std::vector<Start>& starts) {
    auto next = starts.begin();
    TaskQueue<Draw, Finding> line;
    line.draw = [&]() -> std::optional<Draw> {
      if (Stopped()) EndByStop();
      if (end_ || next == starts.end() || IsLowest()) return std::nullopt;
      const bool is_neighbour = next->sequence && !next->is_guess && next->effort == Effort::kUsual;
      if (is_neighbour && !HasPatience(problem_.long_work())) return std::nullopt;
      const std::optional<double> most_work = CountDrawn();
      if (!most_work) return std::nullopt;
      const Start& start = *next++;
      return Draw{&start, *most_work, LossLimit(start)};
    };
    line.solve = [this](const Draw& draw) { return Stopped() ? Finding{} : SolveDrawn(draw); };
    line.look = [this](const Draw& draw, Finding finding) {
      if (finding.report.solver.empty()) return EndByStop();  // not begun
      if (const auto& sequence = draw.start->sequence) {
        tried_.push_back(*sequence);
        AddIfNew(*sequence, &searched_along_);
      }
      ConsumeResult(*draw.start, std::move(finding));
      if (!run_.Record(BestLoss())) end_ = End::kInterrupt;
    };
    line.RunAll(NumThreads(options_.threads));
    if (Stopped()) EndByStop();
  }

  // Near the best optimum a sequence of its neighbourhood has to be better; elsewhere other optima are reported too.
  double LossLimit(const Start& start) const {
    if (!best_ || start.is_guess || !MeetsConstraints(best_->trial)) return INFINITY;
    const double loss = best_->trial.exact.loss;
    return loss + (start.sequence ? kSameOptimum : sequence_search::kMuchWorse - 1) * std::abs(loss);
  }

  Finding SolveDrawn(const Draw& draw) const {
    const auto& [start_of_draw, most_work, most_loss] = draw;
    const Start& start = *start_of_draw;
    SolverOptions own;
    own.monitor.stop = options_.monitor.stop;
    own.sequences.search = options_.sequences.search;
    Trial from = start.trial;
    std::optional<Trial> shot;
    int shooting = 0;
    if (start.shooting != Shooting::kNone) {
      const int most = start.is_guess ? options_.limits.iterations : sequence_search::kIterationsShooting;
      own.limits.iterations = IterationsWithin(most_work, problem_.WorkByRollout(), most);
      shooting = problem_.Shoot(own, start, &from);
      shot = from;
    }
    Finding finding;
    if (start.is_more && !(from.exact.loss < most_loss)) {
      finding.report.solver = "mode_search";
      finding.report.reason = "no motion near the targets was found";
    } else {
      own.limits.iterations =
          IterationsWithin(most_work,
                           problem_.WorkOf(from, start),
                           start.sequence ? sequence_search::kIterationsAlong : sequence_search::kIterationsUpdating);
      finding = problem_.SolveFrom(std::move(from), start, most_loss, own);
    }
    finding.report.work.evaluations += shooting;
    finding.work += shooting * problem_.WorkByRollout();
    finding.shot = std::move(shot);
    return finding;
  }

  void ConsumeResult(const Start& start, Finding finding) {
    ++solves_;
    run_.report().work.evaluations += finding.report.work.evaluations;
    searched_.work += finding.work;
    ReportStatus(start);
    if (finding.shot && finding.shot->exact.ok) NoteUnexpanded(*finding.shot);
    if (finding.strayed) strayed_.push_back(std::move(*finding.strayed));
    const Trial& trial = finding.trial;
    if (!trial.exact.ok) {
      if (!best_ && reason_.empty()) reason_ = finding.report.reason;
      return;
    }
    AddIfNew(trial.exact.contacts, &searched_along_);
    if (IsOptimum(finding) && IsRefuted(start, &finding)) {
      finding.report.termination = Termination::kNoProgress;
      finding.report.reason = "the conditions of an optimum hold at the end of the solve, and its certificate fails";
      finding.report.certificate.reset();
    }
    if (IsOptimum(finding)) {
      LocalOptimum found = problem_.OptimumOf(trial);
      if (start.shooting != Shooting::kNone && !start.is_guess) NoteOptimumOfStart(found);
      LocalOptimum* known = FindSame(found, &optima_);
      if (known == nullptr) {
        optima_.push_back(std::move(found));
      } else if (found.loss < known->loss) {
        *known = std::move(found);
      }
    }
    if (!best_ || IsBelow(trial, problem_.MeritOf(best_->trial))) {
      last_better_ = solves_;
      better_work_ = searched_.work;
    }
    NoteUnexpanded(trial);
    if (best_ && !IsBetter(finding)) return;
    best_along_ = start.sequence ? *start.sequence : trial.exact.contacts;
    best_ = std::move(finding);
  }

  // Certifies an optimum that is not known. Returns whether it is none, so that a solve from it is to leave it.
  bool IsRefuted(const Start& start, Finding* finding) {
    const Trial& trial = finding->trial;
    std::optional<Certificate>& certificate = finding->report.certificate;
    const LocalOptimum found = problem_.OptimumOf(trial);
    if (start.certifies || certificate || !run_.HasCertificate() || FindSame(found, &optima_)) return false;
    if (FindSame(found, &refuted_optima_)) return true;
    certificate = run_.Certify(trial);
    const bool leaves_node = std::ranges::any_of(certificate->impacts, &ImpactCertificate::LeavesNode);
    if (!certificate->IsSaddle() && certificate->verdict != Certificate::Verdict::kNotStationary && !leaves_node) {
      return false;
    }
    refuted_optima_.push_back(found);
    Start& again = refuted_.emplace_back(start);
    again.trial = trial;
    again.shooting = Shooting::kNone;
    again.certifies = true;
    return true;
  }

  void NoteOptimumOfStart(const LocalOptimum& found) {
    ++optima_from_starts_;
    if (!HasSameLoss(optima_of_starts_, found.loss)) optima_of_starts_.push_back(found.loss);
  }

  // Notes that the neighbours of a motion may be tried; those of the worst motions are forgotten first.
  void NoteUnexpanded(const Trial& trial) {
    const double merit = problem_.MeritOf(trial);
    if (!trial.exact.only_impacts || !std::isfinite(merit)) return;
    unexpanded_.emplace(merit, trial);
    const size_t bytes = sizeof(Trial) + (trial.control.size() + trial.durations.size()) * sizeof(double);
    while (unexpanded_.size() > 1 && unexpanded_.size() * bytes > options_.sequences.limits.memory / 2) {
      unexpanded_.erase(std::prev(unexpanded_.end()));
      AddLimitRemark("the limit of memory");
    }
  }

  void ReportStatus(const Start& start) const {
    if (!options_.monitor.status) return;
    options_.monitor.status(Status(problem_.LossForUser(BestLoss())) + ", the last " +
                            (start.sequence ? "along " + run_.NameOf(*start.sequence) : "from another start"));
  }

  bool MeetsConstraints(const Trial& trial) const { return problem_.ViolationOf(trial) <= kFeasible; }

  static void AddIfNew(const Sequence& sequence, std::vector<Sequence>* sequences) {
    if (std::count(sequences->begin(), sequences->end(), sequence) == 0) sequences->push_back(sequence);
  }

  bool IsBelow(const Trial& trial, double merit) const {
    return problem_.MeritOf(trial) < (std::isfinite(merit) ? merit - kSameOptimum * std::abs(merit) : merit);
  }

  // Whether a finding is better; optima that meet all constraints come first.
  bool IsBetter(const Finding& finding) const {
    const bool mine = MeetsConstraints(finding.trial), other = MeetsConstraints(best_->trial);
    if (mine != other) return mine;
    const double merit = problem_.MeritOf(finding.trial), least = problem_.MeritOf(best_->trial);
    if (IsBelow(finding.trial, least)) return true;
    if (!IsOptimum(finding)) return false;
    return HasOptimum() ? merit < least : merit < least + kSameOptimum * std::abs(least);
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
    const bool converged = HasOptimum();
    if (converged && !best.certificate && run_.HasCertificate()) best.certificate = run_.Certify(best_->trial);
    run_.report().certificate = std::move(best.certificate);
    if (auto& certificate = run_.report().certificate; certificate && converged) {
      certificate->sequences_searched = searched_.sequences;
      if (options_.sequences.search && end_ != End::kInterrupt && !certificate->IsSaddle()) {
        certificate->scope = Certificate::Scope::kBestOfSearched;
      }
      if (certificate->verdict == Certificate::Verdict::kStationary && IsProved()) {
        certificate->verdict = Certificate::Verdict::kGlobal;
      }
    }
    Termination end = best.termination;
    const bool of_solve = end == Termination::kIterationLimit || end == Termination::kNotApplicable;
    if (of_solve && options_.sequences.search) end = Termination::kNoProgress;
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
  Sequence best_along_;                      // with which its solve has begun
  std::multimap<double, Trial> unexpanded_;  // by merit: whose neighbours may be tried
  std::vector<Trial> strayed_;               // to be solved along their own sequences
  std::vector<Start> refuted_;               // from optima that are none by their certificates
  std::vector<Sequence> tried_;              // that were given to a solve
  std::vector<Sequence> searched_along_;     // these, and those that solves have ended with
  std::vector<Sequence> expanded_;           // whose neighbours are tried
  std::string reason_;                       // why nothing was found
  double mended_ = INFINITY;                 // merit of the last motion that was the start of a thorough solve
  double better_work_ = 0;                   // done when the search was last better
  int last_better_ = 0, rounds_ = 0;
  std::vector<double> optima_of_starts_;  // the losses of those to which random starts have led
  int optima_from_starts_ = 0;            // how often they have
};

}  // namespace saltus
