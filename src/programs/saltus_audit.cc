// Gradients of contact models against the exact one.
#include "programs/audit.h"

int main(int argc, char** argv) { return saltus::AuditMain(argc, argv); }
