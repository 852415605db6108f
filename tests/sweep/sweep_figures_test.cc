#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "folders.h"
#include "sweep/figures.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

Request GradientRequest(std::vector<std::string> contacts) {
  Request request;
  request.scene = LoadScene(SourceFolder() + "/problems/two_balls.yaml");
  request.contacts = std::move(contacts);
  return request;
}

// Results as a function of the values of the options: loss and relative error.
std::vector<StoredPoint> MakePoints(const SweepStudy& study, const std::function<double(const SweepRow&)>& loss,
                                    const std::function<double(const SweepRow&)>& error) {
  std::vector<StoredPoint> points;
  for (int64_t point = 0; point < study.size(); ++point) {
    const SweepRow values = study.Values(point);
    PointResult result{PointStatus::kComputed, values};
    for (const SweepValue& value : {SweepValue(loss(values)),
                                    SweepValue(),
                                    SweepValue(),
                                    SweepValue(),
                                    SweepValue(error(values)),
                                    SweepValue("")}) {
      result.row.push_back(value);
    }
    points.push_back({point, result});
  }
  return points;
}

std::vector<std::string> Names(const std::vector<SweepFigure>& figures) {
  std::vector<std::string> names;
  for (const SweepFigure& figure : figures) names.push_back(figure.name);
  return names;
}

double Zero(const SweepRow&) { return 0; }

TEST(Order, IsTheExponentOfAPower) {
  std::vector<double> x, y;
  for (const double at : {0.1, 0.03, 0.01, 0.001}) {
    x.push_back(at);
    y.push_back(7 * std::pow(at, 1.5));
  }
  EXPECT_NEAR(Order(x, y), 1.5, 1e-12);
  x.push_back(1);
  y.push_back(0);  // an exact one says nothing of the order
  EXPECT_NEAR(Order(x, y), 1.5, 1e-12);
  EXPECT_TRUE(std::isnan(Order({1, 2}, {1, 2})));
}

TEST(SweepFigures, LossAgainstOneOptionIsACurvePerModel) {
  const Request request = GradientRequest({"event", "compliant_warp"});
  const SweepStudy study(request, ParseSweep("stiffness=1e2:1e5:log:4", request.scene));
  const auto figures = MakeSweepFigures(study,
                                        MakePoints(
                                            study, [](const SweepRow& row) { return 1 / ToNumber(row[0]); }, Zero));
  ASSERT_THAT(Names(figures), ElementsAre("loss_against_stiffness"));
  const Panel& panel = figures[0].figure.panels.at(0);
  EXPECT_TRUE(panel.x.log);
  EXPECT_EQ(panel.x.label, "stiffness (N/m)");
  int curves = 0;
  for (const Series& series : panel.series) {
    if (!series.line) continue;
    ++curves;
    EXPECT_THAT(series.x, ElementsAre(1e2, 1e3, 1e4, 1e5));
    EXPECT_THAT(series.y, ElementsAre(1e-2, 1e-3, 1e-4, 1e-5));
  }
  EXPECT_EQ(curves, 2);
}

TEST(SweepFigures, AnAxisHasTheScaleOnWhichItsValuesAreEven) {
  const Request request = GradientRequest({"event"});
  for (const auto& [sweep, log] : {std::pair{"steps=120,240,480", true},
                                   std::pair{"steps=100,200,300", false},
                                   std::pair{"damping=0,1,10", false},
                                   std::pair{"stiffness=1e2,1e5", true},
                                   std::pair{"stiffness=1e2,2e2", false}}) {
    const SweepStudy study(request, ParseSweep(sweep, request.scene));
    const auto figures = MakeSweepFigures(study,
                                          MakePoints(
                                              study, [](const SweepRow&) { return 1.0; }, Zero));
    EXPECT_EQ(figures.at(0).figure.panels.at(0).x.log, log) << sweep;
  }
}

TEST(SweepFigures, OtherOptionsAreChosenForTheSmallestLoss) {
  const Request request = GradientRequest({"event"});
  const SweepStudy study(request, ParseSweep("stiffness=1,2; damping=5,3,4", request.scene));
  const auto figures =
      MakeSweepFigures(study,
                       MakePoints(
                           study, [](const SweepRow& row) { return ToNumber(row[0]) * 10 + ToNumber(row[1]); }, Zero));
  ASSERT_THAT(Names(figures),
              ElementsAre("loss_against_stiffness", "loss_against_damping", "loss_map_stiffness_damping"));
  EXPECT_THAT(figures[0].figure.title, HasSubstr("smallest over damping"));
  EXPECT_THAT(figures[0].figure.panels[0].series.back().y, ElementsAre(13, 23));
  EXPECT_THAT(figures[1].figure.panels[0].series.back().y, ElementsAre(13, 14, 15));
}

TEST(SweepFigures, GradientErrorHasItsOrder) {
  const Request request = GradientRequest({"direct", "event"});
  const SweepStudy study(request, ParseSweep("steps=100,200,400; stiffness=1,2", request.scene));
  const auto figures = MakeSweepFigures(study,
                                        MakePoints(
                                            study,
                                            [](const SweepRow&) { return 1.0; },
                                            [](const SweepRow& row) {
                                              const double dt = 1 / ToNumber(row[0]);
                                              return row[2] == "event" ? 0.0 : ToNumber(row[1]) * dt * dt;
                                            }));
  const auto figure = std::find_if(
      figures.begin(), figures.end(), [](const SweepFigure& f) { return f.name == "gradient_error_against_dt"; });
  ASSERT_NE(figure, figures.end());
  std::vector<std::string> labels;
  for (const Series& series : figure->figure.panels[0].series) {
    if (!series.line) continue;
    labels.push_back(series.label);
    if (series.label.starts_with("direct")) {
      EXPECT_THAT(series.x, ElementsAre(1.0 / 400, 1.0 / 200, 1.0 / 100));
      EXPECT_DOUBLE_EQ(series.y[2], 2e-4);  // the larger of two
    }
  }
  EXPECT_THAT(labels, ElementsAre("direct: order 2.00", "event: exact"));
}

// An error that falls with the first power of the step under one stiffness and with the second under the other: the
// larger of the two falls with neither.
TEST(SweepFigures, TheLargestErrorOverAnotherOptionHasNoOrderOfItsOwn) {
  const Request request = GradientRequest({"direct", "event"});
  const auto labels_of = [&](const std::string& sweep, const auto& error) {
    const SweepStudy study(request, ParseSweep(sweep, request.scene));
    const auto figures = MakeSweepFigures(study,
                                          MakePoints(
                                              study, [](const SweepRow&) { return 1.0; }, error));
    std::vector<std::string> labels;
    for (const SweepFigure& figure : figures) {
      if (figure.name != "gradient_error_against_dt") continue;
      for (const Series& series : figure.figure.panels[0].series) {
        if (series.line) labels.push_back(series.label);
      }
    }
    return labels;
  };
  EXPECT_THAT(labels_of("steps=100,200,400; stiffness=1,2",
                        [](const SweepRow& row) {
                          const double dt = 100 / ToNumber(row[0]);
                          if (row[2] == "event") return 0.0;
                          return ToNumber(row[1]) == 1 ? dt : 2 * dt * dt;
                        }),
              ElementsAre("direct: order 1.00 to 2.00", "event: exact"));
  // One number of steps each of several motions is no refinement.
  EXPECT_THAT(
      labels_of("duration=0.5,1,2", [](const SweepRow& row) { return row[1] == "event" ? 0.0 : ToNumber(row[0]); }),
      ElementsAre("direct: too few steps", "event: exact"));
}

TEST(SweepFigures, AMapCoversThePlaneWithOneCellAPair) {
  const Request request = GradientRequest({"event"});
  const SweepStudy study(request, ParseSweep("stiffness=1,10,100; friction=0,1", request.scene));
  const auto figures = MakeSweepFigures(study,
                                        MakePoints(
                                            study, [](const SweepRow& row) { return ToNumber(row[0]); }, Zero));
  const Panel& panel = figures.back().figure.panels.at(0);
  ASSERT_EQ(panel.rectangles.size(), 6u);
  double area = 0;
  for (const Rectangle& cell : panel.rectangles) {
    area += std::log10(cell.to[0] / cell.from[0]) * (cell.to[1] - cell.from[1]);
  }
  EXPECT_NEAR(area, 3 * 2, 1e-12);  // three decades by two units, without gaps
  EXPECT_EQ(panel.rectangles[0].colour, panel.rectangles[1].colour);
  EXPECT_NE(panel.rectangles[0].colour, panel.rectangles[2].colour);
}

TEST(SweepFigures, OptionsThatMoveTogetherHaveNoMap) {
  const Request request = GradientRequest({"event"});
  const SweepStudy study(request, ParseSweep("stiffness=1,2,3,4,5&damping=1,2,3,4,5", request.scene));
  const auto figures = MakeSweepFigures(study,
                                        MakePoints(
                                            study, [](const SweepRow&) { return 1.0; }, Zero));
  for (const SweepFigure& figure : figures) EXPECT_THAT(figure.name, Not(HasSubstr("map")));
}

TEST(SweepFigures, NothingComputedIsNoFigure) {
  const Request request = GradientRequest({"event"});
  const SweepStudy study(request, ParseSweep("stiffness=1,2", request.scene));
  EXPECT_TRUE(MakeSweepFigures(study, {}).empty());
}

}  // namespace
}  // namespace saltus
