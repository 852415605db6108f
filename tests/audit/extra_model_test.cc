// Models that are known by their headers alone (mirror_model.h, bad_models.h) are audited like any other.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "audit/gradient/step_study.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

ModelAudit Audit(const std::string& problem) {
  const Scene scene = ProblemScene(problem);
  return AuditModel("mirror", scene, Precision::kDouble, ComputeExactGradient(scene), {.width_sweep = true});
}

TEST(ExtraModel, IsTheLastInTheRegistry) {
  EXPECT_EQ(AllContactModels().back().name, "mirror");
  EXPECT_EQ(AllContactModels().size(), SALTUS_NUM_MODELS);
}

TEST(ExtraModel, IsRightWhereNothingAccelerates) {
  const ModelAudit audit = Audit("bounce_once");
  EXPECT_EQ(audit.verdict, Verdict::kRight);
  EXPECT_EQ(audit.FirstWrong(), nullptr);
  EXPECT_EQ(audit.VerdictReason(), "");
  EXPECT_EQ(audit.widths->verdict, Verdict::kUnknown);
}

// The class of a model that nobody has told the audit of.
TEST(ExtraModel, ItsClassIsRecognised) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls"}) {
    const Scene scene = ProblemScene(problem);
    const ContactRecognition found = RecogniseContact("mirror", scene);
    EXPECT_EQ(found.contact_class, ContactClass::kImpactTimeResolved) << problem << found.words;
    EXPECT_NEAR(found.position_from_position.value_or(0), -scene.contact.restitution, 1e-3) << problem;
  }
}

TEST(ExtraModel, IsWrongUnderForceForAKnownReason) {
  const ModelAudit audit = Audit("two_balls");
  EXPECT_TRUE(IsWrong(audit.verdict));
  ASSERT_NE(audit.FirstWrong(), nullptr);
  EXPECT_EQ(audit.FirstWrong()->first_step, 331);
  EXPECT_EQ(audit.VerdictReason(), "acceleration at the impact ignored");
  EXPECT_TRUE(IsWrong(audit.widths->verdict));
}

// In the audit as everybody runs it, without a sweep of widths.
TEST(ExtraModel, AModelThatForgetsToReportHasNoGradient) {
  const Scene scene = ProblemScene("two_balls");
  const ModelAudit audit = AuditModel("silent", scene, Precision::kDouble, ComputeExactGradient(scene));
  EXPECT_THAT(audit.gradient.reason, HasSubstr("step 331 of silent"));
  EXPECT_THAT(audit.gradient.reason, HasSubstr("reports no contact"));
  EXPECT_FALSE(audit.error);
}

TEST(ExtraModel, DetachedDerivativesAreSaidSo) {
  for (const char* problem : {"bounce_once", "ground_wall", "two_balls"}) {
    const Scene scene = ProblemScene(problem);
    const ModelAudit audit = AuditModel("detached", scene, Precision::kDouble, ComputeExactGradient(scene));
    EXPECT_TRUE(IsWrong(audit.verdict)) << problem;
    EXPECT_FALSE(audit.widths);
    EXPECT_EQ(audit.gradient_check->agreement, Agreement::kDiffers) << problem;
    EXPECT_THAT(audit.VerdictReason(), HasSubstr("agrees with no differences")) << problem;
  }
}

// Models with wrong gradients of other kinds are not reported as contradicting themselves. Some losses jump on a node
// of the time grid, so scenes off the grid are taken.
TEST(ExtraModel, OtherGradientsAgreeWithTheirDifferences) {
  const Scene off_grid[] = {
      BounceOffTheGrid(), LaunchOffTheGrid(), ProblemScene("two_balls"), ProblemScene("multiple_collisions")};
  for (const char* contact : {"mirror",
                              "direct",
                              "direct_toi",
                              "compliant_warp",
                              "pbd_warp",
                              "compliant_brax",
                              "pbd_brax",
                              "toi_velocity",
                              "event",
                              "soft_convex",
                              "smooth_compliant",
                              "xpbd"}) {
    for (const Scene& scene : off_grid) {
      const GradientCheck own = CheckGradient(contact, scene);
      EXPECT_EQ(own.agreement, Agreement::kAgrees) << contact << " in " << scene.name << ": " << own.gradient << " for "
                                                   << own.difference << " by " << QuantityToString(own.quantity);
    }
    for (const char* problem : {"bounce_once", "ground_wall"}) {
      EXPECT_NE(CheckGradient(contact, ProblemScene(problem)).agreement, Agreement::kDiffers) << contact;
    }
  }
}

TEST(ExtraModel, WithoutAReferenceTheWidthsDecide) {
  const ModelAudit audit = AuditModel("mirror", ProblemScene("two_balls"), Precision::kDouble, std::nullopt);
  EXPECT_TRUE(IsWrong(audit.verdict));
  EXPECT_FALSE(audit.refinement);
  EXPECT_NE(audit.VerdictReason(), "");
}

TEST(ExtraModel, ASceneItCannotTakeIsSaidSo) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  const ModelAudit audit = AuditModel("mirror", scene, Precision::kDouble, ComputeExactGradient(scene));
  EXPECT_FALSE(audit.gradient.ok());
  EXPECT_EQ(audit.verdict, Verdict::kUnknown);
}

}  // namespace
}  // namespace saltus
