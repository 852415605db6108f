#include "output/page.h"

#include <glog/logging.h>

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "base/file.h"
#include "base/interrupt.h"
#include "base/number_text.h"

namespace saltus {

namespace {

constexpr std::size_t kMostItems = 1000;  // of a list of results

// Thins long lists: those beyond kMostItems keep every n-th item, {"every": n, "items": [...]}.
void Thin(Json* json) {
  if (!json->is_structured()) return;
  if (json->is_array() && json->size() > kMostItems) {
    const std::size_t every = (json->size() + kMostItems - 1) / kMostItems;
    Json items = Json::array();
    for (std::size_t i = 0; i < json->size(); i += every) items.push_back(std::move((*json)[i]));
    *json = {{"every", every}, {"items", std::move(items)}};
  }
  for (Json& item : *json) Thin(&item);
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

void Page::SetResults(Json results) {
  Thin(&results);
  SetWholeResults(std::move(results));
}

void Page::AddStyle(const std::string& label, const std::string& colour, Dash dash) {
  document_["styles"].push_back({{"label", label}, {"colour", colour}, {"dash", dash}});
}

std::string Page::Render() const {
  constexpr std::string_view kMark = "<!-- document -->";
  const std::string_view viewer = internal::Viewer();
  const std::size_t at = viewer.find(kMark);
  std::string html(viewer.substr(0, at));
  // The character < is escaped, so that nothing in the document can end its HTML element.
  for (const char c : document_.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    if (c == '<') {
      html += "\\u003c";
    } else {
      html += c;
    }
  }
  return html.append(viewer.substr(at + kMark.size()));
}

Status Page::Write(const std::string& path) const { return WriteFile(path, Render(), InterruptGuard::Interrupted); }

void Round(int significant_digits, Json* json) {
  if (json->is_number_float()) {
    const double value = json->get<double>();
    *json = std::isfinite(value) ? Json(RoundedTo(significant_digits, value)) : Json();
  }
  if (!json->is_structured()) return;
  for (Json& item : *json) Round(significant_digits, &item);
}

namespace {

constexpr size_t kColumns = 120;
constexpr size_t kIndent = 2;

std::string Scalar(const Json& value, int significant_digits) {
  if (!value.is_number_float() || !std::isfinite(value.get<double>())) {
    return value.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  std::array<char, 40> buffer;
  const auto [end, error] = std::to_chars(buffer.data(),
                                          buffer.data() + buffer.size(),
                                          value.get<double>(),
                                          std::chars_format::general,
                                          significant_digits);
  CHECK(error == std::errc());
  std::string text(buffer.data(), end);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";
  return text;
}

// Returns "key": of an item of an object; empty for an item of an array.
std::string Label(const Json& parent, Json::const_iterator item) {
  return parent.is_object() ? Scalar(item.key(), kDoubleDigits) + ": " : "";
}

// Returns the value on one line; empty if it takes more than `room` columns.
std::string OneLine(const Json& value, int significant_digits, size_t room) {
  std::string text = value.is_object() ? "{" : value.is_array() ? "[" : Scalar(value, significant_digits);
  for (auto item = value.begin(); value.is_structured() && item != value.end(); ++item) {
    text += (item == value.begin() ? "" : ", ") + Label(value, item);
    const std::string part = text.size() < room ? OneLine(*item, significant_digits, room - text.size()) : "";
    if (part.empty()) return "";
    text += part;
  }
  if (value.is_structured()) text += value.is_object() ? '}' : ']';
  return text.size() <= room ? text : "";
}

// Returns a value that does not fit on one line, of which the first line is indented by `depth` levels. Entries of an
// array that fit on one line share lines, as words in a paragraph, if they are numbers or short arrays.
std::string Lines(const Json& value, int significant_digits, size_t depth) {
  if (!value.is_structured() || value.empty()) return Scalar(value, significant_digits);
  const std::string indent((depth + 1) * kIndent, ' ');
  std::string text(1, value.is_object() ? '{' : '[');
  size_t column = kColumns;
  for (auto item = value.begin(); item != value.end(); ++item) {
    if (item != value.begin()) text += ',';
    const std::string label = Label(value, item);
    const size_t used = indent.size() + label.size() + 1;  // with a comma
    const std::string line = used < kColumns ? OneLine(*item, significant_digits, kColumns - used) : "";
    const bool fills = value.is_array() && !line.empty() && !item->is_object();
    if (fills && column + 2 + line.size() < kColumns) {
      text += ' ';
      column += 2 + line.size();
    } else {
      text += '\n' + indent + label;
      column = fills ? indent.size() + line.size() : kColumns;
    }
    text += line.empty() ? Lines(*item, significant_digits, depth + 1) : line;
  }
  return text + '\n' + std::string(depth * kIndent, ' ') + (value.is_object() ? '}' : ']');
}

}  // namespace

std::string DumpJson(const nlohmann::ordered_json& document, int significant_digits) {
  CHECK(1 <= significant_digits && significant_digits <= kDoubleDigits) << significant_digits;
  const std::string line = document.is_object() ? "" : OneLine(document, significant_digits, kColumns - 1);
  return (line.empty() ? Lines(document, significant_digits, 0) : line) + "\n";
}

}  // namespace saltus
