// Certificates of controls whose impacts lie on nodes, where the force jumps: judged with the intervals as they are, by
// what simulations of changed controls on these intervals show.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

#include "box_scene.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using Verdict = Certificate::Verdict;

Body Disc(const char* name, double radius, double mass, const Vec2d& position, const Vec2d& velocity = {0, 0}) {
  Body body{.name = name, .radius = radius, .mass = mass};
  body.position = position;
  body.velocity = velocity;
  return body;
}

// A disc that bounces off a wall, elastically, and then pushes another one.
Scene OverTheWall() {
  Scene scene;
  scene.name = "over_the_wall";
  scene.duration = 1.3373769049564772;
  scene.steps = 6;
  scene.gravity = {0, -1.5875960987716036};
  scene.bodies = {Disc("s", 0.19366239364351368, 1.7618505046278174, {-0.47904057642392495, -0.3185352413451059}),
                  Disc("t", 0.1581747130864376, 1.0056162473484411, {-0.9373085159744403, -0.05242327829728466})};
  scene.planes = {{"floor", {0.017972635776604552, -2.199926586130374}, {-0.008169379898456614, 0.9999666300592609}},
                  {"wall", {2.0754019037517764, 0.7298677537085081}, {-0.9433645017053528, -0.33175806986750367}}};
  scene.contact.restitution = 1;
  scene.control = {.bodies = {0}, .initial = {Vec2d(-4.712083837351505, 2.158444049632141)}};
  scene.objective.terminal = {
      {.body = 1, .target = {-0.7895155732785804, 1.199942046602947}, .weight = 6.118905273624351}};
  scene.objective.effort = 0.10055434561974286;
  scene.optimize = Optimize::kControl;
  return scene;
}

Scene ThreeDiscs() {
  Scene scene;
  scene.name = "three_discs";
  scene.duration = 1.806849050732314;
  scene.steps = 6;
  scene.bodies = {Disc("s", 0.1321946182338214, 1.3366168210485383, {-0.3957601750071862, -0.8551741093146947}),
                  Disc("t0",
                       0.10305793131934232,
                       0.881061370688959,
                       {0.3124375636917902, -1.2487899159385705},
                       {-0.6080536817730078, 0.557887232566304}),
                  Disc("t1", 0.2135079626296889, 1.414010205567655, {-1.4792202614571952, -0.9627483782602964})};
  scene.contact.restitution = 0.47905244366633976;
  scene.control = {.bodies = {0}, .initial = {Vec2d(1.9418222310054336, -0.8524142898846827)}};
  scene.objective.terminal = {
      {.body = 0, .target = {0.19730651852268544, -0.7894624403150104}, .weight = 3.076422348316762}};
  scene.objective.effort = 0.06613829909412655;
  scene.optimize = Optimize::kControl;
  return scene;
}

// The least loss of controls near by, on the same intervals, by a random search whose steps become smaller. As the loss
// has kinks where impacts lie on nodes, every other step keeps the times of all impacts but one, to first order.
double LeastNearBy(const Scene& scene, const SolveReport& report) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  const auto simulate = [&](const Eigen::VectorXd& control) {
    return SimulateExactly(
        scene, report.solution.initial_state, {control.begin(), control.end()}, report.solution.durations);
  };
  Eigen::VectorXd best =
      Eigen::VectorXd::Map(report.solution.control.data(), static_cast<Eigen::Index>(report.solution.control.size()));
  const ExactRun start = simulate(best);
  const auto impacts = static_cast<Eigen::Index>(start.events.size());
  const double largest = best.lpNorm<Eigen::Infinity>();
  Eigen::MatrixXd times(best.size(), impacts);  // their derivatives
  for (Eigen::Index j = 0; j < best.size(); ++j) {
    const double change = 1e-6 * largest;
    const ExactRun changed = simulate(best + change * Eigen::VectorXd::Unit(best.size(), j));
    for (Eigen::Index i = 0; i < impacts; ++i) {
      times(j, i) = (changed.events.at(i).time - start.events[i].time) / change;
    }
  }
  double least = start.loss, size = 1e-3 * largest;
  for (int i = 0; i < 1000; ++i) {
    Eigen::VectorXd step = Eigen::VectorXd::NullaryExpr(best.size(), [&] { return normal(random); });
    if (i % 2 == 1 && impacts > 1) {
      Eigen::MatrixXd kept = times;
      kept.col(i / 2 % impacts).setZero();
      step -= kept * kept.completeOrthogonalDecomposition().solve(step);
    }
    const Eigen::VectorXd next = best + size * step;
    const ExactRun run = simulate(next);
    const double found = run.ok ? run.loss : std::numeric_limits<double>::infinity();
    size *= found < least ? 1.5 : 0.98;
    if (found >= least) continue;
    least = found;
    best = next;
  }
  return least;
}

TEST(KinksOnNodes, AStationaryVerdictIsThatOfTheControlOnItsIntervals) {
  int certified = 0, refused = 0;
  for (const Scene& scene : {OverTheWall(), ThreeDiscs()}) {
    for (const char* solver : {"ceres_event", "ceres_phases", "hmp"}) {
      const SolveReport report = Solve(solver, {scene, "event"}, {});
      ASSERT_FALSE(report.solution.control.empty());
      const ExactRun run =
          SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
      ASSERT_TRUE(run.ok) << run.reason;
      const Certificate certificate =
          Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
      const bool falls = LeastNearBy(scene, report) < run.loss * (1 - 1e-7);
      EXPECT_EQ(certificate.IsStationary(), !falls) << scene.name << " " << solver << ": " << certificate.reason;
      ++(certificate.IsStationary() ? certified : refused);
      if (report.termination == Termination::kConverged) {
        ASSERT_TRUE(report.certificate);
        EXPECT_EQ(report.certificate->verdict, certificate.verdict) << scene.name << " " << solver;
      }
    }
  }
  EXPECT_GT(certified, 0);
  EXPECT_GT(refused, 0);
}

// A force that hardly jumps at a node makes no kink: theta is then a quotient of rounding errors.
TEST(KinksOnNodes, AreNoneWhereForcesHardlyJump) {
  for (const int steps : {100, 120}) {
    const Scene scene = BallInBox(1, steps);
    const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    ASSERT_TRUE(report.certificate);
    EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
    EXPECT_GT(LeastNearBy(scene, report), report.solution.loss * (1 - 1e-7));
    for (const ImpactCertificate& impact : report.certificate->impacts) {
      const double theta = impact.theta.value_or(0);
      EXPECT_TRUE(theta >= 0 && theta <= 1) << theta;
    }
  }
}

// A certificate is not about the optimum in continuous time, whose conditions hmp reports beside it.
TEST(KinksOnNodes, HmpCertifiesTheControlThatItReturns) {
  const Scene scene = ThreeDiscs();
  const SolveReport report = Solve("hmp", {scene, "event"}, {});
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  ASSERT_TRUE(run.ok);
  EXPECT_LT(run.loss, 0.13985);
  EXPECT_NEAR(report.solution.loss, 0.137199714885363, 1e-9);
  ASSERT_TRUE(report.continuous);
  EXPECT_EQ(report.continuous->verdict, Verdict::kStationary);
  ASSERT_TRUE(report.certificate);
  ASSERT_EQ(report.certificate->impacts.size(), run.events.size());
  EXPECT_NEAR(report.certificate->impacts[0].time, run.events[0].time, 1e-9);
}

}  // namespace
}  // namespace saltus
