#include "output/figure.h"

#include <glog/logging.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>
#include <nlohmann/json.hpp>
#include <thread>
#include <utility>

#include "base/file.h"
#include "base/interrupt.h"
#include "base/number_text.h"
#include "base/table.h"

extern char** environ;

namespace saltus {
namespace {

using Json = nlohmann::ordered_json;

// ---- Running gnuplot

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

std::string ReadFromStart(std::FILE* file) {
  std::rewind(file);
  std::string text;
  std::array<char, 1 << 14> buffer;
  while (const size_t size = std::fread(buffer.data(), 1, buffer.size(), file)) text.append(buffer.data(), size);
  return text;
}

// Waits for the end of a child process, which is killed when the grace of an interrupt (base/interrupt.h) is over.
int WaitFor(pid_t child, int* wait_status) {
  using namespace std::chrono_literals;
  auto pause = 100us;
  while (true) {
    const pid_t ended = waitpid(child, wait_status, WNOHANG);
    if (ended == child) return 0;
    if (ended < 0 && errno != EINTR) return errno;
    if (InterruptGuard::GraceIsOver()) kill(child, SIGKILL);
    std::this_thread::sleep_for(pause);
    pause = std::min<std::chrono::microseconds>(2 * pause, 10ms);
  }
}

// Runs the program with files as its standard streams. Returns errno of the start, or 0 and the wait status. It has its
// own process group, so that Ctrl-C in the terminal does not end it before its figure is done.
int Spawn(const std::string& executable, std::FILE* in, std::FILE* out, std::FILE* err, int* wait_status) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, fileno(in), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(out), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(err), STDERR_FILENO);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  posix_spawnattr_setpgroup(&attributes, 0);
  std::string name = executable;
  std::string no_user_settings = "-d";
  std::string script = "/dev/stdin";  // by its name: what gnuplot reads without one, it reads character by character
  char* const arguments[] = {name.data(), no_user_settings.data(), script.data(), nullptr};
  pid_t child = 0;
  const int error = posix_spawnp(&child, executable.c_str(), &actions, &attributes, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  return error != 0 ? error : WaitFor(child, wait_status);
}

// Returns what gnuplot writes to its standard output when `script` is its standard input; no shell is involved.
StatusOr<std::string> RunGnuplot(const std::string& executable, const std::string& script) {
  // Files rather than pipes: neither side ever waits for the other.
  const File in(std::tmpfile());
  const File out(std::tmpfile());
  const File err(std::tmpfile());
  if (!in || !out || !err) return Status::Error(std::string("cannot make a temporary file: ") + std::strerror(errno));
  if (std::fwrite(script.data(), 1, script.size(), in.get()) != script.size() || std::fflush(in.get()) != 0) {
    return Status::Error(std::string("cannot write a temporary file: ") + std::strerror(errno));
  }
  std::rewind(in.get());
  int wait_status = 0;
  const int error = Spawn(executable, in.get(), out.get(), err.get(), &wait_status);
  if (error == ENOENT) return Status::Error("figures need gnuplot, and '" + executable + "' was not found");
  if (error != 0) return Status::Error("cannot run '" + executable + "': " + std::strerror(error));
  if (WIFEXITED(wait_status) && WEXITSTATUS(wait_status) == 0) return ReadFromStart(out.get());
  if (InterruptGuard::GraceIsOver()) return Status::Error("interrupted");
  return Status::Error("gnuplot failed: " + ReadFromStart(err.get()));
}

// ---- The script

// Colours of the drawing that do not stand for data.
constexpr char kInk[] = "#24292f", kFaintInk[] = "#6e7781", kGrid[] = "#e6e8eb", kGround[] = "#d0d4d9";
constexpr char kPaper[] = "#ffffff";

constexpr double kCharacter = 7.5, kLine = 20, kSample = 60, kTitle = 34;  // pixels
constexpr double kPngScale = 2;
constexpr size_t kAllMarked = 40, kMarksOnALine = 9;

std::string Number(double value) { return std::isfinite(value) ? Format("%.9g", value) : "NaN"; }

// Returns a text as a gnuplot string. Single quotes take all characters literally but themselves and line ends.
std::string Quote(std::string_view text) {
  std::string quoted = "'";
  for (const char c : text) {
    const bool control = static_cast<unsigned char>(c) < 0x20;
    quoted += control ? std::string(" ") : c == '\'' ? std::string("''") : std::string(1, c);
  }
  return quoted + "'";
}

// Returns a text that appears in a figure literally, without gnuplot's markup.
std::string Label(std::string_view text) { return Quote(text) + " noenhanced"; }

std::string Colour(std::string_view colour) { return " lc rgb " + Quote(colour); }

// Returns the style of a line. Lines end in half discs, which lengthen every dash by the width of the line.
std::string LineStyle(double width, Dash dash, std::string_view colour) {
  static constexpr std::string_view kDashes[] = {"solid", "(5,5)", "(0.5,4)", "(8,4,0.5,4)"};
  return " lw " + Number(width) + " dt " + std::string(kDashes[static_cast<int>(dash)]) + Colour(colour);
}

// Returns gnuplot's number of a marker, with a size that makes all markers look equally large.
std::string MarkStyle(Marker marker) {
  static constexpr std::pair<int, double> kPoints[] = {
      {0, 0}, {7, 0.6}, {5, 0.55}, {9, 0.65}, {11, 0.65}, {13, 0.65}, {6, 0.65}, {4, 0.6}, {2, 0.6}};
  const auto& [type, size] = kPoints[static_cast<int>(marker)];
  return " pt " + std::to_string(type) + " ps " + Number(size);
}

struct Range {
  double min = 0, max = 1;
};

// The range of an axis: all of its data with a margin, except where the axis states a bound.
class Extent {
 public:
  explicit Extent(const Axis& axis) : axis_(axis) {}

  void Add(double value) {
    if (!std::isfinite(value) || (axis_.log && value <= 0)) return;
    const double at = axis_.log ? std::log10(value) : std::clamp(value, -1e270, 1e270);
    low_ = std::min(low_, at);
    high_ = std::max(high_, at);
  }

  Range WithMargin(double share) const {
    double low = low_ > high_ ? 0 : low_, high = low_ > high_ ? 1 : high_;
    // A constant needs a span too, wider than its rounding.
    if (high - low <= 1e-9 * std::max(std::abs(low), std::abs(high))) {
      const double half = low == 0 || axis_.log ? 1 : 0.1 * std::abs(low);
      low -= half;
      high += half;
    }
    const double margin = share * (high - low);
    const auto value = [&](double at) { return axis_.log ? std::pow(10, std::clamp(at, -300.0, 300.0)) : at; };
    Range range{axis_.min.value_or(value(low - margin)), axis_.max.value_or(value(high + margin))};
    // If all data lie beyond the one bound that is stated, the plot is empty but valid.
    if (range.min >= range.max && !axis_.max) range.max = axis_.log ? 10 * range.min : range.min + 1;
    if (range.min >= range.max) range.min = axis_.log ? range.max / 10 : range.max - 1;
    return range;
  }

 private:
  const Axis& axis_;
  double low_ = HUGE_VAL, high_ = -HUGE_VAL;
};

std::pair<Range, Range> RangesOf(const Panel& panel) {
  Extent x(panel.x), y(panel.y);
  const auto add = [&](double at_x, double at_y) {
    x.Add(at_x);
    y.Add(at_y);
  };
  for (const Series& series : panel.series) {
    CHECK_EQ(series.x.size(), series.y.size()) << "series '" << series.label << "'";
    for (size_t i = 0; i < series.x.size(); ++i) add(series.x[i], series.y[i]);
  }
  for (const ReferenceLine& line : panel.reference_lines) (line.vertical ? x : y).Add(line.value);
  for (const Rectangle& rectangle : panel.rectangles) {
    for (const auto& corner : {rectangle.from, rectangle.to}) add(corner[0], corner[1]);
  }
  for (const Circle& circle : panel.circles) {
    for (const double side : {-circle.radius, circle.radius}) add(circle.centre[0] + side, circle.centre[1] + side);
  }
  for (const Outline& outline : panel.outlines) {
    for (const auto& point : outline.points) add(point[0], point[1]);
  }
  return {x.WithMargin(0.02), y.WithMargin(0.05)};
}

// Places panels in cells of equal size, with one key beside or below; gnuplot places margins, ticks and their labels.
class ScriptWriter {
 public:
  ScriptWriter(const Figure& figure, FigureFormat format) : figure_(figure), format_(format) {}

  std::string Write() {
    CHECK(!figure_.panels.empty());
    CHECK_GT(figure_.columns, 0);
    const size_t columns = std::min(static_cast<size_t>(figure_.columns), figure_.panels.size());
    const size_t rows = (figure_.panels.size() + columns - 1) / columns;
    const double title = figure_.title.empty() ? 0 : kTitle, panels = static_cast<double>(rows) * figure_.panel_height;
    const KeySize key = SizeOfKey(panels);
    const bool right = figure_.legend == Legend::kRight;
    height_ = title + panels + (right ? 0 : key.height);
    Begin();
    const double width = (figure_.width - (right ? key.width : 0)) / static_cast<double>(columns);
    for (size_t i = 0; i < figure_.panels.size(); ++i) {
      const double top = title + static_cast<double>(i / columns) * figure_.panel_height;
      Place(static_cast<double>(i % columns) * width, top, width, figure_.panel_height);
      PanelPlot(figure_.panels[i]);
    }
    if (key.columns > 0) {
      Place(right ? figure_.width - key.width : 0,
            title + (right ? 0 : panels),
            right ? key.width : figure_.width,
            right ? panels : key.height);
      KeyPlot(key.columns);
    }
    Line("unset multiplot");
    return std::move(script_);
  }

 private:
  struct KeySize {
    int columns = 0;  // 0 without a key
    double width = 0, height = 0;
  };

  void Line(const std::string& command) { script_ += command + '\n'; }

  void Begin() {
    Line("set encoding utf8");
    const double scale = format_ == FigureFormat::kSvg ? 1 : kPngScale;
    const std::string size = " size " + Number(scale * figure_.width) + "," + Number(scale * height_) + " background " +
                             Quote(kPaper) + " font 'Liberation Sans,13'";
    if (format_ == FigureFormat::kSvg) {
      Line("set terminal svg dynamic enhanced rounded" + size);
    } else {
      // Cairo's font sizes are points of 4/3 pixels.
      const std::string all = Number(scale);
      Line("set terminal pngcairo enhanced rounded" + size + " fontscale " + Number(0.75 * scale) + " linewidth " +
           all + " pointscale " + all + " dashlength " + all);
    }
    Line("set minussign");
    Line("set multiplot" + (figure_.title.empty() ? "" : " title " + Label(figure_.title) + " font ',15'"));
    Line("unset key");
    Line("set border 3 lw 1" + Colour(kFaintInk));
    Line("set grid xtics ytics back lt 1 lw 1" + Colour(kGrid));
    Line("set tics nomirror out scale 0.6,0.3 textcolor rgb " + Quote(kInk));
  }

  // Sets the place of the next plot, in pixels from the top left.
  void Place(double left, double top, double width, double height) {
    Line("set origin " + Number(left / figure_.width) + "," + Number(1 - (top + height) / height_));
    Line("set size " + Number(width / figure_.width) + "," + Number(height / height_));
  }

  void AxisCommands(const std::string& name, const Axis& axis, const Range& range) {
    Line("set " + name + "range [" + Number(range.min) + ":" + Number(range.max) + "]");
    const bool log = axis.log && range.max >= 10 * range.min;  // or gnuplot has no place for a tick
    Line((log ? "set logscale " : "unset logscale ") + name);
    Line("set format " + name + (log && range.max >= 1e3 * range.min ? " '10^{%L}'" : " '%h'"));
    Line("set " + name + "label " + Label(axis.label));
  }

  void PanelPlot(const Panel& panel) {
    const auto [x, y] = RangesOf(panel);
    AxisCommands("x", panel.x, x);
    AxisCommands("y", panel.y, y);
    Line("set title " + Label(panel.title));
    Line(panel.equal_aspect ? "set size ratio -1" : "set size noratio");
    Shapes(panel, x, y);
    std::vector<std::string> plots = {"NaN notitle"};  // gnuplot wants something to plot
    for (const Outline& outline : panel.outlines) {
      plots.push_back(DataBlock(outline.points) + " with lines" + LineStyle(1.5, Dash::kSolid, kFaintInk));
    }
    for (const Series& series : panel.series) {
      std::vector<std::array<double, 2>> points;
      for (size_t i = 0; i < series.x.size(); ++i) points.push_back({series.x[i], series.y[i]});
      plots.push_back(DataBlock(points) + LookOf(series));
    }
    for (const ReferenceLine& line : panel.reference_lines) {
      const std::string at = Number(line.value);
      const std::string ends =
          line.vertical ? at + ",graph 0 to " + at + ",graph 1" : "graph 0,first " + at + " to graph 1,first " + at;
      Line("set arrow from " + ends + " nohead front" + LineStyle(1.5, line.dash, line.colour));
    }
    Plot(plots);
  }

  // Returns the style of a series: a line, marks, or a line with a few of them.
  static std::string LookOf(const Series& series) {
    const std::string line = LineStyle(series.width, series.dash, series.colour);
    if (series.marker == Marker::kNone) return " with lines" + line;
    const std::string marks = MarkStyle(series.marker);
    if (!series.line) return " with points" + marks + Colour(series.colour);
    const size_t every = series.x.size() <= kAllMarked ? 1 : series.x.size() / kMarksOnALine;
    return " with linespoints" + line + marks + " pi " + std::to_string(every);
  }

  void Shapes(const Panel& panel, const Range& x, const Range& y) {
    const std::vector<std::array<double, 2>> whole = {{x.min, y.min}, {x.max, y.min}, {x.max, y.max}, {x.min, y.max}};
    // The solid outside of a line comes first, as it would cover other solid areas.
    for (const Outline& outline : panel.outlines) {
      if (outline.solid != Outline::Solid::kOutside) continue;
      Polygon(whole, kGround);
      Polygon(outline.points, kPaper);
    }
    for (const Outline& outline : panel.outlines) {
      if (outline.solid == Outline::Solid::kInside) Polygon(outline.points, kGround);
    }
    for (const SolidHalfPlane& half_plane : panel.half_planes) Polygon(SolidPart(whole, half_plane), kGround);
    for (const Rectangle& rectangle : panel.rectangles) {
      // The border closes the gaps that antialiasing leaves between neighbours.
      Line("set object rectangle from " + Point(rectangle.from) + " to " + Point(rectangle.to) + " behind fc rgb " +
           Quote(rectangle.colour) + " fs solid border rgb " + Quote(rectangle.colour) + " lw 0.5");
    }
    for (const Circle& circle : panel.circles) {
      Line("set object circle at " + Point(circle.centre) + " size " + Number(circle.radius) + " front fc rgb " +
           Quote(circle.colour) + " fs transparent solid " + Number(circle.opacity) + " border rgb " +
           Quote(circle.colour) + " lw 1.5");
    }
  }

  // Returns the part of a polygon that lies in the ground (Sutherland and Hodgman 1974, for one line).
  static std::vector<std::array<double, 2>> SolidPart(const std::vector<std::array<double, 2>>& polygon,
                                                      const SolidHalfPlane& ground) {
    const auto height = [&](const std::array<double, 2>& p) {
      return ground.normal[0] * (p[0] - ground.point[0]) + ground.normal[1] * (p[1] - ground.point[1]);
    };
    std::vector<std::array<double, 2>> part;
    for (size_t i = 0; i < polygon.size(); ++i) {
      const auto &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      const double height_a = height(a), height_b = height(b);
      if (height_a <= 0) part.push_back(a);
      if ((height_a <= 0) == (height_b <= 0)) continue;
      const double t = height_a / (height_a - height_b);
      part.push_back({a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])});
    }
    return part;
  }

  static std::string Point(const std::array<double, 2>& point) { return Number(point[0]) + "," + Number(point[1]); }

  // Fills the inside of a closed line.
  void Polygon(const std::vector<std::array<double, 2>>& points, std::string_view colour) {
    if (points.size() < 3) return;
    std::string path;
    for (const auto& point : points) path += (path.empty() ? " from " : " to ") + Point(point);
    if (points.front() != points.back()) path += " to " + Point(points.front());
    Line("set object polygon" + path + " behind fc rgb " + Quote(colour) + " fs solid noborder");
  }

  // Writes points as a data block. Points that are not finite interrupt the line.
  std::string DataBlock(const std::vector<std::array<double, 2>>& points) {
    const std::string name = "$data" + std::to_string(++blocks_);
    Line(name + " << EOD");
    bool gap = true;
    for (const auto& [x, y] : points) {
      const bool finite = std::isfinite(x) && std::isfinite(y);
      if (finite || !gap) Line(finite ? Number(x) + " " + Number(y) : "");
      gap = !finite;
    }
    Line("EOD");
    return name;
  }

  // Returns each label of the figure once, with its style.
  std::vector<std::pair<std::string, std::string>> KeyEntries() const {
    std::vector<std::pair<std::string, std::string>> entries;
    const auto add = [&](const std::string& label, const std::string& look) {
      const bool known = std::ranges::any_of(entries, [&](const auto& e) { return e.first == label; });
      if (!label.empty() && !known) entries.emplace_back(label, look);
    };
    for (const Panel& panel : figure_.panels) {
      for (const Series& series : panel.series) add(series.label, LookOf(series));
      for (const ReferenceLine& line : panel.reference_lines) {
        add(line.label, " with lines" + LineStyle(1.5, line.dash, line.colour));
      }
    }
    return entries;
  }

  // Returns the size of the key: as few columns as its height allows beside the panels, as many as fit below them.
  KeySize SizeOfKey(double panels_height) const {
    const auto entries = KeyEntries();
    if (figure_.legend == Legend::kNone || entries.empty()) return {};
    size_t longest = 0;
    for (const auto& [label, look] : entries) longest = std::max(longest, DisplayWidth(label));
    const double width = kSample + static_cast<double>(longest) * kCharacter,
                 count = static_cast<double>(entries.size());
    const double columns = figure_.legend == Legend::kRight
                               ? std::ceil(count / std::max(1.0, std::floor(panels_height / kLine) - 1))
                               : std::clamp(std::floor(figure_.width / width), 1.0, count);
    return {static_cast<int>(columns), columns * width, (std::ceil(count / columns) + 1) * kLine};
  }

  // Plots nothing but the key.
  void KeyPlot(int columns) {
    for (const char* what : {"title", "xlabel", "ylabel", "border", "tics", "grid", "logscale"}) {
      Line(std::string("unset ") + what);
    }
    Line("set size noratio");
    for (const char* margin : {"lmargin", "rmargin", "tmargin", "bmargin"}) Line(std::string("set ") + margin + " 0");
    Line("set xrange [0:1]");
    Line("set yrange [0:1]");
    Line("set key center center Left reverse samplen 3 maxcols " + std::to_string(columns) +
         (figure_.legend == Legend::kRight ? " vertical" : " horizontal"));
    std::vector<std::string> plots;
    for (const auto& [label, look] : KeyEntries()) plots.push_back("NaN" + look + " title " + Label(label));
    Plot(plots);
  }

  void Plot(const std::vector<std::string>& plots) {
    Line("plot " + Joined(plots));
    // Objects of this plot must not be drawn again with the next one.
    Line("unset object");
    Line("unset arrow");
  }

  const Figure& figure_;
  FigureFormat format_;
  double height_ = 0;
  std::string script_;
  int blocks_ = 0;
};

// ---- JSON

Json RoundedToJson(double value) { return std::isfinite(value) ? Json(RoundedTo(6, value)) : Json(); }

Json RoundedToJson(const std::vector<double>& values) {
  Json list = Json::array();
  for (const double value : values) list.push_back(RoundedToJson(value));
  return list;
}

Json AxisToJson(const Axis& axis) {
  Json item = {{"label", axis.label}, {"log", axis.log}};
  if (axis.min) item["min"] = *axis.min;
  if (axis.max) item["max"] = *axis.max;
  return item;
}

Json PanelToJson(const Panel& panel) {
  Json item = {
      {"title", panel.title}, {"x", AxisToJson(panel.x)}, {"y", AxisToJson(panel.y)}, {"equal", panel.equal_aspect}};
  for (const char* key : {"series", "lines", "rectangles", "circles", "planes", "outlines"}) item[key] = Json::array();
  for (const Series& series : panel.series) {
    item["series"].push_back({{"label", series.label},
                              {"x", RoundedToJson(series.x)},
                              {"y", RoundedToJson(series.y)},
                              {"colour", series.colour},
                              {"dash", DashName(series.dash)},
                              {"marker", MarkerName(series.marker)},
                              {"line", series.line},
                              {"width", series.width}});
  }
  for (const ReferenceLine& line : panel.reference_lines) {
    item["lines"].push_back({{"value", RoundedToJson(line.value)},
                             {"label", line.label},
                             {"vertical", line.vertical},
                             {"colour", line.colour},
                             {"dash", DashName(line.dash)}});
  }
  for (const Rectangle& shape : panel.rectangles) {
    item["rectangles"].push_back({{"from", shape.from}, {"to", shape.to}, {"colour", shape.colour}});
  }
  for (const Circle& shape : panel.circles) {
    item["circles"].push_back(
        {{"centre", shape.centre}, {"radius", shape.radius}, {"colour", shape.colour}, {"opacity", shape.opacity}});
  }
  for (const SolidHalfPlane& plane : panel.half_planes) {
    item["planes"].push_back({{"point", plane.point}, {"normal", plane.normal}});
  }
  for (const Outline& outline : panel.outlines) {
    item["outlines"].push_back({{"points", outline.points}, {"solid", SolidName(outline.solid)}});
  }
  return item;
}

}  // namespace

Series Series::ForModel(std::string_view model, std::vector<double> x, std::vector<double> y) {
  const ModelStyle& style = StyleOf(model);
  return {.label = std::string(model),
          .x = std::move(x),
          .y = std::move(y),
          .colour = std::string(style.colour),
          .dash = style.dash,
          .marker = style.marker};
}

StatusOr<std::string> RenderFigure(const Figure& figure, FigureFormat format, const std::string& gnuplot) {
  return RunGnuplot(gnuplot, ScriptWriter(figure, format).Write());
}

Status WriteFigure(const Figure& figure, const std::string& path) {
  for (const auto& [suffix, format] : {std::pair(".svg", FigureFormat::kSvg), std::pair(".png", FigureFormat::kPng)}) {
    const StatusOr<std::string> bytes = RenderFigure(figure, format);
    if (!bytes.ok()) return bytes.status();
    const Status written = WriteFile(path + suffix, *bytes, InterruptGuard::Interrupted);
    if (!written.ok()) return written;
  }
  return Status();
}

nlohmann::ordered_json FigureToJson(const Figure& figure) {
  Json panels = Json::array();
  for (const Panel& panel : figure.panels) panels.push_back(PanelToJson(panel));
  return {{"title", figure.title}, {"panels", std::move(panels)}};
}

std::string_view DashName(Dash dash) {
  static constexpr std::string_view kNames[] = {"solid", "dashed", "dotted", "dashdotted"};
  return kNames[static_cast<int>(dash)];
}

std::string_view MarkerName(Marker marker) {
  static constexpr std::string_view kNames[] = {
      "none", "circle", "square", "triangle", "triangledown", "diamond", "opencircle", "opensquare", "cross"};
  return kNames[static_cast<int>(marker)];
}

const std::vector<ModelStyle>& ModelStyles() {
  static const std::vector<ModelStyle> styles = {
      {"analytic", "#000000", Dash::kDashed, Marker::kNone},
      {"lcp", "#4671DB", Dash::kSolid, Marker::kCircle},
      {"convex", "#F49700", Dash::kDashed, Marker::kSquare},
      {"convex_toi", "#A35F0A", Dash::kSolid, Marker::kSquare},
      {"direct", "#05A98B", Dash::kDashed, Marker::kTriangle},
      {"direct_toi", "#04593F", Dash::kSolid, Marker::kTriangle},
      {"compliant_warp", "#FF76C8", Dash::kSolid, Marker::kDiamond},
      {"compliant_brax", "#7C117D", Dash::kDashDotted, Marker::kDiamond},
      {"pbd_warp", "#0ABAFF", Dash::kSolid, Marker::kTriangleDown},
      {"pbd_brax", "#3D2CBC", Dash::kDashDotted, Marker::kTriangleDown},
      {"toi_velocity", "#DB7549", Dash::kDotted, Marker::kOpenSquare},
      {"event", "#517886", Dash::kSolid, Marker::kOpenCircle},
      {"lcp_kkt", "#1AD165", Dash::kDotted, Marker::kCircle},
      {"lcp_pgs", "#266F55", Dash::kDotted, Marker::kSquare},
      {"lcp_pgs_adjoint", "#E705B9", Dash::kDotted, Marker::kTriangle},
      {"ncp", "#0F1BF0", Dash::kDashed, Marker::kCross},
      {"ncp_restitution", "#6D0055", Dash::kDashed, Marker::kOpenSquare},
      {"soft_convex", "#2181B6", Dash::kDashDotted, Marker::kSquare},
      {"qcqp", "#A61F05", Dash::kDashed, Marker::kCircle},
      {"smooth_compliant", "#8B3A94", Dash::kDotted, Marker::kTriangleDown},
      {"ipc_barrier", "#6D1E02", Dash::kDashDotted, Marker::kCross},
      {"xpbd", "#2DC08D", Dash::kDashDotted, Marker::kOpenCircle},
      {"position_qp", "#4890FC", Dash::kDashed, Marker::kDiamond},
      {"primal_descent", "#480C24", Dash::kSolid, Marker::kCross},
      {"dual_descent", "#000030", Dash::kDotted, Marker::kCross},
      {"static_lcp", "#30000C", Dash::kDashDotted, Marker::kOpenSquare},
  };
  return styles;
}

const ModelStyle& StyleOf(std::string_view model) {
  const std::vector<ModelStyle>& styles = ModelStyles();
  for (const ModelStyle& style : styles) {
    if (style.model == model) return style;
  }
  uint32_t hash = 2166136261u;  // FNV-1a: the same on every machine, unlike std::hash
  for (const char c : model) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
  return styles[1 + hash % (styles.size() - 1)];
}

std::string ColourOf(std::string_view model) { return std::string(StyleOf(model).colour); }

std::string RampColour(double fraction) {
  static constexpr std::array<std::array<double, 3>, 5> kStops = {
      {{43, 34, 118}, {107, 40, 141}, {178, 58, 118}, {226, 105, 76}, {242, 166, 50}}};
  const double position = std::clamp(fraction, 0.0, 1.0) * (kStops.size() - 1);
  const size_t below = std::min(static_cast<size_t>(position), kStops.size() - 2);
  const double share = position - static_cast<double>(below);
  std::array<int, 3> rgb;
  for (size_t i = 0; i < 3; ++i) {
    rgb[i] = static_cast<int>(std::lround((1 - share) * kStops[below][i] + share * kStops[below + 1][i]));
  }
  std::array<char, 8> text;
  std::snprintf(text.data(), text.size(), "#%02X%02X%02X", rgb[0] & 0xff, rgb[1] & 0xff, rgb[2] & 0xff);
  return text.data();
}

}  // namespace saltus
