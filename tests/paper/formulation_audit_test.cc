// Table and figure of all formulations, for a few of them.
#include <gmock/gmock.h>

#include <cstdlib>

#include "base/csv.h"
#include "paper/experiments.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;

class Formulations : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const auto audit =
        AuditFormulations({{"One bounce", ProblemScene("bounce_once")}, {"Two balls", ProblemScene("two_balls")}},
                          {"direct", "event", "soft_convex", "smooth_compliant"},
                          {},
                          2,
                          ProgressMode::kNone);
    ASSERT_TRUE(audit.has_value());
    audit_ = new Section(*audit);
  }
  static std::string Get(size_t row, const std::string& column) {
    const CsvDocument csv = *ParseCsv(audit_->tables.at(0).table.ToCsv());
    return csv.rows[row][*csv.Find(column)];
  }
  static double Number(size_t row, const std::string& column) { return std::stod(Get(row, column)); }

  static Section* audit_;
};

Section* Formulations::audit_ = nullptr;

// The exact gradient by the initial state is (-1, -1) in task 1, that of `direct` (1, -0.1); in task 3 all is known.
TEST_F(Formulations, LossesAndErrorsAreThoseOfTheTasks) {
  EXPECT_NEAR(Number(0, "error, task 1"), std::hypot(2.0, 0.9) / std::sqrt(2.0), 1e-2);
  EXPECT_LT(Number(1, "error, task 1"), 1e-9);
  EXPECT_NEAR(Number(1, "loss, task 2"), 2.059143506, 1e-8);
  EXPECT_NEAR(Number(4, "loss, task 1"), 1.2, 1e-9);
  EXPECT_EQ(Get(4, "contact"), "exact");
  EXPECT_EQ(Get(0, "verdict, task 1"), "wrong sign");
  EXPECT_EQ(Get(1, "verdict, task 2"), "right");
}

TEST_F(Formulations, ClassesAreJoinedWhereTasksAgree) {
  EXPECT_EQ(Get(0, "class"), "impulse at a step boundary");
  EXPECT_EQ(Get(2, "class"), "continuous force (1), force with a jump (2)");
  EXPECT_THAT(audit_->findings,
              Contains(AllOf(HasSubstr("continuous force"), HasSubstr("`smooth_compliant`"), HasSubstr("in task 1"))));
}

TEST_F(Formulations, CostsAreThoseOfDirect) {
  EXPECT_EQ(Number(0, "cost of a step"), 1);
  EXPECT_GT(Number(3, "cost of a step"), 1);  // four substeps
  const Figure figure = audit_->figures.at(0).figure;
  ASSERT_EQ(figure.panels.size(), 2u);
  for (const Panel& panel : figure.panels) {
    ASSERT_EQ(panel.series.size(), 4u);
    for (const Series& series : panel.series) {
      EXPECT_EQ(series.x.size(), 1u);
      EXPECT_NE(series.marker, Marker::kNone);
    }
  }
}

}  // namespace
}  // namespace saltus
