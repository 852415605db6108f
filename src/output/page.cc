#include "output/page.h"

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

}  // namespace saltus
