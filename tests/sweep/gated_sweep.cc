// saltus_sweep with one more contact model, the gate.
#include "sweep/sweep.h"

int main(int argc, char** argv) { return saltus::SweepMain(argc, argv); }
