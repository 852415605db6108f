// Numbers in messages and files.
#pragma once

#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>

namespace saltus {

// The shortest text that reads back as the same number.
inline std::string ToText(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value).ptr};
}

// The number with so many significant digits, as printf's %g writes it.
inline std::string ToText(double value, int digits) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value, std::chars_format::general, digits).ptr};
}

// The text of a printf format with up to three numbers, cut off after 239 characters.
inline std::string FormatNumbers(const char* format, double a, double b = 0, double c = 0) {
  char text[240];
  std::snprintf(text, sizeof text, format, a, b, c);
  return text;
}

// The number rounded to so many significant digits.
inline double RoundedTo(int digits, double value) { return std::strtod(ToText(value, digits).c_str(), nullptr); }

// Reads the whole text as a number. There is none if the text is something else, or if the number is not finite or out
// of the range of its type.
template <typename Number>
std::optional<Number> FromText(std::string_view text) {
  Number number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(number)) return std::nullopt;
  return number;
}

}  // namespace saltus
