// Task 2: the launch velocity that hits a target off ground and wall.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc,
      argv,
      {.scene = saltus::ShippedFile("problems/ground_wall.yaml"), .learning_rate = 0.01, .iterations = 1000});
}
