// Where tests find what they read and run. Defined in one file, so that no other depends on where the checkout is.
#pragma once

#include <string>

namespace saltus {

std::string SourceFolder();  // of the checkout
std::string BuildFolder();

// The path of a temporary file or folder that no other process has: tests run side by side, each in its own process.
std::string TempFile(const std::string& name);

}  // namespace saltus
