// A law of impact that is known from elsewhere, to stand beside one that is learned.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace saltus {

// Restitution by the speed of approach, m/s, which rises.
struct KnownLaw {
  std::vector<double> speed, restitution;

  // By straight lines between the points; nothing outside of them.
  std::optional<double> At(double at) const;
};

// From CSV with the columns speed and restitution. Throws InputError that names the line: numbers that are not finite,
// speeds that do not rise, restitution outside of [0, 1], fewer than two rows.
KnownLaw ReadKnownLaw(const std::string& path);

}  // namespace saltus
