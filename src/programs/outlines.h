// Segments, polygons, arcs and pockets of a scene as lines to draw.
#pragma once

#include <vector>

#include "output/outline.h"
#include "saltus/scene/scene.h"

namespace saltus {

// In the order of the scene; arcs as chords, two degrees each at most.
std::vector<Outline> OutlinesOf(const Scene& scene);

}  // namespace saltus
