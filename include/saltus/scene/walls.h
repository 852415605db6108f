// Parts of walls: lines and circles (geometry.h), each of which a disc can touch from one side. A plane has one part, a
// segment or an arc two sides and two ends, a polygon one side for each edge and one part for each corner.
//
// A part counts where it is the nearest part: the side of a segment between the perpendiculars through its ends, an end
// beyond the perpendiculars of all edges that meet there. At every place near an edge exactly one part counts; in a
// corner that discs enter, one of each edge. An end that several edges share is one part.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// The region of the centres of discs in which a part counts.
struct WallExtent {
  // The half-plane normal . x >= offset, or > if it is open.
  struct Bound {
    Vec2d normal = Vec2d::Zero();  // |normal| = 1
    double offset = 0;             // m
    bool open = false;
    // Returns by how much x satisfies the bound, m.
    double Inside(const Vec2d& x) const { return Dot(normal, x) - offset; }
  };
  bool endless = true;             // the part counts everywhere; `bounds` are not read
  bool any = false;                // whether x must satisfy one of the bounds, and not all
  std::vector<Bound> bounds = {};  // none: the part counts everywhere, as a full circle does

  // Returns whether the part counts at x, where bounds may be violated by less than `tolerance`, m.
  bool Covers(const Vec2d& x, double tolerance = 0) const {
    if (endless || bounds.empty()) return true;
    for (const Bound& bound : bounds) {
      const double inside = bound.Inside(x);
      const bool holds = inside > -tolerance || (inside == 0 && !bound.open);
      if (holds == any) return any;
    }
    return !any;
  }
};

struct WallPart {
  Wall<double> wall = {};
  WallExtent extent = {};
  std::string name = {};                           // that of the wall, table or pocket; of ends "name.a", "name.b"
  Vec2d from = Vec2d::Zero(), to = Vec2d::Zero();  // m, where a line that is not endless ends
  bool table = false;                              // under all discs: its distance is infinite
  bool pocket = false;                             // reached by the centre of a disc, which then stays there

  // Returns a lower bound of the distance of a disc's centre at x from the part, m; negative behind an endless one.
  double LeastDistance(const Vec2d& x) const {
    if (wall.curved()) {
      const double outside = (x - wall.center).norm() - wall.radius;
      return pocket ? std::max(outside, 0.0) : std::abs(outside);
    }
    if (extent.endless) return Dot(wall.normal, x) - wall.offset;
    return (x - Nearest(x)).norm();
  }
  // Returns a bound on the rate at which LeastDistance() decreases while a disc at x moves straight with velocity v,
  // m/s; not negative within an arc. Precondition: the part is not endless.
  double Closing(const Vec2d& x, const Vec2d& v) const {
    const Vec2d away = x - (wall.curved() ? wall.center : Nearest(x));
    const double distance = away.norm();
    // Along a direction that parts it from what is convex, the distance is no less than its part along it.
    return distance > wall.radius ? -Dot(away, v) / distance : v.norm();
  }

 private:
  Vec2d Nearest(const Vec2d& x) const {
    const Vec2d along = to - from;
    const double share = std::min(std::max(Dot(along, Vec2d(x - from)) / along.squaredNorm(), 0.0), 1.0);
    return from + share * along;
  }
};

// Returns the scene's planes, in their order, its table (if any) and its pockets, then the sides of its segments,
// polygons and arcs, and then the ends. A Candidate (step_input.h) whose `plane` is true has an index into this list.
// Precondition: ValidateStructure(scene) finds nothing.
std::vector<WallPart> WallPartsOf(const Scene& scene);

// Returns the names of WallPartsOf(scene), in the same order.
std::vector<std::string> WallNamesOf(const Scene& scene);

}  // namespace saltus
