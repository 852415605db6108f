#include "identify/start.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "scene/units.h"

namespace saltus {
namespace {

constexpr int kFewest = 4, kMost = 12;  // samples that a line goes through
constexpr double kNoise = 1e-4;         // of the scene's length: misses below it are no reason for a shorter line

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// y = at + slope x by the medians of Theil and Sen; and the median of what it misses.
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

Vec2d AccelerationOf(const Scene& scene, int body) {
  Vec2d acceleration = scene.gravity;
  for (int c = 0; c < scene.num_controlled(); ++c) {
    if (scene.control.bodies[c] == body) acceleration += scene.control.initial[c] / scene.bodies[body].mass;
  }
  return acceleration;
}

struct Track {
  std::vector<double> time;  // s, since the segment begins
  std::vector<double> flat[2];
};

// The line whose velocity is known best: long, unless an impact bends the motion.
void FitTrack(const Track& track, double noise, const Vec2d& scene_velocity, Vec2d* position, Vec2d* velocity) {
  const int count = static_cast<int>(track.time.size());
  if (count == 1) {
    *position = {track.flat[0][0], track.flat[1][0]};
    *velocity = scene_velocity;
    *position -= track.time[0] * *velocity;
    return;
  }
  double best = std::numeric_limits<double>::infinity();
  for (int n = std::min(count, kFewest); n <= std::min(count, kMost); ++n) {
    const std::vector<double> time(track.time.begin(), track.time.begin() + n);
    Line line[2];
    for (int j = 0; j < 2; ++j) line[j] = FitLine(time, {track.flat[j].begin(), track.flat[j].begin() + n});
    const double error = (line[0].miss + line[1].miss + noise) / (time.back() * std::sqrt(n));
    if (error >= best) continue;
    best = error;
    *position = {line[0].at, line[1].at};
    *velocity = {line[0].slope, line[1].slope};
  }
}

// Pairs that overlap part along their normal, half each.
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

}  // namespace

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

std::vector<double> InitialFromData(const Scene& scene, const std::vector<Sample>& samples, const Segment& segment,
                                    const std::vector<int>& free_bodies) {
  std::vector<double> initial = InitialState(scene);
  for (const int body : free_bodies) {
    Track track;
    std::optional<Vec2d> measured;
    const Vec2d acceleration = AccelerationOf(scene, body);
    for (int i = segment.first; i < segment.last && track.time.size() < kMost; ++i) {
      const Sample& sample = samples[i];
      if (sample.body != body) continue;
      const double t = sample.time - segment.begin;
      if (track.time.empty() && sample.velocity) measured = *sample.velocity - t * acceleration;
      track.time.push_back(t);
      for (int j = 0; j < 2; ++j) track.flat[j].push_back(sample.position[j] - 0.5 * t * t * acceleration[j]);
    }
    if (track.time.empty()) continue;
    Vec2d position, velocity;
    FitTrack(track,
             kNoise * NaturalUnits(scene).length,
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

}  // namespace saltus
