#include "saltus/identify/identify.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "base/number_text.h"
#include "base/statistics.h"
#include "identify/fit.h"
#include "identify/statistics.h"

namespace saltus {
namespace {

constexpr double kHorizons[] = {0.15, 0.3, 0.5, 0.7, 0.85, 1};  // shares of the samples that fits begin with
constexpr double kWideLoss = 10;             // times the loss scale, while the motion is not found yet
constexpr double kGainOfSearch = 1e-8;       // share of the cost that an iteration must gain, before Polish()
constexpr double kFits = 1.25;               // misfit of a motion that is found
constexpr double kContradicts = 2.5;         // misfit that noise does not make
constexpr double kFarBelow = 0.2;            // misfit that noise of the stated sigma does not leave
constexpr double kFewestDegrees = 4;         // of freedom, of which an interval is computed
constexpr double kFewestBesideOutliers = 6;  // the same, where it is open too which samples are outliers
constexpr double kFewestWithoutSigma = 8;    // the same, where an outlier may pass for noise of an estimated sigma
constexpr double kFewOutliers = 0.12;        // share of samples, of a motion that is found
constexpr double kMostOutliers = 1.0 / 3;    // that noise and slips of the pen do not make
constexpr double kFarOff = 10;               // sigmas, that are estimated, beyond which an outlier is no tail of noise
constexpr double kTooMany = 0.5;             // from which on the other samples are no better
constexpr double kMostScatter = 0.1;         // estimated sigma, of the extent of the motion, of a fit that is judged
constexpr double kMostWaves = 0.01;          // the same, if residuals are systematic
constexpr double kFlat = 0.25;               // of the rise of the cost to an end of an interval: less is none
constexpr double kOfRounding = 1e-6;         // of a change that matters: an interval within which the cost is rounding
constexpr double kGainOfProbe = 1e-3;        // of the cost, in an iteration of the fit of the others there
constexpr double kAsWell = 2;   // squares of the interval's quantile by which a motion explains samples as well
constexpr int kScreened = 100;  // starts that are compared, by kind of line
constexpr int kFitted = 5;      // times the starts, of which these are fitted a little
constexpr double kGainOfScreening = 0.1;  // share of the cost that an iteration of these must gain
constexpr int kFewLeft = 20;              // the same, below which one outlier may look like noise
constexpr double kNoOutlier = 0.005;      // estimated sigma, of the extent of the motion, that then is no outlier
constexpr int kManyLeft = 60;             // numbers more than unknowns, from which on one start may be enough
constexpr double kFirstSigma = 1e-3;      // of the motion's length, until it is estimated
constexpr double kLeastSigma = 1e-20;     // of the motion's length: residuals that are smaller are 0

// The i-th number of the low-discrepancy sequence of van der Corput, in (0, 1).
double RadicalInverse(int i, int base) {
  double value = 0, digit = 1.0 / base;
  for (; i > 0; i /= base, digit /= base) value += digit * (i % base);
  return value;
}

class Identification {
 public:
  Identification(FitRequest request, double length)
      : problem_(std::move(request.problem)), segments_(std::move(request.segments)), length_(length) {
    if (problem_.options.status) {
      problem_.options.status = [this, say = problem_.options.status](const std::string& what) {
        say(at_work_ + ", " + what);
      };
    }
  }

  IdentifyReport Run() {
    const auto begin = std::chrono::steady_clock::now();
    Fit();
    report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return report_;
  }

 private:
  // A motion, and the sigma that its residuals have.
  struct Found {
    FitPoint point;
    double sigma = 0;
  };

  void Fit() {
    problem_.sigma = kFirstSigma * length_;
    FitResult best = SearchFromStarts();
    if (!best.ok) {
      report_.verdict = Interrupted() ? FitVerdict::kInterrupted : FitVerdict::kFailed;
      report_.reason = best.reason;
      return;
    }
    best = Polish(best);
    Report(best);
  }

  bool Interrupted() const { return problem_.options.stop && problem_.options.stop(); }

  // The starts of the unknowns first, then values spread over what is plausible.
  FitPoint StartAt(int number, int kind) const {
    static constexpr int kBases[] = {2, 3, 5, 7, 11, 13, 17, 19, 23, 29};
    FitPoint point;
    for (int u = 0; u < problem_.num_plain(); ++u) {
      const FitUnknown& unknown = problem_.unknowns[u];
      const double value = number == 0 ? unknown.start : unknown.Spread(RadicalInverse(number, kBases[u % 10]));
      point.coordinates.push_back(unknown.ToCoordinate(value));
    }
    if (const auto& learned = problem_.learned) {
      point.coordinates.insert(point.coordinates.end(), learned->parameters.begin(), learned->parameters.end());
    }
    const std::vector<double> values = problem_.ValuesAt(point.coordinates);
    point.segments = segments_;
    for (Segment& segment : point.segments) segment.initial = problem_.model->StartOf(values, segment, kind);
    return point;
  }

  // With the samples up to a share of each segment's.
  FitPoint TruncateSamples(double share, FitPoint point) const {
    for (std::size_t s = 0; s < segments_.size(); ++s) {
      const int count = segments_[s].last - segments_[s].first;
      point.segments[s].last = segments_[s].first + std::max(1, static_cast<int>(std::ceil(share * count)));
    }
    return point;
  }

  // The weights of a network follow valleys that bend, along which a fit creeps. So it is tried with those that bend
  // the law held until the others are found, and with all from the beginning; the better one is kept.
  FitResult FitFrom(const FitPoint& start, const std::string& name) {
    FitResult all = FitAlong(start, name, {});
    const std::vector<bool> last = LearnedLast();
    if (last.empty() || Interrupted()) return all;
    FitResult some = FitAlong(start, name + ", weights that bend last", last);
    if (some.ok) some = MinimizeFrom(problem_, some.point, problem_.options.loss_scale);
    Count(some);
    return some.ok && (!all.ok || some.cost < all.cost) ? some : all;
  }

  // With more and more of the samples. Unknowns in `held` stay as they are.
  FitResult FitAlong(const FitPoint& start, const std::string& name, const std::vector<bool>& held) {
    FitResult fit;
    fit.point = start;
    for (const double share : kHorizons) {
      at_work_ = name + ", " + std::to_string(static_cast<int>(std::lround(100 * share))) + " % of the samples";
      const double scale = problem_.options.loss_scale * (share < 1 ? kWideLoss : 1);
      FitResult next = MinimizeFrom(problem_, TruncateSamples(share, fit.point), scale, held, kGainOfSearch);
      Count(next);
      if (!next.ok) return next;
      fit = std::move(next);
      if (Interrupted()) break;
    }
    return fit;
  }

  std::vector<bool> LearnedLast() const {
    if (!problem_.learned || problem_.learned->learned_last == 0) return {};
    std::vector<bool> held(problem_.unknowns.size(), false);
    std::fill_n(held.begin() + problem_.num_plain(), problem_.learned->learned_last, true);
    return held;
  }

  void Count(const FitResult& fit) {
    report_.iterations += fit.iterations;
    report_.evaluations += fit.evaluations;
  }

  static std::string SequenceOf(const FitResult& fit) {
    std::string sequence;
    for (const FitMotion& motion : fit.motion) {
      Candidate last{-1, -1, false};
      for (const Candidate& c : motion.events) {
        if (c == last) continue;
        last = c;
        sequence += std::to_string(c.a) + (c.plane ? "|" : "-") + std::to_string(c.b) + " ";
      }
      sequence += ";";
    }
    return sequence;
  }

  // With few samples, no first part shows where a motion begins. Many starts are compared by how far they miss all
  // samples, and the best ones are fitted.
  std::vector<FitPoint> ScreenStarts() {
    std::map<std::size_t, std::vector<std::pair<double, FitPoint>>> starts;  // by the number of contacts
    at_work_ = "starts";
    for (int number = 0; number < kScreened && !Interrupted(); ++number) {
      for (int kind = 0; kind < problem_.model->num_start_kinds(); ++kind) {
        FitPoint point = StartAt(number, kind);
        const auto [miss, contacts] = SumOfMisfits(point);
        if (std::isfinite(miss)) starts[contacts].emplace_back(miss, std::move(point));
      }
    }
    // The best of each number of contacts, the second best of each, and so on.
    std::vector<FitPoint> best;
    std::size_t place = 0;
    for (auto& [contacts, group] : starts) std::ranges::stable_sort(group, {}, &std::pair<double, FitPoint>::first);
    for (bool any = true; any && static_cast<int>(best.size()) < kFitted * problem_.options.starts; ++place) {
      any = false;
      std::vector<std::pair<double, FitPoint*>> row;
      for (auto& [contacts, group] : starts) {
        if (place < group.size()) row.emplace_back(group[place].first, &group[place].second);
      }
      std::ranges::stable_sort(row, {}, &std::pair<double, FitPoint*>::first);
      for (auto& [miss, point] : row) {
        any = true;
        best.push_back(std::move(*point));
      }
    }
    std::vector<std::pair<double, FitPoint>> fitted;
    for (const FitPoint& point : best) {
      if (Interrupted()) break;
      FitResult fit = MinimizeFrom(problem_, point, kWideLoss * problem_.options.loss_scale, {}, kGainOfScreening);
      Count(fit);
      if (fit.ok) fitted.emplace_back(fit.cost, std::move(fit.point));
    }
    std::ranges::stable_sort(fitted, {}, &std::pair<double, FitPoint>::first);
    best.clear();
    for (auto& [cost, point] : fitted) {
      if (static_cast<int>(best.size()) < problem_.options.starts) best.push_back(std::move(point));
    }
    return best;
  }

  // The sum of the distances of all samples from the motion, in sigmas, and its number of contacts; infinite if there
  // is none.
  std::pair<double, std::size_t> SumOfMisfits(const FitPoint& point) const {
    FitResult at;
    std::size_t contacts = 0;
    at.point = point;
    const std::vector<double> values = problem_.ValuesAt(point.coordinates);
    for (const Segment& segment : point.segments) {
      at.motion.push_back(problem_.model->Move(values, segment, /*with_derivatives=*/false));
      if (!at.motion.back().ok) return {std::numeric_limits<double>::infinity(), 0};
      contacts += at.motion.back().events.size();
    }
    double miss = 0;
    ForEachSample(
        problem_, at, [&](int, int, const FitSample&, const Eigen::VectorXd& residual) { miss += residual.norm(); });
    return {miss, contacts};
  }

  // With all samples at once.
  FitResult FitAll(const FitPoint& start, const std::string& name) {
    FitResult fit;
    fit.point = start;
    for (const double wider : {kWideLoss, 1.0}) {
      at_work_ = name;
      FitResult next = MinimizeFrom(problem_, fit.point, problem_.options.loss_scale * wider, {}, kGainOfSearch);
      Count(next);
      if (!next.ok) return next;
      fit = std::move(next);
    }
    return fit;
  }

  FitResult SearchFromStarts() {
    FitResult best;
    best.reason = "no start has a motion";
    std::set<std::string> sequences;
    const int starts = problem_.num_plain() > 0 ? problem_.options.starts : 1;  // which differ in these unknowns only
    const int kinds_in_turn = std::min(3, problem_.model->num_start_kinds());
    const bool few = DegreesOfFreedom() < kManyLeft;
    // The first part of many samples shows where a motion begins, unless there are many outliers in it.
    const int first_screened = few ? 1 : (starts + 1) / 2;
    std::vector<FitPoint> screened;
    for (int number = 0; number < starts && !Interrupted(); ++number) {
      if (number == first_screened) screened = ScreenStarts();
      const std::string name = "start " + std::to_string(number + 1);
      const int rank = number - first_screened;
      FitResult fit = rank >= 0 && rank < static_cast<int>(screened.size())
                          ? FitAll(screened[rank], name)
                          : FitFrom(StartAt(number, number % kinds_in_turn), name);
      ++report_.starts;
      if (!fit.ok) {
        if (!best.ok) best.reason = fit.reason;
        continue;
      }
      const bool known = !sequences.insert(SequenceOf(fit)).second;
      const double before = best.cost;
      const bool same = best.ok && std::abs(fit.cost - before) < 1e-6 * before;
      others_.push_back({fit.point, problem_.sigma * (problem_.states_sigma ? 1 : MisfitOf(problem_, fit))});
      if (!best.ok || fit.cost < best.cost) best = std::move(fit);
      // Without a stated sigma, or with many outliers, a fit must be found again, from another start.
      const bool again = same && known && IsClose(best);
      const bool enough = again || (problem_.states_sigma && IsFound(best));
      if (!few && enough && !FindOutlierRuns(problem_, best).follow_each_other) break;
    }
    report_.sequences = static_cast<int>(sequences.size());
    return best;
  }

  // Whether the motion passes by the samples except for outliers.
  bool IsClose(const FitResult& fit) const {
    const double misfit = MisfitOf(problem_, fit);
    return problem_.states_sigma ? misfit < kFits : problem_.sigma * misfit < kMostWaves * ExtentOf(problem_, fit);
  }
  bool IsFound(const FitResult& fit) const { return IsClose(fit) && OutlierShareOf(problem_, fit) < kFewOutliers; }

  // Whether so many of many samples are outliers, by a stated sigma, that this or the model is wrong.
  bool OutliersAreMost(const FitResult& fit) const {
    return problem_.states_sigma && DegreesOfFreedom() >= kFewLeft && OutlierShareOf(problem_, fit) > kTooMany;
  }

  // Whether more numbers were measured than are unknown. Otherwise a motion can pass through all samples, and nothing
  // shows how much noise they have.
  bool HasResiduals() const { return DegreesOfFreedom() > 0; }
  // Returns the number of measured numbers less that of unknown ones.
  int DegreesOfFreedom() const {
    Eigen::Index measured = 0;
    for (const FitProblem::Recording& recording : problem_.recordings) {
      for (const FitSample& sample : recording.samples) measured += sample.size();
    }
    return static_cast<int>(measured) - problem_.num_plain() -
           static_cast<int>(problem_.free_initial.size() * segments_.size());
  }

  // If none is stated.
  FitResult EstimateSigma(FitResult fit) {
    for (int round = 0; round < 3 && !problem_.states_sigma && HasResiduals(); ++round) {
      problem_.sigma = std::max(kLeastSigma * length_, problem_.sigma * MisfitOf(problem_, fit));
      FitResult next = MinimizeFrom(problem_, fit.point, problem_.options.loss_scale);
      Count(next);
      if (!next.ok) break;
      fit = std::move(next);
    }
    return fit;
  }

  // A robust loss bounds what one outlier does to a fit, but not what many do. Of the motions that were found, that is
  // taken on which samples without outliers lie best, and these alone are fitted. If no sigma is stated, each motion
  // has its own, as outliers look like noise of the sigma of a wrong motion, and the motions are compared by the scale
  // of Yohai and Zamar (1988), which is sigma^2 times the mean loss.
  FitResult DropOutliers(FitResult fit) {
    std::vector<Found> all = others_;
    all.push_back({fit.point, problem_.sigma});
    // Outliers have made the sigma of a motion larger, too.
    const std::size_t count = problem_.states_sigma ? 0 : all.size();
    for (std::size_t i = 0; i < count; ++i) all.push_back({all[i].point, all[i].sigma / 2});
    problem_.drops_outliers = true;
    double best_sigma = problem_.sigma, least = std::numeric_limits<double>::infinity();
    for (const auto& [point, sigma] : all) {
      problem_.sigma = sigma;
      FitResult next = MinimizeFrom(problem_, point, problem_.options.loss_scale);
      Count(next);
      if (!next.ok) continue;
      next = EstimateSigma(std::move(next));
      const double scale = problem_.sigma * problem_.sigma * next.cost;
      if (!(scale < least)) continue;
      least = scale;
      best_sigma = problem_.sigma;
      fit = std::move(next);
    }
    problem_.sigma = best_sigma;
    return fit;
  }

  // Estimates sigma if none is stated, leaves out many outliers, holds what the data leave open, and takes the
  // covariance.
  FitResult Polish(FitResult fit) {
    at_work_ = "confidence";
    fit = EstimateSigma(std::move(fit));
    if (problem_.options.loss != RobustLoss::kNone && DegreesOfFreedom() >= kFewLeft &&
        OutlierShareOf(problem_, fit) >= kFewOutliers) {
      FitResult rest = DropOutliers(fit);
      problem_.drops_outliers = !OutliersAreMost(rest);
      if (problem_.drops_outliers) fit = std::move(rest);
    }
    open_ = FindOpenUnknowns(problem_, fit, problem_.options.loss_scale);
    too_few_ = ReasonTooFewSamples(fit);  // before unknowns are held, which then take no number of the samples
    if ((!problem_.states_sigma && !HasResiduals()) || !too_few_.empty()) {
      open_.determination.assign(open_.determination.size(), Determination::kUndetermined);
    }
    std::vector<bool> held;
    for (const Determination at : open_.determination) held.push_back(at != Determination::kDetermined);
    FitPoint point = fit.point;
    for (int u = 0; u < problem_.num_plain(); ++u) {
      if (open_.determination[u] != Determination::kAtBound) continue;
      point.coordinates[u] = problem_.unknowns[u].CoordinateAtBoundNear(point.coordinates[u]);
    }
    FitResult last = MinimizeFrom(problem_, point, problem_.options.loss_scale, held);
    Count(last);
    if (last.ok) fit = std::move(last);
    confidence_ = ConfidenceOf(problem_, fit, problem_.options.loss_scale, held);
    return fit;
  }

  // Returns the reason why the samples are too few to determine the error of a fit; empty if they are not.
  std::string ReasonTooFewSamples(const FitResult& fit) const {
    const int left = DegreesOfFreedom();
    if (!HasResiduals() || left >= kManyLeft || OutliersAreMost(fit)) return "";
    const Confidence confidence = ConfidenceOf(problem_, fit, problem_.options.loss_scale);
    const std::string state = problem_.states_sigma ? "" : "state sigma, ";
    const std::string remedy = "; " + state + "take more samples, or let fewer parameters be unknown";
    const double share = OutlierShareOf(problem_, fit), fewest = FewestDegrees(share > 0);
    if (left < kFewLeft && confidence.degrees < fewest) {
      return "too few samples to judge: with " + std::to_string(fit.num_fitted) +
             FormatNumbers(" unknowns, %.2g degrees of freedom remain without the outliers, expected at least %.2g",
                           std::max(0.0, confidence.degrees),
                           fewest) +
             remedy;
    }
    const std::string outlier = "too few samples to judge: their scatter is that of outliers, ";
    const double sigma = problem_.sigma / ExtentOf(problem_, fit);
    if (!problem_.states_sigma && (left < kFewLeft ? sigma > kNoOutlier : sigma > kMostWaves && sigma < kMostScatter)) {
      return outlier + FormatNumbers("by %.2g %% of the extent of the motion", 100 * sigma) + remedy;
    }
    if (problem_.states_sigma && (left < kFewLeft || share >= kFewOutliers) && !confidence.is_noise) {
      return outlier + FormatNumbers("by %.2g times their sigma", std::sqrt(confidence.scatter)) + remedy;
    }
    return "";
  }

  double FewestDegrees(bool has_outliers) const {
    if (has_outliers) return kFewestBesideOutliers;
    return problem_.states_sigma || problem_.options.loss == RobustLoss::kNone ? kFewestDegrees : kFewestWithoutSigma;
  }

  void Report(const FitResult& fit) {
    ReportEstimates(fit);
    MarkAmbiguousAsUndetermined(fit);
    MarkFlatAsUndetermined(fit);
    problem_.model->AddLearned(
        fit.point.segments, problem_.ValuesAt(fit.point.coordinates), confidence_.covariance, &report_);
    ReportResiduals(fit);
    report_.cost = fit.cost;
    report_.sigma = problem_.states_sigma || !HasResiduals() ? 0 : problem_.sigma;
    report_.misfit = problem_.states_sigma ? MisfitOf(problem_, fit) : 0;
    for (std::size_t s = 0; s < segments_.size(); ++s) {
      report_.initial.push_back(fit.point.segments[s].initial);
      report_.segment_begin.push_back(segments_[s].begin);
      report_.segment_recording.push_back(segments_[s].recording);
      report_.impacts += static_cast<int>(fit.motion[s].events.size());
    }
    SetVerdict(fit);
  }

  void SetVerdict(const FitResult& fit) {
    const bool none_left = !problem_.states_sigma && !HasResiduals();
    const std::string contradiction = !too_few_.empty() || none_left ? "" : ContradictionOf(fit);
    const double outliers = OutlierShareOf(problem_, fit);
    if (Interrupted()) {
      report_.verdict = FitVerdict::kInterrupted;
    } else if (!too_few_.empty()) {
      report_.verdict = FitVerdict::kNotJudged;
      report_.reason = too_few_;
    } else if (!contradiction.empty()) {
      report_.verdict = FitVerdict::kContradicted;
      report_.reason = contradiction;
    } else if (!fit.converged) {
      report_.verdict = FitVerdict::kNotConverged;
      report_.reason = fit.reason;
    } else if (!AnyDetermined()) {
      report_.verdict = FitVerdict::kNotDetermined;
      report_.reason = HasResiduals() ? "the samples do not determine any unknown"
                                      : "the samples have no more numbers than there are unknowns";
    } else if (OutliersAreSystematic(fit)) {
      report_.verdict = FitVerdict::kNotJudged;
      report_.reason =
          FormatNumbers("%.3g %% of the samples are outliers that follow each other, which slips do not do: ",
                        100 * outliers) +
          "the model may be wrong there; fit the recordings one by one, or leave these samples out if they are wrong";
    } else if (outliers >= kMostOutliers) {
      report_.verdict = FitVerdict::kNotJudged;
      report_.reason = FormatNumbers("%.0f %% of the samples are outliers, expected less than a third", 100 * outliers);
    } else if (const std::string at_bound = NamesAtBounds(); !problem_.states_sigma && !at_bound.empty()) {
      report_.verdict = FitVerdict::kNotJudged;
      report_.reason =
          at_bound + " is at its bound, and without a sigma it is open whether the samples allow that; state sigma";
    } else {
      report_.verdict = FitVerdict::kFits;
      report_.reason.clear();
    }
  }

  // Whether outliers follow each other, and without a stated sigma are many or far off: others may be the largest of
  // systematic residuals, of which sigma is estimated.
  bool OutliersAreSystematic(const FitResult& fit) const {
    const OutlierRuns runs = FindOutlierRuns(problem_, fit);
    const bool counts =
        problem_.states_sigma || OutlierShareOf(problem_, fit) >= kFewOutliers || runs.largest > kFarOff;
    return runs.follow_each_other && counts;
  }

  std::string NamesAtBounds() const {
    std::string names;
    for (const Estimate& estimate : report_.estimates) {
      if (estimate.determination != Determination::kAtBound) continue;
      names += (names.empty() ? "" : ", ") + estimate.name;
    }
    return names;
  }

  // Returns the reason why no parameters explain the samples; empty if these may. Adds remarks on the residuals.
  std::string ContradictionOf(const FitResult& fit) {
    if (problem_.states_sigma) {
      if (report_.misfit < kFarBelow && DegreesOfFreedom() >= kFewLeft) {
        report_.remarks.push_back(
            FormatNumbers("residuals are only %.2g times the stated sigma, which makes the standard errors too large; "
                          "check the unit of sigma",
                          report_.misfit));
      }
      // Errors of the model are systematic, those of single samples come at any time.
      const double share = OutlierShareOf(problem_, fit);
      const OutlierRuns runs = FindOutlierRuns(problem_, fit);
      const bool scatters = report_.misfit > kContradicts && (!confidence_.is_noise || OutliersAreMost(fit));
      const bool strays = runs.follow_each_other && (runs.are_one_sided || share >= kMostOutliers);
      if (!scatters && !strays) return "";
      return FormatNumbers("samples miss the motion by %.3g times their sigma, %.3g %% are outliers",
                           report_.misfit,
                           100 * share) +
             (strays ? " that follow each other" : "") + "; check sigma, and " + problem_.model->SuggestChecks();
    }
    const double extent = ExtentOf(problem_, fit), share = problem_.sigma / extent;
    const Runs runs = CountRuns(problem_, fit);
    const bool systematic = runs.Systematic();
    const std::string waves =
        "residuals are systematic: " + std::to_string(runs.found) + " runs of one sign among " +
        std::to_string(runs.signs) +
        FormatNumbers(", expected %.0f +- %.0f of independent errors", runs.expected, runs.deviation);
    const std::string scatter = "sigma was estimated: " + problem_.model->SigmaToText(problem_.sigma) +
                                FormatNumbers(", %.2g %% of the extent of the motion", 100 * share);
    report_.remarks.push_back(scatter);
    if (systematic) {
      report_.remarks.push_back(waves + "; the " + problem_.model->Subject() +
                                " lacks an effect of the size of sigma, and the standard errors are too small");
    }
    const std::string remedy = "; check the units, and " + problem_.model->SuggestChecks();
    if (!(share < kMostScatter)) {
      return scatter + FormatNumbers(", where less than %.0f %% is expected", 100 * kMostScatter) + remedy;
    }
    return systematic && share > kMostWaves ? waves + "; " + scatter + remedy : "";
  }

  // Whether anything was found that was asked for. Without unknowns that is the motion.
  bool AnyDetermined() const {
    if (report_.law && !report_.law->curve.empty()) return true;
    if (report_.events && !report_.events->impacts.empty()) return true;
    if (report_.estimates.empty()) return !problem_.learned;
    return std::any_of(report_.estimates.begin(), report_.estimates.end(), [](const Estimate& estimate) {
      return estimate.determination == Determination::kDetermined || estimate.determination == Determination::kAtBound;
    });
  }

  void ReportEstimates(const FitResult& fit) {
    const Eigen::MatrixXd& covariance = confidence_.covariance;
    const double quantile = StudentQuantile(std::max(kFewestDegrees, confidence_.interval_degrees));
    std::vector<int> determined;
    for (int u = 0; u < problem_.num_plain(); ++u) {
      Estimate estimate;
      const FitUnknown& unknown = problem_.unknowns[u];
      const double value = unknown.FromCoordinate(fit.point.coordinates[u]);
      estimate.name = unknown.name;
      estimate.start = unknown.start;
      estimate.determination = open_.determination[u];
      // There is none if the derivatives have not full rank, and then no value either.
      if (covariance.size() == 0 && estimate.determination == Determination::kDetermined) {
        estimate.determination = Determination::kUndetermined;
      }
      for (const int other : open_.with[u]) estimate.with.push_back(problem_.unknowns[other].name);
      if (estimate.determination == Determination::kDetermined) {
        determined.push_back(u);
        estimate.value = value;
        estimate.standard_error = std::sqrt(covariance(u, u));
        const double half = quantile * estimate.standard_error;
        estimate.low = std::max(value - half, unknown.low);
        estimate.high = std::min(value + half, unknown.high);
      } else if (estimate.determination == Determination::kAtBound) {
        estimate.value = unknown.BoundNear(value);
      }
      report_.estimates.push_back(std::move(estimate));
    }
    for (const int i : determined) {
      report_.correlation.emplace_back();
      for (const int j : determined) {
        const double scale = std::sqrt(covariance(i, i) * covariance(j, j));
        report_.correlation.back().push_back(scale > 0 ? covariance(i, j) / scale : 0);
      }
    }
  }

  // Few samples may lie on several motions. A parameter is not determined if a motion of another start explains them
  // about as well, and has another value of it.
  void MarkAmbiguousAsUndetermined(const FitResult& fit) {
    if (Interrupted() || DegreesOfFreedom() >= kManyLeft) return;
    const double quantile = StudentQuantile(std::max(kFewestDegrees, confidence_.interval_degrees));
    const double most = fit.cost + kAsWell * quantile * quantile * confidence_.scatter / 2;
    for (const auto& [point, sigma] : others_) {
      const auto value = [&](const FitPoint& at, std::size_t u) {
        return problem_.unknowns[u].FromCoordinate(at.coordinates[u]);
      };
      const auto denies = [&](const FitPoint& at, std::size_t u) {
        const Estimate& estimate = report_.estimates[u];
        const bool outside = value(at, u) < estimate.low || value(at, u) > estimate.high;
        return estimate.determination == Determination::kDetermined && outside;
      };
      std::vector<std::size_t> denied;
      for (std::size_t u = 0; u < report_.estimates.size(); ++u) {
        if (denies(point, u)) denied.push_back(u);
      }
      if (denied.empty()) continue;
      const FitResult other = MinimizeFrom(problem_, point, problem_.options.loss_scale);
      Count(other);
      if (!other.ok || other.cost > most) continue;
      for (const std::size_t u : denied) {
        if (!denies(other.point, u)) continue;
        Estimate& estimate = report_.estimates[u];
        report_.remarks.push_back("the samples fit a motion with " + estimate.name + " " +
                                  ToText(value(other.point, u), 4) + " about as well as one with " +
                                  ToText(estimate.value, 4) + "; take more samples");
        estimate.determination = Determination::kUndetermined;
      }
    }
  }

  // An interval follows from derivatives at the minimum. Where the motion changes there, as that of a disc that lies on
  // the ground without gravity, these are of one side, and the cost may be flat on the other. A parameter is not
  // determined if a motion with the value at an end of its interval explains the samples as well.
  void MarkFlatAsUndetermined(const FitResult& fit) {
    const double quantile = StudentQuantile(std::max(kFewestDegrees, confidence_.interval_degrees));
    const double most = fit.cost + kFlat * quantile * quantile * confidence_.scatter / 2;
    for (std::size_t u = 0; u < report_.estimates.size(); ++u) {
      const FitUnknown& unknown = problem_.unknowns[u];
      Estimate& estimate = report_.estimates[u];
      if (estimate.high - estimate.low < kOfRounding * unknown.ScaleAt(estimate.value)) continue;
      for (const double end : {estimate.low, estimate.high}) {
        if (estimate.determination != Determination::kDetermined || Interrupted()) break;
        if (end <= unknown.low || end >= unknown.high) continue;
        std::vector<bool> held;
        for (const Determination at : open_.determination) held.push_back(at != Determination::kDetermined);
        held[u] = true;
        FitPoint point = fit.point;
        point.coordinates[u] = unknown.ToCoordinate(end);
        const FitResult other = MinimizeFrom(problem_, point, problem_.options.loss_scale, held, kGainOfProbe);
        if (!other.ok || other.cost >= most) continue;
        report_.remarks.push_back("the samples fit motions with " + estimate.name + " " + ToText(end, 4) +
                                  " as well as those with " + ToText(estimate.value, 4) +
                                  ", where the motion changes: its derivative is one-sided");
        estimate.determination = Determination::kUndetermined;
      }
    }
  }

  void ReportResiduals(const FitResult& fit) {
    report_.quantities = problem_.quantities;
    for (const FitProblem::Recording& recording : problem_.recordings) report_.recordings.push_back(recording.name);
    // The fit's own segments: those of a search that was interrupted have fewer samples.
    ForEachSample(problem_, fit, [&](int s, int i, const FitSample& sample, const Eigen::VectorXd& residual) {
      const Segment& segment = fit.point.segments[s];
      const Eigen::VectorXd predicted = sample.value + fit.motion[s].miss[i];
      SampleResidual at{segment.recording, segment.first + i, sample.quantity, sample.line, sample.time};
      at.measured.assign(sample.value.begin(), sample.value.begin() + sample.num_positions);
      at.predicted.assign(predicted.begin(), predicted.begin() + sample.num_positions);
      at.standardised.assign(residual.begin(), residual.begin() + sample.num_positions);
      at.outlier = residual.norm() > problem_.options.outlier;
      report_.residuals.push_back(at);
    });
  }

  FitProblem problem_;
  std::vector<Segment> segments_;
  const double length_;  // of the motion, in the unit of sigma
  std::string at_work_;  // for a person
  Openness open_;
  Confidence confidence_;      // in the result
  std::string too_few_;        // why there are too few samples
  std::vector<Found> others_;  // in which fits from other starts ended
  IdentifyReport report_;
};

}  // namespace

std::string Validate(const IdentifyOptions& options) {
  if (options.loss_scale > 0 && options.segment >= 0 && options.starts >= 1 && options.threads >= 0) return "";
  return "found an option out of range, expected loss_scale > 0, segment >= 0, starts >= 1";
}

IdentifyReport IdentifyBy(const std::shared_ptr<FitModel>& model, double length) {
  IdentifyReport report;
  FitRequest request;
  report.reason = model->Prepare(&request);
  report.verdict = FitVerdict::kNotApplicable;
  if (!report.reason.empty()) return report;
  request.problem.model = model;
  return Identification(std::move(request), length).Run();
}

const char* DeterminationToString(Determination determination) {
  constexpr const char* kNames[] = {"determined", "only in combination", "not determined", "at its bound"};
  return kNames[static_cast<int>(determination)];
}

const char* FitVerdictToString(FitVerdict verdict) {
  constexpr const char* kNames[] = {"fits",
                                    "not determined",
                                    "contradicted",
                                    "not judged",
                                    "failed",
                                    "not converged",
                                    "interrupted",
                                    "not applicable"};
  return kNames[static_cast<int>(verdict)];
}

}  // namespace saltus
