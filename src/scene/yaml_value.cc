#include "scene/yaml_value.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>

#include "base/suggestion.h"
#include "scene/yaml_text.h"

namespace saltus::internal {
namespace {

bool IsQuoted(const YAML::Node& node) { return node.Tag() == "!"; }

template <typename T>
bool ParseAll(std::string_view text, T* value) {
  if (text.starts_with('+')) {
    text.remove_prefix(1);
    if (text.starts_with('-')) return false;
  }
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), *value);
  return status == std::errc() && end == text.data() + text.size() && std::isfinite(*value);
}

template <typename T>
T ReadPlain(const Value& value, const char* expected) {
  T result = 0;
  if (!value.node.IsScalar() || IsQuoted(value.node) || !ParseAll(value.node.Scalar(), &result)) {
    FailExpected(value, expected);
  }
  return result;
}

}  // namespace

std::string Describe(const YAML::Node& node) {
  switch (node.Type()) {
    case YAML::NodeType::Map:
      return "a map";
    case YAML::NodeType::Sequence:
      return "a list of " + std::to_string(node.size());
    case YAML::NodeType::Scalar:
      return IsQuoted(node) ? "the text \"" + Printable(node.Scalar()) + '"' : Printable(node.Scalar());
    default:
      return "nothing";
  }
}

void Fail(const Value& value, const std::string& message) { throw SceneFileFailure{value.line, value.path, message}; }

void FailExpected(const Value& value, const std::string& expected) {
  Fail(value, "found " + Describe(value.node) + ", expected " + expected);
}

double ReadNumber(const Value& value, const char* expected) { return ReadPlain<double>(value, expected); }

double ReadNumber(const Value& value) { return ReadPlain<double>(value, "a finite number"); }

int ReadSteps(const Value& value) { return ReadPlain<int>(value, "a positive whole number"); }

bool ReadBool(const Value& value) {
  if (value.node.IsScalar() && !IsQuoted(value.node)) {
    if (value.node.Scalar() == "true") return true;
    if (value.node.Scalar() == "false") return false;
  }
  FailExpected(value, "true or false");
}

const std::string& ReadName(const Value& value) {
  if (!value.node.IsScalar()) FailExpected(value, "a name");
  const std::string& name = value.node.Scalar();
  const bool in_one_line = std::none_of(name.begin(), name.end(), [](unsigned char c) { return std::iscntrl(c); });
  if (!in_one_line) FailExpected(value, "a name without line breaks and other control characters");
  return name;
}

int ReadChoice(const Value& value, const std::vector<std::string>& choices) {
  const auto choice = std::find(choices.begin(), choices.end(), value.node.IsScalar() ? value.node.Scalar() : "");
  if (choice == choices.end()) {
    FailExpected(value,
                 "one of " + Join(choices) + (value.node.IsScalar() ? Suggestion(value.node.Scalar(), choices) : ""));
  }
  return static_cast<int>(choice - choices.begin());
}

}  // namespace saltus::internal
