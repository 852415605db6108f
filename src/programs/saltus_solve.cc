// Optimises a scene with any contact models and solvers.
#include "programs/solve.h"

int main(int argc, char** argv) { return saltus::SolveMain(argc, argv); }
