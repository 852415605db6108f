#include "output/figure.h"

#include <glog/logging.h>

#include <array>
#include <cctype>
#include <cstdio>
#include <filesystem>
#include <utility>

#include "base/file.h"
#include "base/interrupt.h"
#include "output/drawn_figure.h"
#include "output/figure_script.h"
#include "output/figure_text.h"
#include "output/gnuplot.h"
#include "output/table.h"

namespace saltus {
namespace {

// Replaces within the tags, not in the text between them (where gnuplot writes '<' as an entity).
std::string ReplaceInTags(const std::string& svg,
                          const std::vector<std::pair<std::string, std::string>>& replacements) {
  std::string result;
  bool in_tag = false;
  for (size_t i = 0; i < svg.size();) {
    if (svg[i] == '<') in_tag = true;
    if (svg[i] == '>') in_tag = false;
    const std::pair<std::string, std::string>* found = nullptr;
    for (const auto& replacement : replacements) {
      if (in_tag && svg.compare(i, replacement.first.size(), replacement.first) == 0) found = &replacement;
    }
    result += found != nullptr ? found->second : std::string(1, svg[i]);
    i += found != nullptr ? found->first.size() : 1;
  }
  return result;
}

// gnuplot spells a colour in three ways, all of the form "rgb(18, 52, 86)"; "#123456" is shorter and always the same.
std::string HexColours(const std::string& svg) {
  constexpr std::string_view kStart = "rgb(";
  std::string result;
  size_t at = 0;
  for (size_t found = 0; (found = svg.find(kStart, at)) != std::string::npos;) {
    result.append(svg, at, found - at);
    unsigned red = 0;
    unsigned green = 0;
    unsigned blue = 0;
    int length = 0;
    const std::string colour = svg.substr(found, 24);  // sscanf looks for the end of its string
    if (std::sscanf(colour.c_str(), "rgb(%3u ,%3u ,%3u )%n", &red, &green, &blue, &length) == 3 && length > 0) {
      std::array<char, 8> hex;
      std::snprintf(hex.data(), hex.size(), "#%02x%02x%02x", red & 0xff, green & 0xff, blue & 0xff);
      result += hex.data();
    } else {
      length = kStart.size();
      result += kStart;
    }
    at = found + static_cast<size_t>(length);
  }
  return result.append(svg, at);
}

// From the first `begin` to the end of the first `end`, or nothing.
void ReplaceSpan(std::string_view begin, std::string_view end, const std::string& by, std::string* text) {
  const size_t from = text->find(begin);
  const size_t to = from == std::string::npos ? from : text->find(end, from);
  if (to != std::string::npos) text->replace(from, to + end.size() - from, by);
}

std::string Title(const Figure& figure) { return figure.title.empty() ? figure.panels.front().title : figure.title; }

// Gives gnuplot's SVG unique ids, a title and a text of its own, fonts that every machine has and markers that are not
// too thin.
std::string Finish(std::string svg, const Figure& figure, const std::string& prefix) {
  svg.erase(0, svg.find("<svg"));
  const std::string title = Title(figure);
  const std::string element = title.empty() ? "" : "<title>" + EscapeHtml(title) + "</title>";
  ReplaceSpan("<title>Gnuplot</title>", "</desc>", element, &svg);
  const std::string text = " role=\"img\" aria-label=\"" + EscapeHtml(internal::DescribeFigure(figure)) + "\"";
  svg.insert(std::string_view("<svg").size(), text);
  const std::string id = prefix + "-";
  const std::string font = std::string("font-family=\"") + internal::kFont;
  const std::string fonts = font + ", Arial, Helvetica, sans-serif\"";
  return ReplaceInTags(HexColours(svg),
                       {{" id='", " id='" + id},
                        {" id=\"", " id=\"" + id},
                        {"href='#", "href='#" + id},
                        {"href=\"#", "href=\"#" + id},
                        {"url(#", "url(#" + id},
                        {"stroke-width='0.205'", "stroke-width='0.35'"},
                        {font + ":Bold\"", fonts + " font-weight=\"bold\""},
                        {font + "\"", fonts}});
}

std::string IdFromPath(const std::string& path) {
  std::string id = std::filesystem::path(path).stem().string();
  for (char& c : id) {
    if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '-';
  }
  return "figure-" + id;
}

}  // namespace

Series Series::ForModel(std::string_view model, std::vector<double> x, std::vector<double> y) {
  const ModelStyle& style = StyleOf(model);
  Series series;
  series.label = std::string(model);
  series.x = std::move(x);
  series.y = std::move(y);
  series.colour = std::string(style.colour);
  series.dash = style.dash;
  series.marker = style.marker;
  return series;
}

StatusOr<DrawnFigure> DrawnFigure::Draw(const Figure& figure, const std::string& gnuplot) {
  StatusOr<std::string> svg = internal::RunGnuplot(gnuplot, internal::GnuplotScript(figure, internal::Terminal::kSvg));
  if (!svg.ok()) return svg.status();
  DrawnFigure drawn;
  drawn.figure_ = figure;
  drawn.svg_ = std::move(*svg);
  return drawn;
}

std::string DrawnFigure::Svg(std::string_view id_prefix) const {
  for (const char c : id_prefix) {
    CHECK(std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-' || c == '_')
        << "id prefix '" << id_prefix << "'";
  }
  return Finish(svg_, figure_, std::string(id_prefix));
}

Status DrawnFigure::WriteSvg(const std::string& path) const {
  return WriteFile(path, Svg(IdFromPath(path)), InterruptGuard::Interrupted);
}

StatusOr<std::string> RenderSvg(const Figure& figure, std::string_view id_prefix, const std::string& gnuplot) {
  const StatusOr<DrawnFigure> drawn = DrawnFigure::Draw(figure, gnuplot);
  if (!drawn.ok()) return drawn.status();
  return drawn->Svg(id_prefix);
}

StatusOr<std::string> RenderPng(const Figure& figure, const std::string& gnuplot) {
  return internal::RunGnuplot(gnuplot, internal::GnuplotScript(figure, internal::Terminal::kPng));
}

Status WriteFigure(const Figure& figure, const std::string& svg_path, const std::string& png_path) {
  if (!svg_path.empty()) {
    const StatusOr<DrawnFigure> drawn = DrawnFigure::Draw(figure);
    if (!drawn.ok()) return drawn.status();
    const Status written = drawn->WriteSvg(svg_path);
    if (!written.ok()) return written;
  }
  if (png_path.empty()) return Status();
  const StatusOr<std::string> png = RenderPng(figure);
  if (!png.ok()) return png.status();
  return WriteFile(png_path, *png, InterruptGuard::Interrupted);
}

}  // namespace saltus
