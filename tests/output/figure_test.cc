#include "output/figure.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <regex>

#include "base/file.h"
#include "folders.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::Not;

Panel WavePanel(const std::string& title) {
  Panel panel;
  panel.title = title;
  panel.x.label = "time (s)";
  panel.y.label = "height (m)";
  for (const char* model : {"lcp", "direct_toi", "event"}) {
    std::vector<double> x;
    std::vector<double> y;
    for (int i = 0; i < 300; ++i) {
      x.push_back(i / 300.0);
      y.push_back(std::sin(i / 50.0 + model[0]));
    }
    panel.series.push_back(Series::ForModel(model, std::move(x), std::move(y)));
  }
  return panel;
}

Figure WaveFigure() {
  Figure figure;
  figure.title = "Waves";
  figure.panels = {WavePanel("left"), WavePanel("right")};
  figure.columns = 2;
  return figure;
}

std::vector<std::string> Matches(const std::string& text, const std::string& pattern) {
  const std::regex regex(pattern);
  std::vector<std::string> matches;
  for (std::sregex_iterator it(text.begin(), text.end(), regex), end; it != end; ++it) matches.push_back((*it)[1]);
  return matches;
}

// Every tag is closed, in order.
void ExpectWellFormed(const std::string& xml) {
  std::vector<std::string> open;
  const std::regex tag("<(/?)([A-Za-z]+)((?:\"[^\"]*\"|'[^']*'|[^>\"'])*?)(/?)>");
  for (std::sregex_iterator it(xml.begin(), xml.end(), tag), end; it != end; ++it) {
    if ((*it)[1].length() > 0) {
      ASSERT_FALSE(open.empty());
      ASSERT_EQ(open.back(), (*it)[2]);
      open.pop_back();
    } else if ((*it)[4].length() == 0) {
      open.push_back((*it)[2]);
    }
  }
  EXPECT_THAT(open, testing::IsEmpty());
}

std::string Svg(const Figure& figure) {
  const StatusOr<std::string> svg = RenderFigure(figure, FigureFormat::kSvg);
  EXPECT_TRUE(svg.ok()) << svg.status().message();
  return svg.ok() ? *svg : "";
}

TEST(FigureTest, SvgScalesAndHasTheText) {
  const std::string svg = Svg(WaveFigure());
  EXPECT_THAT(svg, HasSubstr("viewBox=\"0 0 800 "));
  for (const char* text : {"Waves", "left", "right", "time (s)", "height (m)", "direct_toi", "−0.5"}) {
    EXPECT_THAT(svg,
                testing::ContainsRegex("<text>(<tspan[^>]*>)?" + std::regex_replace(text, std::regex("[()]"), "[$&]")));
  }
  ExpectWellFormed(svg);
}

TEST(FigureTest, LegendNamesEachLabelOnce) {
  EXPECT_EQ(Matches(Svg(WaveFigure()), ">(lcp)</(?:text|tspan)>").size(), 1u);
  Figure figure = WaveFigure();
  figure.legend = Legend::kNone;
  EXPECT_EQ(Matches(Svg(figure), ">(lcp)</(?:text|tspan)>").size(), 0u);
}

TEST(FigureTest, TextIsNeverMarkupNorCommands) {
  const std::string nasty = "it's <b>\"&\" `id` _a ^b @c {d} \\n %g\n'; system('touch /tmp/x'); #$";
  Figure figure = WaveFigure();
  figure.title = nasty;
  Panel& panel = figure.panels[0];
  panel.title = panel.x.label = panel.y.label = panel.series[0].label = nasty;
  panel.reference_lines.push_back({.value = 0.5, .label = nasty + " id='x'"});
  const std::string svg = Svg(figure);
  ExpectWellFormed(svg);
  EXPECT_THAT(svg, Not(HasSubstr("<b>")));
  EXPECT_THAT(svg, HasSubstr("`id` _a ^b @c {d} \\n %g '; system('touch /tmp/x'); #$"));
  EXPECT_THAT(svg, HasSubstr(" id='x'<"));
  EXPECT_TRUE(RenderFigure(figure, FigureFormat::kPng).ok());
}

TEST(FigureTest, DrawsEverythingThatAPanelCanHold) {
  Figure figure = WaveFigure();
  Panel& panel = figure.panels[0];
  panel.equal_aspect = true;
  panel.circles.push_back({{0.5, 0.5}, 0.2, "#123456"});
  panel.rectangles.push_back({{0.25, 0}, {0.5, 1}, "#654321"});
  panel.outlines.push_back({"box", {{0, 0}, {1, 0}, {1, 1}, {0, 0}}, Outline::Solid::kInside});
  panel.half_planes.push_back({{0, -0.5}, {0.1, 1}});
  panel.half_planes.push_back({{0, -500}, {0, 1}});  // out of sight
  panel.reference_lines.push_back({.value = 0.25, .label = "impact", .vertical = true, .colour = "#abcdef"});
  std::string svg = Svg(figure);
  ExpectWellFormed(svg);
  for (const auto& [hex, rgb] : {std::pair("#123456", "18, *52, *86"),
                                 std::pair("#654321", "101, *67, *33"),
                                 std::pair("#abcdef", "171, *205, *239"),
                                 std::pair("#d0d4d9", "208, *212, *217")}) {
    EXPECT_FALSE(Matches(svg, "(" + std::string(hex) + "|rgb\\( *" + rgb + ")").empty()) << hex;
  }
  EXPECT_THAT(svg, HasSubstr(">impact<"));
}

// Reference lines stand where the data of their value do.
TEST(FigureTest, ReferenceLinesAreAtTheirValues) {
  Figure figure;
  figure.panels.resize(1);
  Panel& panel = figure.panels[0];
  panel.series.push_back({.label = "", .x = {3, 3, 8}, .y = {1, 40, 40}, .colour = "#123456"});
  panel.reference_lines.push_back({.value = 40, .label = "", .colour = "#654321"});
  panel.reference_lines.push_back({.value = 3, .label = "", .vertical = true, .colour = "#abcdef"});
  const std::string svg = Svg(figure);
  const auto numbers = [&](const std::string& colour) {
    std::vector<double> found;
    const std::vector<std::string> paths = Matches(svg, "stroke='" + colour + "'[^>]* d='([^']*)'");
    for (const std::string& number : paths.empty() ? paths : Matches(paths[0], "([0-9.]+)"))
      found.push_back(std::stod(number));
    return found;
  };
  const std::vector<double> line = numbers("rgb\\( 18,  52,  86\\)"), level = numbers("rgb\\(101,  67,  33\\)"),
                            upright = numbers("rgb\\(171, 205, 239\\)");
  ASSERT_EQ(line.size(), 6u);
  ASSERT_EQ(level.size(), 4u);
  ASSERT_EQ(upright.size(), 4u);
  for (const size_t end : {1, 3}) EXPECT_NEAR(level[end], line[3], 0.2);
  for (const size_t end : {0, 2}) EXPECT_NEAR(upright[end], line[0], 0.2);
}

// The document of a page has all of it, too.
TEST(FigureTest, JsonHasWhatAPanelHolds) {
  Figure figure = WaveFigure();
  Panel& panel = figure.panels[0];
  panel.y.min = -2;
  panel.circles.push_back({{0.5, 0.25}, 0.125, "#123456"});
  panel.half_planes.push_back({{0, -0.5}, {0, 1}});
  panel.outlines.push_back({"box", {{0, 0}, {1, 0}, {1, 1}, {0, 0}}, Outline::Solid::kOutside});
  panel.reference_lines.push_back({.value = 0.25, .label = "impact", .vertical = true});
  panel.series[0].x[1] = 0.123456789;
  panel.series[0].y[1] = std::numeric_limits<double>::quiet_NaN();
  const nlohmann::ordered_json json = FigureToJson(figure), first = json["panels"][0];
  EXPECT_EQ(json["title"], "Waves");
  EXPECT_EQ(json["panels"].size(), 2u);
  EXPECT_EQ(first["x"]["label"], "time (s)");
  EXPECT_EQ(first["y"]["min"], -2);
  EXPECT_FALSE(first["y"].contains("max"));
  EXPECT_EQ(first["series"][0]["label"], "lcp");
  EXPECT_EQ(first["series"][0]["marker"], "circle");
  EXPECT_EQ(first["series"][0]["x"][1], 0.123457);
  EXPECT_TRUE(first["series"][0]["y"][1].is_null());
  EXPECT_EQ(first["circles"][0]["radius"], 0.125);
  EXPECT_EQ(first["planes"][0]["normal"][1], 1);
  EXPECT_EQ(first["outlines"][0]["solid"], "outside");
  EXPECT_EQ(first["lines"][0]["vertical"], true);
}

TEST(FigureTest, DrawsPanelsWithoutAnythingToShow) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Figure figure;
  figure.panels.resize(3);
  figure.panels[1].series.push_back({.label = "nothing", .x = {0, 1}, .y = {nan, nan}});
  figure.panels[2].y.log = true;
  figure.panels[2].series.push_back({.label = "negative", .x = {0, 1}, .y = {-1, 0}, .marker = Marker::kCircle});
  figure.panels[0].x.min = 5;  // beyond all data
  figure.panels[1].series.push_back({.label = "constant", .x = {0, 1e300}, .y = {7, 7}});
  ExpectWellFormed(Svg(figure));
}

// gnuplot joins what follows each other without an empty line: two paths of two points.
TEST(FigureTest, LineHasAGapWhereDataAreMissing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Figure figure;
  figure.panels.resize(1);
  figure.panels[0].series.push_back({.label = "", .x = {0, 1, 2, 3, 4}, .y = {0, 1, nan, 1, 0}, .colour = "#fedcba"});
  const std::string with_gap = Svg(figure);
  figure.panels[0].series[0].y[2] = 0.5;
  const std::string without = Svg(figure);
  const std::string path = "<path [^>]*stroke=.(?:#fedcba|rgb\\( *254, *220, *186)[^>]* d=.(M[^'\"]*)";
  const auto moves = [&](const std::string& svg) {
    size_t count = 0;
    for (const std::string& found : Matches(svg, path)) count += std::count(found.begin(), found.end(), 'M');
    return count;
  };
  EXPECT_EQ(moves(without), 1u);
  EXPECT_EQ(moves(with_gap), 2u);
}

TEST(FigureTest, PngHasTwiceTheSize) {
  const StatusOr<std::string> png = RenderFigure(WaveFigure(), FigureFormat::kPng);
  ASSERT_TRUE(png.ok()) << png.status().message();
  EXPECT_EQ(png->substr(0, 8), "\x89PNG\r\n\x1a\n");
  const auto* header = reinterpret_cast<const unsigned char*>(png->data());
  EXPECT_EQ(header[18] * 256 + header[19], 1600);  // IHDR width, big-endian
}

TEST(FigureTest, WritesBothFiles) {
  const std::string path = TempFile("figure test");
  const Status status = WriteFigure(WaveFigure(), path);
  ASSERT_TRUE(status.ok()) << status.message();
  EXPECT_THAT(*ReadFile(path + ".svg"), HasSubstr("</svg>"));
  EXPECT_THAT(*ReadFile(path + ".png"), HasSubstr("IHDR"));
  EXPECT_THAT(WriteFigure(WaveFigure(), "/no/such/x").message(), HasSubstr("/no/such/x.svg"));
}

TEST(FigureTest, SaysWhatIsWrongWithGnuplot) {
  EXPECT_EQ(RenderFigure(WaveFigure(), FigureFormat::kSvg, "/no/such/gnuplot").status().message(),
            "figures need gnuplot, and '/no/such/gnuplot' was not found");
  EXPECT_THAT(RenderFigure(WaveFigure(), FigureFormat::kSvg, "false").status().message(), HasSubstr("gnuplot failed"));
}

}  // namespace
}  // namespace saltus
