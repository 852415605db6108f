#include "output/figure.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

namespace saltus {
namespace {

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
  return figure;
}

// The document of a page has all that a panel holds.
TEST(FigureTest, JsonHasWhatAPanelHolds) {
  Figure figure = WaveFigure();
  Panel& panel = figure.panels[0];
  panel.y.min = -2;
  panel.circles.push_back({{"centre", {0.5, 0.25}}, {"radius", 0.125}, {"colour", "#123456"}});
  panel.half_planes.push_back({{"point", {0, -0.5}}, {"normal", {0, 1}}});
  panel.outlines.push_back({{"name", "box"}, {"points", {{0, 0}, {1, 0}, {1, 1}, {0, 0}}}, {"solid", "outside"}});
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
  EXPECT_EQ(first["half_planes"][0]["normal"][1], 1);
  EXPECT_EQ(first["outlines"][0]["solid"], "outside");
  EXPECT_EQ(first["reference_lines"][0]["vertical"], true);
}

}  // namespace
}  // namespace saltus
