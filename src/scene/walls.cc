#include "saltus/scene/walls.h"

#include <limits>
#include <map>
#include <numbers>
#include <utility>

namespace saltus {
namespace {

using Bound = WallExtent::Bound;

// Ends of edges that are closer than this, relative to their lengths, are one joint; ends of arcs are rounded.
constexpr double kJoint = 1e-9;

class PartsOfScene {
 public:
  explicit PartsOfScene(const Scene& scene) {
    for (const Plane& plane : scene.planes) {
      const Vec2d normal = plane.normal.normalized();
      Add({{normal, Dot(normal, plane.point)}, {}, plane.name}, plane.material);
    }
    if (scene.table) AddTable();
    for (const Pocket& pocket : scene.pockets) AddPocket(pocket);
    for (const EdgeSegment& segment : scene.segments) AddSegment(segment);
    for (const EdgePolygon& polygon : scene.polygons) AddPolygon(polygon);
    for (const EdgeArc& arc : scene.arcs) AddArc(arc);
    for (const End& end : ends_) AddEnd(end);
  }
  std::vector<WallPart> Take() { return std::move(parts_); }

 private:
  // A point where edges end, with the regions beyond each of them, in which the point is the nearest part of the wall.
  struct End {
    Vec2d at;
    std::string name;
    int material;  // of the first of them
    std::vector<Bound> beyond;
  };

  // Adds a part of a thing with this material, or -1.
  void Add(WallPart part, int material) {
    part.wall.material = material + 1;
    parts_.push_back(std::move(part));
  }

  static Bound Opposite(const Bound& bound) { return {-bound.normal, -bound.offset, !bound.open}; }

  // Adds the end `at` of an edge that counts where `within` holds.
  void EndAt(const Vec2d& at, double length, const std::string& name, int material, const Bound& within) {
    ends_[FindEnd(at, kJoint * length, name, material)].beyond.push_back(Opposite(within));
  }
  // Returns the index of an end; adds one unless there is one within `joint`, m.
  std::size_t FindEnd(const Vec2d& at, double joint, const std::string& name, int material) {
    const auto last = by_x_.upper_bound(at[0] + joint);
    for (auto it = by_x_.lower_bound(at[0] - joint); it != last; ++it) {
      if (std::abs(ends_[it->second].at[1] - at[1]) <= joint) return it->second;
    }
    by_x_.emplace(at[0], ends_.size());
    ends_.push_back({at, name, material, {}});
    return ends_.size() - 1;
  }

  // Adds the sides of a straight edge: that to its left, that to its right, or both.
  void AddEdge(const Vec2d& from, const Vec2d& to, bool left, bool right, int material, const std::string& name,
               const std::string& first, const std::string& last) {
    const double length = (to - from).norm();
    const Vec2d along = (to - from) / length, normal = Perpendicular(along);
    const Bound after{along, Dot(along, from), false}, before{-along, -Dot(along, to), true};
    const WallExtent extent{.endless = false, .bounds = {after, before}};
    const double offset = Dot(normal, from);
    if (left) Add({{normal, offset}, extent, name, from, to}, material);
    if (right) Add({{-normal, -offset}, extent, name, from, to}, material);
    EndAt(from, length, first, material, after);
    EndAt(to, length, last, material, before);
  }

  void AddTable() {
    WallPart table{.name = "table", .table = true};
    table.wall.offset = -std::numeric_limits<double>::infinity();
    parts_.push_back(std::move(table));
  }

  void AddPocket(const Pocket& pocket) {
    parts_.push_back({.wall = {.side = 1, .center = pocket.position, .radius = pocket.radius},
                      .extent = {.endless = false},
                      .name = pocket.name,
                      .pocket = true});
  }

  void AddSegment(const EdgeSegment& segment) {
    AddEdge(
        segment.from, segment.to, true, true, segment.material, segment.name, segment.name + ".a", segment.name + ".b");
  }

  void AddPolygon(const EdgePolygon& polygon) {
    const std::size_t n = polygon.points.size();
    const bool discs_inside = polygon.solid == EdgePolygon::Solid::kOutside;
    const auto corner = [&](std::size_t i) { return polygon.name + ".corner" + std::to_string(i); };
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t next = (i + 1) % n;
      AddEdge(polygon.points[i],
              polygon.points[next],
              discs_inside,
              !discs_inside,
              polygon.material,
              polygon.name + ".edge" + std::to_string(i),
              corner(i),
              corner(next));
    }
  }

  void AddArc(const EdgeArc& arc) {
    const auto at = [](double angle) { return Vec2d(std::cos(angle), std::sin(angle)); };
    const double turn = arc.to - arc.from;
    const bool whole = turn >= 2 * std::numbers::pi;
    const Vec2d after = Perpendicular(at(arc.from)), before = -Perpendicular(at(arc.to));
    WallExtent extent{.endless = false, .any = turn > std::numbers::pi};
    if (!whole) {
      extent.bounds = {{after, Dot(after, arc.center), false}, {before, Dot(before, arc.center), true}};
      EndAt(arc.center + arc.radius * at(arc.from), arc.radius, arc.name + ".a", arc.material, extent.bounds[0]);
      EndAt(arc.center + arc.radius * at(arc.to), arc.radius, arc.name + ".b", arc.material, extent.bounds[1]);
    }
    for (const int side : {1, -1}) {
      Add({{.side = side, .center = arc.center, .radius = arc.radius}, extent, arc.name}, arc.material);
    }
  }

  void AddEnd(const End& end) {
    Add({{.side = 1, .center = end.at}, {.endless = false, .bounds = end.beyond}, end.name}, end.material);
  }

  std::vector<WallPart> parts_;
  std::vector<End> ends_;
  std::multimap<double, std::size_t> by_x_;  // which of them have this x
};

}  // namespace

std::vector<WallPart> WallPartsOf(const Scene& scene) { return PartsOfScene(scene).Take(); }

std::vector<std::string> WallNamesOf(const Scene& scene) {
  std::vector<std::string> names;
  for (WallPart& part : WallPartsOf(scene)) names.push_back(std::move(part.name));
  return names;
}

}  // namespace saltus
