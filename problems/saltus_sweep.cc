// Many points of any options, one row each.
#include "programs/sweep/sweep.h"

int main(int argc, char** argv) { return saltus::SweepMain(argc, argv); }
