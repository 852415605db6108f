// The numbers that are fitted: how their bounds are kept, and what change of them matters.
#pragma once

#include <limits>
#include <string>

#include "saltus/identify/identify.h"

namespace saltus {

// The least distance of a start from a bound, and the least size of a number that has one, in changes that matter.
inline constexpr double kInsideBounds = 1e-3;

struct FitUnknown {
  std::string name;
  double start = 0;
  double low = -std::numeric_limits<double>::infinity(), high = std::numeric_limits<double>::infinity();
  bool reaches_bounds = true;  // whether a motion has the value of a bound
  // A change of the value that matters: what is known no better than this is not known. That of a relative one is its
  // distance from its bound, or without one its size, if this is more than `scale`.
  double scale = 1;
  bool is_relative = false;
  // The range over which starts are spread, evenly or, of a relative one with a bound, by factors of the distance from
  // it.
  double first = 0, last = 1;

  bool HasBounds() const { return IsBoundedBelow() || IsBoundedAbove(); }
  bool IsBoundedBelow() const { return low > -std::numeric_limits<double>::infinity(); }
  bool IsBoundedAbove() const { return high < std::numeric_limits<double>::infinity(); }

  // Converts a coordinate without bounds to the value: logistic between two bounds, exponential from one on, the
  // identity without any.
  double FromCoordinate(double coordinate) const;
  // Returns d value / d coordinate at a coordinate.
  double SlopeAt(double coordinate) const;
  // Returns the coordinate of a value; of one at a bound, that of a value a little inside.
  double ToCoordinate(double value) const;
  double ScaleAt(double value) const;
  // Returns the bound that is nearest to a value. Precondition: HasBounds().
  double BoundNear(double value) const;
  // Returns a coordinate at the bound nearest to one; the same one if no motion has the value of a bound.
  double CoordinateAtBoundNear(double coordinate) const;
  // Returns a start at a share of the range of starts.
  double Spread(double share) const;

 private:
  double Origin() const;  // of relative numbers
};

}  // namespace saltus
