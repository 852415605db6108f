// Numbers in messages and files.
#pragma once

#include <charconv>
#include <string>

namespace saltus {

// The shortest text that reads back as the same number.
inline std::string ToText(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value).ptr};
}

}  // namespace saltus
