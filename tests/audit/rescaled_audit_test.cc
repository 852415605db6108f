// The audit says the same of a model, whatever the units of a scene and wherever its origin is.
#include <gmock/gmock.h>

#include <algorithm>
#include <string>

#include "rescaled_scene.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

struct Case {
  std::string contact, problem;
  friend void PrintTo(const Case& at, std::ostream* os) { *os << at.contact << " " << at.problem; }
};

std::string NameOf(const testing::TestParamInfo<Case>& info) { return info.param.contact + "_" + info.param.problem; }

Scene SceneOf(const std::string& problem) {
  Scene scene = ProblemScene(problem);
  scene.steps /= 6;
  return scene;
}

ModelAudit Audit(const std::string& contact, const Scene& scene) {
  AuditOptions options;
  options.width_sweep = true;
  options.refinement.levels = 4;
  options.refinement.samples = 3;
  return AuditModel(contact, scene, Precision::kDouble, ComputeExactGradient(scene), options);
}

// Verdicts, classes and what is said; numbers to `tolerance`, 0 for the same bits.
void ExpectSame(const ModelAudit& own, const ModelAudit& rescaled, const Rescaling& by, double tolerance) {
  EXPECT_EQ(rescaled.verdict, own.verdict);
  // Other than in natural units, durations are part of what is said.
  if (by.time == 1) {
    EXPECT_EQ(rescaled.VerdictReason(), own.VerdictReason());
  }
  ASSERT_EQ(rescaled.error.has_value(), own.error.has_value());
  if (own.error) {
    EXPECT_NEAR(rescaled.error->relative, own.error->relative, tolerance);
    EXPECT_NEAR(rescaled.error->angle, own.error->angle, 1e-7);
  }
  ASSERT_EQ(rescaled.refinement.has_value(), own.refinement.has_value());
  if (own.refinement) {
    ASSERT_EQ(rescaled.refinement->quantities.size(), own.refinement->quantities.size());
    for (size_t q = 0; q < own.refinement->quantities.size(); ++q) {
      const QuantityStudy &a = own.refinement->quantities[q], &b = rescaled.refinement->quantities[q];
      EXPECT_EQ(b.verdict, a.verdict);
      ASSERT_EQ(b.levels.size(), a.levels.size());
      for (size_t i = 0; i < a.levels.size(); ++i) EXPECT_NEAR(b.levels[i].error, a.levels[i].error, tolerance);
    }
  }
  ASSERT_EQ(rescaled.attribution.has_value(), own.attribution.has_value());
  if (own.attribution) {
    EXPECT_EQ(rescaled.attribution->first_wrong, own.attribution->first_wrong);
    ASSERT_EQ(rescaled.attribution->contacts.size(), own.attribution->contacts.size());
    for (size_t i = 0; i < own.attribution->contacts.size(); ++i) {
      const ContactError &a = own.attribution->contacts[i], &b = rescaled.attribution->contacts[i];
      EXPECT_NEAR(b.error, a.error, tolerance * std::max(1.0, a.error));
      EXPECT_EQ(b.block, a.block);
      EXPECT_EQ(b.first_step, a.first_step);
    }
  }
  ASSERT_EQ(rescaled.recognition.has_value(), own.recognition.has_value());
  if (own.recognition) {
    EXPECT_EQ(rescaled.recognition->contact_class, own.recognition->contact_class);
  }
  ASSERT_EQ(rescaled.widths.has_value(), own.widths.has_value());
  if (own.widths) {
    EXPECT_EQ(rescaled.widths->verdict, own.widths->verdict);
    ASSERT_EQ(rescaled.widths->sweeps.size(), own.widths->sweeps.size());
    for (size_t i = 0; i < own.widths->sweeps.size(); ++i) {
      const WidthSweep &a = own.widths->sweeps[i], &b = rescaled.widths->sweeps[i];
      EXPECT_EQ(b.finding, a.finding) << a.entry;
      const double unit = a.quantity == Quantity::kPosition   ? by.length
                          : a.quantity == Quantity::kVelocity ? by.speed()
                                                              : by.force();
      EXPECT_NEAR(b.grid_width, a.grid_width * unit, std::max(tolerance, 1e-12) * a.grid_width * unit);
      EXPECT_NEAR(b.wide, a.wide * by.loss / unit, std::max(1e3 * tolerance, 1e-12) * by.loss / unit);
    }
  }
}

class EveryModel : public testing::TestWithParam<Case> {};

TEST_P(EveryModel, IsJudgedAlikeForAnyUnitOfTheLoss) {
  const Scene scene = SceneOf(GetParam().problem);
  const ModelAudit own = Audit(GetParam().contact, scene);
  ASSERT_TRUE(own.gradient.ok()) << own.gradient.reason;
  for (const Rescaling& by : LossRescalings()) {
    SCOPED_TRACE(by.name);
    ExpectSame(own, Audit(GetParam().contact, Rescaled(scene, by)), by, 0);
  }
}

TEST_P(EveryModel, IsJudgedAlikeFarFromTheOrigin) {
  const Scene scene = SceneOf(GetParam().problem);
  const Rescaling far{.name = "far", .shift = {Power(18), -Power(19)}};
  ExpectSame(Audit(GetParam().contact, scene), Audit(GetParam().contact, Rescaled(scene, far)), far, 0);
}

// One of each kind; those that take long are left out.
INSTANTIATE_TEST_SUITE_P(Models, EveryModel,
                         testing::Values(Case{"event", "two_balls"}, Case{"event", "ground_wall"},
                                         Case{"direct_toi", "two_balls"}, Case{"convex", "ground_wall"},
                                         Case{"compliant_warp", "two_balls"}, Case{"toi_velocity", "ground_wall"},
                                         Case{"compliant_brax", "two_balls"}, Case{"pbd_warp", "ground_wall"},
                                         Case{"xpbd", "two_balls"}),
                         NameOf);

// Whose step has no constant with a unit.
class ModelWithoutUnits : public testing::TestWithParam<Case> {};

TEST_P(ModelWithoutUnits, IsJudgedAlikeInAnyUnits) {
  const Scene scene = SceneOf(GetParam().problem);
  const ModelAudit own = Audit(GetParam().contact, scene);
  ASSERT_TRUE(own.gradient.ok()) << own.gradient.reason;
  for (const Rescaling& by : UnitRescalings()) {
    SCOPED_TRACE(by.name);
    ExpectSame(own, Audit(GetParam().contact, Rescaled(scene, by)), by, 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Models, ModelWithoutUnits,
                         testing::Values(Case{"event", "two_balls"}, Case{"event", "ground_wall"},
                                         Case{"direct", "two_balls"}, Case{"convex", "ground_wall"}),
                         NameOf);

}  // namespace
}  // namespace saltus
