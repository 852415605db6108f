// Scenes as problems of hybrid systems, against the contact model `event` and solvers of discs.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "control/hybrid_shooting.h"
#include "control/pushed_scenes.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/scene_problem.h"
#include "saltus/control/single_shooting.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/hybrid_solver.h"
#include "scene/control_problems.h"
#include "test_scenes.h"

namespace saltus {
namespace {

Scene With(Scene scene, int steps) {
  scene.steps = steps;
  return scene;
}

Scene TwoBallsThatLoseEnergy() {
  Scene scene = With(ProblemScene("two_balls"), 40);
  scene.contact.restitution = 0.7;
  scene.gravity = {0.3, -1};
  scene.bodies[0].mass = 1.3;
  scene.bodies[1].velocity = {0.1, 0.2};
  return scene;
}

// With a price of the final time, waypoints of both discs, of which two are at one time, and running terms whose
// targets turn.
Scene WithPathCosts(Scene scene) {
  scene.objective.duration = FreeDuration{.min = 0.5, .max = 2, .weight = 0.7};
  scene.objective.via = {
      {.body = 0, .time = 0.33, .target = {0.5, 0.2}, .weight = 2},
      {.body = 1, .time = 0.33, .target = {0.4, 0.1}, .weight = 0.5},
      {.body = 1, .time = 0.62, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.1, -1}, .weight = 0.4}};
  return WithRunningTerms(scene);
}

struct SceneCase {
  const char* name;
  Scene scene;
  size_t impacts;
};
void PrintTo(const SceneCase& item, std::ostream* out) { *out << item.name; }

class SceneAsHybridProblem : public testing::TestWithParam<SceneCase> {};

// The exact run of the model `event` is another simulation, from event to event of each pair, with losses in closed
// form.
TEST_P(SceneAsHybridProblem, HasTheLossAndTheGradientOfTheModelEvent) {
  const Scene& scene = GetParam().scene;
  ASSERT_EQ(UnsupportedByHybridProblem(scene), "");
  const HybridProblem problem = MakeHybridProblem(scene);
  ASSERT_EQ(Validate(problem), "");
  HybridShooting hybrid(problem);
  std::vector<double> z = hybrid.initial_guess();
  const size_t steered = z.size() - problem.free.duration;
  for (size_t i = 0; i < steered; ++i) z[i] += 0.02 * std::sin(1.7 * static_cast<double>(i) + 0.3);
  const auto exact_loss = [&](const std::vector<double>& at) {
    Scene moved = scene;
    if (problem.free.duration) moved.duration = at.back();
    std::vector<double> initial = hybrid.InitialStateAt(at);
    initial.resize(InitialState(scene).size());
    const ExactRun run = SimulateExactly(moved, initial, hybrid.ControlAt(at));
    EXPECT_EQ(run.contacts.size(), GetParam().impacts);
    return run.loss;
  };
  double loss = 0;
  std::vector<double> gradient(z.size());
  ASSERT_TRUE(hybrid.Evaluate(z, &loss, gradient.data())) << hybrid.FailureReason();
  EXPECT_NEAR(loss, exact_loss(z), 1e-11 * std::max(1.0, std::abs(loss)));
  double largest = 0;
  for (const double by : gradient) largest = std::max(largest, std::abs(by));
  for (size_t i = 0; i < z.size(); i += 1 + z.size() / 12) {
    const auto slope = [&](double width) {
      std::vector<double> above = z, below = z;
      above[i] += width;
      below[i] -= width;
      return (exact_loss(above) - exact_loss(below)) / (2 * width);
    };
    EXPECT_NEAR(gradient[i], (4 * slope(1e-3) - slope(2e-3)) / 3, 1e-7 * largest) << i;
  }
  if (problem.free.duration) {
    std::vector<double> above = z, below = z;
    above.back() += 1e-4;
    below.back() -= 1e-4;
    EXPECT_NEAR(gradient.back(), (exact_loss(above) - exact_loss(below)) / 2e-4, 1e-6 * largest);
  }
  // The adjoint of the model, where it has one: not for waypoints of discs that spin.
  SingleShooting discs(MakeSimulator("event", scene, Precision::kDouble));
  std::vector<double> by(steered);
  if (!discs.Evaluate(std::span(z).first(steered), &loss, by.data())) return;
  for (size_t i = 0; i < steered; ++i) EXPECT_NEAR(gradient[i], by[i], 1e-10 * largest) << i;
}

// Each part moves as it does in the whole state, where its motion depends on no other part.
TEST_P(SceneAsHybridProblem, HasPartsThatMoveAsInTheWholeState) {
  const HybridProblem problem = MakeHybridProblem(GetParam().scene);
  const HybridFunctions& functions = problem.system.functions();
  const std::vector<StatePart> parts = functions.Parts(0);
  const int n = functions.state_size(0), m = functions.layout().num_controls, columns = n + 1 + m;
  if (parts.size() == 1) {  // all that moves
    EXPECT_EQ(static_cast<int>(parts[0].states.size()), n);
    EXPECT_EQ(static_cast<int>(parts[0].controls.size()), m);
    return;
  }
  std::vector<double> x(n), u(m), after(n), jacobian(n * columns), slope(n);
  for (int i = 0; i < n; ++i) x[i] = problem.guess.initial[i] + 0.1 * std::cos(i);
  for (int i = 0; i < m; ++i) u[i] = std::sin(1 + i);
  const FlowStep step{{0, 0.2, x.data(), u.data(), nullptr}, 0.3};
  ASSERT_TRUE(functions.Fly(step, after.data(), jacobian.data()));
  functions.Flow({0, 0.5, after.data(), u.data(), nullptr}, slope.data());
  std::vector<int> times_seen(n + m);
  for (int k = 0; k < static_cast<int>(parts.size()); ++k) {
    std::vector<int> inputs = parts[k].states;
    const int of_part = static_cast<int>(inputs.size());
    std::vector<double> own_x, own_u;
    for (const int i : parts[k].states) own_x.push_back(x[i]);
    for (const int i : parts[k].controls) own_u.push_back(u[i]);
    inputs.push_back(n);
    for (const int i : parts[k].controls) inputs.push_back(n + 1 + i);
    for (const int i : inputs) times_seen[i < n ? i : i - 1] += i != n;
    const int width = static_cast<int>(inputs.size()) + 1;
    std::vector<double> own_after = own_x, own_jacobian(of_part * width);
    for (int i = 0; i < of_part; ++i) own_jacobian[i * width + i] = 1;
    const FlowStep own{{0, 0.2, own_x.data(), own_u.data(), nullptr}, 0.3};
    if (parts[k].motion != StatePart::Motion::kRests) {
      functions.MovePart(k, own, own_after.data(), own_jacobian.data());
    }
    EXPECT_EQ(parts[k].motion == StatePart::Motion::kSteps, !parts[k].controls.empty());
    for (int i = 0; i < of_part; ++i) {
      const double* row = &jacobian[parts[k].states[i] * columns];
      EXPECT_DOUBLE_EQ(own_after[i], after[parts[k].states[i]]);
      EXPECT_DOUBLE_EQ(own_jacobian[i * width + width - 1], slope[parts[k].states[i]]);
      for (int j = 0; j < columns; ++j) {
        const auto place = std::ranges::find(inputs, j);
        const double expected = place == inputs.end() ? 0 : own_jacobian[i * width + (place - inputs.begin())];
        EXPECT_DOUBLE_EQ(row[j], expected) << k << " " << i << " " << j;
      }
    }
  }
  EXPECT_EQ(times_seen, std::vector<int>(n + m, 1));
}

// Returns a point of the problem beside the guess, with places for its numbers.
struct PlacedPoint {
  std::vector<double> x, u;
  ModePoint at;
};
PlacedPoint PointBeside(const Scene& scene, const HybridProblem& problem, int seed) {
  PlacedPoint point{problem.guess.initial, std::vector<double>(problem.system.num_controls()), {}};
  for (size_t i = 0; i < point.x.size(); ++i) {
    const bool is_fixed = i < 4 * scene.bodies.size() && scene.bodies[i / 4].fixed;
    if (!is_fixed) point.x[i] += 0.3 * std::cos(static_cast<double>(7 * i) + seed);
  }
  for (size_t i = 0; i < point.u.size(); ++i) point.u[i] = 3 * std::sin(static_cast<double>(5 * i) + seed);
  point.at = {0, 0.2, point.x.data(), point.u.data(), nullptr};
  return point;
}

// The closed form of the least gap within a step is the least of many on the way, and what is found from the rates of
// the guard; its derivative is that of differences where the time of the least gap does not jump.
TEST_P(SceneAsHybridProblem, KnowsWherePairsComeNearestInAStep) {
  Scene scene = GetParam().scene;
  scene.objective.running.clear();
  const HybridProblem problem = MakeHybridProblem(scene);
  const HybridFunctions& functions = problem.system.functions();
  const int n = functions.state_size(0), m = functions.layout().num_controls;
  const int pairs = static_cast<int>(AllPairs(scene).size());
  int inside = 0;
  for (int seed = 0; seed < 12; ++seed) {
    PlacedPoint point = PointBeside(scene, problem, seed);
    for (int guard = 0; guard < pairs; ++guard) {
      FlowStep step{point.at, 0.1 + 0.04 * seed};  // of one dip: of several, one is found
      double least = 0, other = 0;
      std::vector<double> gradient(n + 2 + m), after(n);
      ASSERT_TRUE(functions.LeastGuard(step, guard, &least, gradient.data()));
      ASSERT_TRUE(functions.HybridFunctions::LeastGuard(step, guard, &other, nullptr));
      constexpr int kSamples = 2000;
      double seen = INFINITY;
      int nearest = 0;
      for (int k = 0; k <= kSamples; ++k) {
        FlowStep way = step;
        way.h = step.h * k / kSamples;
        ASSERT_TRUE(functions.Fly(way, after.data(), nullptr));
        const double gap = functions.Guard({0, step.t + way.h, after.data(), point.u.data(), nullptr}, guard);
        if (gap < seen) nearest = k;
        seen = std::min(seen, gap);
      }
      EXPECT_LE(least, seen + 1e-12);
      EXPECT_NEAR(least, seen, 2e-4);
      EXPECT_LE(least, other + 1e-9);  // one of two dips is found from the rates
      inside += nearest > 0 && nearest < kSamples;
      const auto difference = [&](double* number, double width) {
        const double before = *number;
        double above = 0, below = 0;
        *number = before + width;
        EXPECT_TRUE(functions.LeastGuard(step, guard, &above, nullptr));
        *number = before - width;
        EXPECT_TRUE(functions.LeastGuard(step, guard, &below, nullptr));
        *number = before;
        return (above - below) / (2 * width);
      };
      const auto slope = [&](double* number) { return (4 * difference(number, 1e-4) - difference(number, 2e-4)) / 3; };
      for (int i = 0; i < n; ++i) {
        const bool moves = i >= 4 * scene.num_bodies() || i % 4 < 2 || !scene.bodies[i / 4].fixed;
        if (moves) {
          EXPECT_NEAR(gradient[i], slope(&point.x[i]), 1e-6) << i;
        }
      }
      for (int i = 0; i < m; ++i) EXPECT_NEAR(gradient[n + 1 + i], slope(&point.u[i]), 1e-6) << i;
      EXPECT_NEAR(gradient[n], slope(&step.t), 1e-6);
      EXPECT_NEAR(gradient[n + 1 + m], slope(&step.h), 1e-6);
    }
  }
  if (scene.num_bodies() > 1) {
    EXPECT_GT(inside, 0);
  }
}

// An event is one of discs that approach each other. In its regime an impact slips or sticks whatever Coulomb's law
// says, and the row of a regime says whether the law does.
TEST_P(SceneAsHybridProblem, KnowsWhatItsEventsRequire) {
  const Scene& scene = GetParam().scene;
  const HybridProblem problem = MakeHybridProblem(scene);
  const HybridFunctions& functions = problem.system.functions();
  const int n = functions.state_size(0);
  const ContactSequence pairs = AllPairs(scene);
  int slips = 0, sticks = 0;
  for (int seed = 0; seed < 12; ++seed) {
    PlacedPoint point = PointBeside(scene, problem, seed);
    for (int guard = 0; guard < static_cast<int>(pairs.size()); ++guard) {
      ASSERT_EQ(functions.num_event_rows(0, guard), 1);
      std::vector<double> slope(n);
      functions.Flow(point.at, slope.data());
      double approach = 0, rate = 0;
      functions.EventRows(point.at, guard, &approach, nullptr);
      functions.GuardRate(point.at, guard, slope.data(), &rate);
      EXPECT_NEAR(approach, rate, 1e-12);
      if (!(scene.contact.friction > 0)) continue;
      std::vector<double> expected(n), slipped(n), stuck(n);
      const auto slip = functions.RegimeOf(static_cast<int>(ContactMode::kSlip));
      const auto stick = functions.RegimeOf(static_cast<int>(ContactMode::kStick));
      functions.Reset(point.at, guard, expected.data());
      slip->Reset(point.at, guard, slipped.data());
      stick->Reset(point.at, guard, stuck.data());
      double of_slip[2], of_stick[2];
      std::vector<double> by_slip(2 * (n + 1)), by_stick(2 * (n + 1));
      slip->EventRows(point.at, guard, of_slip, by_slip.data());
      stick->EventRows(point.at, guard, of_stick, by_stick.data());
      EXPECT_EQ(of_slip[0], approach);
      EXPECT_DOUBLE_EQ(of_slip[1], -of_stick[1]);
      const bool is_slip = of_slip[1] <= 0;
      ++(is_slip ? slips : sticks);
      if (approach < 0) {
        EXPECT_EQ(expected, is_slip ? slipped : stuck);
        EXPECT_NE(slipped, stuck);
      }
      for (int i = 0; i < n; ++i) {
        const double before = point.x[i], width = 1e-5;
        double above[2], below[2];
        point.x[i] = before + width;
        stick->EventRows(point.at, guard, above, nullptr);
        point.x[i] = before - width;
        stick->EventRows(point.at, guard, below, nullptr);
        point.x[i] = before;
        for (int row = 0; row < 2; ++row) {
          const double by = (above[row] - below[row]) / (2 * width);
          EXPECT_NEAR(by_stick[row * (n + 1) + i], by, 1e-6 * std::max(1.0, std::abs(by))) << row << " " << i;
        }
        EXPECT_DOUBLE_EQ(by_slip[n + 1 + i], -by_stick[n + 1 + i]);
      }
    }
  }
  if (scene.contact.friction > 0) {
    EXPECT_GT(slips + sticks, 10);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, SceneAsHybridProblem,
    testing::Values(SceneCase{"two_balls", With(ProblemScene("two_balls"), 40), 1},
                    SceneCase{"two_balls_480", ProblemScene("two_balls"), 1},
                    SceneCase{"two_balls_lose_energy", TwoBallsThatLoseEnergy(), 1},
                    SceneCase{"single_collision", With(ProblemScene("single_collision"), 25), 1},
                    SceneCase{"multiple_collisions", With(ProblemScene("multiple_collisions"), 25), 3},
                    SceneCase{"ground_wall", ProblemScene("ground_wall"), 2},
                    SceneCase{"head_on", With(HeadOn(), 23), 1}, SceneCase{"two_pushed", TwoPushed(), 2},
                    SceneCase{"spin_slips", TwoSpin(0.05), 2}, SceneCase{"spin_sticks", TwoSpin(2), 2},
                    SceneCase{"strike_sticks", SpinStrike(2), 1},
                    SceneCase{"torques_slip", WithTorques(TwoSpin(0.05)), 2},
                    SceneCase{"torques_stick", WithTorques(TwoSpin(2)), 2},
                    SceneCase{"path_costs", WithPathCosts(TwoPushed()), 2},
                    SceneCase{"torques_path_costs", WithTorques(WithPathCosts(TwoSpin(2))), 2}),
    [](const auto& at) { return at.param.name; });

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
  const SolveReport user = Solve("ceres_phases", MakeHybridProblem(scene), {});
  ASSERT_EQ(discs.termination, Termination::kConverged) << discs.reason;
  ASSERT_EQ(user.termination, Termination::kConverged) << user.reason;
  EXPECT_NEAR(user.guess.loss, discs.guess.loss, 1e-12);
  EXPECT_LE(user.work.iterations, 30);
  ASSERT_TRUE(user.certificate);
  EXPECT_EQ(user.certificate->verdict, Certificate::Verdict::kStationary) << user.certificate->reason;
  ASSERT_EQ(user.certificate->impacts.size(), 1u);
  int before = 0;
  for (double time = 0; time < user.certificate->impacts[0].time - 1e-6; ++before) {
    time += user.solution.durations[before];
  }
  const DiagonalOptimum optimum = OptimumOnTheDiagonal(before, 40 - before);
  EXPECT_NEAR(user.solution.loss, optimum.loss, 1e-12);
  EXPECT_NEAR(discs.solution.loss, optimum.loss, 1e-11);               // Ceres stops 5e-12 above it
  EXPECT_NEAR(user.certificate->impacts[0].time, optimum.time, 1e-7);  // where the loss is flat
  // In continuous time, to which it converges by order 2.
  EXPECT_NEAR(OptimumOnTheDiagonal(100000, 1).loss, 1.396542160123197291194, 1e-10);
}

TEST(DiscsAsHybridSystem, HaveTheCertificateOfTheModelEvent) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 40;
  const HybridProblem problem = MakeHybridProblem(scene);
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

TEST(DiscsAsHybridSystem, HaveNoMotionBehindATouchThatIsForbidden) {
  for (const NoContact apart : {NoContact{0, 1}, NoContact{1, 0}}) {
    Scene scene = With(ProblemScene("two_balls"), 24);
    scene.no_contact = {apart};
    HybridShooting hybrid(MakeHybridProblem(scene));
    double loss = 0;
    EXPECT_FALSE(hybrid.Evaluate(hybrid.initial_guess(), &loss, nullptr));
    EXPECT_NE(hybrid.FailureReason().find("striker-target touch, which must not (no_contact)"), std::string::npos)
        << hybrid.FailureReason();
  }
}

// A goal region, and a limit of the speed there: both are active at the optimum.
TEST(DiscsAsHybridSystem, HaveGoalRegions) {
  Scene scene = With(ProblemScene("two_balls"), 24);
  constexpr double kMost = 1.2;
  TerminalTerm goal{.body = 1, .hard = true};
  goal.region = TerminalTerm::Region{.min = {-0.3, -0.2}, .max = {0.1, 0.1}};
  scene.objective.terminal = {goal};
  scene.objective.limits = {{.body = 1, .max = kMost, .at = SpeedLimit::Timing::kEnd}};
  scene.duration = 1.5;
  const SolveReport discs = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(discs.termination, Termination::kConverged) << discs.reason;
  // The conditions of both are those of one optimum.
  const HybridProblem problem = MakeHybridProblem(scene);
  HybridInput input = problem.guess;
  input.control = discs.solution.control;
  input.lengths = discs.solution.durations;
  HybridShooting hybrid(problem);
  HybridShooting::Outcome outcome;
  ASSERT_TRUE(hybrid.Simulate(input, &outcome)) << hybrid.FailureReason();
  EXPECT_NEAR(outcome.loss, discs.solution.loss, 1e-11);
  EXPECT_LT(outcome.violation, 1e-8);
  const Certificate found = Certify(problem, input);
  EXPECT_TRUE(found.IsStationary()) << found.reason;
  const SolveReport user = Solve("ceres_phases", problem, {});
  EXPECT_EQ(user.termination, Termination::kConverged) << user.reason;
  scene.objective.limits[0].at = SpeedLimit::Timing::kAlways;
  EXPECT_EQ(UnsupportedByHybridProblem(scene), "");
}

// The guess has no impact, and the best motion without one just touches the ground: the solve goes on with an impact.
// The reference is the solver of closed arcs along that impact.
TEST(DiscsAsHybridSystem, GoOnThroughATouch) {
  Scene scene = ControlProblem(97);
  scene.steps = 60;
  const SolveReport arcs =
      Solve("ceres_event", {scene, "event"}, {.sequences = {.given = ContactSequence{{0, 0, true}}}});
  ASSERT_EQ(arcs.termination, Termination::kConverged) << arcs.reason;
  const SolveReport user = Solve("ceres_phases", MakeHybridProblem(scene), {});
  EXPECT_EQ(user.termination, Termination::kConverged) << user.reason;
  EXPECT_NEAR(user.solution.loss, arcs.solution.loss, 1e-4 * arcs.solution.loss);  // with other shares of the intervals
  ASSERT_TRUE(user.certificate);
  EXPECT_EQ(user.certificate->verdict, Certificate::Verdict::kStationary) << user.certificate->reason;
  EXPECT_EQ(user.certificate->impacts.size(), 1u);
}

// The pushed disc cannot reach the other, which misses its target: no force is the optimum, and what a solver leaves of
// it has terms that do not cancel.
TEST(DiscsAsHybridSystem, HaveAnOptimumWithoutForces) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 20;
  scene.bodies[1].position = {50, 50};
  scene.objective.terminal[0].target = {50, 51};
  const SolveReport discs = Solve("ceres_phases", {scene, "event"}, {});
  const SolveReport user = Solve("ceres_phases", MakeHybridProblem(scene), {});
  EXPECT_EQ(user.termination, Termination::kConverged) << user.reason;
  EXPECT_NEAR(user.solution.loss, discs.solution.loss, 1e-12);
  HybridInput input = MakeHybridProblem(scene).guess;
  for (const double size : {0.0, 1e-12, 1e-9}) {
    for (size_t i = 0; i < input.control.size(); ++i) {
      input.control[i] = size * std::sin(1.7 * static_cast<double>(i));
    }
    const Certificate found = Certify(MakeHybridProblem(scene), input);
    EXPECT_EQ(found.verdict, Certificate::Verdict::kStationary) << size << " " << found.reason;
    ASSERT_TRUE(found.curvature) << size;
    EXPECT_EQ(found.curvature->kind, Curvature::Kind::kMinimum) << size;
  }
  // A force that matters is none, however small it is beside the loss.
  std::ranges::fill(input.control, 1e-3);
  EXPECT_EQ(Certify(MakeHybridProblem(scene), input).verdict, Certificate::Verdict::kNotStationary);
  // Nor is no force where it would change the loss.
  scene.bodies[1].position = {-1, -1};
  scene.objective.terminal[0].body = 0;
  std::ranges::fill(input.control, 0);
  input.initial = InitialState(scene);
  EXPECT_EQ(Certify(MakeHybridProblem(scene), input).verdict, Certificate::Verdict::kNotStationary);
}

}  // namespace
}  // namespace saltus
