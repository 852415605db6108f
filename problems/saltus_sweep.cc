#include "programs/sweep/sweep.h"

int main(int argc, char** argv) { return saltus::SweepMain(argc, argv); }
