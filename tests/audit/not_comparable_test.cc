// Models that no exact gradient can judge, and exact gradients that can judge no model.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "saltus/audit/audit.h"
#include "scene/scene_generators.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

ModelAudit Audit(const std::string& contact, const Scene& scene, const AuditOptions& options = {}) {
  return AuditModel(contact, scene, Precision::kDouble, ComputeExactGradient(scene), options);
}

TEST(NotComparable, ModelsThatSpinUnderFriction) {
  Scene scene = ProblemScene("ground_wall");
  for (const char* contact : {"pbd_brax", "compliant_brax"}) {
    scene.contact.friction = 0;
    EXPECT_THAT(ReasonNotComparable(contact, scene), IsEmpty());
    EXPECT_NE(Audit(contact, scene).verdict, Verdict::kNotApplicable) << contact;
    scene.contact.friction = 0.1;
    const ModelAudit audit = Audit(contact, scene);
    EXPECT_EQ(audit.verdict, Verdict::kNotApplicable) << contact;
    EXPECT_THAT(audit.VerdictReason(), HasSubstr("do not spin")) << contact;
    EXPECT_TRUE(audit.gradient.ok()) << contact;
    EXPECT_FALSE(audit.error || audit.refinement || audit.attribution) << contact;
  }
  EXPECT_THAT(ReasonNotComparable("compliant_warp", scene), IsEmpty());
}

// Discs that hit each other dozens of times.
Scene Gas(int discs, double duration) {
  return GasInABox({.discs = discs, .radius = 0.05, .fraction = 0.3, .duration = duration, .steps = 480}, 1);
}

TEST(IllConditioned, AShortRunIsNot) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls"}) {
    const std::optional<Conditioning> found = MeasureConditioning(ProblemScene(problem));
    ASSERT_TRUE(found);
    EXPECT_LT(found->condition, 1e4) << problem;
    EXPECT_LT(found->rounding, 1e-10) << problem;
  }
}

TEST(IllConditioned, AChaoticGasExcusesTheExactModel) {
  const Scene scene = Gas(8, 8);
  const std::optional<Conditioning> found = MeasureConditioning(scene);
  ASSERT_TRUE(found);
  ASSERT_GT(found->rounding, 1e-6);
  EXPECT_GT(found->condition, 1e8);
  const ModelAudit audit = Audit("event", scene, {.refinement = {.budget = 0}});
  EXPECT_EQ(audit.verdict, Verdict::kIllConditioned) << audit.VerdictReason();
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("condition"));
  ASSERT_TRUE(audit.refinement->conditioning);
  EXPECT_FALSE(audit.attribution);
}

// Rounding excuses no more than it does.
TEST(IllConditioned, ABiasIsStillWrong) {
  const Scene scene = Gas(4, 2);
  ASSERT_LT(MeasureConditioning(scene)->rounding, 1e-3);
  EXPECT_TRUE(IsWrong(Audit("direct", scene, {.refinement = {.budget = 0}}).verdict));
}

}  // namespace
}  // namespace saltus
