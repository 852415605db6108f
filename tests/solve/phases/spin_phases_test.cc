// Discs that spin between impacts at free times: ceres_phases and the certificate, against the optimum of
// data/spin_references.json, single shooting, and differences of exact roll-outs.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "parameter_name.h"
#include "rescaled_scene.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "spin_control.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using ::testing::HasSubstr;
using Quantity = TerminalTerm::Quantity;

SolveReport Optimum(const Scene& scene) {
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  return report;
}

// A pushed disc that spins strikes another one, which is to get to a place, a speed and an angle of turning.
Scene Strike(double friction) {
  Scene scene;
  scene.name = "strike_with_spin";
  scene.steps = 60;
  scene.bodies = {Spinning("striker", 0.1, 1.2, {-0.8, 0}, {1.5, 0.1}, 15),
                  Spinning("target", 0.15, 0.9, {0, 0.05}, {0, 0}, 2)};
  scene.contact = {.restitution = 0.85, .friction = friction};
  scene.control = {{0}, {{0.5, 0.1}}};
  scene.objective.terminal = {{.body = 1, .target = {0.9, 0.35}},
                              {.body = 1, .quantity = Quantity::kAngle, .target = {1, 0}, .weight = 0.05},
                              {.body = 0, .quantity = Quantity::kAngularVelocity, .target = {5, 0}, .weight = 0.01},
                              {.body = 0, .target = {-0.2, 0.2}, .weight = 0.2}};
  scene.objective.effort = 0.02;
  scene.optimize = Optimize::kControl;
  return scene;
}

// The optimum converges to that in continuous time as the steps get shorter, with second order.
TEST(SpinPhases, FindTheOptimumThatOnlyTheWallCanSpin) {
  const double exact = SpinOptimum("loss");
  std::vector<double> errors;
  for (const int steps : {40, 80, 160}) {
    const Scene scene = SpinControl(steps);
    const SolveReport report = Optimum(scene);
    errors.push_back(report.solution.loss - exact);
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
    ASSERT_TRUE(report.certificate->curvature);
    EXPECT_EQ(report.certificate->curvature->kind, Curvature::Kind::kMinimum);
    ASSERT_EQ(report.certificate->impacts.size(), 1u);
    EXPECT_NEAR(report.certificate->impacts[0].time, SpinOptimum("time"), 3.0 / (steps * steps));

    const ExactRun run =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(run.ok) << run.reason;
    EXPECT_EQ(run.loss, report.solution.loss);
    const double near = 5.0 / (steps * steps);
    EXPECT_NEAR(run.end[0], SpinOptimum("p", 0), near);
    EXPECT_NEAR(run.end[1], SpinOptimum("p", 1), near);
    EXPECT_NEAR(run.end[5], SpinOptimum("w"), 10 * near);
    // Forces are linear in time: on to the start from the first two.
    for (int j = 0; j < 2; ++j) {
      EXPECT_NEAR(1.5 * report.solution.control[j] - 0.5 * report.solution.control[2 + j],
                  SpinOptimum("force_0", j),
                  10 * near);
    }
  }
  // Not quite 4, as the phases do not share the steps quite in the same way.
  EXPECT_NEAR(errors[0] / errors[1], 4, 0.1);
  EXPECT_NEAR(errors[1] / errors[2], 4, 0.1);
  EXPECT_NEAR(errors[2], (errors[1] - errors[2]) / 3, 1e-7);
}

// The loss of a control on a grid that moves with the first impact: `before` steps until there, equal ones after.
double LossOnMovingGrid(const Scene& scene, const std::vector<double>& control, std::vector<double> durations,
                        size_t before) {
  double loss = NAN;
  for (int round = 0; round < 60; ++round) {
    const ExactRun run = SimulateExactly(scene, InitialState(scene), control, durations);
    if (!run.ok || run.events.empty()) return NAN;
    loss = run.loss;
    const double time = run.events[0].time, old = durations[0] * before;
    if (std::abs(time - old) < 1e-15) break;
    for (size_t k = 0; k < durations.size(); ++k) {
      durations[k] = k < before ? time / before : (scene.duration - time) / (durations.size() - before);
    }
  }
  return loss;
}

class StrikeWithSpin : public ::testing::TestWithParam<double> {};

// Differences of the exact loss vanish along every change of the control, as nodes follow the impact.
TEST_P(StrikeWithSpin, EndsWhereDifferencesVanish) {
  const Scene scene = Strike(GetParam());
  const SolveReport report = Optimum(scene);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 1u);
  const size_t before = std::find_if(report.solution.durations.begin(),
                                     report.solution.durations.end(),
                                     [&](double h) { return std::abs(h / report.solution.durations[0] - 1) > 1e-6; }) -
                        report.solution.durations.begin();
  constexpr double kWidth = 1e-3;
  double largest_slope = 0, largest_bend = 0;
  for (const double wave : {0.0, 0.7, 1.9}) {
    for (const int axis : {0, 1}) {
      const auto loss = [&](double by) {
        std::vector<double> control = report.solution.control;
        for (size_t i = axis; i < control.size(); i += 2) control[i] += by * std::cos(wave * static_cast<double>(i));
        return LossOnMovingGrid(scene, control, report.solution.durations, before);
      };
      largest_slope = std::max(largest_slope, std::abs(loss(kWidth) - loss(-kWidth)) / (2 * kWidth));
      largest_bend =
          std::max(largest_bend, (loss(kWidth) - 2 * report.solution.loss + loss(-kWidth)) / (kWidth * kWidth));
    }
  }
  EXPECT_GT(largest_bend, 0.01);
  EXPECT_LT(largest_slope, 1e-6 * largest_bend);
}

// With or without slip; single shooting on the same number of steps does not find anything better.
TEST_P(StrikeWithSpin, IsAsGoodAsSingleShooting) {
  const Scene scene = Strike(GetParam());
  const SolveReport report = Optimum(scene);
  const SolveReport shot = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 200}});
  EXPECT_LE(report.solution.loss, shot.solution.loss + 1e-12);
  EXPECT_NEAR(report.solution.loss, shot.solution.loss, 1e-3);
}

INSTANTIATE_TEST_SUITE_P(Friction, StrikeWithSpin, ::testing::Values(0.02, 0.1, 1.0), ParameterName());

// Velocities and spins at the start have no grid: the two solvers find the same.
TEST(SpinPhases, LaunchAsSingleShootingDoes) {
  for (const char* name : {"back_spin", "bank_shot"}) {
    SCOPED_TRACE(name);
    const Scene scene = ProblemScene(name);
    const SolveReport report = Optimum(scene);
    const SolveReport shot = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
    EXPECT_NEAR(report.solution.loss, shot.solution.loss, 1e-9);
    for (std::size_t i = 0; i < shot.solution.initial_state.size(); ++i) {
      // The spins of discs in an impact that slips do not matter: the bank shot is the same with other spins.
      if (std::string_view(name) == "bank_shot" && i >= 4 * scene.bodies.size()) break;
      EXPECT_NEAR(report.solution.initial_state[i],
                  shot.solution.initial_state[i],
                  1e-4 * (1 + std::abs(shot.solution.initial_state[i])))
          << i;
    }
    EXPECT_EQ(
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations).loss,
        report.solution.loss);
  }
}

TEST(SpinPhases, CertificateRejectsOneForceChangedByOnePercent) {
  for (const double friction : {0.02, 1.0}) {
    const Scene scene = Strike(friction);
    SolveReport report = Optimum(scene);
    report.solution.control[10] *= 1.01;
    const Certificate certificate =
        Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kNotStationary);
  }
}

// A disc that is struck, and whose spin at the end a wall decides too.
TEST(SpinPhases, CostatesOfSpinGoThroughImpacts) {
  Scene scene = Strike(1.0);
  scene.planes = {{"wall", {0.7, 0}, {-1, 0}}};
  scene.objective.terminal[0].target = {0.3, 0.35};
  const SolveReport report = Optimum(scene);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 2u);
  EXPECT_EQ(report.certificate->impacts[1].b, "wall");
}

// A spin that is asked for exactly: the multiplier says how the loss changes with it.
TEST(SpinPhases, MeetAHardSpinWithItsMultiplier) {
  Scene scene = SpinControl(60);
  scene.objective.terminal[1].hard = true;
  const auto at = [&](double spin) {
    scene.objective.terminal[1].target[0] = spin;
    return Optimum(scene);
  };
  const SolveReport report = at(-12);
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_NEAR(run.end[5], -12, 1e-7);
  const Certificate& certificate = *report.certificate;
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary) << certificate.reason;
  ASSERT_TRUE(certificate.curvature) << certificate.reason;
  EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
  ASSERT_EQ(certificate.constraints.size(), 1u);
  EXPECT_EQ(certificate.constraints[0].quantity, Quantity::kAngularVelocity);
  constexpr double kStep = 0.02;
  const double slope = (at(-12 + kStep).solution.loss - at(-12 - kStep).solution.loss) / (2 * kStep);
  EXPECT_NEAR(slope, -certificate.constraints[0].multiplier[0], 1e-5 * std::abs(slope));
}

TEST(SpinPhases, SayHowFarASpinIsOutOfReach) {
  Scene scene = SpinControl(20);
  scene.contact.friction = 0;  // nothing turns it
  scene.objective.terminal[1].hard = true;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_NE(report.termination, Termination::kConverged);
  EXPECT_THAT(report.reason, HasSubstr("12 rad/s, by disc"));
}

// SearchStatistics for from a force that does not bring the disc to the wall: without it nothing can spin.
TEST(SpinPhases, SearchFindsTheWall) {
  Scene scene = SpinControl(60);
  scene.control.initial = {{-0.2, 0.1}};
  const SolveReport report = Solve("mode_search", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, SpinOptimum("loss"), 1e-4);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary);
  EXPECT_THAT(report.optima.front().sequence, ::testing::SizeIs(1));
  // That without the wall, which the reference knows in continuous time.
  const auto alone = std::find_if(
      report.optima.begin(), report.optima.end(), [](const LocalOptimum& optimum) { return optimum.sequence.empty(); });
  ASSERT_NE(alone, report.optima.end());
  EXPECT_NEAR(alone->loss, SpinOptimum("without_wall"), 1e-3);
}

TEST(SpinPhases, SearchIsAsGoodAsSingleShootingOnTheBankShot) {
  const Scene scene = ProblemScene("bank_shot");
  const SolveReport report = Solve("mode_search", {scene, "event"}, {});
  const SolveReport shot = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LE(report.solution.loss, shot.solution.loss * (1 + 1e-9));
}

// In millimetres and milliseconds nothing changes but the numbers, of the multiplier of a hard spin too.
TEST(SpinPhases, AreTheSameInOtherUnits) {
  const Rescaling by{.name = "small", .length = 1000, .time = 1000, .mass = 64, .loss = 1e-3, .shift = {40, -7}};
  Scene scene = SpinControl(40);
  scene.objective.terminal[1].hard = true;
  scene.objective.terminal.push_back({.body = 0, .quantity = Quantity::kAngle, .target = {-2, 0}, .weight = 0.02});
  const SolveReport report = Optimum(scene), other = Optimum(Rescaled(scene, by));
  EXPECT_NEAR(other.solution.loss, by.loss * report.solution.loss, 1e-9 * by.loss * report.solution.loss);
  ASSERT_EQ(other.certificate->verdict, report.certificate->verdict);
  const double multiplier = report.certificate->constraints[0].multiplier[0];
  EXPECT_NEAR(other.certificate->constraints[0].multiplier[0],
              by.loss * by.time * multiplier,
              1e-6 * by.loss * by.time * std::abs(multiplier));
}

// Costs on the way, a bound and a free final time, as without spin.
TEST(SpinPhases, TakeWhatTheyTakeWithoutSpin) {
  Scene scene = SpinControl(60);
  scene.objective.running = {{.body = 0, .times = {0}, .targets = {Vec2d(0.3, 0.4)}, .weight = 0.2}};
  const SolveReport on_the_way = Optimum(scene);
  ASSERT_TRUE(on_the_way.certificate);
  EXPECT_EQ(on_the_way.certificate->verdict, Certificate::Verdict::kStationary) << on_the_way.certificate->reason;
  EXPECT_GT(on_the_way.solution.loss, SpinOptimum("loss"));

  scene = SpinControl(60);
  scene.control.max = {3};
  const SolveReport bounded = Optimum(scene);
  for (const double u : bounded.solution.control) EXPECT_LE(std::abs(u), 3 + 1e-9);
  EXPECT_EQ(bounded.certificate->verdict, Certificate::Verdict::kStationary) << bounded.certificate->reason;
  EXPECT_GT(bounded.solution.loss, SpinOptimum("loss") + 1e-3);

  scene = SpinControl(60);
  scene.objective.duration = FreeDuration{.min = 0.5, .max = 2, .weight = 0.1};
  const SolveReport free = Optimum(scene);
  EXPECT_EQ(free.certificate->verdict, Certificate::Verdict::kStationary) << free.certificate->reason;
  EXPECT_LT(free.solution.loss, SpinOptimum("loss") + 0.1);
}

// Steps of a contact model between exact impacts: with finer ones the optimum is that of exact flight.
TEST(SpinPhases, FlyByAModelsSteps) {
  std::vector<double> errors;
  for (const int steps : {60, 240}) {
    const SolveReport report = Solve("ceres_phases", {SpinControl(steps), "lcp_kkt"}, {.limits = {.iterations = 1000}});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    errors.push_back(std::abs(report.solution.loss - SpinOptimum("loss")));
  }
  EXPECT_LT(errors[1], 0.35 * errors[0]);
}

}  // namespace
}  // namespace saltus
