#include "exact/two_disc_optimum.h"

#include <gtest/gtest.h>

#include <cmath>

#include "exact/exact_scenes.h"

namespace saltus {
namespace {

using namespace exact_test;

TwoDiscOptimum Find(const Scene& scene, TwoDiscSequence sequence) {
  std::string reason_not_applicable;
  const std::optional<TwoDiscOptimum> optimum = FindTwoDiscOptimum(scene, sequence, &reason_not_applicable);
  EXPECT_TRUE(optimum) << reason_not_applicable;
  return optimum.value_or(TwoDiscOptimum());
}

TEST(TwoBallsOptimumTest, EqualsReference) {
  const TwoDiscOptimum o = Find(TwoBalls(), TwoDiscSequence::kImpact);
  const auto& reference = References()["task3_optimum"];
  EXPECT_LT(RelativeError(o.loss, Number(reference["J"])), 1e-13);
  EXPECT_LT(RelativeError(o.loss, 1.3965421601231973), 1e-13);
  EXPECT_RELATIVE(o.terminal, Number(reference["terminal"]));
  EXPECT_RELATIVE(o.running, Number(reference["running"]));
  EXPECT_RELATIVE(o.impact_time, Number(reference["s"]));
  EXPECT_RELATIVE(o.impact_speed, Number(reference["v1d"]));
  EXPECT_RELATIVE(o.curvature, Number(reference["Jss"]));
  EXPECT_RELATIVE(o.kink_slope, Number(reference["kink_slope"]));
  EXPECT_RELATIVE(o.hamiltonian_start, Number(reference["H(0)"]));
  EXPECT_RELATIVE(o.hamiltonian_before, Number(reference["H(s-)"]));
  EXPECT_RELATIVE(o.hamiltonian_after, Number(reference["H(s+)"]));
  const auto& costates = reference["costates_t0_x"];
  for (int c = 0; c < 2; ++c) {
    EXPECT_RELATIVE(o.striker_velocity[c], Number(reference["vc"]));
    EXPECT_RELATIVE(o.control_start[c], Number(reference["u(0)_x"]));
    EXPECT_RELATIVE(o.control_slope[c], Number(reference["slope_x"]));
    EXPECT_RELATIVE(o.Control(std::nextafter(o.impact_time, 0))[c], Number(reference["u(s-)_x"]));
    EXPECT_EQ(o.Control(o.impact_time)[c], 0);
    EXPECT_RELATIVE(o.target_final[c], Number(reference["x2T"]));
    EXPECT_RELATIVE(o.costate_start.position[0][c], Number(costates["lam_p1"]));
    EXPECT_RELATIVE(o.costate_start.velocity[0][c], Number(costates["lam_v1"]));
    EXPECT_RELATIVE(o.costate_start.position[1][c], Number(costates["lam_p2"]));
    EXPECT_RELATIVE(o.costate_start.velocity[1][c], Number(costates["lam_v2"]));
    EXPECT_RELATIVE(o.costate_before.position[0][c], Number(reference["lam_p1_x(pre)"]));
    EXPECT_RELATIVE(o.costate_before.velocity[0][c], Number(reference["lam_v1_x(s-)"]));
    EXPECT_NEAR(o.costate_before.velocity[1][c], Number(reference["lam_v2_x(s-)"]), 1e-13);
    EXPECT_RELATIVE(o.costate_after.position[1][c], Number(reference["lam_p2_x"]));
    EXPECT_RELATIVE(o.costate_after.velocity[1][c], Number(reference["lam_v2_x(s)"]));
  }
}

void ExpectFollowUp(const TwoDiscOptimum& o, const nlohmann::json& reference) {
  EXPECT_RELATIVE(o.loss, Number(reference["J"]));
  EXPECT_RELATIVE(o.terminal, Number(reference["terminal"]));
  EXPECT_RELATIVE(o.running, Number(reference["running"]));
  EXPECT_RELATIVE(o.impact_time, Number(reference["s"]));
  EXPECT_RELATIVE(o.angle, Number(reference["phi"]));
  EXPECT_LT((o.normal - Vector(reference["n"])).norm(), kTolerance);
  EXPECT_LT((o.striker_velocity - Vector(reference["w"])).norm(), 5 * kTolerance);
  EXPECT_LT((o.control_start - Vector(reference["c0"])).norm(), 20 * kTolerance);
  EXPECT_LT((o.control_slope - Vector(reference["c1"])).norm(), 50 * kTolerance);
  EXPECT_LT((o.target_final - Vector(reference["p2T"])).norm(), kTolerance);
}

TEST(FollowUpOptimumTest, SingleCollisionEqualsReference) {
  ExpectFollowUp(Find(SingleCollision(), TwoDiscSequence::kImpact), References()["followup_single"]);
}

TEST(FollowUpOptimumTest, MirrorSequenceEqualsReference) {
  const TwoDiscOptimum o = Find(MultipleCollisions(), TwoDiscSequence::kImpactThenPlane);
  ExpectFollowUp(o, References()["followup_multi_B2_mirror"]);
  ASSERT_TRUE(o.plane_time);
  EXPECT_RELATIVE(*o.plane_time, 0.66218262880491428143);
}

// The gradient of the optimal loss by the initial state is the initial costate.
void ExpectCostateIsGradient(const Scene& scene, TwoDiscSequence sequence) {
  const TwoDiscOptimum o = Find(scene, sequence);
  for (int i = 0; i < 2; ++i) {
    for (int c = 0; c < 2; ++c) {
      const auto loss_at = [&](double dp, double dv) {
        Scene changed = scene;
        changed.bodies[i].position[c] += dp;
        changed.bodies[i].velocity[c] += dv;
        return Find(changed, sequence).loss;
      };
      EXPECT_NEAR(o.costate_start.position[i][c], Richardson([&](double h) { return loss_at(h, 0); }, 1e-2), 1e-8);
      EXPECT_NEAR(o.costate_start.velocity[i][c], Richardson([&](double h) { return loss_at(0, h); }, 1e-2), 1e-8);
    }
  }
}

// Checks the conditions of the minimum principle on the control, the costates and the Hamiltonian.
void ExpectMinimumPrinciple(const Scene& scene, const TwoDiscOptimum& o) {
  const double effort = scene.objective.effort;
  const double m1 = scene.bodies[0].mass;
  for (const double t : {0.0, 0.5 * o.impact_time, std::nextafter(o.impact_time, 0)}) {
    const Vec2d costate = o.costate_start.velocity[0] - t * o.costate_start.position[0];
    EXPECT_LT((2 * effort * o.Control(t) + costate / m1).norm(), 1e-11);
  }
  EXPECT_NEAR(o.hamiltonian_before, o.hamiltonian_start, 1e-11);
  EXPECT_NEAR(o.hamiltonian_after, o.hamiltonian_start, 1e-11);
}

Scene UnequalDiscs() {
  Scene scene = SingleCollision();
  scene.duration = 1.3;
  scene.bodies[0].mass = 1.7;
  scene.bodies[0].velocity = {-0.2, 0.3};
  scene.bodies[1].velocity = {0.1, -0.1};
  scene.bodies[1].radius = 0.25;
  scene.contact.restitution = 0.8;
  scene.objective.terminal[0].weight = 0.7;
  scene.objective.terminal[0].target = {0.1, 0.4};
  return scene;
}

TEST(TwoDiscOptimumTest, MinimumPrincipleHolds) {
  for (const Scene& scene : {TwoBalls(), SingleCollision(), UnequalDiscs()}) {
    ExpectMinimumPrinciple(scene, Find(scene, TwoDiscSequence::kImpact));
  }
  ExpectMinimumPrinciple(MultipleCollisions(), Find(MultipleCollisions(), TwoDiscSequence::kImpactThenPlane));
}

TEST(TwoDiscOptimumTest, CostateIsGradientOfTheOptimalLoss) {
  ExpectCostateIsGradient(TwoBalls(), TwoDiscSequence::kImpact);
  ExpectCostateIsGradient(UnequalDiscs(), TwoDiscSequence::kImpact);
  ExpectCostateIsGradient(MultipleCollisions(), TwoDiscSequence::kImpactThenPlane);
}

TEST(TwoDiscOptimumTest, RefusesOtherProblems) {
  const auto expect_refusal = [](const Scene& scene, TwoDiscSequence sequence, const std::string& reason) {
    std::string reason_not_applicable;
    EXPECT_FALSE(FindTwoDiscOptimum(scene, sequence, &reason_not_applicable));
    EXPECT_NE(reason_not_applicable.find(reason), std::string::npos) << reason_not_applicable;
  };
  expect_refusal(BounceOnce(), TwoDiscSequence::kImpact, "two discs");
  expect_refusal(TwoBalls(), TwoDiscSequence::kImpactThenPlane, "one plane");
  Scene scene = TwoBalls();
  scene.gravity = {0, -1};
  expect_refusal(scene, TwoDiscSequence::kImpact, "gravity");
  scene = TwoBalls();
  scene.contact.friction = 0.1;
  expect_refusal(scene, TwoDiscSequence::kImpact, "friction");
  scene = MultipleCollisions();
  scene.contact.restitution = 0.9;
  expect_refusal(scene, TwoDiscSequence::kImpactThenPlane, "elastic");
}

}  // namespace
}  // namespace saltus
