// Writes a page that plays saved motions.
#include "programs/replay_file.h"

int main(int argc, char** argv) { return saltus::ReplayMain(argc, argv); }
