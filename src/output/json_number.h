// JSON documents with a stated number of significant digits, and without NaN or infinity, which JSON does not have.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "base/status.h"

namespace saltus {

// Digits after which every double (float) is read back as the same bits.
inline constexpr int kDoubleDigits = 17;
inline constexpr int kFloatDigits = 9;

// `value` as a JSON number with so many significant digits, e.g. 0.10000000000000001; whole numbers keep a ".0", so
// that readers see a floating-point number. Nothing if value is NaN or infinite. Precondition: 1 <= significant_digits
// <= 17.
std::optional<std::string> FormatJsonNumber(double value, int significant_digits = kDoubleDigits);

// The document as text, ending with a newline: two spaces of indentation, short arrays and objects on one line, long
// arrays of numbers filled to 120 columns. Bytes that are not UTF-8 become U+FFFD. An error, naming the place as in
// "/runs/0/final_loss", if a number is NaN or infinite.
StatusOr<std::string> DumpJson(const nlohmann::ordered_json& document, int significant_digits = kDoubleDigits);

}  // namespace saltus
