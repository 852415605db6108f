#include <algorithm>
#include <cmath>
#include <set>

#include "base/csv.h"
#include "base/number_text.h"
#include "base/table.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "sweep/study.h"

namespace saltus {
namespace {

constexpr int64_t kMostValues = 1'000'000;  // of all ranges of a sweep: few characters can ask for many
constexpr double kLargestInteger = 1e9;     // that an int holds

std::optional<double> ReadNumber(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  return FromText<double>(text);
}

// Reads the value of an option. Returns the error as "found 'x', expected y", or nothing after setting `value`.
std::string ReadValue(const std::string& option, const std::string& text, const Scene& scene, SweepValue* value) {
  const SweepOptionKind kind = *FindSweepOption(option, scene);
  const std::string found = "found '" + text + "', expected ";
  if (kind == SweepOptionKind::kWord) {
    *value = text;
    if (option == "contact") return WhatIsWrongWith(text);
    const std::vector<std::string> words = SweepWords(option);
    return std::ranges::find(words, text) != words.end() ? "" : found + "one of " + Joined(words);
  }
  const std::optional<double> number = ReadNumber(text);
  if (!number) return found + "a number";
  *value = *number;
  if (kind != SweepOptionKind::kInteger) return "";
  const bool whole = std::round(*number) == *number && std::abs(*number) <= kLargestInteger;
  return whole ? "" : found + "a whole number up to 1e9";
}

// One pass over the text. What it takes next decides what it expects.
class SpecParser {
 public:
  SpecParser(const std::string& text, const Scene& scene) : text_(text), scene_(scene) {}

  std::vector<SweepBlock> Parse() {
    std::vector<SweepBlock> blocks;
    do {
      blocks.push_back(ParseBlock());
      if (!AtEnd() && Peek() != ';') Fail("',', '&' or ';'");
    } while (Accept(';') && !AtEnd());
    return blocks;
  }

 private:
  // " after 'what stands before'", shortened.
  std::string Before(size_t place) const {
    constexpr size_t kMost = 30;
    const size_t from = place > kMost ? place - kMost : 0;
    if (place == 0) return "";
    return std::string(" after '") + (from > 0 ? "..." : "") + text_.substr(from, place - from) + "'";
  }

  [[noreturn]] void FailAt(size_t place, const std::string& what) const {
    throw InputError("--sweep, character " + std::to_string(place + 1) + Before(place) + ": " + what);
  }
  [[noreturn]] void FailAt(size_t place, const std::string& found, const std::string& expected) const {
    FailAt(place, "found " + (found.empty() ? "nothing" : "'" + found + "'") + ", expected " + expected);
  }

  [[noreturn]] void Fail(const std::string& expected) {
    SkipSpaces();
    FailAt(at_, text_.substr(at_, 1), expected);
  }

  void SkipSpaces() {
    while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_])) != 0) ++at_;
  }

  bool AtEnd() {
    SkipSpaces();
    return at_ == text_.size();
  }

  char Peek() { return AtEnd() ? '\0' : text_[at_]; }

  bool Accept(char c) {
    if (Peek() != c) return false;
    ++at_;
    return true;
  }

  void Expect(char c) {
    if (!Accept(c)) Fail(std::string("'") + c + "'");
  }

  // A token up to the next mark; spaces at its ends are not part of it.
  struct Token {
    std::string text;
    size_t place = 0;
  };
  Token Take(const char* marks = ",;:&=()") {
    SkipSpaces();
    Token token{"", at_};
    at_ = std::min(text_.find_first_of(marks, at_), text_.size());
    token.text = text_.substr(token.place, at_ - token.place);
    token.text.erase(token.text.find_last_not_of(" \t\n") + 1);
    return token;
  }

  // The name of a contact model may have options with the marks of a range.
  Token TakeValue(const std::string& option) { return option == "contact" ? Take(",;&()") : Take(); }

  SweepBlock ParseBlock() {
    if (Peek() == '@') return ParseFile();
    if (Peek() == '(') return ParseTuples();
    SweepBlock block = ParseAxis();
    while (Accept('&')) {
      SkipSpaces();
      const size_t place = at_;
      const SweepBlock axis = ParseAxis();
      if (axis.rows.size() != block.rows.size()) {
        FailAt(place,
               text_.substr(place, at_ - place),
               std::to_string(block.rows.size()) + " values, as '" + block.options[0] + "' has (there are " +
                   std::to_string(axis.rows.size()) + ")");
      }
      block.options.push_back(axis.options[0]);
      for (size_t i = 0; i < block.rows.size(); ++i) block.rows[i].push_back(axis.rows[i][0]);
    }
    return block;
  }

  // The name of an option that has not been used before.
  std::string ParseName() {
    const Token token = Take();
    if (token.text.empty()) Fail("an option, such as in \"stiffness=1e2:1e5:log:4\"");
    CheckName(token.text, [&](const std::string& expected) { FailAt(token.place, token.text, expected); });
    return token.text;
  }

  template <typename OnError>
  void CheckName(const std::string& name, const OnError& fail) {
    if (!FindSweepOption(name, scene_)) {
      std::vector<std::string> names = SweepOptionNames();
      if (!scene_.materials.empty())
        std::erase_if(names, [](const auto& n) { return n == "restitution" || n == "friction"; });
      fail("an option: one of " + Joined(names) + ", or <body>.<field> of the scene, such as " +
           (scene_.bodies.empty() ? "ball" : scene_.bodies[0].name) + ".mass" +
           (scene_.materials.empty() ? "" : ", or of its materials: " + ContactParametersOf(scene_)));
    }
    // A pair of materials may be named in either order.
    const std::vector<SceneParameter> parameters = ParametersNamed(name, scene_);
    const std::string option = parameters.size() == 1 ? NameOf(parameters[0], scene_) : name;
    if (!used_.insert(option).second) fail("each option once");
  }

  SweepBlock ParseAxis() {
    SweepBlock block;
    block.options = {ParseName()};
    Expect('=');
    do {
      ParseItem(&block);
    } while (Accept(','));
    return block;
  }

  SweepValue ParseValue(const std::string& option, const Token& token) {
    SweepValue value;
    const std::string wrong = ReadValue(option, token.text, scene_, &value);
    if (!wrong.empty()) FailAt(token.place, wrong);
    return value;
  }

  void ParseItem(SweepBlock* block) {
    const std::string& option = block->options[0];
    const Token token = TakeValue(option);
    if (Peek() != ':') {
      block->rows.push_back({ParseValue(option, token)});
      return;
    }
    if (FindSweepOption(option, scene_) == SweepOptionKind::kWord) FailAt(token.place, token.text, "no range of words");
    ParseRange(token, block);
  }

  double ParseEnd(const Token& token) {
    const std::optional<double> number = ReadNumber(token.text);
    if (!number) FailAt(token.place, token.text, "a number");
    return *number;
  }

  // The rest of first:last:lin|log:count.
  void ParseRange(const Token& first_token, SweepBlock* block) {
    const std::string form = "first:last:lin:count or first:last:log:count";
    const double first = ParseEnd(first_token);
    if (!Accept(':')) Fail(form);
    const Token last_token = Take();
    const double last = ParseEnd(last_token);
    if (!Accept(':')) Fail(form);
    const Token scale = Take();
    if (scale.text != "lin" && scale.text != "log") FailAt(scale.place, scale.text, "'lin' or 'log', as in " + form);
    if (!Accept(':')) Fail(form);
    const Token count_token = Take();
    const double count = ReadNumber(count_token.text).value_or(0);
    if (count < 1 || count > kMostValues || count != std::floor(count)) {
      FailAt(count_token.place, count_token.text, "a whole number in 1..1000000");
    }
    values_left_ -= static_cast<int64_t>(count);
    if (values_left_ < 0) {
      FailAt(count_token.place, count_token.text, "at most 1000000 values in all ranges; more of them in a file (@)");
    }
    const bool log = scale.text == "log";
    if (log && !(first > 0)) FailAt(first_token.place, first_token.text, "a number > 0, as the range is logarithmic");
    if (log && !(last > 0)) FailAt(last_token.place, last_token.text, "a number > 0, as the range is logarithmic");
    if (!std::isfinite(log ? last / first : last - first) || (log && last / first == 0)) {
      FailAt(last_token.place, last_token.text, "a number closer to " + first_token.text);
    }
    AddRange(first, last, log, static_cast<int>(count), first_token, block);
  }

  void AddRange(double first, double last, bool log, int count, const Token& place, SweepBlock* block) {
    const bool whole = FindSweepOption(block->options[0], scene_) == SweepOptionKind::kInteger;
    for (int i = 0; i < count; ++i) {
      const double t = count > 1 ? i / (count - 1.0) : 0.0;
      // Powers of ten within a logarithmic range are exact in spite of rounding.
      double value = RoundedTo(15, log ? first * std::pow(last / first, t) : first + t * (last - first));
      if (i > 0 && i + 1 == count) value = last;  // not what rounding makes of it
      if (whole) value = std::round(value);
      if (whole && std::abs(value) > kLargestInteger) FailAt(place.place, place.text, "a range within 1e9");
      if (whole && i > 0 && SweepValue(value) == block->rows.back()[0]) {
        FailAt(place.place, place.text, "fewer values: two of the range round to the same whole number");
      }
      block->rows.push_back({value});
    }
  }

  SweepBlock ParseTuples() {
    SweepBlock block;
    Expect('(');
    do {
      block.options.push_back(ParseName());
    } while (Accept(','));
    Expect(')');
    Expect('=');
    do {
      Expect('(');
      SweepRow row;
      for (const std::string& option : block.options) {
        if (!row.empty()) Expect(',');
        row.push_back(ParseValue(option, TakeValue(option)));
      }
      Expect(')');
      block.rows.push_back(std::move(row));
    } while (Accept(','));
    return block;
  }

  SweepBlock ParseFile() {
    Expect('@');
    const Token path = Take(";");
    const StatusOr<CsvDocument> csv = ReadCsv(path.text);
    if (!csv.ok()) throw InputError("--sweep, character " + std::to_string(path.place) + ": " + csv.status().message());
    const auto fail = [&](const std::string& place, const std::string& what) {
      throw InputError(path.text + ", " + place + ": " + what);
    };
    SweepBlock block;
    for (const std::string& name : csv->header) {
      CheckName(name,
                [&](const std::string& expected) { fail("header", "found '" + name + "', expected " + expected); });
      block.options.push_back(name);
    }
    for (size_t i = 0; i < csv->rows.size(); ++i) {
      SweepRow row(block.options.size());
      for (size_t j = 0; j < row.size(); ++j) {
        const std::string wrong = ReadValue(block.options[j], csv->rows[i][j], scene_, &row[j]);
        if (!wrong.empty()) fail("row " + std::to_string(i + 1) + ", " + block.options[j], wrong);
      }
      block.rows.push_back(std::move(row));
    }
    if (block.rows.empty()) throw InputError(path.text + ": no rows below the header, expected at least one");
    return block;
  }

  const std::string& text_;
  const Scene& scene_;
  size_t at_ = 0;
  int64_t values_left_ = kMostValues;  // of ranges
  std::set<std::string> used_;
};

}  // namespace

std::vector<SweepBlock> ParseSweep(const std::string& text, const Scene& scene) {
  return SpecParser(text, scene).Parse();
}

}  // namespace saltus
