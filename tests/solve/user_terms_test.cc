// Costs and constraints of a user's own: where scene files can say the same, the solution is the same.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

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

SolveReport SolveWith(const Scene& scene, std::vector<HybridTerm> terms, const char* solver = "ceres_phases") {
  return Solve(
      solver, {.scene = scene, .contact = "event", .terms = std::move(terms)}, {.limits = {.iterations = 300}});
}

// The state of two discs: [x y v_x v_y] of each.
constexpr int kState = 8;

// A cost that is zero, with which a scene is solved as one with own terms is.
struct Zero {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = 0.0 * x[0];
    return true;
  }
};
HybridTerm Nothing() {
  HybridTerm term{.name = "nothing", .with_state = true};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<Zero, 1, kState>>(new Zero);
  return term;
}

struct FinalMiss {
  int body;
  double scale, target = 0.3;
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    for (int j = 0; j < 2; ++j) residuals[j] = scale * (x[4 * body + j] - target);
    return true;
  }
};
HybridTerm FinalPosition(int body, HybridTerm::Role role, double scale) {
  HybridTerm term{.name = "aim", .role = role, .with_state = true};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<FinalMiss, 2, kState>>(new FinalMiss{body, scale});
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

// Costs of the angle and the angular velocity of the first of two discs, whose rotations follow the states.
struct RotationMiss {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = x[kState] - 1.5;
    residuals[1] = sqrt(0.3) * (x[kState + 1] - 2.0);
    return true;
  }
};

// Forces and torque / radius over the steps, as the effort of an objective.
struct EffortWithTorque {
  double weight;
  template <typename T>
  bool operator()(const T* u, const T* h, T* residuals) const {
    using std::sqrt;
    for (int j = 0; j < 3; ++j) residuals[j] = sqrt(weight * h[0]) * u[j];
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

  HybridTerm rotation{.name = "rotation", .with_state = true};
  rotation.function = std::make_shared<ceres::AutoDiffCostFunction<RotationMiss, 2, kState + 4>>(new RotationMiss);
  HybridTerm effort{
      .name = "effort", .at = HybridTerm::Timing::kEachInterval, .with_control = true, .with_length = true};
  effort.function = std::make_shared<ceres::AutoDiffCostFunction<EffortWithTorque, 3, 3, 1>>(
      new EffortWithTorque{0.5 * scene.objective.effort});
  const SolveReport own = SolveWith(scene, {rotation, effort});
  ASSERT_EQ(own.termination, Termination::kConverged) << own.reason;
  EXPECT_NEAR(own.solution.loss, known.solution.loss, 1e-8 * known.solution.loss);
  ASSERT_EQ(own.solution.control.size(), known.solution.control.size());
  for (std::size_t i = 0; i < own.solution.control.size(); ++i) {
    EXPECT_NEAR(own.solution.control[i], known.solution.control[i], 1e-4);
  }
}

TEST(OwnTerms, CostsThatAScenesOwnWouldBe) {
  Scene with = Problem();
  with.objective.terminal.push_back({.body = 1, .target = Vec2d(0.3, 0.3), .weight = 2.5});
  with.objective.effort *= 1.5;
  const SolveReport known = SolveWith(with, {Nothing()});

  const Scene without = Problem();
  HybridTerm effort{.at = HybridTerm::Timing::kEachInterval, .with_control = true, .with_length = true};
  effort.function =
      std::make_shared<ceres::AutoDiffCostFunction<Effort, 2, 2, 1>>(new Effort{0.5 * without.objective.effort});
  const SolveReport own = SolveWith(without, {FinalPosition(1, HybridTerm::Role::kCost, std::sqrt(2.5)), effort});
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
  const SolveReport known = SolveWith(with, {Nothing()});
  const SolveReport own = SolveWith(Problem(), {FinalPosition(1, HybridTerm::Role::kEquality, 1)});
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
  HybridTerm bound{.name = "ball",
                   .at = HybridTerm::Timing::kEachInterval,
                   .role = HybridTerm::Role::kInequality,
                   .with_control = true};
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
  const SolveReport one = SolveWith(Problem(), {FinalPosition(1, HybridTerm::Role::kCost, 1)});
  // All lengths times 1024, and the loss with their squares.
  Scene large = Problem();
  for (Body& body : large.bodies) {
    body.position *= 1024;
    body.velocity *= 1024;
    body.radius *= 1024;
  }
  for (Vec2d& force : large.control.initial) force *= 1024;
  HybridTerm term{.with_state = true};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<FinalMiss, 2, kState>>(new FinalMiss{1, 1, 0.3 * 1024});
  const SolveReport other = SolveWith(large, {term});
  ASSERT_EQ(one.termination, Termination::kConverged) << one.reason;
  EXPECT_EQ(other.work.iterations, one.work.iterations);
  EXPECT_NEAR(other.solution.loss, one.solution.loss * 1024 * 1024, 1e-9 * other.solution.loss);
}

struct Nowhere {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = x[4] * x[4] + x[5] * x[5] + 1.0;
    return true;
  }
};

TEST(OwnTerms, AConstraintOutOfReachIsSaid) {
  HybridTerm term{.name = "nowhere", .role = HybridTerm::Role::kEquality, .with_state = true};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<Nowhere, 1, kState>>(new Nowhere);
  const SolveReport report = SolveWith(Problem(), {term});
  EXPECT_NE(report.termination, Termination::kConverged);
  EXPECT_THAT(report.reason, HasSubstr("nowhere"));
}

TEST(OwnTerms, WrongOnesAreRefusedByName) {
  const Scene scene = Problem();
  const auto reason_of = [&](HybridTerm term, const char* solver = "ceres_phases") {
    const SolveReport report = SolveWith(scene, {std::move(term)}, solver);
    EXPECT_EQ(report.termination, Termination::kNotApplicable);
    return report.reason;
  };
  HybridTerm term = FinalPosition(1, HybridTerm::Role::kCost, 1);
  EXPECT_THAT(reason_of(term, "ceres_shooting"), HasSubstr("ceres_phases"));
  term.with_length = true;
  EXPECT_THAT(reason_of(term), HasSubstr("aim"));
  term.with_length = false;
  term.role = HybridTerm::Role::kEquality;
  EXPECT_THAT(reason_of(term, "ceres_lbfgs"), HasSubstr("aim is a constraint"));
  term.function = nullptr;
  EXPECT_THAT(reason_of(term), HasSubstr("aim"));
}

// A cost at an event, of the state behind it, and a certificate with it: by shooting and in phases.
struct Rebound {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = 0.2 * x[6];
    residuals[1] = 0.2 * x[7];
    return true;
  }
};

TEST(OwnTerms, AreReadAtImpactsAndCertified) {
  HybridTerm term{.name = "rebound",
                  .at = HybridTerm::Timing::kEvent,
                  .event = "striker-target",
                  .occurrence = 0,
                  .with_state = true};
  term.function = std::make_shared<ceres::AutoDiffCostFunction<Rebound, 2, kState>>(new Rebound);
  const SolveReport phases = SolveWith(Problem(), {term});
  ASSERT_EQ(phases.termination, Termination::kConverged) << phases.reason;
  ASSERT_TRUE(phases.certificate);
  EXPECT_TRUE(phases.certificate->IsStationary()) << phases.certificate->reason;
  // Without gravity the target keeps the velocity that the impact gives it.
  HybridTerm at_end = term;
  at_end.at = HybridTerm::Timing::kEnd;
  at_end.event = "";
  at_end.occurrence = -1;
  const SolveReport known = SolveWith(Problem(), {at_end});
  ASSERT_EQ(known.termination, Termination::kConverged) << known.reason;
  EXPECT_NEAR(phases.solution.loss, known.solution.loss, 1e-9 * known.solution.loss);
  const SolveReport shooting = SolveWith(Problem(), {at_end}, "ceres_lbfgs");
  EXPECT_NEAR(shooting.solution.loss, known.solution.loss, 1e-3 * known.solution.loss);  // on equal intervals
}

}  // namespace
}  // namespace saltus
