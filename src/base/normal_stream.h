// Standard normal numbers that are the same everywhere: 64-bit Mersenne Twister, and the transformation of Box and
// Muller (1958), which std::normal_distribution leaves to the library.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>

namespace saltus {

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
  // In (0, 1), 53 bits.
  double Uniform() { return (static_cast<double>(bits_() >> 11) + 0.5) * 0x1p-53; }

  std::mt19937_64 bits_;
  double sine_ = 0;
  bool has_sine_ = false;
};

}  // namespace saltus
