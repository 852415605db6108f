#include "exact/flow.h"

#include <algorithm>
#include <cmath>

namespace saltus::exact_internal {
namespace {

// Returns the root of p in [low, high], where p is monotone and changes sign: Newton's method with bisection.
double RootOfMonotone(const Polynomial& p, const Polynomial& slope, double low, double high) {
  const bool rising = Evaluate(p, high) > 0;
  double t = 0.5 * (low + high);
  for (int i = 0; i < 200; ++i) {
    const double value = Evaluate(p, t);
    if (value == 0) return t;
    ((value > 0) == rising ? high : low) = t;
    double next = t - value / Evaluate(slope, t);
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - t) <= 1e-16 * std::abs(t) || next == low || next == high) return next;
    t = next;
  }
  return t;
}

std::vector<double> BreakPoints(const Polynomial& p, double low, double high) {
  std::vector<double> points = {low};
  if (p.size() > 1) {
    const std::vector<double> inner = RootsBetween(Derivative(p), low, high);
    points.insert(points.end(), inner.begin(), inner.end());
  }
  points.push_back(high);
  return points;
}

constexpr double kSameTime = 1e-12;

struct NextHit {
  int plane = -1;
  double wait = 0;
  bool corner = false;
};

// The next plane that the disc reaches within `remaining`; plane -1 if none. `last` is the plane it has just left.
// Returns false if the disc rests on a plane.
bool FindNextHit(const Scene& scene, const Motion<double>& disc, double remaining, int last, NextHit* next) {
  const Vec2d acceleration = InitialAcceleration(scene, 0);
  *next = NextHit();
  next->wait = remaining;
  for (int i = 0; i < static_cast<int>(scene.planes.size()); ++i) {
    const Vec2d n = scene.planes[i].normal.normalized();
    double gap = n.dot(disc.position - scene.planes[i].point) - scene.bodies[0].radius;
    if (i == last || gap < kTouching) gap = 0;
    const double speed = n.dot(disc.velocity);
    const double push = n.dot(acceleration);
    if (gap == 0 && std::abs(speed) < kGrazing && push < 0) return false;
    const std::optional<double> wait = FallTime(gap, speed, push);
    if (!wait || *wait > next->wait + kSameTime) continue;
    next->corner = next->plane >= 0 && *wait > next->wait - kSameTime;
    if (*wait <= next->wait) next->plane = i;
    next->wait = std::min(*wait, next->wait);
  }
  return true;
}

}  // namespace

double Evaluate(const Polynomial& p, double t) {
  double value = 0;
  for (auto c = p.rbegin(); c != p.rend(); ++c) value = value * t + *c;
  return value;
}

Polynomial Derivative(const Polynomial& p) {
  Polynomial slope;
  for (size_t i = 1; i < p.size(); ++i) slope.push_back(static_cast<double>(i) * p[i]);
  return slope;
}

Polynomial Multiply(const Polynomial& a, const Polynomial& b) {
  if (a.empty() || b.empty()) return {};
  Polynomial product(a.size() + b.size() - 1, 0.0);
  for (size_t i = 0; i < a.size(); ++i) {
    for (size_t j = 0; j < b.size(); ++j) product[i + j] += a[i] * b[j];
  }
  return product;
}

Polynomial Add(const Polynomial& a, const Polynomial& b) {
  Polynomial sum = a.size() > b.size() ? a : b;
  const Polynomial& shorter = a.size() > b.size() ? b : a;
  for (size_t i = 0; i < shorter.size(); ++i) sum[i] += shorter[i];
  return sum;
}

std::vector<double> RootsBetween(const Polynomial& p, double low, double high) {
  std::vector<double> roots;
  if (p.empty() || !(low <= high)) return roots;
  const Polynomial slope = Derivative(p);
  const std::vector<double> points = BreakPoints(p, low, high);
  if (Evaluate(p, low) == 0) roots.push_back(low);
  for (size_t i = 0; i + 1 < points.size(); ++i) {
    const double left = Evaluate(p, points[i]);
    const double right = Evaluate(p, points[i + 1]);
    if ((left < 0 && right > 0) || (left > 0 && right < 0)) {
      roots.push_back(RootOfMonotone(p, slope, points[i], points[i + 1]));
    }
  }
  if (high > low && Evaluate(p, high) == 0) roots.push_back(high);
  return roots;
}

double MinimumBetween(const Polynomial& p, double low, double high) {
  double minimum = Evaluate(p, high);
  for (const double t : BreakPoints(p, low, high)) minimum = std::min(minimum, Evaluate(p, t));
  return minimum;
}

std::optional<DiscPath> FollowDisc(const Scene& scene, std::string* reason_not_applicable) {
  const Vec2d acceleration = InitialAcceleration(scene, 0);
  const ContactLaw<double> law = {scene.contact.restitution, scene.contact.friction};
  DiscPath path;
  Motion<double> disc = InitialMotion(scene, 0);
  path.phase_start.push_back(disc);
  double time = 0;
  for (;;) {
    NextHit next;
    const int last = path.hits.empty() ? -1 : path.hits.back();
    if (!FindNextHit(scene, disc, scene.duration - time, last, &next))
      return Refuse(reason_not_applicable, "the disc rests on a plane");
    if (next.plane < 0) return path;
    if (next.corner) return Refuse(reason_not_applicable, "the disc strikes two planes at once");
    if (static_cast<int>(path.hits.size()) == kMostHits)
      return Refuse(reason_not_applicable, "the disc strikes planes too often");
    disc = Fly(disc, acceleration, next.wait);
    time += next.wait;
    const Vec2d n = scene.planes[next.plane].normal.normalized();
    if (n.dot(disc.velocity) > -kGrazing) return Refuse(reason_not_applicable, "the disc grazes a plane");
    ExactEvent event = {time, scene.bodies[0].name, scene.planes[next.plane].name, {}};
    disc.velocity += Impulse(law, n, disc.velocity, 1.0, &event.mode);
    path.hits.push_back(next.plane);
    path.events.push_back(event);
    path.phase_start.push_back(disc);
  }
}

}  // namespace saltus::exact_internal
