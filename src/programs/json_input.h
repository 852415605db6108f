// JSON that users hand to the programs.
#pragma once

#include <string>

#include "programs/json_output.h"

namespace saltus {

// The document in `text`. What is none is an InputError that begins with `where` and names the line and column, and
// `expected`, such as "a JSON object".
Json ParseJson(const std::string& text, const std::string& where, const std::string& expected);

}  // namespace saltus
