#include "output/figure_script.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string_view>

namespace saltus::internal {
namespace {

constexpr double kTitleFontSize = 15;  // pixels, as all that follows
constexpr double kTitleGap = 14;
constexpr double kTickLabelGapX = 18;
constexpr double kTickLabelGapY = 9;
constexpr double kAxisLabelGapX = 40;
constexpr double kAxisLabelGapY = 26;
constexpr double kLegendSample = 36;
constexpr double kSimplifyTolerance = 0.1;
constexpr int kMarksOnALine = 9;
constexpr double kPngScale = 2;

// Points of a panel in pixels, relative to its plot.
class PixelMap {
 public:
  PixelMap(const Panel& panel, const Range& x, const Range& y, const Box& box)
      : log_x_(panel.x.log), log_y_(panel.y.log), x_(x), y_(y), box_(box) {}

  double X(double x) const { return Map(x, log_x_, x_) * (box_.right - box_.left); }
  double Y(double y) const { return Map(y, log_y_, y_) * (box_.top - box_.bottom); }

 private:
  static double Map(double value, bool log, const Range& range) {
    if (log) return (std::log(value) - std::log(range.min)) / (std::log(range.max) - std::log(range.min));
    return (value - range.min) / Span(range);
  }

  bool log_x_;
  bool log_y_;
  Range x_;
  Range y_;
  Box box_;
};

class ScriptWriter {
 public:
  ScriptWriter(const Figure& figure, Terminal terminal)
      : figure_(figure), terminal_(terminal), layout_(LayOut(figure)) {}

  std::string Write() {
    Page();
    for (size_t i = 0; i < figure_.panels.size(); ++i) PanelPlot(figure_.panels[i], layout_.plots[i]);
    if (layout_.legend_columns > 0) LegendPlot();
    Line("unset multiplot");
    return std::move(script_);
  }

 private:
  void Line(const std::string& command) { script_ += command + '\n'; }

  std::string AtScreen(double pixels, double of) const { return " at screen " + Number(pixels / of); }

  void Page() {
    Line("set encoding utf8");
    const std::string font = Font(kFontSize);
    if (terminal_ == Terminal::kSvg) {
      Line("set terminal svg dynamic noenhanced rounded size " + Number(layout_.width) + "," + Number(layout_.height) +
           font + " background " + Quote(kPaper));
    } else {
      const std::string scale = Number(kPngScale);
      // Cairo's font sizes are points of 4/3 pixels.
      const std::string font_scale = Number(0.75 * kPngScale);
      Line("set terminal pngcairo noenhanced rounded size " + Number(kPngScale * layout_.width) + "," +
           Number(kPngScale * layout_.height) + font + " fontscale " + font_scale + " linewidth " + scale +
           " pointscale " + scale + " dashlength " + scale + " background " + Quote(kPaper));
    }
    Line("set multiplot");
    Line("unset key");
    Line("set border 3 lw 1" + Colour(kFaintInk));
    Line("set grid xtics ytics back lt 1 lw 1" + Colour(kGrid));
    Line("set tics nomirror out scale 0.6,0.3 textcolor rgb " + Quote(kInk));
    Text({kTopMargin, layout_.height - 0.6 * kFigureTitle}, figure_.title, "left", kTitleFontSize, /*bold=*/true);
  }

  // Text at a place in pixels.
  void Text(const std::array<double, 2>& at, const std::string& text, const std::string& options,
            double size = kFontSize, bool bold = false) {
    if (text.empty()) return;
    Line("set label " + Quote(text) + " at screen " + Number(at[0] / layout_.width) + ", screen " +
         Number(at[1] / layout_.height) + " " + options + " front textcolor rgb " + Quote(kInk) + Font(size, bold));
  }

  void Margins(const Box& box) {
    Line("set lmargin" + AtScreen(box.left, layout_.width));
    Line("set rmargin" + AtScreen(box.right, layout_.width));
    Line("set bmargin" + AtScreen(box.bottom, layout_.height));
    Line("set tmargin" + AtScreen(box.top, layout_.height));
  }

  // Range, scale and ticks; the labels are set as text, at the same distance in every terminal.
  void AxisCommands(const std::string& name, const Axis& axis, const Range& range, const std::vector<Tick>& ticks) {
    Line("set " + name + "range [" + Number(range.min) + ":" + Number(range.max) + "]");
    Line((axis.log ? "set logscale " : "unset logscale ") + name);
    std::string list;
    for (const Tick& tick : ticks) {
      list += (list.empty() ? "" : ", ") + std::string("'' ") + Number(tick.value) + (tick.label.empty() ? " 1" : "");
    }
    Line("set " + name + "tics (" + list + ")");
  }

  void AxisX(const Axis& axis, const Range& range, const Box& box, const PixelMap& map) {
    const std::vector<Tick> ticks = TicksX(axis, range, box);
    AxisCommands("x", axis, range, ticks);
    for (const Tick& tick : ticks) {
      Text({box.left + map.X(tick.value), box.bottom - kTickLabelGapX}, tick.label, "center");
    }
    Text({(box.left + box.right) / 2, box.bottom - kAxisLabelGapX}, axis.label, "center");
  }

  void AxisY(const Axis& axis, const Range& range, const Box& box, const PixelMap& map) {
    const std::vector<Tick> ticks = TicksY(axis, range, box);
    AxisCommands("y", axis, range, ticks);
    for (const Tick& tick : ticks) {
      Text({box.left - kTickLabelGapY, box.bottom + map.Y(tick.value)}, tick.label, "right");
    }
    const double gap = kAxisLabelGapY + static_cast<double>(LongestLabel(ticks)) * kCharacter;
    Text({box.left - gap, (box.bottom + box.top) / 2}, axis.label, "center rotate by 90");
  }

  void PanelPlot(const Panel& panel, const Box& box) {
    const auto [x, y] = AxisRanges(panel, box);
    Margins(box);
    const PixelMap map(panel, x, y, box);
    AxisX(panel.x, x, box, map);
    AxisY(panel.y, y, box, map);
    Text({box.left, box.top + kTitleGap}, panel.title, "left", kFontSize, /*bold=*/true);
    Shapes(panel, x, y, map);
    std::vector<std::string> plots = {"NaN notitle"};  // gnuplot wants something to plot
    for (const Outline& outline : panel.outlines) OutlinePlot(outline, &plots);
    for (size_t i = 0; i < panel.series.size(); ++i) SeriesPlots(panel, i, map, &plots);
    ReferencePlots(panel, x, y, &plots);
    Plot(plots);
  }

  void Shapes(const Panel& panel, const Range& x, const Range& y, const PixelMap& map) {
    // What is solid outside of a line would cover all that is solid elsewhere.
    for (const Outline& outline : panel.outlines) {
      if (outline.solid == Outline::Solid::kOutside) {
        Polygon({{x.min, y.min}, {x.max, y.min}, {x.max, y.max}, {x.min, y.max}, {x.min, y.min}}, kGround);
        Polygon(outline.points, kPaper);
      }
    }
    for (const Outline& outline : panel.outlines) {
      if (outline.solid == Outline::Solid::kInside) Polygon(outline.points, kGround);
    }
    for (const SolidHalfPlane& half_plane : panel.half_planes) Ground(half_plane, x, y);
    for (const Rectangle& rectangle : panel.rectangles) {
      // The border closes the gaps that antialiasing leaves between neighbours.
      Line("set object rectangle from " + Number(rectangle.from[0]) + "," + Number(rectangle.from[1]) + " to " +
           Number(rectangle.to[0]) + "," + Number(rectangle.to[1]) + " behind fc rgb " + Quote(rectangle.colour) +
           " fs solid border rgb " + Quote(rectangle.colour) + " lw 0.5");
    }
    for (const Circle& circle : panel.circles) {
      Line("set object " + (panel.equal_aspect ? PolygonOf(circle, map) : Round(circle)) + " front fc rgb " +
           Quote(circle.colour) + " fs transparent solid " + Number(circle.opacity) + " border rgb " +
           Quote(circle.colour) + " lw 1.5");
    }
    for (const LineSegment& segment : panel.segments) {
      Line("set arrow from " + Number(segment.from[0]) + "," + Number(segment.from[1]) + " to " +
           Number(segment.to[0]) + "," + Number(segment.to[1]) + " front lw " + Number(segment.width) +
           Colour(segment.colour) + (segment.arrow ? " head filled size screen 0.012,18" : " nohead"));
    }
  }

  // The part of the plot that lies in the ground: the plot's rectangle clipped by the half-plane.
  void Ground(const SolidHalfPlane& ground, const Range& x, const Range& y) {
    const std::array<std::array<double, 2>, 4> corners = {
        {{x.min, y.min}, {x.max, y.min}, {x.max, y.max}, {x.min, y.max}}};
    const auto height = [&](const std::array<double, 2>& p) {
      return ground.normal[0] * (p[0] - ground.point[0]) + ground.normal[1] * (p[1] - ground.point[1]);
    };
    std::vector<std::array<double, 2>> polygon;
    std::vector<std::array<double, 2>> surface;
    for (size_t i = 0; i < corners.size(); ++i) {
      const auto& a = corners[i];
      const auto& b = corners[(i + 1) % corners.size()];
      const double height_a = height(a);
      const double height_b = height(b);
      if (height_a <= 0) polygon.push_back(a);
      if ((height_a <= 0) == (height_b <= 0)) continue;
      const double t = height_a / (height_a - height_b);
      polygon.push_back({a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])});
      surface.push_back(polygon.back());
    }
    if (surface.size() != 2) return;
    polygon.push_back(polygon.front());
    Polygon(polygon, kGround);
    Line("set arrow from " + Number(surface[0][0]) + "," + Number(surface[0][1]) + " to " + Number(surface[1][0]) +
         "," + Number(surface[1][1]) + " nohead lw 1.5" + Colour(kFaintInk));
  }

  static std::string Round(const Circle& circle) {
    return "circle at " + Number(circle.centre[0]) + "," + Number(circle.centre[1]) + " size " + Number(circle.radius);
  }

  // With no more corners than one can see: gnuplot's own circles take 4 KB each.
  static std::string PolygonOf(const Circle& circle, const PixelMap& map) {
    const double pixels = std::abs(map.X(circle.centre[0] + circle.radius) - map.X(circle.centre[0]));
    const double half_angle = std::acos(1 - std::min(kSimplifyTolerance / 2 / std::max(pixels, 0.1), 0.5));
    const int corners = static_cast<int>(std::ceil(std::numbers::pi / half_angle));
    std::vector<std::array<double, 2>> points;
    for (int i = 0; i <= corners; ++i) {
      const double angle = 2 * std::numbers::pi * (i % corners) / corners;
      points.push_back(
          {circle.centre[0] + circle.radius * std::cos(angle), circle.centre[1] + circle.radius * std::sin(angle)});
    }
    return PolygonThrough(points);
  }

  static std::string PolygonThrough(const std::vector<std::array<double, 2>>& points) {
    std::string path = "polygon";
    for (size_t i = 0; i < points.size(); ++i) {
      path += (i == 0 ? " from " : " to ") + Number(points[i][0]) + "," + Number(points[i][1]);
    }
    return path;
  }

  // The inside of a closed line.
  void Polygon(const std::vector<std::array<double, 2>>& points, std::string_view colour) {
    Line("set object " + PolygonThrough(points) + " behind fc rgb " + Quote(colour) + " fs solid noborder");
  }

  // Writes the points to a data block; an empty line interrupts a line.
  std::string DataBlock(const std::vector<std::string>& rows) {
    const std::string name = "$data" + std::to_string(++blocks_);
    Line(name + " << EOD");
    for (const std::string& row : rows) Line(row);
    Line("EOD");
    return name;
  }

  static bool IsDrawable(const Panel& panel, double x, double y) {
    return std::isfinite(x) && std::isfinite(y) && !(panel.x.log && x <= 0) && !(panel.y.log && y <= 0);
  }

  // The runs of drawable points, each without the points that no one could see.
  std::vector<std::string> LineRows(const Panel& panel, const Series& series, const PixelMap& map) {
    std::vector<std::string> rows;
    for (size_t begin = 0; begin < series.x.size();) {
      size_t end = begin;
      std::vector<double> pixel_x;
      std::vector<double> pixel_y;
      for (; end < series.x.size() && IsDrawable(panel, series.x[end], series.y[end]); ++end) {
        pixel_x.push_back(map.X(series.x[end]));
        pixel_y.push_back(map.Y(series.y[end]));
      }
      if (end > begin) {
        if (!rows.empty()) rows.emplace_back();
        for (const size_t i : SimplifyLine(pixel_x, pixel_y, kSimplifyTolerance)) {
          rows.push_back(Number(series.x[begin + i]) + " " + Number(series.y[begin + i]));
        }
      }
      begin = end + 1;
    }
    return rows;
  }

  // On a line a few points are marked, not the same for every series; without a line all.
  std::vector<std::string> MarkerRows(const Panel& panel, size_t index) {
    const Series& series = panel.series[index];
    const size_t stride = series.line ? std::max<size_t>(1, series.x.size() / kMarksOnALine) : 1;
    std::vector<std::string> rows;
    for (size_t i = stride * (index % 8) / 8; i < series.x.size(); i += stride) {
      if (IsDrawable(panel, series.x[i], series.y[i])) rows.push_back(Number(series.x[i]) + " " + Number(series.y[i]));
    }
    return rows;
  }

  void SeriesPlots(const Panel& panel, size_t index, const PixelMap& map, std::vector<std::string>* plots) {
    const Series& series = panel.series[index];
    CHECK_EQ(series.x.size(), series.y.size()) << "series '" << series.label << "'";
    const std::string title = series.label.empty() ? " notitle" : " title " + Quote(series.label);
    if (series.line) {
      const std::vector<std::string> rows = LineRows(panel, series, map);
      if (!rows.empty())
        plots->push_back(DataBlock(rows) + " with lines" + LineStyle(series.width, series.dash, series.colour) + title);
    }
    if (series.marker != Marker::kNone) {
      const std::vector<std::string> rows = MarkerRows(panel, index);
      const std::string style = " with points" + MarkStyle(series.marker, series.colour, terminal_) + title;
      if (!rows.empty()) plots->push_back(DataBlock(rows) + style);
    }
  }

  void OutlinePlot(const Outline& outline, std::vector<std::string>* plots) {
    std::vector<std::string> rows;
    for (const auto& point : outline.points) rows.push_back(Number(point[0]) + " " + Number(point[1]));
    plots->push_back(DataBlock(rows) + " with lines" + LineStyle(1.5, Dash::kSolid, kFaintInk) + " notitle");
  }

  void ReferencePlots(const Panel& panel, const Range& x, const Range& y, std::vector<std::string>* plots) {
    for (const ReferenceLine& line : panel.reference_lines) {
      const std::string value = Number(line.value);
      const std::vector<std::string> rows =
          line.vertical ? std::vector<std::string>{value + " " + Number(y.min), value + " " + Number(y.max)}
                        : std::vector<std::string>{Number(x.min) + " " + value, Number(x.max) + " " + value};
      const std::string title = line.label.empty() ? " notitle" : " title " + Quote(line.label);
      plots->push_back(DataBlock(rows) + " with lines" + LineStyle(kReferenceWidth, line.dash, line.colour) + title);
    }
  }

  // A plot of samples over the whole page, in pixels.
  void LegendPlot() {
    Margins({0, layout_.width, 0, layout_.height});
    Line("unset border");
    Line("unset tics");
    Line("unset logscale");
    Line("set xrange [0:" + Number(layout_.width) + "]");
    Line("set yrange [0:" + Number(layout_.height) + "]");
    const std::vector<LegendEntry> entries = LegendEntries(figure_, terminal_);
    const size_t columns = static_cast<size_t>(layout_.legend_columns);
    const size_t rows = (entries.size() + columns - 1) / columns;
    const double column_width = (layout_.legend.right - layout_.legend.left) / layout_.legend_columns;
    std::vector<std::string> plots;
    for (size_t i = 0; i < entries.size(); ++i) {
      const double x = layout_.legend.left + static_cast<double>(i / rows) * column_width;
      const double y = layout_.legend.top - (static_cast<double>(i % rows) + 0.5) * kLine;
      LegendSample(entries[i], x, y, &plots);
      Text({x + kLegendText, y}, entries[i].label, "left");
    }
    Plot(plots);
  }

  void LegendSample(const LegendEntry& entry, double x, double y, std::vector<std::string>* plots) {
    const auto row = [&](double share) { return Number(x + share * kLegendSample) + " " + Number(y); };
    if (!entry.line.empty()) plots->push_back(DataBlock({row(0), row(1)}) + " with lines" + entry.line);
    if (!entry.marks.empty()) plots->push_back(DataBlock({row(0.5)}) + " with points" + entry.marks);
  }

  void Plot(const std::vector<std::string>& plots) {
    std::string command = "plot ";
    for (const std::string& plot : plots) command += (&plot == &plots[0] ? "" : ", ") + plot;
    Line(command);
    // What belongs to this plot must not be drawn again with the next.
    Line("unset label");
    Line("unset object");
    Line("unset arrow");
  }

  const Figure& figure_;
  Terminal terminal_;
  Layout layout_;
  std::string script_;
  int blocks_ = 0;
};

}  // namespace

std::string GnuplotScript(const Figure& figure, Terminal terminal) { return ScriptWriter(figure, terminal).Write(); }

}  // namespace saltus::internal
