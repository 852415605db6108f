// A report as one HTML file that needs nothing else: style and figures inside, no network, and no script but that of
// replays.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "base/status.h"
#include "output/drawn_figure.h"
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

struct Link {
  std::string label;
  std::string target;  // a path relative to the report, or an http(s) address
};

// Collects the parts in order. All text is taken literally, except that `words between backquotes` are set as code.
class HtmlReport {
 public:
  // `subtitle` may be empty.
  HtmlReport(std::string title, std::string subtitle);

  // Opens a section of level 1 or 2, which the table of contents lists.
  void AddHeading(int level, std::string_view text);

  void AddParagraph(std::string_view text);
  void AddList(const std::vector<std::string>& items);
  void AddPreformatted(std::string_view text);
  void AddTiles(const std::vector<Tile>& tiles);

  // Precondition: targets are as Link says.
  void AddLinks(const std::vector<Link>& links);

  // Tables and figures are numbered. Long tables scroll under their header line; in what is too narrow for
  // a table its rows are cards. A folded part shows its caption only, until opened.
  void AddTable(const Table& table, std::string_view caption, bool folded = false);

  // Draws the figure; an error if gnuplot is missing or fails, and the report is then as it was.
  Status AddFigure(const Figure& figure, std::string_view caption, bool folded = false);
  void AddFigure(const DrawnFigure& figure, std::string_view caption, bool folded = false);

  // Numbered as a figure.
  void AddReplay(const Replay& replay, std::string_view caption);

  // The whole document.
  std::string Render() const;

  // Replaces the file at `path`.
  Status Write(const std::string& path) const;

 private:
  struct Section {
    int level;
    std::string text;
    std::string id;
  };

  void AddFigureElement(const std::string& kind, int number, std::string_view caption, const std::string& content,
                        bool folded);

  std::string title_;
  std::string subtitle_;
  std::vector<Section> sections_;
  int tables_ = 0;
  int figures_ = 0;
  bool replays_ = false;
  std::string body_;
};

}  // namespace saltus
