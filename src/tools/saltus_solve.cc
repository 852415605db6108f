// Optimises a scene with any contact models and solvers.
#include "tools/solve.h"

int main(int argc, char** argv) { return saltus::SolveMain(argc, argv); }
