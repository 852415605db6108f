// Overlaps of the bodies of a scene at its initial time, with each other and with solid walls.
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "base/number_text.h"
#include "saltus/scene/walls.h"
#include "scene/polygon.h"
#include "scene/scene_rules.h"
#include "scene/units.h"

namespace saltus {
namespace {

// The smallest radius, relative to the scene's length: contacts of smaller discs would be lost in the thresholds.
constexpr double kLeastRadius = 1e-9;
// The largest rounding error of a position, relative to the radius, with which the place of a disc is still defined.
constexpr double kLargestRounding = 0.1;

class OverlapSearch {
 public:
  explicit OverlapSearch(const Scene& scene)
      : scene_(scene), length_(NaturalUnits(scene).length), tolerance_(kOverlapTolerance * length_) {}

  std::optional<SceneError> Run() {
    for (std::size_t i = 0; i < scene_.bodies.size() && !error_; ++i) CheckResolved(i);
    if (error_) return error_;
    for (std::size_t i = 0; i < scene_.bodies.size(); ++i) {
      for (std::size_t j = 0; j < i && !error_; ++j) CheckApart(i, j);
      for (std::size_t j = 0; j < scene_.planes.size() && !error_; ++j) CheckAbove(i, j);
      for (std::size_t j = 0; j < scene_.pockets.size() && !error_; ++j) CheckOutside(i, j);
      if (error_) return error_;
    }
    if (scene_.HasEdges()) CheckEdges();
    return error_;
  }

 private:
  static std::string Path(const char* list, std::size_t index, const std::string& name) {
    return list + ('[' + std::to_string(index) + "] (") + name + ")";
  }

  void Refuse(std::size_t body, const std::string& message, const char* field = ".position") {
    if (!error_) error_ = SceneError{"bodies[" + std::to_string(body) + ']' + field, message};
  }

  void CheckResolved(std::size_t i) {
    const Body& body = scene_.bodies[i];
    if (body.radius < kLeastRadius * length_) {
      Refuse(i,
             "found " + ToText(body.radius) + " m, expected at least " + ToText(kLeastRadius) +
                 " of the extent of the scene, about " + ToText(length_) + " m",
             ".radius");
    }
    const double far = body.position.cwiseAbs().maxCoeff();
    if (std::numeric_limits<double>::epsilon() * far > kLargestRounding * body.radius) {
      Refuse(i,
             "found a point " + ToText(far) + " m from the origin, where numbers are rounded by more than " +
                 ToText(kLargestRounding) + " of the radius, expected one nearer to it");
    }
  }

  void CheckApart(std::size_t i, std::size_t j) {
    const Body& a = scene_.bodies[i];
    const Body& b = scene_.bodies[j];
    if (a.fixed && b.fixed) return;
    const Vec2d apart = a.position - b.position;
    const double contact_distance = a.radius + b.radius;
    if (std::abs(apart[0]) >= contact_distance) return;  // spares most pairs of a large scene the square root
    Overlap(i, Path("bodies", j, b.name), contact_distance - std::hypot(apart[0], apart[1]));
  }

  void CheckAbove(std::size_t i, std::size_t j) {
    const Body& body = scene_.bodies[i];
    const Plane& plane = scene_.planes[j];
    if (body.fixed) return;
    const Vec2d normal = plane.normal / std::hypot(plane.normal[0], plane.normal[1]);
    const double height = Dot(normal, Vec2d(body.position - plane.point));
    Overlap(i, Path("planes", j, plane.name), body.radius - height);
  }

  void CheckOutside(std::size_t i, std::size_t j) {
    const Body& body = scene_.bodies[i];
    const Pocket& pocket = scene_.pockets[j];
    if (body.fixed) return;
    const Vec2d apart = body.position - pocket.position;
    if (std::hypot(apart[0], apart[1]) > pocket.radius) return;
    Refuse(i,
           "found a point in the pocket " + pocket.name + ", expected one outside it: there the disc is out of play");
  }

  void CheckEdges() {
    const std::vector<WallPart> parts = WallPartsOf(scene_);
    for (std::size_t i = 0; i < scene_.bodies.size() && !error_; ++i) {
      const Body& body = scene_.bodies[i];
      if (body.fixed) continue;
      for (std::size_t p = scene_.planes.size(); p < parts.size(); ++p) {
        if (parts[p].pocket || !parts[p].extent.Covers(body.position)) continue;
        Overlap(i, parts[p].name, body.radius - parts[p].LeastDistance(body.position));
      }
      for (const EdgeArc& arc : scene_.arcs) CheckNotAlong(i, arc);
      for (const EdgePolygon& polygon : scene_.polygons) {
        const bool solid = IsInside(body.position, polygon.points) == (polygon.solid == EdgePolygon::Solid::kInside);
        if (!solid) continue;
        Refuse(i, "found a point in what is solid of the polygon " + polygon.name + ", expected one outside it");
      }
    }
  }

  // Checks that no disc is in the centre of an arc of its radius: it would touch all of the arc, at no single point.
  void CheckNotAlong(std::size_t i, const EdgeArc& arc) {
    const Body& body = scene_.bodies[i];
    const Vec2d apart = body.position - arc.center;
    const double tolerance = Tolerance(i);
    if (std::hypot(apart[0], apart[1]) > tolerance || std::abs(body.radius - arc.radius) > tolerance) return;
    Refuse(i,
           "found the centre of the arc " + arc.name +
               ", which has the radius of the disc, expected a point where the disc does not touch all of the arc");
  }

  // Returns the tolerance of overlaps, m: positions in files are rounded, and so are their difference and its length.
  double Tolerance(std::size_t body) const {
    const double rounding =
        8 * std::numeric_limits<double>::epsilon() * scene_.bodies[body].position.cwiseAbs().maxCoeff();
    return std::max(tolerance_, rounding);
  }

  void Overlap(std::size_t body, const std::string& other, double depth) {
    const double tolerance = Tolerance(body);
    if (depth <= tolerance) return;
    Refuse(body,
           "found an overlap of " + ToText(depth * scene_.units.length) + " m with " + other +
               " at the start, expected at most " + ToText(tolerance * scene_.units.length) + " m");
  }

  const Scene& scene_;
  const double length_, tolerance_;  // m
  std::optional<SceneError> error_;
};

}  // namespace

std::optional<SceneError> FindOverlap(const Scene& scene) { return OverlapSearch(scene).Run(); }

std::optional<SceneError> FindOverlapAt(Scene scene, std::span<const double> initial) {
  for (std::size_t i = 0; i < scene.bodies.size(); ++i) {
    scene.bodies[i].position = {initial[4 * i], initial[4 * i + 1]};
  }
  return FindOverlap(scene);
}

}  // namespace saltus
