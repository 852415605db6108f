// The gaps of discs, and of discs and walls, in one interval of a motion, and where they are least.
//
// Between its impacts the acceleration of a disc is constant in an interval. The least gap of a pair that does not
// touch is where the gap stops falling: at a zero of its rate, at an impact that turns one of the discs aside, or at
// the end of the interval. Of a disc that has three or more impacts in an interval, the flights between them are not
// known, and gaps in them are not looked at.
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
  // since the beginning of the interval. Keeps references to scene, walls and states.
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

  // A flight of a disc between two of its impacts, with where it is at a time of it.
  struct Leg {
    double from, to, time;
    Vec2d position, velocity;
  };
  // A part of the interval in which neither disc of a pair has an impact.
  struct Stretch {
    double from, to;
    std::array<Leg, 2> legs;  // of a, and of b if that is a disc
  };
  // Overwrites `stretches`, in the order of time.
  void FindStretches(const GapPair& pair, std::vector<Stretch>* stretches) const;
  Gap At(const Stretch& stretch, const GapPair& pair, double t) const;
  Vec2d PositionOfA(const Stretch& stretch, const GapPair& pair, double t) const {
    return PositionIn(stretch.legs[0], pair.a, t);
  }
  std::optional<double> LeastIn(const Stretch& stretch, const GapPair& pair) const;

 private:
  // Finds the legs of a disc that are known, the first of them before its impacts and the last one behind. Returns
  // their number.
  int FindLegs(int i, std::array<Leg, 3>* legs) const;
  Vec2d VelocityIn(const Leg& leg, int i, double t) const { return leg.velocity + (t - leg.time) * accelerations_[i]; }
  Vec2d PositionIn(const Leg& leg, int i, double t) const {
    const double s = t - leg.time;
    return leg.position + s * (leg.velocity + 0.5 * s * accelerations_[i]);
  }
  Gap GapOf(const GapPair& pair, const Vec2d& at_a, const Vec2d& of_a, const Vec2d& at_b, const Vec2d& of_b) const;

  const Scene& scene_;
  const std::span<const WallPart> walls_;
  const FlightState &begin_, &end_;
  std::vector<double> first_, second_, last_;  // impact of each disc
  std::vector<Vec2d> accelerations_;           // without impacts; where contacts last, with those of their forces
};

}  // namespace saltus
