// Many points of any options, one row each.
#include "sweep/sweep.h"

int main(int argc, char** argv) { return saltus::SweepMain(argc, argv); }
