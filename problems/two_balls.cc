// Task 3: the force that makes one ball strike another towards the origin.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc, argv, {.scene = saltus::ShippedFile("problems/two_balls.yaml"), .learning_rate = 10, .iterations = 1000});
}
