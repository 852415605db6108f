// Motions of mechanical systems by Siconos' event-driven integrator, EventDriven with LsodarOSI, and the box that
// is measured. Siconos' headers are no C++20.
#pragma once

#include <memory>
#include <vector>

namespace saltus {

// A box whose corners may touch the ground. Corners are counted from the lower left, counterclockwise.
struct BouncingBox {
  static constexpr double kMass = 0.8, kHalfWidth = 0.3, kHalfHeight = 0.2, kGravity = 9.81, kRestitution = 0.6;
  static constexpr double kInertia = kMass * (kHalfWidth * kHalfWidth + kHalfHeight * kHalfHeight) / 3;

  static double Along(int corner) { return corner == 1 || corner == 2 ? kHalfWidth : -kHalfWidth; }
  static double Across(int corner) { return corner < 2 ? -kHalfHeight : kHalfHeight; }
};

class SiconosMotion {
 public:
  virtual ~SiconosMotion() = default;
  // Simulates to the end, and returns the number of impacts. Once.
  virtual int Run() = 0;
  // Coordinates of all bodies, then their velocities.
  virtual std::vector<double> State() const = 0;
};

// From `initial` = [q v], with a relative and absolute tolerance of the integration. x, y and angle of each box in
// turn.
std::unique_ptr<SiconosMotion> BoxesBySiconos(const std::vector<double>& initial, double duration, double tolerance);

}  // namespace saltus
