#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {

// A box on an oiled table, seen from above, and a disc that does not turn and pushes its left side; q = [x y of the
// disc, x y and angle of the box], u = [force on the disc along x, along y], p = [friction between them, viscous drag
// of the box (1/s)].
struct PushedBox {
  double disc_mass = 0.5, radius = 0.05, box_mass = 1, half_width = 0.15, half_height = 0.1;

  static constexpr int kNumCoordinates = 5, kNumControls = 2, kNumParameters = 2, kNumContacts = 1;
  static constexpr std::array<const char*, 5> kCoordinateNames = {"disc_x", "disc_y", "x", "y", "angle"};
  static constexpr std::array<const char*, 2> kControlNames = {"force_x", "force_y"};
  static constexpr std::array<const char*, 2> kParameterNames = {"friction", "drag"};
  static constexpr std::array<const char*, 1> kContactNames = {"side"};

  double inertia() const { return box_mass / 3 * (half_width * half_width + half_height * half_height); }

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    for (int i = 0; i < 25; ++i) M[i] = T(0.0);
    M[0] = M[6] = T(disc_mass);
    M[12] = M[18] = T(box_mass);
    M[24] = T(inertia());
  }
  template <typename T>
  void Force(const T&, const T*, const T* v, const T* u, const T* p, T* h) const {
    h[0] = u[0];
    h[1] = u[1];
    h[2] = -p[1] * box_mass * v[2];
    h[3] = -p[1] * box_mass * v[3];
    h[4] = -p[1] * inertia() * v[4];
  }
  // The disc's distance from the line through the side.
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    using std::cos, std::sin;
    return -(cos(q[4]) * (q[0] - q[2]) + sin(q[4]) * (q[1] - q[3])) - (half_width + radius);
  }
  // Of the disc relative to the box along the side, where they touch.
  template <typename T>
  void SlideRow(int, const T* q, const T*, T* row) const {
    using std::cos, std::sin;
    const T c = cos(q[4]), s = sin(q[4]);
    row[0] = -s;
    row[1] = c;
    row[2] = s;
    row[3] = -c;
    row[4] = T(half_width);
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[0];
  }
  // Of the point of contact from the nearer end of the side.
  template <typename T>
  T Reach(int, const T* q, const T*) const {
    using std::cos, std::sin;
    const T along = cos(q[4]) * (q[1] - q[3]) - sin(q[4]) * (q[0] - q[2]);
    return along > T(0.0) ? half_height - along : half_height + along;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double*, Drawing* drawing) const {
    const double c = std::cos(x[4]), s = std::sin(x[4]);
    const auto side = [&](double x0, double y0, double x1, double y1) {
      drawing->Line(x[2] + c * x0 - s * y0, x[3] + s * x0 + c * y0, x[2] + c * x1 - s * y1, x[3] + s * x1 + c * y1);
    };
    side(-half_width, -half_height, half_width, -half_height);
    side(half_width, -half_height, half_width, half_height);
    side(half_width, half_height, -half_width, half_height);
    side(-half_width, half_height, -half_width, -half_height);
    drawing->Circle(x[0], x[1], radius);
  }
};

// To a place and an angle within a second, with little effort: the disc strikes the box below its centre.
inline HybridProblem PushedBoxProblem() {
  HybridProblem problem{.system = MechanicalSystem(PushedBox()).hybrid(),
                        .guess = {.initial = {-0.25, -0.03, 0, 0, 0, 0, 0, 0, 0, 0},
                                  .parameters = {0.4, 1.5},
                                  .duration = 1,
                                  .num_intervals = 10},
                        .terms = {MakeTerminalCost(2, 0.25, 20.0, 10),
                                  MakeTerminalCost(3, 0.05, 20.0, 10),
                                  MakeTerminalCost(4, 0.4, 2.0, 10),
                                  MakeEffortCost(0.01, 2)},
                        .integration = {.steps_per_interval = 1}};
  for (int k = 0; k < 10; ++k) problem.guess.control.insert(problem.guess.control.end(), {0.87 - 0.06 * k, 0.0});
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
