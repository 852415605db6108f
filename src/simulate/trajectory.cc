#include "simulate/trajectory.h"

#include <cmath>

namespace saltus {

int WindowLength(int steps, std::size_t state_bytes, std::size_t limit) {
  const auto bytes = [&](int length) {
    return (static_cast<std::size_t>(length) + (steps + length - 1) / length) * state_bytes;
  };
  const int cached = static_cast<int>(std::min<std::size_t>(kWindowBytes / state_bytes, steps));
  const int balanced = static_cast<int>(std::ceil(std::sqrt(steps)));
  int length = std::clamp(cached, 1, steps);
  while (length < balanced && bytes(length) > limit) length = std::min(2 * length, balanced);
  while (length > balanced && bytes(length) > limit) length = std::max(length / 2, balanced);
  return length;
}

}  // namespace saltus
