#pragma once

#include <array>
#include <cmath>
#include <numbers>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {

// A point mass on a massless rod beside an elastic wall, as a mechanical system; u: torque at the pivot; p = [e].
struct PendulumAtWall {
  double m = 1, l = 1, g = 9.81, wall = 0.5;

  static constexpr int kNumCoordinates = 1, kNumControls = 1, kNumParameters = 1, kNumContacts = 1;
  static constexpr std::array<const char*, 1> kCoordinateNames = {"theta"};
  static constexpr std::array<const char*, 1> kControlNames = {"u"};
  static constexpr std::array<const char*, 1> kParameterNames = {"e"};
  static constexpr std::array<const char*, 1> kContactNames = {"wall"};

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = T(m * l * l);
  }
  template <typename T>
  void Force(const T&, const T* q, const T*, const T* u, const T*, T* h) const {
    using std::sin;
    h[0] = u[0] - m * g * l * sin(q[0]);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    using std::sin;
    return wall - l * sin(q[0]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double*, Drawing* drawing) const {
    const double tip_x = l * std::sin(x[0]), tip_y = -l * std::cos(x[0]);
    drawing->Line(wall, -1.2 * l, wall, 1.2 * l);
    drawing->Line(0, 0, tip_x, tip_y);
    drawing->Circle(tip_x, tip_y, 0.05 * l);
  }
};

// From rest at the bottom to the top, the other way round: it pays to strike the wall first.
inline HybridProblem WallSwingUpProblem() {
  HybridProblem problem{.system = MechanicalSystem(PendulumAtWall()).hybrid(),
                        .guess = {.initial = {0, 0}, .parameters = {0.9}, .duration = 1.6, .num_intervals = 40},
                        .terms = {MakeTerminalCost(0, -std::numbers::pi, 100.0, 2),
                                  MakeTerminalCost(1, 0.0, 10.0, 2),
                                  MakeEffortCost(0.02, 1)}};
  for (int k = 0; k < 40; ++k) problem.guess.control.push_back(k < 10 ? 9 : -5);
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
