// Audits that are told to stop: what they have found stays, and is what they would have found.
#include <gtest/gtest.h>

#include <cstdint>

#include "saltus/audit/audit.h"
#include "test_scenes.h"

namespace saltus {
namespace {

class InterruptedAudit : public testing::Test {
 protected:
  // Stopped at the question after the first `most`.
  ModelAudit StopAfter(int64_t most) {
    asked_ = 0;
    AuditOptions options;
    options.width_sweep = true;
    options.stop = [this, most] { return ++asked_ > most; };
    return AuditModel("direct_toi", scene_, Precision::kDouble, exact_, options);
  }

  // How many of its studies there are.
  static int StageOf(const ModelAudit& audit) {
    return audit.gradient.ok() + audit.recognition.has_value() + audit.refinement.has_value() +
           audit.attribution.has_value() + audit.widths.has_value();
  }

  Scene scene_ = ProblemScene("two_balls");
  std::optional<ModelGradient> exact_ = ComputeExactGradient(scene_);
  int64_t asked_ = 0;
};

TEST_F(InterruptedAudit, KeepsTheStudiesThatAreWhole) {
  constexpr int kStudies = 5;
  const ModelAudit whole = StopAfter(int64_t{1} << 60);
  const int64_t questions = asked_;
  ASSERT_FALSE(whole.interrupted);
  ASSERT_EQ(StageOf(whole), kStudies);
  for (int stage = 0; stage < kStudies; ++stage) {
    // The first question of each study.
    int64_t from = 0, to = questions;
    while (from < to) {
      const int64_t middle = (from + to) / 2;
      if (StageOf(StopAfter(middle)) >= stage) {
        to = middle;
      } else {
        from = middle + 1;
      }
    }
    const ModelAudit audit = StopAfter(from);
    ASSERT_EQ(StageOf(audit), stage);
    EXPECT_TRUE(audit.interrupted);
    if (stage == 0) {
      EXPECT_EQ(audit.gradient.reason, kStopped);
      continue;
    }
    EXPECT_EQ(audit.VerdictReason(), "interrupted");
    EXPECT_EQ(audit.gradient.gradient.control, whole.gradient.gradient.control);
    EXPECT_EQ(audit.verdict, stage > 2 ? whole.verdict : Verdict::kUnknown);
    if (audit.recognition) {
      EXPECT_EQ(audit.recognition->words, whole.recognition->words);
    }
    if (audit.attribution) {
      EXPECT_EQ(audit.attribution->first_wrong, whole.attribution->first_wrong);
    }
  }
}

TEST_F(InterruptedAudit, ThereIsNoReferenceThen) {
  EXPECT_FALSE(ComputeExactGradient(scene_, [] { return true; }));
}

}  // namespace
}  // namespace saltus
