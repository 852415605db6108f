#include <glog/logging.h>

#include <cmath>

#include "fuzz/targets.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "saltus/control/control_rows.h"

namespace saltus::fuzz {
namespace {

// Numbers that are not known are NaN.
void CheckNumbers(const std::vector<double>& numbers, int most) {
  CHECK_LE(numbers.size(), static_cast<size_t>(most));
  for (const double number : numbers) CHECK(!std::isinf(number));
}

}  // namespace

void ReadsGiven(std::string_view bytes) {
  const Scene& scene = ExampleScene();
  try {
    const ExternalGradient given = ReadExternalGradient(FileWith(bytes), scene);
    CHECK(given.tolerance >= 0 && std::isfinite(given.tolerance));
    CheckNumbers(given.position, 2 * scene.num_bodies());
    CheckNumbers(given.velocity, 2 * scene.num_bodies());
    CheckNumbers(given.control, scene.steps * scene.num_controlled() * ControlColumns(scene));
  } catch (const InputError& error) {
    CHECK_NE(error.what(), std::string());
  }
}

}  // namespace saltus::fuzz
