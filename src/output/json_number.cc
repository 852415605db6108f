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

void AppendNumber(double value, int significant_digits, std::string* text) {
  std::array<char, 40> buffer;
  const auto [end, error] = std::to_chars(
      buffer.data(), buffer.data() + buffer.size(), value, std::chars_format::general, significant_digits);
  CHECK(error == std::errc());
  const std::string_view digits(buffer.data(), end);
  text->append(digits);
  if (digits.find_first_of(".e") == std::string_view::npos) text->append(".0");
}

// Writes the document. Each number is formatted once only, because documents have millions of them.
class Writer {
 public:
  explicit Writer(int significant_digits) : digits_(significant_digits) {}

  std::string Document(const Json& document) {
    // The outermost object is always written over several lines.
    if (document.is_object() || !OnOneLine(document, RoomAfter(0))) Open(document, 0);
    return std::move(text_) + "\n";
  }

 private:
  // One column is kept for a comma.
  static size_t RoomAfter(size_t used) { return used < kColumns ? kColumns - used - 1 : 0; }

  void Scalar(const Json& value) {
    if (value.is_number_float() && std::isfinite(value.get<double>())) {
      AppendNumber(value.get<double>(), digits_, &text_);
    } else {
      text_ += value.dump(-1, ' ', false, Json::error_handler_t::replace);
    }
  }

  // Appends the value on one line if it takes at most `room` columns, and nothing otherwise.
  bool OnOneLine(const Json& value, size_t room) {
    const size_t begin = text_.size();
    if (AppendUpTo(begin + room, value)) return true;
    text_.resize(begin);
    return false;
  }

  // Appends the value; returns false as soon as the text is longer than `limit`.
  bool AppendUpTo(size_t limit, const Json& value) {
    const char* separator = "";
    if (value.is_object()) {
      text_ += '{';
      for (const auto& [key, child] : value.get_ref<const Json::object_t&>()) {
        text_ += separator;
        Label(key);
        if (!AppendUpTo(limit, child)) return false;
        separator = ", ";
      }
      text_ += '}';
    } else if (value.is_array()) {
      text_ += '[';
      for (const Json& child : value) {
        text_ += separator;
        if (!AppendUpTo(limit, child)) return false;
        separator = ", ";
      }
      text_ += ']';
    } else {
      Scalar(value);
    }
    return text_.size() <= limit;
  }

  void Label(const std::string& key) {
    Scalar(key);
    text_ += ": ";
  }

  void NewLine(size_t depth) {
    text_ += '\n';
    text_.append(depth * kIndent, ' ');
  }

  // Appends a value that does not fit on the line.
  void Open(const Json& value, size_t depth) {
    if (value.is_object() && !value.empty()) {
      Object(value, depth);
    } else if (value.is_array() && !value.empty()) {
      Array(value, depth);
    } else {
      Scalar(value);
    }
  }

  void Object(const Json& value, size_t depth) {
    text_ += '{';
    const char* separator = "";
    for (const auto& [key, child] : value.get_ref<const Json::object_t&>()) {
      text_ += separator;
      const size_t line = text_.size() + 1;
      NewLine(depth + 1);
      Label(key);
      if (!OnOneLine(child, RoomAfter(text_.size() - line))) Open(child, depth + 1);
      separator = ",";
    }
    NewLine(depth);
    text_ += '}';
  }

  // Entries that fit on one line share lines, as words in a paragraph, if they are numbers or short arrays.
  void Array(const Json& value, size_t depth) {
    const size_t indent = (depth + 1) * kIndent;
    text_ += '[';
    size_t column = kColumns;
    const char* separator = "";
    for (const Json& child : value) {
      text_ += separator;
      const size_t begin = text_.size();
      text_ += ' ';
      const bool fits = OnOneLine(child, RoomAfter(indent)), fills = fits && !child.is_object();
      const size_t length = text_.size() - begin - 1;
      if (fills && column + 2 + length < kColumns) {
        column += 2 + length;
      } else {
        text_.replace(begin, 1, "\n" + std::string(indent, ' '));
        if (!fits) Open(child, depth + 1);
        column = fills ? indent + length : kColumns;
      }
      separator = ",";
    }
    NewLine(depth);
    text_ += ']';
  }

  int digits_;
  std::string text_;
};

}  // namespace

std::string DumpJson(const nlohmann::ordered_json& document, int significant_digits) {
  CHECK(1 <= significant_digits && significant_digits <= kDoubleDigits) << significant_digits;
  return Writer(significant_digits).Document(document);
}

}  // namespace saltus
