#include "folders.h"

namespace saltus {

std::string SourceFolder() { return SALTUS_SOURCE_DIR; }
std::string BuildFolder() { return SALTUS_BINARY_DIR; }

}  // namespace saltus
