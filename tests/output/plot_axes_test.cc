#include "output/plot_axes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace saltus::internal {
namespace {

using testing::ElementsAre;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const Box kBox{0, 400, 0, 200};

std::vector<std::string> Labels(const std::vector<Tick>& ticks) {
  std::vector<std::string> labels;
  for (const Tick& tick : ticks) {
    if (!tick.label.empty()) labels.push_back(tick.label);
  }
  return labels;
}

Panel PanelOf(std::vector<double> x, std::vector<double> y) {
  Panel panel;
  panel.series.push_back({.label = "", .x = std::move(x), .y = std::move(y)});
  return panel;
}

TEST(LinearTicksTest, AreRoundAndEquallyWritten) {
  EXPECT_THAT(Labels(LinearTicks({-0.02, 1.02}, 5)), ElementsAre("0.0", "0.5", "1.0"));
  EXPECT_THAT(Labels(LinearTicks({-1, 1}, 4)), ElementsAre("−1.0", "−0.5", "0.0", "0.5", "1.0"));
  EXPECT_THAT(Labels(LinearTicks({0, 1000}, 5)), ElementsAre("0", "200", "400", "600", "800", "1000"));
  EXPECT_THAT(Labels(LinearTicks({1.3965420, 1.3965424}, 4)),
              ElementsAre("1.3965420", "1.3965421", "1.3965422", "1.3965423", "1.3965424"));
}

TEST(LinearTicksTest, UsePowersOfTenFarFromOne) {
  EXPECT_THAT(Labels(LinearTicks({0, 2e-7}, 4)), ElementsAre("0", "0.5×10⁻⁷", "1.0×10⁻⁷", "1.5×10⁻⁷", "2.0×10⁻⁷"));
  EXPECT_THAT(Labels(LinearTicks({-2e6, 2e6}, 2)), ElementsAre("−2×10⁶", "0", "2×10⁶"));
}

TEST(LogTicksTest, ChooseBySpan) {
  EXPECT_THAT(Labels(LogTicks({0.5e-3, 20})), ElementsAre("10⁻³", "10⁻²", "10⁻¹", "10⁰", "10¹"));
  EXPECT_THAT(Labels(LogTicks({1e-16, 1})), ElementsAre("10⁻¹⁶", "10⁻¹³", "10⁻¹⁰", "10⁻⁷", "10⁻⁴", "10⁻¹"));
  EXPECT_THAT(Labels(LogTicks({60, 2000})), ElementsAre("100", "200", "500", "1000", "2000"));
  EXPECT_THAT(Labels(LogTicks({1.39, 1.44})), ElementsAre("1.39", "1.40", "1.41", "1.42", "1.43", "1.44"));
}

TEST(LogTicksTest, StayWithinTheRange) {
  for (const Range range : {Range{0.5e-3, 20}, Range{60, 2000}, Range{3e-9, 4e5}, Range{0.9, 11}}) {
    for (const Tick& tick : LogTicks(range)) {
      EXPECT_GE(tick.value, range.min * (1 - 1e-9));
      EXPECT_LE(tick.value, range.max * (1 + 1e-9));
    }
  }
}

// Losses of any size are drawn: the ends of the axis and its ticks are numbers.
TEST(AxisRangesTest, OfAnyNumbersHaveTicks) {
  constexpr double kLargest = std::numeric_limits<double>::max(), kLeast = std::numeric_limits<double>::denorm_min();
  for (const bool log : {false, true}) {
    for (const std::vector<double>& y : {std::vector<double>{kLeast, 1},
                                         std::vector<double>{1, kLargest},
                                         std::vector<double>{kLeast, kLargest},
                                         std::vector<double>{-kLargest, kLargest},
                                         std::vector<double>{kLargest, kLargest},
                                         std::vector<double>{kLeast, kLeast}}) {
      Panel panel = PanelOf({0, 1}, y);
      panel.y.log = log;
      const Range range = AxisRanges(panel, kBox).second;
      EXPECT_TRUE(std::isfinite(range.min) && std::isfinite(range.max)) << range.min << " to " << range.max;
      EXPECT_LT(range.min, range.max);
      const std::vector<Tick> ticks = log ? LogTicks(range) : LinearTicks(range, 5);
      EXPECT_FALSE(ticks.empty());
      EXPECT_LT(Labels(ticks).size(), 100u);
    }
  }
}

TEST(AxisRangesTest, CoverDataWithAMargin) {
  const auto [x, y] = AxisRanges(PanelOf({0, 10, kNan}, {1, kNan, -3}), kBox);
  EXPECT_DOUBLE_EQ(x.min, -0.2);
  EXPECT_DOUBLE_EQ(x.max, 10.2);
  EXPECT_DOUBLE_EQ(y.min, -3.2);
  EXPECT_DOUBLE_EQ(y.max, 1.2);
}

TEST(AxisRangesTest, CoverShapesAndReferenceLines) {
  Panel panel = PanelOf({0}, {0});
  panel.circles.push_back({{4, 2}, 1});
  panel.segments.push_back({{-5, 0}, {0, -7}});
  panel.reference_lines.push_back({.value = 9, .label = ""});
  const auto [x, y] = AxisRanges(panel, kBox);
  EXPECT_NEAR(x.min, -5 - 0.02 * 10, 1e-12);
  EXPECT_NEAR(x.max, 5 + 0.02 * 10, 1e-12);
  EXPECT_NEAR(y.min, -7 - 0.05 * 16, 1e-12);
  EXPECT_NEAR(y.max, 9 + 0.05 * 16, 1e-12);
}

TEST(AxisRangesTest, LogarithmicAxesIgnoreWhatTheyCannotShow) {
  Panel panel = PanelOf({1, 2, 3}, {0, 1, 100});
  panel.y.log = true;
  const Range y = AxisRanges(panel, kBox).second;
  EXPECT_NEAR(std::log10(y.min), -0.1, 1e-12);
  EXPECT_NEAR(std::log10(y.max), 2.1, 1e-12);
}

TEST(AxisRangesTest, ThereIsAlwaysARange) {
  for (const bool log : {false, true}) {
    for (const double value : {0.0, -2.0, 1e-200, 1e200, 5.0, kNan}) {
      Panel panel = PanelOf({value}, {value});
      panel.x.log = panel.y.log = log;
      const auto [x, y] = AxisRanges(panel, kBox);
      EXPECT_LT(x.min, x.max) << value;
      EXPECT_LT(y.min, y.max) << value;
      EXPECT_FALSE((log ? LogTicks(y) : LinearTicks(y, 4)).empty()) << value;
    }
  }
}

TEST(AxisRangesTest, StatedEndsHoldEvenWithAllDataBeyond) {
  Panel panel = PanelOf({0, 1}, {5, 6});
  panel.y.max = 3;
  EXPECT_DOUBLE_EQ(AxisRanges(panel, kBox).second.min, 2);
  EXPECT_DOUBLE_EQ(AxisRanges(panel, kBox).second.max, 3);
  panel.y.min = -1;
  EXPECT_DOUBLE_EQ(AxisRanges(panel, kBox).second.min, -1);
}

TEST(AxisRangesTest, EqualAspectGivesEqualScales) {
  Panel panel = PanelOf({-1, 1}, {0, 5});
  panel.equal_aspect = true;
  const auto [x, y] = AxisRanges(panel, kBox);
  EXPECT_NEAR(Span(x) / 400, Span(y) / 200, 1e-12);
  EXPECT_NEAR((x.min + x.max) / 2, 0, 1e-12);
  EXPECT_LT(y.min, 0);
}

// Distance of a point from a polyline, by trying all its segments.
double Distance(double x, double y, const std::vector<double>& px, const std::vector<double>& py,
                const std::vector<size_t>& kept) {
  double smallest = std::hypot(x - px[kept[0]], y - py[kept[0]]);
  for (size_t k = 0; k + 1 < kept.size(); ++k) {
    const double dx = px[kept[k + 1]] - px[kept[k]];
    const double dy = py[kept[k + 1]] - py[kept[k]];
    const double along = ((x - px[kept[k]]) * dx + (y - py[kept[k]]) * dy) / (dx * dx + dy * dy);
    const double t = std::min(1.0, std::max(0.0, along));
    smallest = std::min(smallest, std::hypot(x - px[kept[k]] - t * dx, y - py[kept[k]] - t * dy));
  }
  return smallest;
}

TEST(SimplifyLineTest, StaysWithinTheTolerance) {
  std::vector<double> x;
  std::vector<double> y;
  for (int i = 0; i < 500; ++i) {
    const double t = i / 20.0;
    x.push_back(20 * std::cos(t) + 3 * t);
    y.push_back(std::abs(40 * std::sin(0.7 * t)));
  }
  const std::vector<size_t> kept = SimplifyLine(x, y, 0.1);
  EXPECT_LT(kept.size(), 350u);
  EXPECT_EQ(kept.front(), 0u);
  EXPECT_EQ(kept.back(), 499u);
  for (size_t i = 0; i < x.size(); ++i) EXPECT_LE(Distance(x[i], y[i], x, y, kept), 0.1 + 1e-12);
}

TEST(SimplifyLineTest, KeepsWhatMatters) {
  EXPECT_THAT(SimplifyLine({0, 1, 2, 3}, {0, 0, 0, 0}, 0.1), ElementsAre(0, 3));
  EXPECT_THAT(SimplifyLine({0, 1, 2, 3}, {0, 0, 5, 0}, 0.1), ElementsAre(0, 1, 2, 3));
  EXPECT_THAT(SimplifyLine({0, 9, 0}, {0, 0, 0}, 0.1), ElementsAre(0, 1, 2));  // there and back
  EXPECT_THAT(SimplifyLine({0, 9, 2}, {0, 0, 0}, 0.1), ElementsAre(0, 1, 2));
  EXPECT_THAT(SimplifyLine({7}, {7}, 0.1), ElementsAre(0));
  EXPECT_THAT(SimplifyLine({}, {}, 0.1), ElementsAre());
}

}  // namespace
}  // namespace saltus::internal
