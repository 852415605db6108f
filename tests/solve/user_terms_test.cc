// Costs and constraints of a user's own: where scene files can say the same, the solution is the same.
#include <ceres/autodiff_cost_function.h>
#include <ceres/gradient_checker.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "control/user_term_cost.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using ::testing::HasSubstr;

// Moves the target, as problems/two_balls.yaml.
Scene Problem() {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  return scene;
}

SolveReport SolveWith(const Scene& scene, std::vector<UserTerm> terms, const char* solver = "ceres_phases") {
  return Solve(
      solver, {.scene = scene, .contact = "event", .terms = std::move(terms)}, {.limits = {.iterations = 300}});
}

struct FinalMiss {
  double scale, target = 0.3;
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    for (int j = 0; j < 2; ++j) residuals[j] = scale * (x[j] - target);
    return true;
  }
};
UserTerm FinalPosition(int body, UserTerm::Role role, double scale) {
  UserTerm term{.name = "aim", .at = UserTerm::Timing::kEnd, .role = role, .states = {body}};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<FinalMiss, 2, 4>>(new FinalMiss{scale});
  return term;
}

// Forces over the steps, as the effort of an objective.
struct Effort {
  double weight;
  template <typename T>
  bool operator()(const T* u, const T* h, T* residuals) const {
    using std::sqrt;
    for (int j = 0; j < 2; ++j) residuals[j] = sqrt(weight * h[0]) * u[j];
    return true;
  }
};

// Torques over the steps, as the effort of an objective, for a disc of the radius 0.2.
struct TorqueEffort {
  double weight;
  template <typename T>
  bool operator()(const T* torque, const T* h, T* residuals) const {
    using std::sqrt;
    residuals[0] = sqrt(weight * h[0]) * torque[0] / 0.2;
    return true;
  }
};

struct RotationMiss {
  template <typename T>
  bool operator()(const T* rotation, T* residuals) const {
    residuals[0] = rotation[0] - 1.5;
    residuals[1] = sqrt(0.3) * (rotation[1] - 2.0);
    return true;
  }
};

TEST(OwnTerms, SeeRotationsAndTorques) {
  Scene scene = Problem();
  for (Body& body : scene.bodies) body.inertia.kind = Inertia::Kind::kSolid;
  scene.control.torque_bodies = {0};
  scene.control.initial_torque = {0};
  Scene with = scene;
  with.objective.terminal.push_back(
      {.body = 0, .quantity = TerminalTerm::Quantity::kAngle, .target = {1.5, 0}, .weight = 1});
  with.objective.terminal.push_back(
      {.body = 0, .quantity = TerminalTerm::Quantity::kAngularVelocity, .target = {2, 0}, .weight = 0.3});
  with.objective.effort *= 1.5;
  const SolveReport known = SolveWith(with, {});
  ASSERT_EQ(known.termination, Termination::kConverged) << known.reason;

  UserTerm rotation{.name = "rotation", .at = UserTerm::Timing::kEnd, .rotations = {0}};
  rotation.function = std::make_shared<ceres::AutoDiffCostFunction<RotationMiss, 2, 2>>(new RotationMiss);
  UserTerm torque{.name = "torque", .at = UserTerm::Timing::kEachStep, .torques = {0}, .with_length = true};
  torque.function = std::make_shared<ceres::AutoDiffCostFunction<TorqueEffort, 1, 1, 1>>(
      new TorqueEffort{0.5 * scene.objective.effort});
  UserTerm effort{.name = "effort", .at = UserTerm::Timing::kEachStep, .forces = {0}, .with_length = true};
  effort.function =
      std::make_shared<ceres::AutoDiffCostFunction<Effort, 2, 2, 1>>(new Effort{0.5 * scene.objective.effort});
  const SolveReport own = SolveWith(scene, {rotation, torque, effort});
  ASSERT_EQ(own.termination, Termination::kConverged) << own.reason;
  EXPECT_NEAR(own.solution.loss, known.solution.loss, 1e-8 * known.solution.loss);
  ASSERT_EQ(own.solution.control.size(), known.solution.control.size());
  for (std::size_t i = 0; i < own.solution.control.size(); ++i) {
    EXPECT_NEAR(own.solution.control[i], known.solution.control[i], 1e-4);
  }

  rotation.at = UserTerm::Timing::kEachStep;
  rotation.rotations = {1};
  EXPECT_THAT(SolveWith(scene, {rotation}).reason, HasSubstr("rotation in each step of disc 1"));
  torque.torques = {1};
  EXPECT_THAT(SolveWith(scene, {torque}).reason, HasSubstr("torque on disc 1"));
}

TEST(OwnTerms, CostsThatAScenesOwnWouldBe) {
  Scene with = Problem();
  with.objective.terminal.push_back({.body = 1, .target = Vec2d(0.3, 0.3), .weight = 2.5});
  with.objective.effort *= 1.5;
  const SolveReport known = SolveWith(with, {});

  const Scene without = Problem();
  UserTerm effort{.at = UserTerm::Timing::kEachStep, .forces = {0}, .with_length = true};
  effort.function =
      std::make_shared<ceres::AutoDiffCostFunction<Effort, 2, 2, 1>>(new Effort{0.5 * without.objective.effort});
  const SolveReport own = SolveWith(without, {FinalPosition(1, UserTerm::Role::kCost, std::sqrt(2.5)), effort});
  ASSERT_EQ(known.termination, Termination::kConverged) << known.reason;
  ASSERT_EQ(own.termination, Termination::kConverged) << own.reason;
  EXPECT_NEAR(own.guess.loss, known.guess.loss, 1e-12);
  EXPECT_NEAR(own.solution.loss, known.solution.loss, 1e-9 * known.solution.loss);
  EXPECT_LT(own.solution.loss, 0.9 * own.guess.loss);
  // Without them it is another problem.
  EXPECT_GT(std::abs(SolveWith(without, {}).solution.loss - own.solution.loss), 1e-2);
}

TEST(OwnTerms, AnEqualityIsAHardTerm) {
  Scene with = Problem();
  with.objective.terminal.push_back({.body = 1, .target = Vec2d(0.3, 0.3), .hard = true});
  const SolveReport known = SolveWith(with, {});
  const SolveReport own = SolveWith(Problem(), {FinalPosition(1, UserTerm::Role::kEquality, 1)});
  ASSERT_EQ(known.termination, Termination::kConverged) << known.reason;
  ASSERT_EQ(own.termination, Termination::kConverged) << own.reason;
  EXPECT_NEAR(own.solution.loss, known.solution.loss, 1e-7 * known.solution.loss);
  const ExactRun exact =
      SimulateExactly(Problem(), own.solution.initial_state, own.solution.control, own.solution.durations);
  ASSERT_TRUE(exact.ok);
  EXPECT_NEAR(exact.loss, own.solution.loss, 1e-12);
}

// |u|^2 <= most^2, in every step.
struct Ball {
  double most;
  template <typename T>
  bool operator()(const T* u, T* residuals) const {
    residuals[0] = 0.5 * ((u[0] * u[0] + u[1] * u[1]) / (most * most) - 1.0);
    return true;
  }
};

TEST(OwnTerms, AnInequalityIsABound) {
  constexpr double kMost = 3;
  Scene without = Problem();
  without.control.initial = {Vec2d(2, 2)};  // within the bound, or steps are shared out in another way
  Scene with = without;
  with.control.max_norm = {kMost};
  const SolveReport known = SolveWith(with, {});
  UserTerm bound{.name = "ball", .at = UserTerm::Timing::kEachStep, .role = UserTerm::Role::kInequality, .forces = {0}};
  bound.function = std::make_shared<ceres::AutoDiffCostFunction<Ball, 1, 2>>(new Ball{kMost});
  const SolveReport own = SolveWith(without, {bound});
  ASSERT_EQ(known.termination, Termination::kConverged) << known.reason;
  ASSERT_EQ(own.termination, Termination::kConverged) << own.reason;
  EXPECT_GT(own.solution.loss, SolveWith(without, {}).solution.loss + 1e-4);  // it is in the way
  EXPECT_NEAR(own.solution.loss, known.solution.loss, 1e-7 * known.solution.loss);
  for (size_t i = 0; i < own.solution.control.size(); i += 2) {
    EXPECT_LE(std::hypot(own.solution.control[i], own.solution.control[i + 1]), kMost * (1 + 1e-8));
  }
}

TEST(OwnTerms, UnitsAreThoseOfTheScene) {
  const SolveReport one = SolveWith(Problem(), {FinalPosition(1, UserTerm::Role::kCost, 1)});
  // All lengths times 1024, and the loss with their squares.
  Scene large = Problem();
  for (Body& body : large.bodies) {
    body.position *= 1024;
    body.velocity *= 1024;
    body.radius *= 1024;
  }
  for (Vec2d& force : large.control.initial) force *= 1024;
  UserTerm term{.at = UserTerm::Timing::kEnd, .states = {1}};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<FinalMiss, 2, 4>>(new FinalMiss{1, 0.3 * 1024});
  const SolveReport other = SolveWith(large, {term});
  ASSERT_EQ(one.termination, Termination::kConverged) << one.reason;
  EXPECT_EQ(other.work.iterations, one.work.iterations);
  EXPECT_NEAR(other.solution.loss, one.solution.loss * 1024 * 1024, 1e-9 * other.solution.loss);
}

// A cost of the states of two discs, a force and a length, no two entries alike.
struct Mixed {
  template <typename T>
  bool operator()(const T* x, const T* y, const T* u, const T* h, T* residuals) const {
    residuals[0] = x[0] * y[1] + x[2] * x[3] * h[0] - y[2];
    residuals[1] = u[0] * u[1] * h[0] * h[0] + 3.0 * x[1] - y[0] * y[3];
    return true;
  }
};

// In units that share no factor: the values of the function in SI units, and its derivatives.
TEST(OwnTerms, HaveTheirDerivativesInEveryUnit) {
  const Units units{.length = 4, .time = 0.5, .mass = 8, .loss = 32, .origin = Vec2d(64, -128)};
  Scene scene;
  scene.units = units;
  scene.bodies.resize(2);
  UserTerm term{.role = UserTerm::Role::kEquality, .states = {0, 1}, .forces = {0}, .with_length = true, .scale = 0.25};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<Mixed, 2, 4, 4, 2, 1>>(new Mixed);
  const std::array<double, 4> x{0.3, -0.7, 1.1, 0.6}, y{-0.2, 0.9, -1.3, 0.4};
  const std::array<double, 2> u{0.8, -1.7};
  constexpr double kLength = 0.9;

  for (const UserTerm::Timing at : {UserTerm::Timing::kEachStep, UserTerm::Timing::kEnd}) {
    term.at = at;
    const double length = 0.5 * kLength;
    const auto in_si = [](const std::array<double, 4>& z) {
      return std::array<double, 4>{64 + 4 * z[0], -128 + 4 * z[1], 8 * z[2], 8 * z[3]};
    };
    const std::array<double, 4> x_si = in_si(x), y_si = in_si(y);
    const std::array<double, 2> u_si{128 * u[0], 128 * u[1]};  // kg m / s^2
    std::array<double, 2> expected;
    Mixed()(x_si.data(), y_si.data(), u_si.data(), &length, expected.data());

    const UserTermCost cost(term, scene);
    const std::vector<const double*> blocks{x.data(), y.data(), u.data(), &kLength};
    std::array<double, 2> residuals;
    ASSERT_TRUE(cost.Evaluate(blocks.data(), residuals.data(), nullptr));
    for (int r = 0; r < 2; ++r) EXPECT_NEAR(residuals[r], expected[r] / 0.25, 1e-12 * std::abs(expected[r]));
    ceres::GradientChecker checker(&cost, static_cast<const std::vector<const ceres::Manifold*>*>(nullptr), {});
    ceres::GradientChecker::ProbeResults results;
    EXPECT_TRUE(checker.Probe(blocks.data(), 1e-8, &results)) << results.error_log;
  }

  // A cost's square is a loss.
  term.role = UserTerm::Role::kCost;
  std::array<double, 2> constraint, residuals;
  const std::vector<const double*> blocks{x.data(), y.data(), u.data(), &kLength};
  ASSERT_TRUE(UserTermCost(term, scene).Evaluate(blocks.data(), residuals.data(), nullptr));
  term.role = UserTerm::Role::kEquality;
  ASSERT_TRUE(UserTermCost(term, scene).Evaluate(blocks.data(), constraint.data(), nullptr));
  for (int r = 0; r < 2; ++r) {
    EXPECT_NEAR(
        residuals[r] * residuals[r], std::pow(0.25 * constraint[r], 2) / 32, 1e-12 * residuals[r] * residuals[r]);
  }
}

struct Nowhere {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = x[0] * x[0] + x[1] * x[1] + 1.0;
    return true;
  }
};

TEST(OwnTerms, AConstraintOutOfReachIsSaid) {
  UserTerm term{.name = "nowhere", .at = UserTerm::Timing::kEnd, .role = UserTerm::Role::kEquality, .states = {1}};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<Nowhere, 1, 4>>(new Nowhere);
  const SolveReport report = SolveWith(Problem(), {term});
  EXPECT_NE(report.termination, Termination::kConverged);
  EXPECT_THAT(report.reason, HasSubstr("nowhere"));
}

TEST(OwnTerms, WrongOnesAreRefusedByName) {
  const Scene scene = Problem();
  const auto reason_of = [&](UserTerm term, const char* solver = "ceres_phases") {
    const SolveReport report = SolveWith(scene, {std::move(term)}, solver);
    EXPECT_EQ(report.termination, Termination::kNotApplicable);
    return report.reason;
  };
  UserTerm term = FinalPosition(1, UserTerm::Role::kCost, 1);
  EXPECT_THAT(reason_of(term, "gd"), HasSubstr("ceres_phases"));
  term.states = {2};
  EXPECT_THAT(reason_of(term), HasSubstr("aim: found the state of disc 2, expected 0 to 1"));
  term.states = {0, 1};
  EXPECT_THAT(reason_of(term), HasSubstr("sizes [4], expected [4, 4]"));
  term.states = {1};
  term.forces = {1};
  EXPECT_THAT(reason_of(term), HasSubstr("disc 1, expected a disc that is controlled"));
  term.forces = {0};
  EXPECT_THAT(reason_of(term), HasSubstr("a force at the final time"));
  term.forces = {};
  term.scale = 0;
  EXPECT_THAT(reason_of(term), HasSubstr("a scale above zero"));
  term.function = nullptr;
  EXPECT_THAT(reason_of(term), HasSubstr("no function"));
}

}  // namespace
}  // namespace saltus
