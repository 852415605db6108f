// A step whose iterations end without a result says so, and the rollout fails.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "contact/models/qcqp.h"
#include "contact/solvers/lcp_solver.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string FailureReason(const std::string& model, const Scene& scene) {
  const auto simulator = MakeSimulator(model, scene, Precision::kDouble);
  EXPECT_FALSE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())));
  return simulator->FailureReason();
}

// Discs in a row that overlap by `overlap`, the first of them that of a wall.
Scene Row(int discs, double overlap) {
  Scene scene;
  scene.name = "row";
  scene.duration = 0.01;
  scene.gravity = {-10, 0};
  for (int i = 0; i < discs; ++i) {
    scene.bodies.push_back({.name = "d" + std::to_string(i), .radius = 0.5, .position = {0.5 + i - i * overlap, 0}});
  }
  scene.planes = {{"wall", {overlap, 0}, {1, 0}}};
  return scene;
}

// Gauss-Seidel passes the weight of a row on by one disc a sweep, and back.
TEST(IterationLimits, SoftConvexFailsWithoutItsForces) {
  const std::string stiff = "soft_convex:dmin=0.9999:dmax=0.9999";
  EXPECT_THAT(FailureReason(stiff, Row(150, 1e-6)),
              AllOf(HasSubstr("step 0 of soft_convex"), HasSubstr("sweeps for the contact forces do not converge")));
}

TEST(IterationLimits, SoftConvexTakesAShorterRow) {
  const auto simulator = MakeSimulator("soft_convex", Row(20, 1e-6), Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(simulator->scene()), {})) << simulator->FailureReason();
}

// A disc between two walls that hits them thousands of times in one step.
TEST(IterationLimits, LcpKktFailsAtItsSubsteps) {
  Scene scene;
  scene.name = "rattle";
  scene.duration = 0.1;
  scene.bodies = {{.name = "ball", .radius = 0.5, .position = {0.5005, 0}, .velocity = {100, 0}}};
  scene.planes = {{"left", {0, 0}, {1, 0}}, {"right", {1.001, 0}, {-1, 0}}};
  EXPECT_THAT(FailureReason("lcp_kkt", scene),
              AllOf(HasSubstr("step 0 of lcp_kkt"), HasSubstr("most substeps"), HasSubstr("(ball)")));
}

TEST(IterationLimits, QcqpSaysThatItsProgramsDoNotAgree) {
  Scene scene = Row(3, 1e-6);
  scene.contact.friction = 0.5;
  for (Body& body : scene.bodies) body.velocity = {-1, 1};
  EXPECT_THAT(FailureReason("qcqp:passes=1", scene), AllOf(HasSubstr("of qcqp"), HasSubstr("do not come to agree")));
}

// Coordinate descent along a long chain ends at its most sweeps; the solve that follows has the minimum.
TEST(IterationLimits, ABoxProgramIsEitherSolvedOrNot) {
  const int n = 100;
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);
  for (int i = 0; i < n; ++i) {
    A(i, i) = 2;
    if (i > 0) A(i, i - 1) = A(i - 1, i) = -1;
  }
  const Eigen::VectorXd c = Eigen::VectorXd::Constant(n, -1.0), low = Eigen::VectorXd::Zero(n);
  const Eigen::VectorXd high = Eigen::VectorXd::Constant(n, std::numeric_limits<double>::infinity());
  const auto solved = SolveBoxQp(A, c, low, high, low);
  ASSERT_TRUE(solved);
  EXPECT_LT((A * *solved + c).cwiseAbs().maxCoeff(), 1e-7);
  const Eigen::VectorXd wrong = Eigen::VectorXd::Constant(n, std::numeric_limits<double>::quiet_NaN());
  EXPECT_FALSE(SolveBoxQp(A, wrong, low, high, low));
}

TEST(IterationLimits, TheLastResortOfLcpSaysWhetherItHasWorked) {
  BoxedLcp problem;
  problem.matrix = Eigen::MatrixXd::Identity(1, 1);
  problem.rhs = Eigen::VectorXd::Constant(1, 0.5);
  problem.normal = {0};
  problem.friction = Eigen::VectorXd::Zero(1);
  EXPECT_TRUE(SolveBoxedLcp(problem).fits);
  problem.matrix *= -1.0;  // a push that pulls
  EXPECT_FALSE(SolveBoxedLcp(problem).fits);
}

// All the way up: a solver's report names the step.
TEST(IterationLimits, ASolverPassesTheReasonOn) {
  Scene scene = Row(150, 1e-6);
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  scene.objective.terminal = {{.body = 0}};
  const SolveReport report =
      Solve("gd", {.scene = scene, .contact = "soft_convex:dmin=0.9999:dmax=0.9999"}, {.limits = {.iterations = 1}});
  EXPECT_EQ(report.termination, Termination::kFailed);
  EXPECT_THAT(report.reason, HasSubstr("step 0 of soft_convex"));
}

}  // namespace
}  // namespace saltus
