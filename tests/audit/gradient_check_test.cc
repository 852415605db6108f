// A model's gradient against differences of its own loss.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "audit/gradient/step_study.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// A disc that flies along a channel, `gap` from either wall: what moves it aside by more makes it bounce.
Scene AlongAChannel(double gap) {
  Scene scene;
  scene.name = "along_a_channel";
  scene.duration = 1;
  scene.steps = 10;
  scene.bodies = {{.name = "disc", .radius = 0.1, .mass = 1, .position = {0, 0}, .velocity = {0, 1}}};
  scene.planes = {{"left", {-0.1 - gap, 0}, {1, 0}}, {"right", {0.1 + gap, 0}, {-1, 0}}};
  scene.contact = {.restitution = 1, .friction = 0};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0.3, 0.5}}};
  scene.objective.effort = 0.001;
  return scene;
}

// Differences begin at a tenth of the way of a step, 0.01 m.
TEST(GradientCheck, AgreeOnceTheyAreNarrowEnough) {
  for (const double gap : {1e-3, 1e-5, 1e-7}) {
    EXPECT_EQ(CheckGradient("event", AlongAChannel(gap)).agreement, Agreement::kAgrees) << gap;
  }
}

const ParameterAudit* Find(const std::vector<ParameterAudit>& audits, const std::string& name) {
  const auto found = std::ranges::find(audits, name, &ParameterAudit::name);
  return found == audits.end() ? nullptr : &*found;
}

// A ball on soft ground bounces once.
TEST(GradientCheck, OfParametersOfEveryModelThatHasThem) {
  Scene scene = ProblemScene("bounce_once");
  scene.contact.restitution = 0.7;
  scene.contact.damping = 3;
  const std::vector<ParameterAudit> soft = CompareParameters("compliant_warp", scene, ParametersToCompare(scene));
  for (const std::string name : {"stiffness", "damping", "mass.ball", "gravity.y"}) {
    const ParameterAudit* audit = Find(soft, name);
    ASSERT_NE(audit, nullptr) << name;
    EXPECT_EQ(audit->verdict, Verdict::kRight) << name;
    ASSERT_TRUE(audit->difference) << name;
    EXPECT_NEAR(audit->gradient, *audit->difference, 1e-3 * std::abs(audit->gradient));
    EXPECT_NE(audit->gradient, 0);
  }
  // The Jacobian that was published with this model does not depend on positions; its motion does.
  scene = ProblemScene("post_shot");
  const std::vector<ParameterAudit> published = CompareParameters("convex", scene, ParametersToCompare(scene));
  const ParameterAudit* post = Find(published, "position.post.x");
  ASSERT_NE(post, nullptr);
  EXPECT_EQ(post->gradient, 0);
  EXPECT_TRUE(IsWrong(post->verdict));
  // Height at the end: 0.1 + e 2 0.55, in the units of the weight; at a bound there are differences to one side.
  scene = ProblemScene("bounce_once");
  const std::vector<ParameterAudit> exact = CompareParameters("event", scene, ParametersToCompare(scene));
  EXPECT_EQ(Find(exact, "stiffness"), nullptr);
  const ParameterAudit* restitution = Find(exact, "restitution");
  ASSERT_NE(restitution, nullptr);
  EXPECT_EQ(restitution->verdict, Verdict::kRight);
}

}  // namespace
}  // namespace saltus
