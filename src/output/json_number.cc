#include "output/json_number.h"

#include <glog/logging.h>

#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>

namespace saltus {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kColumns = 120;
constexpr size_t kIndent = 2;

// Writes a document whose numbers are known to be finite.
class Writer {
 public:
  explicit Writer(int significant_digits) : digits_(significant_digits) {}

  std::string Document(const Json& document) {
    Value(document, 0, 0);
    return std::move(text_) + "\n";
  }

 private:
  static bool IsContainer(const Json& value) { return value.is_structured() && !value.empty(); }

  std::string Scalar(const Json& value) const {
    if (value.is_number_float()) return *FormatJsonNumber(value.get<double>(), digits_);
    return value.dump(-1, ' ', false, Json::error_handler_t::replace);
  }

  // The value on one line, or what fits of it: gives up once it is longer than `limit`.
  void OneLine(const Json& value, size_t limit, std::string* line) const {
    if (!IsContainer(value)) {
      *line += Scalar(value);
      return;
    }
    const bool object = value.is_object();
    *line += object ? "{" : "[";
    bool first = true;
    for (const auto& [key, child] : value.items()) {
      if (!first) *line += ", ";
      first = false;
      if (object) *line += Scalar(key) + ": ";
      OneLine(child, limit, line);
      if (line->size() > limit) return;
    }
    *line += object ? "}" : "]";
  }

  // `used`: columns taken on the current line; one more is kept for a comma.
  bool FitsOnOneLine(const Json& value, size_t used, std::string* line) const {
    const size_t room = used < kColumns ? kColumns - used - 1 : 0;
    OneLine(value, room, line);
    return line->size() <= room;
  }

  void NewLine(size_t depth) {
    text_ += '\n';
    text_.append(depth * kIndent, ' ');
  }

  void Value(const Json& value, size_t depth, size_t used) {
    std::string line;
    // The outermost object is always opened up.
    if (!IsContainer(value) || ((depth > 0 || value.is_array()) && FitsOnOneLine(value, used, &line))) {
      text_ += line.empty() ? Scalar(value) : line;
    } else if (value.is_object()) {
      Object(value, depth);
    } else {
      Array(value, depth);
    }
  }

  void Object(const Json& value, size_t depth) {
    text_ += '{';
    const char* separator = "";
    for (const auto& [key, child] : value.items()) {
      text_ += separator;
      NewLine(depth + 1);
      const std::string label = Scalar(key) + ": ";
      text_ += label;
      Value(child, depth + 1, (depth + 1) * kIndent + label.size());
      separator = ",";
    }
    NewLine(depth);
    text_ += '}';
  }

  // Entries that fit on one line share lines, as words in a paragraph, if they are numbers or short arrays.
  void Array(const Json& value, size_t depth) {
    text_ += '[';
    size_t column = kColumns;
    bool first = true;
    for (const Json& child : value) {
      if (!first) text_ += ',';
      std::string line;
      const size_t indent = (depth + 1) * kIndent;
      const bool fills = !child.is_object() && FitsOnOneLine(child, indent, &line);
      if (fills && !first && column + 2 + line.size() < kColumns) {
        text_ += ' ' + line;
        column += 2 + line.size();
      } else {
        NewLine(depth + 1);
        Value(child, depth + 1, indent);
        column = fills ? indent + line.size() : kColumns;
      }
      first = false;
    }
    NewLine(depth);
    text_ += ']';
  }

  int digits_;
  std::string text_;
};

std::optional<Json::json_pointer> FindNonFinite(const Json& value, const Json::json_pointer& here) {
  if (value.is_number_float() && !std::isfinite(value.get<double>())) return here;
  if (value.is_object()) {
    for (const auto& [key, child] : value.items()) {
      if (auto found = FindNonFinite(child, here / key)) return found;
    }
  } else if (value.is_array()) {
    for (size_t i = 0; i < value.size(); ++i) {
      if (auto found = FindNonFinite(value[i], here / i)) return found;
    }
  }
  return std::nullopt;
}

}  // namespace

std::optional<std::string> FormatJsonNumber(double value, int significant_digits) {
  CHECK(1 <= significant_digits && significant_digits <= kDoubleDigits) << significant_digits;
  if (!std::isfinite(value)) return std::nullopt;
  std::array<char, 40> buffer;
  const auto [end, error] = std::to_chars(
      buffer.data(), buffer.data() + buffer.size(), value, std::chars_format::general, significant_digits);
  CHECK(error == std::errc());
  std::string text(buffer.data(), end);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";
  return text;
}

StatusOr<std::string> DumpJson(const nlohmann::ordered_json& document, int significant_digits) {
  if (const auto place = FindNonFinite(document, Json::json_pointer())) {
    return Status::Error("number at '" + place->to_string() + "' is not finite");
  }
  return Writer(significant_digits).Document(document);
}

}  // namespace saltus
