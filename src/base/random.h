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
  int UniformIndex(int count) { return static_cast<int>(engine_() % static_cast<std::uint64_t>(count)); }
  // Returns two independent standard normal variates (Box and Muller 1958).
  Vec2d Normal() {
    const double length = std::sqrt(-2 * std::log(1 - Unit()));
    const double angle = 2 * std::numbers::pi * Unit();
    return {length * std::cos(angle), length * std::sin(angle)};
  }

 private:
  std::mt19937_64 engine_;
};

// Reproducible standard normal variates: a 64-bit Mersenne Twister with the transformation of Box and Muller (1958),
// because the algorithm of std::normal_distribution differs between standard libraries.
class NormalStream {
 public:
  explicit NormalStream(std::uint64_t seed) : bits_(seed) {}

  double Next() {
    if (has_sine_) {
      has_sine_ = false;
      return sine_;
    }
    const double radius = std::sqrt(-2 * std::log(Uniform()));
    const double angle = 2 * std::numbers::pi * Uniform();
    sine_ = radius * std::sin(angle);
    has_sine_ = true;
    return radius * std::cos(angle);
  }

 private:
  // Returns a uniform variate in (0, 1) with 53 random bits.
  double Uniform() { return (static_cast<double>(bits_() >> 11) + 0.5) * 0x1p-53; }

  std::mt19937_64 bits_;
  double sine_ = 0;
  bool has_sine_ = false;
};

}  // namespace saltus
