// A simulator of a scene in natural units does what that of the same scene in SI units does.
#include <gtest/gtest.h>

#include "rescaled_scene.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"
#include "test_scenes.h"

namespace saltus {
namespace {

class InNaturalUnitsTest : public testing::TestWithParam<const char*> {
 protected:
  // Far from one in every unit, so that no factor is 1.
  Scene si_ = Rescaled(FourDiscs(GetParam() == std::string("direct_toi") ? 0 : 0.2),
                       {.name = "", .length = 0.25, .time = 0.5, .mass = 32, .loss = 128});
  Scene natural_ = ToNaturalUnits(si_);
  UnitFactors to_si_{natural_.units, si_.units};

  // Returns the factor of derivatives by the entries of a state.
  double StateFactor(size_t i, int body_size) const {
    const size_t entry = i % body_size;
    return entry < 2 ? to_si_.length : entry < 4 ? to_si_.speed : 1;
  }
};

TEST_P(InNaturalUnitsTest, RolloutsAndGradientsAreTheSame) {
  SingleShooting si(MakeSimulator(GetParam(), si_, Precision::kDouble));
  SingleShooting natural(MakeSimulator(GetParam(), natural_, Precision::kDouble));
  EXPECT_EQ(natural.scene().units, natural_.units);
  double si_loss = 0, natural_loss = 0;
  Sensitivity a, b;
  ASSERT_TRUE(si.EvaluateAll(si.initial_guess(), &si_loss, &a));
  ASSERT_TRUE(natural.EvaluateAll(natural.initial_guess(), &natural_loss, &b));
  EXPECT_EQ(natural_loss * to_si_.loss, si_loss);

  const Simulator& simulator = natural.simulator();
  std::vector<double> x(simulator.state_size()), y(x.size());
  for (int k = 0; k <= simulator.num_steps(); k += 30) {
    si.simulator().GetState(k, x);
    simulator.GetState(k, y);
    for (size_t i = 0; i < x.size(); ++i)
      ASSERT_EQ(y[i] * StateFactor(i, simulator.body_size()), x[i]) << k << " " << i;
  }
  ASSERT_FALSE(si.simulator().touches().empty());
  ASSERT_EQ(simulator.touches().size(), si.simulator().touches().size());
  for (size_t i = 0; i < simulator.touches().size(); ++i) {
    const double time = si.simulator().touches()[i].touch.time;
    EXPECT_EQ(simulator.touches()[i].touch.time * (time < 0 ? 1 : to_si_.time), time);
  }

  const double loss = to_si_.loss;
  for (size_t i = 0; i < a.initial.size(); ++i) {
    ASSERT_EQ(b.initial[i] * loss / (i % 4 < 2 ? to_si_.length : to_si_.speed), a.initial[i]) << i;
  }
  for (size_t i = 0; i < a.control.size(); ++i) ASSERT_EQ(b.control[i] * loss / to_si_.force, a.control[i]) << i;
  EXPECT_EQ(b.parameters.restitution * loss, a.parameters.restitution);
  EXPECT_EQ(b.parameters.friction * loss, a.parameters.friction);
  EXPECT_EQ(b.parameters.stiffness * loss * to_si_.length / to_si_.force, a.parameters.stiffness);
  EXPECT_EQ(b.parameters.damping * loss * to_si_.speed / to_si_.force, a.parameters.damping);
  for (int i = 0; i < si_.num_bodies(); ++i) {
    EXPECT_EQ(b.parameters.mass[i] * loss / to_si_.mass, a.parameters.mass[i]) << i;
    EXPECT_EQ(b.parameters.force[i] * loss / to_si_.force, a.parameters.force[i]) << i;
  }
  EXPECT_EQ(b.parameters.gravity * loss / to_si_.acceleration, a.parameters.gravity);
}

TEST_P(InNaturalUnitsTest, LinearizationsAreTheSame) {
  const auto si = MakeSimulator(GetParam(), si_, Precision::kDouble);
  const auto natural = MakeSimulator(GetParam(), natural_, Precision::kDouble);
  ASSERT_TRUE(si->Rollout(InitialState(si_), InitialControl(si_, si->num_steps())));
  ASSERT_FALSE(si->touches().empty());
  std::vector<double> x(si->state_size()), force(2 * si->num_bodies(), 0.0), y(x.size());
  si->GetState(si->touches().front().step, x);
  y = x;
  for (size_t i = 0; i < y.size(); ++i) y[i] /= StateFactor(i, si->body_size());
  StepLinearization a, b;
  si->Linearize(x, force, true, &a);
  natural->Linearize(y, force, true, &b);
  ASSERT_FALSE(a.islands.empty());
  Eigen::MatrixXd A[2], B[2];
  a.ToDense(&A[0], &B[0]);
  b.ToDense(&A[1], &B[1]);
  const auto factor = [&](Eigen::Index i) { return StateFactor(i, si->body_size()); };
  for (Eigen::Index i = 0; i < A[0].rows(); ++i) {
    for (Eigen::Index j = 0; j < A[0].cols(); ++j) ASSERT_EQ(A[1](i, j) * factor(i) / factor(j), A[0](i, j));
    for (Eigen::Index j = 0; j < B[0].cols(); ++j) ASSERT_EQ(B[1](i, j) * factor(i) / to_si_.force, B[0](i, j));
  }
  const Eigen::MatrixXd &P = a.islands.front().P, &Q = b.islands.front().P;
  const double stiffness = to_si_.force / to_si_.length, damping = to_si_.force / to_si_.speed;
  for (Eigen::Index i = 0; i < P.rows(); ++i) {
    for (Eigen::Index j = 0; j < P.cols(); ++j) {
      const double unit = j < 2 ? 1 : j == 2 ? stiffness : j == 3 ? damping : to_si_.mass;
      ASSERT_EQ(Q(i, j) * factor(i) / unit, P(i, j)) << i << " " << j;
    }
  }
}

// A disc that flies turns by its angular velocity times the step, in radians and seconds, whatever its natural units.
TEST(ToNaturalUnits, AngularVelocityTurnsForTheWholeStep) {
  Scene scene;
  scene.name = "turning";
  scene.duration = 1.5;
  scene.steps = 100;
  scene.bodies = {{"disc", 0.1, 1.0}};
  scene.bodies[0].inertia.kind = Inertia::Kind::kSolid;
  scene.bodies[0].velocity = {8, 0};
  const auto simulator = MakeSimulator("event", scene, Precision::kDouble);
  ASSERT_NE(NaturalUnits(scene).time, 1);
  const std::vector<double> x = ToState(InitialState(scene), 1), force(2, 0.0);
  StepLinearization linearization;
  simulator->Linearize(x, force, false, &linearization);
  ASSERT_EQ(linearization.flying.size(), 1u);
  Eigen::MatrixXd A, B, expected = Eigen::MatrixXd::Identity(6, 6);
  linearization.ToDense(&A, &B);
  expected(0, 2) = expected(1, 3) = expected(4, 5) = scene.dt();
  EXPECT_TRUE(A.isApprox(expected, 1e-15)) << A;
}

INSTANTIATE_TEST_SUITE_P(Models, InNaturalUnitsTest,
                         testing::Values("direct_toi", "compliant_warp", "pbd_brax", "event"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace saltus
