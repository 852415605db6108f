// A page: one self-contained HTML file with a document and the viewer (src/output/page) that draws it.
//
// The document is JSON: {"title", "subtitle", "results", "styles", "parts": [{"kind", ...}, ...]}. `results` is what a
// program prints with --json, its long lists of numbers thinned; the parts state what is shown, in which order.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "base/status.h"
#include "base/table.h"
#include "output/figure.h"
#include "output/json.h"

namespace saltus {

// A tile: one important number, shown large.
struct Tile {
  std::string value;
  std::string label;
  Tone tone = Tone::kPlain;
};

// A table with the name of its files and its caption, a sentence without its full stop.
struct CaptionedTable {
  std::string name;
  std::string caption;
  Table table;
};

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
  void AddReplay(Json replay, const std::string& caption) {
    Add("replay", {{"replay", std::move(replay)}, {"caption", caption}});
  }
  // Adds a figure that the viewer makes from the results and `more`: a key of PLOTS in page/plot.js. Omitted if it has
  // no data.
  void AddPlot(const std::string& plot, const std::string& caption, Json more = Json::object()) {
    Add("plot", {{"plot", plot}, {"caption", caption}, {"more", std::move(more)}});
  }

  // Adds the replay and the figure of a motion in the results of a hybrid system: that of the run with this number, or
  // of the initial guess if it is null.
  void AddMotion(Json run) { Add("motion", {{"run", std::move(run)}}); }

  void SetResults(Json results);
  // Sets the results without thinning their lists.
  void SetWholeResults(Json results) { document_["results"] = std::move(results); }
  // Sets the style of each run of the results in plots, in their order.
  void AddStyle(const std::string& label, const std::string& colour, Dash dash);

  // Returns the file.
  std::string Render() const;
  Status Write(const std::string& path) const;

 private:
  void Add(const char* kind, Json part);

  Json document_;
};

namespace internal {

// Returns the viewer's file, with a mark in the place of the document.
std::string_view Viewer();

}  // namespace internal

}  // namespace saltus
