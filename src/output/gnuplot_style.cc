#include "output/gnuplot_style.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

namespace saltus::internal {
namespace {

// Lines end in half discs, which lengthen every dash by the width of the line.
std::string DashType(Dash dash) {
  switch (dash) {
    case Dash::kSolid:
      return " dt solid";
    case Dash::kDashed:
      return " dt (5,5)";
    case Dash::kDotted:
      return " dt (0.5,4)";
    case Dash::kDashDotted:
      return " dt (8,4,0.5,4)";
  }
  return "";
}

// gnuplot's number of a marker, and the sizes that make all markers look equally large.
struct PointType {
  int type;
  double png_size;
  double svg_size;
};

PointType TypeOf(Marker marker) {
  switch (marker) {
    case Marker::kNone:
      return {0, 0, 0};
    case Marker::kCircle:
      return {7, 0.62, 0.56};
    case Marker::kSquare:
      return {5, 0.58, 0.5};
    case Marker::kTriangle:
      return {9, 0.75, 0.52};
    case Marker::kTriangleDown:
      return {11, 0.75, 0.52};
    case Marker::kDiamond:
      return {13, 0.78, 0.46};
    case Marker::kOpenCircle:
      return {6, 0.68, 0.6};
    case Marker::kOpenSquare:
      return {4, 0.62, 0.52};
    case Marker::kCross:
      return {2, 0.62, 0.58};
  }
  return {0, 0, 0};
}

}  // namespace

std::string Number(double value) {
  if (!std::isfinite(value)) return "NaN";
  std::array<char, 40> buffer;
  return std::string(buffer.data(), std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr);
}

// Single quotes take everything literally but themselves and line ends.
std::string Quote(std::string_view text) {
  std::string quoted = "'";
  for (const char c : text) {
    const bool control = static_cast<unsigned char>(c) < 0x20;
    quoted += control ? std::string(" ") : c == '\'' ? std::string("''") : std::string(1, c);
  }
  return quoted + "'";
}

std::string Colour(std::string_view colour) { return " lc rgb " + Quote(colour); }

std::string Font(double size, bool bold) {
  return " font " + Quote(std::string(kFont) + (bold ? ":Bold," : ",") + Number(size));
}

std::string LineStyle(double width, Dash dash, std::string_view colour) {
  return " lw " + Number(width) + DashType(dash) + Colour(colour);
}

std::string MarkStyle(Marker marker, std::string_view colour, Terminal terminal) {
  const PointType point = TypeOf(marker);
  const double size = terminal == Terminal::kSvg ? point.svg_size : point.png_size;
  return " lw 1.2 pt " + std::to_string(point.type) + " ps " + Number(size) + Colour(colour);
}

std::vector<LegendEntry> LegendEntries(const Figure& figure, Terminal terminal) {
  std::vector<LegendEntry> entries;
  const auto add = [&](LegendEntry entry) {
    const bool known =
        std::any_of(entries.begin(), entries.end(), [&](const auto& e) { return e.label == entry.label; });
    if (!entry.label.empty() && !known) entries.push_back(std::move(entry));
  };
  for (const Panel& panel : figure.panels) {
    for (const Series& series : panel.series) {
      const bool marks = series.marker != Marker::kNone;
      add({series.label,
           series.line ? LineStyle(series.width, series.dash, series.colour) : "",
           marks ? MarkStyle(series.marker, series.colour, terminal) : ""});
    }
    for (const ReferenceLine& line : panel.reference_lines) {
      add({line.label, LineStyle(kReferenceWidth, line.dash, line.colour), ""});
    }
  }
  return entries;
}

}  // namespace saltus::internal
