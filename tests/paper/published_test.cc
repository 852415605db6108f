// Every number that the paper prints, at its precision and within its tolerance, from what saltus_reproduce runs.
#include "paper/published.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "saltus/dynamics/registry.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::Pair;

class Published : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    experiments_ = new Experiments(SALTUS_SOURCE_DIR "/problems");
    ASSERT_TRUE(experiments_->Run(2, ProgressMode::kNone));
    rows_ = new std::vector<PublishedRow>(ReadPublished(SALTUS_SOURCE_DIR "/data/published.csv"));
    CompareWithPublished(*experiments_, rows_);
  }

  static Experiments* experiments_;
  static std::vector<PublishedRow>* rows_;
};

Experiments* Published::experiments_ = nullptr;
std::vector<PublishedRow>* Published::rows_ = nullptr;

TEST_F(Published, EveryNumber) {
  std::map<std::string, int> rows_of_table;
  for (const PublishedRow& row : *rows_) {
    ++rows_of_table[row.table];
    const std::string name = row.table + " " + row.problem + " " + row.contact + " " + row.quantity;
    ASSERT_TRUE(row.ours) << name << " is not computed";
    if (!row.IsJudged()) continue;
    EXPECT_NEAR(*row.ours, row.expected, row.tolerance) << name;
  }
  EXPECT_THAT(
      rows_of_table,
      ElementsAre(Pair("F5", 8), Pair("L4DC", 2), Pair("T1", 27), Pair("T2", 36), Pair("T3", 60), Pair("T4", 28)));
}

TEST_F(Published, ARowOutsideItsToleranceDoesNotMatch) {
  PublishedRow row = rows_->front();
  ASSERT_TRUE(row.Matches());
  row.ours = row.expected + 2 * row.tolerance;
  EXPECT_FALSE(row.Matches());
  row.ours.reset();
  EXPECT_FALSE(row.Matches());
}

TEST_F(Published, ResultsDoNotDependOnTheNumberOfThreads) {
  Experiments alone(SALTUS_SOURCE_DIR "/problems");
  ASSERT_TRUE(alone.Run(1, ProgressMode::kNone));
  ASSERT_EQ(alone.all().size(), experiments_->all().size());
  for (size_t i = 0; i < alone.all().size(); ++i) {
    const Experiment& one = alone.all()[i];
    const Experiment& two = experiments_->all()[i];
    EXPECT_EQ(one.gradient.gradient.initial, two.gradient.gradient.initial);
    for (size_t r = 0; r < one.runs.size(); ++r) EXPECT_EQ(one.runs[r].report.losses, two.runs[r].report.losses);
  }
}

}  // namespace
}  // namespace saltus
