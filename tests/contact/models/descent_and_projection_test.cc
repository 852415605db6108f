// Positions projected by a quadratic program, implicit springs by descent, and contact that sticks, against other ways
// to solve the same equations. By name, as users get them.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>
#include <string>

#include "base/linear_algebra.h"
#include "contact/one_step.h"
#include "saltus/audit/gradients.h"
#include "test_scenes.h"

namespace saltus::contact_test {
namespace {

double Uniform(std::mt19937_64& random, double low, double high) {
  return low + (high - low) * (static_cast<double>(random() >> 11) / 9007199254740992.0);
}

// Three discs, one of them fixed, masses 1 and 2, above the ground, that overlap or are about to.
Scene Crowd(std::mt19937_64& random, double friction) {
  const auto near = [&](double x, double y) { return Vec2d(x + Uniform(random, -5e-3, 5e-3), y); };
  const double bottom = 0.2 + Uniform(random, -4e-3, 2e-3);
  Scene scene = DiscScene({{.name = "a", .radius = 0.2, .mass = 1, .position = near(0, bottom)},
                           {.name = "b", .radius = 0.2, .mass = 2, .position = near(0.4, bottom)},
                           {.name = "c", .radius = 0.2, .fixed = true, .position = near(0.2, bottom + 0.346)}},
                          {{"ground", {0, 0}, {0, 1}}});
  scene.duration = 1;
  for (int i = 0; i < 2; ++i) scene.bodies[i].velocity = {Uniform(random, -2, 2), Uniform(random, -2, 1)};
  scene.contact = {.restitution = 0.5, .friction = friction, .stiffness = 1e4, .damping = 0};
  return scene;
}

double Gap(const Scene& scene, const std::vector<Vec2d>& at, int contact) {
  const auto gap = [&](int a, int b) { return (at[a] - at[b]).norm() - 0.4; };
  if (contact < 3) return contact == 0 ? gap(0, 1) : gap(contact - 1, 2);
  return at[contact - 3][1] - scene.bodies[0].radius;
}

// The projection of x* on gaps that are linear at x*, of the contacts that overlap there, by trying all sets of active
// ones. Rows of N: a-b, a-c, b-c, a-ground, b-ground. Nothing if other contacts overlap in the end.
std::optional<Eigen::Vector4d> ProjectByAllSets(const Scene& scene, const Eigen::Vector4d& predicted) {
  std::vector<Vec2d> at = {predicted.head<2>(), predicted.tail<2>(), scene.bodies[2].position};
  std::vector<int> overlapping;
  for (int contact = 0; contact < 5; ++contact) {
    if (Gap(scene, at, contact) < 0) overlapping.push_back(contact);
  }
  const int n = static_cast<int>(overlapping.size());
  Eigen::MatrixXd N = Eigen::MatrixXd::Zero(n, 4);
  Eigen::VectorXd gap(n);
  for (int i = 0; i < n; ++i) {
    const int contact = overlapping[i];
    gap[i] = Gap(scene, at, contact);
    if (contact == 0) N.row(i) << (at[0] - at[1]).normalized().transpose(), (at[1] - at[0]).normalized().transpose();
    if (contact == 1) N.block<1, 2>(i, 0) = (at[0] - at[2]).normalized().transpose();
    if (contact == 2) N.block<1, 2>(i, 2) = (at[1] - at[2]).normalized().transpose();
    if (contact >= 3) N(i, contact == 3 ? 1 : 3) = 1;
  }
  const Eigen::Vector4d inverse_mass(1, 1, 0.5, 0.5);
  for (int set = 0; set < 1 << n; ++set) {
    std::vector<int> rows;
    for (int i = 0; i < n; ++i) {
      if (set >> i & 1) rows.push_back(i);
    }
    Eigen::Vector4d x = predicted;
    if (!rows.empty()) {
      const Eigen::MatrixXd active = N(rows, Eigen::all), A = active * inverse_mass.asDiagonal() * active.transpose();
      const Eigen::VectorXd multipliers = LeastNormSolution(A, -gap(rows));
      if (multipliers.minCoeff() < 0) continue;
      x += inverse_mass.asDiagonal() * active.transpose() * multipliers;
    }
    if (n > 0 && (gap + N * (x - predicted)).minCoeff() < -1e-12) continue;
    at[0] = x.head<2>();
    at[1] = x.tail<2>();
    for (int contact = 0; contact < 5; ++contact) {
      if (Gap(scene, at, contact) < -1e-12) return std::nullopt;
    }
    return x;
  }
  ADD_FAILURE() << "no set of contacts is active";
  return std::nullopt;
}

TEST(PositionQp, IsTheProjectionThatAllActiveSetsGive) {
  std::mt19937_64 random(11);
  int compared = 0, several = 0;
  while (compared < 48) {
    const Scene scene = Crowd(random, 0);
    OneStep step("position_qp", scene);
    Eigen::Vector4d predicted;
    for (int i = 0; i < 2; ++i)
      predicted.segment<2>(2 * i) = scene.bodies[i].position + step.h() * scene.bodies[i].velocity;
    const auto expected = ProjectByAllSets(scene, predicted);
    if (!expected) continue;
    step.Run();
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        ASSERT_NEAR(step.after(i, j), (*expected)[2 * i + j], 1e-14);
        ASSERT_NEAR(step.after(i, 2 + j), ((*expected)[2 * i + j] - step.start(i, j)) / step.h(), 1e-11);
      }
    }
    several += step.touches().size() >= 2;
    ++compared;
  }
  EXPECT_GT(several, 20);
}

// Velocities of both free discs after a step, and their derivative by all states.
struct StepResult {
  std::vector<double> velocity;
  Eigen::MatrixXd derivative;
  size_t touches;
};
StepResult TakeStep(const std::string& model, const Scene& scene) {
  OneStep step(model, scene);
  step.Run();
  Eigen::MatrixXd A, B;
  step.Linearize(&A, &B);
  return {{step.after(0, 2), step.after(0, 3), step.after(1, 2), step.after(1, 3)}, A, step.touches().size()};
}

TEST(SpringDescent, PrimalAndDualAndNewtonSolveTheSameEquations) {
  std::mt19937_64 random(5);
  int several = 0;
  for (int i = 0; i < 48; ++i) {
    const Scene scene = Crowd(random, 0.3);
    const StepResult newton = TakeStep("primal_descent:newton=1:substeps=1", scene);
    several += newton.touches >= 2;
    for (const char* descent : {"primal_descent:substeps=1:iterations=200:alpha=0.5:implicit=0",
                                "dual_descent:substeps=1:iterations=200:alpha=0.5:implicit=0",
                                "dual_descent:substeps=1:iterations=200:alpha=0.5:gauss_seidel=1:implicit=0",
                                "primal_descent:substeps=1:iterations=2:alpha=0.5",
                                "dual_descent:substeps=1:iterations=2:alpha=0.5"}) {
      const StepResult found = TakeStep(descent, scene);
      for (int j = 0; j < 4; ++j) ASSERT_NEAR(found.velocity[j], newton.velocity[j], 1e-13) << descent << " " << i;
      ASSERT_LT((found.derivative - newton.derivative).cwiseAbs().maxCoeff(), 1e-11) << descent << " in state " << i;
    }
  }
  EXPECT_GT(several, 20);
}

// Changes added along their own normals end elsewhere where discs meet obliquely.
TEST(SpringDescent, IncrementalForcesHaveAnotherLimit) {
  std::mt19937_64 random(5);
  double largest = 0;
  for (int i = 0; i < 48; ++i) {
    const Scene scene = Crowd(random, 0.3);
    const std::string dual = "dual_descent:substeps=1:iterations=200:alpha=0.5:tolerance=1";
    const StepResult full = TakeStep(dual, scene), incremental = TakeStep(dual + ":incremental=1", scene);
    for (int j = 0; j < 4; ++j) largest = std::max(largest, std::abs(full.velocity[j] - incremental.velocity[j]));
  }
  EXPECT_GT(largest, 1e-6);
  EXPECT_LT(largest, 5e-3);
}

TEST(SpringDescent, WhatDoesNotConvergeIsSaidSo) {
  const Scene scene = ProblemScene("two_balls");
  const ModelGradient refused = ComputeGradient("primal_descent:iterations=1:implicit=0", scene, Precision::kDouble);
  EXPECT_NE(refused.reason.find("do not converge"), std::string::npos) << refused.reason;
}

// Errors of the loss and of the gradient through the iterations in the task of two balls, by their number: those of an
// independent implementation, within a factor of two.
TEST(SpringDescent, ConvergesAsFastAsStated) {
  const Scene scene = ProblemScene("two_balls");
  const auto at = [&](const std::string& options) {
    return ComputeGradient("primal_descent" + options + ":implicit=0:tolerance=1", scene, Precision::kDouble);
  };
  const ModelGradient limit = at(":newton=1");
  const double loss[] = {3e-6, 1e-9, 5e-13}, gradient[] = {1e-2, 5e-6, 2e-9};
  for (int k = 0; k < 3; ++k) {
    const ModelGradient found = at(":iterations=" + std::to_string(k + 1));
    double error = 0;
    for (size_t i = 0; i < found.gradient.initial.size(); ++i) {
      error = std::max(error, std::abs(found.gradient.initial[i] - limit.gradient.initial[i]));
    }
    EXPECT_LT(std::abs(found.loss - limit.loss), 2 * loss[k]) << k + 1;
    EXPECT_LT(error, 2 * gradient[k]) << k + 1;
    EXPECT_GT(error, 0.5 * gradient[k]) << k + 1;
  }
}

// A disc of 1 kg on the ground, at the depth at which its spring carries it, that slides at 1 m/s: friction 0.1.
struct Slide {
  double speed_at_half, place, place_by_speed;
};
Slide SlideToRest(const std::string& model) {
  Scene scene = ProblemScene("bounce_once");
  scene.gravity = {0, -9.8};
  scene.contact.friction = 0.1;
  scene.bodies[0].position = {0, scene.bodies[0].radius - 9.8 / scene.contact.stiffness};
  scene.bodies[0].velocity = {1, 0};
  scene.duration = 1.5;
  scene.steps = 720;
  scene.control = {};
  const auto simulator = MakeSimulator(model, scene, Precision::kDouble);
  std::vector<double> x(4);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, 720)));
  Slide slide;
  simulator->GetState(240, x);
  slide.speed_at_half = x[2];
  simulator->GetState(720, x);
  slide.place = x[0];
  Sensitivity sensitivity;
  simulator->Adjoint(std::vector<double>{1, 0, 0, 0}, false, &sensitivity);
  slide.place_by_speed = sensitivity.initial[2];
  return slide;
}

TEST(SpringDescent, SlidingDiscStops) {
  for (const std::string model : {"primal_descent", "dual_descent"}) {
    const Slide coarse = SlideToRest(model + ":substeps=1"), fine = SlideToRest(model);
    EXPECT_NEAR(coarse.speed_at_half, 0.51, 1e-6) << model;
    EXPECT_NEAR(coarse.place, 0.509164, 1e-6) << model;
    EXPECT_NEAR(coarse.place_by_speed, 1.0198, 1e-4) << model;
    EXPECT_NEAR(fine.speed_at_half, 0.51, 1e-6) << model;
    EXPECT_NEAR(fine.place, 0.510101, 1e-6) << model;
    EXPECT_NEAR(fine.place_by_speed, 1.0204, 1e-4) << model;
  }
}

ModelGradient Gradient(const std::string& contact, Scene scene, int steps, double stiffness = 1e4) {
  scene.steps = steps;
  scene.contact.stiffness = stiffness;
  const ModelGradient result = ComputeGradient(contact, scene, Precision::kDouble);
  EXPECT_TRUE(result.ok()) << contact << ": " << result.reason;
  return result;
}

constexpr int kPx = 0, kPy = 1, kVx = 2, kVy = 3;

TEST(PositionQpLimits, PlasticToFirstOrder) {
  const Scene strike = ProblemScene("two_balls");
  const double loss[] = {2.536937, 2.540356, 2.540698}, slope[] = {-0.607016, -0.608422, -0.608563};
  for (int i = 0; i < 3; ++i) {
    const ModelGradient at = Gradient("position_qp", strike, 480 * static_cast<int>(std::pow(10, i)));
    EXPECT_NEAR(at.loss, loss[i], 1e-6);
    for (const int entry : {kPx, kVx, 4 + kPx, 4 + kVx}) EXPECT_NEAR(at.gradient.initial[entry], slope[i], 1e-6);
  }
}

// Off centre, the derivative of normals counts.
TEST(PositionQp, ConstantNormalsAreWrongOffCentre) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[0].position += Vec2d(0, 0.05);
  const ModelGradient right = Gradient("position_qp", scene, 480);
  const ModelGradient frozen = Gradient("position_qp:normal_gradient=0", scene, 480);
  EXPECT_NEAR(right.loss, 2.535723, 1e-6);
  EXPECT_NEAR(frozen.loss, 2.535723, 1e-6);
  EXPECT_NEAR(right.gradient.initial[kPx], -1.7010, 1e-4);
  EXPECT_NEAR(right.gradient.initial[kPy], 0.5649, 1e-4);
  EXPECT_NEAR(frozen.gradient.initial[kPx], -0.8770, 1e-4);
  EXPECT_NEAR(frozen.gradient.initial[kPy], -0.3968, 1e-4);
}

// At the steps of the scene, stiff implicit springs take all of the approach: they are the projection.
TEST(SpringDescentLimits, ProjectionAsStiffnessGrows) {
  const double stiffness[] = {1e6, 1e8, 1e10, 1e12}, slope[] = {-79.9, -1.204, -0.0121, -0.0001};
  const double slope_digits[] = {0.06, 6e-4, 6e-5, 6e-5}, launch[] = {14.724, 15.277, 15.28245, 15.282499};
  const double launch_digits[] = {6e-4, 6e-4, 6e-6, 1.1e-6};
  const Scene wall = ProblemScene("ground_wall");
  for (const std::string model :
       {"primal_descent:newton=1:substeps=1:tolerance=1e-3", "dual_descent:substeps=1:iterations=200:tolerance=1e-3"}) {
    for (int i = 0; i < 4; ++i) {
      const ModelGradient bounce = Gradient(model, ProblemScene("bounce_once"), 480, stiffness[i]);
      EXPECT_NEAR(bounce.gradient.initial[kPy], slope[i], slope_digits[i]) << model << " " << stiffness[i];
      EXPECT_NEAR(Gradient(model, wall, wall.steps, stiffness[i]).loss, launch[i], launch_digits[i]) << model;
    }
    EXPECT_NEAR(Gradient(model, ProblemScene("two_balls"), 480, 1e8).loss, 2.536937, 1.1e-6) << model;
  }
}

// The models become elastic as the step goes to zero; with a force that sets in smoothly the gradient converges without
// oscillation.
TEST(SpringDescentLimits, ElasticAsTheStepGoesToZero) {
  const double linear[3][3] = {{0.849, -3.013, -1.732}, {1.103, -0.778, -0.852}, {1.133, -0.993, -0.964}};
  const double smooth[3][3] = {{0.756, -0.655, -0.583}, {1.096, -0.947, -0.925}, {1.143, -0.995, -0.977}};
  for (int i = 0; i < 3; ++i) {
    const int steps = 480 * static_cast<int>(std::pow(10, i));
    for (const bool cubic : {false, true}) {
      const ModelGradient at = Gradient(
          cubic ? "primal_descent:substeps=1:exponent=3" : "primal_descent:substeps=1", BounceOffTheGrid(), steps);
      const double* expected = cubic ? smooth[i] : linear[i];
      EXPECT_NEAR(at.loss, expected[0], 6e-4) << steps;
      EXPECT_NEAR(at.gradient.initial[kPy], expected[1], 6e-4) << steps;
      EXPECT_NEAR(at.gradient.initial[kVy], expected[2], 6e-4) << steps;
    }
  }
}

// Then, as springs stiffen, the gradient becomes the exact one: (-0.3987, -0.3213). Stiffness is that at a depth of 1
// cm.
TEST(SpringDescentLimits, ExactAsSmoothSpringsStiffen) {
  const double stiffness[] = {1e3, 1e4, 1e5, 1e6}, loss[] = {2.0951, 2.0777, 2.0732, 2.0777};
  const double first[] = {-0.4632, -0.4289, -0.4152, -0.4105}, second[] = {-0.3051, -0.3164, -0.3240, -0.3348};
  for (int i = 0; i < 4; ++i) {
    const ModelGradient at =
        Gradient("primal_descent:substeps=1:exponent=3", ProblemScene("two_balls"), 48000, stiffness[i]);
    EXPECT_NEAR(at.loss, loss[i], 6e-5);
    EXPECT_NEAR(at.gradient.initial[kPx], first[i], 6e-5);
    EXPECT_NEAR(at.gradient.initial[4 + kPx], second[i], 6e-5);
  }
}

// Full stick and no rebound: the loss has a limit, 7.161031841, and so has the derivative across the surface; along it
// the place where a disc stops does not know when it stopped (exact: 0.545233).
TEST(StaticLcpLimits, RightMotionWrongGradientAlongTheSurface) {
  const Scene scene = ProblemScene("ground_wall");
  const double loss[] = {7.116684, 7.159350}, across[] = {0.700174, 0.711615}, frozen[] = {-0.431657, -0.436917};
  for (int i = 0; i < 2; ++i) {
    const int steps = i == 0 ? scene.steps : 10 * scene.steps;
    const ModelGradient surface = Gradient("static_lcp", scene, steps);
    EXPECT_NEAR(surface.loss, loss[i], 1e-6);
    EXPECT_NEAR(surface.gradient.initial[kVx], across[i], 1e-6);
    EXPECT_NEAR(surface.gradient.initial[kVy], 0, 1e-6);
    EXPECT_NEAR(surface.gradient.initial[kPy], 0, 1e-6);
    const ModelGradient source = Gradient("static_lcp:source_anchor=1", scene, steps);
    EXPECT_NEAR(source.gradient.initial[kVy], frozen[i], 1e-6);
  }
  EXPECT_NEAR(7.161031841 - loss[0], 10 * (7.161031841 - loss[1]), 0.03);
  const ModelGradient surface = Gradient("static_lcp", BounceOffTheGrid(), 480);
  EXPECT_NEAR(surface.loss, 0.1, 1e-9);
  EXPECT_NEAR(surface.gradient.initial[kPy], 0, 1e-9);
  EXPECT_NEAR(surface.gradient.initial[kVy], 0, 1e-9);
  const ModelGradient source = Gradient("static_lcp:source_anchor=1", BounceOffTheGrid(), 480);
  EXPECT_NEAR(source.loss, 0.101, 1e-9);
  EXPECT_NEAR(source.gradient.initial[kPy], 1, 1e-9);
  EXPECT_NEAR(source.gradient.initial[kVy], 0.45, 1e-9);
}

}  // namespace
}  // namespace saltus::contact_test
