#include "output/figure.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <regex>
#include <set>

#include "base/file.h"
#include "output/drawn_figure.h"
#include "output/figure_layout.h"
#include "output/figure_script.h"

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

TEST(FigureTest, SvgIsOneScalableElementWithTheText) {
  const StatusOr<std::string> svg = RenderSvg(WaveFigure(), "waves");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  EXPECT_THAT(*svg, testing::StartsWith("<svg role=\"img\""));
  EXPECT_THAT(*svg, HasSubstr("viewBox=\"0 0 800 "));
  EXPECT_THAT(*svg, HasSubstr("<title>Waves</title>"));
  EXPECT_THAT(*svg, Not(HasSubstr("GNUPLOT")));
  for (const char* text : {"left", "right", "time (s)", "height (m)", "direct_toi", "−0.5"}) {
    EXPECT_THAT(*svg, HasSubstr(std::string("<text>") + text + "</text>"));
  }
  EXPECT_THAT(*svg, HasSubstr("font-weight=\"bold\""));
  ExpectWellFormed(*svg);
}

TEST(FigureTest, IdsArePrefixedUniqueAndAllReferencesResolve) {
  const StatusOr<std::string> svg = RenderSvg(WaveFigure(), "f1");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  std::set<std::string> ids;
  for (const std::string& id : Matches(*svg, "\\sid=[\"']([^\"']*)[\"']")) {
    EXPECT_THAT(id, testing::StartsWith("f1-"));
    EXPECT_TRUE(ids.insert(id).second) << id;
  }
  const std::vector<std::string> references = Matches(*svg, "(?:href=[\"']#|url\\(#)([^\"')]*)");
  EXPECT_GT(references.size(), 20u);  // the markers
  for (const std::string& reference : references) EXPECT_TRUE(ids.contains(reference)) << reference;
}

TEST(FigureTest, LegendNamesEachLabelOnce) {
  const StatusOr<std::string> svg = RenderSvg(WaveFigure(), "f");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  EXPECT_EQ(Matches(*svg, "<text>(lcp)</text>").size(), 1u);
  Figure figure = WaveFigure();
  figure.legend = Legend::kNone;
  EXPECT_THAT(*RenderSvg(figure, "f"), Not(HasSubstr("<text>lcp</text>")));
}

TEST(FigureTest, TextIsNeverMarkupNorCommands) {
  const std::string nasty = "it's <b>\"&\" `id` _a ^b @c {d} \\n %g\n'; system('touch /tmp/x'); #$";
  Figure figure = WaveFigure();
  figure.title = nasty;
  Panel& panel = figure.panels[0];
  panel.title = panel.x.label = panel.y.label = panel.series[0].label = nasty;
  panel.reference_lines.push_back({.value = 0.5, .label = nasty + " id='x'"});
  const StatusOr<std::string> svg = RenderSvg(figure, "f");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  ExpectWellFormed(*svg);
  EXPECT_THAT(*svg, Not(HasSubstr("<b>")));
  EXPECT_THAT(*svg, HasSubstr("`id` _a ^b @c {d} \\n %g '; system('touch /tmp/x'); #$"));
  EXPECT_THAT(*svg, HasSubstr(" id='x'</text>"));
  EXPECT_TRUE(RenderPng(figure).ok());
}

TEST(FigureTest, DrawsEverythingThatAPanelCanHold) {
  Figure figure = WaveFigure();
  Panel& panel = figure.panels[0];
  panel.equal_aspect = true;
  panel.circles.push_back({{0.5, 0.5}, 0.2, "#123456"});
  panel.segments.push_back({{0, 0}, {1, 1}, "#654321", 2, true});
  panel.half_planes.push_back({{0, -0.5}, {0.1, 1}});
  panel.half_planes.push_back({{0, -500}, {0, 1}});  // out of sight
  panel.reference_lines.push_back({.value = 0.25, .label = "impact", .vertical = true, .colour = "#abcdef"});
  const StatusOr<std::string> svg = RenderSvg(figure, "f");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  ExpectWellFormed(*svg);
  for (const char* colour : {"#123456", "#654321", "#abcdef", internal::kGround}) {
    EXPECT_THAT(*svg, HasSubstr(colour));
  }
  EXPECT_THAT(*svg, HasSubstr("<text>impact</text>"));
}

TEST(FigureTest, AThousandDiscsStaySmall) {
  Figure figure;
  figure.panels.resize(1);
  figure.panels[0].equal_aspect = true;
  for (int i = 0; i < 1000; ++i) figure.panels[0].circles.push_back({{1.0 * (i % 32), 1.0 * (i / 32)}, 0.4});
  const StatusOr<std::string> svg = RenderSvg(figure, "f");
  ASSERT_TRUE(svg.ok()) << svg.status().message();
  ExpectWellFormed(*svg);
  EXPECT_LT(svg->size(), 1500u * 1000);
}

TEST(FigureTest, DrawsPanelsWithoutAnythingToShow) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Figure figure;
  figure.panels.resize(3);
  figure.panels[1].series.push_back({.label = "nothing", .x = {0, 1}, .y = {nan, nan}});
  figure.panels[2].y.log = true;
  figure.panels[2].series.push_back({.label = "negative", .x = {0, 1}, .y = {-1, 0}, .marker = Marker::kCircle});
  const StatusOr<std::string> svg = RenderSvg(figure, "f");
  EXPECT_TRUE(svg.ok()) << svg.status().message();
}

TEST(FigureTest, LineHasAGapWhereDataAreMissing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Figure figure;
  figure.panels.resize(1);
  figure.panels[0].series.push_back({.label = "a", .x = {0, 1, 2, 3, 4}, .y = {0, 1, nan, 1, 0}});
  EXPECT_THAT(internal::GnuplotScript(figure, internal::Terminal::kSvg), HasSubstr("0 0\n1 1\n\n3 1\n4 0\nEOD"));
}

TEST(FigureTest, PngHasTwiceTheSize) {
  const StatusOr<std::string> png = RenderPng(WaveFigure());
  ASSERT_TRUE(png.ok()) << png.status().message();
  EXPECT_EQ(png->substr(0, 8), "\x89PNG\r\n\x1a\n");
  const auto* header = reinterpret_cast<const unsigned char*>(png->data());
  EXPECT_EQ(header[18] * 256 + header[19], 1600);  // IHDR width, big-endian
}

TEST(FigureTest, WritesTheFilesAskedFor) {
  const std::string svg_path = testing::TempDir() + "figure test.svg";
  const std::string png_path = testing::TempDir() + "figure test.png";
  const Status status = WriteFigure(WaveFigure(), svg_path, png_path);
  ASSERT_TRUE(status.ok()) << status.message();
  EXPECT_THAT(*ReadFile(svg_path), HasSubstr("id=\"figure-figure-test-"));
  EXPECT_THAT(*ReadFile(png_path), HasSubstr("IHDR"));
  EXPECT_TRUE(WriteFigure(WaveFigure(), "", "").ok());
  EXPECT_THAT(WriteFigure(WaveFigure(), "/no/such/x.svg", "").message(), HasSubstr("/no/such/x.svg"));
}

TEST(FigureTest, SaysWhatIsWrongWithGnuplot) {
  EXPECT_EQ(RenderSvg(WaveFigure(), "f", "/no/such/gnuplot").status().message(),
            "figures need gnuplot, and '/no/such/gnuplot' was not found");
  EXPECT_THAT(RenderSvg(WaveFigure(), "f", "false").status().message(), HasSubstr("gnuplot failed"));
}

TEST(LayoutTest, NothingOverlaps) {
  for (const Legend legend : {Legend::kRight, Legend::kBelow, Legend::kNone}) {
    Figure figure = WaveFigure();
    figure.legend = legend;
    figure.panels.push_back(WavePanel(""));
    std::vector<internal::Box> boxes = internal::LayOut(figure).plots;
    const internal::Layout layout = internal::LayOut(figure);
    if (legend != Legend::kNone) boxes.push_back(layout.legend);
    for (size_t i = 0; i < boxes.size(); ++i) {
      EXPECT_LT(boxes[i].left, boxes[i].right);
      EXPECT_LT(boxes[i].bottom, boxes[i].top);
      EXPECT_GE(std::min(boxes[i].left, boxes[i].bottom), 0);
      EXPECT_LE(boxes[i].right, layout.width);
      EXPECT_LE(boxes[i].top, layout.height);
      for (size_t j = 0; j < i; ++j) {
        const bool apart = boxes[i].left >= boxes[j].right || boxes[j].left >= boxes[i].right ||
                           boxes[i].bottom >= boxes[j].top || boxes[j].bottom >= boxes[i].top;
        EXPECT_TRUE(apart) << i << " and " << j;
      }
    }
  }
}

TEST(FigureTest, LabelsOfALogarithmicAxisDoNotTouch) {
  Axis axis;
  axis.log = true;
  const internal::Range range = {1.9e-5, 2.3e-3};
  size_t fewest = 100;
  for (const double width : {150.0, 250.0, 1000.0}) {
    std::vector<std::string> labels;
    double end = -HUGE_VAL;
    for (const internal::Tick& tick : internal::TicksX(axis, range, {0, width, 0, 100})) {
      if (tick.label.empty()) continue;
      const double middle = width * std::log(tick.value / range.min) / std::log(range.max / range.min);
      const double half = 0.5 * internal::kCharacter * static_cast<double>(internal::LengthOf(tick.label));
      EXPECT_GT(middle - half, end) << tick.label << " at a width of " << width;
      end = middle + half;
      labels.push_back(tick.label);
    }
    EXPECT_THAT(labels, testing::IsSupersetOf({"0.0001", "0.001"}));
    fewest = std::min(fewest, labels.size());
  }
  EXPECT_LT(fewest, 7u);
}

TEST(FigureTest, DrawnOnceItStandsOnSeveralPages) {
  const Figure figure = WaveFigure();
  const StatusOr<DrawnFigure> drawn = DrawnFigure::Draw(figure);
  ASSERT_TRUE(drawn.ok());
  for (const char* prefix : {"one", "other"}) EXPECT_EQ(drawn->Svg(prefix), *RenderSvg(figure, prefix));
  EXPECT_NE(drawn->Svg("one"), drawn->Svg("other"));
  EXPECT_FALSE(DrawnFigure::Draw(figure, "/no/such/gnuplot").ok());
}

}  // namespace
}  // namespace saltus
