#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {

// A hip with a mass above a leg of two links, whose foot sticks to the ground, slides and leaves it; q = [x y of the
// hip, angles of thigh and shank from the downward vertical], u = [torque at the knee, torque between the hip and a
// frame that does not turn]. a0 and b0 are the angles in which it crouches.
struct LegHopper {
  static constexpr int kNumCoordinates = 4, kNumControls = 2, kNumParameters = 12, kNumContacts = 1;
  static constexpr std::array<const char*, 12> kParameterNames = {
      "m0", "m1", "m2", "l1", "l2", "g", "ck", "ch", "e", "mu", "a0", "b0"};
  static constexpr std::array<const char*, 4> kCoordinateNames = {"x", "y", "thigh", "shank"};
  static constexpr std::array<const char*, 2> kControlNames = {"knee", "hip"};
  static constexpr std::array<const char*, 1> kContactNames = {"foot"};

  template <typename T>
  void Mass(const T* q, const T* p, T* M) const {
    using std::cos, std::sin;
    const T first = (0.5 * p[1] + p[2]) * p[3], second = 0.5 * p[2] * p[4];
    M[0] = M[5] = p[0] + p[1] + p[2];
    M[1] = M[4] = T(0.0);
    M[2] = M[8] = first * cos(q[2]);
    M[3] = M[12] = second * cos(q[3]);
    M[6] = M[9] = first * sin(q[2]);
    M[7] = M[13] = second * sin(q[3]);
    M[10] = (p[1] / 3.0 + p[2]) * p[3] * p[3];
    M[11] = M[14] = 0.5 * p[2] * p[3] * p[4] * cos(q[2] - q[3]);
    M[15] = p[2] * p[4] * p[4] / 3.0;
  }
  template <typename T>
  void Force(const T&, const T* q, const T* v, const T* u, const T* p, T* h) const {
    using std::cos, std::sin;
    const T first = (0.5 * p[1] + p[2]) * p[3], second = 0.5 * p[2] * p[4];
    const T s = 0.5 * p[2] * p[3] * p[4] * sin(q[2] - q[3]);
    const T knee = u[0] - p[6] * (v[3] - v[2]), hip = u[1] - p[7] * v[2];
    h[0] = first * sin(q[2]) * v[2] * v[2] + second * sin(q[3]) * v[3] * v[3];
    h[1] = -first * cos(q[2]) * v[2] * v[2] - second * cos(q[3]) * v[3] * v[3] - (p[0] + p[1] + p[2]) * p[5];
    h[2] = -s * v[3] * v[3] - first * p[5] * sin(q[2]) - knee + hip;
    h[3] = s * v[2] * v[2] - second * p[5] * sin(q[3]) + knee;
  }
  template <typename T>
  T Gap(int, const T* q, const T* p) const {
    using std::cos;
    return q[1] - p[3] * cos(q[2]) - p[4] * cos(q[3]);
  }
  template <typename T>
  T Slide(int, const T* q, const T* p) const {
    using std::sin;
    return q[0] + p[3] * sin(q[2]) + p[4] * sin(q[3]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[8];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[9];
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double* p, Drawing* drawing) const {
    const double knee_x = x[0] + p[3] * std::sin(x[2]), knee_y = x[1] - p[3] * std::cos(x[2]);
    drawing->Line(-0.5, 0, 1, 0);
    drawing->Line(x[0], x[1], knee_x, knee_y);
    drawing->Line(knee_x, knee_y, knee_x + p[4] * std::sin(x[3]), knee_y - p[4] * std::cos(x[3]));
    drawing->Circle(x[0], x[1], 0.06);
  }
};

// One hop of least effort by 0.2 m in 0.6 s, from rest to rest in the same crouch.
inline HybridProblem LegHopperProblem() {
  const double distance = 0.2, thigh = 0.7, shank = -0.6;
  const double x = -0.4 * std::sin(thigh) - 0.45 * std::sin(shank), y = 0.4 * std::cos(thigh) + 0.45 * std::cos(shank);
  const MechanicalSystem system{LegHopper()};
  const int stands = system.Mode("s");
  HybridProblem problem{.system = system.hybrid(),
                        .guess = {.mode = stands,
                                  .initial = {x, y, thigh, shank, 0, 0, 0, 0},
                                  .parameters = {2, 0.4, 0.3, 0.4, 0.45, 9.81, 0.4, 0.3, 0, 0.9, thigh, shank},
                                  .duration = 0.6,
                                  .num_intervals = 24},
                        .terms = {MakeEffortCost(0.02, 2)}};
  // What the foot holds follows from the angles.
  const int of[] = {0, 2, 3, 6, 7};
  const double target[] = {x + distance, thigh, shank, 0, 0};
  for (int i = 0; i < 5; ++i) {
    HybridTerm term = MakeTerminalCost(of[i], target[i], 1.0, 8, stands);
    term.role = HybridTerm::Role::kEquality;
    problem.terms.push_back(term);
  }
  for (const double knee : {8, 11, 12, 9, 6, 3, 0, -1, 0, 0, 1, 2}) {
    for (int i = 0; i < 2; ++i) problem.guess.control.insert(problem.guess.control.end(), {knee, -0.2});
  }
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
