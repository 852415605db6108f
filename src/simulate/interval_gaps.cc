#include "simulate/interval_gaps.h"

#include <algorithm>

namespace saltus {
namespace {

constexpr int kBisections = 60;

}  // namespace

IntervalGaps::IntervalGaps(const Scene& scene, std::span<const WallPart> walls, std::span<const Touch> touches,
                           std::span<const double> force, const FlightState& begin, const FlightState& end)
    : scene_(scene),
      walls_(walls),
      first_(scene.bodies.size(), kNever),
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
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& body = scene.bodies[i];
    if (!body.fixed) accelerations_[i] = scene.gravity + Vec2d(force[2 * i], force[2 * i + 1]) / body.mass;
    if (held[i] != 0 && first_[i] == kNever) {
      const double length = end.time - begin.time;
      accelerations_[i] = (Velocity(end, i, end.time) - Velocity(begin, i, begin.time)) / length;
    }
  }
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

Gap IntervalGaps::At(const FlightState& flight, const GapPair& pair, double t) const {
  const Vec2d p = Position(flight, pair.a, t), v = Velocity(flight, pair.a, t);
  const double radius = scene_.bodies[pair.a].radius;
  if (pair.wall != nullptr) {
    const Separation<double> separation = Separate<double>(p, pair.wall->wall);
    return {separation.distance - (pair.wall->pocket ? 0 : radius), Dot(separation.normal, v), separation.normal};
  }
  const Separation<double> separation = Separate<double>(p, Position(flight, pair.b, t));
  return {separation.distance - radius - scene_.bodies[pair.b].radius,
          Dot(separation.normal, Vec2d(v - Velocity(flight, pair.b, t))),
          separation.normal};
}

std::optional<double> IntervalGaps::LeastBetween(const FlightState& flight, const GapPair& pair, double from,
                                                 double to) const {
  if (At(flight, pair, from).rate >= 0 || At(flight, pair, to).rate < 0) return std::nullopt;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (from + to);
    (At(flight, pair, middle).rate < 0 ? from : to) = middle;
  }
  return to;
}

}  // namespace saltus
