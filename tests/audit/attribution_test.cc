// Which step of which model is wrong, and why. The causes are what the models' own headers say of them.
#include "saltus/audit/attribution.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

const ContactError& FirstWrong(const Attribution& attribution) {
  static const ContactError none;
  EXPECT_TRUE(attribution.ok()) << attribution.reason;
  EXPECT_GE(attribution.first_wrong, 0);
  return attribution.first_wrong < 0 ? none : attribution.contacts[attribution.first_wrong];
}

struct Expected {
  const char* contact;
  int step;
  Block block;
  const char* why;
};

// The exact impact is in step 331 of 480. Models that move with the velocity before the step see it up to two later.
TEST(Attribution, NamesStepBlockAndCauseInTask3) {
  const Scene scene = ProblemScene("two_balls");
  const Expected models[] = {
      {"lcp",
       333,
       Block::kVelocityFromPosition,
       "relative position bounces by half the restitution; acceleration at the impact ignored"},
      {"convex", 332, Block::kPositionFromPosition, "time of impact ignored; normal frozen"},
      {"convex_toi", 332, Block::kVelocityFromPosition, "acceleration at the impact ignored; normal frozen"},
      {"direct", 331, Block::kPositionFromPosition, "time of impact ignored"},
      {"direct_toi", 331, Block::kVelocityFromPosition, "acceleration at the impact ignored"},
      {"compliant_brax", 166, Block::kPositionFromPosition, "time of impact ignored"},
      {"pbd_warp", 331, Block::kPositionFromPosition, "projection forgets the position"},
      {"pbd_brax", 165, Block::kPositionFromPosition, "projection forgets the position"},
  };
  for (const Expected& expected : models) {
    const Attribution attribution = AttributeError(expected.contact, scene);
    const ContactError& error = FirstWrong(attribution);
    EXPECT_EQ(error.first_step, expected.step) << expected.contact;
    EXPECT_EQ(error.last_step, expected.step) << expected.contact;
    EXPECT_EQ(error.a, "striker");
    EXPECT_EQ(error.b, "target");
    EXPECT_EQ(error.block, expected.block) << expected.contact;
    EXPECT_EQ(error.why, expected.why) << expected.contact;
    EXPECT_TRUE(error.stays) << expected.contact;
    EXPECT_THAT(attribution.sequence, IsEmpty()) << expected.contact;
  }
}

// A spring pushes for about pi sqrt(m / k) = 22 ms, eleven steps.
TEST(Attribution, ASpringIsNotResolvedByItsSteps) {
  const Attribution attribution = AttributeError("compliant_warp", ProblemScene("two_balls"));
  const ContactError& error = FirstWrong(attribution);
  EXPECT_EQ(error.last_step - error.first_step + 1, 11);
  EXPECT_THAT(error.why, HasSubstr("not resolved by its 11 steps"));
}

TEST(Attribution, CausesAreSeenOnCoarseGridsToo) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 6;
  const ContactError direct = FirstWrong(AttributeError("direct_toi", scene));
  EXPECT_EQ(direct.first_step, 3);
  EXPECT_EQ(direct.why, "acceleration at the impact ignored");
  EXPECT_THAT(FirstWrong(AttributeError("compliant_warp", scene)).why, HasSubstr("not resolved by its single step"));
}

TEST(Attribution, ASoftSpringStaysWrongHoweverSmallItsSteps) {
  Scene scene = ProblemScene("two_balls");
  scene.contact.stiffness = 300;
  scene.steps = 2400;
  EXPECT_THAT(FirstWrong(AttributeError("compliant_warp", scene)).why, HasSubstr("soft"));
}

TEST(Attribution, RightAndConsistentModelsHaveNoWrongStep) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"}) {
    for (const char* contact : {"event", "toi_velocity"}) {
      const Attribution attribution = AttributeError(contact, ProblemScene(problem));
      ASSERT_TRUE(attribution.ok());
      EXPECT_EQ(attribution.first_wrong, -1) << contact << " in " << problem;
    }
  }
  EXPECT_EQ(AttributeError("direct_toi", ProblemScene("bounce_once")).first_wrong, -1);
}

// Gravity accelerates along the ground's normal and across that of the wall.
TEST(Attribution, TheAccelerationMattersWhereItHasANormalPart) {
  const Attribution attribution = AttributeError("direct_toi", ProblemScene("ground_wall"));
  ASSERT_THAT(attribution.contacts, SizeIs(2));
  EXPECT_EQ(attribution.first_wrong, 0);
  EXPECT_EQ(attribution.contacts[0].b, "ground");
  EXPECT_EQ(attribution.contacts[0].why, "acceleration at the impact ignored");
  EXPECT_LT(attribution.contacts[1].error, 1e-12);
}

// Off the line of centres the normal turns with the time of impact.
TEST(Attribution, ObliqueImpactsShowTheNormal) {
  const Attribution attribution = AttributeError("direct_toi", ProblemScene("multiple_collisions"));
  EXPECT_EQ(FirstWrong(attribution).why, "acceleration at the impact ignored; normal taken at a fixed time");
}

TEST(Attribution, SquaresAndConesOfFrictionAreSeen) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  EXPECT_THAT(AttributeError("compliant_brax", scene).contacts[1].why,
              HasSubstr("restitution squared; friction squared"));
  EXPECT_THAT(AttributeError("convex_toi", scene).contacts[0].why, HasSubstr("restitution multiplies friction"));
  EXPECT_THAT(AttributeError("pbd_warp", scene).contacts[0].why, HasSubstr("velocity of overlap / step"));
}

TEST(Attribution, AnotherSequenceOfContactsIsReported) {
  Scene scene = ProblemScene("single_collision");
  scene.contact.restitution = 0.5;
  EXPECT_THAT(AttributeError("compliant_brax", scene).sequence, HasSubstr("striker - target"));
}

TEST(Attribution, SeveralDiscsAndFixedOnes) {
  for (const char* contact : {"event", "pbd_brax", "compliant_warp", "lcp"}) {
    const Attribution attribution = AttributeError(contact, FourDiscs(0.2));
    ASSERT_TRUE(attribution.ok()) << attribution.reason;
    EXPECT_GE(attribution.contacts.size(), 2u) << contact;
    for (const ContactError& error : attribution.contacts) EXPECT_TRUE(std::isfinite(error.error)) << contact;
    EXPECT_EQ(attribution.first_wrong < 0, std::string(contact) == "event") << contact;
  }
}

}  // namespace
}  // namespace saltus
