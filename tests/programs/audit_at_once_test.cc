// Output of the audit where events happen at the same time, where nothing can be judged, and on which number it rests.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "programs/audit.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/user_contact.h"

namespace saltus {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

Scene Empty(double restitution, const Vec2d& target) {
  Scene scene;
  scene.name = "at_once";
  scene.duration = 1;
  scene.steps = 40;
  scene.contact.restitution = restitution;
  scene.objective.terminal = {{.body = 0, .target = target}};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  return scene;
}

Scene Corner() {
  Scene scene = Empty(0.7, {0.5, 0.3});
  scene.bodies = {{.name = "a", .radius = 0.25, .position = {1.25, 1.25}, .velocity = {-2, -2}}};
  scene.planes = {{"ground", {0, 0}, {0, 1}}, {"wall", {0, 0}, {1, 0}}};
  return scene;
}

Scene GroundAndDisc() {
  Scene scene = Empty(1, {0.5, 0.3});
  scene.bodies = {{.name = "a", .radius = 0.25, .position = {0, 1.25}, .velocity = {1, -2}},
                  {.name = "b", .radius = 0.25, .position = {1.5, 1.25}, .velocity = {-1, -2}}};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return scene;
}

Scene Incline() {
  Scene scene = Empty(0.3, {-1, -1});
  scene.duration = 0.8;
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1.3, .position = {-0.06, 0.08}}};
  scene.planes = {{"incline", {0, 0}, {-0.6, 0.8}}};
  scene.contact.friction = 0.2;
  return scene;
}

ModelAudit AuditOf(const Contact& contact, const Scene& scene) {
  AuditOptions options;
  options.refinement = {.levels = 4, .samples = 5};
  return AuditModel(contact, scene, Precision::kDouble, ComputeExactGradient(scene), options);
}

// The axes are independent: x(T) = r - e (p - r) - e v T.
TEST(AuditAtOnce, ACornerIsRightAndTwoSided) {
  for (const int steps : {40, 554, 1026}) {
    Scene scene = Corner();
    scene.steps = steps;
    const ModelGradient exact = *ComputeExactGradient(scene);
    EXPECT_THAT(exact.one_sided, IsEmpty());
    const double expected[] = {-0.63, -0.91, -0.63, -0.91};
    for (int i = 0; i < 4; ++i) EXPECT_NEAR(exact.gradient.initial[i], expected[i], 1e-9);
    const ModelAudit audit = AuditOf("event", scene);
    EXPECT_EQ(audit.verdict, Verdict::kRight) << steps;
    EXPECT_EQ(audit.VerdictReason(), "") << steps;
  }
}

// The discs exchange their horizontal velocities, so that where a ends does not depend on where it begins. If a is
// lowered, both discs strike the ground before they meet, since discs that are not at one height meet later. That
// leads to the slopes of the order here, in which they meet first: both impacts with the ground mirror the motion. If a
// is lifted, they meet between these impacts.
TEST(AuditAtOnce, SlopesThatDependOnTheOrderAreNamed) {
  for (const int steps : {2, 3, 4, 5, 40}) {
    Scene scene = GroundAndDisc();
    scene.steps = steps;
    const ModelGradient exact = *ComputeExactGradient(scene);
    EXPECT_NEAR(exact.gradient.initial[0], 0, 1e-9);
    EXPECT_NEAR(exact.gradient.initial[4], -1, 1e-9);
    std::vector<OneSided> expected;
    for (const int body : {0, 1}) {
      for (const auto quantity : {OneSided::Quantity::kPosition, OneSided::Quantity::kVelocity}) {
        expected.push_back({body, quantity, 1, OneSided::Side::kBelow});
      }
    }
    EXPECT_THAT(exact.one_sided, ::testing::UnorderedElementsAreArray(expected)) << steps;
  }
  const ModelAudit audit = AuditOf("event", GroundAndDisc());
  EXPECT_EQ(audit.verdict, Verdict::kRight);
  EXPECT_EQ(audit.gradient.one_sided.size(), 4u);
}

TEST(AuditAtOnce, WhereNothingCanBeJudgedTheVerdictSaysSo) {
  const ModelAudit audit = AuditOf("event", Incline());
  EXPECT_EQ(audit.verdict, Verdict::kOneSided);
  EXPECT_STREQ(VerdictToString(audit.verdict), "one-sided");
  EXPECT_EQ(audit.VerdictReason(),
            "the loss has a kink: derivatives by the initial state are one-sided or do not exist");
}

// Free flight, in which velocities count twice at some lengths of the step.
struct Sometimes {
  static constexpr ModelTraits kTraits = {
      .name = "sometimes", .summary = "wrong at some step counts", .source = "a fault", .friction = false};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    const auto wrong = decltype(in.h)(std::fmod(std::floor(1e7 * Value(in.h)), 7) == 0 ? 2 : 1);
    State<T> next;
    next.v = x.v + Scale(in.h, in.Acceleration(i));
    next.p = x.p + Scale(wrong * in.h, x.v);
    return next;
  }
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
  }
};

TEST(AuditAtOnce, TheTableHasTheErrorThatDecided) {
  Scene scene = Corner();
  scene.bodies[0].velocity = {0.3, 0.2};
  const ModelAudit audit = AuditOf(UserContact<Sometimes>(), scene);
  ASSERT_TRUE(audit.refinement);
  const QuantityStudy& study = *audit.refinement->Find(Quantity::kVelocity);
  double largest = 0;
  for (const RefinementLevel& level : study.levels) largest = std::max(largest, level.largest);
  ASSERT_TRUE(IsWrong(study.verdict)) << VerdictToString(study.verdict);
  ASSERT_LE(study.levels.back().error, 1e-6) << "the finest median must be that of a right model";
  // From the loss |p + w v - target|^2 with w = 1 and 2, whose gradient by v is 2 w (p + w v - target).
  const double expected = std::hypot(3.3, 3.1) / std::hypot(2.1, 2.3);
  ASSERT_NEAR(largest, expected, 1e-6);
  EXPECT_EQ(study.decisive, largest);
  EXPECT_THAT(VerdictTable({.reference = std::nullopt, .models = {audit}}).ToCsv(), HasSubstr("wrong, error 1.5"));
}

}  // namespace
}  // namespace saltus
