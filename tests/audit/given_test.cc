// Gradients that were computed elsewhere.
#include "saltus/audit/given.h"

#include <gtest/gtest.h>

#include <cmath>

#include "saltus/audit/audit.h"
#include "test_scenes.h"

namespace saltus {
namespace {

TEST(Given, JudgesEveryEntryThatIsKnown) {
  const Scene scene = ProblemScene("two_balls");
  GivenGradient given;
  given.position = {-0.39866841646141652, 0.3};
  given.velocity = {NAN, NAN, -0.2221, -0.3};
  given.control = {0.00021380129632184102, -0.0009};
  const std::vector<GivenEntry> entries = JudgeGiven(scene, given, *ExactGradientOf(scene));
  ASSERT_EQ(entries.size(), 6u);
  const struct {
    const char* entry;
    Verdict verdict;
  } expected[] = {{"px striker", Verdict::kRight},
                  {"py striker", Verdict::kWrongSign},
                  {"vx target", Verdict::kWrong},
                  {"vy target", Verdict::kWrong},
                  {"ux[0] striker", Verdict::kRight},
                  {"uy[0] striker", Verdict::kWrongSign}};
  for (size_t i = 0; i < entries.size(); ++i) {
    EXPECT_EQ(entries[i].entry, expected[i].entry);
    EXPECT_EQ(entries[i].verdict, expected[i].verdict) << entries[i].entry;
  }
  EXPECT_EQ(WorstOf(entries), Verdict::kWrongSign);
  given.tolerance = 5e-5;
  EXPECT_EQ(JudgeGiven(scene, given, *ExactGradientOf(scene))[2].verdict, Verdict::kRight);
  EXPECT_EQ(WorstOf({}), Verdict::kUnknown);
}

TEST(Given, FixedDiscsHaveNoEntries) {
  const Scene scene = FourDiscs(0);
  GivenGradient given;
  given.position = {NAN, NAN, 1, 1, 1, 1};
  const std::vector<GivenEntry> entries = JudgeGiven(scene, given, *ExactGradientOf(scene));
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[0].entry, "px b");
}

}  // namespace
}  // namespace saltus
