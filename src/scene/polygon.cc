#include "scene/polygon.h"

#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

double Cross(const Vec2d& a, const Vec2d& b) { return a[0] * b[1] - a[1] * b[0]; }

// Whether the line segments a-b and c-d have a point in common.
bool SegmentsIntersect(const Vec2d& a, const Vec2d& b, const Vec2d& c, const Vec2d& d) {
  for (int j = 0; j < 2; ++j) {
    if (std::max(a[j], b[j]) < std::min(c[j], d[j]) || std::max(c[j], d[j]) < std::min(a[j], b[j])) return false;
  }
  const auto sides = [](const Vec2d& p, const Vec2d& q, const Vec2d& r, const Vec2d& s) {
    return Cross(q - p, r - p) * Cross(q - p, s - p);
  };
  return sides(a, b, c, d) <= 0 && sides(c, d, a, b) <= 0;
}

double TwiceTheArea(const std::vector<Vec2d>& points) {
  double area = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    area += Cross(points[i] - points[0], points[(i + 1) % points.size()] - points[0]);
  }
  return area;
}

// Whether all points lie on one straight line, up to rounding.
bool AreCollinear(const std::vector<Vec2d>& points) {
  constexpr double kStraight = 1e-12;  // of the distance of the farthest: how far off the line rounding may be
  const auto nearer = [&](const Vec2d& a, const Vec2d& b) {
    return (a - points[0]).squaredNorm() < (b - points[0]).squaredNorm();
  };
  const Vec2d along = *std::max_element(points.begin(), points.end(), nearer) - points[0];
  return std::all_of(points.begin(), points.end(), [&](const Vec2d& point) {
    return std::abs(Cross(along, point - points[0])) <= kStraight * along.squaredNorm();
  });
}

}  // namespace

std::string ValidatePolygon(const std::vector<Vec2d>& points, bool crossings) {
  const std::size_t n = points.size();
  if (n < 3) return "found " + std::to_string(n) + " points, expected at least three corners";
  const auto at = [&](std::size_t i) { return points[i % n]; };
  for (std::size_t i = 0; i < n; ++i) {
    if (at(i) == at(i + 1)) return "found the same corner twice in turn, number " + std::to_string(i);
  }
  if (AreCollinear(points)) return "found corners that lie on one line, expected corners around an area";
  if (!(TwiceTheArea(points) > 0)) return "found corners in clockwise order, expected them counter-clockwise";
  for (std::size_t i = 0; crossings && i < n; ++i) {
    for (std::size_t j = i + 2; j < n; ++j) {
      const bool neighbours = (j + 1) % n == i;
      if (neighbours || !SegmentsIntersect(at(i), at(i + 1), at(j), at(j + 1))) continue;
      return "found sides " + std::to_string(i) + " and " + std::to_string(j) + " that meet, expected sides apart";
    }
  }
  return "";
}

bool IsInside(const Vec2d& x, const std::vector<Vec2d>& points) {
  bool inside = false;  // an odd number of sides lies to the right
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vec2d &a = points[i], &b = points[(i + 1) % points.size()];
    if ((a[1] > x[1]) == (b[1] > x[1])) continue;
    const bool up = b[1] > a[1];
    inside = inside != ((Cross(b - a, x - a) > 0) == up);
  }
  return inside;
}

}  // namespace saltus
