// A bank shot: launch velocity and side spin of a cue ball that goes by the cushion; the way is searched for.
#include "programs/problem.h"

int main(int argc, char** argv) {
  return saltus::ProblemMain(
      argc,
      argv,
      {.scene = saltus::ShippedFile("problems/bank_shot.yaml"), .solver = "mode_search", .iterations = 1000});
}
