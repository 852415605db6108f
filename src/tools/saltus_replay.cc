// Writes a page that plays saved motions.
#include "tools/replay_file.h"

int main(int argc, char** argv) { return saltus::ReplayMain(argc, argv); }
