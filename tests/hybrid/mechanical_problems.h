// The mechanical systems whose exact values are known (data/mechanical_references.json), and one that several tests
// use, as users would write them. SI units. Parameters have the names of the file.
#pragma once

#include <array>
#include <cmath>

namespace saltus {

// A point mass on a massless rod between two walls.
struct PendulumBetweenWalls {
  static constexpr int kNumCoordinates = 1, kNumControls = 0, kNumParameters = 6, kNumContacts = 2;
  static constexpr std::array<const char*, 6> kParameterNames = {"m", "l", "g", "a", "b", "e"};
  static constexpr std::array<const char*, 2> kContactNames = {"right", "left"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    M[0] = p[0] * p[1] * p[1];
  }
  template <typename T>
  void Force(const T&, const T* q, const T*, const T*, const T* p, T* h) const {
    using std::sin;
    h[0] = -p[0] * p[2] * p[1] * sin(q[0]);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    using std::sin;
    return contact == 0 ? p[3] - p[1] * sin(q[0]) : p[4] + p[1] * sin(q[0]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[5];
  }
};

// A uniform pole on a cart between walls and bump stops.
struct CartPoleWithStops {
  static constexpr int kNumCoordinates = 2, kNumControls = 1, kNumParameters = 9, kNumContacts = 4;
  static constexpr std::array<const char*, 9> kParameterNames = {"M", "m", "l", "g", "c", "w", "s", "et", "ec"};
  static constexpr std::array<const char*, 4> kContactNames = {"tip_right", "tip_left", "cart_right", "cart_left"};

  template <typename T>
  void Mass(const T* q, const T* p, T* M) const {
    using std::cos;
    M[0] = p[0] + p[1];
    M[1] = M[2] = 0.5 * p[1] * p[2] * cos(q[1]);
    M[3] = p[1] * p[2] * p[2] / 3.0;
  }
  template <typename T>
  void Force(const T&, const T* q, const T* v, const T* u, const T* p, T* h) const {
    using std::sin;
    h[0] = u[0] + 0.5 * p[1] * p[2] * sin(q[1]) * v[1] * v[1] - p[4] * v[0];
    h[1] = 0.5 * p[1] * p[3] * p[2] * sin(q[1]);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    using std::sin;
    const T tip = q[0] + p[2] * sin(q[1]);
    if (contact == 0) return p[5] - tip;
    if (contact == 1) return p[5] + tip;
    return contact == 2 ? p[6] - q[0] : p[6] + q[0];
  }
  template <typename T>
  T Restitution(int contact, const T* p) const {
    return contact < 2 ? p[7] : p[8];
  }
};

// Two uniform rods that hang from the origin; the tip hits an inclined plane with friction.
struct DoublePendulum {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 9, kNumContacts = 1;
  static constexpr std::array<const char*, 9> kParameterNames = {"m1", "m2", "l1", "l2", "g", "d", "al", "e", "mu"};
  static constexpr std::array<const char*, 1> kContactNames = {"tip"};

  template <typename T>
  void Mass(const T* q, const T* p, T* M) const {
    using std::cos;
    M[0] = (p[0] / 3.0 + p[1]) * p[2] * p[2];
    M[1] = M[2] = 0.5 * p[1] * p[2] * p[3] * cos(q[0] - q[1]);
    M[3] = p[1] * p[3] * p[3] / 3.0;
  }
  template <typename T>
  void Force(const T&, const T* q, const T* v, const T*, const T* p, T* h) const {
    using std::sin;
    const T s = 0.5 * p[1] * p[2] * p[3] * sin(q[0] - q[1]);
    h[0] = -s * v[1] * v[1] - (0.5 * p[0] + p[1]) * p[4] * p[2] * sin(q[0]);
    h[1] = s * v[0] * v[0] - 0.5 * p[1] * p[4] * p[3] * sin(q[1]);
  }
  template <typename T>
  T Gap(int, const T* q, const T* p) const {
    using std::cos, std::sin;
    return cos(p[6]) * Y(q, p) - sin(p[6]) * X(q, p);
  }
  template <typename T>
  T Slide(int, const T* q, const T* p) const {
    using std::cos, std::sin;
    return cos(p[6]) * X(q, p) + sin(p[6]) * Y(q, p);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[7];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[8];
  }

  template <typename T>
  static T X(const T* q, const T* p) {
    using std::sin;
    return p[2] * sin(q[0]) + p[3] * sin(q[1]);
  }
  template <typename T>
  static T Y(const T* q, const T* p) {
    using std::cos;
    return p[5] - p[2] * cos(q[0]) - p[3] * cos(q[1]);
  }
};

// A uniform box of half sizes a and b, of which some of the corners A (-a, -b), B (a, -b), C (a, b), D (-a, b) may
// touch the ground, a plane that falls by beta along x. th0: the angle at the start.
template <int kCorners>
struct Box {
  static constexpr int kNumCoordinates = 3, kNumControls = 0, kNumParameters = 8, kNumContacts = kCorners;
  static constexpr std::array<const char*, 8> kParameterNames = {"m", "a", "b", "g", "e", "mu", "beta", "th0"};
  static constexpr auto kContactNames = [] {
    constexpr std::array<const char*, 4> kAll = {"A", "B", "C", "D"};
    std::array<const char*, kCorners> names{};
    for (int i = 0; i < kCorners; ++i) names[i] = kAll[i];
    return names;
  }();

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    for (int i = 0; i < 9; ++i) M[i] = T(0.0);
    M[0] = M[4] = p[0];
    M[8] = p[0] * (p[1] * p[1] + p[2] * p[2]) / 3.0;
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    using std::cos, std::sin;
    h[0] = p[0] * p[3] * sin(p[6]);
    h[1] = -p[0] * p[3] * cos(p[6]);
    h[2] = T(0.0);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    using std::cos, std::sin;
    return q[1] + Along(contact, p) * sin(q[2]) + Across(contact, p) * cos(q[2]);
  }
  template <typename T>
  T Slide(int contact, const T* q, const T* p) const {
    using std::cos, std::sin;
    return q[0] + Along(contact, p) * cos(q[2]) - Across(contact, p) * sin(q[2]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[4];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[5];
  }

  template <typename T>
  static T Along(int contact, const T* p) {
    return contact == 1 || contact == 2 ? p[1] : -p[1];
  }
  template <typename T>
  static T Across(int contact, const T* p) {
    return contact < 2 ? -p[2] : p[2];
  }
};

// A uniform rod of length 2 l whose lower end touches the ground.
struct SlidingRod {
  static constexpr int kNumCoordinates = 3, kNumControls = 0, kNumParameters = 8, kNumContacts = 1;
  static constexpr std::array<const char*, 8> kParameterNames = {"m", "l", "g", "e", "mu", "th0", "om0", "vt0"};
  static constexpr std::array<const char*, 1> kContactNames = {"end"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    for (int i = 0; i < 9; ++i) M[i] = T(0.0);
    M[0] = M[4] = p[0];
    M[8] = p[0] * p[1] * p[1] / 3.0;
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = h[2] = T(0.0);
    h[1] = -p[0] * p[2];
  }
  template <typename T>
  T Gap(int, const T* q, const T* p) const {
    using std::sin;
    return q[1] - p[1] * sin(q[2]);
  }
  template <typename T>
  T Slide(int, const T* q, const T* p) const {
    using std::cos;
    return q[0] - p[1] * cos(q[2]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[3];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[4];
  }
};

// A body with a vertex at r = (rx, ry) from its centre of mass, on the ground; no gravity.
struct Vertex {
  static constexpr int kNumCoordinates = 3, kNumControls = 0, kNumParameters = 6, kNumContacts = 1;
  static constexpr std::array<const char*, 6> kParameterNames = {"m", "I", "rx", "ry", "e", "mu"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    for (int i = 0; i < 9; ++i) M[i] = T(0.0);
    M[0] = M[4] = p[0];
    M[8] = p[1];
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T*, T* h) const {
    h[0] = h[1] = h[2] = T(0.0);
  }
  template <typename T>
  T Gap(int, const T* q, const T* p) const {
    using std::cos, std::sin;
    return q[1] + p[2] * sin(q[2]) + p[3] * cos(q[2]);
  }
  template <typename T>
  T Slide(int, const T* q, const T* p) const {
    using std::cos, std::sin;
    return q[0] + p[2] * cos(q[2]) - p[3] * sin(q[2]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[4];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[5];
  }
};

// A ball on the ground in a nonlinear coordinate s: its height is s + c s^3 / 3.
struct BallInNonlinearCoordinate {
  static constexpr int kNumCoordinates = 1, kNumControls = 0, kNumParameters = 4, kNumContacts = 1;
  static constexpr std::array<const char*, 4> kParameterNames = {"m", "g", "c", "e"};
  static constexpr std::array<const char*, 1> kContactNames = {"ground"};

  template <typename T>
  void Mass(const T* q, const T* p, T* M) const {
    const T w = 1.0 + p[2] * q[0] * q[0];
    M[0] = p[0] * w * w;
  }
  template <typename T>
  void Force(const T&, const T* q, const T* v, const T*, const T* p, T* h) const {
    const T w = 1.0 + p[2] * q[0] * q[0];
    h[0] = -p[0] * w * (2.0 * p[2] * q[0] * v[0] * v[0] + p[1]);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[0];
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[3];
  }
};

// A point mass on an incline with friction.
struct BallOnIncline {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 5, kNumContacts = 1;
  static constexpr std::array<const char*, 5> kParameterNames = {"m", "g", "beta", "e", "mu"};
  static constexpr std::array<const char*, 1> kContactNames = {"ground"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    M[0] = M[3] = p[0];
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    using std::cos, std::sin;
    h[0] = p[0] * p[1] * sin(p[2]);
    h[1] = -p[0] * p[1] * cos(p[2]);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[1];
  }
  template <typename T>
  T Slide(int, const T* q, const T*) const {
    return q[0];
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[3];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[4];
  }
};

// A point mass above the curve y = k x^2 / 2; the gap is the vertical distance.
struct Bowl {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 4, kNumContacts = 1;
  static constexpr std::array<const char*, 4> kParameterNames = {"m", "g", "k", "e"};
  static constexpr std::array<const char*, 1> kContactNames = {"bowl"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    M[0] = M[3] = p[0];
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = T(0.0);
    h[1] = -p[0] * p[1];
  }
  template <typename T>
  T Gap(int, const T* q, const T* p) const {
    return q[1] - 0.5 * p[2] * q[0] * q[0];
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[3];
  }
};

// A mass of 1 kg on the ground that is pulled along it and up; p = [friction gravity].
struct PulledMass {
  static constexpr int kNumCoordinates = 2, kNumControls = 2, kNumParameters = 2, kNumContacts = 1;

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(1.0);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T* p, T* h) const {
    h[0] = u[0];
    h[1] = u[1] - p[1];
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[1];
  }
  template <typename T>
  T Slide(int, const T* q, const T*) const {
    return q[0];
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[0];
  }
};

}  // namespace saltus
