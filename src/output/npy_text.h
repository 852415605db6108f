// Text in NPY files: UTF-32, all entries of one length, padded with zeros (NumPy's type str_, '<U<length>').
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace saltus::internal {

inline constexpr char kNpyTextType[] = "<U";

struct NpyText {
  int width = 1;      // characters of every entry
  std::string bytes;  // 4 * width each, little-endian
};

// Bytes that are not UTF-8 become U+FFFD.
NpyText EncodeNpyText(const std::vector<std::string>& texts);

// Nothing if the bytes are no such entries. Precondition: width > 0.
std::optional<std::vector<std::string>> DecodeNpyText(const NpyText& text);

}  // namespace saltus::internal
