// Which step of which model is wrong, and why. The causes are what the models' own headers say of them.
#include "saltus/audit/attribution.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "audit/attribution/step_map.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"
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
  const char* cause;
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
      {"pbd_warp", 331, Block::kPositionFromPosition, "position before the impact ignored (projection)"},
      {"pbd_brax", 165, Block::kPositionFromPosition, "position before the impact ignored (projection)"},
  };
  for (const Expected& expected : models) {
    const Attribution attribution = AttributeError(expected.contact, scene);
    const ContactError& error = FirstWrong(attribution);
    EXPECT_EQ(error.first_step, expected.step) << expected.contact;
    EXPECT_EQ(error.last_step, expected.step) << expected.contact;
    EXPECT_EQ(error.a, "striker");
    EXPECT_EQ(error.b, "target");
    EXPECT_EQ(error.block, expected.block) << expected.contact;
    EXPECT_EQ(error.cause, expected.cause) << expected.contact;
    EXPECT_TRUE(error.stays) << expected.contact;
    EXPECT_THAT(attribution.sequence, IsEmpty()) << expected.contact;
  }
}

// A spring pushes for about pi sqrt(m / k) = 22 ms, eleven steps.
TEST(Attribution, ASpringIsNotResolvedByItsSteps) {
  const Attribution attribution = AttributeError("compliant_warp", ProblemScene("two_balls"));
  const ContactError& error = FirstWrong(attribution);
  EXPECT_EQ(error.last_step - error.first_step + 1, 11);
  EXPECT_THAT(error.cause, HasSubstr("not resolved by its 11 steps"));
}

TEST(Attribution, CausesAreSeenOnCoarseGridsToo) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 6;
  const ContactError direct = FirstWrong(AttributeError("direct_toi", scene));
  EXPECT_EQ(direct.first_step, 3);
  EXPECT_EQ(direct.cause, "acceleration at the impact ignored");
  EXPECT_THAT(FirstWrong(AttributeError("compliant_warp", scene)).cause, HasSubstr("not resolved by its single step"));
}

TEST(Attribution, ASoftSpringStaysWrongHoweverSmallItsSteps) {
  Scene scene = ProblemScene("two_balls");
  scene.contact.stiffness = 300;
  scene.steps = 2400;
  EXPECT_THAT(FirstWrong(AttributeError("compliant_warp", scene)).cause, HasSubstr("soft"));
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
  EXPECT_EQ(attribution.contacts[0].cause, "acceleration at the impact ignored");
  EXPECT_LT(attribution.contacts[1].error, 1e-12);
}

// Off the line of centres the normal turns with the time of impact.
TEST(Attribution, ObliqueImpactsShowTheNormal) {
  const Attribution attribution = AttributeError("direct_toi", ProblemScene("multiple_collisions"));
  EXPECT_EQ(FirstWrong(attribution).cause, "acceleration at the impact ignored; normal taken at a fixed time");
}

TEST(Attribution, SquaresAndConesOfFrictionAreSeen) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  EXPECT_THAT(AttributeError("compliant_brax", scene).contacts[1].cause,
              HasSubstr("restitution squared; friction squared"));
  EXPECT_THAT(AttributeError("convex_toi", scene).contacts[0].cause, HasSubstr("restitution multiplies friction"));
  EXPECT_THAT(AttributeError("pbd_warp", scene).contacts[0].cause, HasSubstr("overlap / step added to the velocity"));
}

TEST(Attribution, AnotherSequenceOfContactsIsReported) {
  Scene scene = ProblemScene("single_collision");
  scene.contact.restitution = 0.5;
  EXPECT_THAT(AttributeError("compliant_brax", scene).sequence, HasSubstr("striker - target"));
}

TEST(Attribution, ALimitOfTimeIsSaid) {
  AttributionOptions options{.seconds = 1e-9};  // which is over before anything is compared
  const Attribution cut = AttributeError("compliant_warp", ProblemScene("two_balls"), options);
  EXPECT_TRUE(cut.ok()) << cut.reason;
  EXPECT_THAT(cut.limit, HasSubstr("no contacts compared in 1e-09 s"));
  EXPECT_THAT(cut.contacts, IsEmpty());
  EXPECT_EQ(cut.first_wrong, -1);
  AuditOptions audit_options;
  audit_options.attribution_seconds = options.seconds;
  const Scene scene = ProblemScene("two_balls");
  const ModelAudit audit = AuditModel("direct", scene, Precision::kDouble, ComputeExactGradient(scene), audit_options);
  EXPECT_FALSE(audit.interrupted);
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("not traced to a contact in time"));
}

TEST(Attribution, SaysWhatItIsAt) {
  std::vector<std::string> said;
  AttributionOptions options{.seconds = 1e9};
  options.status = [&](const std::string& what) { said.push_back(what); };
  const Attribution attribution = AttributeError("compliant_warp", ProblemScene("two_balls"), options);
  EXPECT_THAT(attribution.limit, IsEmpty());
  EXPECT_EQ(FirstWrong(attribution).cause,
            FirstWrong(AttributeError("compliant_warp", ProblemScene("two_balls"))).cause);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_EQ(said[0], "contact 1 of 1 at 480 steps");
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

// Discs that touch nothing make a scene a crowd, and change nothing of what is found; nor do some that spin.
void ExpectTheSameInACrowd(const Scene& pair, const std::vector<const char*>& contacts, bool others_spin = false) {
  Scene crowd = pair;
  for (int i = 0; i < 20; ++i) {
    crowd.bodies.push_back({.name = "far" + std::to_string(i), .radius = 0.2, .mass = 1, .position = {-5.0 - i, 5}});
    if (others_spin) crowd.bodies.back().inertia = {Inertia::Kind::kSolid};
  }
  for (const char* contact : contacts) {
    const Attribution expected = AttributeError(contact, pair), found = AttributeError(contact, crowd);
    ASSERT_EQ(found.contacts.size(), expected.contacts.size()) << contact;
    const ContactError &right = FirstWrong(expected), &own = FirstWrong(found);
    EXPECT_EQ(own.first_step, right.first_step) << contact;
    EXPECT_EQ(own.block, right.block) << contact;
    EXPECT_EQ(own.cause, right.cause) << contact;
    EXPECT_NEAR(own.error, right.error, 1e-9 * right.error) << contact;
  }
}

TEST(Attribution, OfAPairInACrowdIsThatOfThePair) {
  ExpectTheSameInACrowd(ProblemScene("two_balls"), {"direct", "direct_toi", "compliant_warp"});
  ExpectTheSameInACrowd(ProblemScene("ground_wall_spin"), {"lcp_kkt", "compliant_warp"});
  Scene plain = ProblemScene("ground_wall");
  plain.contact.friction = 0.1;
  ExpectTheSameInACrowd(plain, {"lcp_kkt", "compliant_warp"}, true);
}

// A ball with spin on its way off ground and wall: what is wrong is what their headers say, as it is without spin, and
// exact events have no error.
TEST(Attribution, TracesErrorsOfDiscsThatSpin) {
  const Scene scene = ProblemScene("ground_wall_spin");
  const Attribution exact = AttributeError("event", scene);
  ASSERT_TRUE(exact.ok()) << exact.reason;
  EXPECT_EQ(exact.first_wrong, -1);
  ASSERT_THAT(exact.contacts, SizeIs(2));
  for (const ContactError& contact : exact.contacts) EXPECT_LT(contact.error, 1e-9);

  const Expected models[] = {
      {"lcp_kkt", 74, Block::kVelocityFromPosition, "time of impact ignored"},
      {"convex_toi",
       75,
       Block::kVelocityFromPosition,
       "restitution multiplies friction, and sliding the normal impulse; acceleration at the impact ignored"},
      {"xpbd", 74, Block::kVelocityFromPosition, "position before the impact ignored (projection)"},
      {"lcp",
       76,
       Block::kVelocityFromPosition,
       "position bounces without friction; acceleration at the impact ignored"},
  };
  for (const Expected& expected : models) {
    const Attribution found = AttributeError(expected.contact, scene);
    const ContactError& wrong = FirstWrong(found);
    EXPECT_EQ(wrong.b, "ground") << expected.contact;
    EXPECT_EQ(wrong.first_step, expected.step) << expected.contact;
    EXPECT_EQ(wrong.block, expected.block) << expected.contact;
    EXPECT_TRUE(wrong.stays) << expected.contact;
    EXPECT_EQ(wrong.cause, expected.cause) << expected.contact;
  }
}

// A row of discs that overlap, pushed together: what is pulled back is the transposed linearization times the costate.
TEST(Attribution, ACostateIsPulledBackAsByTheMatrix) {
  Scene scene;
  scene.duration = 0.05;
  scene.steps = 25;
  scene.contact.stiffness = 1e4;
  std::vector<int> bodies;
  for (int i = 0; i < 18; ++i) {
    const Vec2d position(0.199 * i, 0.01 * std::sin(i));
    scene.bodies.push_back(
        {.name = "disc" + std::to_string(i), .radius = 0.1, .mass = 1 + 0.1 * i, .position = position});
    bodies.push_back(i);
  }
  scene.control = {{0}, {Vec2d(5, 1)}};
  for (const char* contact : {"compliant_warp", "direct", "xpbd"}) {
    if (contact == std::string_view("xpbd")) {  // those of spin too
      scene.contact.friction = 0.3;
      for (Body& body : scene.bodies) body.inertia = {Inertia::Kind::kSolid};
      scene.bodies[3].angular_velocity = 20;
    }
    const int size = NumbersOfDisc(scene);
    Eigen::VectorXd lambda(size * bodies.size());
    for (int i = 0; i < lambda.size(); ++i) lambda[i] = std::sin(1.0 + i);
    const std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, Precision::kDouble);
    const std::vector<double> begin = ToState(InitialState(scene), scene.num_bodies());
    const std::vector<double> control = InitialControl(scene, scene.steps);
    const auto force = [&](int k, std::span<double> f) { simulator->ExpandForce(control, k, f); };
    const Eigen::MatrixXd A = RunSteps(*simulator, begin, force, scene.steps, &bodies).A;
    const PulledCostate pulled = PullBackCostate(simulator.get(), begin, bodies, lambda);
    Eigen::VectorXd positions = lambda, velocities = lambda;
    for (int i = 0; i < lambda.size(); ++i) (i % size < 2 || i % size == 4 ? velocities : positions)[i] = 0;
    EXPECT_LT((pulled.by_positions - A.transpose() * positions).norm(), 1e-9 * pulled.by_positions.norm()) << contact;
    EXPECT_LT((pulled.by_velocities - A.transpose() * velocities).norm(), 1e-9 * pulled.by_velocities.norm())
        << contact;
  }
}

}  // namespace
}  // namespace saltus
