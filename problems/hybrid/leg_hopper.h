#pragma once

#include <ceres/autodiff_cost_function.h>

#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {

// A planar hopper: a point mass at the hip above a leg of two uniform links. q = [x y of the hip, angles of thigh and
// shank from the downward vertical], u = [torque at the knee, torque between the thigh and a frame that does not turn],
// p = [masses of hip, thigh and shank, lengths of thigh and shank, gravity, damping of knee and hip, restitution and
// friction of the foot, angles of thigh and shank at the start].
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

// What the apex of the centre of mass would miss of a height, if the motion went on in flight.
struct MissOfApex {
  double height, weight;

  template <typename T>
  bool operator()(const T* x, const T* p, T* residual) const {
    using std::cos, std::sin;
    const T mass = p[0] + p[1] + p[2], first = (0.5 * p[1] + p[2]) * p[3] / mass, second = 0.5 * p[2] * p[4] / mass;
    const T y = x[1] - first * cos(x[2]) - second * cos(x[3]);
    const T rate = x[5] + first * sin(x[2]) * x[6] + second * sin(x[3]) * x[7];
    residual[0] = std::sqrt(weight) * (y + rate * rate / (2.0 * p[5]) - height);
    return true;
  }
};

// One hop of least effort: from rest in a crouch through an apex of 0.75 m, 0.15 m above where the centre of mass was
// at first, to a landing that ends at rest in the same crouch.
inline HybridProblem LegHopperProblem() {
  constexpr double kThigh = 0.7, kShank = -0.6;
  constexpr int kIntervals = 10;
  const std::vector<double> p = {2, 0.4, 0.3, 0.4, 0.45, 9.81, 0.4, 0.3, 0, 0.9, kThigh, kShank};
  const MechanicalSystem system{LegHopper()};
  const int stuck = system.Mode("s"), flight = system.Mode("o");
  HybridProblem problem{.system = system.hybrid(),
                        .guess = {.mode = stuck,
                                  .initial = {-p[3] * std::sin(kThigh) - p[4] * std::sin(kShank),
                                              p[3] * std::cos(kThigh) + p[4] * std::cos(kShank),
                                              kThigh,
                                              kShank,
                                              0,
                                              0,
                                              0,
                                              0},
                                  .parameters = p,
                                  .duration = 0.6,
                                  .num_intervals = kIntervals},
                        .terms = {MakeEffortCost(0.002, 2),
                                  {.name = "apex",
                                   .at = HybridTerm::Timing::kEvent,
                                   .mode = flight,
                                   .event = "hit foot",
                                   .before = true,
                                   .with_state = true,
                                   .with_parameters = true,
                                   .function = std::make_shared<ceres::AutoDiffCostFunction<MissOfApex, 1, 8, 12>>(
                                       new MissOfApex{0.75, 20})},
                                  MakeTerminalCost(2, kThigh, 1.0, 8, stuck),
                                  MakeTerminalCost(3, kShank, 1.0, 8, stuck),
                                  MakeTerminalCost(6, 0.0, 0.2, 8, stuck),
                                  MakeTerminalCost(7, 0.0, 0.2, 8, stuck)},
                        .integration = {.steps_per_interval = 3}};
  for (int k = 0; k < kIntervals; ++k) {
    problem.guess.control.insert(problem.guess.control.end(), {k < 4 ? 9.0 : 0.0, 0.0});
  }
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
