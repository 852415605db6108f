#include "programs/audit.h"

int main(int argc, char** argv) { return saltus::AuditMain(argc, argv); }
