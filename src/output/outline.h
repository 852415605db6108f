// Walls that end, as figures and replays draw them.
#pragma once

#include <array>
#include <string>
#include <vector>

namespace saltus {

// A line from point to point. What is on one side of a closed one may be solid.
struct Outline {
  enum class Solid { kNeither, kInside, kOutside };
  std::string name;
  std::vector<std::array<double, 2>> points;  // m, at least two; of a closed line the last is the first
  Solid solid = Solid::kNeither;
};

inline const char* SolidName(Outline::Solid solid) {
  constexpr const char* kNames[] = {"neither", "inside", "outside"};
  return kNames[static_cast<int>(solid)];
}

}  // namespace saltus
