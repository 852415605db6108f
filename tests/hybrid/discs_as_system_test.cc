// Two discs, written as a user's hybrid system, against the contact model `event`.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/hybrid_solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// [p_1 v_1 p_2 v_2] of two discs of which the first is pushed, by u; p = [restitution].
struct TwoDiscs {
  std::array<double, 2> mass, gravity;
  double reach;  // sum of the radii, m

  static constexpr int kNumControls = 2;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {8};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        xdot[4 * i + j] = x[4 * i + 2 + j];
        xdot[4 * i + 2 + j] = i == 0 ? T(gravity[j] + u[j] / mass[0]) : T(gravity[j]);
      }
    }
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    using std::sqrt;
    const T dx = x[4] - x[0], dy = x[5] - x[1];
    return sqrt(dx * dx + dy * dy) - reach;
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::sqrt;
    const T dx = x[4] - x[0], dy = x[5] - x[1], distance = sqrt(dx * dx + dy * dy);
    const T n[2] = {dx / distance, dy / distance};
    const T speed = n[0] * (x[6] - x[2]) + n[1] * (x[7] - x[3]);
    const T impulse = -(1.0 + p[0]) * speed / (1.0 / mass[0] + 1.0 / mass[1]);
    for (int j = 0; j < 2; ++j) {
      x_plus[j] = x[j];
      x_plus[2 + j] = x[2 + j] - impulse / mass[0] * n[j];
      x_plus[4 + j] = x[4 + j];
      x_plus[6 + j] = x[6 + j] + impulse / mass[1] * n[j];
    }
    return 0;
  }
};

void ExpectSameMotion(const Scene& scene, int impacts) {
  const auto exact = MakeSimulator({"event"}, scene, Precision::kDouble);
  const std::vector<double> x0 = InitialState(scene), control = InitialControl(scene, exact->num_steps());
  ASSERT_TRUE(exact->Rollout(x0, control));
  std::vector<double> final_state(8), cotangent(8);
  exact->GetState(exact->num_steps(), final_state);

  HybridSimulator simulator(HybridSystem(TwoDiscs{.mass = {scene.bodies[0].mass, scene.bodies[1].mass},
                                                  .gravity = {scene.gravity[0], scene.gravity[1]},
                                                  .reach = scene.bodies[0].radius + scene.bodies[1].radius}));
  ASSERT_TRUE(simulator.Rollout({.initial = x0,
                                 .parameters = {scene.contact.restitution},
                                 .duration = scene.duration,
                                 .num_intervals = scene.steps,
                                 .control = control}));
  EXPECT_EQ(simulator.events().size(), static_cast<size_t>(impacts));
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(simulator.final_state()[i], final_state[i], 1e-12);
  for (int i = 0; i < 8; ++i) {
    std::fill(cotangent.begin(), cotangent.end(), 0.0);
    cotangent[i] = 1;
    Sensitivity expected;
    exact->Adjoint(cotangent, /*with_parameters=*/false, &expected);
    const HybridGradient gradient = simulator.Adjoint(cotangent);
    for (int j = 0; j < 8; ++j) EXPECT_NEAR(gradient.initial[j], expected.initial[j], 1e-12) << i << " by " << j;
    for (size_t j = 0; j < control.size(); ++j) EXPECT_NEAR(gradient.control[j], expected.control[j], 1e-12) << i;
  }
}

TEST(DiscsAsHybridSystem, EqualTheModelEvent) {
  Scene scene = ProblemScene("two_balls");
  ExpectSameMotion(scene, 1);
  scene.contact.restitution = 0.7;
  scene.gravity = {0.3, -1};
  scene.bodies[0].mass = 1.3;
  scene.bodies[1].velocity = {0.1, 0.2};
  scene.steps = 40;
  ExpectSameMotion(scene, 1);
}

HybridProblem ProblemOf(const Scene& scene) {
  HybridProblem problem{.system = HybridSystem(TwoDiscs{.mass = {scene.bodies[0].mass, scene.bodies[1].mass},
                                                        .gravity = {scene.gravity[0], scene.gravity[1]},
                                                        .reach = scene.bodies[0].radius + scene.bodies[1].radius}),
                        .guess = {.initial = InitialState(scene),
                                  .parameters = {scene.contact.restitution},
                                  .duration = scene.duration,
                                  .num_intervals = scene.steps,
                                  .control = InitialControl(scene, scene.steps)},
                        .terms = {MakeEffortCost(scene.objective.effort, 2)}};
  for (const TerminalTerm& term : scene.objective.terminal) {
    const int first = 4 * term.body + (term.quantity == TerminalTerm::Quantity::kPosition ? 0 : 2);
    for (int j = 0; j < 2; ++j) {
      problem.terms.push_back(MakeTerminalCost(first + j, term.target[j], term.weight, 8));
    }
  }
  problem.free.control = true;
  return problem;
}

// The optimum of task 3 (Zhong, Han, Brikis 2022) by another method, with `before` equal intervals of the control up to
// the impact at s and `after` ones from there on. All motion is along the diagonal. The least effort that brings the
// striker over the distance D to the speed w at s has forces linear in time at the middles of the intervals; w is
// eliminated from the loss, which leaves a function of s, and s is the root of its derivative.
struct DiagonalOptimum {
  double loss = 0, time = 0, speed = 0;
  std::vector<double> control, lengths;
};
DiagonalOptimum OptimumOnTheDiagonal(int before, int after) {
  using T = ceres::Jet<double, 1>;
  const double effort = 0.1, goal = std::sqrt(2.0), distance = goal - 0.4;
  T w, alpha, beta;
  const auto loss_at = [&](double time) {
    const T s(time, 0), rest = 1.0 - s;
    const T a = s * s * s / 3.0 * (1 - 0.25 / before / before), b = 0.5 * s * s, determinant = a * s - b * b;
    w = (goal * rest + effort * distance * b / determinant) / (rest * rest + effort * a / determinant);
    alpha = (s * distance - b * w) / determinant;
    beta = (a * w - b * distance) / determinant;
    const T miss = w * rest - goal;
    return T(miss * miss + effort * (alpha * distance + beta * w));
  };
  double low = 0.5, high = 0.9;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (loss_at(middle).v[0] < 0 ? low : high) = middle;
  }
  DiagonalOptimum optimum;
  optimum.time = 0.5 * (low + high);
  optimum.loss = loss_at(optimum.time).a;
  optimum.speed = w.a;
  for (int i = 0; i < before; ++i) {
    const double left = optimum.time * (1 - (i + 0.5) / before);  // from the middle of the interval to the impact
    optimum.control.insert(optimum.control.end(), 2, (beta.a + alpha.a * left) / goal);
  }
  optimum.control.resize(2 * (before + after));
  optimum.lengths.assign(before, optimum.time / before);
  optimum.lengths.resize(before + after, (1 - optimum.time) / after);
  return optimum;
}

TEST(DiscsAsHybridSystem, HaveTheOptimumOfTheModelEvent) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 40;
  const SolveReport discs = Solve("ceres_phases", {scene, "event"}, {});
  const SolveReport user = Solve("ceres_phases", ProblemOf(scene), {});
  ASSERT_EQ(discs.termination, Termination::kConverged) << discs.reason;
  ASSERT_EQ(user.termination, Termination::kConverged) << user.reason;
  EXPECT_NEAR(user.initial_loss, discs.initial_loss, 1e-12);
  ASSERT_TRUE(user.certificate);
  EXPECT_EQ(user.certificate->verdict, Certificate::Verdict::kStationary) << user.certificate->reason;
  ASSERT_EQ(user.certificate->impacts.size(), 1u);
  int before = 0;
  for (double time = 0; time < user.certificate->impacts[0].time - 1e-6; ++before) time += user.durations[before];
  const DiagonalOptimum optimum = OptimumOnTheDiagonal(before, 40 - before);
  EXPECT_NEAR(user.final_loss, optimum.loss, 1e-12);
  EXPECT_NEAR(discs.final_loss, optimum.loss, 1e-11);                  // Ceres stops 5e-12 above it
  EXPECT_NEAR(user.certificate->impacts[0].time, optimum.time, 1e-7);  // where the loss is flat
  // In continuous time, to which it converges by order 2.
  EXPECT_NEAR(OptimumOnTheDiagonal(100000, 1).loss, 1.396542160123197291194, 1e-10);
}

TEST(DiscsAsHybridSystem, HaveTheCertificateOfTheModelEvent) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 40;
  const HybridProblem problem = ProblemOf(scene);
  const DiagonalOptimum optimum = OptimumOnTheDiagonal(27, 13);
  const Certificate expected = Certify(scene, InitialState(scene), optimum.control, optimum.lengths);
  HybridInput input = problem.guess;
  input.control = optimum.control;
  input.lengths = optimum.lengths;
  const Certificate found = Certify(problem, input);
  EXPECT_EQ(expected.verdict, Certificate::Verdict::kStationary) << expected.reason;
  EXPECT_EQ(found.verdict, Certificate::Verdict::kStationary) << found.reason;
  ASSERT_EQ(expected.impacts.size(), 1u);
  ASSERT_EQ(found.impacts.size(), 1u);
  EXPECT_NEAR(found.impacts[0].time, optimum.time, 1e-12);
  EXPECT_NEAR(found.impacts[0].speed, optimum.speed, 1e-12);
  EXPECT_NEAR(expected.impacts[0].speed, optimum.speed, 1e-12);
  EXPECT_NEAR(found.impacts[0].multiplier, expected.impacts[0].multiplier, 1e-12);
  EXPECT_TRUE(found.impacts[0].on_node && expected.impacts[0].on_node);
  EXPECT_LT(std::max(found.stationarity, expected.stationarity), 1e-12);
  EXPECT_LT(std::max(std::abs(found.hamiltonian), std::abs(expected.hamiltonian)), 1e-12);
  // The curvatures are along intervals that all move with the impact, and of discs along those of which the last one
  // does.
  ASSERT_TRUE(found.curvature && expected.curvature);
  EXPECT_EQ(found.curvature->kind, Curvature::Kind::kMinimum);
  EXPECT_EQ(expected.curvature->kind, Curvature::Kind::kMinimum);
  EXPECT_NEAR(found.curvature->smallest, expected.curvature->smallest, 0.02);

  // A force that is off by a thousandth is not stationary in either.
  input.control[7] *= 1.001;
  EXPECT_EQ(Certify(problem, input).verdict, Certificate::Verdict::kNotStationary);
  EXPECT_EQ(Certify(scene, InitialState(scene), input.control, optimum.lengths).verdict,
            Certificate::Verdict::kNotStationary);
}

}  // namespace
}  // namespace saltus
