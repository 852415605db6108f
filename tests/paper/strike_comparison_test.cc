// The comparison of solvers at the impact: nothing is missing, nothing is better than possible, and forces stay within
// their bounds.
#include <gmock/gmock.h>

#include <cmath>
#include <cstdlib>
#include <set>

#include "folders.h"
#include "paper/experiments.h"
#include "paper_tables.h"
#include "test_scenes.h"

namespace saltus {
namespace {

class Strike : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const auto references = ReadBoundedReferences(SourceFolder() + "/data/constrained_references.json");
    const auto compared = CompareStrikes(ProblemScene("two_balls"), references, 2, ProgressMode::kNone);
    ASSERT_TRUE(compared.has_value());
    comparison_ = new Section(*compared);
  }
  static CsvDocument Find(const std::string& name) { return FindTable(comparison_->tables, name); }
  static double Gap(const std::string& steps, const std::string& solver) {
    const CsvDocument csv = Find("strike");
    for (size_t row = 0; row < csv.rows.size(); ++row) {
      if (Get(csv, row, "steps") == steps && Get(csv, row, "solver") == solver) {
        return std::atof(Get(csv, row, "gap").c_str());
      }
    }
    ADD_FAILURE() << "no row of " << solver;
    return NAN;
  }

  static Section* comparison_;
};

Section* Strike::comparison_ = nullptr;

TEST_F(Strike, HasEverySolverOnBothGridsAndNoneBelowTheOptimum) {
  for (const char* steps : {"480", "1000"}) {
    for (const char* solver :
         {"gd, rate per step", "gd, rate per time", "ceres_lm", "ceres_phases", "ceres_event", "hmp"}) {
      EXPECT_GT(Gap(steps, solver), 0) << solver << " on " << steps;
    }
  }
}

TEST_F(Strike, AtARatePerTimeAFinerGridIsNoWorse) {
  EXPECT_NEAR(Gap("480", "gd, rate per time"), Gap("480", "gd, rate per step"), 1e-9);
  EXPECT_NEAR(Gap("1000", "gd, rate per step"), 1.4150 - 1.396542160, 5e-5);  // as the paper's rate leaves it
  EXPECT_LT(Gap("1000", "gd, rate per time"), 0.5 * Gap("1000", "gd, rate per step"));
}

TEST_F(Strike, PhasesGainWithTheSquareOfTheStep) {
  const double order = std::log(Gap("480", "ceres_phases") / Gap("1000", "ceres_phases")) / std::log(1000.0 / 480);
  EXPECT_NEAR(order, 2, 0.05);
}

TEST_F(Strike, ForcesStayWithinTheirBounds) {
  const CsvDocument csv = Find("strike_bounded");
  std::set<std::string> solvers;
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    EXPECT_LE(std::atof(Get(csv, row, "largest force of the bound").c_str()), 1 + 1e-12);
    // Not to strike at all may be better.
    if (Get(csv, row, "impacts") != "0") {
      EXPECT_GT(std::atof(Get(csv, row, "gap").c_str()), 0);
    }
    solvers.insert(Get(csv, row, "solver"));
    if (Get(csv, row, "solver") == "ceres_phases") {
      EXPECT_LT(std::atof(Get(csv, row, "gap").c_str()), 1e-6);
    }
  }
  EXPECT_THAT(solvers, testing::UnorderedElementsAre("gd, rate per step", "ceres_lm", "ceres_phases", "hmp"));
}

TEST(BoundedReferences, AreWithinTheirBounds) {
  const auto references = ReadBoundedReferences(SourceFolder() + "/data/constrained_references.json");
  ASSERT_EQ(references.size(), 4u);
  for (const BoundedReference& reference : references) {
    const Vec2d first = reference.Force(0), last = reference.Force(reference.impact_time);
    EXPECT_EQ(reference.max ? first.cwiseAbs().maxCoeff() : first.norm(),
              reference.max ? *reference.max : *reference.max_norm);
    EXPECT_NEAR((last - reference.at_impact).norm(), 0, 1e-15);
    EXPECT_EQ(reference.Force(reference.impact_time + 1e-6), Vec2d(0, 0));
  }
  EXPECT_THROW(ReadBoundedReferences("/nowhere.json"), std::runtime_error);
}

}  // namespace
}  // namespace saltus
