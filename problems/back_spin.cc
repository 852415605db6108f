// A ball thrown so that it comes back: launch velocity and spin.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc, argv, {.scene = saltus::ShippedFile("problems/back_spin.yaml"), .solver = "ceres_lm", .iterations = 100});
}
