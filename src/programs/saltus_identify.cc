// Parameters of a scene from recordings of its motion.
#include "programs/identify.h"

int main(int argc, char** argv) { return saltus::IdentifyMain(argc, argv); }
