// Prescribed motions (PrescribedMotion): not-a-knot cubic splines through positions (m) at given times (s).
#pragma once

#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// Whether there are two times or more, which rise, with a position for each.
bool IsPath(const PrescribedMotion& path);

// The cubics of a path.
class PathMotion {
 public:
  // Precondition: IsPath(path).
  explicit PathMotion(const PrescribedMotion& path);

  struct Point {
    Vec2d position, velocity, acceleration, jerk;  // m, m/s, m/s^2, m/s^3
  };
  Point SampleAt(double time) const;

 private:
  std::vector<double> times_;
  std::vector<Vec2d> positions_, slopes_;  // at the times
};

// The scene from `time` on: its paths begin earlier by that time, and what has a path is where that is then.
Scene ShiftTimeOrigin(Scene scene, double time);

}  // namespace saltus
