// Closed polygonal lines: tests for simple polygons and for points inside.
#pragma once

#include <string>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

// Returns the reason why the points are not the corners of a simple polygon in counter-clockwise order; empty if they
// are. Crossings of sides are checked only if `crossings`, which takes quadratic time.
std::string ValidatePolygon(const std::vector<Vec2d>& points, bool crossings);

// Whether x is inside. Precondition: ValidatePolygon(points) is empty.
bool IsInside(const Vec2d& x, const std::vector<Vec2d>& points);

}  // namespace saltus
