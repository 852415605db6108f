// A carrom shot through a gate: launch velocity of a striker, after which all comes to rest.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc, argv, {.scene = saltus::ShippedFile("problems/carrom_gate.yaml"), .solver = "ceres_lm", .iterations = 100});
}
