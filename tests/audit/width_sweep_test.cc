// Differences of every width, against exact gradients that the sweep itself never sees.
#include "saltus/audit/width_sweep.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "saltus/audit/audit.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

const WidthSweep& SweepOf(const WidthSweepStudy& study, const std::string& entry) {
  for (const WidthSweep& sweep : study.sweeps) {
    if (sweep.entry == entry) return sweep;
  }
  ADD_FAILURE() << "no sweep of " << entry;
  static const WidthSweep none;
  return none;
}

// It agrees with narrow differences to many digits, and only wide ones know the exact gradient.
TEST(WidthSweep, ExposesDirectImpulsesWithTimeOfImpactInTask3) {
  const WidthSweepStudy study = SweepWidths("direct_toi", ProblemScene("two_balls"));
  ASSERT_TRUE(study.ok()) << study.reason;
  EXPECT_TRUE(IsWrong(study.verdict));
  const WidthSweep& striker = SweepOf(study, "px striker");
  EXPECT_EQ(striker.finding, WidthFinding::kOnlyOfItsSteps);
  EXPECT_NEAR(striker.narrow, striker.gradient, 1e-5);
  EXPECT_NEAR(striker.wide, -0.39866841646141652, 0.03);
  EXPECT_NEAR(SweepOf(study, "px target").wide, -0.32125311552466066, 0.03);
  EXPECT_NEAR(SweepOf(study, "vx striker").wide, -0.49779065736599695, 0.03);
  EXPECT_THAT(study.Summary(), HasSubstr("; differences narrower than a step give "));
}

TEST(WidthSweep, ExposesImpulsesAtTheEndOfTheStep) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls"}) {
    const WidthSweepStudy study = SweepWidths("direct", ProblemScene(problem));
    EXPECT_TRUE(IsWrong(study.verdict)) << problem;
  }
  const WidthSweepStudy study = SweepWidths("direct", ProblemScene("bounce_once"));
  EXPECT_EQ(study.verdict, Verdict::kWrongSign);
  EXPECT_NEAR(SweepOf(study, "py ball").wide, -1, 0.05);
}

TEST(WidthSweep, APublishedJacobianAgreesWithNoDifferences) {
  const WidthSweepStudy study = SweepWidths("lcp", ProblemScene("two_balls"));
  EXPECT_EQ(SweepOf(study, "px striker").finding, WidthFinding::kOfNeither);
}

TEST(WidthSweep, FindsNothingAgainstRightAndConsistentGradients) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"}) {
    for (const char* contact : {"event", "toi_velocity"}) {
      const WidthSweepStudy study = SweepWidths(contact, ProblemScene(problem));
      ASSERT_TRUE(study.ok()) << study.reason;
      EXPECT_EQ(study.verdict, Verdict::kUnknown) << contact << " in " << problem << ": " << study.Summary();
    }
  }
  EXPECT_EQ(SweepWidths("direct_toi", ProblemScene("bounce_once")).verdict, Verdict::kUnknown);
}

// Wide differences across another sequence of impacts may be farther from the exact value than a gradient that is
// wrong.
TEST(WidthSweep, DifferencesFartherFromTheExactValueAreNoEvidence) {
  const Scene scene = ProblemScene("two_balls");
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  ASSERT_TRUE(exact);
  const double value = exact->gradient.initial[0];
  for (const auto& [wide, finding] :
       {std::pair{value + 13, WidthFinding::kFarther}, std::pair{value + 0.1, WidthFinding::kOfNeither}}) {
    WidthSweepStudy study;
    study.verdict = Verdict::kWrong;
    WidthSweep& sweep = study.sweeps.emplace_back();
    sweep.entry = "px striker";
    sweep.gradient = value + 1;
    sweep.wide = wide;
    sweep.finding = WidthFinding::kOfNeither;
    CompareWithExact(scene, *exact, &study);
    EXPECT_EQ(sweep.exact, value);
    EXPECT_EQ(sweep.finding, finding);
    const bool evidence = finding == WidthFinding::kOfNeither;
    EXPECT_EQ(study.verdict, evidence ? Verdict::kWrong : Verdict::kUnknown);
    EXPECT_EQ(study.Worst() != nullptr, evidence);
    if (!evidence) {
      EXPECT_THAT(study.Summary(), HasSubstr("farther from the exact gradient"));
    }
  }
}

TEST(WidthSweep, DiscsThatStartCloseLeaveItUndecided) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[0].position = {-1.3, -1.265};
  const WidthSweepStudy study = SweepWidths("direct_toi", scene);
  EXPECT_EQ(SweepOf(study, "px striker").finding, WidthFinding::kUndecided);
}

}  // namespace
}  // namespace saltus
