// Optima of mechanical systems with contacts: a pendulum that swings up and may use an elastic wall, against optima
// that were computed in 60 digits by Newton's method on exact derivatives.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <vector>

#include "folders.h"
#include "problems/hybrid/wall_swing_up.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// On a grid of 40 intervals, the best control that is known strikes where it switches for the ninth time: a kink.
TEST(WallSwingUp, BestControlOnTheGridIsAtAKink) {
  std::ifstream file(SourceFolder() + "/data/mechanical_references.json");
  const nlohmann::json reference = nlohmann::json::parse(file)["P12"]["pinned"];
  const auto number = [](const nlohmann::json& value) { return std::stod(value.get<std::string>()); };
  HybridProblem problem = WallSwingUpProblem();
  for (int k = 0; k < 40; ++k) problem.guess.control[k] = number(reference["u"][k]);
  const SolveReport report = Solve("gd", problem, {.iterations = 0});
  EXPECT_NEAR(report.final_loss, number(reference["J"]), 1e-11);
  EXPECT_THAT(report.reason, HasSubstr("guard 'wall hit' has an event at t = 0.36, where the control jumps"));
  HybridSimulator simulator(problem.system, {.tolerance = 1e-14});
  ASSERT_TRUE(simulator.Rollout(problem.guess)) << simulator.WhyFailed();
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_NEAR(simulator.events()[0].time, 0.36, 1e-13);
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(simulator.events()[0].before[i], number(reference["x_impact"][i]), 1e-12) << i;
    EXPECT_NEAR(simulator.final_state()[i], number(reference["xT"][i]), 1e-12) << i;
  }
}

// The control may switch with the impact, whenever that is, so the optimum is no kink of the loss.
TEST(WallSwingUp, OptimumHasACertificate) {
  for (const char* solver : {"ceres_phases", "mode_search"}) {
    const SolveReport report = Solve(solver, WallSwingUpProblem(), {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LT(report.final_loss, 1.2940262535645843948) << solver;
    EXPECT_GT(report.final_loss, 1.29) << solver;
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
    ASSERT_EQ(report.certificate->impacts.size(), 1u);
    EXPECT_EQ(report.certificate->impacts[0].b, "wall hit");
  }
}

// On the grid, where optima sit on kinks, single shooting ends near one of them.
TEST(WallSwingUp, ShootingEndsAtAKinkAndSaysSo) {
  const SolveReport report = Solve("ceres_lbfgs", WallSwingUpProblem(), {.iterations = 2000});
  EXPECT_LT(report.final_loss, 1.4861) << "the best that is known without an impact";
  EXPECT_THAT(report.reason, HasSubstr("where the control jumps"));
}

// A weight on the wall's side of the pendulum holds the impact for a while.
TEST(WallSwingUp, AContactThatStaysClosedIsRefusedWithAReason) {
  HybridProblem problem = WallSwingUpProblem();
  problem.guess.parameters = {0};
  problem.guess.control.assign(40, 12.0);
  const SolveReport report = Solve("ceres_phases", problem, {.search = false});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("closed"));
}

// The same pendulum under a torque that is a polynomial of t / T, whose coefficients are the parameters.
struct PolynomialTorque : PendulumAtWall {
  static constexpr double kDuration = 1.6;
  static constexpr int kNumControls = 0, kNumParameters = 7;  // c_0 .. c_5, e
  static constexpr std::array<const char*, 0> kControlNames = {};
  static constexpr std::array<const char*, 7> kParameterNames = {"c0", "c1", "c2", "c3", "c4", "c5", "e"};

  template <typename T>
  void Force(const T& t, const T* q, const T*, const T*, const T* p, T* h) const {
    using std::sin;
    const T s = t / kDuration;
    T torque = p[5];
    for (int i = 4; i >= 0; --i) torque = torque * s + p[i];
    h[0] = torque - m * g * l * sin(q[0]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[6];
  }
};

// 0.02 int u^2 dt = 0.02 T c^T H c with the Hilbert matrix H = L L^T: the residuals are sqrt(0.02 T) L^T c.
struct Effort {
  Eigen::Matrix<double, 6, 6> root;
  Effort() {
    Eigen::Matrix<double, 6, 6> hilbert;
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) hilbert(i, j) = 1.0 / (i + j + 1);
    }
    root = std::sqrt(0.02 * PolynomialTorque::kDuration) * Eigen::Matrix<double, 6, 6>(hilbert.llt().matrixU());
  }
  template <typename T>
  bool operator()(const T* p, T* residuals) const {
    for (int i = 0; i < 6; ++i) {
      residuals[i] = T(0.0);
      for (int j = i; j < 6; ++j) residuals[i] += root(i, j) * p[j];
    }
    return true;
  }
};

SolveReport SolvePolynomial(const std::vector<double>& start) {
  HybridProblem problem{.system = MechanicalSystem(PolynomialTorque()).hybrid(),
                        .guess = {.initial = {0, 0}, .parameters = start, .duration = PolynomialTorque::kDuration},
                        .terms = {MakeTerminalCost(0, -std::numbers::pi, 100.0, 2), MakeTerminalCost(1, 0.0, 10.0, 2)}};
  problem.guess.parameters.push_back(0.9);
  problem.terms.push_back({.name = "effort",
                           .with_parameters = true,
                           .function = std::make_shared<ceres::AutoDiffCostFunction<Effort, 6, 7>>(new Effort())});
  problem.free.parameters = {0, 1, 2, 3, 4, 5};
  return Solve("ceres_lm", problem, {.iterations = 2000});
}

TEST(PolynomialSwingUp, WithoutImpact) {
  const SolveReport report = SolvePolynomial({-5.1, -65.6, 206.4, -131.9, -82.4, 84.3});
  EXPECT_NEAR(report.final_loss, 1.4856636733327897, 1e-9) << report.reason;
}

TEST(PolynomialSwingUp, WithOneImpact) {
  const SolveReport report = SolvePolynomial({-11, -11, -120, 870, -1330, 595});
  EXPECT_NEAR(report.final_loss, 2.0435133468791774, 1e-9) << report.reason;
}

}  // namespace
}  // namespace saltus
