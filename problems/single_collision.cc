// The follow-up paper's control of one collision of two balls.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc,
      argv,
      {.scene = saltus::ShippedFile("problems/single_collision.yaml"), .learning_rate = 200, .iterations = 500});
}
