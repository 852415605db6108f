// Gradient descent under further formulations of contact, and what its results are worth under exact dynamics: values
// of an independent implementation.
#include <gtest/gtest.h>

#include "saltus/control/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

struct Expected {
  const char* model;
  double loss, exact;  // after 1000 updates
  double tolerance, exact_tolerance;
};
void PrintTo(const Expected& expected, std::ostream* out) { *out << expected.model; }
std::string NameOf(const testing::TestParamInfo<Expected>& info) { return info.param.model; }

class TwoBallsUnder : public testing::TestWithParam<Expected> {};

// Right trajectories with gradients of the wrong sign end at no effort and no hit (loss 2); force laws and projections
// learn.
TEST_P(TwoBallsUnder, ReachesItsLossByDescent) {
  const Scene scene = ProblemScene("two_balls");
  const SolveReport report = Solve("gd", {scene, GetParam().model}, {.learning_rate = 10});
  EXPECT_NEAR(report.final_loss, GetParam().loss, GetParam().tolerance);
  const ExactRun exact = SimulateExactly(scene, report.initial_state, report.control);
  ASSERT_TRUE(exact.ok) << exact.reason;
  EXPECT_NEAR(exact.loss, GetParam().exact, GetParam().exact_tolerance);
}

INSTANTIATE_TEST_SUITE_P(Formulations, TwoBallsUnder,
                         testing::Values(Expected{"lcp_kkt", 2.001414, 2.0014, 1e-6, 5e-5},
                                         Expected{"lcp_pgs", 1.733545, 1.7528, 1e-6, 5e-5},
                                         Expected{"lcp_pgs_adjoint", 1.733545, 1.7528, 1e-6, 5e-5},
                                         Expected{"ncp_restitution", 2.001431, 2.0014, 1e-6, 5e-5},
                                         Expected{"soft_convex", 1.441198, 1.4023, 1e-6, 5e-5},
                                         Expected{"qcqp", 2.001398, 2.0014, 1e-6, 5e-5},
                                         Expected{"smooth_compliant", 1.420041, 1.400528, 1e-6, 1e-6},
                                         Expected{"xpbd", 1.430723, 1.4308, 1e-6, 5e-5}),
                         NameOf);

class GroundWallUnder : public testing::TestWithParam<Expected> {};

TEST_P(GroundWallUnder, ReachesItsLossByDescent) {
  const Scene scene = ProblemScene("ground_wall");
  const SolveReport report = Solve("gd", {scene, GetParam().model}, {.learning_rate = 0.01});
  EXPECT_NEAR(report.final_loss, GetParam().loss, GetParam().tolerance);
  const ExactRun exact = SimulateExactly(scene, report.initial_state, report.control);
  ASSERT_TRUE(exact.ok) << exact.reason;
  EXPECT_NEAR(exact.loss, GetParam().exact, GetParam().exact_tolerance);
}

INSTANTIATE_TEST_SUITE_P(Formulations, GroundWallUnder,
                         testing::Values(Expected{"lcp_kkt", 4.00508e-3, 4.288e-3, 1e-8, 1e-6},
                                         Expected{"ncp_restitution", 4.79892e-3, 3.439e-3, 1e-8, 1e-6},
                                         Expected{"qcqp", 4.49834e-3, 4.370e-3, 1e-8, 1e-6},
                                         Expected{"smooth_compliant", 2.97630e-3, 0.1724, 1e-7, 1e-4},
                                         Expected{"xpbd", 9.40619e-3, 9.111e-3, 1e-8, 1e-6}),
                         NameOf);

}  // namespace
}  // namespace saltus
