#include <glog/logging.h>

#include <cmath>

#include "fuzz/targets.h"
#include "programs/given_gradient.h"
#include "programs/program.h"

namespace saltus::fuzz {
namespace {

void CheckVectors(const std::vector<std::optional<Vec2d>>& vectors, int most) {
  CHECK_LE(vectors.size(), static_cast<size_t>(most));
  for (const std::optional<Vec2d>& vector : vectors) {
    CHECK(!vector || (std::isfinite((*vector)[0]) && std::isfinite((*vector)[1])));
  }
}

}  // namespace

void ReadsGiven(std::string_view bytes) {
  const Scene& scene = ExampleScene();
  try {
    const GivenGradient given = ReadGivenGradient(FileWith(bytes), scene);
    CHECK(given.tolerance >= 0 && std::isfinite(given.tolerance));
    CheckVectors(given.position, scene.num_bodies());
    CheckVectors(given.velocity, scene.num_bodies());
    CHECK_LE(given.control.size(), static_cast<size_t>(scene.steps));
    for (const auto& forces : given.control) CheckVectors(forces, scene.num_controlled());
  } catch (const InputError& error) {
    CHECK_NE(error.what(), std::string());
  }
}

}  // namespace saltus::fuzz
