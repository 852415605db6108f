// A page: one HTML file that needs nothing else, which holds a document and the viewer (src/output/page) that draws it.
//
// The document is JSON: {"title", "subtitle", "results", "styles", "parts": [{"kind", ...}, ...]}. `results` is what a
// program prints with --json, its long lists of numbers thinned; the parts say what is shown, in which order.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "base/status.h"
#include "output/figure.h"
#include "output/replay.h"
#include "output/table.h"

namespace saltus {

// One number that matters, shown large.
struct Tile {
  std::string value;
  std::string label;
  Tone tone = Tone::kPlain;
};

// The file with any document that the viewer knows: one with parts, or that of a hybrid system's program.
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
  void AddList(const std::vector<std::string>& items);
  // Items that the first replay of the page shows: the motion of a label at a time, s. No label: as in a list.
  struct Moment {
    std::string text, motion;
    double time = 0;
  };
  void AddMoments(const std::vector<Moment>& moments);
  void AddTiles(const std::vector<Tile>& tiles);
  // Links to files beside the page.
  void AddLinks(const std::vector<std::string>& files) { Add("links", {{"files", files}}); }

  // Tables and figures are numbered. `notes` stand numbered below the table. A folded table shows its caption only,
  // until opened.
  void AddTable(const Table& table, const std::string& caption, const std::vector<std::string>& notes = {},
                bool folded = false);
  void AddTableIfAny(const Table& table, const std::string& caption) {
    if (!table.rows().empty()) AddTable(table, caption);
  }
  void AddFigure(const Figure& figure, const std::string& caption);
  void AddReplay(const Replay& replay, const std::string& caption);
  // A figure that the viewer makes from the results: a key of PLOTS in page/plot.js. Left out if there is no data.
  void AddPlot(const std::string& plot, const std::string& caption) {
    Add("plot", {{"plot", plot}, {"caption", caption}});
  }

  void SetResults(const nlohmann::ordered_json& results);
  // How each run of the results looks in plots, in their order.
  void AddStyle(const std::string& label, const std::string& colour, Dash dash);

  std::string Render() const { return RenderPage(document_); }
  Status Write(const std::string& path) const;

 private:
  void Add(const char* kind, nlohmann::ordered_json part);

  nlohmann::ordered_json document_;
};

namespace internal {

// The file, with a mark where the document goes.
std::string_view Viewer();

}  // namespace internal
}  // namespace saltus
