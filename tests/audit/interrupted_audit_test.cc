// Audits that are told to stop: what they have found stays, and is what they would have found.
#include <gtest/gtest.h>

#include <cstdint>

#include "saltus/audit/audit.h"
#include "test_scenes.h"

namespace saltus {
namespace {

TEST(InterruptedAudit, KeepsTheStudiesThatAreWhole) {
  const Scene scene = ProblemScene("two_balls");
  const std::optional<ModelGradient> exact = ExactGradientOf(scene);
  AuditOptions options;
  options.width_sweep = true;
  const ModelAudit whole = AuditModel("direct_toi", scene, Precision::kDouble, exact, options);
  ASSERT_FALSE(whole.interrupted);
  ASSERT_TRUE(whole.recognition && whole.refinement && whole.attribution && whole.widths);
  int stages[5] = {};
  bool done = false;
  for (int64_t most = 0; !done; most += 1 + most / 16) {
    int64_t asked = 0;
    options.stop = [&] { return ++asked > most; };
    const ModelAudit audit = AuditModel("direct_toi", scene, Precision::kDouble, exact, options);
    done = !audit.interrupted;
    const int stage = !audit.gradient.ok() ? 0
                      : !audit.recognition ? 1
                      : !audit.refinement  ? 2
                      : !audit.attribution ? 3
                                           : 4;
    if (!done) ++stages[stage];
    if (stage == 0) {
      EXPECT_EQ(audit.gradient.reason, kStopped);
      continue;
    }
    EXPECT_EQ(audit.gradient.gradient.control, whole.gradient.gradient.control);
    EXPECT_EQ(audit.verdict, stage > 2 ? whole.verdict : Verdict::kUnknown);
    if (stage > 1) EXPECT_EQ(audit.recognition->words, whole.recognition->words);
    if (stage > 3) EXPECT_EQ(audit.attribution->first_wrong, whole.attribution->first_wrong);
    EXPECT_EQ(audit.widths.has_value(), done);
    if (!done) EXPECT_EQ(audit.Why(), "interrupted");
  }
  for (const int count : stages) EXPECT_GT(count, 0);
}

TEST(InterruptedAudit, ThereIsNoReferenceThen) {
  EXPECT_FALSE(ExactGradientOf(ProblemScene("two_balls"), [] { return true; }));
}

}  // namespace
}  // namespace saltus
