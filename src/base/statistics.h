// Norms and medians of numbers, whether they are finite, and the exponent of a power law.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

namespace saltus {

// The Euclidean norm.
inline double Norm(const std::vector<double>& entries) {
  double sum = 0;
  for (double entry : entries) sum += entry * entry;
  return std::sqrt(sum);
}

// Returns |found - exact| / |exact|. Precondition: as many entries in both.
inline double RelativeError(std::vector<double> found, const std::vector<double>& exact) {
  for (size_t i = 0; i < exact.size(); ++i) found[i] -= exact[i];
  return Norm(found) / Norm(exact);
}

// Returns the largest magnitude, 0 if there are no entries. The largest of every fourth entry are found side by side,
// as each comparison waits for the one before.
inline double Largest(std::span<const double> entries) {
  std::array<double, 4> largest = {};
  std::size_t i = 0;
  for (; i + largest.size() <= entries.size(); i += largest.size()) {
    for (std::size_t j = 0; j < largest.size(); ++j) largest[j] = std::max(largest[j], std::abs(entries[i + j]));
  }
  for (; i < entries.size(); ++i) largest[0] = std::max(largest[0], std::abs(entries[i]));
  return std::max({largest[0], largest[1], largest[2], largest[3]});
}

// Returns whether all entries are finite. Exponents of ones only become negative by the addition, and the loop has no
// branches, so that the compiler takes several entries at a time.
inline bool AllFinite(std::span<const double> entries) {
  constexpr std::uint64_t kExponent = 0x7ff0'0000'0000'0000, kOne = 0x0010'0000'0000'0000;
  std::uint64_t sums = 0;
  for (const double entry : entries) sums |= (std::bit_cast<std::uint64_t>(entry) & kExponent) + kOne;
  return sums >> 63 == 0;
}

// Returns the median, the upper one of the two middle values if their number is even. Precondition: not empty.
inline double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Returns the exponent p of the power law y = c x^p, fitted by linear least squares to the logarithms.
inline double FittedExponent(std::span<const double> x, std::span<const double> y) {
  double sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0;
  const double n = static_cast<double>(x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    const double log_x = std::log(x[i]), log_y = std::log(y[i]);
    sum_x += log_x;
    sum_y += log_y;
    sum_xx += log_x * log_x;
    sum_xy += log_x * log_y;
  }
  return (n * sum_xy - sum_x * sum_y) / (n * sum_xx - sum_x * sum_x);
}

}  // namespace saltus
