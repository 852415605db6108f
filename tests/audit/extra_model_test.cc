// A model that is known by its header alone (mirror_model.h) is audited like any other.
#include <gtest/gtest.h>

#include "saltus/audit/audit.h"
#include "saltus/dynamics/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

ModelAudit Audit(const std::string& problem) {
  const Scene scene = ProblemScene(problem);
  return AuditModel("mirror", scene, Precision::kDouble, ExactGradientOf(scene), {.width_sweep = true});
}

TEST(ExtraModel, IsTheLastInTheRegistry) {
  EXPECT_EQ(AllContactModels().back().name, "mirror");
  EXPECT_EQ(AllContactModels().size(), SALTUS_NUM_MODELS);
}

TEST(ExtraModel, IsRightWhereNothingAccelerates) {
  const ModelAudit audit = Audit("bounce_once");
  EXPECT_EQ(audit.verdict, Verdict::kRight);
  EXPECT_EQ(audit.FirstWrong(), nullptr);
  EXPECT_EQ(audit.Why(), "");
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
  EXPECT_EQ(audit.Why(), "acceleration at the impact ignored");
  EXPECT_TRUE(IsWrong(audit.widths->verdict));
}

TEST(ExtraModel, WithoutAReferenceTheWidthsDecide) {
  const ModelAudit audit = AuditModel("mirror", ProblemScene("two_balls"), Precision::kDouble, std::nullopt);
  EXPECT_TRUE(IsWrong(audit.verdict));
  EXPECT_FALSE(audit.refinement);
  EXPECT_NE(audit.Why(), "");
}

TEST(ExtraModel, ASceneItCannotTakeIsSaidSo) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  const ModelAudit audit = AuditModel("mirror", scene, Precision::kDouble, ExactGradientOf(scene));
  EXPECT_FALSE(audit.gradient.ok());
  EXPECT_EQ(audit.verdict, Verdict::kUnknown);
}

}  // namespace
}  // namespace saltus
