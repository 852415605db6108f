// A contact model as a black box, for programs that ask simulators.
#include "programs/simulate.h"

int main(int argc, char** argv) { return saltus::SimulateMain(argc, argv); }
