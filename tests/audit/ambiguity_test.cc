// Where the order of impacts at the same time decides, there is no gradient to be right about.
#include <gmock/gmock.h>

#include "saltus/audit/audit.h"
#include "saltus/audit/external_gradient.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::UnorderedElementsAre;

TEST(AmbiguousAudit, NoModelGetsAVerdict) {
  std::optional<LossSpread> first_spread;
  for (const Scene& scene : {StrikesTwo(), StrikesTwoSwapped()}) {
    const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
    ASSERT_TRUE(exact && exact->spread);
    for (const ModelTraits& model : AllContactModels()) {
      if (!ReasonNotApplicable(model.name, scene).empty()) continue;
      const ModelAudit audit = AuditModel(model.name, scene, Precision::kDouble, exact);
      EXPECT_EQ(audit.verdict, Verdict::kAmbiguous) << model.name;
      EXPECT_STREQ(VerdictToString(audit.verdict), "ambiguous");
      EXPECT_FALSE(audit.error || audit.refinement || audit.attribution) << model.name;
      ASSERT_EQ(audit.ambiguous.size(), 1u);
      EXPECT_THAT(audit.ambiguous[0].bodies, UnorderedElementsAre("striker", "left", "right"));
      EXPECT_THAT(audit.VerdictReason(), HasSubstr(" decides; the loss is 0."));
      ASSERT_TRUE(audit.spread);
      if (!first_spread) first_spread = audit.spread;
      EXPECT_NEAR(audit.spread->lowest, first_spread->lowest, 1e-12);
      EXPECT_NEAR(audit.spread->highest, first_spread->highest, 1e-12);
    }
  }
  EXPECT_GT(first_spread->highest - first_spread->lowest, 0.02);
}

TEST(AmbiguousAudit, SurrogatesAndGivenGradientsNeither) {
  const Scene scene = StrikesTwo();
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  AuditOptions options;
  options.surrogate = Surrogate{.kind = SurrogateKind::kSmoothedFirst, .sigma = 0.01, .samples = 4};
  const ModelAudit audit = AuditModel("event", scene, Precision::kDouble, exact, options);
  EXPECT_TRUE(audit.gradient.ok()) << audit.gradient.reason;
  EXPECT_EQ(audit.verdict, Verdict::kAmbiguous);
  EXPECT_FALSE(audit.error);

  ExternalGradient given;
  given.position = {exact->gradient.initial[0], -1};
  const std::vector<ExternalGradientEntry> entries = JudgeExternalGradient(scene, given, *exact);
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[0].verdict, Verdict::kAmbiguous);
  EXPECT_EQ(WorstVerdict(entries), Verdict::kAmbiguous);
}

TEST(AmbiguousAudit, StudiesOfRefinementSayWhy) {
  const RefinementStudy study = StudyRefinement("event", StrikesTwo());
  EXPECT_EQ(study.verdict, Verdict::kAmbiguous);
  EXPECT_THAT(study.reason, HasSubstr("striker, left and right"));
}

// A row of equal discs that touch, struck at its end: every order leads to the same velocities.
TEST(AmbiguousAudit, ACradleHasAVerdict) {
  Scene scene = StrikesTwo();
  scene.bodies[1].position = {0, 0};
  scene.bodies[2].position = {0.2, 0};
  scene.control.initial = {{0, 0}};  // nothing presses afterwards
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  ASSERT_TRUE(exact);
  EXPECT_TRUE(exact->ambiguous.empty());
  EXPECT_FALSE(exact->spread);
  EXPECT_EQ(AuditModel("event", scene, Precision::kDouble, exact).verdict, Verdict::kRight);
}

}  // namespace
}  // namespace saltus
