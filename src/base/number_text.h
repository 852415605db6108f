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

// With so many significant digits, as printf's %g writes it.
inline std::string ToText(double value, int digits) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value, std::chars_format::general, digits).ptr};
}

// As printf does.
inline std::string FormatNumbers(const char* format, double a, double b = 0, double c = 0) {
  char text[240];
  std::snprintf(text, sizeof text, format, a, b, c);
  return text;
}

// The number with so many significant digits.
inline double RoundedTo(int digits, double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.*g", digits, value);
  return std::strtod(text, nullptr);
}

// The number that the whole text is. Nothing if it is none, or none that is finite and that a Number holds.
template <typename Number>
std::optional<Number> FromText(std::string_view text) {
  Number number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(number)) return std::nullopt;
  return number;
}

}  // namespace saltus
