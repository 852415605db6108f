#include "output/page.h"

#include <glog/logging.h>

#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>

#include "base/file.h"
#include "base/interrupt.h"

namespace saltus {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kMostItems = 1000;  // of a list of results

// Returns the document with long lists thinned: lists beyond kMostItems keep every n-th, {"every": n, "items": [...]}.
Json Thinned(const Json& value) {
  if (!value.is_structured()) return value;
  if (value.is_array() && value.size() > kMostItems) {
    const std::size_t every = (value.size() + kMostItems - 1) / kMostItems;
    Json items = Json::array();
    for (std::size_t i = 0; i < value.size(); i += every) items.push_back(Thinned(value[i]));
    return {{"every", every}, {"items", std::move(items)}};
  }
  Json thinned = value.is_array() ? Json::array() : Json::object();
  if (value.is_object()) thinned.get_ref<Json::object_t&>().reserve(value.size());
  for (const auto& [key, item] : value.items()) {
    if (value.is_array()) {
      thinned.push_back(Thinned(item));
    } else {
      thinned.get_ref<Json::object_t&>().emplace_back(key, Thinned(item));
    }
  }
  return thinned;
}

Json TableToJson(const Table& table) {
  Json columns = Json::array(), rows = Json::array();
  const std::vector<std::size_t> shown = table.ColumnsWithContent();
  for (const std::size_t j : shown) {
    columns.push_back({{"header", table.columns()[j].header}, {"number", table.IsNumeric(j)}});
  }
  for (std::size_t i = 0; i < table.rows().size(); ++i) {
    Json row = Json::array();
    for (const std::size_t j : shown) {
      const Tone tone = table.rows()[i][j].tone();
      Json text = table.Display(i, j);
      row.push_back(tone == Tone::kPlain ? text : Json::array({text, ToneName(tone)}));
    }
    rows.push_back(std::move(row));
  }
  return {{"keys", table.keys()}, {"columns", std::move(columns)}, {"rows", std::move(rows)}};
}

}  // namespace

Page::Page(std::string title, std::string subtitle)
    : document_({{"title", std::move(title)}, {"subtitle", std::move(subtitle)}, {"parts", Json::array()}}) {}

void Page::Add(const char* kind, Json part) {
  part["kind"] = kind;
  document_["parts"].push_back(std::move(part));
}

void Page::AddList(const std::vector<std::string>& items) {
  std::vector<Moment> notes;
  for (const std::string& item : items) notes.push_back({.text = item, .motion = ""});
  AddMoments(notes);
}

void Page::AddMoments(const std::vector<Moment>& moments) {
  Json list = Json::array();
  for (const Moment& at : moments) {
    list.push_back({{"text", at.text}});
    if (!at.motion.empty()) list.back().update({{"motion", at.motion}, {"time", at.time}});
  }
  Add("list", {{"items", std::move(list)}});
}

void Page::AddTiles(const std::vector<Tile>& tiles) {
  Json list = Json::array();
  for (const Tile& tile : tiles) {
    list.push_back({{"value", tile.value}, {"label", tile.label}, {"tone", ToneName(tile.tone)}});
  }
  Add("tiles", {{"tiles", std::move(list)}});
}

void Page::AddTable(const Table& table, const std::string& caption, const std::vector<std::string>& notes,
                    bool folded) {
  Json part = {{"table", TableToJson(table)}, {"caption", caption}, {"folded", folded}};
  if (!notes.empty()) part["notes"] = notes;
  Add("table", std::move(part));
}

void Page::AddFigure(const Figure& figure, const std::string& caption) {
  Add("figure", {{"figure", FigureToJson(figure)}, {"caption", caption}});
}

void Page::SetResults(const Json& results) { document_["results"] = Thinned(results); }

void Page::AddStyle(const std::string& label, const std::string& colour, Dash dash) {
  document_["styles"].push_back({{"label", label}, {"colour", colour}, {"dash", dash}});
}

std::string RenderPage(const Json& document) {
  constexpr std::string_view kMark = "<!-- document -->";
  const std::string_view viewer = internal::Viewer();
  const std::size_t at = viewer.find(kMark);
  std::string html(viewer.substr(0, at));
  // The character < is escaped, so that nothing in the document can end its HTML element.
  for (const char c : document.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    if (c == '<') {
      html += "\\u003c";
    } else {
      html += c;
    }
  }
  return html.append(viewer.substr(at + kMark.size()));
}

Status Page::Write(const std::string& path) const { return WriteFile(path, Render(), InterruptGuard::Interrupted); }

namespace {

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
    if (!value.is_structured()) {
      Scalar(value);
      return text_.size() <= limit;
    }
    text_ += value.is_object() ? '{' : '[';
    const char* separator = "";
    for (const auto& child : value.items()) {
      text_ += separator;
      if (value.is_object()) Label(child.key());
      if (!AppendUpTo(limit, child.value())) return false;
      separator = ", ";
    }
    text_ += value.is_object() ? '}' : ']';
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
