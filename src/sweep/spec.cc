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
    if (option == "contact") return Validate(text);
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

// Returns the text without spaces at its ends; of spaces alone, the empty text behind them.
std::string_view Trimmed(std::string_view text) {
  constexpr char kSpaces[] = " \t\n\v\f\r";
  text.remove_prefix(std::min(text.find_first_not_of(kSpaces), text.size()));
  return text.substr(0, text.find_last_not_of(kSpaces) + 1);
}

// Returns the parts of a text between separators, without spaces at their ends.
std::vector<std::string_view> Parts(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  for (size_t begin = 0, end = 0; end < text.size() || parts.empty(); begin = end + 1) {
    end = std::min(text.find(separator, begin), text.size());
    parts.push_back(Trimmed(text.substr(begin, end - begin)));
  }
  return parts;
}

// Reads a text part by part. Parts are views of it, so that errors name their place.
class SpecParser {
 public:
  SpecParser(const std::string& text, const Scene& scene) : text_(text), scene_(scene) {}

  std::vector<SweepBlock> Parse() {
    std::vector<std::string_view> parts = Parts(text_, ';');
    if (parts.size() > 1 && parts.back().empty()) parts.pop_back();
    std::vector<SweepBlock> blocks;
    for (const std::string_view part : parts) blocks.push_back(ParseBlock(part));
    return blocks;
  }

 private:
  // " after 'what stands before'", shortened.
  std::string PrecedingText(size_t place) const {
    constexpr size_t kMost = 30;
    const size_t from = place > kMost ? place - kMost : 0;
    if (place == 0) return "";
    return std::string(" after '") + (from > 0 ? "..." : "") + text_.substr(from, place - from) + "'";
  }

  [[noreturn]] void FailWith(std::string_view part, const std::string& what) const {
    const size_t place = part.data() - text_.data();
    throw InputError("--sweep, character " + std::to_string(place + 1) + PrecedingText(place) + ": " + what);
  }
  [[noreturn]] void Fail(std::string_view found, const std::string& expected) const {
    FailWith(found, "found " + (found.empty() ? "nothing" : "'" + std::string(found) + "'") + ", expected " + expected);
  }

  // Takes the text in the brackets with which `rest` begins, and leaves what follows.
  std::string_view TakeBrackets(std::string_view* rest) const {
    if (!rest->starts_with('(')) Fail(rest->substr(0, 1), "'('");
    const size_t end = rest->find(')');
    if (end == std::string_view::npos) Fail(rest->substr(rest->size()), "')'");
    const std::string_view inside = rest->substr(1, end - 1);
    *rest = Trimmed(rest->substr(end + 1));
    return inside;
  }

  SweepBlock ParseBlock(std::string_view text) {
    if (text.starts_with('@')) return ParseFile(Trimmed(text.substr(1)));
    if (text.starts_with('(')) return ParseTuples(text);
    SweepBlock block;
    for (const std::string_view part : Parts(text, '&')) {
      SweepBlock axis = ParseAxis(part);
      if (block.options.empty()) {
        block = std::move(axis);
        continue;
      }
      if (axis.rows.size() != block.rows.size()) {
        Fail(part,
             std::to_string(block.rows.size()) + " values, as '" + block.options[0] + "' has (there are " +
                 std::to_string(axis.rows.size()) + ")");
      }
      block.options.push_back(axis.options[0]);
      for (size_t i = 0; i < block.rows.size(); ++i) block.rows[i].push_back(axis.rows[i][0]);
    }
    return block;
  }

  // The name of an option that has not been used before.
  std::string ParseName(std::string_view text) {
    if (text.empty()) Fail(text, "an option, such as in \"stiffness=1e2:1e5:log:4\"");
    CheckName(std::string(text), [&](const std::string& expected) { Fail(text, expected); });
    return std::string(text);
  }

  template <typename OnError>
  void CheckName(const std::string& name, const OnError& fail) {
    if (!FindSweepOption(name, scene_)) {
      std::vector<std::string> names = SweepOptionNames();
      if (!scene_.materials.empty())
        std::erase_if(names, [](const auto& n) { return n == "restitution" || n == "friction"; });
      fail("an option: one of " + Joined(names) + ", or <body>.<field> of the scene, such as " +
           (scene_.bodies.empty() ? "ball" : scene_.bodies[0].name) + ".mass" +
           (scene_.materials.empty() ? "" : ", or of its materials: " + ContactParametersOf(scene_)) +
           (scene_.forces.empty() ? "" : ", or drag.BODY of a disc with drag"));
    }
    // A pair of materials may be named in either order.
    const std::vector<SceneParameter> parameters = ParametersNamed(name, scene_);
    const std::string option = parameters.size() == 1 ? NameOf(parameters[0], scene_) : name;
    if (!used_.insert(option).second) fail("each option once");
  }

  SweepBlock ParseAxis(std::string_view text) {
    const size_t equals = std::min(text.find('='), text.size());
    SweepBlock block;
    block.options = {ParseName(Trimmed(text.substr(0, equals)))};
    if (equals == text.size()) Fail(text.substr(equals), "'='");
    for (const std::string_view item : Parts(text.substr(equals + 1), ',')) ParseItem(item, &block);
    return block;
  }

  SweepValue ParseValue(const std::string& option, std::string_view text) {
    SweepValue value;
    const std::string wrong = ReadValue(option, std::string(text), scene_, &value);
    if (!wrong.empty()) FailWith(text, wrong);
    return value;
  }

  // A value or a range; the name of a contact model may have options with the marks of a range.
  void ParseItem(std::string_view text, SweepBlock* block) {
    const std::string& option = block->options[0];
    const std::vector<std::string_view> parts = Parts(text, ':');
    if (parts.size() == 1 || option == "contact") {
      block->rows.push_back({ParseValue(option, text)});
    } else if (FindSweepOption(option, scene_) == SweepOptionKind::kWord) {
      Fail(parts[0], "no range of words");
    } else {
      ParseRange(text, parts, block);
    }
  }

  double ParseEnd(std::string_view text) const {
    const std::optional<double> number = ReadNumber(text);
    if (!number) Fail(text, "a number");
    return *number;
  }

  // first:last:lin|log:count.
  void ParseRange(std::string_view text, const std::vector<std::string_view>& parts, SweepBlock* block) {
    const std::string form = "first:last:lin:count or first:last:log:count";
    const std::string_view end = text.substr(text.size());
    const double first = ParseEnd(parts[0]), last = ParseEnd(parts[1]);
    if (parts.size() < 3) Fail(end, form);
    if (parts[2] != "lin" && parts[2] != "log") Fail(parts[2], "'lin' or 'log', as in " + form);
    if (parts.size() != 4) Fail(parts.size() < 4 ? end : parts[4], form);
    const double count = ReadNumber(parts[3]).value_or(0);
    if (count < 1 || count > kMostValues || count != std::floor(count)) {
      Fail(parts[3], "a whole number in 1..1000000");
    }
    values_left_ -= static_cast<int64_t>(count);
    if (values_left_ < 0) Fail(parts[3], "at most 1000000 values in all ranges; more of them in a file (@)");
    const bool log = parts[2] == "log";
    if (log && !(first > 0)) Fail(parts[0], "a number > 0, as the range is logarithmic");
    if (log && !(last > 0)) Fail(parts[1], "a number > 0, as the range is logarithmic");
    if (!std::isfinite(log ? last / first : last - first) || (log && last / first == 0)) {
      Fail(parts[1], "a number closer to " + std::string(parts[0]));
    }
    AddRange(first, last, log, static_cast<int>(count), parts[0], block);
  }

  void AddRange(double first, double last, bool log, int count, std::string_view place, SweepBlock* block) {
    const bool whole = FindSweepOption(block->options[0], scene_) == SweepOptionKind::kInteger;
    for (int i = 0; i < count; ++i) {
      const double t = count > 1 ? i / (count - 1.0) : 0.0;
      // Powers of ten within a logarithmic range are exact in spite of rounding.
      double value = RoundedTo(15, log ? first * std::pow(last / first, t) : first + t * (last - first));
      if (i > 0 && i + 1 == count) value = last;  // not what rounding makes of it
      if (whole) value = std::round(value);
      if (whole && std::abs(value) > kLargestInteger) Fail(place, "a range within 1e9");
      if (whole && i > 0 && SweepValue(value) == block->rows.back()[0]) {
        Fail(place, "fewer values: two of the range round to the same whole number");
      }
      block->rows.push_back({value});
    }
  }

  SweepBlock ParseTuples(std::string_view rest) {
    SweepBlock block;
    for (const std::string_view name : Parts(TakeBrackets(&rest), ',')) block.options.push_back(ParseName(name));
    const size_t size = block.options.size();
    if (!rest.starts_with('=')) Fail(rest.substr(0, 1), "'='");
    do {
      rest = Trimmed(rest.substr(1));
      const std::string_view inside = TakeBrackets(&rest);
      const std::vector<std::string_view> values = Parts(inside, ',');
      if (values.size() < size) Fail({inside.data() + inside.size(), 1}, "','");
      if (values.size() > size) Fail({values[size - 1].data() + values[size - 1].size(), 1}, "')'");
      SweepRow& row = block.rows.emplace_back();
      for (size_t i = 0; i < size; ++i) row.push_back(ParseValue(block.options[i], values[i]));
    } while (rest.starts_with(','));
    if (!rest.empty()) Fail(rest.substr(0, 1), "',', '&' or ';'");
    return block;
  }

  SweepBlock ParseFile(std::string_view text) {
    const std::string path(text);
    const StatusOr<CsvDocument> csv = ReadCsv(path);
    if (!csv.ok()) {
      throw InputError("--sweep, character " + std::to_string(text.data() - text_.data()) + ": " +
                       csv.status().message());
    }
    const auto fail = [&](const std::string& place, const std::string& what) {
      throw InputError(path + ", " + place + ": " + what);
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
    if (block.rows.empty()) throw InputError(path + ": no rows below the header, expected at least one");
    return block;
  }

  const std::string& text_;
  const Scene& scene_;
  int64_t values_left_ = kMostValues;  // of ranges
  std::set<std::string> used_;
};

}  // namespace

std::vector<SweepBlock> ParseSweep(const std::string& text, const Scene& scene) {
  return SpecParser(text, scene).Parse();
}

}  // namespace saltus
