// Derivatives where Jets find none although the function has one, such as v |v| with |v| = sqrt(v_x^2 + v_y^2) at rest:
// the limit of the derivatives at points nearby, if it is one.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <limits>
#include <span>
#include <vector>

namespace saltus {

template <typename Jet>
bool HasDerivatives(std::span<const Jet> jets) {
  return std::ranges::all_of(jets, [](const Jet& jet) { return jet.v.allFinite(); });
}

// Replaces derivatives of finite numbers `out` that are not finite by their limits at the point, where a limit exists.
// `function()` computes `out` from `inputs`, which are moved off the point in several directions, by two distances, and
// put back: derivatives have a limit if they differ less, from direction to direction, the nearer the points are. Then
// the function, which is continuous, has this derivative (mean value theorem).
template <typename Jet, typename Function>
void CompleteJets(std::initializer_list<std::span<Jet>> inputs, std::span<Jet> out, const Function& function) {
  constexpr std::array kDistances = {1e-4, 1e-8};  // of the size of each input
  constexpr double kOfZero = 1e-40;                // size of an input that is zero: its fourth power does not underflow
  constexpr int kDirections = 4;                   // two and their opposites
  constexpr double kGolden = 0.6180339887498949;
  constexpr double kCloser = 1e-2, kRounding = 1e-13;
  constexpr int kWidth = Jet::DIMENSION;
  if (HasDerivatives<Jet>(out) || !std::ranges::all_of(out, [](const Jet& jet) { return std::isfinite(jet.a); })) {
    return;
  }
  const std::vector<Jet> found(out.begin(), out.end());
  std::vector<double> at;
  for (const std::span<Jet> part : inputs) {
    for (const Jet& jet : part) at.push_back(jet.a);
  }
  struct Derivatives {
    double least = std::numeric_limits<double>::infinity(), most = -least, sum = 0;
  };
  std::array<std::vector<Derivatives>, 2> all;
  for (std::size_t near = 0; near < 2; ++near) {
    all[near].resize(out.size() * kWidth);
    for (int direction = 0; direction < kDirections; ++direction) {
      std::size_t number = 0;
      for (const std::span<Jet> part : inputs) {
        for (Jet& jet : part) {
          // Parts of 1/2 to 3/2 of the distance, with both signs.
          double whole = 0;
          const double part_of = std::modf(kGolden * static_cast<double>((number + 1) * (direction / 2 + 1)), &whole);
          const double sign = ((number >> (direction / 2)) + direction) % 2 == 0 ? 1 : -1;
          const double size = at[number] != 0 ? std::abs(at[number]) : kOfZero;
          jet.a = at[number++] + sign * (0.5 + part_of) * kDistances[near] * size;
        }
      }
      function();
      for (std::size_t i = 0; i < all[near].size(); ++i) {
        const double derivative = out[i / kWidth].v[static_cast<int>(i % kWidth)];
        Derivatives& of = all[near][i];
        of.least = std::min(of.least, derivative);
        of.most = std::max(of.most, derivative);
        of.sum += derivative;  // which is not finite if one of them is not
      }
    }
  }
  std::size_t number = 0;
  for (const std::span<Jet> part : inputs) {
    for (Jet& jet : part) jet.a = at[number++];
  }
  std::ranges::copy(found, out.begin());
  for (std::size_t i = 0; i < all[1].size(); ++i) {
    double& derivative = out[i / kWidth].v[static_cast<int>(i % kWidth)];
    const Derivatives &far = all[0][i], &near = all[1][i];
    const double rounding = kRounding * std::max(std::abs(near.least), std::abs(near.most));
    const bool has_limit = std::isfinite(far.sum) && std::isfinite(near.sum) &&
                           near.most - near.least <= kCloser * (far.most - far.least) + rounding;
    if (std::isfinite(derivative) || !has_limit) continue;
    constexpr double kBeyond = kDistances[1] / (kDistances[0] - kDistances[1]);  // the difference is linear
    derivative = (near.sum - kBeyond * (far.sum - near.sum)) / kDirections;
  }
}

}  // namespace saltus
