// The certificate with bounds, hard terms, running costs and a free final time: it accepts optima along with their
// multipliers, and rejects what is near them.
#include <gmock/gmock.h>

#include <cmath>

#include "constrained_reference.h"
#include "saltus/optimality/certificate.h"
#include "saltus/solve/solver.h"
#include "scene/units.h"

namespace saltus {
namespace {

using Verdict = Certificate::Verdict;

SolveReport OptimumByPhases(const Scene& scene) {
  SolveReport report = Solve("ceres_phases", {scene, "event"}, FromGuess(scene));
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  return report;
}

Certificate CertifyOptimum(const Scene& scene, const SolveReport& report) {
  return Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
}

class ConstrainedCertificate : public testing::TestWithParam<Json> {};

TEST_P(ConstrainedCertificate, AcceptsTheOptimum) {
  const Scene scene = SceneOf(GetParam(), 480);
  const Certificate certificate = CertifyOptimum(scene, OptimumByPhases(scene));
  EXPECT_TRUE(certificate.IsStationary()) << certificate.reason;
  ASSERT_EQ(certificate.impacts.size(), 1u);
  EXPECT_NEAR(certificate.impacts[0].time, GetParam()["impact_time"].get<double>(), 2e-5);
  EXPECT_EQ(certificate.final_time.has_value(), scene.objective.duration.has_value());
  EXPECT_EQ(certificate.constraints.size(), scene.objective.terminal[0].hard ? 1u : 0u);
  if (scene.objective.effort == 0) {
    EXPECT_FALSE(certificate.curvature.has_value());
    EXPECT_THAT(certificate.reason, testing::HasSubstr("linear in the forces"));
    return;
  }
  ASSERT_TRUE(certificate.curvature.has_value()) << certificate.reason;
  EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
  EXPECT_GT(certificate.curvature->smallest, scene.objective.duration ? 0.1 : 0.3);
  EXPECT_LE(certificate.curvature->smallest, 1);
}

TEST_P(ConstrainedCertificate, RejectsOneForceChangedByOnePercent) {
  const Scene scene = SceneOf(GetParam(), 480);
  SolveReport report = OptimumByPhases(scene);
  for (int interval : {0, 100, 250}) {
    SolveReport changed = report;
    changed.solution.control[2 * interval] *= 0.99;
    const Certificate certificate = CertifyOptimum(scene, changed);
    EXPECT_EQ(certificate.verdict, Verdict::kNotStationary) << interval;
    EXPECT_FALSE(certificate.reason.empty());
  }
}

INSTANTIATE_TEST_SUITE_P(All, ConstrainedCertificate, testing::ValuesIn(References()),
                         [](const auto& test) { return TestName(test.param); });

// The optimum under a bound is none under a wider one, where the force is not at the bound any more.
TEST(Certificate, KnowsWhichBoundHolds) {
  for (const char* name : {"max_3.5", "max_norm_diagonal_3.5"}) {
    Scene scene = SceneOf(Reference(name), 480);
    const SolveReport report = OptimumByPhases(scene);
    for (std::vector<double>* bounds : {&scene.control.max, &scene.control.max_norm}) {
      for (double& bound : *bounds) bound *= 1.001;
    }
    const Certificate certificate = CertifyOptimum(scene, report);
    EXPECT_EQ(certificate.verdict, Verdict::kNotStationary) << name;
    EXPECT_EQ(certificate.reason, "the largest residual is that of stationarity");
  }
}

// At a bound, but the loss falls inwards.
TEST(Certificate, RejectsAForceAtTheWrongBound) {
  const Scene scene = SceneOf(Reference("max_3.5"), 480);
  SolveReport report = OptimumByPhases(scene);
  ASSERT_NEAR(report.solution.control[0], 3.5, 1e-9);
  report.solution.control[2 * 479] = 3.5;  // after the impact, where a force is wasted
  EXPECT_EQ(CertifyOptimum(scene, report).verdict, Verdict::kNotStationary);
}

TEST(Certificate, FindsTheMultiplierOfAHardTargetWithSecondOrder) {
  constexpr double kExact = -1.2626901100608278905;  // constrained-references: by moving the target
  std::vector<double> errors;
  for (int steps : {60, 240}) {
    const Scene scene = SceneOf(Reference("hard_target"), steps);
    const Certificate certificate = CertifyOptimum(scene, OptimumByPhases(scene));
    ASSERT_EQ(certificate.constraints.size(), 1u);
    EXPECT_EQ(certificate.constraints[0].body, "target");
    const Vec2d& multiplier = certificate.constraints[0].multiplier;
    EXPECT_NEAR(multiplier[0], multiplier[1], 1e-5);
    errors.push_back(std::abs(0.5 * (multiplier[0] + multiplier[1]) - kExact));
  }
  EXPECT_LT(errors[1], 3e-6);
  EXPECT_NEAR(std::log(errors[0] / errors[1]) / std::log(4.0), 2, 0.3);
}

// The multiplier says how the loss changes with the target.
TEST(Certificate, MultiplierIsTheDerivativeByTheTarget) {
  constexpr double kStep = 1e-3;
  Scene scene = SceneOf(Reference("hard_target"), 240);
  const Certificate certificate = CertifyOptimum(scene, OptimumByPhases(scene));
  std::vector<double> losses;
  for (double by : {-kStep, kStep}) {
    scene.objective.terminal[0].target = {by, 0};
    losses.push_back(OptimumByPhases(scene).solution.loss);
  }
  const double slope = (losses[1] - losses[0]) / (2 * kStep);
  EXPECT_NEAR(slope, -certificate.constraints[0].multiplier[0], 1e-4);
}

TEST(Certificate, IsTheSameInOtherUnits) {
  for (const char* name : {"off_diagonal_max_3", "hard_target", "free_time", "running"}) {
    const Scene scene = SceneOf(Reference(name), 240);
    const SolveReport report = OptimumByPhases(scene);
    const Certificate certificate = CertifyOptimum(scene, report);
    const Units units{.length = 0x1p-10, .time = 0x1p5, .mass = 0x1p5, .loss = 0x1p-20};
    const Scene rescaled = ToUnits(scene, units);
    const UnitFactors by(scene.units, units);
    Scene plain = rescaled;
    plain.units = {};
    const Certificate other = Certify(plain,
                                      ConvertStates(report.solution.initial_state, scene.units, units),
                                      Multiplied(report.solution.control, by.force),
                                      Multiplied(report.solution.durations, by.time));
    EXPECT_EQ(other.verdict, certificate.verdict) << name << ": " << other.reason;
    EXPECT_EQ(other.stationarity, certificate.stationarity) << name;
    EXPECT_EQ(other.hamiltonian, certificate.hamiltonian) << name;
    for (size_t i = 0; i < other.constraints.size(); ++i) {
      EXPECT_EQ(other.constraints[i].multiplier, certificate.constraints[i].multiplier * (by.loss / by.length));
    }
  }
}

}  // namespace
}  // namespace saltus
