// The second derivative of the exact loss by the control, against differences of it and of its gradients, and what the
// certificate makes of it.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>

#include "base/linear_algebra.h"
#include "control/pushed_scenes.h"
#include "optimality/condensed.h"
#include "parameter_name.h"
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

class Condensed : public testing::TestWithParam<Case> {};

// The event-driven model knows the gradient; its differences are the dense second derivative.
TEST_P(Condensed, EqualsDifferencesOfExactGradients) {
  const Scene& scene = GetParam().scene;
  const std::vector<double> control = Wavy(scene), lengths = EqualLengths(scene);
  const Exact exact(scene, control, lengths);
  ASSERT_TRUE(exact.run.only_impacts);
  ASSERT_EQ(exact.run.events.size(), GetParam().impacts);
  for (const Flight::Hit& hit : exact.flight.hits()) ASSERT_FALSE(hit.on_node);

  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  const auto gradient = [&](const std::vector<double>& at) {
    double loss = 0;
    Eigen::VectorXd g(at.size());
    EXPECT_TRUE(shooting.Evaluate(at, &loss, g.data()));
    return g;
  };
  const CondensedLoss condensed(scene, exact.flight, control, lengths);
  const Eigen::VectorXd ours = condensed.Gradient();
  EXPECT_LT((ours - gradient(control)).norm(), 1e-12 * ours.norm());

  const Eigen::MatrixXd hessian = condensed.DenseHessian();
  Eigen::MatrixXd differences(hessian.rows(), hessian.cols());
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
  EXPECT_LT((hessian - differences).norm(), 1e-8 * differences.norm());
  // Not by the effort alone.
  EXPECT_GT((hessian - Eigen::MatrixXd(hessian.diagonal().asDiagonal())).norm(), 1e-3 * hessian.norm());

  // The smallest eigenvalue by any direction of unit length in time.
  const double h = scene.dt(), of_effort = 2 * scene.objective.effort * h;
  const Eigen::VectorXd dense = EigenOf(hessian / of_effort).values;
  const CurvatureRange curvature = condensed.SmallestCurvature();
  EXPECT_NEAR(curvature.smallest, dense[0], 1e-9 * dense.cwiseAbs().maxCoeff());
  EXPECT_NEAR(h * curvature.direction.squaredNorm(), 1, 1e-9);
  const double along = curvature.direction.dot(hessian * curvature.direction) / (2 * scene.objective.effort);
  EXPECT_NEAR(along, curvature.smallest, 1e-8 * std::abs(curvature.smallest));
}

INSTANTIATE_TEST_SUITE_P(Scenes, Condensed,
                         testing::Values(Case{"two_balls", With(ProblemScene("two_balls"), 25), 1},
                                         Case{"single_collision", With(ProblemScene("single_collision"), 25), 1},
                                         Case{"multiple_collisions", With(ProblemScene("multiple_collisions"), 25), 3},
                                         Case{"head_on", With(HeadOn(), 23), 1}, Case{"two_pushed", TwoPushed(), 2},
                                         Case{"spin_slips", TwoSpin(0.05), 2}, Case{"spin_sticks", TwoSpin(2), 2},
                                         Case{"strike_sticks", SpinStrike(2), 1},
                                         Case{"torques_slip", WithTorques(TwoSpin(0.05)), 2},
                                         Case{"torques_stick", WithTorques(TwoSpin(2)), 2}),
                         [](const auto& at) { return at.param.name; });

// Path costs and a free final time, which is one variable more, by second differences of the loss: the last interval
// becomes longer.
TEST(Curvature, HasPathCostsAndTheFinalTime) {
  const Scene scenes[] = {WithWaypoints(TwoPushed()),
                          WithRunningTerms(TwoPushed()),
                          WithTorques(WithRunningTerms(WithWaypoints(TwoSpin(0.05)))),
                          WithTorques(WithRunningTerms(WithWaypoints(TwoSpin(2))))};
  for (Scene scene : scenes) {
    SCOPED_TRACE(scene.name);
    scene.objective.duration = {.min = 0.5, .max = 2, .weight = 0.7};
    const std::vector<double> control = Wavy(scene), lengths = EqualLengths(scene);
    const Exact exact(scene, control, lengths);
    const CondensedLoss condensed(scene, exact.flight, control, lengths);
    const Eigen::MatrixXd hessian = condensed.DenseHessian();
    const Eigen::VectorXd gradient = condensed.Gradient();
    const auto n = static_cast<Eigen::Index>(control.size());
    ASSERT_EQ(hessian.rows(), n + 1);
    const auto loss = [&](const Eigen::VectorXd& by, double eps) {
      Scene longer = scene;
      std::vector<double> moved = control, durations = lengths;
      for (Eigen::Index i = 0; i < n; ++i) moved[i] += eps * by[i];
      longer.duration += eps * by[n];
      durations.back() += eps * by[n];
      return ExactLoss(longer, moved, durations);
    };
    Eigen::VectorXd by = Eigen::VectorXd::Zero(n + 1);
    for (int trial = 0; trial < 5; ++trial) {
      by[n] = trial == 1 ? 0 : 0.3;
      const auto first = [&](double eps) { return (loss(by, eps) - loss(by, -eps)) / (2 * eps); };
      const auto second = [&](double eps) { return (loss(by, eps) - 2 * loss(by, 0) + loss(by, -eps)) / (eps * eps); };
      const double differences = (4 * second(5e-4) - second(1e-3)) / 3, along = by.dot(hessian * by);
      EXPECT_NEAR(along, differences, 1e-6 * std::max(1.0, std::abs(along))) << trial;
      if (trial == 1) {
        EXPECT_NEAR(by.head(n).dot(gradient), (4 * first(5e-4) - first(1e-3)) / 3, 1e-9);
      }
      for (Eigen::Index i = 0; i < n; ++i) by[i] = std::sin(static_cast<double>((trial + 2) * i + trial));
    }
  }
}

// The least curvature is measured by the effort and, along the final time, by another size: it has the sign of the
// least eigenvalue (Sylvester).
TEST(Curvature, IsPositiveWhereTheMatrixIs) {
  int negative = 0, positive = 0;
  Scene flies = With(HeadOn(), 23);
  flies.bodies[0].velocity = {0, 1};
  flies.objective.terminal[0].target = {-1, 1};
  for (Scene scene : {WithWaypoints(TwoPushed()), With(HeadOn(), 23), flies}) {
    scene.objective.duration = {.min = 0.5, .max = 2, .weight = 0.7};
    for (double effort : {0.01, 0.5, 1000.0}) {
      scene.objective.effort = effort;
      const std::vector<double> control = Wavy(scene), lengths = EqualLengths(scene);
      const Exact exact(scene, control, lengths);
      const CondensedLoss loss(scene, exact.flight, control, lengths);
      const double smallest = EigenOf(loss.DenseHessian()).values[0];
      (smallest < 0 ? negative : positive) += 1;
      EXPECT_EQ(loss.SmallestCurvature().smallest > 0, smallest > 0) << scene.name << effort;
    }
  }
  EXPECT_GT(negative, 0);
  EXPECT_GT(positive, 0);
}

// Forces that are free, at one bound, at two, and at one that is curved; and hard terms for both discs.
Restrictions SomeRestrictions(const Scene& scene) {
  Restrictions restrictions{.forces = {}, .rows = RowsOfHardTerms(scene)};
  for (size_t i = 0; i < restrictions.rows.size(); ++i) {
    constexpr double kMultipliers[] = {0.3, -0.2, 0.1, 0.4};
    restrictions.rows[i].multiplier = kMultipliers[i];
  }
  restrictions.forces.resize(scene.steps * scene.num_controlled());
  for (size_t i = 0; i < restrictions.forces.size(); ++i) {
    Restrictions::Force& force = restrictions.forces[i];
    const Vec2d tangent(std::cos(double(i)), std::sin(double(i)));
    if (i % 5 == 1) force.free = Vec2d(0, 1).asDiagonal();
    if (i % 5 == 2) force.free.setZero();
    if (i % 5 == 3) force = {tangent * tangent.transpose(), 0.7};
  }
  return restrictions;
}

// A linear objective is a row of the derivative of the end by the control; the model knows it exactly.
Eigen::RowVectorXd DerivativeOf(Scene scene, const TerminalTerm& term, const std::vector<double>& control) {
  scene.objective.terminal = {term};
  scene.objective.effort = 0;
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  double loss = 0;
  Eigen::VectorXd row(control.size());
  EXPECT_TRUE(shooting.Evaluate(control, &loss, row.data()));
  return row.transpose();
}

// With bounds and hard terms it is the least eigenvalue of the dense Lagrangian where directions may go. The
// multipliers of hard terms are those of linear ones.
TEST(Curvature, IsThatOfTheLagrangianAlongWhatIsFree) {
  const Scene lagrangian = [] {
    Scene scene = TwoPushed();
    const auto add = [&](int body, TerminalTerm::Quantity quantity, int component, double weight) {
      scene.objective.terminal.push_back(
          {.body = body, .quantity = quantity, .component = component, .weight = weight});
    };
    add(0, TerminalTerm::Quantity::kPosition, 0, 0.3);
    add(0, TerminalTerm::Quantity::kPosition, 1, -0.2);
    add(1, TerminalTerm::Quantity::kVelocity, 0, 0.1);
    add(1, TerminalTerm::Quantity::kVelocity, 1, 0.4);
    return scene;
  }();
  Scene hard = TwoPushed();
  hard.objective.terminal.push_back({.body = 0, .target = {1, 0}, .hard = true});
  hard.objective.terminal.push_back(
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0}, .hard = true});
  const std::vector<double> control = Wavy(hard), lengths = EqualLengths(hard);
  const Exact exact(hard, control, lengths);
  const Restrictions restrictions = SomeRestrictions(hard);
  const CurvatureRange curvature =
      CondensedLoss(hard, exact.flight, control, lengths, {}, restrictions).SmallestCurvature();

  const Exact of_lagrangian(lagrangian, control, lengths);
  Eigen::MatrixXd hessian = CondensedLoss(lagrangian, of_lagrangian.flight, control, lengths).DenseHessian();
  const double unit = 2 * hard.objective.effort * hard.dt();
  Eigen::MatrixXd measure = Eigen::MatrixXd::Zero(hessian.rows(), hessian.cols());
  Eigen::MatrixXd held = Eigen::MatrixXd::Zero(hessian.rows() + 4, hessian.cols());
  for (size_t i = 0; i < restrictions.forces.size(); ++i) {
    const Restrictions::Force& force = restrictions.forces[i];
    hessian.block<2, 2>(2 * i, 2 * i) += unit * force.bend * force.free;
    measure.block<2, 2>(2 * i, 2 * i) = unit * (Eigen::Matrix2d::Identity() + force.bend * force.free);
    held.block<2, 2>(2 * i, 2 * i) = Eigen::Matrix2d::Identity() - force.free;
  }
  for (int i = 0; i < 4; ++i) {
    TerminalTerm term = lagrangian.objective.terminal[3 + i];
    term.weight = 1;
    held.row(hessian.rows() + i) = DerivativeOf(hard, term, control);
  }
  const Eigen::MatrixXd basis = NullSpace(held);
  ASSERT_EQ(basis.cols(), 44);  // of 80 forces: 16 and 8 and 8 held, and the end
  // Solves the pencil of both: B^T hessian B for a basis B in which the measure is the identity.
  const SymmetricEigen of_measure = EigenOf(Multiply(MultiplyTransposed(basis, measure), basis));
  const Eigen::MatrixXd unit_basis =
      Multiply(basis, of_measure.vectors * of_measure.values.cwiseSqrt().cwiseInverse().asDiagonal());
  const Eigen::VectorXd dense = EigenOf(Multiply(MultiplyTransposed(unit_basis, hessian), unit_basis)).values;
  EXPECT_NEAR(curvature.smallest, dense[0], 1e-8 * dense.cwiseAbs().maxCoeff());
  EXPECT_NEAR(curvature.largest, dense.maxCoeff(), 1e-8 * dense.maxCoeff());
  EXPECT_NEAR(hard.dt() * curvature.direction.squaredNorm(), 1, 1e-9);
  EXPECT_LT((held * curvature.direction).norm(), 1e-8 * curvature.direction.norm());
}

Certificate CertifyReport(const Scene& scene, const SolveReport& report) {
  return Certify(scene, report.initial_state, report.control, report.durations);
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
  return solution.trial;
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
  EXPECT_LT(report.final_loss, saddle.exact.loss);  // that of any control straight back is higher
  for (const double force : report.control) EXPECT_LE(std::abs(force), scene.control.max[0]);
}

// One step of Newton's method leaves the square of what was missing, with the impact held on its node.
TEST(Curvature, NewtonsMethodFindsTheOptimumOnTheGrid) {
  const Scene scene = ProblemScene("two_balls");
  const std::vector<double> lengths = EqualLengths(scene);
  const SolveReport optimum = Solve("grid_optimum", {scene, "event"}, {});
  const std::vector<double>& direction = optimum.certificate->curvature->direction;  // keeps the node
  std::vector<double> left;
  for (const double eps : {1e-3, 1e-4}) {
    const std::vector<double> control = Along(optimum.control, direction, eps);
    const Exact exact(scene, control, lengths);
    const auto found = CondensedLoss(scene, exact.flight, control, lengths, {0.5}).NewtonStep();
    ASSERT_TRUE(found);
    double most = 0;
    for (size_t i = 0; i < control.size(); ++i) most = std::max(most, std::abs((*found)[i] - optimum.control[i]));
    left.push_back(most);
  }
  EXPECT_LT(left[0], 1e-4);
  EXPECT_LT(left[1], 0.02 * left[0]);
}

// With the impact held on its node the direction keeps it there.
TEST(Curvature, OnTheGridDirectionsKeepImpactsOnNodes) {
  const Scene scene = ProblemScene("two_balls");
  const SolveReport report = Solve("grid_optimum", {scene, "event"}, {});
  ASSERT_EQ(report.certificate->verdict, Certificate::Verdict::kStationaryOnGrid);
  const std::vector<double>& direction = report.certificate->curvature->direction;
  const double before = SimulateExactly(scene, report.initial_state, report.control).events[0].time;
  for (const double eps : {1e-4, -1e-4}) {
    const ExactRun moved = SimulateExactly(scene, report.initial_state, Along(report.control, direction, eps));
    EXPECT_NEAR(moved.events[0].time, before, 10 * eps * eps);
    EXPECT_GT(moved.loss, report.final_loss);
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

TEST(Curvature, LeavesOutWhatWouldTakeLong) {
  Scene scene;
  scene.name = "rattle";
  scene.steps = 2000;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, 0}, .velocity = {60, 1}}};
  scene.planes = {{"left", {-0.2, 0}, {1, 0}}, {"right", {0.2, 0}, {-1, 0}}};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0, 0}}};
  scene.objective.effort = 1;
  scene.optimize = Optimize::kControl;
  const std::vector<double> control = InitialControl(scene, scene.steps);
  EXPECT_GT(SimulateExactly(scene, InitialState(scene), control).events.size(), 200u);
  EXPECT_FALSE(CurvatureAt(scene, InitialState(scene), control));
}

// Solvers along sequences leave the saddle; the best motion touches the post, which these take as an impact. Its loss
// in continuous time, by minimization over time, angle and speed of that touch alone: 2.711708788.
class LeavesSaddle : public testing::TestWithParam<std::string> {};

TEST_P(LeavesSaddle, AndTouchesThePost) {
  const Scene scene = HeadOn();
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  const ExactRun exact = SimulateExactly(scene, report.initial_state, report.control, report.durations);
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
