#include "saltus/identify/identify.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "base/number_text.h"
#include "base/statistics.h"
#include "identify/fit.h"
#include "identify/statistics.h"
#include "identify/unknowns.h"
#include "saltus/simulate/learned_contact.h"
#include "scene/units.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

using Kind = Unknown::Kind;

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
constexpr double kAsWell = 2;   // squares of the interval's quantile by which a motion explains samples as well
constexpr int kScreened = 100;  // starts that are compared, by kind of line
constexpr int kFitted = 5;      // times the starts, of which these are fitted a little
constexpr double kGainOfScreening = 0.1;  // share of the cost that an iteration of these must gain
constexpr int kFewLeft = 20;              // the same, below which one outlier may look like noise
constexpr double kNoOutlier = 0.005;      // estimated sigma, of the extent of the motion, that then is no outlier
constexpr int kManyLeft = 60;             // numbers more than unknowns, from which on one start may be enough
constexpr double kFirstSigma = 1e-3;      // of the scene's length, until it is estimated
constexpr double kLeastSigma = 1e-20;     // of the scene's length: residuals that are smaller are 0

// The i-th number of the low-discrepancy sequence of van der Corput, in (0, 1).
double RadicalInverse(int i, int base) {
  double value = 0, digit = 1.0 / base;
  for (; i > 0; i /= base, digit /= base) value += digit * (i % base);
  return value;
}

constexpr int kFewest = 4, kMost = 12;  // samples that a line goes through
constexpr double kNoise = 1e-4;         // of the scene's length: misses below it are no reason for a shorter line

// The line y = at + slope x by the medians of Theil and Sen, and the median of its residuals.
struct Line {
  double at = 0, slope = 0, miss = 0;
};
Line FitLine(const std::vector<double>& x, const std::vector<double>& y) {
  Line line;
  std::vector<double> slopes, offsets, misses;
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = i + 1; j < x.size(); ++j) slopes.push_back((y[j] - y[i]) / (x[j] - x[i]));
  }
  line.slope = Median(slopes);
  for (std::size_t i = 0; i < x.size(); ++i) offsets.push_back(y[i] - line.slope * x[i]);
  line.at = Median(offsets);
  for (std::size_t i = 0; i < x.size(); ++i) misses.push_back(std::abs(offsets[i] - line.at));
  line.miss = Median(misses);
  return line;
}

struct Track {
  std::vector<double> time;  // s, since the segment begins
  std::vector<double> flat[2];
};

// How a line through the first samples is found, as starts differ in it.
enum class LineKind {
  kMedians,      // of slopes: precise, unless more than a quarter of the samples are outliers
  kLeastMedian,  // through those two samples that leave the least median miss (Rousseeuw 1984): up to half of them
  kFirstTwo,     // an impact may come after the second sample
  kFirst,        // through the first sample, with the velocity of the scene
  kScene,        // none: the initial state of the scene
  kNumLineKinds,
};

// The first `count` samples of a track, by a line in each coordinate.
std::array<Line, 2> FitLines(const Track& track, int count, LineKind kind) {
  const std::vector<double> time(track.time.begin(), track.time.begin() + count);
  std::array<Line, 2> best;
  if (kind == LineKind::kMedians) {
    for (int j = 0; j < 2; ++j) best[j] = FitLine(time, {track.flat[j].begin(), track.flat[j].begin() + count});
    return best;
  }
  double least = std::numeric_limits<double>::infinity();
  for (int a = 0; a < count; ++a) {
    for (int b = a + 1; b < count; ++b) {
      std::array<Line, 2> lines;
      for (int j = 0; j < 2; ++j) {
        const std::vector<double>& y = track.flat[j];
        lines[j].slope = (y[b] - y[a]) / (time[b] - time[a]);
        lines[j].at = y[a] - lines[j].slope * time[a];
      }
      std::vector<double> misses;
      for (int i = 0; i < count; ++i) {
        const auto miss = [&](int j) { return track.flat[j][i] - lines[j].at - lines[j].slope * time[i]; };
        misses.push_back(std::hypot(miss(0), miss(1)));
      }
      lines[0].miss = Median(std::move(misses));
      if (!(lines[0].miss < least)) continue;
      least = lines[0].miss;
      best = lines;
    }
  }
  return best;
}

// The line whose velocity is known best: long, unless an impact bends the motion.
void FitTrack(const Track& track, double noise, LineKind kind, const Vec2d& scene_velocity, Vec2d* position,
              Vec2d* velocity) {
  const int count = static_cast<int>(track.time.size());
  if (count == 1 || kind == LineKind::kFirst) {
    *position = {track.flat[0][0], track.flat[1][0]};
    *velocity = scene_velocity;
    *position -= track.time[0] * *velocity;
    return;
  }
  double best = std::numeric_limits<double>::infinity();
  const int most = kind == LineKind::kFirstTwo ? 2 : kMost;
  for (int n = std::min({count, kFewest, most}); n <= std::min(count, most); ++n) {
    const std::array<Line, 2> line = FitLines(track, n, kind);
    const double error = (line[0].miss + line[1].miss + noise) / (track.time[n - 1] * std::sqrt(n));
    if (error >= best) continue;
    best = error;
    *position = {line[0].at, line[1].at};
    *velocity = {line[0].slope, line[1].slope};
  }
}

// Moves overlapping pairs apart along their normal, each disc by half the overlap.
void MoveApart(const Scene& scene, std::vector<double>* initial) {
  const double slack = 1e-9 * NaturalUnits(scene).length;
  const auto at = [&](int i) { return Eigen::Map<Vec2d>(&(*initial)[4 * i]); };
  for (int pass = 0; pass < 20; ++pass) {
    for (int a = 0; a < scene.num_bodies(); ++a) {
      if (scene.bodies[a].fixed) continue;
      for (int b = 0; b < scene.num_bodies(); ++b) {
        if (b == a) continue;
        const Vec2d apart = at(a) - at(b);
        const double overlap = scene.bodies[a].radius + scene.bodies[b].radius + slack - apart.norm();
        if (overlap <= 0 || apart.norm() == 0) continue;
        at(a) += (scene.bodies[b].fixed ? 1.0 : 0.5) * overlap * apart.normalized();
      }
      for (const Plane& plane : scene.planes) {
        const Vec2d normal = plane.normal.normalized();
        const double overlap = scene.bodies[a].radius + slack - normal.dot(Vec2d(at(a) - plane.point));
        if (overlap > 0) at(a) += overlap * normal;
      }
    }
  }
}

// Cuts recordings into segments of at most `length`, each of which begins with a sample; 0: one per recording, which
// begins at time 0.
std::vector<Segment> CutIntoSegments(const std::vector<Recording>& recordings, double length) {
  std::vector<Segment> segments;
  for (std::size_t r = 0; r < recordings.size(); ++r) {
    const std::vector<Sample>& samples = recordings[r].samples;
    for (int i = 0; i < static_cast<int>(samples.size()); ++i) {
      const bool first = i == 0;
      if (first || (length > 0 && samples[i].time >= segments.back().begin + length)) {
        segments.push_back({static_cast<int>(r), first && length <= 0 ? 0 : samples[i].time, i, i, {}});
      }
      segments.back().last = i + 1;
    }
  }
  return segments;
}

// Returns initial states of `free_bodies` by lines through their first samples, less the effect of gravity and forces,
// robust to a few outliers; those of the others are the scene's. Overlapping discs are moved apart. In scene units.
std::vector<double> InitialFromData(const Scene& scene, const std::vector<Sample>& samples, const Segment& segment,
                                    const std::vector<int>& free_bodies, LineKind kind) {
  std::vector<double> initial = InitialState(scene);
  for (const int body : free_bodies) {
    Track track;
    std::optional<Vec2d> measured;
    const Vec2d acceleration = InitialAcceleration(scene, body);
    for (int i = segment.first; i < segment.last && track.time.size() < kMost; ++i) {
      const Sample& sample = samples[i];
      if (sample.body != body) continue;
      const double t = sample.time - segment.begin;
      if (track.time.empty() && sample.velocity) measured = *sample.velocity - t * acceleration;
      track.time.push_back(t);
      for (int j = 0; j < 2; ++j) track.flat[j].push_back(sample.position[j] - 0.5 * t * t * acceleration[j]);
    }
    if (track.time.empty() || kind == LineKind::kScene) continue;
    Vec2d position, velocity;
    FitTrack(track,
             kNoise * NaturalUnits(scene).length,
             kind,
             measured.value_or(scene.bodies[body].velocity),
             &position,
             &velocity);
    if (measured) velocity = *measured;
    std::copy_n(position.data(), 2, &initial[4 * body]);
    std::copy_n(velocity.data(), 2, &initial[4 * body + 2]);
  }
  MoveApart(scene, &initial);
  return initial;
}

class Identification {
 public:
  Identification(const Contact& contact, const Scene& scene, const std::vector<Recording>& recordings,
                 const std::vector<Unknown>& unknowns, const IdentifyOptions& options)
      : options_(options), start_scene_(scene) {
    if (options.status) {
      options_.status = [this, say = options.status](const std::string& what) { say(at_work_ + ", " + what); };
    }
    problem_.contact = contact;
    problem_.scene = scene;
    problem_.recordings = &recordings_;
    problem_.unknowns = unknowns;
    problem_.options = &options_;
    recordings_ = recordings;
    for (const Unknown& unknown : unknowns) {
      SetValue(unknown, FromCoordinate(unknown, ToCoordinate(unknown, ValueOf(unknown, scene))), &problem_.scene);
    }
    problem_.num_plain = static_cast<int>(unknowns.size());
    if (const auto learned = LearnedStartOf(options)) {
      for (int i = 0; i < static_cast<int>(learned->parameters.size()); ++i) {
        problem_.unknowns.push_back({.kind = Kind::kLaw, .component = i});
      }
    }
    // The loss of the scene has no part in this.
    problem_.scene.objective = {};
    problem_.scene.optimize = Optimize::kNone;
    problem_.scene.free.clear();
  }

  IdentifyReport Run() {
    const auto begin = std::chrono::steady_clock::now();
    report_.reason = WhyNot();
    if (!report_.reason.empty()) {
      report_.verdict = FitVerdict::kNotApplicable;
      return report_;
    }
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

  std::string WhyNot() {
    if (recordings_.empty()) return "found no recordings, expected at least one";
    for (Recording& recording : recordings_) {
      if (const auto error = CheckRecording(problem_.scene, &recording)) return error->ToString();
    }
    if (options_.loss_scale <= 0 || options_.segment < 0 || options_.starts < 1 || options_.threads < 0) {
      return "found an option out of range, expected loss_scale > 0, segment >= 0, starts >= 1";
    }
    const std::string why = WhyNotApplicable(problem_.contact, problem_.scene);
    if (!why.empty()) return why;
    if (std::string wrong = WhatIsWrongWithTheLaw(); !wrong.empty()) return wrong;
    if (problem_.scene.Spins()) return "the scene has discs that spin, and recordings have no angles";
    FindFreeBodies();
    if (problem_.unknowns.empty() && problem_.free_bodies.empty()) return "found nothing that is unknown";
    segments_ = CutIntoSegments(recordings_, options_.segment);
    return WhyNotMeasured();
  }

  std::string WhatIsWrongWithTheLaw() const {
    if (!options_.law && !options_.events) return "";
    if (options_.law && options_.events) return "found a law of impact and event functions, expected one of them";
    const std::string name = options_.law ? "a law of impact" : "event functions";
    if (!problem_.scene.materials.empty()) {
      return "found " + name + " in a scene with materials, expected one without: it is one law for all contacts";
    }
    std::string wrong =
        options_.law ? WhatIsWrongWith(*options_.law) : WhatIsWrongWith(*options_.events, problem_.scene);
    if (!wrong.empty()) return wrong;
    if (problem_.contact.name() != "event") {
      return "found " + name + " with the contact model " + problem_.contact.name() + ", expected event";
    }
    if (options_.events) wrong = WhyNotApplicable(LearnedContact(*options_.events), problem_.scene);
    if (!wrong.empty()) return wrong;
    const bool friction = options_.events || options_.law->HasFriction();
    for (int u = 0; u < problem_.num_plain; ++u) {
      const Kind kind = problem_.unknowns[u].kind;
      const bool said = kind == Kind::kRestitution || (kind == Kind::kFriction && friction);
      const bool unread = kind == Kind::kStiffness || kind == Kind::kDamping;
      if (!said && !unread) continue;
      return "found '" + NameOf(problem_.unknowns[u], problem_.scene) + "' beside " + name + ", which " +
             (options_.law ? (said ? "determines it" : "does not read it")
                           : (said ? "determine it" : "do not read it"));
    }
    return "";
  }

  // Finds the discs that any recording has; with segments, every disc that moves.
  void FindFreeBodies() {
    if (!options_.initial_states) return;
    std::set<int> measured;
    for (const Recording& recording : recordings_) {
      for (const Sample& sample : recording.samples) measured.insert(sample.body);
    }
    problem_.free_bodies.assign(measured.begin(), measured.end());
  }

  std::string WhyNotMeasured() const {
    for (const Segment& segment : segments_) {
      std::set<int> measured;
      for (int i = segment.first; i < segment.last; ++i) {
        measured.insert(recordings_[segment.recording].samples[i].body);
      }
      for (int body = 0; body < problem_.scene.num_bodies(); ++body) {
        const bool needed = segment.begin > 0 || std::ranges::count(problem_.free_bodies, body);
        if (problem_.scene.bodies[body].fixed || measured.count(body) > 0 || !needed) continue;
        return recordings_[segment.recording].name + ": found no sample of '" + problem_.scene.bodies[body].name +
               "' from " + std::to_string(segment.begin) + " s on, expected some in every segment of every recording";
      }
    }
    return "";
  }

  void Fit() {
    const Units units = NaturalUnits(problem_.scene);
    states_sigma_ = recordings_[0].samples[0].sigma > 0;
    SetSigma(kFirstSigma * units.length);
    FitResult best = SearchFromStarts();
    if (!best.ok) {
      report_.verdict = Interrupted() ? FitVerdict::kInterrupted : FitVerdict::kFailed;
      report_.reason = best.reason;
      return;
    }
    best = Polish(best);
    Report(best);
  }

  bool Interrupted() const { return options_.stop && options_.stop(); }

  // A velocity counts as a position over the time that the scene needs for its length.
  void SetSigma(double sigma) {
    problem_.sigma = sigma;
    problem_.sigma_velocity = sigma / NaturalUnits(problem_.scene).time;
  }

  // The scene's values first, then values spread over what is plausible.
  FitPoint StartAt(int number, LineKind kind) const {
    static constexpr int kBases[] = {2, 3, 5, 7, 11, 13, 17, 19, 23, 29};
    FitPoint point;
    for (int u = 0; u < problem_.num_plain; ++u) {
      const Unknown& unknown = problem_.unknowns[u];
      const double value = ValueOf(unknown, problem_.scene), scale = ScaleOf(unknown, problem_.scene);
      const double t = number == 0 ? 0.5 : RadicalInverse(number, kBases[u % 10]);
      double start = value;
      if (number > 0) {
        switch (unknown.kind) {
          case Kind::kRestitution:
            start = 0.1 + 0.85 * t;
            break;
          case Kind::kFriction:
            start = 0.02 + 0.5 * t;
            break;
          case Kind::kGravity:
          case Kind::kForce:
            start = value + scale * (t - 0.5);
            break;
          default:
            start = value * std::exp(2 * (t - 0.5));
        }
      }
      point.coordinates.push_back(ToCoordinate(unknown, start));
    }
    if (const auto learned = LearnedStartOf(options_)) {
      point.coordinates.insert(point.coordinates.end(), learned->parameters.begin(), learned->parameters.end());
    }
    const Scene scene = problem_.SceneAt(point.coordinates);
    point.segments = segments_;
    for (Segment& segment : point.segments) {
      segment.initial =
          InitialFromData(scene, recordings_[segment.recording].samples, segment, problem_.free_bodies, kind);
    }
    return point;
  }

  // With the samples up to a share of each segment's.
  FitPoint UpTo(double share, FitPoint point) const {
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
    if (some.ok) some = MinimizeFrom(problem_, some.point, options_.loss_scale);
    Count(some);
    return some.ok && (!all.ok || some.cost < all.cost) ? some : all;
  }

  // With more and more of the samples. Unknowns in `held` stay as they are.
  FitResult FitAlong(const FitPoint& start, const std::string& name, const std::vector<bool>& held) {
    FitResult fit;
    fit.point = start;
    for (const double share : kHorizons) {
      at_work_ = name + ", " + std::to_string(static_cast<int>(std::lround(100 * share))) + " % of the samples";
      const double scale = options_.loss_scale * (share < 1 ? kWideLoss : 1);
      FitResult next = MinimizeFrom(problem_, UpTo(share, fit.point), scale, held, kGainOfSearch);
      Count(next);
      if (!next.ok) return next;
      fit = std::move(next);
      if (Interrupted()) break;
    }
    return fit;
  }

  std::vector<bool> LearnedLast() const {
    if (!options_.law || options_.law->learned_last == 0) return {};
    std::vector<bool> held(problem_.unknowns.size(), false);
    std::fill_n(held.begin() + problem_.num_plain, options_.law->learned_last, true);
    return held;
  }

  void Count(const FitResult& fit) {
    report_.iterations += fit.iterations;
    report_.evaluations += fit.evaluations;
  }

  static std::string SequenceOf(const FitResult& fit) {
    std::string sequence;
    for (const MotionAtSamples& motion : fit.motion) {
      Candidate last{-1, -1, false};
      for (const StepTouch& at : motion.touches) {
        const Candidate& c = at.touch.candidate;
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
      for (int kind = 0; kind < static_cast<int>(LineKind::kNumLineKinds); ++kind) {
        FitPoint point = StartAt(number, static_cast<LineKind>(kind));
        const auto [miss, contacts] = MissOf(point);
        if (std::isfinite(miss)) starts[contacts].emplace_back(miss, std::move(point));
      }
    }
    // The best of each number of contacts, the second best of each, and so on.
    std::vector<FitPoint> best;
    std::size_t place = 0;
    for (auto& [contacts, group] : starts) std::ranges::stable_sort(group, {}, &std::pair<double, FitPoint>::first);
    for (bool any = true; any && static_cast<int>(best.size()) < kFitted * options_.starts; ++place) {
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
      FitResult fit = MinimizeFrom(problem_, point, kWideLoss * options_.loss_scale, {}, kGainOfScreening);
      Count(fit);
      if (fit.ok) fitted.emplace_back(fit.cost, std::move(fit.point));
    }
    std::ranges::stable_sort(fitted, {}, &std::pair<double, FitPoint>::first);
    best.clear();
    for (auto& [cost, point] : fitted) {
      if (static_cast<int>(best.size()) < options_.starts) best.push_back(std::move(point));
    }
    return best;
  }

  // The sum of the distances of all samples from the motion, in sigmas, and its number of contacts; infinite if there
  // is none.
  std::pair<double, std::size_t> MissOf(const FitPoint& point) const {
    FitResult at;
    std::size_t contacts = 0;
    at.point = point;
    const Scene scene = problem_.SceneAt(point.coordinates);
    const std::optional<ImpactLaw> law = problem_.LawAt(point.coordinates);
    const std::optional<EventFunctions> events = problem_.EventsAt(point.coordinates);
    for (const Segment& segment : point.segments) {
      at.motion.push_back(MoveThrough(
          problem_.contact, scene, segment, problem_.RequestOf(segment, law, events), /*with_derivatives=*/false));
      if (!at.motion.back().ok) return {std::numeric_limits<double>::infinity(), 0};
      contacts += at.motion.back().touches.size();
    }
    double miss = 0;
    ForEachSample(
        problem_, at, [&](int, int, const Sample&, const Eigen::VectorXd& residual) { miss += residual.norm(); });
    return {miss, contacts};
  }

  // With all samples at once.
  FitResult FitAll(const FitPoint& start, const std::string& name) {
    FitResult fit;
    fit.point = start;
    for (const double wider : {kWideLoss, 1.0}) {
      at_work_ = name;
      FitResult next = MinimizeFrom(problem_, fit.point, options_.loss_scale * wider, {}, kGainOfSearch);
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
    const int starts = problem_.num_plain > 0 ? options_.starts : 1;  // which differ in these unknowns only
    constexpr LineKind kInTurn[] = {LineKind::kMedians, LineKind::kLeastMedian, LineKind::kFirstTwo};
    const bool few = NumbersLeft() < kManyLeft;
    // The first part of many samples shows where a motion begins, unless there are many outliers in it.
    const int first_screened = few ? 1 : (starts + 1) / 2;
    std::vector<FitPoint> screened;
    for (int number = 0; number < starts && !Interrupted(); ++number) {
      if (number == first_screened) screened = ScreenStarts();
      const std::string name = "start " + std::to_string(number + 1);
      const int rank = number - first_screened;
      FitResult fit = rank >= 0 && rank < static_cast<int>(screened.size())
                          ? FitAll(screened[rank], name)
                          : FitFrom(StartAt(number, kInTurn[number % std::size(kInTurn)]), name);
      ++report_.starts;
      if (!fit.ok) {
        if (!best.ok) best.reason = fit.reason;
        continue;
      }
      const bool known = !sequences.insert(SequenceOf(fit)).second;
      const double before = best.cost;
      const bool same = best.ok && std::abs(fit.cost - before) < 1e-6 * before;
      others_.push_back({fit.point, problem_.sigma * (states_sigma_ ? 1 : MisfitOf(problem_, fit))});
      if (!best.ok || fit.cost < best.cost) best = std::move(fit);
      // Without a stated sigma, or with many outliers, a fit must be found again, from another start.
      const bool again = same && known && IsClose(best);
      const bool enough = again || (states_sigma_ && IsFound(best));
      if (!few && enough && !FindOutlierRuns(problem_, best).follow_each_other) break;
    }
    report_.sequences = static_cast<int>(sequences.size());
    return best;
  }

  // Whether the motion passes by the samples except for outliers.
  bool IsClose(const FitResult& fit) const {
    const double misfit = MisfitOf(problem_, fit);
    return states_sigma_ ? misfit < kFits : problem_.sigma * misfit < kMostWaves * ExtentOf(problem_, fit);
  }
  bool IsFound(const FitResult& fit) const { return IsClose(fit) && OutlierShareOf(problem_, fit) < kFewOutliers; }

  // Whether so many of many samples are outliers, by a stated sigma, that this or the model is wrong.
  bool OutliersAreMost(const FitResult& fit) const {
    return states_sigma_ && NumbersLeft() >= kFewLeft && OutlierShareOf(problem_, fit) > kTooMany;
  }

  // Whether more numbers were measured than are unknown. Otherwise a motion can pass through all samples, and nothing
  // shows how much noise they have.
  bool HasResiduals() const { return NumbersLeft() > 0; }
  // Returns the number of measured numbers less that of unknown ones.
  int NumbersLeft() const {
    std::size_t measured = 0;
    for (const Recording& recording : recordings_) {
      for (const Sample& sample : recording.samples) measured += sample.velocity ? 4 : 2;
    }
    return static_cast<int>(measured) - problem_.num_plain -
           static_cast<int>(4 * problem_.free_bodies.size() * segments_.size());
  }

  // If none is stated.
  FitResult EstimateSigma(FitResult fit) {
    const double least = kLeastSigma * NaturalUnits(problem_.scene).length;
    for (int round = 0; round < 3 && !states_sigma_ && HasResiduals(); ++round) {
      SetSigma(std::max(least, problem_.sigma * MisfitOf(problem_, fit)));
      FitResult next = MinimizeFrom(problem_, fit.point, options_.loss_scale);
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
    const std::size_t count = states_sigma_ ? 0 : all.size();
    for (std::size_t i = 0; i < count; ++i) all.push_back({all[i].point, all[i].sigma / 2});
    problem_.drops_outliers = true;
    double best_sigma = problem_.sigma, least = std::numeric_limits<double>::infinity();
    for (const auto& [point, sigma] : all) {
      SetSigma(sigma);
      FitResult next = MinimizeFrom(problem_, point, options_.loss_scale);
      Count(next);
      if (!next.ok) continue;
      next = EstimateSigma(std::move(next));
      const double scale = problem_.sigma * problem_.sigma * next.cost;
      if (!(scale < least)) continue;
      least = scale;
      best_sigma = problem_.sigma;
      fit = std::move(next);
    }
    SetSigma(best_sigma);
    return fit;
  }

  // Estimates sigma if none is stated, leaves out many outliers, holds what the data leave open, and takes the
  // covariance.
  FitResult Polish(FitResult fit) {
    at_work_ = "confidence";
    fit = EstimateSigma(std::move(fit));
    if (options_.loss != RobustLoss::kNone && NumbersLeft() >= kFewLeft &&
        OutlierShareOf(problem_, fit) >= kFewOutliers) {
      FitResult rest = DropOutliers(fit);
      problem_.drops_outliers = !OutliersAreMost(rest);
      if (problem_.drops_outliers) fit = std::move(rest);
    }
    open_ = FindOpenUnknowns(problem_, fit, options_.loss_scale);
    too_few_ = WhyTooFew(fit);  // before unknowns are held, which then take no number of the samples
    if ((!states_sigma_ && !HasResiduals()) || !too_few_.empty()) {
      open_.determination.assign(open_.determination.size(), Determination::kUndetermined);
    }
    std::vector<bool> held;
    for (const Determination at : open_.determination) held.push_back(at != Determination::kDetermined);
    FitPoint point = fit.point;
    for (int u = 0; u < problem_.num_plain; ++u) {
      if (open_.determination[u] == Determination::kAtBound) MoveToBound(problem_.unknowns[u], &point.coordinates[u]);
    }
    FitResult last = MinimizeFrom(problem_, point, options_.loss_scale, held);
    Count(last);
    if (last.ok) fit = std::move(last);
    confidence_ = ConfidenceOf(problem_, fit, options_.loss_scale, held);
    return fit;
  }

  // Returns the reason why the samples are too few to determine the error of a fit; empty if they are not.
  std::string WhyTooFew(const FitResult& fit) const {
    const int left = NumbersLeft();
    if (!HasResiduals() || left >= kManyLeft || OutliersAreMost(fit)) return "";
    const Confidence confidence = ConfidenceOf(problem_, fit, options_.loss_scale);
    const std::string state = states_sigma_ ? "" : "state sigma, ";
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
    if (!states_sigma_ && (left < kFewLeft ? sigma > kNoOutlier : sigma > kMostWaves && sigma < kMostScatter)) {
      return outlier + FormatNumbers("by %.2g %% of the extent of the motion", 100 * sigma) + remedy;
    }
    if (states_sigma_ && (left < kFewLeft || share >= kFewOutliers) && !confidence.is_noise) {
      return outlier + FormatNumbers("by %.2g times their sigma", std::sqrt(confidence.scatter)) + remedy;
    }
    return "";
  }

  double FewestDegrees(bool has_outliers) const {
    if (has_outliers) return kFewestBesideOutliers;
    return states_sigma_ || options_.loss == RobustLoss::kNone ? kFewestDegrees : kFewestWithoutSigma;
  }

  void Report(const FitResult& fit) {
    ReportEstimates(fit);
    LeaveOpenWhatOthersDeny(fit);
    if (options_.law) report_.law = LearnedLawOf(problem_, fit, confidence_.covariance);
    if (options_.events) report_.events = LearnedEventsOf(problem_, fit);
    ReportResiduals(fit);
    report_.cost = fit.cost;
    report_.sigma = states_sigma_ || !HasResiduals() ? 0 : problem_.sigma;
    report_.misfit = states_sigma_ ? MisfitOf(problem_, fit) : 0;
    for (std::size_t s = 0; s < segments_.size(); ++s) {
      report_.initial.push_back(fit.point.segments[s].initial);
      report_.segment_begin.push_back(segments_[s].begin);
      report_.segment_recording.push_back(segments_[s].recording);
      report_.impacts += static_cast<int>(fit.motion[s].touches.size());
    }
    SetVerdict(fit);
  }

  void SetVerdict(const FitResult& fit) {
    const bool none_left = !states_sigma_ && !HasResiduals();
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
    } else if (const std::string at_bound = AtBounds(); !states_sigma_ && !at_bound.empty()) {
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
    const bool counts = states_sigma_ || OutlierShareOf(problem_, fit) >= kFewOutliers || runs.largest > kFarOff;
    return runs.follow_each_other && counts;
  }

  std::string AtBounds() const {
    std::string names;
    for (const Estimate& estimate : report_.estimates) {
      if (estimate.determination != Determination::kAtBound) continue;
      names += (names.empty() ? "" : ", ") + estimate.name;
    }
    return names;
  }

  // Returns the reason why no parameters explain the samples; empty if these may. Adds remarks on the residuals.
  std::string ContradictionOf(const FitResult& fit) {
    if (states_sigma_) {
      if (report_.misfit < kFarBelow && NumbersLeft() >= kFewLeft) {
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
             (strays ? " that follow each other" : "") + "; check sigma, and the sizes, walls and forces of the scene" +
             HeldParameters();
    }
    const double extent = ExtentOf(problem_, fit), share = problem_.sigma / extent;
    const Runs runs = CountRuns(problem_, fit);
    const bool systematic = runs.Systematic();
    const std::string waves =
        "residuals are systematic: " + std::to_string(runs.found) + " runs of one sign among " +
        std::to_string(runs.signs) +
        FormatNumbers(", expected %.0f +- %.0f of independent errors", runs.expected, runs.deviation);
    const std::string scatter =
        FormatNumbers("sigma was estimated: %.3g m, %.2g %% of the extent of the motion", problem_.sigma, 100 * share);
    report_.remarks.push_back(scatter);
    if (systematic) {
      report_.remarks.push_back(waves +
                                "; the scene lacks an effect of the size of sigma, and the standard errors are "
                                "too small");
    }
    const std::string remedy = "; check the units, and the sizes, walls and forces of the scene" + HeldParameters();
    if (!(share < kMostScatter)) {
      return scatter + FormatNumbers(", where less than %.0f %% is expected", 100 * kMostScatter) + remedy;
    }
    return systematic && share > kMostWaves ? waves + "; " + scatter + remedy : "";
  }

  // Returns the parameters of contacts that are not fitted, with their values, to be read after what may be wrong.
  std::string HeldParameters() const {
    std::string held;
    if (options_.law || options_.events) return held;
    for (const Kind kind : {Kind::kRestitution, Kind::kFriction}) {
      const Unknown parameter{.kind = kind};
      if (std::ranges::count(problem_.unknowns, parameter) > 0) continue;
      held += (held.empty() ? ", or let these be unknown too: " : ", ") + NameOf(parameter, problem_.scene) + " (" +
              ToText(ValueOf(parameter, problem_.scene), 4) + ")";
    }
    return held;
  }

  // Whether anything was found that was asked for. Without unknowns that is the motion.
  bool AnyDetermined() const {
    if (report_.law && !report_.law->curve.empty()) return true;
    if (report_.events && !report_.events->impacts.empty()) return true;
    const bool learns = options_.law || options_.events;
    if (report_.estimates.empty()) return !learns;
    return std::any_of(report_.estimates.begin(), report_.estimates.end(), [](const Estimate& estimate) {
      return estimate.determination == Determination::kDetermined || estimate.determination == Determination::kAtBound;
    });
  }

  void ReportEstimates(const FitResult& fit) {
    const Eigen::MatrixXd& covariance = confidence_.covariance;
    const double quantile = StudentQuantile(std::max(kFewestDegrees, confidence_.interval_degrees));
    std::vector<int> determined;
    for (int u = 0; u < problem_.num_plain; ++u) {
      Estimate estimate;
      estimate.unknown = problem_.unknowns[u];
      estimate.name = NameOf(estimate.unknown, problem_.scene);
      estimate.start = ValueOf(estimate.unknown, start_scene_);
      estimate.determination = open_.determination[u];
      // There is none if the derivatives have not full rank, and then no value either.
      if (covariance.size() == 0 && estimate.determination == Determination::kDetermined) {
        estimate.determination = Determination::kUndetermined;
      }
      for (const int other : open_.with[u]) estimate.with.push_back(NameOf(problem_.unknowns[other], problem_.scene));
      if (estimate.determination == Determination::kDetermined) {
        determined.push_back(u);
        estimate.value = FromCoordinate(estimate.unknown, fit.point.coordinates[u]);
        estimate.standard_error = std::sqrt(covariance(u, u));
        SetInterval(quantile, &estimate);
      } else if (estimate.determination == Determination::kAtBound) {
        estimate.value = BoundNear(estimate.unknown, FromCoordinate(estimate.unknown, fit.point.coordinates[u]));
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
  void LeaveOpenWhatOthersDeny(const FitResult& fit) {
    if (Interrupted() || NumbersLeft() >= kManyLeft) return;
    const double quantile = StudentQuantile(std::max(kFewestDegrees, confidence_.interval_degrees));
    const double most = fit.cost + kAsWell * quantile * quantile * confidence_.scatter / 2;
    for (const auto& [point, sigma] : others_) {
      const auto value = [&](const FitPoint& at, std::size_t u) {
        return FromCoordinate(report_.estimates[u].unknown, at.coordinates[u]);
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
      const FitResult other = MinimizeFrom(problem_, point, options_.loss_scale);
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

  static void SetInterval(double quantile, Estimate* estimate) {
    const double half = quantile * estimate->standard_error;
    estimate->low = estimate->value - half;
    estimate->high = estimate->value + half;
    const Kind kind = estimate->unknown.kind;
    if (kind != Kind::kGravity && kind != Kind::kForce) estimate->low = std::max(0.0, estimate->low);
    if (kind == Kind::kRestitution) estimate->high = std::min(1.0, estimate->high);
  }

  void ReportResiduals(const FitResult& fit) {
    // The fit's own segments: those of a search that was interrupted have fewer samples.
    ForEachSample(problem_, fit, [&](int s, int i, const Sample&, const Eigen::VectorXd& residual) {
      const Segment& segment = fit.point.segments[s];
      SampleResidual at{segment.recording, segment.first + i, fit.motion[s].state[i].head<2>(), residual.head<2>()};
      at.outlier = residual.norm() > options_.outlier;
      report_.residuals.push_back(at);
    });
  }

  IdentifyOptions options_;
  std::string at_work_;  // for a person
  const Scene start_scene_;
  std::vector<Recording> recordings_;
  FitProblem problem_;
  std::vector<Segment> segments_;  // without initial states
  bool states_sigma_ = false;
  Openness open_;
  Confidence confidence_;      // in the result
  std::string too_few_;        // why there are too few samples
  std::vector<Found> others_;  // in which fits from other starts ended
  IdentifyReport report_;
};

}  // namespace

IdentifyReport Identify(const Contact& contact, const Scene& scene, const std::vector<Recording>& recordings,
                        const std::vector<Unknown>& unknowns, const IdentifyOptions& options) {
  return Identification(contact, scene, recordings, unknowns, options).Run();
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
