// Task 1: the gradient of the height after one bounce.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc, argv, {.scene = SALTUS_PROBLEMS_DIR "/bounce_once.yaml", .learning_rate = 0.01, .iterations = 1000});
}
