// Task 1: the gradient of the height after one bounce.
#include "programs/problem.h"

int main(int argc, char** argv) {
  // There is nothing to optimise in it.
  return saltus::ProblemMain(argc, argv, {.scene = saltus::ShippedFile("problems/bounce_once.yaml"), .solver = "none"});
}
