// Motions of mechanical systems by Siconos' event-driven integrator, EventDriven with LsodarOSI, and the box that
// and the pendulum that are measured. Siconos' headers are no C++20.
#pragma once

#include <cmath>
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

// A double pendulum of two uniform rods whose tip slides on the ground. Coordinates are the angles of the rods from the
// downward vertical.
struct SlidingPendulum {
  static constexpr double kMass[2] = {1, 0.7}, kLength[2] = {0.8, 0.6}, kGravity = 9.81, kDepth = 1.15;

  template <typename T>
  void Mass(const T* q, const T*, T* M) const {
    using std::cos;
    M[0] = T((kMass[0] / 3 + kMass[1]) * kLength[0] * kLength[0]);
    M[1] = M[2] = 0.5 * kMass[1] * kLength[0] * kLength[1] * cos(q[0] - q[1]);
    M[3] = T(kMass[1] * kLength[1] * kLength[1] / 3);
  }
  template <typename T>
  void Force(const T&, const T* q, const T* v, const T*, const T*, T* h) const {
    using std::sin;
    const T s = 0.5 * kMass[1] * kLength[0] * kLength[1] * sin(q[0] - q[1]);
    h[0] = -s * v[1] * v[1] - (0.5 * kMass[0] + kMass[1]) * kGravity * kLength[0] * sin(q[0]);
    h[1] = s * v[0] * v[0] - 0.5 * kMass[1] * kGravity * kLength[1] * sin(q[1]);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    using std::cos;
    return kDepth - kLength[0] * cos(q[0]) - kLength[1] * cos(q[1]);
  }
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
// Makes the motion of a pendulum; its tip is on the ground at the start.
std::unique_ptr<SiconosMotion> PendulumBySiconos(const std::vector<double>& initial, double duration, double tolerance);

}  // namespace saltus
