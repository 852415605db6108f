// Reproducible standard normal variates: a 64-bit Mersenne Twister with the transformation of Box and Muller (1958),
// because the algorithm of std::normal_distribution differs between standard libraries.
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
  // Returns a uniform variate in (0, 1) with 53 random bits.
  double Uniform() { return (static_cast<double>(bits_() >> 11) + 0.5) * 0x1p-53; }

  std::mt19937_64 bits_;
  double sine_ = 0;
  bool has_sine_ = false;
};

}  // namespace saltus
