// The pieces of a motion through impacts as functions for Ceres: steps of free flight whose length is a variable,
// impacts between them, and what is asked of the motion. Templates on T, double or a Jet.
//
// A phase is the time between two cuts (impacts, or instants that a term of the objective names), of n equal steps. A
// step has the length h = (end - begin) / n, with `begin` and `end` the times of the cuts, which are variables too. A
// node is the state [p_x p_y v_x v_y] of a disc between two steps. A disc that spins has rotations too, just before and
// after each of its impacts, as between them it turns evenly: [r angle, r w], what its rim has turned and how fast, so
// that all unknowns are lengths and velocities. SI units, or any others that fit.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "saltus/scene/scene.h"
#include "simulate/flight.h"
#include "simulate/impact.h"

namespace saltus {

// A step of a phase: its index, from 0, and the number of steps.
struct StepOfPhase {
  int index = 0, count = 1;

  template <typename T>
  T Length(const T* begin, const T* end) const {
    return (end[0] - begin[0]) / double(count);
  }
};

// Coordinates of a node (2) or of a rotation (1).
template <typename T, int kSize>
using Coordinates = Eigen::Matrix<T, kSize, 1, Eigen::DontAlign>;

// Returns the acceleration of a disc in free flight, m/s^2; `force` is null if nothing pushes it.
template <typename T, int kSize>
Coordinates<T, kSize> FlightAcceleration(const Coordinates<double, kSize>& gravity, double inverse_mass,
                                         const T* force) {
  Coordinates<T, kSize> a = gravity.template cast<T>();
  for (int j = 0; force != nullptr && j < kSize; ++j) a[j] += inverse_mass * force[j];
  return a;
}

// Sets `next` to the state after free flight for a time s from x.
template <typename T, int kSize>
void Fly(const T* x, const Coordinates<T, kSize>& a, const T& s, T* next) {
  for (int j = 0; j < kSize; ++j) {
    next[j] = x[j] + s * (x[kSize + j] + 0.5 * s * a[j]);
    next[kSize + j] = x[kSize + j] + s * a[j];
  }
}

// A step of a pushed disc. Blocks: node, force, begin, end, next node. Rows: the equalities next - f(node, force, h),
// and the costs sqrt(effort h) force. Torques turn a disc in the same way: [r angle, r w] is to torque / radius as a
// position and a velocity are to a force, with r^2 / I in place of 1/m.
template <int kSize>
struct PushedStep {
  StepOfPhase step;
  Coordinates<double, kSize> gravity;
  double inverse_mass, effort;
  double least;  // s, of the length in the cost, whose root has no derivative at 0

  static constexpr int kEqualities = 2 * kSize, kRows = 3 * kSize;
  template <typename T>
  bool operator()(const T* x, const T* force, const T* begin, const T* end, const T* next, T* rows) const {
    using std::sqrt;
    const T h = step.Length(begin, end);
    Fly(x, FlightAcceleration(gravity, inverse_mass, force), h, rows);
    for (int j = 0; j < kEqualities; ++j) rows[j] = next[j] - rows[j];
    const T scale = std::sqrt(effort) * (Value(h) > least ? T(sqrt(h)) : T(std::sqrt(least)));
    for (int j = 0; j < kSize; ++j) rows[kEqualities + j] = scale * force[j];
    return true;
  }
};

// A step of a disc without a force, or its rotation between two times, those of impacts or the first or last one.
// Blocks: node or rotation, begin, end, the next one. Rows: the equalities next - f(node, h).
template <int kSize>
struct CoastingStep {
  StepOfPhase step;
  Coordinates<double, kSize> gravity;

  static constexpr int kRows = 2 * kSize;
  template <typename T>
  bool operator()(const T* x, const T* begin, const T* end, const T* next, T* rows) const {
    Fly(x, FlightAcceleration<T>(gravity, 0, nullptr), step.Length(begin, end), rows);
    for (int j = 0; j < kRows; ++j) rows[j] = next[j] - rows[j];
    return true;
  }
};

// An impact. Blocks: the nodes before and after of each disc that moves, of a first; then the rotations before and
// after of each that spins. Rows: the equalities gap = 0, after - g(before) of each such disc and of each such
// rotation; the inequalities that the two do not separate and, if it is to slip or to stick, that it does.
struct ImpactCut {
  ImpactConstants law;
  std::optional<HalfPlane<double>> plane;  // in the place of b
  std::array<std::optional<Vec2d>, 2> at;  // of a side that is a fixed disc
  double overlap = 0;                      // of the contact distance: the gap is -overlap * contact_distance instead
  std::optional<ContactMode> mode = {};    // as slipping or sticking; none: by Coulomb's law

  bool Moves(int side) const { return !at[side] && !(side == 1 && plane); }
  int num_moving() const { return Moves(0) + Moves(1); }
  bool Spins(int side) const { return law.inverse_inertia[side] > 0; }
  int num_spinning() const { return Spins(0) + Spins(1); }
  int num_equalities() const { return 1 + 4 * num_moving() + 2 * num_spinning(); }
  int num_inequalities() const { return mode ? 2 : 1; }

  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    std::array<Vec2<T>, 2> p, v;
    std::array<T, 2> spin = {T(0.0), T(0.0)};
    int block = 0;
    for (int side = 0; side < 2; ++side) {
      p[side] = v[side] = Vec2<T>(T(0), T(0));
      if (at[side]) p[side] = at[side]->template cast<T>();
      if (!Moves(side)) continue;
      const T* x = blocks[block];
      block += 2;
      p[side] = Vec2<T>(x[0], x[1]);
      v[side] = Vec2<T>(x[2], x[3]);
    }
    T const* const* rotations = blocks + block;
    block = 0;
    for (int side = 0; side < 2; ++side) {
      if (Spins(side)) spin[side] = rotations[block][1] / law.radius[side];
      block += Spins(side) ? 2 : 0;
    }
    const Separation<T> apart = plane ? Separate<T>(p[0], *plane) : Separate<T>(p[0], p[1]);
    const Impact<T> impact = MakeImpact<T>(law, apart.normal, Vec2<T>(v[0] - v[1]), spin, mode);
    *rows++ = apart.distance - (1 - overlap) * law.contact_distance;
    block = 0;
    for (int side = 0; side < 2; ++side) {
      if (!Moves(side)) continue;
      const T* after = blocks[block + 1];
      block += 2;
      const double gain = side == 0 ? law.inverse_mass_a : -law.inverse_mass_b;
      for (int j = 0; j < 2; ++j) *rows++ = after[j] - p[side][j];
      for (int j = 0; j < 2; ++j) *rows++ = after[2 + j] - v[side][j] - gain * impact.impulse[j];
    }
    for (int side = 0; side < 2; ++side) {
      if (!Spins(side)) continue;
      const T *before = rotations[0], *after = rotations[1];
      rotations += 2;
      *rows++ = after[0] - before[0];
      *rows++ = after[1] - before[1] - law.radius[side] * SpinGain(law, side, impact);
    }
    *rows++ = impact.speed;
    if (!mode) return true;
    const T most = law.MostDrag() * impact.speed;
    const T slip = impact.sliding * impact.sliding - most * most;
    *rows++ = *mode == ContactMode::kSlip ? T(-slip) : slip;
    return true;
  }
};

// A running term over a step: costs whose squares sum up to the integral, exact but where the target turns. Blocks:
// node, force if the disc is pushed, begin, end. Rows: 6.
struct RunningCost {
  StepOfPhase step;
  Vec2d gravity;
  double inverse_mass;
  bool pushed;
  double least;  // s, as of PushedStep
  RunningTerm term;
  static constexpr int kRows = 6;

  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    using std::sqrt;
    const T* x = blocks[0];
    const T* force = pushed ? blocks[1] : nullptr;
    const T* begin = blocks[pushed ? 2 : 1];
    const T h = step.Length(begin, blocks[pushed ? 3 : 2]);
    const T length = Value(h) > least ? h : T(least);
    for (size_t i = 0; i < kGaussNodes.size(); ++i) {
      T there[4];
      Fly(x, FlightAcceleration(gravity, inverse_mass, force), T(kGaussNodes[i] * h), there);
      const Vec2<T> target = TargetAt(term, T(begin[0] + (step.index + kGaussNodes[i]) * h));
      const T* q = term.quantity == TerminalTerm::Quantity::kPosition ? there : there + 2;
      const T scale = std::sqrt(term.weight * kGaussWeights[i]) * sqrt(length);
      for (int j = 0; j < 2; ++j) *rows++ = scale * (q[j] - target[j]);
    }
    return true;
  }
};

// Bounds on a force, or on torque / radius, in parts of the bound. Block: force. Rows: inequalities |u_j| <= most; or
// one |u| <= most.
template <int kSize>
struct ComponentBound {
  double most;
  static constexpr int kRows = 2 * kSize;
  template <typename T>
  bool operator()(const T* force, T* rows) const {
    for (int j = 0; j < kSize; ++j) {
      rows[2 * j] = force[j] / most - 1.0;
      rows[2 * j + 1] = -force[j] / most - 1.0;
    }
    return true;
  }
};
struct NormBound {
  double most;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(const T* force, T* rows) const {
    rows[0] = 0.5 * ((force[0] * force[0] + force[1] * force[1]) / (most * most) - 1.0);
    return true;
  }
};

// least <= end - begin. Blocks: begin, end. Row: an inequality.
struct LengthBound {
  double least = 0;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(const T* begin, const T* end, T* rows) const {
    rows[0] = least - (end[0] - begin[0]);
    return true;
  }
};

// The place of a quantity in a node or a rotation.
inline int PlaceOf(TerminalTerm::Quantity quantity) {
  constexpr int kPlaces[] = {0, 2, 0, 1};
  return kPlaces[static_cast<int>(quantity)];
}

// scale (q - target), costs, with q the position or velocity of a node (2 rows), or the angle or angular velocity of a
// rotation (1).
template <int kSize>
struct Target {
  TerminalTerm::Quantity quantity;
  Vec2d target;
  double scale, radius = 1;  // by which a rotation is multiplied
  static constexpr int kRows = kSize;
  template <typename T>
  bool operator()(const T* x, T* rows) const {
    const T* q = x + PlaceOf(quantity);
    for (int j = 0; j < kSize; ++j) rows[j] = scale * (q[j] / radius - target[j]);
    return true;
  }
};

// That q is in a region, with q the position or velocity of a node, or the angle or angular velocity of a rotation.
// Block: node or rotation. Rows: equalities q = bound of components whose bounds are equal, then inequalities.
struct GoalRows {
  TerminalTerm::Quantity quantity;
  TerminalTerm::Region region;
  double radius = 1;  // by which a rotation is multiplied

  bool IsGiven(int j) const { return region.min[j] == region.max[j]; }
  int num_equalities() const { return IsGiven(0) + IsGiven(1); }
  int num_inequalities() const {
    int count = 0;
    for (int j = 0; j < 2; ++j) count += IsGiven(j) ? 0 : std::isfinite(region.min[j]) + std::isfinite(region.max[j]);
    return count;
  }

  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    const T* q = blocks[0] + PlaceOf(quantity);
    for (int j = 0; j < 2; ++j) {
      if (IsGiven(j)) *rows++ = q[j] / radius - region.min[j];
    }
    for (int j = 0; j < 2; ++j) {
      if (IsGiven(j)) continue;
      if (std::isfinite(region.max[j])) *rows++ = q[j] / radius - region.max[j];
      if (std::isfinite(region.min[j])) *rows++ = region.min[j] - q[j] / radius;
    }
    return true;
  }
};

// That the speed of a node is at most `most`. Block: node. Row: an inequality, smooth where the disc is at rest, of
// slope one at the bound, and linear far beyond it.
struct SpeedBound {
  double most;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(const T* x, T* rows) const {
    using std::sqrt;
    rows[0] = sqrt(2.0 * (x[2] * x[2] + x[3] * x[3] + most * most)) - 2 * most;
    return true;
  }
};

// Two discs (or a disc and a plane) that are not to meet, where they come nearest in a step of a phase. Blocks: of each
// disc that moves its node at the beginning of the step, or if it coasts at that of the phase; then the force on each
// that is pushed; then begin and end. Row: the inequality contact distance - distance <= 0, in parts of the contact
// distance.
struct Clearance {
  struct Side {
    std::optional<Vec2d> at;  // of a fixed disc
    bool coasts = false;      // not pushed, and without nodes inside of a phase
    bool pushed = false;
    double inverse_mass = 0;
  };
  double contact_distance;                 // from where on they are too near
  std::optional<HalfPlane<double>> plane;  // in the place of b
  std::array<Side, 2> sides;
  StepOfPhase step;
  Vec2d gravity;

  int num_sides() const { return plane ? 1 : 2; }

  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    std::array<const T*, 2> x = {nullptr, nullptr}, force = x;
    for (int side = 0; side < num_sides(); ++side) x[side] = sides[side].at ? nullptr : *blocks++;
    for (int side = 0; side < num_sides(); ++side) force[side] = sides[side].pushed ? *blocks++ : nullptr;
    const T h = step.Length(blocks[0], blocks[1]);
    std::array<Vec2<T>, 2> p, v, a;  // at the beginning of the step
    for (int side = 0; side < 2; ++side) {
      p[side] = v[side] = a[side] = Vec2<T>(T(0), T(0));
      if (sides[side].at) p[side] = sides[side].at->template cast<T>();
      if (x[side] == nullptr) continue;
      a[side] = FlightAcceleration(gravity, sides[side].inverse_mass, force[side]);
      T there[4] = {x[side][0], x[side][1], x[side][2], x[side][3]};
      if (sides[side].coasts) Fly(x[side], a[side], T(h * double(step.index)), there);
      p[side] = Vec2<T>(there[0], there[1]);
      v[side] = Vec2<T>(there[2], there[3]);
    }
    // The time of the nearest point has no derivative to first order.
    const T s = Nearest(Values(p), Values(v), Values(a), Value(h)) * h;
    for (int side = 0; side < num_sides(); ++side) p[side] += Scale(s, Vec2<T>(v[side] + Scale(T(0.5 * s), a[side])));
    const Separation<T> apart = plane ? Separate<T>(p[0], *plane) : Separate<T>(p[0], p[1]);
    rows[0] = 1.0 - apart.distance / contact_distance;
    return true;
  }

 private:
  template <typename T>
  static Vec2d Values(const std::array<Vec2<T>, 2>& of) {
    return {Value(of[0][0]) - Value(of[1][0]), Value(of[0][1]) - Value(of[1][1])};
  }

  // The part of a step of length h after which two that are p apart come nearest; v and a are relative too.
  double Nearest(const Vec2d& p, const Vec2d& v, const Vec2d& a, double h) const {
    double least = std::numeric_limits<double>::infinity(), at = 0;
    constexpr int kSamples = 4, kNewtonSteps = 4;
    const auto consider = [&](double part) {
      const double s = part * h;
      const Vec2d there = p + s * (v + 0.5 * s * a);
      const double distance = plane ? Dot(plane->normal, there) : there.norm();
      if (distance < least) {
        least = distance;
        at = part;
      }
    };
    for (int i = 0; i <= kSamples; ++i) consider(double(i) / kSamples);
    for (int i = 0; i < kNewtonSteps; ++i) {
      const double s = at * h;
      const Vec2d w = v + s * a, there = p + s * (v + 0.5 * s * a);
      const double slope = plane ? Dot(plane->normal, w) : Dot(there, w);
      const double curvature = plane ? Dot(plane->normal, a) : Dot(w, w) + Dot(there, a);
      if (!(curvature > 0) || h == 0) break;
      consider(std::clamp((s - slope / curvature) / h, 0.0, 1.0));
    }
    return at;
  }
};

// Row, an inequality: how much nearer than at a touch two are at the start, of their contact distance. Blocks: the
// initial states of those that are not held.
struct StartGap {
  double contact_distance;
  std::optional<HalfPlane<double>> plane;  // in the place of b
  std::array<std::optional<Vec2d>, 2> at;  // held

  template <typename T>
  bool operator()(T const* const* x, T* rows) const {
    std::array<Vec2<T>, 2> p;
    for (int side = 0; side < (plane ? 1 : 2); ++side) {
      p[side] = at[side] ? Vec2<T>(at[side]->template cast<T>()) : Vec2<T>((*x)[0], (*x)[1]);
      if (!at[side]) ++x;
    }
    const Separation<T> apart = plane ? Separate<T>(p[0], *plane) : Separate<T>(p[0], p[1]);
    rows[0] = 1.0 - apart.distance / contact_distance;
    return true;
  }
};

// sqrt(weight T), so that the loss gains weight T. Block: the final time.
struct DurationPrice {
  double weight;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(const T* end, T* rows) const {
    using std::sqrt;
    if (!(Value(end[0]) > 0)) return false;
    rows[0] = sqrt(weight * end[0]);
    return true;
  }
};

}  // namespace saltus
