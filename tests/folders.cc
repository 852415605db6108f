#include "folders.h"

#include <gtest/gtest.h>
#include <unistd.h>

namespace saltus {

std::string SourceFolder() { return SALTUS_SOURCE_DIR; }
std::string BuildFolder() { return SALTUS_BINARY_DIR; }

std::string TempFile(const std::string& name) {
  return testing::TempDir() + "/" + std::to_string(getpid()) + "_" + name;
}

}  // namespace saltus
