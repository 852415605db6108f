// The follow-up paper's control of two balls and a ceiling, with several collisions.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc,
      argv,
      {.scene = saltus::ShippedFile("problems/multiple_collisions.yaml"), .learning_rate = 50, .iterations = 1500});
}
