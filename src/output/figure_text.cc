#include "output/figure_text.h"

#include <cmath>
#include <set>

#include "output/figure_layout.h"
#include "output/table.h"

namespace saltus::internal {
namespace {

constexpr size_t kMostSeries = 8;  // of a panel, in words

std::string Words(double value) { return Format("%.3g", value); }

bool IsFinite(const Series& series, size_t i) { return std::isfinite(series.x[i]) && std::isfinite(series.y[i]); }

// "lcp from (0, 3) to (2, 1)"
std::string DescribeSeries(const Series& series) {
  size_t first = 0, last = series.x.size();
  while (first < last && !IsFinite(series, first)) ++first;
  while (last > first && !IsFinite(series, last - 1)) --last;
  if (first == last) return series.label + " has no points";
  const auto point = [&](size_t i) { return "(" + Words(series.x[i]) + ", " + Words(series.y[i]) + ")"; };
  return series.label + " from " + point(first) + " to " + point(last - 1);
}

std::string DescribePanel(const Panel& panel) {
  std::string text = panel.title.empty() ? "" : panel.title + ": ";
  text += panel.y.label + " against " + panel.x.label;
  std::set<std::string> named = {""};
  for (const Series& series : panel.series) {
    if (!named.insert(series.label).second) continue;
    if (named.size() <= kMostSeries + 1) text += (named.size() == 2 ? "; " : ", ") + DescribeSeries(series);
  }
  if (named.size() > kMostSeries + 1) text += ", and " + std::to_string(named.size() - kMostSeries - 1) + " more";
  for (const ReferenceLine& line : panel.reference_lines) {
    if (named.insert(line.label).second) text += ", " + line.label + " at " + Words(line.value);
  }
  return text + ".";
}

std::string Pixels(double value) { return Format("%.1f", value); }

constexpr double kMargin = 8;  // pixels, on the right of what is viewed: lines of the neighbour begin there

// A view of a part of the figure; `attributes` end its tag.
std::string View(const Box& box, double height, const std::string& id, const std::string& attributes) {
  const double width = box.right - box.left - kMargin;
  return "<svg viewBox=\"" + Pixels(box.left) + " " + Pixels(height - box.top) + " " + Pixels(width) + " " +
         Pixels(box.top - box.bottom) + "\" " + attributes + "><use href=\"#" + id + "\"/></svg>\n";
}

}  // namespace

std::string DescribeFigure(const Figure& figure) {
  std::string text = figure.title.empty() ? "" : figure.title + ".";
  for (const Panel& panel : figure.panels) text += (text.empty() ? "" : " ") + DescribePanel(panel);
  return text;
}

std::string FigureParts(const Figure& figure, const std::string& id_prefix) {
  const Layout layout = LayOut(figure);
  if (layout.panels.size() + static_cast<size_t>(layout.legend_columns) < 2) return "";
  const std::string id = id_prefix + "-gnuplot_canvas";
  std::string parts;
  for (const Box& panel : layout.panels) {
    const bool first = &panel == &layout.panels.front();
    parts +=
        View(panel,
             layout.height,
             id,
             first ? "role=\"img\" aria-label=\"" + EscapeHtml(DescribeFigure(figure)) + "\"" : "aria-hidden=\"true\"");
  }
  const Box& legend = layout.legend;
  const double width = layout.legend_columns > 0 ? (legend.right - legend.left) / layout.legend_columns : 0;
  for (int i = 0; i < layout.legend_columns; ++i) {
    const Box column = {legend.left + i * width, legend.left + (i + 1) * width, legend.bottom, legend.top};
    parts += View(column,
                  layout.height,
                  id,
                  "class=\"legend\" style=\"width: " + Pixels(width - kMargin) + "px\" aria-hidden=\"true\"");
  }
  return parts;
}

}  // namespace saltus::internal
