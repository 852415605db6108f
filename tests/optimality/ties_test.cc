// Solutions in which the order of impacts at the same time decides: exact runs and certificates say so.
#include <gmock/gmock.h>

#include <cmath>

#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::UnorderedElementsAre;

struct Solution {
  explicit Solution(Scene of)
      : scene(std::move(of)),
        initial(InitialState(scene)),
        control(InitialControl(scene, scene.steps)),
        run(SimulateExactly(scene, initial, control)) {}
  Certificate Certified() const { return Certify(scene, initial, control); }

  Scene scene;
  std::vector<double> initial, control;
  ExactRun run;
};

// With two contacts there are two orders, and the order of the lines is that of the impacts.
TEST(AmbiguousRuns, TheSpreadIsThatOfBothOrders) {
  const Solution one(StrikesTwo()), other(StrikesTwoSwapped());
  ASSERT_GT(std::abs(one.run.loss - other.run.loss), 0.02);
  for (const Solution* solution : {&one, &other}) {
    ASSERT_EQ(solution->run.ambiguous.size(), 1u);
    const Tie& tie = solution->run.ambiguous[0];
    EXPECT_THAT(tie.bodies, UnorderedElementsAre("striker", "left", "right"));
    EXPECT_EQ(tie.num_contacts, 2);
    EXPECT_NEAR(tie.time, solution->run.events[0].time, 1e-9);
    const std::optional<LossSpread> spread = solution->run.spread;
    ASSERT_TRUE(spread);
    EXPECT_NEAR(spread->lowest, std::min(one.run.loss, other.run.loss), 1e-12);
    EXPECT_NEAR(spread->highest, std::max(one.run.loss, other.run.loss), 1e-12);
  }
  EXPECT_THAT(DescribeTies(one.run.ambiguous, one.run.spread),
              HasSubstr("the order of the impacts of striker, left and right at 0.2"));
}

TEST(AmbiguousRuns, AlsoOnIntervalsOfDifferentLength) {
  const Scene scene = StrikesTwo();
  std::vector<double> durations(30, 0.02);
  durations.insert(durations.end(), 10, 0.04);
  const std::vector<double> initial = InitialState(scene), control = InitialControl(scene, 40);
  const ExactRun run = SimulateExactly(scene, initial, control, durations);
  ASSERT_EQ(run.ambiguous.size(), 1u);
  EXPECT_NEAR(run.ambiguous[0].time, Solution(scene).run.ambiguous[0].time, 1e-12);
  ASSERT_TRUE(run.spread);
  EXPECT_GT(run.spread->highest - run.spread->lowest, 0.02);
  EXPECT_EQ(Certify(scene, initial, control, durations).verdict, Certificate::Verdict::kAmbiguous);
}

TEST(AmbiguousRuns, CertificatesSaySo) {
  for (const Scene& scene : {StrikesTwo(), StrikesTwoSwapped()}) {
    const Certificate certificate = Solution(scene).Certified();
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kAmbiguous);
    EXPECT_STREQ(VerdictToString(certificate.verdict), "ambiguous");
    EXPECT_THAT(certificate.reason, HasSubstr("striker"));
    ASSERT_EQ(certificate.ambiguous.size(), 1u);
    EXPECT_THAT(certificate.ambiguous[0].bodies, UnorderedElementsAre("striker", "left", "right"));
  }
}

TEST(AmbiguousRuns, NothingIsSaidWhereOneComesFirst) {
  Scene scene = StrikesTwo();
  scene.bodies[2].position[0] += 1e-4;
  const Solution solution(scene);
  EXPECT_TRUE(solution.run.ambiguous.empty());
  EXPECT_FALSE(solution.run.spread);
  EXPECT_NE(solution.Certified().verdict, Certificate::Verdict::kAmbiguous);
  EXPECT_EQ(DescribeTies(solution.run.ambiguous, solution.run.spread), "");
  for (const char* name : {"bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"}) {
    EXPECT_THAT(Solution(ProblemScene(name)).run.ambiguous, ElementsAre()) << name;
  }
}

// Which of the walls of a groove a disc meets first when it is hit decides for a while, until it rests.
TEST(AmbiguousRuns, NothingIsSaidWhereAllOrdersEndAlike) {
  Scene scene;
  scene.name = "groove";
  scene.duration = 0.02;
  scene.steps = 20;
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .velocity = {0.3, -1}}};
  scene.planes = {{"left", {0, 0}, {1, 1.2}}, {"right", {0, 0}, {-1, 1.2}}};
  scene.bodies[0].position[1] = 0.1 * std::sqrt(1 + 1.2 * 1.2) / 1.2;  // in the groove
  scene.contact = {.restitution = 0.3};
  scene.objective.terminal = {{.body = 0, .target = {0, 0}}};
  scene.optimize = Optimize::kVelocity;
  for (const double duration : {0.02, 3.0}) {
    scene.duration = duration;
    const std::unique_ptr<Simulator> event = MakeSimulator("event", scene, Precision::kDouble);
    ASSERT_TRUE(event->Rollout(InitialState(scene), {}));
    EXPECT_EQ(TiesOf(*event).size(), 1u);
    EXPECT_EQ(Solution(scene).run.ambiguous.empty(), duration == 3.0);
  }
}

// Two such strikes far from each other and at different times, each of which has two orders.
TEST(AmbiguousRuns, EveryTieIsNamed) {
  Scene scene = StrikesTwo();
  for (int i = 0; i < 3; ++i) {
    Body body = scene.bodies[i];
    body.name = "second_" + body.name;
    body.position += Vec2d(i == 0 ? 3.8 : 4, 5);
    scene.bodies.push_back(body);
  }
  const Solution solution(scene);
  ASSERT_EQ(solution.run.ambiguous.size(), 2u);
  EXPECT_THAT(solution.run.ambiguous[0].bodies, ElementsAre("striker", "left", "right"));
  EXPECT_THAT(solution.run.ambiguous[1].bodies, ElementsAre("second_striker", "second_left", "second_right"));
  EXPECT_LT(solution.run.ambiguous[0].time, solution.run.ambiguous[1].time);
  EXPECT_THAT(TiesToString(solution.run.ambiguous), HasSubstr("decides, and 1 more"));
  // At the same time they are still two.
  scene.bodies[3].position = scene.bodies[0].position + Vec2d(4, 5);
  scene.control = {};
  EXPECT_EQ(Solution(scene).run.ambiguous.size(), 2u);
}

}  // namespace
}  // namespace saltus
