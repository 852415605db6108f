#include "simulate/interval_gaps.h"

#include <algorithm>

namespace saltus {
namespace {

constexpr int kBisections = 60;
constexpr double kSameImpact = 1e-12;  // of the interval: impacts of a disc at one time

// Returns the time between two others at which a rate ceases to be negative; nothing if it is not at the first, or
// still is at the second.
template <typename Rate>
std::optional<double> EndOfFall(const Rate& rate, double from, double to) {
  if (rate(from) >= 0 || rate(to) < 0) return std::nullopt;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (from + to);
    (rate(middle) < 0 ? from : to) = middle;
  }
  return to;
}

}  // namespace

IntervalGaps::IntervalGaps(const Scene& scene, std::span<const WallPart> walls, std::span<const Touch> touches,
                           std::span<const double> force, const FlightState& begin, const FlightState& end)
    : scene_(scene),
      walls_(walls),
      begin_(begin),
      end_(end),
      first_(scene.bodies.size(), kNever),
      second_(scene.bodies.size(), kNever),
      last_(scene.bodies.size(), 0.0),
      accelerations_(scene.bodies.size(), Vec2d::Zero()) {
  std::vector<char> held(scene.bodies.size());
  for (const Touch& touch : touches) {
    for (const int i : PairOf(touch.candidate).discs()) {
      if (touch.kind == ContactKind::kSustained) {
        held[i] = 1;
      } else if (touch.time >= 0) {
        first_[i] = std::min(first_[i], touch.time);
        last_[i] = std::max(last_[i], touch.time);
      }
    }
  }
  const double same = kSameImpact * (end.time - begin.time);
  for (const Touch& touch : touches) {
    if (touch.kind == ContactKind::kSustained || touch.time < 0) continue;
    for (const int i : PairOf(touch.candidate).discs()) {
      if (touch.time > first_[i] + same) second_[i] = std::min(second_[i], touch.time);
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& body = scene.bodies[i];
    if (!body.fixed) accelerations_[i] = scene.gravity + Vec2d(force[2 * i], force[2 * i + 1]) / body.mass;
    if (held[i] != 0 && first_[i] == kNever) {
      const double length = end.time - begin.time;
      accelerations_[i] = (Velocity(end, i, end.time) - Velocity(begin, i, begin.time)) / length;
    }
  }
}

int IntervalGaps::FindLegs(int i, std::array<Leg, 3>* legs) const {
  const auto leg = [i](double from, double to, const IntervalGaps& at, const FlightState& flight) {
    return Leg{from, to, flight.time, at.Position(flight, i, flight.time), at.Velocity(flight, i, flight.time)};
  };
  (*legs)[0] = leg(begin_.time, std::min(first_[i], end_.time), *this, begin_);
  if (first_[i] == kNever) return 1;
  int count = 1;
  const double between = last_[i] - first_[i], same = kSameImpact * (end_.time - begin_.time);
  if (between > same && second_[i] + same >= last_[i]) {
    const Vec2d from = Position(begin_, i, first_[i]), to = Position(end_, i, last_[i]);
    (*legs)[count++] = {
        first_[i], last_[i], first_[i], from, (to - from) / between - 0.5 * between * accelerations_[i]};
  }
  (*legs)[count++] = leg(last_[i], end_.time, *this, end_);
  return count;
}

bool IntervalGaps::Touches(std::span<const Touch> touches, const GapPair& pair) {
  return std::ranges::any_of(touches, [&](const Touch& touch) {
    const Candidate& c = touch.candidate;
    return c.a == pair.a && c.b == pair.b && c.plane == (pair.wall != nullptr);
  });
}

double IntervalGaps::First(const GapPair& pair) const {
  return std::min(first_[pair.discs()[0]], first_[pair.discs()[1]]);
}

double IntervalGaps::Last(const GapPair& pair) const {
  return std::max(last_[pair.discs()[0]], last_[pair.discs()[1]]);
}

double IntervalGaps::Touching(const GapPair& pair) const { return kTouching * scene_.bodies[pair.a].radius; }

Vec2d IntervalGaps::Velocity(const FlightState& flight, int i, double t) const {
  const double* v = &flight.x[flight.x.size() / scene_.bodies.size() * i + 2];
  return Vec2d(v[0], v[1]) + (t - flight.time) * accelerations_[i];
}

Vec2d IntervalGaps::Position(const FlightState& flight, int i, double t) const {
  const double* p = &flight.x[flight.x.size() / scene_.bodies.size() * i];
  const double s = t - flight.time;
  return Vec2d(p[0], p[1]) + s * (Velocity(flight, i, flight.time) + 0.5 * s * accelerations_[i]);
}

void IntervalGaps::FindStretches(const GapPair& pair, std::vector<Stretch>* stretches) const {
  std::array<Leg, 3> of_a, of_b;
  const int count = FindLegs(pair.a, &of_a), count_b = pair.wall == nullptr ? FindLegs(pair.b, &of_b) : 0;
  stretches->clear();
  for (const Leg& a : std::span(of_a).first(count)) {
    if (pair.wall != nullptr) stretches->push_back({a.from, a.to, {a, a}});
    for (const Leg& b : std::span(of_b).first(count_b)) {
      const double from = std::max(a.from, b.from), to = std::min(a.to, b.to);
      if (from < to) stretches->push_back({from, to, {a, b}});
    }
  }
}

Gap IntervalGaps::At(const Stretch& stretch, const GapPair& pair, double t) const {
  const auto& [a, b] = stretch.legs;
  const int j = pair.discs()[1];
  return GapOf(pair, PositionIn(a, pair.a, t), VelocityIn(a, pair.a, t), PositionIn(b, j, t), VelocityIn(b, j, t));
}

std::optional<double> IntervalGaps::LeastIn(const Stretch& stretch, const GapPair& pair) const {
  return EndOfFall([&](double t) { return At(stretch, pair, t).rate; }, stretch.from, stretch.to);
}

Gap IntervalGaps::At(const FlightState& flight, const GapPair& pair, double t) const {
  const int b = pair.discs()[1];
  return GapOf(
      pair, Position(flight, pair.a, t), Velocity(flight, pair.a, t), Position(flight, b, t), Velocity(flight, b, t));
}

Gap IntervalGaps::GapOf(const GapPair& pair, const Vec2d& at_a, const Vec2d& of_a, const Vec2d& at_b,
                        const Vec2d& of_b) const {
  const double radius = scene_.bodies[pair.a].radius;
  if (pair.wall != nullptr) {
    const Separation<double> separation = Separate<double>(at_a, pair.wall->wall);
    return {separation.distance - (pair.wall->pocket ? 0 : radius), Dot(separation.normal, of_a), separation.normal};
  }
  const Separation<double> separation = Separate<double>(at_a, at_b);
  return {separation.distance - radius - scene_.bodies[pair.b].radius,
          Dot(separation.normal, Vec2d(of_a - of_b)),
          separation.normal};
}

std::optional<double> IntervalGaps::LeastBetween(const FlightState& flight, const GapPair& pair, double from,
                                                 double to) const {
  return EndOfFall([&](double t) { return At(flight, pair, t).rate; }, from, to);
}

}  // namespace saltus
