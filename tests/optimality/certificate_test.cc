// The certificate accepts optima, of either solver and on a fixed grid, and rejects what is near them.
#include "saltus/optimality/certificate.h"

#include <gmock/gmock.h>

#include <cmath>

#include "exact/two_disc_optimum.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using Verdict = Certificate::Verdict;

SolveReport Optimum(const Scene& scene, const char* sequence = nullptr) {
  SolverOptions options;
  if (sequence != nullptr) {
    EXPECT_EQ(ParseContactSequence(scene, sequence, &options.sequences.given.emplace()), "");
  }
  const SolveReport report = Solve("ceres_event", {scene, "event"}, options);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  return report;
}

Certificate CertifyReport(const Scene& scene, const SolveReport& report) {
  return Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
}

void ExpectOptimal(const Certificate& certificate) {
  EXPECT_EQ(certificate.verdict, Verdict::kStationary) << certificate.reason;
  EXPECT_LT(certificate.stationarity, 1e-6);
  EXPECT_LT(certificate.costate_jump, 1e-6);
  EXPECT_LT(certificate.hamiltonian, 1e-6);
  EXPECT_LT(certificate.transversality, 1e-6);
}

TEST(Certificate, AcceptsOptimaOnEventPhases) {
  Scene scene = ProblemScene("two_balls");
  ExpectOptimal(CertifyReport(scene, Optimum(scene)));
  scene.steps = 48;
  ExpectOptimal(CertifyReport(scene, Optimum(scene)));
  scene = ProblemScene("single_collision");
  ExpectOptimal(CertifyReport(scene, Optimum(scene)));
  scene = ProblemScene("multiple_collisions");
  ExpectOptimal(CertifyReport(scene, Optimum(scene, "striker-target,target-ceiling")));
}

// A disc that is pushed to the end, with gravity, friction, restitution and a velocity term.
TEST(Certificate, AcceptsAPushedBounce) {
  Scene scene;
  scene.name = "bounce";
  scene.steps = 300;
  scene.gravity = {0, -3};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1.2, .position = {0, 1}, .velocity = {1, -1}}};
  scene.planes = {{"ground", {0, 0}, {0.1, 1}}};
  scene.contact = {.restitution = 0.7, .friction = 0.1};
  scene.control = {{0}, {{0.3, 0}}};
  scene.objective.terminal = {
      {.body = 0, .target = {1.3, 0.9}, .weight = 4},
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 1}, .weight = 0.5}};
  scene.objective.effort = 0.1;
  scene.optimize = Optimize::kControl;
  ExpectOptimal(CertifyReport(scene, Optimum(scene)));
}

TEST(Certificate, DescribesTheImpact) {
  const Scene scene = ProblemScene("two_balls");
  const auto exact = FindTwoDiscOptimum(scene, TwoDiscSequence::kImpact);
  ASSERT_TRUE(exact);
  const Certificate certificate = CertifyReport(scene, Optimum(scene));
  ASSERT_EQ(certificate.impacts.size(), 1u);
  const ImpactCertificate& impact = certificate.impacts[0];
  EXPECT_NEAR(impact.time, exact->impact_time, 1e-6);
  EXPECT_NEAR(impact.speed, exact->impact_speed, 1e-5);
  // The minimum principle's costate is the mean of the one-sided ones.
  ASSERT_TRUE(impact.theta);
  EXPECT_NEAR(*impact.theta, 0.5, 2e-3);
  const SolveReport indirect = Solve("hmp", {scene, "event"}, {});
  EXPECT_NEAR(impact.multiplier, indirect.continuous->impacts[0].multiplier, 1e-4);
}

TEST(Certificate, RejectsOneControlChangedByOnePercent) {
  const Scene scene = ProblemScene("two_balls");
  for (int interval : {0, 100, 400}) {
    SolveReport report = Optimum(scene);
    report.solution.control[2 * interval] *= 1.01;
    const Certificate certificate = CertifyReport(scene, report);
    EXPECT_EQ(certificate.verdict, Verdict::kNotStationary) << interval;
    EXPECT_FALSE(certificate.reason.empty());
  }
}

TEST(Certificate, RejectsGradientDescent) {
  const Scene scene = ProblemScene("two_balls");
  for (const char* contact : {"event", "direct_toi"}) {
    const SolveReport report =
        Solve("gd", {scene, contact}, {.limits = {.iterations = 1000}, .descent = {.learning_rate = 10}});
    EXPECT_EQ(CertifyReport(scene, report).verdict, Verdict::kNotStationary) << contact;
  }
}

// Each condition is found missing by itself.
TEST(Certificate, NamesTheConditionThatFails) {
  const Scene scene = ProblemScene("two_balls");
  const SolveReport optimum = Optimum(scene);

  SolveReport crooked = optimum;
  crooked.solution.control[200] += 0.01;
  EXPECT_GT(CertifyReport(scene, crooked).stationarity, 1e-4);
  EXPECT_EQ(CertifyReport(scene, crooked).reason, "the largest residual is that of stationarity");

  // The best control for an impact at another time meets all conditions but that of the time of the impact, by a
  // multiplier that the conditions of the forces would leave; with the least of all residuals both are missed.
  const auto early = OptimizeWithImpactAt(scene, TwoDiscSequence::kImpact, 300);
  ASSERT_TRUE(early);
  SolveReport moved = optimum;
  moved.solution.durations.clear();
  moved.solution.control.clear();
  for (const Vec2d& u : early->control) moved.solution.control.insert(moved.solution.control.end(), {u[0], u[1]});
  const Certificate certificate = CertifyReport(scene, moved);
  EXPECT_EQ(certificate.transversality, 0);
  EXPECT_GT(certificate.hamiltonian, 1e-3);
  EXPECT_EQ(certificate.verdict, Verdict::kNotStationary);  // theta is not in [0, 1]
}

TEST(Certificate, FindsTheThetaOfGridOptima) {
  struct Row {
    int steps;
    double theta;  // data/exact_references.json
  };
  for (const Row& row : {Row{480, 0.504275798973}, Row{1000, 0.488087704578}}) {
    Scene scene = ProblemScene("two_balls");
    scene.steps = row.steps;
    const auto optimum = FindGridOptimum(scene, TwoDiscSequence::kImpact);
    ASSERT_TRUE(optimum);
    std::vector<double> control;
    for (const Vec2d& u : optimum->control) control.insert(control.end(), {u[0], u[1]});
    const Certificate certificate = Certify(scene, InitialState(scene), control);
    EXPECT_EQ(certificate.verdict, Verdict::kStationaryOnGrid) << certificate.reason;
    ASSERT_TRUE(certificate.impacts[0].theta);
    EXPECT_NEAR(*certificate.impacts[0].theta, row.theta, 1e-9);
    EXPECT_GT(*certificate.gradient_early, 1e-6);
    EXPECT_GT(*certificate.gradient_late, 1e-6);
    EXPECT_LT(*certificate.gradient_combined, 1e-12);
  }
}

// The gradient with the impact late is that of the event-driven model's adjoint, which takes the force of the step that
// begins with the impact.
TEST(Certificate, LateGradientIsTheAdjoints) {
  const Scene scene = ProblemScene("two_balls");
  const auto optimum = FindGridOptimum(scene, TwoDiscSequence::kImpact);
  ASSERT_TRUE(optimum);
  std::vector<double> control;
  for (const Vec2d& u : optimum->control) control.insert(control.end(), {u[0], u[1]});
  const Certificate certificate = Certify(scene, InitialState(scene), control);
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  double loss = 0, largest = 0;
  std::vector<double> gradient(control.size());
  ASSERT_TRUE(shooting.Evaluate(control, &loss, gradient.data()));
  for (double g : gradient) largest = std::max(largest, std::abs(g));
  const double late = std::abs(*certificate.gradient_late - largest);
  const double early = std::abs(*certificate.gradient_early - largest);
  EXPECT_LT(std::min(late, early), 1e-10);
}

TEST(Certificate, SaysWhenThereIsNothingToCertify) {
  Scene scene = ProblemScene("ground_wall");
  EXPECT_EQ(Certify(scene, InitialState(scene), {}).verdict, Verdict::kNotApplicable);
  scene = ProblemScene("two_balls");
  scene.objective.effort = 0;
  const Certificate certificate = Certify(scene, InitialState(scene), InitialControl(scene, 480));
  EXPECT_EQ(certificate.verdict, Verdict::kNotApplicable);
  EXPECT_FALSE(certificate.reason.empty());
}

}  // namespace
}  // namespace saltus
