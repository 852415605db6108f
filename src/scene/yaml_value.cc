#include "scene/yaml_value.h"

#include <yaml-cpp/eventhandler.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <sstream>

#include "base/suggestion.h"
#include "base/table.h"

namespace saltus::internal {
namespace {

// Names of things in messages are cut to this many bytes.
constexpr std::size_t kLongestExcerpt = 60;

// Length of the UTF-8 character at `text[i]`, or 0 if there is none, or one of the control characters that YAML
// forbids.
std::size_t CharacterLength(std::string_view text, std::size_t i) {
  const auto byte = [&](std::size_t k) { return k < text.size() ? static_cast<unsigned char>(text[k]) : 0U; };
  const unsigned lead = byte(i);
  if (lead < 0x80) return (lead >= 0x20 && lead != 0x7F) || lead == '\t' || lead == '\n' || lead == '\r';
  const std::size_t length = lead >= 0xF0 ? 4 : lead >= 0xE0 ? 3 : 2;
  if (lead < 0xC2 || lead > 0xF4) return 0;
  for (std::size_t k = 1; k < length; ++k) {
    if ((byte(i + k) & 0xC0) != 0x80) return 0;
  }
  // These are overlong forms, surrogates, and numbers beyond the last code point.
  const unsigned second = byte(i + 1);
  if ((lead == 0xE0 && second < 0xA0) || (lead == 0xED && second > 0x9F)) return 0;
  if ((lead == 0xF0 && second < 0x90) || (lead == 0xF4 && second > 0x8F)) return 0;
  return length;
}

void CheckText(std::string_view text) {
  if (text.size() > kMaxSceneBytes) {
    throw SceneFileFailure{
        1, "", "found more than " + std::to_string(kMaxSceneBytes) + " bytes, expected a scene file"};
  }
  int line = 1;
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t length = CharacterLength(text, i);
    if (length == 0) {
      throw SceneFileFailure{line,
                             "",
                             "found byte " + std::to_string(static_cast<unsigned char>(text[i])) +
                                 ", expected text in UTF-8 without control characters"};
    }
    line += text[i] == '\n';
    i += length;
  }
}

// Refuses, before any tree is built, what YAML allows and a scene file does not need.
class StructureCheck : public YAML::EventHandler {
 public:
  bool found_document() const { return found_document_; }

  void OnDocumentStart(const YAML::Mark& mark) override {
    Expect(!found_document_, mark, "found a second document, expected one");
    found_document_ = true;
  }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override { CheckNode(mark, "", anchor); }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override {
    Expect(false, mark, "found an alias, expected the value itself");
  }
  void OnScalar(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor, const std::string&) override {
    CheckNode(mark, tag, anchor);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override {
    CheckNode(mark, tag, anchor);
    Descend(mark);
  }
  void OnSequenceEnd() override { --depth_; }
  void OnMapStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override {
    CheckNode(mark, tag, anchor);
    Descend(mark);
  }
  void OnMapEnd() override { --depth_; }

 private:
  static void Expect(bool holds, const YAML::Mark& mark, const std::string& message) {
    if (!holds) throw SceneFileFailure{mark.line + 1, "", message};
  }
  static void CheckNode(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor) {
    Expect(anchor == YAML::NullAnchor, mark, "found an anchor (&), expected the value without one");
    Expect(tag.empty() || tag == "?" || tag == "!",
           mark,
           "found the tag " + Printable(tag) + ", expected the value without one");
  }
  void Descend(const YAML::Mark& mark) {
    Expect(++depth_ <= kMaxSceneDepth,
           mark,
           "found lists or maps nested deeper than " + std::to_string(kMaxSceneDepth) + ", expected a scene");
  }

  bool found_document_ = false;
  int depth_ = 0;
};

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

std::string Printable(std::string_view text) {
  std::size_t length = std::min(text.size(), kLongestExcerpt);
  while (length > 0 && length < text.size() && (text[length] & 0xC0) == 0x80) --length;
  std::string printable;
  for (const unsigned char c : text.substr(0, length)) {
    if (c < 0x20 || c == 0x7F) {
      constexpr char kDigits[] = "0123456789abcdef";
      printable += {'\\', 'x', kDigits[c >> 4], kDigits[c & 15]};
    } else {
      printable += static_cast<char>(c);
    }
  }
  return length < text.size() ? printable + "..." : printable;
}

YAML::Node LoadYaml(std::string_view text) {
  CheckText(text);
  std::istringstream stream{std::string(text)};
  YAML::Parser parser(stream);
  StructureCheck check;
  while (parser.HandleNextDocument(check)) {
  }
  if (!check.found_document()) throw SceneFileFailure{1, "", "found nothing, expected a scene"};
  return YAML::Load(std::string(text));
}

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
                 "one of " + Joined(choices) + (value.node.IsScalar() ? Suggestion(value.node.Scalar(), choices) : ""));
  }
  return static_cast<int>(choice - choices.begin());
}

}  // namespace saltus::internal
