// Closed lines of points: which are polygons, and what they enclose.
#pragma once

#include <string>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

// Why the points are not the corners of a polygon in counter-clockwise order, none of whose sides meet; empty if they
// are. That sides do not meet takes time quadratic in their number, and is looked at if `crossings`.
std::string WhyNoPolygon(const std::vector<Vec2d>& points, bool crossings);

// Whether x is enclosed. Precondition: WhyNoPolygon(points) is empty.
bool IsInside(const Vec2d& x, const std::vector<Vec2d>& points);

}  // namespace saltus
