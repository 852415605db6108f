// Random numbers that are the same on every machine. The engines of the standard library are specified, but its
// distributions differ between implementations.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>

#include "saltus/scene/geometry.h"

namespace saltus {

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}

  // Uniform in [0, 1).
  double Unit() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  // Uniform in [-1, 1).
  double Symmetric() { return 2 * Unit() - 1; }
  double Uniform(double low, double high) { return low + (high - low) * Unit(); }
  // Returns one of 0 .. count - 1; the probabilities differ by less than 1e-10. Precondition: count > 0.
  int Below(int count) { return static_cast<int>(engine_() % static_cast<std::uint64_t>(count)); }
  // Returns two independent standard normal variates (Box and Muller 1958).
  Vec2d Normal() {
    const double length = std::sqrt(-2 * std::log(1 - Unit()));
    const double angle = 2 * std::numbers::pi * Unit();
    return {length * std::cos(angle), length * std::sin(angle)};
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace saltus
