// Where tests find what they read and run. Defined in one file, so that no other depends on where the checkout is.
#pragma once

#include <string>

namespace saltus {

std::string SourceFolder();  // of the checkout
std::string BuildFolder();

}  // namespace saltus
