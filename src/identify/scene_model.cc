// Motions of scenes of discs, as a fit of their parameters sees them.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>

#include "base/number_text.h"
#include "base/statistics.h"
#include "identify/fit.h"
#include "identify/segment_motion.h"
#include "saltus/identify/identify.h"
#include "saltus/simulate/learned_contact.h"
#include "scene/units.h"
#include "simulate/flight.h"
#include "simulate/geometry_difference.h"

namespace saltus {
namespace {

using Kind = Unknown::Kind;

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

// Splits a text at commas; spaces do not count.
std::vector<std::string> Split(std::string_view text, char separator) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == separator) {
      parts.emplace_back();
    } else if (c != ' ') {
      parts.back() += c;
    }
  }
  return parts;
}

// Returns bounds, scale and range of starts of an unknown of a scene.
FitUnknown UnknownOf(const Unknown& unknown, const Scene& scene) {
  const double value = ValueOf(unknown, scene);
  FitUnknown fit{.name = NameOf(unknown, scene), .start = value};
  const Units units = NaturalUnits(scene);
  switch (unknown.kind) {
    case Kind::kRestitution:
      fit.low = 0;
      fit.high = 1;
      fit.first = 0.1;
      fit.last = 0.95;
      break;
    case Kind::kFriction:
      fit.low = 0;
      fit.first = 0.02;
      fit.last = 0.52;
      break;
    case Kind::kDrag:
      fit.low = 0;
      fit.scale = scene.bodies[unknown.body].mass / units.time;
      fit.first = 0.1 * fit.scale;
      fit.last = 2 * fit.scale;
      break;
    case Kind::kPosition:
    case Kind::kPlaneOffset:
    case Kind::kSegmentOffset:
    case Kind::kPlaneAngle:
    case Kind::kSegmentAngle:
      fit.scale = IsAngle(unknown.kind) ? 1 : units.length;
      fit.first = value - 0.1 * fit.scale;
      fit.last = value + 0.1 * fit.scale;
      break;
    case Kind::kGravity:
    case Kind::kForce:
      fit.scale = units.acceleration() * (unknown.kind == Kind::kForce ? scene.bodies[unknown.body].mass : 1);
      fit.first = value - 0.5 * fit.scale;
      fit.last = value + 0.5 * fit.scale;
      break;
    default:  // a positive number, for which no motion has the value 0
      fit.low = 0;
      fit.reaches_bounds = false;
      fit.is_relative = true;
      fit.scale = kInsideBounds;
      fit.first = value / std::exp(1);
      fit.last = value * std::exp(1);
  }
  return fit;
}

// A scene under a contact model, whose discs were recorded.
class SceneModel final : public FitModel {
 public:
  SceneModel(Contact contact, Scene scene, std::vector<Recording> recordings, std::vector<Unknown> unknowns,
             IdentifyOptions options)
      : contact_(std::move(contact)),
        scene_(std::move(scene)),
        recordings_(std::move(recordings)),
        unknowns_(std::move(unknowns)),
        options_(std::move(options)),
        num_plain_(unknowns_.size()) {
    // The loss of the scene has no part in this.
    scene_.objective = {};
    scene_.optimize = Optimize::kNone;
    scene_.free.clear();
  }

  std::string Prepare(FitRequest* request) override {
    if (std::string why = ValidateRequest(); !why.empty()) return why;
    for (const Unknown& unknown : unknowns_) {
      FitUnknown fit = UnknownOf(unknown, scene_);
      SetValue(unknown, fit.FromCoordinate(fit.ToCoordinate(fit.start)), &scene_);
      request->problem.unknowns.push_back(std::move(fit));
    }
    if (options_.law) {
      request->problem.learned = {options_.law->parameters, options_.law->spread, options_.law->learned_last};
    } else if (options_.events) {
      request->problem.learned = {options_.events->parameters, options_.events->spread};
    }
    for (int i = 0; request->problem.learned && i < std::ssize(request->problem.learned->parameters); ++i) {
      unknowns_.push_back({.kind = Kind::kLaw, .component = i});
      request->problem.unknowns.emplace_back();
    }
    for (const Recording& recording : recordings_) {
      auto& [name, samples] = request->problem.recordings.emplace_back();
      name = recording.name;
      for (const Sample& sample : recording.samples) samples.push_back(FitSampleOf(sample));
    }
    for (const Body& body : scene_.bodies) request->problem.quantities.push_back(body.name);
    for (const int body : free_bodies_) {
      for (int i = 0; i < 4; ++i) request->problem.free_initial.push_back({4 * body + i, body});
    }
    request->problem.options = options_;
    request->problem.states_sigma = recordings_[0].samples[0].sigma > 0;
    request->segments = CutIntoSegments(recordings_, options_.segment);
    return ValidateMeasured(request->segments);
  }

  FitMotion Move(const std::vector<double>& values, const Segment& segment, bool with_derivatives) const override {
    MotionAtSamples motion = MotionAt(values, segment, with_derivatives);
    FitMotion fit{motion.ok, std::move(motion.reason), {}, {}, {}};
    for (std::size_t i = 0; i < motion.state.size(); ++i) {
      const Sample& sample = SampleAt(segment, static_cast<int>(i));
      const Eigen::VectorXd measured = Measured(sample);
      fit.miss.emplace_back(motion.state[i].head(measured.size()) - measured);
      if (with_derivatives) fit.derivative.emplace_back(motion.derivative[i].topRows(measured.size()));
    }
    for (const StepTouch& touch : motion.touches) fit.events.push_back(touch.touch.candidate);
    return fit;
  }

  int num_start_kinds() const override { return static_cast<int>(LineKind::kNumLineKinds); }
  std::vector<double> StartOf(const std::vector<double>& values, const Segment& segment, int kind) const override {
    return InitialFromData(
        SceneAt(values), recordings_[segment.recording].samples, segment, free_bodies_, static_cast<LineKind>(kind));
  }

  std::string SigmaToText(double sigma) const override { return FormatNumbers("%.3g m", sigma); }
  std::string Subject() const override { return "scene"; }
  // The parameters of contacts that are not fitted are named with their values.
  std::string SuggestChecks() const override {
    std::string held;
    for (const Kind kind : {Kind::kRestitution, Kind::kFriction}) {
      const Unknown parameter{.kind = kind};
      if (options_.law || options_.events || std::ranges::count(unknowns_, parameter) > 0) continue;
      held += (held.empty() ? ", or let these be unknown too: " : ", ") + NameOf(parameter, scene_) + " (" +
              ToText(ValueOf(parameter, scene_), 4) + ")";
    }
    return "the sizes, walls and forces of the scene" + held;
  }

  void AddLearned(const std::vector<Segment>& segments, const std::vector<double>& values,
                  const Eigen::MatrixXd& covariance, IdentifyReport* report) const override {
    if (!options_.law && !options_.events) return;
    std::vector<MotionAtSamples> motion;
    for (const Segment& segment : segments) motion.push_back(MotionAt(values, segment, false));
    if (options_.law) report->law = LearnedLawOf(*LawAt(values), motion, covariance);
    if (options_.events) report->events = LearnedEventsOf(*EventsAt(values), motion);
  }

 private:
  std::string ValidateRequest() {
    if (recordings_.empty()) return "found no recordings, expected at least one";
    for (Recording& recording : recordings_) {
      if (const auto error = CheckRecording(scene_, &recording)) return error->ToString();
    }
    if (std::string wrong = Validate(options_); !wrong.empty()) return wrong;
    if (std::string why = ReasonNotApplicable(contact_, scene_); !why.empty()) return why;
    if (std::string wrong = ValidateLaw(); !wrong.empty()) return wrong;
    if (scene_.Spins()) return "the scene has discs that spin, and recordings have no angles";
    if (scene_.HasPaths()) {
      return "the scene has prescribed motions, which begin at time 0: fit the scene as a hybrid system "
             "(saltus.hybrid_problem)";
    }
    FindFreeBodies();
    const bool any = !unknowns_.empty() || options_.law || options_.events || !free_bodies_.empty();
    return any ? "" : "found nothing that is unknown";
  }

  std::string ValidateLaw() const {
    if (!options_.law && !options_.events) return "";
    if (options_.law && options_.events) return "found a law of impact and event functions, expected one of them";
    const std::string name = options_.law ? "a law of impact" : "event functions";
    if (!scene_.materials.empty()) {
      return "found " + name + " in a scene with materials, expected one without: it is one law for all contacts";
    }
    std::string wrong = options_.law ? Validate(*options_.law) : Validate(*options_.events, scene_);
    if (!wrong.empty()) return wrong;
    if (contact_.name() != "event") {
      return "found " + name + " with the contact model " + contact_.name() + ", expected event";
    }
    if (options_.events) wrong = ReasonNotApplicable(LearnedContact(*options_.events), scene_);
    if (!wrong.empty()) return wrong;
    const bool friction = options_.events || options_.law->HasFriction();
    for (std::size_t u = 0; u < num_plain_; ++u) {
      const Kind kind = unknowns_[u].kind;
      const bool said = kind == Kind::kRestitution || (kind == Kind::kFriction && friction);
      const bool moves = options_.events && IsOfGeometry(kind) && kind != Kind::kRadius;
      const bool unread = kind == Kind::kStiffness || kind == Kind::kDamping || moves;
      if (!said && !unread) continue;
      return "found '" + NameOf(unknowns_[u], scene_) + "' beside " + name + ", which " +
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
    free_bodies_.assign(measured.begin(), measured.end());
  }

  std::string ValidateMeasured(const std::vector<Segment>& segments) const {
    for (const Segment& segment : segments) {
      std::set<int> measured;
      for (int i = 0; i < segment.last - segment.first; ++i) measured.insert(SampleAt(segment, i).body);
      for (int body = 0; body < scene_.num_bodies(); ++body) {
        const bool needed = segment.begin > 0 || std::ranges::count(free_bodies_, body);
        if (scene_.bodies[body].fixed || measured.count(body) > 0 || !needed) continue;
        return recordings_[segment.recording].name + ": found no sample of '" + scene_.bodies[body].name + "' from " +
               std::to_string(segment.begin) + " s on, expected some in every segment of every recording";
      }
    }
    return "";
  }

  const Sample& SampleAt(const Segment& segment, int i) const {
    return recordings_[segment.recording].samples[segment.first + i];
  }

  static Eigen::VectorXd Measured(const Sample& sample) {
    Eigen::VectorXd measured(sample.velocity ? 4 : 2);
    measured.head(2) = sample.position;
    if (sample.velocity) measured.tail(2) = *sample.velocity;
    return measured;
  }

  // A velocity counts as a position over the time that the scene needs for its length.
  FitSample FitSampleOf(const Sample& sample) const {
    const Eigen::VectorXd value = Measured(sample), one = Eigen::VectorXd::Ones(value.size());
    FitSample fit{sample.time, sample.body, value, sample.sigma * one, one, 2, sample.line};
    if (sample.velocity) {
      fit.sigma.tail(2).setConstant(sample.sigma_velocity);
      fit.unit.tail(2).setConstant(1 / NaturalUnits(scene_).time);
    }
    return fit;
  }

  Scene SceneAt(const std::vector<double>& values) const {
    Scene at = scene_;
    SetValues(unknowns_, values, &at);
    return at;
  }
  // Return the learned law and events at these values, std::nullopt if none is learned.
  std::optional<ImpactLaw> LawAt(const std::vector<double>& values) const {
    std::optional<ImpactLaw> law = options_.law;
    if (law) law->parameters.assign(values.begin() + num_plain_, values.end());
    return law;
  }
  std::optional<EventFunctions> EventsAt(const std::vector<double>& values) const {
    std::optional<EventFunctions> events = options_.events;
    if (events) events->parameters.assign(values.begin() + num_plain_, values.end());
    return events;
  }

  MotionAtSamples MotionAt(const std::vector<double>& values, const Segment& segment, bool with_derivatives) const {
    const std::optional<ImpactLaw> law = LawAt(values);
    const std::optional<EventFunctions> events = EventsAt(values);
    const MotionRequest request{&recordings_[segment.recording].samples,
                                unknowns_,
                                free_bodies_,
                                law ? &*law : nullptr,
                                events ? &*events : nullptr};
    const Scene scene = SceneAt(values);
    Segment placed = segment;
    for (int body = 0; body < scene.num_bodies(); ++body) {
      if (scene.bodies[body].fixed) std::copy_n(scene.bodies[body].position.data(), 2, &placed.initial[4 * body]);
    }
    return MoveThrough(contact_, scene, placed, request, with_derivatives);
  }

  // Returns the standard error of what has these derivatives by the law's parameters.
  double ErrorOf(const Eigen::MatrixXd& covariance, const std::vector<double>& slope) const {
    const Eigen::Map<const Eigen::VectorXd> by(slope.data(), static_cast<Eigen::Index>(slope.size()));
    return std::sqrt(std::max(0.0, by.dot(covariance.bottomRightCorner(by.size(), by.size()) * by)));
  }

  LearnedLaw LearnedLawOf(ImpactLaw law, const std::vector<MotionAtSamples>& motions,
                          const Eigen::MatrixXd& covariance) const {
    constexpr int kPoints = 25;  // of the curve
    LearnedLaw learned{std::move(law), 0, {}};
    std::vector<double> approach, sliding;
    for (const MotionAtSamples& motion : motions) {
      for (const Vec2d& speeds : motion.impact_speeds) {
        approach.push_back(speeds[0]);
        sliding.push_back(speeds[1]);
      }
    }
    learned.impacts = static_cast<int>(approach.size());
    if (approach.empty() || covariance.size() == 0) return learned;
    const auto [slowest, fastest] = std::minmax_element(approach.begin(), approach.end());
    const double middle = Median(std::move(sliding));
    for (int i = 0; i < kPoints; ++i) {
      const double speed = *slowest + (*fastest - *slowest) * i / (kPoints - 1);
      const ImpactLawValues at = EvaluateLaw(learned.law, speed, middle);
      learned.curve.push_back({speed,
                               middle,
                               at.restitution,
                               ErrorOf(covariance, at.restitution_slope),
                               at.friction,
                               ErrorOf(covariance, at.friction_slope)});
    }
    return learned;
  }

  LearnedEventFunctions LearnedEventsOf(EventFunctions functions, const std::vector<MotionAtSamples>& motions) const {
    LearnedEventFunctions learned{std::move(functions), {}};
    for (std::size_t s = 0; s < motions.size(); ++s) {
      for (const ImpactState& impact : motions[s].impacts) {
        const int body = impact.candidate.a, number = impact.candidate.b;
        const double radius = scene_.bodies[body].radius;
        const Vec2d &position = impact.position[0], &before = impact.velocity[0];
        const EventValues at = EvaluateEvents(learned.functions, number, position, before, radius);
        const Plane& plane = scene_.planes[number];
        const double gap = plane.normal.normalized().dot(Vec2d(position - plane.point)) - radius;
        learned.impacts.push_back({static_cast<int>(s), body, number, position, before, at.after, at.normal, gap});
      }
    }
    return learned;
  }

  const Contact contact_;
  Scene scene_;  // of the first start
  std::vector<Recording> recordings_;
  std::vector<Unknown> unknowns_;  // those of a law or of event functions are the last
  const IdentifyOptions options_;
  const std::size_t num_plain_;   // of the others
  std::vector<int> free_bodies_;  // whose initial states are unknown
};

}  // namespace

IdentifyReport Identify(const Contact& contact, const Scene& scene, const std::vector<Recording>& recordings,
                        const std::vector<Unknown>& unknowns, const IdentifyOptions& options) {
  IdentifyReport report = IdentifyBy(std::make_shared<SceneModel>(contact, scene, recordings, unknowns, options),
                                     NaturalUnits(scene).length);
  for (std::size_t u = 0; u < report.estimates.size(); ++u) report.estimates[u].unknown = unknowns[u];
  return report;
}

Scene FittedScene(const Scene& scene, const std::vector<Estimate>& estimates) {
  std::vector<Unknown> unknowns;
  std::vector<double> values;
  for (const Estimate& estimate : estimates) {
    unknowns.push_back(estimate.unknown);
    values.push_back(estimate.value);
  }
  Scene fitted = scene;
  SetValues(unknowns, values, &fitted);
  return fitted;
}

std::variant<std::vector<Unknown>, std::string> ParseUnknowns(std::string_view names, const Scene& scene) {
  std::vector<Unknown> all;
  for (const std::string& name : Split(names, ',')) {
    const std::vector<Unknown> found = ParametersNamed(name, scene);
    if (found.empty()) {
      return "found '" + name + "', expected some of " + ContactParametersOf(scene) +
             ", gravity, gravity.x, gravity.y, mass.BODY, force.BODY, force.BODY.x, force.BODY.y, with a BODY that "
             "moves, drag.BODY of one with drag, radius.BODY, position.BODY, position.BODY.x, position.BODY.y of one "
             "that is fixed, and offset.WALL, angle.WALL of a plane or a segment";
    }
    all.insert(all.end(), found.begin(), found.end());
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (std::find(all.begin(), all.begin() + i, all[i]) != all.begin() + i) {
      return "found '" + NameOf(all[i], scene) + "' again, expected it once";
    }
  }
  return all;
}

}  // namespace saltus
