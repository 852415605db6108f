// The gaps of discs, and of discs and walls, in one interval of a motion, and where they are least.
//
// Between its impacts the acceleration of a disc is constant in an interval. The least gap of a pair that does not
// touch is where the gap stops falling: at a zero of its rate, at an impact that turns one of the discs aside, or at
// the end of the interval. Between two impacts of the same disc in an interval gaps are not looked at.
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "saltus/scene/walls.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// Two discs, or a disc and a part of a wall.
struct GapPair {
  int a = 0, b = 0;
  const WallPart* wall = nullptr;

  std::array<int, 2> discs() const { return {a, wall == nullptr ? b : a}; }
};

struct Gap {
  double value = 0, rate = 0;    // m, m/s
  Vec2d normal = Vec2d::Zero();  // towards disc a
};

// The state of all discs at a time of the interval, from which they fly on or back.
struct FlightState {
  double time = 0;        // s, since the beginning of the interval
  std::vector<double> x;  // disc by disc as in simulator.h: position (m), velocity (m/s), then what spins
};

class IntervalGaps {
 public:
  static constexpr double kTouching = 1e-9;  // of a radius: the gap of discs that touch
  static constexpr double kNever = std::numeric_limits<double>::infinity();

  // The interval lasts from `begin` to `end`, under `force` (N, two numbers of each disc). Times of `touches` are in s
  // since the beginning of the interval. Keeps references to scene and walls.
  IntervalGaps(const Scene& scene, std::span<const WallPart> walls, std::span<const Touch> touches,
               std::span<const double> force, const FlightState& begin, const FlightState& end);

  GapPair PairOf(const Candidate& c) const { return {c.a, c.b, c.plane ? &walls_[c.b] : nullptr}; }
  static bool Touches(std::span<const Touch> touches, const GapPair& pair);
  // The times of the first and of the last impact of one of the two discs; never, and 0, if there is none.
  double First(const GapPair& pair) const;
  double Last(const GapPair& pair) const;
  // The gap up to which the discs of a pair touch, m.
  double Touching(const GapPair& pair) const;

  Vec2d Velocity(const FlightState& flight, int i, double t) const;
  Vec2d Position(const FlightState& flight, int i, double t) const;
  Gap At(const FlightState& flight, const GapPair& pair, double t) const;
  // Returns when the gap ceases to fall between two times; nothing if it does not fall at the first, or still does at
  // the second.
  std::optional<double> LeastBetween(const FlightState& flight, const GapPair& pair, double from, double to) const;

 private:
  const Scene& scene_;
  const std::span<const WallPart> walls_;
  std::vector<double> first_, last_;  // impact of each disc
  std::vector<Vec2d> accelerations_;  // without impacts; where contacts last, with those of their forces
};

}  // namespace saltus
