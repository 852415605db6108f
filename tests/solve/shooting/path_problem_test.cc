// The gaps at nodes against rollouts, and by the forces against differences.
#include "solve/shooting/path_problem.h"

#include <gtest/gtest.h>

#include <cmath>

#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

PathProblem::LinearGaps GapsAt(SingleShooting* shooting, const std::vector<double>& z,
                               const std::vector<Arrival>& arrivals) {
  double loss = 0;
  EXPECT_TRUE(shooting->Evaluate(z, &loss, nullptr));
  PathProblem problem(shooting, z, arrivals);
  problem.Minimize(0, 0, {});
  return problem.LinearizeGaps().value();
}

// Discs of several masses, one fixed, a plane, gravity, two forces; collisions happen before the later nodes.
TEST(PathProblem, GapsAgreeWithDifferences) {
  const Scene scene = FourDiscs(0);
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  const std::vector<Arrival> arrivals = {
      {2, {0, 2, false}}, {40, {0, 1, false}}, {140, {2, 3, false}}, {145, {2, 0, true}}};
  const std::vector<double> z = shooting.initial_guess();
  const PathProblem::LinearGaps here = GapsAt(&shooting, z, arrivals);
  ASSERT_GT(shooting.simulator().touches().size(), 1u);
  ASSERT_LT(shooting.simulator().touches().front().step, 100);
  for (const size_t i : {0, 3, 4, 50, 101, 300, 553, 556, 559, 560, 575, 579}) {
    constexpr double kWidth = 1e-4;
    std::vector<double> up = z, down = z;
    up[i] += kWidth;
    down[i] -= kWidth;
    const Eigen::VectorXd slope =
        (GapsAt(&shooting, up, arrivals).values - GapsAt(&shooting, down, arrivals).values) / (2 * kWidth);
    EXPECT_LT((slope - here.jacobian.col(i)).lpNorm<Eigen::Infinity>(), 1e-7 + 1e-5 * slope.norm()) << i;
  }
}

// With other forces in the first of the two steps before the node than in the second.
TEST(PathProblem, AGapIsWhatTheRolloutLeaves) {
  const Scene scene = FourDiscs(0);
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  std::vector<double> z = shooting.initial_guess();
  z[2] = 300;  // N, on disc 0
  z[6] = -200;
  const PathProblem::LinearGaps gaps = GapsAt(&shooting, z, {{2, {0, 2, false}}});
  ASSERT_GE(shooting.simulator().touches().front().step, 2);
  std::vector<double> x(4 * scene.num_bodies());
  shooting.simulator().GetState(2, x);
  const double distance = std::hypot(x[8] - x[0], x[9] - x[1]);
  EXPECT_NEAR(gaps.values[0], distance - scene.bodies[0].radius - scene.bodies[2].radius, 1e-13);
}

// Held on a node, an impact happens there.
TEST(PathProblem, HoldsAnImpactOnANode) {
  const Scene scene = ProblemScene("two_balls");
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr));
  ASSERT_EQ(shooting.simulator().touches().front().step, 331);
  PathProblem problem(&shooting, shooting.initial_guess(), {{330, {0, 1, false}}});
  problem.Minimize(20, 1e-14, {});
  ASSERT_TRUE(shooting.Evaluate(problem.z(), &loss, nullptr));
  const StepTouch touch = shooting.simulator().touches().front();
  EXPECT_NEAR(touch.step + touch.touch.time / scene.dt(), 330, 1e-3);
  EXPECT_NEAR(loss, 1.3968818366402, 1e-6);  // the best with the impact there, from 50-digit arithmetic
}

}  // namespace
}  // namespace saltus
