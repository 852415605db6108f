#include "programs/outlines.h"

#include <cmath>
#include <numbers>

namespace saltus {
namespace {

constexpr double kChord = 2 * std::numbers::pi / 180;

Outline OutlineOf(const EdgeSegment& segment) {
  return {segment.name, {{segment.from[0], segment.from[1]}, {segment.to[0], segment.to[1]}}};
}

Outline OutlineOf(const EdgePolygon& polygon) {
  const bool inside = polygon.solid == EdgePolygon::Solid::kInside;
  Outline outline{polygon.name, {}, inside ? Outline::Solid::kInside : Outline::Solid::kOutside};
  for (const Vec2d& point : polygon.points) outline.points.push_back({point[0], point[1]});
  outline.points.push_back(outline.points.front());
  return outline;
}

Outline OutlineOf(const EdgeArc& arc) {
  Outline outline{arc.name, {}};
  const int chords = std::max(1, static_cast<int>(std::ceil((arc.to - arc.from) / kChord)));
  for (int i = 0; i <= chords; ++i) {
    const double angle = arc.from + (arc.to - arc.from) * i / chords;
    outline.points.push_back(
        {arc.center[0] + arc.radius * std::cos(angle), arc.center[1] + arc.radius * std::sin(angle)});
  }
  return outline;
}

Outline OutlineOf(const Pocket& pocket) {
  return OutlineOf(EdgeArc{pocket.name, pocket.position, pocket.radius, 0, 2 * std::numbers::pi});
}

}  // namespace

std::vector<Outline> OutlinesOf(const Scene& scene) {
  std::vector<Outline> outlines;
  for (const EdgeSegment& segment : scene.segments) outlines.push_back(OutlineOf(segment));
  for (const EdgePolygon& polygon : scene.polygons) outlines.push_back(OutlineOf(polygon));
  for (const EdgeArc& arc : scene.arcs) outlines.push_back(OutlineOf(arc));
  for (const Pocket& pocket : scene.pockets) outlines.push_back(OutlineOf(pocket));
  return outlines;
}

}  // namespace saltus
