// Random scenes of tossed boxes (tossed_boxes.h): what goes wrong, a line each, and how often what was found. Fails if
// anything goes wrong.
#include "campaign/tossed_boxes.h"

#include <gflags/gflags.h>

#include <map>

DEFINE_int32(scenes, 1000, "how many");
DEFINE_int32(seed, 1, "of the first; the next has the next");
DEFINE_int32(gradient_every, 5, "compare the gradient of one in so many with differences");

int main(int argc, char** argv) {
  gflags::ParseCommandLineFlags(&argc, &argv, /*remove_flags=*/true);
  int wrong = 0, refused = 0, compared = 0, without_derivative = 0, closed = 0, impacts = 0, gains = 0;
  double lowest_gap = 0, energy = 0, gradient_error = 0;
  std::map<std::string, int> reasons;
  for (int i = 0; i < FLAGS_scenes; ++i) {
    const int seed = FLAGS_seed + i;
    const saltus::TossedBoxes::Result result =
        saltus::TossedBoxes(seed).Run(FLAGS_gradient_every > 0 && i % FLAGS_gradient_every == 0);
    if (!result.wrong.empty()) {
      ++wrong;
      std::printf("seed %d: %s\n", seed, result.wrong.c_str());
    }
    if (!result.refused.empty()) {
      ++refused;
      std::printf("seed %d is refused: %s\n", seed, result.refused.c_str());
    }
    compared += result.gradient_compared ? 1 : 0;
    without_derivative += result.why_no_derivative.empty() ? 0 : 1;
    closed += result.closed > 0 ? 1 : 0;
    impacts += result.impacts;
    gains += result.gains;
    lowest_gap = std::min(lowest_gap, result.lowest_gap);
    energy = std::max(energy, result.energy);
    gradient_error = std::max(gradient_error, result.gradient_error);
  }
  std::printf("%d scenes: %d wrong, %d refused, %d impacts, %d of which gain energy, %d scenes with closed contacts\n",
              FLAGS_scenes,
              wrong,
              refused,
              impacts,
              gains,
              closed);
  std::printf(
      "lowest gap %.3g m, energy above the bound %.3g, %d gradients compared, largest error %.3g, %d scenes "
      "without a derivative\n",
      lowest_gap,
      energy,
      compared,
      gradient_error,
      without_derivative);
  return wrong == 0 ? 0 : 1;
}
