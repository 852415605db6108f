// Optima over parameters of the scene, against closed forms.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"
#include "solve/solve_run.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Verdict = Certificate::Verdict;

DesignParameter Design(const std::string& name, const Scene& scene) { return {ParametersNamed(name, scene).at(0)}; }

// Task 1 with a target: the ball meets the ground after 0.45 s at 2 m/s, and is at the height 0.1 + e 2 0.55 at the
// end.
Scene BounceToHeight(double height) {
  Scene scene = ProblemScene("bounce_once");
  scene.objective.terminal = {{.body = 0, .target = {1, height}}};
  scene.design = {Design("restitution", scene)};
  return scene;
}
constexpr double kHeight = 0.65, kRestitution = 0.5;

// A disc strikes another head-on: it leaves with 2 / (1 + m) times the speed of the first, which has the mass 1. After
// 0.3 s at 2 m/s they touch.
Scene HeadOn() {
  Scene scene;
  scene.name = "head_on";
  scene.duration = 1;
  scene.steps = 100;
  scene.bodies = {{.name = "striker", .radius = 0.2, .mass = 1, .position = {-1, 0}, .velocity = {2, 0}},
                  {.name = "target", .radius = 0.2, .mass = 1, .position = {0, 0}}};
  scene.objective.terminal = {{.body = 1, .target = {0.7, 0}}};
  scene.design = {Design("mass.target", scene)};
  return scene;
}
constexpr double kMass = 3;  // 2 2 / (1 + m) 0.7 = 0.7

TEST(DesignSolvers, FindTheRestitutionThatReachesAHeight) {
  for (const std::string solver : {"gd", "ceres_lbfgs", "ceres_lm"}) {
    SCOPED_TRACE(solver);
    const SolveReport report = Solve(
        solver, {BounceToHeight(kHeight), "event"}, {.limits = {.iterations = 500}, .descent = {.learning_rate = 0.2}});
    ASSERT_EQ(report.solution.parameters.size(), 1u);
    EXPECT_NEAR(report.solution.parameters[0], kRestitution, 1e-7);
    if (solver == "gd") continue;  // it may go on in the last bits
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Verdict::kStationary) << report.certificate->reason;
  }
}

TEST(DesignSolvers, StopAtABound) {
  Scene scene = BounceToHeight(kHeight);
  scene.contact.restitution = 0.2;
  scene.design[0].max = 0.4;
  for (const std::string solver : {"gd", "ceres_lm"}) {
    SCOPED_TRACE(solver);
    const SolveReport report =
        Solve(solver, {scene, "event"}, {.limits = {.iterations = 500}, .descent = {.learning_rate = 0.2}});
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    ASSERT_EQ(report.solution.parameters.size(), 1u);
    EXPECT_EQ(report.solution.parameters[0], 0.4);
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Verdict::kStationary) << report.certificate->reason;
    // d/de (0.1 + 1.1 e - 0.65)^2 there
    EXPECT_NEAR(report.certificate->parameters.at(0).derivative, 2 * 1.1 * (0.54 - kHeight), 1e-9);
  }
  EXPECT_THAT(Solve("ceres_lbfgs", {scene, "event"}, {}).reason, HasSubstr("found bounds on restitution"));
}

TEST(DesignSolvers, FindTheMassThatSendsADiscSoFar) {
  for (const std::string contact : {"event", "direct_toi"}) {
    for (const std::string solver : {"gd", "ceres_lbfgs", "ceres_lm"}) {
      SCOPED_TRACE(solver + " " + contact);
      const SolveReport report =
          Solve(solver, {HeadOn(), contact}, {.limits = {.iterations = 3000}, .descent = {.learning_rate = 2}});
      EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
      ASSERT_EQ(report.solution.parameters.size(), 1u);
      EXPECT_NEAR(report.solution.parameters[0], kMass, 1e-5);
    }
  }
}

TEST(DesignSolvers, GiveTheSameInOtherUnits) {
  Scene scene = HeadOn(), large = scene;
  for (Body& body : large.bodies) {
    body.position *= 1024;
    body.radius *= 1024;
    body.velocity *= 1024;
    body.mass *= 64;
  }
  large.objective.terminal[0].target *= 1024;
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {}), other = Solve("ceres_lm", {large, "event"}, {});
  ASSERT_EQ(other.solution.parameters.size(), 1u);
  EXPECT_EQ(other.solution.parameters[0], 64 * report.solution.parameters[0]);
  EXPECT_EQ(other.work.iterations, report.work.iterations);
}

// At an optimum in control and mass together each has a vanishing derivative.
TEST(DesignSolvers, OptimizeControlAndParametersTogether) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  scene.objective.terminal.push_back(
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.5, 0.5}, .weight = 0.5});
  scene.design = {Design("mass.target", scene), Design("restitution", scene)};
  scene.design[0].min = 0.25;
  scene.design[0].max = 4;
  const double alone = [&] {
    Scene fixed = scene;
    fixed.design.clear();
    return Solve("ceres_lm", {fixed, "event"}, {}).solution.loss;
  }();
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 200}});
  ASSERT_EQ(report.solution.parameters.size(), 2u);
  EXPECT_LT(report.solution.loss, alone - 1e-3);
  EXPECT_EQ(report.solution.control.size(), 120u);
}

// The descent around a solver of controls: the derivative by the mass is that of the least loss, whose differences are
// taken over solves with given masses.
TEST(DesignSolvers, TheDerivativeOfTheLeastLossIsThatOfItsDifferences) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  scene.design = {Design("mass.target", scene), Design("restitution", scene)};
  scene.design[0].min = 0.5;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_EQ(report.solution.parameters.size(), 2u);
  EXPECT_EQ(report.solution.parameters[0], 0.5);  // lighter is cheaper
  EXPECT_EQ(report.solution.parameters[1], 1);    // so is more bouncing
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Verdict::kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->parameters.size(), 2u);
  constexpr double kStep = 1e-3;
  const auto least_loss = [&](double mass, double restitution) {
    Scene given = scene;
    given.design.clear();
    given.bodies[1].mass = mass;
    given.contact.restitution = restitution;
    return Solve("ceres_phases",
                 {given, "event"},
                 {.guess = ControlGuess{report.solution.control, report.solution.durations}})
        .solution.loss;
  };
  EXPECT_NEAR(report.certificate->parameters[0].derivative,
              (least_loss(0.5 + kStep, 1) - least_loss(0.5 - kStep, 1)) / (2 * kStep),
              1e-5);
  const double by_restitution =
      (3 * least_loss(0.5, 1) - 4 * least_loss(0.5, 1 - kStep) + least_loss(0.5, 1 - 2 * kStep)) / (2 * kStep);
  EXPECT_NEAR(report.certificate->parameters[1].derivative, by_restitution, 1e-5);
  EXPECT_LT(by_restitution, -0.1);
}

// Both parameters move the impact, and the boundary of two intervals with it.
TEST(DesignSolvers, TheDerivativeOfTheLeastLossCountsTheMovedImpact) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  Scene designed = scene;
  designed.design = {Design("radius.target", scene), Design("mass.striker", scene)};
  const Certificate certificate =
      Certify(designed, report.solution.initial_state, report.solution.control, report.solution.durations);
  ASSERT_EQ(certificate.parameters.size(), 2u) << certificate.reason;
  EXPECT_EQ(certificate.verdict, Verdict::kNotStationary);
  constexpr double kStep = 1e-3;
  for (const ParameterCertificate& entry : certificate.parameters) {
    const auto least_loss = [&](double change) {
      Scene given = scene;
      SetValue(entry.parameter, entry.value + change, &given);
      return Solve("ceres_phases",
                   {given, "event"},
                   {.guess = ControlGuess{report.solution.control, report.solution.durations}})
          .solution.loss;
    };
    EXPECT_NEAR(entry.derivative, (least_loss(kStep) - least_loss(-kStep)) / (2 * kStep), 1e-5) << entry.name;
    EXPECT_GT(std::abs(entry.derivative), 0.1) << entry.name;
  }
}

// The multipliers of constraints are a part of the derivative: that of the least loss among motions that meet them.
TEST(DesignSolvers, TheDerivativeOfTheLeastLossCountsConstraints) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  scene.objective.terminal[0].hard = true;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  Scene designed = scene;
  designed.design = {Design("mass.target", scene)};
  const Certificate certificate =
      Certify(designed, report.solution.initial_state, report.solution.control, report.solution.durations);
  ASSERT_EQ(certificate.parameters.size(), 1u) << certificate.reason;
  constexpr double kStep = 1e-2;
  const auto least_loss = [&](double mass) {
    Scene given = scene;
    given.bodies[1].mass = mass;
    return Solve("ceres_phases",
                 {given, "event"},
                 {.guess = ControlGuess{report.solution.control, report.solution.durations}})
        .solution.loss;
  };
  const double difference = (least_loss(1 + kStep) - least_loss(1 - kStep)) / (2 * kStep);
  EXPECT_NEAR(certificate.parameters[0].derivative, difference, 1e-3 * std::abs(difference));
  EXPECT_GT(difference, 0.1);
  designed.design[0].min = 0.5;
  const SolveReport best = Solve("ceres_phases", {designed, "event"}, {});
  EXPECT_EQ(best.termination, Termination::kConverged) << best.reason;
  ASSERT_EQ(best.solution.parameters.size(), 1u);
  EXPECT_EQ(best.solution.parameters[0], 0.5);  // lighter is cheaper
  EXPECT_LT(best.solution.violation, 1e-7);
}

// Path costs and a free final time have no adjoint by parameters: all derivatives against differences of the loss.
TEST(DesignSolvers, DerivativesBesidePathCostsAreThoseOfTheLoss) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 12;
  scene.objective.running = {{.body = 1, .times = {0}, .targets = {{0, 0}}, .weight = 0.5}};
  scene.objective.via = {{.body = 0, .time = 0.4, .target = {-1.6, -1.6}, .weight = 2}};
  scene.objective.duration = FreeDuration{.min = 0.5, .max = 2, .weight = 0.3};
  scene.design = {Design("mass.target", scene), Design("restitution", scene), Design("radius.target", scene)};
  scene.contact.restitution = 0.8;
  const auto of_scene = [](const Scene& other) { return MakeSimulator("event", other, Precision::kDouble); };
  SingleShooting shooting(of_scene(scene), SingleShooting::Variables::kOptimized, of_scene);
  ASSERT_EQ(shooting.num_variables(), 12 * 2 + 1 + 3);
  const std::vector<double> at = shooting.initial_guess();
  std::vector<double> gradient(at.size());
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(at, &loss, gradient.data()));
  std::vector<double> residuals(shooting.num_residuals()), jacobian(residuals.size() * at.size());
  ASSERT_TRUE(shooting.EvaluateResiduals(at, residuals.data(), jacobian.data()));
  const auto residuals_at = [&](const std::vector<double>& z) {
    std::vector<double> there(residuals.size());
    EXPECT_TRUE(shooting.EvaluateResiduals(z, there.data(), nullptr));
    return there;
  };
  constexpr double kWidth = 1e-5;
  for (std::size_t i = 0; i < at.size(); ++i) {
    std::vector<double> above = at, below = at;
    above[i] += kWidth;
    below[i] -= kWidth;
    double high = 0, low = 0;
    ASSERT_TRUE(shooting.Evaluate(above, &high, nullptr));
    ASSERT_TRUE(shooting.Evaluate(below, &low, nullptr));
    EXPECT_NEAR(gradient[i], (high - low) / (2 * kWidth), 1e-7) << i;
    const std::vector<double> highs = residuals_at(above), lows = residuals_at(below);
    for (std::size_t row = 0; row < residuals.size(); ++row) {
      EXPECT_NEAR(jacobian[row * at.size() + i], (highs[row] - lows[row]) / (2 * kWidth), 1e-6) << row << " " << i;
    }
  }
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 200}});
  ASSERT_EQ(report.solution.parameters.size(), 3u) << report.reason;
  EXPECT_LT(report.solution.loss, loss - 0.1);
}

// The lightest target is cheapest, and then a duration within its bounds: against a parabola through the least losses
// with three durations that are given. The solves of the descent begin beside the optima that they find.
TEST(DesignSolvers, FindAMassBesideAFreeDuration) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 48;
  scene.bodies[0].position = {-1, -2};
  scene.control.initial = {{0, 6}};
  scene.objective.terminal.push_back(
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.6, 0.6}, .weight = 0.5});
  scene.objective.duration = FreeDuration{.min = 0.5, .max = 3, .weight = 0.3};
  Scene designed = scene;
  designed.design = {Design("mass.target", scene)};
  designed.design[0].min = 0.25;
  designed.design[0].max = 4;
  const SolveReport report = Solve("ceres_phases", {designed, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solution.parameters, std::vector<double>{0.25});
  EXPECT_LT(report.work.iterations, 1000);
  const double duration = std::accumulate(report.solution.durations.begin(), report.solution.durations.end(), 0.0);
  constexpr double kStep = 0.02;
  const auto least_loss = [&](double change, double mass) {
    Scene given = scene;
    given.bodies[1].mass = mass;
    given.duration = duration + change;
    given.objective.duration = FreeDuration{given.duration, given.duration, 0.3};
    const SolveReport solved = Solve("ceres_phases", {given, "event"}, {});
    EXPECT_EQ(solved.termination, Termination::kConverged) << solved.reason;
    return solved.solution.loss;
  };
  const double before = least_loss(-kStep, 0.25), at = least_loss(0, 0.25), after = least_loss(kStep, 0.25);
  EXPECT_NEAR(report.solution.loss, at, 2e-5);  // the steps are shared out otherwise before and after the impact
  EXPECT_GT(before, at);
  EXPECT_GT(after, at);
  EXPECT_NEAR((before - after) / (before - 2 * at + after) / 2, 0, 0.05);  // steps of it to the vertex
  EXPECT_GT(least_loss(0, 0.26), at);
}

// Solvers in phases have parameters among their unknowns; the impacts keep the names of the discs.
TEST(DesignSolvers, SolveAlongAGivenSequence) {
  const Scene scene = ProblemScene("post_shot");
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Verdict::kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 2u);
  EXPECT_EQ(report.certificate->impacts[0].a, "striker");
  EXPECT_EQ(report.certificate->impacts[1].b, "post");
  const ContactSequence sequence = {{.a = 0, .b = 1}, {.a = 1, .b = 2}};
  const SolveReport along = Solve("ceres_event", {scene, "event"}, {.sequences = {.given = sequence, .search = false}});
  EXPECT_EQ(along.solver, "ceres_event");
  EXPECT_EQ(along.termination, Termination::kConverged) << along.reason;
  EXPECT_NEAR(along.solution.loss, report.solution.loss, 1e-9);
  ASSERT_EQ(along.solution.parameters.size(), 3u);
  // The initial state has the post where it is found.
  ASSERT_EQ(along.solution.initial_state.size(), 12u);
  EXPECT_EQ(along.solution.initial_state[8], along.solution.parameters[0]);
}

// With the parameters that were found the scene has no better control.
TEST(DesignSolvers, EndWithTheBestControlOfTheirParameters) {
  Scene scene = ControlProblem(16);
  scene.steps = 60;
  const double mass = scene.bodies.back().mass;
  scene.design = {{{.kind = SceneParameter::Kind::kMass, .body = scene.num_bodies() - 1}, 0.5 * mass, 2 * mass}};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  Scene given = WithDesign(scene, report.solution.parameters);
  given.design.clear();
  const SolveReport solved = Solve("ceres_phases", {given, "event"}, {});
  ASSERT_EQ(solved.termination, Termination::kConverged) << solved.reason;
  EXPECT_LE(report.solution.loss, solved.solution.loss * (1 + 1e-9));
}

// A guess whose impacts accumulate is refused as it is with given parameters.
TEST(DesignSolvers, RefuseAGuessAsWithGivenParameters) {
  Scene scene = ControlProblem(14);
  scene.steps = 60;
  Scene designed = scene;
  const double mass = scene.bodies.back().mass;
  designed.design = {{{.kind = SceneParameter::Kind::kMass, .body = scene.num_bodies() - 1}, 0.5 * mass, 2 * mass}};
  const SolveReport given = Solve("ceres_phases", {scene, "event"}, {});
  const SolveReport report = Solve("ceres_phases", {designed, "event"}, {});
  EXPECT_EQ(given.termination, Termination::kNotApplicable);
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_EQ(report.reason, given.reason);
}

// With the given post the ball is best sent past it; with a better one, against it.
// A certificate is of the control and the parameters, and not of the best control of parameters that others beat.
TEST(DesignSolvers, CertificatesHaveTheParameters) {
  Scene scene;
  scene.name = "strike";
  scene.duration = 1.06;
  scene.steps = 10;
  scene.bodies = {{.name = "striker", .radius = 0.0982, .mass = 0.4256, .position = {-1, 0.028}},
                  {.name = "target", .radius = 0.12, .mass = 1.3244, .position = {-0.2, -0.0528}}};
  scene.contact.restitution = 0.8975;
  scene.control = {{0}, {{3.6365, 0.1}}};
  scene.objective.terminal = {{.body = 1, .target = {0.61, -0.27}, .weight = 5}};
  scene.objective.effort = 0.05;
  scene.objective.duration = {.min = 0.64, .max = 2.12, .weight = 0.5};
  scene.optimize = Optimize::kControl;
  scene.design = {{ParametersNamed("gravity.y", scene)[0], -0.1, 0.1},
                  {ParametersNamed("radius.target", scene)[0], 0.08, 0.16}};
  const SolveReport report = Solve("auto", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  ASSERT_EQ(report.certificate->parameters.size(), 2u);
  // With these parameters alone, none has a lower loss.
  for (size_t i = 0; i < 2; ++i) {
    for (const double step : {-0.02, 0.02}) {
      std::vector<double> beside = report.solution.parameters;
      beside[i] = std::clamp(beside[i] + step, *scene.design[i].min, *scene.design[i].max);
      Scene given = WithDesign(scene, beside);
      given.design.clear();
      SolverOptions options;
      options.guess = ControlGuess{report.solution.control, report.solution.durations};
      const SolveReport other = Solve("ceres_phases", {given, "event"}, options);
      EXPECT_GE(other.solution.loss, report.solution.loss - 1e-9) << i << " " << step;
    }
  }
}

// A search with given parameters proves no bound for others.
TEST(DesignSolvers, NoBoundIsOneOfGivenParameters) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  const SolveReport given = Solve("mode_search", {scene, "event"}, {});
  ASSERT_TRUE(given.searched);
  ASSERT_GT(given.searched->lower_bound, 0.1);
  scene.design = {{ParametersNamed("mass.target", scene)[0], 0.01, 2}};
  const SolveReport found = Solve("mode_search", {scene, "event"}, {});
  ASSERT_TRUE(found.searched);
  EXPECT_EQ(found.searched->lower_bound, 0);
  EXPECT_LT(found.solution.loss, given.solution.loss);
}

// A solve that goes on from a motion which its certificate denies says nothing of that motion.
TEST(DesignSolvers, ADenialIsTakenBackWithItsReason) {
  Certificate denial;
  denial.verdict = Verdict::kNotStationary;
  denial.reason = "the loss falls";
  for (const std::string before : {"", "from a random start"}) {
    SolveReport report;
    report.termination = Termination::kConverged;
    report.reason = before;
    report.certificate = denial;
    JudgeByCertificate(&report);
    EXPECT_EQ(report.termination, Termination::kNoProgress);
    EXPECT_THAT(report.reason, HasSubstr("the loss falls"));
    ForgetCertificate(&report);
    EXPECT_EQ(report.termination, Termination::kConverged);
    EXPECT_EQ(report.reason, before);
    EXPECT_FALSE(report.certificate);
  }
  // A report that has ended for another reason stays as it is.
  SolveReport stuck;
  stuck.termination = Termination::kNoProgress;
  stuck.reason = "no small change of the control changes the motion";
  stuck.certificate.emplace().verdict = Verdict::kStationary;
  ForgetCertificate(&stuck);
  EXPECT_EQ(stuck.termination, Termination::kNoProgress);
  EXPECT_EQ(stuck.reason, "no small change of the control changes the motion");
}

TEST(DesignSolvers, ASearchKeepsToItsLimitOfTime) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  scene.design = {{ParametersNamed("mass.target", scene)[0], 0.01, 2}};
  SolverOptions options;
  options.sequences.limits.seconds = 1e-9;  // over at once
  const SolveReport report = Solve("mode_search", {scene, "event"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_THAT(report.reason, HasSubstr("the limit of time"));
  EXPECT_LT(report.work.evaluations, 5);
}

TEST(DesignSolvers, ModeSearchStartsFromSeveralSequences) {
  const Scene scene = ProblemScene("post_shot");
  const SolveReport report = Solve("mode_search", {scene, "event"}, {});
  EXPECT_EQ(report.solver, "mode_search");
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.8889);
  ASSERT_TRUE(report.searched);
  EXPECT_GT(report.searched->sequences, 1);
}

// The certificate of a wall that is moved knows where it stands between its bounds.
TEST(DesignSolvers, AWallStopsAtItsBound) {
  Scene scene = BounceToHeight(kHeight);
  scene.contact.restitution = kRestitution;
  scene.objective.terminal[0].target[1] += 0.5;
  scene.design = {Design("offset.ground", scene)};
  scene.design[0].max = 0.1;
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_EQ(report.solution.parameters.size(), 1u);
  EXPECT_EQ(report.solution.parameters[0], 0.1);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Verdict::kStationary) << report.certificate->reason;
  EXPECT_LT(report.certificate->parameters.at(0).derivative, 0);
  EXPECT_EQ(report.certificate->parameters.at(0).value, 0.1);
}

TEST(DesignSolvers, ThatDoNotTakeParametersNameTheKey) {
  Scene scene = ProblemScene("two_balls");
  scene.design = {Design("mass.target", scene)};
  for (const std::string solver : {"ceres_shooting", "ceres_lagrangian", "grid_optimum", "hmp"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kNotApplicable) << solver;
    EXPECT_THAT(report.reason, HasSubstr("optimize: found mass.target")) << solver;
  }
  EXPECT_THAT(Solve("ceres_phases", {HeadOn(), "event"}, {}).reason, HasSubstr("found mass.target without a control"));
  EXPECT_THAT(Solve("gd", {scene, "event", Precision::kFloat}, {}).reason, HasSubstr("optimize: found mass.target"));
  scene.objective.via = {{.body = 0, .time = 0.5}};
  EXPECT_THAT(Solve("ceres_lm", {scene, "direct_toi"}, {}).reason, HasSubstr("mass.target beside path costs"));
}

}  // namespace
}  // namespace saltus
