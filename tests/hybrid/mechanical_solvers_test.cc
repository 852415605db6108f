// Optima of mechanical systems with contacts. A pendulum that swings up and may use an elastic wall, against optima
// that were computed in 60 digits by Newton's method on exact derivatives; motions with contacts that stay closed.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>
#include <random>
#include <vector>

#include "control/hybrid_shooting.h"
#include "hybrid/mechanical_problems.h"
#include "problems/hybrid_systems.h"
#include "reference_values.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// On a grid of 40 intervals, the best control that is known strikes where it switches for the ninth time: a kink.
TEST(WallSwingUp, BestControlOnTheGridIsAtAKink) {
  const nlohmann::json& reference = ReferenceFile("mechanical_references.json").at("P12").at("pinned");
  HybridProblem problem = WallSwingUpProblem();
  for (int k = 0; k < 40; ++k) problem.guess.control[k] = Number(reference["u"][k]);
  const SolveReport report = Solve("gd", problem, {.limits = {.iterations = 0}});
  EXPECT_NEAR(report.solution.loss, Number(reference["J"]), 1e-11);
  EXPECT_THAT(report.reason, HasSubstr("guard 'hit wall' has an event at t = 0.36, where the control jumps"));
  HybridSimulator simulator(problem.system, {.tolerance = 1e-14});
  ASSERT_TRUE(simulator.Rollout(problem.guess)) << simulator.FailureReason();
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_NEAR(simulator.events()[0].time, 0.36, 1e-13);
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(simulator.events()[0].before[i], Number(reference["x_impact"][i]), 1e-12) << i;
    EXPECT_NEAR(simulator.final_state()[i], Number(reference["xT"][i]), 1e-12) << i;
  }
}

// The control may switch with the impact, whenever that is, so the optimum is no kink of the loss.
TEST(WallSwingUp, OptimumHasACertificate) {
  for (const char* solver : {"ceres_phases", "mode_search"}) {
    const SolveReport report = Solve(solver, WallSwingUpProblem(), {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LT(report.solution.loss, 1.2940262535645843948) << solver;
    EXPECT_GT(report.solution.loss, 1.29) << solver;
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
    ASSERT_EQ(report.certificate->impacts.size(), 1u);
    EXPECT_EQ(report.certificate->impacts[0].b, "hit wall");
  }
}

// On the grid, where optima sit on kinks, single shooting ends near one of them.
TEST(WallSwingUp, ShootingEndsAtAKinkAndSaysSo) {
  const SolveReport report = Solve("ceres_lbfgs", WallSwingUpProblem(), {.limits = {.iterations = 2000}});
  EXPECT_LT(report.solution.loss, 1.4861) << "the best that is known without an impact";
  EXPECT_THAT(report.reason, HasSubstr("where the control jumps"));
}

// While the mass slides, x(T) is linear in the control, which pulls up as well to lessen the friction.
TEST(ClosedContacts, OptimumOfASlidingMassIsThatOfItsLinearProblem) {
  constexpr int kIntervals = 10;
  constexpr double kFriction = 0.5, kDuration = 1, kSpeed = 2, kTarget = 1.5, kWeight = 40, kEffort = 0.1,
                   kGravity = 9.81;
  const MechanicalSystem system{PulledMass()};
  HybridProblem problem{.system = system.hybrid(),
                        .guess = {.mode = system.Mode("+"),
                                  .initial = {0, 0, kSpeed, 0},
                                  .parameters = {kFriction, kGravity},
                                  .duration = kDuration,
                                  .num_intervals = kIntervals},
                        .terms = {MakeTerminalCost(0, kTarget, kWeight, 4), MakeEffortCost(kEffort, 2)}};
  for (int k = 0; k < kIntervals; ++k) problem.guess.control.insert(problem.guess.control.end(), {3.5, 0.5});
  problem.free.control = true;
  // x(T) = free + sum_k a_k (u_x + mu u_y): u_x = s a_k, u_y = s mu a_k.
  const double h = kDuration / kIntervals, with_lift = 1 + kFriction * kFriction;
  const double free = kSpeed * kDuration - 0.5 * kFriction * kGravity * kDuration * kDuration;
  double squares = 0;
  for (int k = 0; k < kIntervals; ++k) squares += std::pow(h * (kDuration - (k + 0.5) * h), 2);
  const double s = kWeight * (kTarget - free) / (kEffort * h + kWeight * with_lift * squares);
  const double missed = kTarget - free - s * with_lift * squares;
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kWeight * missed * missed + kEffort * h * with_lift * s * s * squares, 1e-8);
  for (int k = 0; k < kIntervals; ++k) {
    const double along = s * h * (kDuration - (k + 0.5) * h);
    EXPECT_NEAR(report.solution.control[2 * k], along, 1e-5) << k;
    EXPECT_NEAR(report.solution.control[2 * k + 1], kFriction * along, 1e-5) << k;
  }
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  ASSERT_TRUE(report.certificate->curvature);
  EXPECT_NEAR(report.certificate->curvature->smallest, 1, 1e-6) << "of directions that do not change x(T)";
}

// Two masses on a line without friction, of which a force moves the second only: the first moves where the second
// strikes it.
struct TwoMasses {
  static constexpr int kNumCoordinates = 2, kNumControls = 1, kNumParameters = 1, kNumContacts = 1;
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(1.0);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* h) const {
    h[0] = T(0.0);
    h[1] = u[0];
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[1] - q[0] - 2.0;
  }
  template <typename T>
  T Slide(int, const T*, const T*) const {
    return T(0.0);
  }
  template <typename T>
  T Friction(int, const T*) const {
    return T(0.0);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }
};

// From a guess without an impact no small force moves the first mass towards its target: no solver that changes the
// force by little has found an optimum there. A search finds that of a guess with the impact.
TEST(ClosedContacts, AMassThatNothingTouchesIsReachedByASearch) {
  constexpr int kIntervals = 10;
  const MechanicalSystem system{TwoMasses()};
  HybridProblem problem{.system = system.hybrid(),
                        .guess = {.initial = {-3, 0, 0, 0},
                                  .parameters = {0.5},
                                  .duration = 3,
                                  .num_intervals = kIntervals,
                                  .control = std::vector<double>(kIntervals, 0.0)},
                        .terms = {MakeTerminalCost(0, -6.0, 10.0, 4),
                                  MakeTerminalCost(1, 0.0, 10.0, 4),
                                  MakeTerminalCost(3, 0.0, 1.0, 4),
                                  MakeEffortCost(0.1, 1)}};
  problem.guess.mode = system.FindMode(problem.guess.initial, std::vector<double>{0}, problem.guess.parameters).mode;
  problem.free = {.control = true, .control_min = {-30}, .control_max = {30}};
  for (const char* solver : {"ceres_lm", "ceres_phases", "ipopt"}) {
    const SolveReport stays = Solve(solver, problem, {});
    if (stays.termination == Termination::kNotApplicable) continue;  // built without IPOPT
    EXPECT_EQ(stays.termination, Termination::kNoProgress) << solver;
    EXPECT_THAT(stays.reason, HasSubstr("but no small change of the control changes x[0] at the end")) << solver;
    EXPECT_THAT(stays.reason, HasSubstr("mode_search")) << solver;
  }
  const SolveReport found = Solve("auto", problem, {.sequences = {.limits = {.work = 2e5, .starts = 4}}});
  ASSERT_EQ(found.termination, Termination::kConverged) << found.reason;
  for (int k = 0; k < kIntervals; ++k) problem.guess.control[k] = k < 3 ? -10 : k < 6 ? 10 : 0;
  const SolveReport touching = Solve("ceres_phases", problem, {});
  ASSERT_EQ(touching.termination, Termination::kConverged) << touching.reason;
  EXPECT_LE(found.solution.loss, (1 + 1e-9) * touching.solution.loss);
  EXPECT_LT(found.solution.loss, 0.2 * found.guess.loss);
}

// A mass at rest, which no small force moves: a search pulls it, and reaches the optimum of a mass that slides all
// along.
TEST(ClosedContacts, AMassThatSticksIsPulledByASearch) {
  constexpr int kIntervals = 10;
  constexpr double kFriction = 0.5, kTarget = 1.5, kWeight = 40, kEffort = 0.1, kGravity = 9.81;
  const MechanicalSystem system{PulledMass()};
  HybridProblem problem{.system = system.hybrid(),
                        .guess = {.initial = {0, 0, 0, 0},
                                  .parameters = {kFriction, kGravity},
                                  .duration = 1,
                                  .num_intervals = kIntervals},
                        .terms = {MakeTerminalCost(0, kTarget, kWeight, 4), MakeEffortCost(kEffort, 2)}};
  problem.guess.control.assign(2 * kIntervals, 0.0);
  problem.guess.mode = system.FindMode(problem.guess.initial, std::vector<double>{0, 0}, problem.guess.parameters).mode;
  problem.free.control = true;
  const SolveReport stuck = Solve("ceres_lm", problem, {});
  EXPECT_EQ(stuck.termination, Termination::kNoProgress);
  EXPECT_THAT(stuck.reason, HasSubstr("no small change of the control changes the motion"));
  EXPECT_THAT(stuck.reason, HasSubstr("mode_search"));
  // The loss of the linear problem of a mass that slides, as above, from rest.
  const double h = 1.0 / kIntervals, with_lift = 1 + kFriction * kFriction, free = -0.5 * kFriction * kGravity;
  double squares = 0;
  for (int k = 0; k < kIntervals; ++k) squares += std::pow(h * (1 - (k + 0.5) * h), 2);
  const double s = kWeight * (kTarget - free) / (kEffort * h + kWeight * with_lift * squares);
  const double missed = kTarget - free - s * with_lift * squares;
  const double sliding = kWeight * missed * missed + kEffort * h * with_lift * s * s * squares;
  const SolveReport report = Solve("auto", problem, {.sequences = {.limits = {.work = 2e5, .starts = 2}}});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solver, "mode_search") << report.reason;
  EXPECT_THAT(report.reason, Not(HasSubstr("tried"))) << "solvers that begin at the guess would stay there";
  // The mass sticks for a little while before it is pulled, as a phase before the control jumps has a length.
  EXPECT_LT(report.solution.loss, 1.003 * sliding);
}

// A mass on rough ground, with a smooth wall far to the right.
struct MassBeforeAWall : PulledMass {
  static constexpr int kNumContacts = 2;
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return contact == 0 ? q[1] : T(100.0 - q[0]);
  }
  template <typename T>
  T Slide(int contact, const T* q, const T*) const {
    return q[contact];
  }
  template <typename T>
  T Friction(int contact, const T* p) const {
    return contact == 0 ? p[0] : T(0.0);
  }
};

// The optimum begins with a jump of the control, which is the event of no guard.
TEST(ClosedContacts, OptimaBesideAContactWithoutFrictionNameTheirEvents) {
  const MechanicalSystem system{MassBeforeAWall()};
  const HybridProblem problem{.system = system.hybrid(),
                              .guess = {.mode = system.Mode("so"),
                                        .initial = {0, 0, 0, 0},
                                        .parameters = {0.5, 9.81},
                                        .duration = 1,
                                        .num_intervals = 4,
                                        .control = {0, 0, 8, 0, 8, 0, 8, 0}},
                              .terms = {MakeTerminalCost(0, 1.5, 40, 4), MakeEffortCost(0.1, 2)},
                              .free = {.control = true}};
  const SolveReport report = Solve("mode_search", problem, {.sequences = {.limits = {.work = 2e5, .starts = 2}}});
  ASSERT_FALSE(report.optima.empty()) << report.reason;
  const ContactSequence& best = report.optima[0].sequence;
  ASSERT_FALSE(best.empty()) << report.reason;
  EXPECT_EQ(problem.system.ModeName(best[0].a), "so");
  EXPECT_EQ(best[0].b, -1);
}

// Two carts on the ground, of which the second is pushed, hits the first and comes back.
struct Carts {
  static constexpr int kNumCoordinates = 4, kNumControls = 1, kNumParameters = 1, kNumContacts = 3;
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    for (int i = 0; i < 16; ++i) M[i] = T(i % 5 == 0 ? 1.0 : 0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* h) const {
    h[0] = T(0.0);
    h[1] = h[3] = T(-9.81);
    h[2] = u[0];
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return contact == 0 ? T(q[2] - q[0] - 2.0) : T(q[2 * contact - 1] - 1.0);
  }
  template <typename T>
  T Slide(int contact, const T* q, const T*) const {
    return contact == 0 ? T(q[3] - q[1]) : q[2 * contact - 2];
  }
  template <typename T>
  T Friction(int contact, const T* p) const {
    return contact == 0 ? T(0.0) : p[0];
  }
  template <typename T>
  T Restitution(int contact, const T*) const {
    return T(contact == 0 ? 0.5 : 0.0);
  }
};

// The cost of each interval: its length times the weighted squares of the state beside a target, and of the control.
struct CartCost {
  static constexpr std::array<double, 8> kWeights = {10, 0.1, 1, 0.1, 0.1, 0.1, 0.1, 0.1},
                                         kTargets = {-6, 1, 0, 1, 0, 0, 0, 0};
  template <typename T>
  bool operator()(const T* x, const T* u, const T* length, T* rows) const {
    using std::sqrt;
    for (int i = 0; i < 8; ++i) rows[i] = sqrt(length[0] * kWeights[i]) * (x[i] - kTargets[i]);
    rows[8] = sqrt(0.1 * length[0]) * u[0];
    return true;
  }
};

HybridProblem CartsProblem(double push) {
  const MechanicalSystem system{Carts()};
  HybridProblem problem{
      .system = system.hybrid(),
      .guess = {.initial = {-3, 1, 0, 1, 0, 0, 0, 0}, .parameters = {0}, .duration = 3, .num_intervals = 10}};
  for (int k = 0; k < 10; ++k) problem.guess.control.push_back(k < 3 ? -push : k < 6 ? push : 0);
  problem.guess.mode =
      system.FindMode(problem.guess.initial, std::vector{problem.guess.control[0]}, problem.guess.parameters).mode;
  for (int i = 0; i < 8; ++i) {
    problem.terms.push_back(MakeTerminalCost(i, CartCost::kTargets[i], 200 * CartCost::kWeights[i], 8));
  }
  problem.terms.push_back(
      {.name = "stage",
       .at = HybridTerm::Timing::kEachInterval,
       .with_state = true,
       .with_control = true,
       .with_length = true,
       .function = std::make_shared<ceres::AutoDiffCostFunction<CartCost, 9, 8, 1, 1>>(new CartCost)});
  problem.free = {.control = true, .control_min = {-30}, .control_max = {30}};
  return problem;
}

// Shooting on the control intervals of the solution, which leaves no motion of the system, finds no lower loss.
void ExpectAsLowAsShooting(const HybridProblem& problem, const SolveReport& report) {
  HybridProblem shot = problem;
  shot.guess = SolutionOf(problem, report);
  EXPECT_NEAR(Solve("ceres_lm", shot, {}).solution.loss, report.solution.loss, 1e-8 * report.solution.loss);
}

// Sliding that reverses without friction changes nothing, and no plan has it. As intervals stretch with the time of the
// hit, the hit moves by more than the end of the interval that follows it.
TEST(Carts, WithoutFrictionHitOnce) {
  for (const char* solver : {"ceres_phases", "ipopt"}) {
    if (Solve(solver, CartsProblem(20), {.limits = {.iterations = 0}}).termination == Termination::kNotApplicable) {
      continue;
    }
    const HybridProblem problem = CartsProblem(20);
    const SolveReport report = Solve(solver, problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
    ASSERT_TRUE(report.certificate);
    EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
    ExpectAsLowAsShooting(problem, report);
    EXPECT_LT(report.solution.loss, 172) << solver;
  }
}

// Scales lengths in each phase, so that the interval before nodes[i] ends at times[i].
void MoveEnds(const std::vector<int>& nodes, const std::vector<double>& times, std::vector<double>* lengths) {
  for (size_t i = 0; i < nodes.size(); ++i) {
    const auto first = lengths->begin() + (i > 0 ? nodes[i - 1] : 0), last = lengths->begin() + nodes[i];
    const double factor = (times[i] - (i > 0 ? times[i - 1] : 0.0)) / std::accumulate(first, last, 0.0);
    std::for_each(first, last, [&](double& length) { length *= factor; });
  }
}

// The best motion that a solver found has a certificate of a minimum, and random changes of the control and of the
// times at which it makes the mode change raise the loss of the exact motion. Intervals move with the events of guards.
void ExpectMinimum(const HybridProblem& problem, const SolveReport& report, HybridSimulator* simulator) {
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
  ASSERT_TRUE(report.certificate->curvature);
  EXPECT_GT(report.certificate->curvature->smallest, 0);
  HybridInput best = problem.guess;
  best.control = report.solution.control;
  best.lengths = report.solution.durations;
  best.num_intervals = static_cast<int>(report.solution.durations.size());
  ASSERT_TRUE(simulator->Rollout(best)) << simulator->FailureReason();
  std::map<double, bool> changes = {{best.duration, false}};  // of the mode, and the end; whether a guard makes them
  for (const HybridEvent& event : simulator->events()) changes[event.time] = true;
  for (const HybridEvent& jump : simulator->switches()) changes[jump.time] = false;
  std::vector<int> nodes;
  for (const auto& [time, guard] : changes) {
    double end = 0;
    nodes.push_back(0);
    while (end < time - 0.5 * best.lengths[std::min(nodes.back(), best.num_intervals - 1)]) {
      end += best.lengths[nodes.back()++];
    }
  }
  constexpr double kSize = 1e-3;
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  HybridShooting shooting(problem);
  for (int trial = 0; trial < 40; ++trial) {
    HybridInput moved = best;
    for (double& u : moved.control) u += kSize * normal(random);
    std::vector<double> times;
    for (const auto& [time, guard] : changes) {
      times.push_back(guard || time == best.duration ? time : time * (1 + 0.1 * kSize * normal(random)));
    }
    HybridShooting::Outcome outcome;
    for (int round = 0; round < 20; ++round) {
      MoveEnds(nodes, times, &moved.lengths);
      ASSERT_TRUE(shooting.Simulate(moved, &outcome)) << shooting.FailureReason();
      auto event = shooting.simulator().events().begin();
      ASSERT_EQ(shooting.simulator().events().size(), simulator->events().size());
      size_t i = 0;
      for (const auto& [time, guard] : changes) {
        if (guard) times[i] = (event++)->time;
        ++i;
      }
    }
    EXPECT_GT(outcome.loss, report.solution.loss) << trial;
  }
}

// The disc strikes the box, sticks to it, and pushes it until the end.
TEST(ClosedContacts, APushedBoxReachesItsTargetWithACertificate) {
  const HybridProblem problem = PushedBoxProblem();
  const SolveReport report = Solve("mode_search", problem, {.sequences = {.limits = {.work = 1e6, .starts = 1}}});
  HybridSimulator simulator(problem.system, problem.integration);
  ASSERT_NO_FATAL_FAILURE(ExpectMinimum(problem, report, &simulator));
  EXPECT_EQ(problem.system.ModeName(simulator.final_mode()), "s");
  EXPECT_LT(report.solution.loss, 0.1 * report.history.losses.front());
}

// The foot sticks, takes off where the torques jump, lands and sticks again.
TEST(ClosedContacts, ALegHopsWithLeastEffortWithACertificate) {
  HybridProblem problem = LegHopperProblem();
  problem.integration.steps_per_interval = 4;  // with 3 the error of the integration hides the gradient
  const SolveReport report = Solve("ceres_phases", problem, {});
  HybridSimulator simulator(problem.system, problem.integration);
  ASSERT_NO_FATAL_FAILURE(ExpectMinimum(problem, report, &simulator));
  ASSERT_EQ(simulator.switches().size(), 1u);
  ASSERT_EQ(simulator.events().size(), 1u);
  const HybridEvent &off = simulator.switches()[0], &landing = simulator.events()[0];
  EXPECT_EQ(problem.system.ModeName(off.mode) + problem.system.ModeName(off.next_mode), "so");
  EXPECT_EQ(problem.system.ModeName(landing.mode) + problem.system.ModeName(landing.next_mode), "os");
  EXPECT_LT(off.time, landing.time);
  double missed = 0;  // of the apex
  ASSERT_TRUE(MissOfApex(0.75, 1)(landing.before.data(), problem.guess.parameters.data(), &missed));
  EXPECT_NEAR(missed, 0, 0.02);
}

// The pendulum under a torque that is a polynomial of t / T, whose coefficients are the parameters.
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
  return Solve("ceres_lm", problem, {.limits = {.iterations = 2000}});
}

TEST(PolynomialSwingUp, BoundWithoutImpact) {
  const SolveReport report = SolvePolynomial({-5.1, -65.6, 206.4, -131.9, -82.4, 84.3});
  EXPECT_NEAR(report.solution.loss, 1.4856636733327897, 1e-9) << report.reason;
}

TEST(PolynomialSwingUp, WithOneImpact) {
  const SolveReport report = SolvePolynomial({-11, -11, -120, 870, -1330, 595});
  EXPECT_NEAR(report.solution.loss, 2.0435133468791774, 1e-9) << report.reason;
}

}  // namespace
}  // namespace saltus
