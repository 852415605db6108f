// JSON documents with a stated number of significant digits, and null in place of NaN and infinity, which JSON does not
// have.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace saltus {

// Numbers of digits after which every double (float) is read back with the same bits.
inline constexpr int kDoubleDigits = 17;
inline constexpr int kFloatDigits = 9;

// The document as text, ending with a newline: two spaces of indentation, short arrays and objects on one line, long
// arrays of numbers filled to 120 columns. Numbers have so many significant digits, e.g. 0.10000000000000001; whole
// ones keep a ".0", so that readers see a floating-point number. Bytes that are not UTF-8 become U+FFFD. Precondition:
// 1 <= significant_digits <= 17.
std::string DumpJson(const nlohmann::ordered_json& document, int significant_digits = kDoubleDigits);

}  // namespace saltus
