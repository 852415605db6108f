// The systems whose exact values are known, as users would write them. SI units unless a comment says otherwise.
#pragma once

#include <array>
#include <cmath>

namespace saltus {

// [y v]; p = [g e]; u: force per mass.
struct BouncingBall {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"flight"};
  static constexpr std::array<const char*, 1> kGuardNames = {"ground"};
  static constexpr std::array<const char*, 2> kStateNames = {"y", "v"};
  static constexpr std::array<const char*, 2> kParameterNames = {"g", "e"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0] - p[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = -p[1] * x[1];
    return 0;
  }
};

// Angle and rate [q u] of the stance spoke; p = [lambda^2 mu gamma].
struct RimlessWheel {
  int spokes = 6;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 3;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sin;
    xdot[0] = x[1];
    xdot[1] = p[0] * sin(x[0] + p[2]);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return M_PI / spokes - x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = -x[0];
    x_plus[1] = p[1] * x[1];
    return 0;
  }
};

// The simplest walking model: [q1 u1 q2 u2], p = [gamma].
struct SimplestWalker {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  enum Mode { kEarly, kLate };
  static constexpr std::array kStateSizes = {4, 4};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::cos, std::sin;
    xdot[0] = x[1];
    xdot[1] = sin(x[0] - p[0]);
    xdot[2] = x[3];
    xdot[3] = xdot[1] + (x[1] * x[1] - cos(x[0] - p[0])) * sin(x[2]);
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    if (mode == kEarly) return x[0] + 0.1;
    return 2.0 * x[0] - x[2];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    using std::cos;
    if (mode == kEarly) {
      for (int i = 0; i < 4; ++i) x_plus[i] = x[i];
      return kLate;
    }
    const T c = cos(2.0 * x[0]);
    x_plus[0] = -x[0];
    x_plus[1] = c * x[1];
    x_plus[2] = -2.0 * x[0];
    x_plus[3] = c * (1.0 - c) * x[1];
    return kEarly;
  }
};

// The SLIP hopper. Flight [x y vx vy], stance [x - xf, y, vx, vy, xf]; p = [k theta].
struct SlipHopper {
  double m = 1, l0 = 1, g = 10;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  enum Mode { kDown, kStance, kUp };
  static constexpr std::array kStateSizes = {4, 5, 4};
  static constexpr std::array kNumGuards = {1, 1, 1};
  static constexpr std::array<const char*, 3> kModeNames = {"down", "stance", "up"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sqrt;
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = T(0.0);
    xdot[3] = T(-g);
    if (mode != kStance) return;
    const T spring = p[0] / m * (l0 / sqrt(x[0] * x[0] + x[1] * x[1]) - 1.0);
    xdot[2] = spring * x[0];
    xdot[3] = spring * x[1] - g;
    xdot[4] = T(0.0);
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    using std::cos;
    if (mode == kDown) return x[1] - l0 * cos(p[1]);
    if (mode == kStance) return l0 * l0 - x[0] * x[0] - x[1] * x[1];
    return x[3];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::cos, std::sin;
    for (int i = 0; i < 4; ++i) x_plus[i] = x[i];
    if (mode == kUp) return kDown;
    if (mode == kStance) {
      x_plus[0] = x[0] + x[4];
      return kUp;
    }
    x_plus[0] = -l0 * sin(p[1]);
    x_plus[1] = l0 * cos(p[1]);
    x_plus[4] = x[0] + l0 * sin(p[1]);
    return kStance;
  }
};

// Where x' changes from 3 to 1, [x z] with z = int x^2 dt.
struct SwitchedLine {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 0};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = T(mode == 0 ? 3.0 : 1.0);
    xdot[1] = x[0] * x[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return -x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1;
  }
};

// An oscillator that turns the other way outside a circle; p = [omega R].
struct SwitchedOscillator {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    const T omega = mode == 0 ? p[0] : T(-p[0]);
    xdot[0] = x[0] - omega * x[1];
    xdot[1] = omega * x[0] + x[1];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    const T inside = p[1] * p[1] - x[0] * x[0] - x[1] * x[1];
    return mode == 0 ? inside : T(-inside);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }
};

// A car with a turbo, [q v]: v' = u, and 3 u above a speed.
struct TurboCar {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 0;
  enum Mode { kNominal, kTurbo };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  double on = 10, off = 10;  // m/s

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = (mode == kTurbo ? 3.0 : 1.0) * u[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    return mode == kNominal ? T(on - x[1]) : T(x[1] - off);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }
};

// A ball on a paddle at A sin(omega t); p = [A omega g e].
struct JuggledBall {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 4;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -p[2];
  }
  template <typename T>
  T Guard(int, int, const T& t, const T* x, const T* p) const {
    using std::sin;
    return x[0] - p[0] * sin(p[1] * t);
  }
  template <typename T>
  int Reset(int, int, const T& t, const T* x, const T* p, T* x_plus) const {
    using std::cos, std::sin;
    x_plus[0] = p[0] * sin(p[1] * t);
    x_plus[1] = -p[3] * x[1] + (1.0 + p[3]) * p[0] * p[1] * cos(p[1] * t);
    return 0;
  }
};

// A cart-pole between two walls, [x theta v omega]; u: force on the cart; p = [e].
struct CartPole {
  double M = 1, m = 0.3, l = 0.5, g = 9.81, w = 0.6;

  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {4};
  static constexpr std::array kNumGuards = {2};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    using std::cos, std::sin;
    const T s = sin(x[1]), c = cos(x[1]);
    const T a = (u[0] + m * l * s * x[3] * x[3] - m * g * s * c) / (M + m * s * s);
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = a;
    xdot[3] = (g * s - c * a) / l;
  }
  template <typename T>
  T Guard(int, int guard, const T&, const T* x, const T*) const {
    return guard == 0 ? T(w - x[0]) : T(w + x[0]);
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::cos;
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    x_plus[2] = -p[0] * x[2];
    x_plus[3] = x[3] + (1.0 + p[0]) * x[2] * cos(x[1]) / l;
    return 0;
  }
};

// A body above a foot, with a spring whose rest length r the control moves. Flight [y1 v1 y2 v2 r], stance [y1 v1 r].
struct TwoMassHopper {
  double m1 = 1, m2 = 0.25, k = 250, g = 9.81;

  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 0;
  enum Mode { kFlight, kStance };
  static constexpr std::array kStateSizes = {5, 3};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    if (mode == kStance) {
      xdot[1] = k / m1 * (x[2] - x[0]) - g;
      xdot[2] = u[0];
      return;
    }
    const T force = k * (x[4] - x[0] + x[2]);
    xdot[1] = force / m1 - g;
    xdot[2] = x[3];
    xdot[3] = -force / m2 - g;
    xdot[4] = u[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    if (mode == kFlight) return x[2];
    return m2 * g + k * (x[2] - x[0]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    if (mode == kFlight) {
      x_plus[2] = x[4];
      return kStance;
    }
    x_plus[2] = x_plus[3] = T(0.0);
    x_plus[4] = x[2];
    return kFlight;
  }
};

// A rocking block, [theta omega]; p = [alpha p].
struct RockingBlock {
  bool linear = false;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  enum Mode { kPositive, kNegative };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sin;
    const T lever = mode == kPositive ? T(p[0] - x[0]) : T(p[0] + x[0]);
    const T fall = p[1] * p[1] * (linear ? lever : T(sin(lever)));
    xdot[0] = x[1];
    xdot[1] = mode == kPositive ? T(-fall) : fall;
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    return mode == kPositive ? x[0] : T(-x[0]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::sin;
    const T s = sin(p[0]);
    x_plus[0] = T(0.0);
    x_plus[1] = (1.0 - 1.5 * s * s) * x[1];
    return 1 - mode;
  }
};

// A thermostat, [y z] with z = int y dt; p = [a b low high].
struct Thermostat {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 4;
  enum Mode { kOn, kOff };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = (mode == kOn ? p[1] : T(0.0)) - p[0] * x[0];
    xdot[1] = x[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    return mode == kOn ? T(p[3] - x[0]) : T(x[0] - p[2]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }
};

// A boost converter with hysteretic current control, [i v z] with z = int v dt; p = [L C R Vin low high]; mH, mF, ms.
struct BoostConverter {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 6;
  enum Mode { kOn, kOff };
  static constexpr std::array kStateSizes = {3, 3};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    const bool on = mode == kOn;
    xdot[0] = (p[3] - (on ? T(0.0) : x[1])) / p[0];
    xdot[1] = ((on ? T(0.0) : x[0]) - x[1] / p[2]) / p[1];
    xdot[2] = x[1];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    return mode == kOn ? T(p[5] - x[0]) : T(x[0] - p[4]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    for (int i = 0; i < 3; ++i) x_plus[i] = x[i];
    return 1 - mode;
  }
};

}  // namespace saltus
