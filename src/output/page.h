// A page: one self-contained HTML file with a document and the viewer (src/output/page) that draws it.
//
// The document is JSON: {"title", "subtitle", "results", "styles", "parts": [{"kind", ...}, ...]}. `results` is what a
// program prints with --json, its long lists of numbers thinned; the parts state what is shown, in which order.
#pragma once

#include <nlohmann/json.hpp>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "base/status.h"
#include "base/table.h"
#include "output/figure.h"

namespace saltus {

// A tile: one important number, shown large.
struct Tile {
  std::string value;
  std::string label;
  Tone tone = Tone::kPlain;
};

// Returns the file with any document that the viewer supports: one with parts, or that of a hybrid system's program.
std::string RenderPage(const nlohmann::ordered_json& document);

// Collects the parts in order. All text is taken literally, except that `words between backquotes` are set as code.
class Page {
 public:
  // `subtitle` may be empty.
  explicit Page(std::string title, std::string subtitle = "");

  // Opens a section, which the table of contents lists.
  void AddHeading(const std::string& text) { Add("heading", {{"text", text}}); }
  void AddParagraph(const std::string& text) { Add("text", {{"text", text}}); }
  void AddPreformatted(const std::string& text) { Add("code", {{"text", text}}); }
  // An item of a list; with a label the moment of a motion, s, which the first replay of the page then shows.
  struct Moment {
    std::string text, motion;
    double time = 0;
  };
  void AddMoments(const std::vector<Moment>& moments);
  void AddList(const std::vector<std::string>& items);
  void AddTiles(const std::vector<Tile>& tiles);
  // Adds links to files beside the page.
  void AddLinks(const std::vector<std::string>& files) { Add("links", {{"files", files}}); }

  // Adds a table; tables and figures are numbered. `notes` are listed below it. A folded table shows its caption only,
  // until it is opened.
  void AddTable(const Table& table, const std::string& caption, const std::vector<std::string>& notes = {},
                bool folded = false);
  void AddTableIfAny(const Table& table, const std::string& caption) {
    if (!table.rows().empty()) AddTable(table, caption);
  }
  void AddFigure(const Figure& figure, const std::string& caption);
  // Adds a replay, whose data ReplayToJson() in programs/scene_drawing.h returns.
  void AddReplay(nlohmann::ordered_json replay, const std::string& caption) {
    Add("replay", {{"replay", std::move(replay)}, {"caption", caption}});
  }
  // Adds a figure that the viewer makes from the results: a key of PLOTS in page/plot.js. Omitted if it has no data.
  void AddPlot(const std::string& plot, const std::string& caption) {
    Add("plot", {{"plot", plot}, {"caption", caption}});
  }

  void SetResults(const nlohmann::ordered_json& results);
  // Sets the style of each run of the results in plots, in their order.
  void AddStyle(const std::string& label, const std::string& colour, Dash dash);

  std::string Render() const { return RenderPage(document_); }
  Status Write(const std::string& path) const;

 private:
  void Add(const char* kind, nlohmann::ordered_json part);

  nlohmann::ordered_json document_;
};

namespace internal {

// Returns the viewer's file, with a mark in the place of the document.
std::string_view Viewer();

}  // namespace internal

// JSON documents with a stated number of significant digits, and null in place of NaN and infinity, which JSON does not
// have.

// Numbers of digits after which every double (float) is read back with the same bits.
inline constexpr int kDoubleDigits = 17;
inline constexpr int kFloatDigits = 9;

// The document as text, ending with a newline: two spaces of indentation, short arrays and objects on one line, long
// arrays of numbers filled to 120 columns. Numbers have so many significant digits, e.g. 0.10000000000000001; whole
// ones keep a ".0", so that readers see a floating-point number. Bytes that are not UTF-8 become U+FFFD. Precondition:
// 1 <= significant_digits <= 17.
std::string DumpJson(const nlohmann::ordered_json& document, int significant_digits = kDoubleDigits);

}  // namespace saltus
