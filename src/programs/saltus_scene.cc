// Writes scenes of many discs.
#include "programs/make_scene.h"

int main(int argc, char** argv) { return saltus::SceneMain(argc, argv); }
