// The second derivative of the exact loss by the control, against differences of it and of its gradients, and what the
// certificate makes of it.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>

#include "base/linear_algebra.h"
#include "control/hybrid_shooting.h"
#include "control/pushed_scenes.h"
#include "parameter_name.h"
#include "saltus/control/scene_problem.h"
#include "saltus/control/single_shooting.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "solve/phases/phase_solution.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Thetas = std::vector<std::optional<double>>;

Scene With(Scene scene, int steps) {
  scene.steps = steps;
  return scene;
}

std::vector<double> EqualLengths(const Scene& scene) { return std::vector<double>(scene.steps, scene.dt()); }

// A control that is constant for nobody.
std::vector<double> Wavy(const Scene& scene) {
  std::vector<double> control = InitialControl(scene, scene.steps);
  for (size_t i = 0; i < control.size(); ++i) control[i] += 0.05 * std::sin(1.7 * static_cast<double>(i) + 0.3);
  return control;
}

struct Exact {  // a run and its flight
  Exact(const Scene& scene, const std::vector<double>& control, const std::vector<double>& lengths)
      : run(SimulateExactly(scene, InitialState(scene), control, lengths)),
        flight(scene, InitialState(scene), control, lengths, run) {}
  ExactRun run;
  Flight flight;
};

double ExactLoss(const Scene& scene, const std::vector<double>& control, const std::vector<double>& lengths = {}) {
  return SimulateExactly(scene, InitialState(scene), control, lengths).loss;
}

std::vector<double> Along(const std::vector<double>& control, const std::vector<double>& direction, double eps) {
  std::vector<double> moved = control;
  for (size_t i = 0; i < moved.size(); ++i) moved[i] += eps * direction[i];
  return moved;
}

// With a waypoint for each of the discs.
Scene WithWaypoints(Scene scene) {
  scene.objective.via = {
      {.body = 0, .time = 0.33, .target = {0.5, 0.2}, .weight = 2},
      {.body = 1, .time = 0.6, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.1, -1}, .weight = 0.4}};
  return scene;
}

struct Case {
  const char* name;
  Scene scene;
  size_t impacts;
};
void PrintTo(const Case& item, std::ostream* out) { *out << item.name; }

class CurvatureOf : public testing::TestWithParam<Case> {};

// The event-driven model knows the gradient, and with path costs the hybrid system; the differences of it are the dense
// second derivative, whose least eigenvalue the curvature is by any direction of unit length in time.
TEST_P(CurvatureOf, EqualsDifferencesOfExactGradients) {
  const Scene& scene = GetParam().scene;
  const std::vector<double> control = Wavy(scene), lengths = EqualLengths(scene);
  const Exact exact(scene, control, lengths);
  ASSERT_TRUE(exact.run.only_impacts);
  ASSERT_EQ(exact.run.events.size(), GetParam().impacts);
  for (const Flight::Hit& hit : exact.flight.hits()) ASSERT_FALSE(hit.on_node);

  HybridShooting shooting(MakeHybridProblem(scene));
  SingleShooting of_discs(MakeSimulator("event", scene, Precision::kDouble));
  const bool path = !scene.objective.running.empty() || !scene.objective.via.empty();
  const auto gradient = [&](const std::vector<double>& at) {
    double loss = 0;
    Eigen::VectorXd g(at.size());
    EXPECT_TRUE(path ? shooting.Evaluate(at, &loss, g.data()) : of_discs.Evaluate(at, &loss, g.data()));
    return g;
  };
  const auto size = static_cast<Eigen::Index>(control.size());
  Eigen::MatrixXd differences(size, size);
  constexpr double kWidth = 1e-4;
  std::vector<double> unit(control.size());
  for (size_t i = 0; i < control.size(); ++i) {
    unit[i] = 1;
    const auto slope = [&](double width) -> Eigen::VectorXd {
      return (gradient(Along(control, unit, width)) - gradient(Along(control, unit, -width))) / (2 * width);
    };
    differences.col(i) = (4 * slope(kWidth) - slope(2 * kWidth)) / 3;
    unit[i] = 0;
  }
  const Eigen::MatrixXd hessian = 0.5 * (differences + differences.transpose());
  // Not by the effort alone.
  EXPECT_GT((hessian - Eigen::MatrixXd(hessian.diagonal().asDiagonal())).norm(), 1e-3 * hessian.norm());

  const double h = scene.dt(), of_effort = 2 * scene.objective.effort * h;
  const Eigen::VectorXd dense = EigenOf(hessian / of_effort).values;
  const std::optional<Curvature> curvature = CurvatureAt(scene, InitialState(scene), control);
  ASSERT_TRUE(curvature);
  EXPECT_NEAR(curvature->smallest, dense[0], 1e-7 * dense.cwiseAbs().maxCoeff());
  const Eigen::Map<const Eigen::VectorXd> direction(curvature->direction.data(), size);
  EXPECT_NEAR(h * direction.squaredNorm(), 1, 1e-9);
  const double along = direction.dot(hessian * direction) / (2 * scene.objective.effort);
  EXPECT_NEAR(along, curvature->smallest, 1e-7 * dense.cwiseAbs().maxCoeff());
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, CurvatureOf,
    testing::Values(Case{"two_balls", With(ProblemScene("two_balls"), 25), 1},
                    Case{"single_collision", With(ProblemScene("single_collision"), 25), 1},
                    Case{"multiple_collisions", With(ProblemScene("multiple_collisions"), 25), 3},
                    Case{"head_on", With(HeadOn(), 23), 1}, Case{"two_pushed", TwoPushed(), 2},
                    Case{"spin_slips", TwoSpin(0.05), 2}, Case{"spin_sticks", TwoSpin(2), 2},
                    Case{"strike_sticks", SpinStrike(2), 1}, Case{"torques_slip", WithTorques(TwoSpin(0.05)), 2},
                    Case{"torques_stick", WithTorques(TwoSpin(2)), 2}, Case{"waypoints", WithWaypoints(TwoPushed()), 2},
                    Case{"torques_and_waypoints", WithTorques(WithWaypoints(TwoSpin(0.05))), 2},
                    Case{"running_terms", WithRunningTerms(TwoPushed()), 2},
                    Case{"torques_and_running_terms", WithTorques(WithRunningTerms(TwoSpin(2))), 2}),
    [](const auto& at) { return at.param.name; });

Certificate CertifyReport(const Scene& scene, const SolveReport& report) {
  return Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
}

// Optima that are known to be such.
TEST(Curvature, IsPositiveAtOptima) {
  for (const char* problem : {"two_balls", "single_collision"}) {
    for (const char* solver : {"ceres_event", "hmp", "mode_search", "grid_optimum"}) {
      const Scene scene = ProblemScene(problem);
      const SolveReport report = Solve(solver, {scene, "event"}, {});
      EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
      ASSERT_TRUE(report.certificate && report.certificate->curvature) << problem << solver;
      EXPECT_EQ(report.certificate->curvature->kind, Curvature::Kind::kMinimum) << problem << solver;
      EXPECT_GT(report.certificate->curvature->smallest, 0.5) << problem << solver;
      EXPECT_LE(report.certificate->curvature->smallest, 1) << problem << solver;
      const std::string words = VerdictInWords(*report.certificate);
      EXPECT_EQ(words, std::string(solver) == "grid_optimum" ? "minimum on the grid" : "minimum");
    }
  }
}

// The head-on bounce that meets all conditions of first order, on intervals that begin and end with the impact.
Trial StraightBack(const Scene& scene) {
  const Trial guess = GuessTrial(scene);
  const ContactSequence& sequence = guess.exact.contacts;
  const PhaseSolution solution = SolveAlong(scene, sequence, GuessFrom(scene, FlightOf(scene, guess), sequence), {});
  EXPECT_TRUE(solution.optimal());
  return solution.attempt.trial;
}

// The loss with the control moved along a direction, and the node that had the impact moved to where that is now.
double LossWithMovedNode(const Scene& scene, const Trial& trial, const std::vector<double>& direction, double eps) {
  const std::vector<double> control = Along(trial.control, direction, eps);
  std::vector<double> lengths = trial.durations;
  const int node = trial.exact.places[0].interval;
  double at = trial.exact.events[0].time;
  ExactRun run;
  for (int i = 0; i < 20; ++i) {  // contracts
    run = SimulateExactly(scene, InitialState(scene), control, lengths);
    const double late = run.events[0].time - at;
    lengths[node - 1] += late;
    lengths[node] -= late;
    at += late;
  }
  return run.loss;
}

TEST(Curvature, TheHeadOnBounceIsASaddle) {
  const Scene scene = HeadOn();
  const Trial saddle = StraightBack(scene);
  const Certificate certificate = CertifyTrial(scene, saddle);
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary);
  EXPECT_THAT(certificate.reason, HasSubstr("saddle"));
  EXPECT_EQ(VerdictInWords(certificate), "saddle");
  ASSERT_TRUE(certificate.curvature);
  const double loss = saddle.exact.loss, time = saddle.exact.events[0].time;
  EXPECT_NEAR(loss, 5.4156127, 1e-7);

  // u_y = eps (t_impact - t) until the impact: 1.46e-3 eps^2 less, by simulation alone.
  std::vector<double> sideways(saddle.control.size());
  double now = 0, length = 0;
  for (int k = 0; k < saddle.exact.places[0].interval; now += saddle.durations[k++]) {
    sideways[2 * k + 1] = time - now - 0.5 * saddle.durations[k];
    length += saddle.durations[k] * sideways[2 * k + 1] * sideways[2 * k + 1];
  }
  const double expected = scene.objective.effort * certificate.curvature->smallest;
  for (const double eps : {1e-2, -1e-2}) {
    const auto gain = [&](double moved) { return (moved - loss) / (eps * eps); };
    EXPECT_NEAR(gain(ExactLoss(scene, Along(saddle.control, sideways, eps), saddle.durations)), -1.463e-3, 1e-6);
    EXPECT_NEAR(gain(LossWithMovedNode(scene, saddle, certificate.curvature->direction, eps)), expected, 1e-5);
    EXPECT_GT(gain(LossWithMovedNode(scene, saddle, sideways, eps)) / length, expected);
    EXPECT_LT(ExactLoss(scene, Along(saddle.control, certificate.curvature->direction, eps), saddle.durations), loss);
  }
}

// A bound that no force is at changes nothing; one that some are at leaves the saddle one, as it is left sideways.
TEST(Curvature, KnowsTheSaddleUnderBounds) {
  Scene scene = HeadOn();
  const Trial saddle = StraightBack(scene);
  const Certificate free = CertifyTrial(scene, saddle);
  double largest = 0;
  for (const double force : saddle.control) largest = std::max(largest, std::abs(force));
  scene.control.max = {1.1 * largest};
  const Certificate wide = CertifyTrial(scene, saddle);
  EXPECT_EQ(wide.verdict, Certificate::Verdict::kStationary);
  EXPECT_THAT(wide.reason, HasSubstr("saddle"));
  ASSERT_TRUE(wide.curvature);
  EXPECT_NEAR(wide.curvature->smallest, free.curvature->smallest, 1e-9);

  scene.control.max = {0.9 * largest};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_LT(report.solution.loss, saddle.exact.loss);  // that of any control straight back is higher
  for (const double force : report.solution.control) EXPECT_LE(std::abs(force), scene.control.max[0]);
}

// With the impact held on its node the direction keeps it there.
TEST(Curvature, OnTheGridDirectionsKeepImpactsOnNodes) {
  const Scene scene = ProblemScene("two_balls");
  const SolveReport report = Solve("grid_optimum", {scene, "event"}, {});
  ASSERT_EQ(report.certificate->verdict, Certificate::Verdict::kStationaryOnGrid);
  const std::vector<double>& direction = report.certificate->curvature->direction;
  const double before = SimulateExactly(scene, report.solution.initial_state, report.solution.control).events[0].time;
  for (const double eps : {1e-4, -1e-4}) {
    const ExactRun moved =
        SimulateExactly(scene, report.solution.initial_state, Along(report.solution.control, direction, eps));
    EXPECT_NEAR(moved.events[0].time, before, 10 * eps * eps);
    EXPECT_GT(moved.loss, report.solution.loss);
  }
}

TEST(Curvature, HasNoUnits) {
  const Scene scene = HeadOn();
  const Trial saddle = StraightBack(scene);
  Scene scaled = scene;
  scaled.objective.effort *= 1e-8;
  scaled.objective.terminal[0].weight *= 1e-8;
  const Certificate plain = CertifyTrial(scene, saddle), small = CertifyTrial(scaled, saddle);
  EXPECT_EQ(small.verdict, plain.verdict);
  EXPECT_NEAR(small.curvature->smallest, plain.curvature->smallest, 1e-9);
}

// The ball ends where the loss has no slope along the normals of the walls, so that the second derivatives of the
// impacts count for nothing, and the least curvature is that of the effort. Impacts are at ends of intervals between
// which the control goes on.
TEST(Curvature, HasManyImpacts) {
  Scene scene;
  scene.name = "rattle";
  scene.contact.restitution = 1;
  scene.steps = 2000;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, 0}, .velocity = {60, 1}}};
  scene.planes = {{"left", {-0.2, 0}, {1, 0}}, {"right", {0.2, 0}, {-1, 0}}};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0, 0}}};
  scene.objective.effort = 1;
  scene.optimize = Optimize::kControl;
  const std::vector<double> control = InitialControl(scene, scene.steps);
  EXPECT_GT(SimulateExactly(scene, InitialState(scene), control).events.size(), 200u);
  const std::optional<Curvature> curvature = CurvatureAt(scene, InitialState(scene), control);
  ASSERT_TRUE(curvature);
  EXPECT_NEAR(curvature->smallest, 1, 1e-6);
}

// Solvers along sequences leave the saddle; the best motion touches the post, which these take as an impact. Its loss
// in continuous time, by minimization over time, angle and speed of that touch alone: 2.711708788.
class LeavesSaddle : public testing::TestWithParam<std::string> {};

TEST_P(LeavesSaddle, AndTouchesThePost) {
  const Scene scene = HeadOn();
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  const ExactRun exact =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_LT(exact.loss, 2.7120);
  EXPECT_GT(exact.loss, 2.711708787);
  // There the loss has a kink, of which only hmp has no conditions.
  if (GetParam() == "hmp") {
    EXPECT_NE(report.termination, Termination::kConverged);
    EXPECT_THAT(report.reason, HasSubstr("touches"));
    return;
  }
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_THAT(report.certificate->reason, HasSubstr("just touch"));
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationaryOnGrid);
}

INSTANTIATE_TEST_SUITE_P(Solvers, LeavesSaddle, testing::Values("ceres_event", "ceres_phases", "hmp", "mode_search"),
                         ParameterName());

// Whatever a solver thinks: what the certificate denies has not converged.
TEST(Converged, ComesWithAStationaryVerdict) {
  for (const char* problem : {"two_balls", "single_collision", "multiple_collisions"}) {
    const Scene scene = ProblemScene(problem);
    for (const SolverEntry& solver : AllSolvers()) {
      if (solver.name == "ceres_lagrangian" || solver.name == "gd") continue;  // slow, and far from converging
      const SolveReport report = Solve(solver.name, {scene, "event"}, {});
      if (report.termination != Termination::kConverged) continue;
      const Certificate certificate = CertifyReport(scene, report);
      EXPECT_TRUE(report.certificate->IsStationary()) << problem << " " << solver.name;
      EXPECT_TRUE(certificate.IsStationary()) << problem << " " << solver.name;
      EXPECT_FALSE(certificate.IsSaddle()) << problem << " " << solver.name;
    }
  }
}

// An impact inside an interval: no kink, the gradient itself vanishes where the continuous conditions do not hold.
TEST(Certificate, KnowsStationaryControlsOnAGridWithoutKink) {
  Scene scene = TwoPushed();
  scene.bodies.pop_back();
  scene.control = {{0}, {{0.3, 0}}};
  scene.objective.terminal.resize(1);
  scene.steps = 9;
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  const Certificate certificate = CertifyReport(scene, report);
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationaryOnGrid) << certificate.reason;
  ASSERT_EQ(certificate.impacts.size(), 1u);
  EXPECT_FALSE(certificate.impacts[0].on_node);
  EXPECT_LT(*certificate.gradient, 1e-6);
  EXPECT_GT(certificate.stationarity, 1e-3);
  EXPECT_EQ(VerdictInWords(certificate), "minimum on the grid");
}

}  // namespace
}  // namespace saltus
