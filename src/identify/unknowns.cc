#include "identify/unknowns.h"

#include <algorithm>
#include <cmath>

namespace saltus {

double FitUnknown::FromCoordinate(double coordinate) const {
  if (IsBoundedBelow() && IsBoundedAbove()) return low + (high - low) / (1 + std::exp(-coordinate));
  if (IsBoundedBelow()) return low + std::exp(coordinate);
  return IsBoundedAbove() ? high - std::exp(coordinate) : coordinate;
}

double FitUnknown::SlopeAt(double coordinate) const {
  const double value = FromCoordinate(coordinate);
  if (IsBoundedBelow() && IsBoundedAbove()) return (value - low) * (high - value) / (high - low);
  if (IsBoundedBelow()) return value - low;
  return IsBoundedAbove() ? value - high : 1;
}

double FitUnknown::ToCoordinate(double value) const {
  if (IsBoundedBelow() && IsBoundedAbove()) {
    const double inside = std::clamp((value - low) / (high - low), kInsideBounds, 1 - kInsideBounds);
    return std::log(inside / (1 - inside));
  }
  const double least = kInsideBounds * scale;
  if (IsBoundedBelow()) return std::log(std::max(value - low, least));
  return IsBoundedAbove() ? std::log(std::max(high - value, least)) : value;
}

double FitUnknown::Origin() const { return IsBoundedBelow() ? low : IsBoundedAbove() ? high : 0; }

double FitUnknown::ScaleAt(double value) const {
  return is_relative ? std::max(std::abs(value - Origin()), scale) : scale;
}

double FitUnknown::BoundNear(double value) const { return high - value < value - low ? high : low; }

double FitUnknown::CoordinateAtBoundNear(double coordinate) const {
  constexpr double kFar = 23;  // where the value is 1e-10 changes that matter from its bound
  if (!reaches_bounds || !HasBounds()) return coordinate;
  return IsBoundedBelow() && IsBoundedAbove() ? std::copysign(kFar, coordinate) : std::log(scale) - kFar;
}

double FitUnknown::Spread(double share) const {
  if (!is_relative || !HasBounds()) return first + (last - first) * share;
  const double from = Origin();
  return from + (first - from) * std::pow((last - from) / (first - from), share);
}

}  // namespace saltus
