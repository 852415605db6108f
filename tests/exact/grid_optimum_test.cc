#include <gtest/gtest.h>

#include "exact/exact_scenes.h"
#include "exact/two_disc_optimum.h"

namespace saltus {
namespace {

using namespace exact_test;

GridOptimum FindOnGrid(const Scene& scene, TwoDiscSequence sequence) {
  std::string reason_not_applicable;
  const std::optional<GridOptimum> optimum = FindGridOptimum(scene, sequence, &reason_not_applicable);
  EXPECT_TRUE(optimum) << reason_not_applicable;
  return optimum.value_or(GridOptimum());
}

void ExpectStationary(const GridOptimum& o) {
  EXPECT_GE(o.theta, 0);
  EXPECT_LE(o.theta, 1);
  EXPECT_LT(o.residual, 1e-15);
}

TEST(GridOptimumTest, TwoBallsEqualReferenceForAllGrids) {
  for (const auto& [steps, reference] : References()["task3_zoh"].items()) {
    const GridOptimum o = FindOnGrid(TwoBalls(std::stoi(steps)), TwoDiscSequence::kImpact);
    EXPECT_RELATIVE(o.loss, Number(reference["J"]));
    EXPECT_RELATIVE(o.impact_time, Number(reference["impact_time"]));
    EXPECT_EQ(o.node, reference["node"].get<int>());
    ExpectStationary(o);
  }
}

TEST(GridOptimumTest, TwoBallsCertificateAndControl) {
  const GridOptimum o = FindOnGrid(TwoBalls(480), TwoDiscSequence::kImpact);
  EXPECT_NEAR(o.theta, 0.504275798973, 1e-11);
  EXPECT_NEAR(FindOnGrid(TwoBalls(1000), TwoDiscSequence::kImpact).theta, 0.488087704578, 1e-11);
  ASSERT_EQ(o.control.size(), 480u);
  for (int c = 0; c < 2; ++c) {
    EXPECT_RELATIVE(o.control[0][c], 3.92574313233579969);
    EXPECT_RELATIVE(o.control[327][c], 1.35971061350730089);
    EXPECT_EQ(o.control[328][c], 0);
  }
}

// The kink makes a range of nodes local minima: those in the table and no others.
TEST(GridOptimumTest, NodesThatAreLocalMinima) {
  const auto& reference = References()["task3_node_minima_480"];
  for (int node = 318; node < 340; ++node) {
    const auto o = OptimizeWithImpactAt(TwoBalls(480), TwoDiscSequence::kImpact, node);
    ASSERT_TRUE(o);
    EXPECT_LT(o->residual, 1e-15);
    const std::string key = std::to_string(node);
    EXPECT_EQ(o->theta >= 0 && o->theta <= 1, reference.contains(key)) << node;
    if (!reference.contains(key)) continue;
    EXPECT_NEAR(o->loss, Number(reference[key]), 6e-14) << node;
  }
}

// "0.311418376820024856 (node 221)"
void ExpectFollowUp(const GridOptimum& o, const std::string& reference) {
  EXPECT_RELATIVE(o.loss, std::stod(reference));
  EXPECT_EQ(o.node, std::stoi(reference.substr(reference.find("node ") + 5)));
  ExpectStationary(o);
}

TEST(GridOptimumTest, FollowUpsEqualReference) {
  const auto& reference = References()["followup_zoh"];
  for (const int steps : {480, 1000}) {
    const std::string key = std::to_string(steps);
    ExpectFollowUp(FindOnGrid(SingleCollision(steps), TwoDiscSequence::kImpact), reference["single"][key]);
    ExpectFollowUp(FindOnGrid(MultipleCollisions(steps), TwoDiscSequence::kImpactThenPlane),
                   reference["multi_B2"][key]);
  }
}

// The loss of arbitrary forces before the impact, the striker's motion summed step by step.
double LossOf(const Scene& scene, const std::vector<Vec2d>& control) {
  Vec2d p1 = scene.bodies[0].position, v1 = Vec2d::Zero();
  const Vec2d p2 = scene.bodies[1].position;
  const double h = scene.dt(), reach = scene.bodies[0].radius + scene.bodies[1].radius;
  double running = 0;
  for (const Vec2d& u : control) running += scene.objective.effort * h * u.squaredNorm();
  for (int k = 0; k < scene.steps; ++k) {
    const auto gap = [&](double t) { return (p1 + t * v1 + t * t / 2 * control[k] - p2).norm() - reach; };
    if (gap(h) > 0) {
      p1 += h * v1 + h * h / 2 * control[k];
      v1 += h * control[k];
      continue;
    }
    double low = 0, high = h;
    for (int i = 0; i < 100; ++i) (gap(0.5 * (low + high)) > 0 ? low : high) = 0.5 * (low + high);
    const Vec2d n = (p2 - p1 - low * v1 - low * low / 2 * control[k]).normalized();
    const Vec2d v2 = n.dot(v1 + low * control[k]) * n;
    return (p2 + (scene.duration - k * h - low) * v2).squaredNorm() + running;
  }
  return p2.squaredNorm() + running;
}

// No small change of a few forces lowers the loss, whether it makes the impact earlier or later.
TEST(GridOptimumTest, NeighboursAreNotBetter) {
  for (const Scene& scene : {TwoBalls(60), SingleCollision(60)}) {
    const GridOptimum o = FindOnGrid(scene, TwoDiscSequence::kImpact);
    EXPECT_NEAR(LossOf(scene, o.control), o.loss, 1e-10);
    for (int i = 0; i < scene.steps; ++i) {
      for (const Vec2d& change : {Vec2d(1e-3, 0), Vec2d(-1e-3, 0), Vec2d(0, 1e-3), Vec2d(0, -1e-3)}) {
        std::vector<Vec2d> control = o.control;
        control[i] += change;
        control[(7 * i + 3) % scene.steps] -= 0.6 * change;
        EXPECT_GT(LossOf(scene, control), o.loss) << i;
      }
    }
  }
}

TEST(GridOptimumTest, RefusesOtherProblems) {
  std::string reason_not_applicable;
  EXPECT_FALSE(FindGridOptimum(GroundWall(0), TwoDiscSequence::kImpact, &reason_not_applicable));
  EXPECT_EQ(reason_not_applicable, "there must be two discs");
}

TEST(GridOptimumDeathTest, NodeOutOfRange) {
  EXPECT_DEATH(OptimizeWithImpactAt(TwoBalls(480), TwoDiscSequence::kImpact, 480), "no such node");
}

}  // namespace
}  // namespace saltus
