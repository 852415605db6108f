#include "output/html_report.h"

#include <glog/logging.h>

#include <algorithm>
#include <cctype>
#include <utility>

#include "base/file.h"
#include "base/interrupt.h"
#include "output/figure_text.h"
#include "output/replay_page.h"
#include "output/report_style.h"

namespace saltus {
namespace {

// Rows from which on a table scrolls in the page, and on a narrow screen; lines from which on a text is folded.
constexpr size_t kTallTable = 40, kTallNarrowTable = 10;
constexpr int kTallText = 100;

// Escaped text with `code` set as such; a backquote without a partner stays one.
std::string Inline(std::string_view text) {
  std::string html;
  while (true) {
    const size_t open = text.find('`');
    const size_t close = open == std::string_view::npos ? open : text.find('`', open + 1);
    if (close == std::string_view::npos) return html + EscapeHtml(text);
    html += EscapeHtml(text.substr(0, open));
    html += "<code>" + EscapeHtml(text.substr(open + 1, close - open - 1)) + "</code>";
    text.remove_prefix(close + 1);
  }
}

// "Two balls, 0.1" as "two-balls-0-1".
std::string Slug(std::string_view text) {
  std::string slug;
  for (const char c : text) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      slug += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else if (!slug.empty() && slug.back() != '-') {
      slug += '-';
    }
  }
  return slug;
}

// No other scheme (such as javascript:) belongs in a report.
bool IsSafeTarget(std::string_view target) {
  if (target.starts_with("http://") || target.starts_with("https://")) return true;
  return target.substr(0, target.find('/')).find(':') == std::string_view::npos;
}

std::string ToneClass(Tone tone) {
  const std::string name(ToneName(tone));
  return name.empty() ? "" : " " + name;
}

}  // namespace

HtmlReport::HtmlReport(std::string title, std::string subtitle)
    : title_(std::move(title)), subtitle_(std::move(subtitle)) {}

void HtmlReport::AddHeading(int level, std::string_view text) {
  CHECK(level == 1 || level == 2) << level;
  // The number makes equal headings distinct.
  const std::string id = "s" + std::to_string(sections_.size() + 1) + "-" + Slug(text);
  const std::string tag = "h" + std::to_string(level + 1);
  sections_.push_back({level, std::string(text), id});
  body_ += "<" + tag + " id=\"" + id + "\"><a href=\"#" + id + "\">" + Inline(text) + "</a></" + tag + ">\n";
}

void HtmlReport::AddParagraph(std::string_view text) { body_ += "<p>" + Inline(text) + "</p>\n"; }

void HtmlReport::AddList(const std::vector<std::string>& items) {
  body_ += "<ul>\n";
  for (const std::string& item : items) body_ += "<li>" + Inline(item) + "</li>\n";
  body_ += "</ul>\n";
}

void HtmlReport::AddPreformatted(std::string_view text) { body_ += "<pre>" + EscapeHtml(text) + "</pre>\n"; }

void HtmlReport::AddTiles(const std::vector<Tile>& tiles) {
  body_ += "<dl class=\"tiles\">\n";
  for (const Tile& tile : tiles) {
    body_ += "<div class=\"tile" + ToneClass(tile.tone) + "\"><dt>" + Inline(tile.label) + "</dt><dd>" +
             EscapeHtml(tile.value) + "</dd></div>\n";
  }
  body_ += "</dl>\n";
}

void HtmlReport::AddLinks(const std::vector<Link>& links) {
  body_ += "<p class=\"links\">";
  for (const Link& link : links) {
    CHECK(IsSafeTarget(link.target)) << link.target;
    body_ += "<a href=\"" + EscapeHtml(link.target) + "\">" + Inline(link.label) + "</a> ";
  }
  body_ += "</p>\n";
}

void HtmlReport::AddTable(const Table& table, std::string_view caption, bool folded) {
  const size_t rows = table.rows().size();
  const std::string tall = rows > kTallTable ? " tall" : rows > kTallNarrowTable ? " rather-tall" : "";
  const std::string scroll = "<div class=\"scroll" + tall + "\" tabindex=\"0\">" + table.ToHtml() + "</div>";
  AddFigureElement("Table", ++tables_, caption, scroll, folded);
}

Status HtmlReport::AddFigure(const Figure& figure, std::string_view caption, bool folded) {
  const StatusOr<DrawnFigure> drawn = DrawnFigure::Draw(figure);
  if (!drawn.ok()) return drawn.status();
  AddFigure(*drawn, caption, folded);
  return Status();
}

void HtmlReport::AddFigure(const DrawnFigure& drawn, std::string_view caption, bool folded) {
  const std::string id = "figure" + std::to_string(figures_ + 1);
  std::string plot = "<div class=\"plot\">" + drawn.Svg(id) + "</div>";
  const std::string parts = internal::FigureParts(drawn.figure(), id);
  if (!parts.empty()) plot = "<div class=\"plots\">" + plot + "<div class=\"plot parts\">" + parts + "</div></div>";
  AddFigureElement("Figure", ++figures_, caption, plot, folded);
}

void HtmlReport::AddReplay(const Replay& replay, std::string_view caption) {
  const std::string label = "Figure " + std::to_string(++figures_);
  replays_ = true;
  body_ += "<figure class=\"replay\" id=\"" + Slug(label) + "\">\n" + ReplayContent(replay) + "\n<figcaption><b>" +
           label + ".</b> " + Inline(caption) + "</figcaption>\n</figure>\n";
}

void HtmlReport::AddFigureElement(const std::string& kind, int number, std::string_view caption,
                                  const std::string& content, bool folded) {
  const std::string label = kind + " " + std::to_string(number);
  const std::string text = "<b>" + label + ".</b> " + Inline(caption);
  const std::string open = "<figure id=\"" + Slug(label) + "\">\n";
  if (folded) {
    body_ += open + "<details><summary>" + text + "</summary>\n" + content + "\n</details>\n</figure>\n";
  } else {
    // Captions stand where they are read first: above a table, which may be long, and below a figure.
    const std::string figcaption = "<figcaption>" + text + "</figcaption>\n";
    body_ += open + (kind == "Table" ? figcaption + content + "\n" : content + "\n" + figcaption) + "</figure>\n";
  }
}

std::string HtmlReport::Render() const {
  std::string contents;
  for (const Section& section : sections_) {
    contents += "<li class=\"level" + std::to_string(section.level) + "\"><a href=\"#" + section.id + "\">" +
                Inline(section.text) + "</a></li>\n";
  }
  std::string html = "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n";
  html += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
  html += "<meta name=\"color-scheme\" content=\"light dark\">\n";
  html += "<link rel=\"icon\" href=\"data:,\">\n";  // or browsers ask for /favicon.ico
  html += "<title>" + EscapeHtml(title_) + "</title>\n<style>\n" + internal::ReportStyle() +
          (replays_ ? std::string(internal::ReplayStyle()) : "") + "</style>\n</head>\n<body>\n";
  if (!contents.empty())
    html += "<nav aria-label=\"Contents\">\n<details open><summary>Contents</summary>\n<ol>\n" + contents +
            "</ol>\n</details>\n</nav>\n";
  html += "<main>\n<header>\n<h1>" + EscapeHtml(title_) + "</h1>\n";
  if (!subtitle_.empty()) html += "<p class=\"subtitle\">" + Inline(subtitle_) + "</p>\n";
  html += "</header>\n" + body_ + "</main>\n";
  if (replays_)
    html += "<script>\n'use strict';\n(() => {\n" + std::string(internal::ReplayScript()) + "})();\n</script>\n";
  return html + "</body>\n</html>\n";
}

Status HtmlReport::Write(const std::string& path) const {
  return WriteFile(path, Render(), InterruptGuard::Interrupted);
}

}  // namespace saltus
