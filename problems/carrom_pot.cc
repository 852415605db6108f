// A carrom pot: launch velocity of a striker that sends a coin into a pocket.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc, argv, {.scene = saltus::ShippedFile("problems/carrom_pot.yaml"), .solver = "ceres_lm", .iterations = 100});
}
