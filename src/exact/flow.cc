#include "exact/flow.h"

#include <algorithm>

namespace saltus::exact_internal {
namespace {

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

std::optional<DiscPath> FollowDisc(const Scene& scene, std::string* why_not) {
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
      return Refuse(why_not, "the disc rests on a plane");
    if (next.plane < 0) return path;
    if (next.corner) return Refuse(why_not, "the disc strikes two planes at once");
    if (static_cast<int>(path.hits.size()) == kMostHits) return Refuse(why_not, "the disc strikes planes too often");
    disc = Fly(disc, acceleration, next.wait);
    time += next.wait;
    const Vec2d n = scene.planes[next.plane].normal.normalized();
    if (n.dot(disc.velocity) > -kGrazing) return Refuse(why_not, "the disc grazes a plane");
    ExactEvent event = {time, scene.bodies[0].name, scene.planes[next.plane].name, {}};
    disc.velocity += Impulse(law, n, disc.velocity, 1.0, &event.mode);
    path.hits.push_back(next.plane);
    path.events.push_back(event);
    path.phase_start.push_back(disc);
  }
}

}  // namespace saltus::exact_internal
