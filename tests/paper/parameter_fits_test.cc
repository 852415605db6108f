// The fits of parameters under every contact model: the exact one finds them, and what is found of the others.
#include <gmock/gmock.h>

#include <cstdlib>

#include "paper/experiments.h"
#include "paper_tables.h"

namespace saltus {
namespace {

double Number(const CsvDocument& csv, size_t row, const std::string& column) {
  return std::atof(Get(csv, row, column).c_str());
}

// `event` is within four of its standard errors from either recording; `primal_descent` reads no restitution; `direct`,
// whose gradient has the wrong sign at an impact, does not find the optimum of its own motion, where the misfit is 1.
TEST(ParameterFits, ExactGradientsFindTheParametersAndWrongOnesDoNot) {
  const auto fits = FitParameters({"event", "direct", "primal_descent", "position_qp"}, 2, ProgressMode::kNone);
  ASSERT_TRUE(fits.has_value());
  const CsvDocument csv = FindTable(fits->tables, "parameter_fits");
  ASSERT_EQ(csv.rows.size(), 6u);
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    const std::string contact = Get(csv, row, "contact"), of = Get(csv, row, "recording of");
    if (contact == "event") {
      EXPECT_EQ(Get(csv, row, "verdict"), "fits") << of;
      EXPECT_NEAR(Number(csv, row, "restitution"), 0.75, 4 * 5e-3) << of;
      EXPECT_NEAR(Number(csv, row, "mass"), 0.6, 4 * 1e-2) << of;
      EXPECT_NEAR(Number(csv, row, "misfit"), 1, 0.15) << of;
    } else if (contact == "primal_descent") {
      EXPECT_EQ(Get(csv, row, "restitution"), "not determined") << of;
    } else if (of == "its own motion") {
      EXPECT_GT(Number(csv, row, "misfit"), 1.5);
    }
  }
}

// The learned curve against the law by its formula.
TEST(LearnALaw, FindsTheLawThatMadeTheRecordings) {
  const std::optional<PaperFigure> example = LearnALaw();
  ASSERT_TRUE(example.has_value());
  for (const Series& series : example->figure.panels.at(0).series) {
    if (series.label != "learned") continue;
    ASSERT_GT(series.x.size(), 10u);
    EXPECT_GT(series.x.back(), 2 * series.x.front());
    for (size_t i = 0; i < series.x.size(); ++i) EXPECT_NEAR(series.y[i], 0.9 / (1 + 0.12 * series.x[i]), 0.02);
    return;
  }
  ADD_FAILURE() << "nothing was learned";
}

TEST(ParameterFits, FindingsTellTheModelsApart) {
  const auto fits = FitParameters({"event", "direct", "primal_descent", "position_qp"}, 2, ProgressMode::kNone);
  ASSERT_TRUE(fits.has_value());
  const std::vector<std::string> findings = fits->findings;
  ASSERT_EQ(findings.size(), 3u);
  EXPECT_THAT(findings[0], testing::HasSubstr("under `event`, `primal_descent`."));
  EXPECT_THAT(findings[1], testing::HasSubstr("under `direct`:"));
  EXPECT_THAT(findings[2], testing::HasSubstr("under `event`."));
}

}  // namespace
}  // namespace saltus
