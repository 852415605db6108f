// Every table and figure of the paper.
#include "programs/reproduce.h"

int main(int argc, char** argv) { return saltus::ReproduceMain(argc, argv); }
