// Gradients that were computed elsewhere.
#include "saltus/audit/external_gradient.h"

#include <gtest/gtest.h>

#include <cmath>

#include "saltus/audit/audit.h"
#include "test_scenes.h"

namespace saltus {
namespace {

TEST(Given, JudgesEveryEntryThatIsKnown) {
  const Scene scene = ProblemScene("two_balls");
  ExternalGradient given;
  given.position = {-0.39866841646141652, 0.3};
  given.velocity = {NAN, NAN, -0.2221, -0.3};
  given.control = {0.00021380129632184102, -0.0009};
  const std::vector<ExternalGradientEntry> entries = JudgeExternalGradient(scene, given, *ComputeExactGradient(scene));
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
  EXPECT_EQ(WorstVerdict(entries), Verdict::kWrongSign);
  given.tolerance = 5e-5;
  EXPECT_EQ(JudgeExternalGradient(scene, given, *ComputeExactGradient(scene))[2].verdict, Verdict::kRight);
  EXPECT_EQ(WorstVerdict({}), Verdict::kUnknown);
}

TEST(Given, JudgesRotationsOfDiscsThatSpin) {
  const Scene scene = ProblemScene("back_spin");
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  ASSERT_TRUE(exact && scene.bodies[0].Spins());
  const double by_spin = exact->gradient.initial[4 * scene.bodies.size() + 1];
  ASSERT_NE(by_spin, 0);
  ExternalGradient given;
  given.angle = {0.1};
  given.angular_velocity = {by_spin};
  std::vector<ExternalGradientEntry> entries = JudgeExternalGradient(scene, given, *exact);
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[0].entry, "angle " + scene.bodies[0].name);
  EXPECT_EQ(entries[0].verdict, Verdict::kWrong);
  EXPECT_EQ(entries[1].entry, "angular velocity " + scene.bodies[0].name);
  EXPECT_EQ(entries[1].verdict, Verdict::kRight);
  given.angular_velocity = {-by_spin};
  EXPECT_EQ(JudgeExternalGradient(scene, given, *exact)[1].verdict, Verdict::kWrongSign);
}

TEST(Given, FixedDiscsHaveNoEntries) {
  const Scene scene = FourDiscs(0);
  ExternalGradient given;
  given.position = {NAN, NAN, 1, 1, 1, 1};
  const std::vector<ExternalGradientEntry> entries = JudgeExternalGradient(scene, given, *ComputeExactGradient(scene));
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[0].entry, "px b");
}

}  // namespace
}  // namespace saltus
