// Every table and figure of the paper.
#include "paper/reproduce.h"

int main(int argc, char** argv) { return saltus::ReproduceMain(argc, argv); }
