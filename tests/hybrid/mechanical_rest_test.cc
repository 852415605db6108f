// Bodies that come to rest or rest from the start: rocking, corners, limits of friction, contacts without friction,
// forces that are not unique, and many contacts at once.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "campaign/resting_boxes.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kGravity = 9.81;

// ---------------------------------------------------------------------------------------------------------------------
// A block of point mass on the ground, pushed along it by u. p = [friction].
struct PushedBlock {
  double mass = 1;
  static constexpr int kNumCoordinates = 2, kNumControls = 1, kNumParameters = 1, kNumContacts = 1;
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(mass);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* h) const {
    h[0] = u[0];
    h[1] = T(-10.0 * mass);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[1];
  }
  template <typename T>
  T Slide(int, const T* q, const T*) const {
    return q[0];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[0];
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
};

struct BlockMotion {
  std::string mode, why, why_no_derivative;
  int steps = 0;
  double x = 0, by_push = 0, by_start = 0;
};
BlockMotion Push(double mass, double friction, double push, double x0) {
  const MechanicalSystem system{PushedBlock{mass}};
  const std::vector<double> x{x0, 0, 0, 0}, u{push}, p{friction};
  const MechanicalSystem::Start start = system.FindMode(x, u, p);
  BlockMotion motion;
  motion.why = start.reason;
  if (start.mode < 0) return motion;
  motion.mode = system.hybrid().ModeName(start.mode);
  HybridSimulator simulator(system.hybrid());
  if (!simulator.Rollout({.mode = start.mode, .initial = x, .parameters = p, .duration = 1, .control = u})) {
    motion.why = simulator.FailureReason();
    return motion;
  }
  motion.steps = simulator.steps_per_interval();
  motion.x = simulator.final_state()[0];
  motion.why_no_derivative = simulator.ReasonNotDifferentiable();
  const HybridGradient gradient = simulator.Adjoint(std::vector<double>{1, 0, 0, 0});
  motion.by_push = gradient.control[0];
  motion.by_start = gradient.initial[0];
  return motion;
}

TEST(StuckBlock, StaysAtOnceWhereverItIs) {
  for (const double x0 : {0.0, 1.0, -3e-9, 1e6}) {
    for (const double push : {0.0, 1.0, 5.0, -5.0, 6.7999, -6.7999}) {
      const BlockMotion motion = Push(1.7, 0.4, push, x0);
      EXPECT_EQ(motion.why, "") << x0 << " " << push;
      EXPECT_EQ(motion.mode, "s") << x0 << " " << push;
      EXPECT_EQ(motion.x, x0) << push;
      EXPECT_LE(motion.steps, 32) << x0 << " " << push;
      EXPECT_EQ(motion.by_push, 0) << x0 << " " << push;
      EXPECT_EQ(motion.by_start, 1) << x0 << " " << push;
    }
  }
}

// Whatever the distance from the limit, the mode that is found has a motion, and both have the same friction.
TEST(StuckBlock, TheLimitOfFrictionIsThatOfTheMotion) {
  for (double off = 1e-15; off < 1e-2; off *= 6.3) {
    for (const double side : {-1.0, 1.0}) {
      for (const double sign : {-1.0, 1.0}) {
        const double push = sign * 5 * (1 + side * off);
        const BlockMotion motion = Push(1, 0.5, push, 0);
        ASSERT_EQ(motion.why, "") << push - 5;
        const bool slides = side > 0 && off > 2e-12;
        if (off > 2e-12 || side < 0) {
          EXPECT_EQ(motion.mode, !slides ? "s" : sign > 0 ? "+" : "-") << off;
        }
        EXPECT_NEAR(motion.x, motion.mode == "s" ? 0 : 0.5 * (push - 5 * sign), 1e-15) << off;
        EXPECT_NEAR(motion.by_push, motion.mode == "s" ? 0 : 0.5, 1e-12) << off;
      }
    }
  }
}

TEST(ContactsWithoutFriction, NeverStick) {
  for (const double push : {0.0, 1e-9, -1e-6, 1e-3, -2.0}) {
    const BlockMotion motion = Push(1, 0, push, 0);
    ASSERT_EQ(motion.why, "");
    EXPECT_THAT(motion.mode, testing::Not(HasSubstr("s")));
    EXPECT_NEAR(motion.x, 0.5 * push, 1e-14);
    EXPECT_NEAR(motion.by_push, 0.5, 1e-13) << push;
  }
  // Friction that is not zero is refused in the mode without.
  const MechanicalSystem system{PushedBlock()};
  HybridSimulator simulator(system.hybrid());
  EXPECT_FALSE(
      simulator.Rollout({.mode = system.Mode("n"), .initial = {0, 0, 0, 0}, .parameters = {0.1}, .duration = 1}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("grip"));
}

// ---------------------------------------------------------------------------------------------------------------------
// Point masses on rails, coupled by springs and by their mass matrix; some rails have friction. q = [x_i y_i].
struct Sliders {
  int count = 3;
  std::vector<double> friction, mass, stiffness;
  double coupling = 0;

  MechanicalLayout Layout() const {
    return {.num_coordinates = 2 * count, .num_controls = count, .num_parameters = 0, .num_contacts = count};
  }
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    const int n = 2 * count;
    for (int i = 0; i < n * n; ++i) M[i] = T(0.0);
    for (int i = 0; i < count; ++i) {
      M[2 * i * (n + 1)] = M[(2 * i + 1) * (n + 1)] = T(mass[i]);
      if (i == 0) continue;
      M[2 * i * n + 2 * i - 2] = M[(2 * i - 2) * n + 2 * i] = T(coupling);
    }
  }
  template <typename T>
  void Force(const T&, const T* q, const T*, const T* u, const T*, T* h) const {
    for (int i = 0; i < count; ++i) {
      h[2 * i] = u[i];
      h[2 * i + 1] = T(-10.0 * mass[i]);
      if (i > 0) h[2 * i] -= stiffness[i] * (q[2 * i] - q[2 * i - 2]);
      if (i + 1 < count) h[2 * i] -= stiffness[i + 1] * (q[2 * i] - q[2 * i + 2]);
    }
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return q[2 * contact + 1];
  }
  template <typename T>
  T Slide(int contact, const T* q, const T*) const {
    return q[2 * contact];
  }
  template <typename T>
  T Friction(int contact, const T*) const {
    return T(friction[contact]);
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
};

// At rest without a push, masses on rails without friction move under any push, and those with friction do not: the
// derivative is that of the free masses alone, here by differences of the motion under pushes of them.
TEST(ContactsWithoutFriction, RandomSystemsHaveTheDerivativeOfTheirMotion) {
  std::mt19937 random(7);
  const auto uniform = [&](double low, double high) { return low + (high - low) * (random() / 4294967296.0); };
  int compared = 0;
  for (int number = 0; number < 4; ++number) {
    Sliders sliders;
    sliders.count = 2 + number % 5;
    sliders.coupling = uniform(-0.2, 0.2);
    for (int i = 0; i < sliders.count; ++i) {
      sliders.friction.push_back(random() % 2 == 0 ? 0 : uniform(0.1, 1));
      sliders.mass.push_back(uniform(0.6, 2));
      sliders.stiffness.push_back(uniform(0, 30));
    }
    const MechanicalSystem system{sliders};
    HybridInput input{.initial = std::vector<double>(4 * sliders.count), .duration = 0.7};
    // Springs are at rest where all are at one place.
    for (int i = 0; i < sliders.count; ++i) input.initial[2 * i] = 0.5;
    std::vector<double> control(sliders.count);
    const auto end = [&](HybridSimulator& simulator) {
      const MechanicalSystem::Start start = system.FindMode(input.initial, control, {});
      EXPECT_EQ(start.reason, "") << number;
      input.mode = std::max(start.mode, 0);
      input.control = control;
      EXPECT_TRUE(simulator.Rollout(input)) << number << simulator.FailureReason();
      return std::vector<double>(simulator.final_state().begin(), simulator.final_state().end());
    };
    HybridSimulator simulator(system.hybrid());
    end(simulator);
    const HybridSensitivity sensitivity = simulator.Sensitivity();
    const int n = 4 * sliders.count;
    for (int j = 0; j < sliders.count; ++j) {
      HybridSimulator other(system.hybrid());
      constexpr double kStep = 1e-4;
      control[j] = kStep;
      const std::vector<double> on = end(other);
      control[j] = -kStep;
      other.ResetStepChoice();
      const std::vector<double> back = end(other);
      control[j] = 0;
      for (int i = 0; i < n; ++i) {
        const double by = sensitivity.final_state[static_cast<std::size_t>(i) * sensitivity.columns + n + j];
        EXPECT_NEAR(by, (on[i] - back[i]) / (2 * kStep), 1e-8) << number << ": " << i << " by " << j;
        ++compared;
      }
    }
  }
  EXPECT_GT(compared, 100);
}

// The places of the masses without friction after pushes, by the classical Runge-Kutta method. The others stay at 0.5.
Eigen::VectorXd PlacesOfFreeMasses(const Sliders& sliders, const std::vector<double>& push, double duration) {
  const int n = sliders.count;
  Eigen::MatrixXd mass = Eigen::MatrixXd::Zero(n, n), stiffness = mass;
  Eigen::VectorXd free(n);
  for (int i = 0; i < n; ++i) {
    free[i] = sliders.friction[i] == 0 ? 1 : 0;
    mass(i, i) = sliders.mass[i];
    if (i == 0) continue;
    mass(i, i - 1) = mass(i - 1, i) = sliders.coupling;
    stiffness.block<2, 2>(i - 1, i - 1) += sliders.stiffness[i] * Eigen::Matrix2d{{1, -1}, {-1, 1}};
  }
  const Eigen::MatrixXd held = Eigen::VectorXd(1 - free.array()).asDiagonal(), moving = free.asDiagonal();
  const Eigen::MatrixXd inverse = Eigen::MatrixXd(moving * mass * moving + held).inverse() * moving;
  const Eigen::Map<const Eigen::VectorXd> u(push.data(), n);
  const auto accelerate = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd { return inverse * (u - stiffness * x); };
  Eigen::VectorXd x = Eigen::VectorXd::Zero(n), v = x;  // from 0.5
  constexpr int kSteps = 2000;
  const double h = duration / kSteps;
  for (int step = 0; step < kSteps; ++step) {
    const Eigen::VectorXd a1 = accelerate(x), a2 = accelerate(x + 0.5 * h * v),
                          a3 = accelerate(x + 0.5 * h * v + 0.25 * h * h * a1),
                          a4 = accelerate(x + h * v + 0.5 * h * h * a2);
    x += h * v + h * h / 6 * (a1 + a2 + a3);
    v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
  }
  return x.array() + 0.5;
}

// Masses without friction swing to and fro: they stop and turn without an end of the motion.
TEST(ContactsWithoutFriction, TurnWhereTheyStop) {
  std::mt19937 random(7);
  const auto uniform = [&](double low, double high) { return low + (high - low) * (random() / 4294967296.0); };
  int stops = 0;
  for (int number = 0; number < 12; ++number) {
    SCOPED_TRACE(number);
    Sliders sliders;
    sliders.count = 3 + number % 6;
    sliders.coupling = uniform(-0.2, 0.2);
    for (int i = 0; i < sliders.count; ++i) {
      sliders.friction.push_back(i % 3 == number % 3 ? uniform(0.1, 1) : 0);
      sliders.mass.push_back(uniform(0.6, 2));
      sliders.stiffness.push_back(uniform(0, 30));
    }
    const MechanicalSystem system{sliders};
    HybridInput input{.initial = std::vector<double>(4 * sliders.count), .duration = 0.7};
    for (int i = 0; i < sliders.count; ++i) input.initial[2 * i] = 0.5;
    input.control.resize(sliders.count);
    input.control[(number + 1) % sliders.count] = 0.01;
    const MechanicalSystem::Start start = system.FindMode(input.initial, input.control, {});
    ASSERT_EQ(start.reason, "");
    input.mode = start.mode;
    HybridSimulator simulator(system.hybrid());
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    const Eigen::VectorXd expected = PlacesOfFreeMasses(sliders, input.control, input.duration);
    for (int i = 0; i < sliders.count; ++i) EXPECT_NEAR(simulator.final_state()[2 * i], expected[i], 1e-11) << i;
    stops += static_cast<int>(simulator.events().size());
  }
  EXPECT_GT(stops, 10);
}

// A mass with friction that begins to slide is not stopped by rounding errors of its forces.
TEST(ContactsWithoutFriction, ANeighbourThatBeginsToSlideGoesOn) {
  Sliders sliders{.count = 2, .friction = {0, 0.5}, .mass = {1, 1}, .stiffness = {0, 30}, .coupling = 0.1};
  const MechanicalSystem system{sliders};
  for (const double push : {4.1, 5.3, 6.7, 8.0}) {
    SCOPED_TRACE(push);
    HybridInput input{.initial = {0.5, 0, 0.5, 0, 0, 0, 0, 0}, .duration = 0.7, .control = {push, 0}};
    input.mode = system.FindMode(input.initial, input.control, {}).mode;
    HybridSimulator simulator(system.hybrid());
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    // Until it slides the first mass is an oscillator: x = u / k (1 - cos w t), w^2 = k, with the force on the second
    // k x - 0.1 x'' = 5.
    const double w = std::sqrt(30.0), most = push / 30;
    double low = 0, high = 3.14159265358979 / w;
    for (int i = 0; i < 60; ++i) {
      const double t = 0.5 * (low + high), x = most * (1 - std::cos(w * t)), a = push * std::cos(w * t);
      (30 * x - 0.1 * a < 5 ? low : high) = t;
    }
    ASSERT_FALSE(simulator.events().empty());
    EXPECT_EQ(system.hybrid().ModeName(simulator.events()[0].next_mode), "++");
    EXPECT_NEAR(simulator.events()[0].time, low, 1e-11);
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// A block of point mass in the corner of a rough floor and a wall. p = [friction of the floor].
struct BlockInCorner {
  double wall_friction = 0;
  static constexpr int kNumCoordinates = 2, kNumControls = 1, kNumParameters = 1, kNumContacts = 2;
  static constexpr std::array<const char*, 2> kContactNames = {"floor", "wall"};
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(1.7);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* h) const {
    h[0] = u[0];
    h[1] = T(-1.7 * kGravity);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return contact == 0 ? q[1] : q[0];
  }
  template <typename T>
  T Slide(int contact, const T* q, const T*) const {
    return contact == 0 ? q[0] : q[1];
  }
  template <typename T>
  T Friction(int contact, const T* p) const {
    return contact == 0 ? p[0] : T(wall_friction);
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
};

TEST(BlockInCorner, StaysUnderEveryPushThatFrictionOrTheWallHolds) {
  for (const double wall_friction : {0.0, 0.2, 1.5}) {
    const MechanicalSystem system{BlockInCorner{wall_friction}};
    for (const double push : {0.0, 1.0, 5.0, 6.67, -1.0, -5.0, -12.0, -100.0}) {
      const std::vector<double> x{0, 0, 0, 0}, u{push}, p{0.4};
      const MechanicalSystem::Start start = system.FindMode(x, u, p);
      ASSERT_EQ(start.reason, "") << wall_friction << " " << push;
      HybridSimulator simulator(system.hybrid());
      ASSERT_TRUE(simulator.Rollout({.mode = start.mode, .initial = x, .parameters = p, .duration = 1, .control = u}))
          << wall_friction << " " << push << simulator.FailureReason();
      EXPECT_THAT(simulator.final_state(), testing::Each(0.0)) << wall_friction << " " << push;
      EXPECT_LE(simulator.steps_per_interval(), 32);
      for (const double entry : simulator.Sensitivity().final_state) EXPECT_TRUE(std::isfinite(entry));
    }
    // Beyond the limit it leaves the wall.
    const std::vector<double> x{0, 0, 0, 0}, u{7}, p{0.4};
    const MechanicalSystem::Start start = system.FindMode(x, u, p);
    ASSERT_EQ(start.reason, "");
    HybridSimulator simulator(system.hybrid());
    ASSERT_TRUE(simulator.Rollout({.mode = start.mode, .initial = x, .parameters = p, .duration = 1, .control = u}))
        << simulator.FailureReason();
    EXPECT_NEAR(simulator.final_state()[0], 0.5 * (7 / 1.7 - 0.4 * kGravity), 1e-13);
  }
}

// It slides into the corner, and rests there; without friction of the floor too.
TEST(BlockInCorner, ComesToRestInIt) {
  for (const double wall_friction : {0.0, 0.2}) {
    for (const double floor : {0.0, 0.4}) {
      const MechanicalSystem system{BlockInCorner{wall_friction}};
      HybridSimulator simulator(system.hybrid());
      const std::vector<double> x{0.3, 0, -2, 0}, p{floor};
      const MechanicalSystem::Start start = system.FindMode(x, std::vector<double>{0}, p);
      ASSERT_TRUE(simulator.Rollout({.mode = start.mode, .initial = x, .parameters = p, .duration = 1}))
          << wall_friction << simulator.FailureReason();
      ASSERT_FALSE(simulator.events().empty());
      const double a = floor * kGravity;
      const double time = floor == 0 ? 0.15 : (2 - std::sqrt(4 - 2 * a * 0.3)) / a;
      EXPECT_NEAR(simulator.events()[0].time, time, 1e-13);
      for (const double entry : simulator.final_state()) EXPECT_NEAR(entry, 0, 1e-15);
      for (const double entry : simulator.Sensitivity().final_state) EXPECT_TRUE(std::isfinite(entry));
      EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    }
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Boxes that rock, tumble and rest.

// Each rocking is a quarter as fast as the last: the times add up. The values are those of the problem of Housner.
TEST(RockingBox, LiesStillAtTheEnd) {
  const auto box = [](double restitution) {
    return RigidBodies2D(
        {.bodies =
             {{.name = "box", .polygon = BoxPolygon(0.05, 0.05), .position = {0, 0.06254283478934728}, .angle = 0.3}},
         .planes = {{}},
         .restitution = restitution,
         .friction = 1});
  };
  for (const double restitution : {0.0, 0.3}) {
    const RigidBodies2D scene = box(restitution);
    const MechanicalSystem system(scene);
    const std::vector<double> initial = scene.InitialState(), p = scene.Parameters();
    const MechanicalSystem::Start start = system.FindMode(initial, {}, p);
    ASSERT_EQ(start.reason, "");
    HybridSimulator simulator(system.hybrid());
    ASSERT_TRUE(simulator.Rollout({.mode = start.mode, .initial = initial, .parameters = p, .duration = 1}))
        << simulator.FailureReason();
    EXPECT_TRUE(Rests(simulator.final_state(), 0)) << restitution;
    if (restitution > 0) continue;
    EXPECT_NEAR(simulator.final_state()[0], 0.05 - 0.05 * std::cos(0.3) + 0.05 * std::sin(0.3), 1e-11);
    EXPECT_NEAR(simulator.final_state()[1], 0.05, 1e-15);
    EXPECT_NEAR(simulator.final_state()[2], 0, 1e-15);
    EXPECT_NEAR(simulator.events().back().time, 0.162123749473585, 1e-5);
    EXPECT_LT(simulator.events().size(), 60u);
    EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    // Where it ends by the angle at which it begins to fall on the same corner.
    const std::vector<double> by = simulator.Adjoint(std::vector<double>{1, 0, 0, 0, 0, 0}).initial;
    const double height_by_angle = 0.05 * std::cos(0.3) - 0.05 * std::sin(0.3);
    EXPECT_NEAR(by[0], 1, 1e-12);
    EXPECT_NEAR(by[1] * height_by_angle + by[2], 0.05 * std::sin(0.3) + 0.05 * std::cos(0.3), 1e-9);
  }
}

TEST(TumblingCube, TipsAndRests) {
  for (const double friction : {1.1, 1.2}) {
    for (const double restitution : {0.0, 0.3}) {
      for (const double speed : {1.0, 2.0, 3.0, 4.0, 6.0}) {
        SCOPED_TRACE(Line("friction %g, restitution %g, speed %g", friction, restitution, speed));
        const RigidBodies2D scene(
            {.bodies =
                 {{.name = "cube", .polygon = BoxPolygon(0.05, 0.05), .position = {0, 0.05}, .velocity = {speed, 0}}},
             .planes = {{}},
             .restitution = restitution,
             .friction = friction});
        const MechanicalSystem system(scene);
        HybridInput input{.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = 2};
        const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
        ASSERT_EQ(start.reason, "");
        input.mode = start.mode;
        HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 400, .most_events = 2000});
        ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
        RestingReport report;
        CheckMotion(scene, system, simulator, input, &report);
        EXPECT_EQ(report.wrong, "");
        EXPECT_TRUE(Rests(simulator.final_state(), 0));
      }
    }
  }
}

TEST(RestingBoxes, TossesEndAtRest) {
  int rests = 0, refused = 0;
  for (int seed = 7; seed <= 26; ++seed) {
    const RestingReport report = TossUntilRest(seed).Run(/*compare=*/false);
    EXPECT_EQ(report.wrong, "") << seed;
    refused += report.refused.empty() ? 0 : 1;
    rests += report.rests ? 1 : 0;
  }
  EXPECT_EQ(refused, 0);
  EXPECT_GE(rests, 14);
}

// The forces of a box that slides grow where friction is large, and coarse steps lead anywhere: the number of steps is
// chosen so that they do not.
TEST(RestingBoxes, SlidersWithMuchFrictionEndAtRest) {
  for (const int seed : {240, 306}) {
    const RestingReport report = TossUntilRest(seed).Run(/*compare=*/false);
    EXPECT_EQ(report.wrong, "") << seed;
    EXPECT_EQ(report.refused, "") << seed;
  }
}

// The last bounces of these boxes depend on rounding, and so do their times and the angle, which is zero at rest: that
// twice as many steps do not lower the difference is no reason for more of them, and none to refuse the motion.
TEST(RestingBoxes, BouncesThatAmplifyRoundingEndAtRest) {
  for (const int seed : {39, 444}) {
    const RestingReport report = TossUntilRest(seed).Run(/*compare=*/false);
    EXPECT_EQ(report.wrong, "") << seed;
    EXPECT_EQ(report.refused, "") << seed;
    EXPECT_TRUE(report.rests) << seed;
  }
}

// A box that falls askew on the edge of another one, which lies on the ground.
RigidScene2D OneBoxOnAnother(unsigned seed) {
  std::mt19937 random(seed);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
  };
  RigidScene2D scene{.bodies = {}, .planes = {{}}, .restitution = 0.3 * (seed % 3 == 0), .friction = uniform(0.1, 1)};
  const double width = uniform(0.05, 0.3), height = uniform(0.05, 0.2);
  const double upper_width = uniform(0.05, 0.3), upper_height = uniform(0.05, 0.2), side = seed % 2 == 0 ? 1 : -1;
  scene.bodies.push_back(
      {.name = "low", .polygon = BoxPolygon(width, height), .mass = uniform(0.3, 3), .position = {0, height}});
  RigidBody2D upper{.name = "high", .polygon = BoxPolygon(upper_width, upper_height), .mass = uniform(0.3, 3)};
  upper.position = {side * (width + uniform(-0.7, 0.1) * upper_width),
                    2 * height + std::hypot(upper_width, upper_height) + uniform(0.01, 0.2)};
  upper.angle = uniform(-0.6, 0.6);
  upper.velocity = {uniform(-1, 1), 0};
  upper.spin = uniform(-3, 3);
  scene.bodies.push_back(upper);
  return scene;
}

// How far the corner of a contact named "low.0-high.1" or "low.0-plane 0" is from the edge, or the ground y = 0.
double DistanceOfNamed(const RigidBodies2D& bodies, const std::string& name, const double* x) {
  const auto corner = [&](std::size_t dot) {
    const int body = name[dot - 1] == 'w' ? 0 : 1, vertex = name[dot + 1] - '0';
    const std::array<double, 3> pose = bodies.PoseOf(body, x);
    const auto place = [&](int number) {
      const Point2D& from = bodies.scene().bodies[body].polygon[number % 4];
      const double c = std::cos(pose[2]), s = std::sin(pose[2]);
      return Eigen::Vector2d(pose[0] + c * from[0] - s * from[1], pose[1] + s * from[0] + c * from[1]);
    };
    return std::pair(place(vertex), place(vertex + 1));
  };
  const Eigen::Vector2d point = corner(name.find('.')).first;
  if (name.find("plane") != std::string::npos) return std::abs(point[1]);
  const auto [from, to] = corner(name.rfind('.'));
  const Eigen::Vector2d edge = to - from;
  const double along = std::clamp((point - from).dot(edge) / edge.squaredNorm(), 0.0, 1.0);
  return (point - from - along * edge).norm();
}

// An event is named after a contact that is closed there, and whose status it changes.
TEST(RestingBoxes, EventsAreNamedAfterTheContactThatChanges) {
  int events = 0;
  for (unsigned seed = 0; seed < 50; ++seed) {
    const RigidBodies2D bodies(OneBoxOnAnother(seed));
    const MechanicalSystem system(bodies);
    HybridInput input{.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = 0.6};
    input.mode = system.FindMode(input.initial, {}, input.parameters).mode;
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 50, .most_events = 1000});
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    const std::vector<std::string>& contacts = system.functions().layout().contact_names;
    for (const HybridEvent& event : simulator.events()) {
      ++events;
      const std::string name = system.hybrid().GuardName(event.mode, event.guard);
      const std::string before = system.hybrid().ModeName(event.mode),
                        after = system.hybrid().ModeName(event.next_mode);
      SCOPED_TRACE(Line("seed %u, t = %.9f, ", seed, event.time) + name + ", " + before + " to " + after);
      EXPECT_LT(DistanceOfNamed(bodies, name, event.before.data()), 1e-9);
      if (name.starts_with("hit ")) continue;  // which may rebound
      const auto named =
          std::ranges::find_if(contacts, [&](const std::string& of) { return name.ends_with(" " + of); });
      const auto number = static_cast<std::size_t>(named - contacts.begin());
      EXPECT_NE(before[number], after[number]);
    }
  }
  EXPECT_GT(events, 500);
}

TEST(RestingBoxes, StepsThatAreTooLongAreRefused) {
  const RigidBodies2D scene = TossUntilRest(240).Scene();
  const MechanicalSystem system(scene);
  HybridInput input{.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = 2.5};
  input.mode = system.FindMode(input.initial, {}, input.parameters).mode;
  HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 400});
  EXPECT_FALSE(simulator.Rollout(input));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("steps of the integration are too long"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("Take more steps"));
}

// Up to ten contacts take part in an impact, and tip bodies whose relative accelerations are far below that of gravity.
TEST(RestingBoxes, ColumnsTipAndFallOver) {
  for (const auto& [seed, duration, steps] : {std::tuple{17, 1.0, 16}, {5, 0.003, 64}}) {
    SCOPED_TRACE(seed);
    const RestingReport report = MovingColumn(seed).Run(duration, steps);
    EXPECT_EQ(report.refused, "");
    EXPECT_EQ(report.wrong, "");
    EXPECT_GT(report.impacts, 50);
  }
}

// A box slides to the left, and one that stands on it with much friction tips at once to its right corner. The sliding
// stops within a thousandth of a second, and longer steps lead to no numbers: they tell nothing about the left corner,
// and are no reason to refuse the motion unless they are given.
TEST(RestingBoxes, ABoxTipsWhereTheOneBelowSlides) {
  const auto run = [](double speed, const HybridOptions& options) {
    const RigidBodies2D bodies(
        {.bodies = {{.name = "low", .polygon = BoxPolygon(0.1, 0.05), .position = {0, 0.05}, .velocity = {speed, 0}},
                    {.name = "high", .polygon = BoxPolygon(0.1, 0.2), .mass = 4, .position = {0, 0.3}}},
         .planes = {{}},
         .friction = 1.05});
    const MechanicalSystem system(bodies);
    HybridInput input{.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = 1};
    input.mode = system.FindMode(input.initial, {}, input.parameters).mode;
    HybridSimulator simulator(system.hybrid(), options);
    simulator.Rollout(input);
    return std::pair(simulator.FailureReason(), simulator.events().size());
  };
  const auto [why_given, events] = run(-0.05, {.steps_per_interval = 16});
  EXPECT_THAT(why_given, HasSubstr("is not a finite number"));
  EXPECT_EQ(events, 0u);
  EXPECT_THAT(run(-0.5, {.most_events = 5}).first, HasSubstr("more than 5 events"));
}

TEST(RestingBoxes, ScenesInEquilibriumRest) {
  for (int seed = 1; seed <= 50; ++seed) {
    const RestingReport report = RestingScene(seed).Run();
    EXPECT_EQ(report.refused, "") << seed;
    EXPECT_EQ(report.wrong, "") << seed;
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Columns of bodies that touch: coordinates are heights. p = [restitution].
struct Column {
  int count = 2;
  double radius = 0.005;

  MechanicalLayout Layout() const {
    return {.num_coordinates = count, .num_controls = 0, .num_parameters = 1, .num_contacts = count};
  }
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    for (int i = 0; i < count * count; ++i) M[i] = T(i % (count + 1) == 0 ? 1.0 : 0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T*, T* h) const {
    for (int i = 0; i < count; ++i) h[i] = T(-kGravity);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return contact == 0 ? q[0] - radius : q[contact] - q[contact - 1] - 2 * radius;
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }
};

// Contacts that neither open nor carry a force stay closed in free fall: the column bounces as one body.
TEST(Columns, FallAndBounceAsOneBodyWhateverTheirNumber) {
  for (const int count : {2, 3, 4, 5, 6, 7, 8, 12, 20, 50}) {
    SCOPED_TRACE(count);
    const MechanicalSystem system{Column{count}};
    HybridInput input{.initial = std::vector<double>(2 * count), .parameters = {0.8}, .duration = 0.2};
    for (int i = 0; i < count; ++i) input.initial[i] = 0.055 + 0.01 * i;
    const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
    ASSERT_EQ(start.reason, "");
    EXPECT_EQ(system.hybrid().ModeName(start.mode), "o" + std::string(count - 1, 'n'));
    input.mode = start.mode;
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 8, .most_events = 200});
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    const double fall = std::sqrt(2 * 0.05 / kGravity), left = 0.2 - fall, speed = 0.8 * kGravity * fall;
    for (int i = 0; i < count; ++i) {
      EXPECT_NEAR(simulator.final_state()[i], 0.005 + 0.01 * i + speed * left - 0.5 * kGravity * left * left, 1e-12);
    }
  }
}

TEST(Columns, Rest) {
  for (const int count : {2, 5, 6, 12, 20, 50}) {
    SCOPED_TRACE(count);
    const MechanicalSystem system{Column{count}};
    HybridInput input{.initial = std::vector<double>(2 * count), .parameters = {0.5}, .duration = 1};
    for (int i = 0; i < count; ++i) input.initial[i] = 0.005 + 0.01 * i;
    const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
    ASSERT_EQ(start.reason, "");
    EXPECT_EQ(system.hybrid().ModeName(start.mode), std::string(count, 'n'));
    input.mode = start.mode;
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 8});
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    for (std::size_t i = 0; i < input.initial.size(); ++i) {
      EXPECT_NEAR(simulator.final_state()[i], input.initial[i], 1e-15);
    }
  }
}

// Boxes of one width or discs on top of each other, the lowest at this height above the ground.
RigidScene2D PiledUp(bool boxes, int count, double height, double x = 0) {
  RigidScene2D scene{.bodies = {}, .planes = {{}}, .restitution = 0.5, .friction = 0.6};
  for (int i = 0; i < count; ++i) {
    RigidBody2D body{.name = "body" + std::to_string(i), .position = {x, height + 0.05 * (2 * i + 1)}};
    if (boxes) body.polygon = BoxPolygon(0.1, 0.05);
    if (!boxes) body.radius = 0.05;
    scene.bodies.push_back(body);
  }
  return scene;
}

// Pyramids of boxes, with a distance between them in a row, and of discs, from this height above the ground up.
RigidScene2D Pyramid(bool boxes, int count, double height, double distance = 0.01) {
  RigidScene2D scene{.bodies = {}, .planes = {{}}, .restitution = 0.5, .friction = 0.6};
  constexpr double kWidth = 0.1, kHeight = 0.05, kRadius = 0.1;
  int base = 1;
  while (base * (base + 1) / 2 < count) ++base;
  for (int row = 0; std::ssize(scene.bodies) < count; ++row) {
    for (int i = 0; i < base - row && std::ssize(scene.bodies) < count; ++i) {
      RigidBody2D body{.name = "body" + std::to_string(scene.bodies.size())};
      const double place = i + 0.5 * row;
      if (boxes) {
        body.polygon = BoxPolygon(kWidth, kHeight);
        body.position = {(2 * kWidth + distance) * place, height + kHeight * (2 * row + 1)};
      } else {
        body.radius = kRadius;
        body.position = {2 * kRadius * place, height + kRadius * (1 + row * std::sqrt(3.0))};
      }
      scene.bodies.push_back(body);
    }
  }
  return scene;
}

// The motion of bodies that touch at the start; steps: 0: chosen.
struct BodiesInMotion {
  BodiesInMotion(const RigidScene2D& scene, double duration, int steps)
      : bodies(scene), system(bodies), simulator(system.hybrid(), {.steps_per_interval = steps}) {
    input = {.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = duration};
    const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
    why = start.reason;
    if (start.mode < 0) return;
    input.mode = start.mode;
    if (!simulator.Rollout(input)) why = simulator.FailureReason();
  }
  // All bodies are this much higher than at the start, and else as they were.
  void ExpectRisen(double by) const {
    for (int i = 0; i < std::ssize(bodies.scene().bodies); ++i) {
      const std::array<double, 3> pose = bodies.PoseOf(i, simulator.final_state().data());
      const RigidBody2D& body = bodies.scene().bodies[i];
      EXPECT_NEAR(pose[0], body.position[0], 1e-12) << i;
      EXPECT_NEAR(pose[1], body.position[1] + by, 1e-12) << i;
      EXPECT_NEAR(pose[2], 0, 1e-12) << i;
    }
  }

  RigidBodies2D bodies;
  MechanicalSystem system;
  HybridSimulator simulator;
  HybridInput input;
  std::string why;
};

struct Pile {
  bool boxes = false;
  int count = 0, steps = 0;
};

// Corners of boxes of one width meet, and discs on top of each other would fall over by rounding errors.
TEST(PiledUp, Rests) {
  for (const auto& [boxes, count, steps] :
       {Pile{true, 2}, {true, 5}, {true, 10}, {true, 20, 4}, {false, 2}, {false, 5}, {false, 10}, {false, 50}}) {
    SCOPED_TRACE((boxes ? "boxes " : "discs ") + std::to_string(count));
    const BodiesInMotion motion(PiledUp(boxes, count, 0), 1, steps);
    ASSERT_EQ(motion.why, "");
    EXPECT_TRUE(motion.simulator.events().empty());
    EXPECT_LE(motion.simulator.steps_per_interval(), 64);
    motion.ExpectRisen(0);
  }
}

// Friction slows down all boxes of a column by mu g: each of the contacts between them is at its limit all the while.
TEST(PiledUp, SlidesAndStopsAsOneBody) {
  struct Slide {
    int count = 0;
    double friction = 0, narrower = 0;  // each box, of the width of the first
  };
  for (const auto& [count, friction, narrower] :
       {Slide{2, 0.1}, {2, 0.5}, {2, 1}, {3, 0.5, 0.1}, {4, 0.2}, {4, 0.4, 0.2}, {5, 0.3}}) {
    SCOPED_TRACE(std::to_string(count) + " boxes, friction " + std::to_string(friction));
    RigidScene2D scene = PiledUp(/*boxes=*/true, count, 0);
    const double speed = 0.25 * friction * kGravity;
    scene.friction = friction;
    for (int i = 0; i < count; ++i) {
      RigidBody2D& box = scene.bodies[i];
      box.velocity = {speed, 0};
      for (Point2D& corner : box.polygon) corner[0] *= 1 - narrower * i;
    }
    const BodiesInMotion motion(scene, 0.3, 0);
    ASSERT_EQ(motion.why, "");
    ASSERT_EQ(motion.simulator.events().size(), 1U);
    EXPECT_NEAR(motion.simulator.events()[0].time, 0.25, 1e-12);
    EXPECT_LE(motion.simulator.steps_per_interval(), 64);
    for (int i = 0; i < count; ++i) {
      const std::array<double, 3> pose = motion.bodies.PoseOf(i, motion.simulator.final_state().data());
      EXPECT_NEAR(pose[0], 0.125 * speed, 1e-12) << i;
      EXPECT_NEAR(pose[1], scene.bodies[i].position[1], 1e-12) << i;
      EXPECT_NEAR(pose[2], 0, 1e-12) << i;
    }
    EXPECT_TRUE(Rests(motion.simulator.final_state(), 1e-12));
  }
}

// The lower of two boxes is pushed by 0, 2, 4 and 8 mu m g: with the first and the third, the upper one is carried at
// the limit of friction; under the last, it slides back.
TEST(PiledUp, IsCarriedUpToTheLimitOfFriction) {
  RigidScene2D scene = PiledUp(/*boxes=*/true, 2, 0);
  scene.friction = 0.25;
  for (RigidBody2D& box : scene.bodies) box.velocity = {1, 0};
  scene.bodies[0].pushed = true;
  const RigidBodies2D bodies(scene);
  const MechanicalSystem system(bodies);
  HybridSimulator simulator(system.hybrid());
  const double limit = 0.25 * kGravity, each = 0.1;
  HybridInput input{
      .initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = 4 * each, .num_intervals = 4};
  input.control = {0, 0, 0, 2 * limit, 0, 0, 4 * limit, 0, 0, 8 * limit, 0, 0};
  input.mode = system.FindMode(input.initial, input.control, input.parameters).mode;
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  double x = 0, v = 1, upper = 0, upper_v = 1;
  for (const double a : {-limit, 0.0, limit, 5 * limit}) {
    const double of_upper = std::min(a, limit);
    x += v * each + 0.5 * a * each * each;
    upper += upper_v * each + 0.5 * of_upper * each * each;
    v += a * each;
    upper_v += of_upper * each;
  }
  EXPECT_NEAR(bodies.PoseOf(0, simulator.final_state().data())[0], x, 1e-12);
  EXPECT_NEAR(bodies.PoseOf(1, simulator.final_state().data())[0], upper, 1e-12);
  EXPECT_NEAR(bodies.PoseOf(1, simulator.final_state().data())[2], 0, 1e-12);
}

// A force on the first box of a row accelerates all of them by 2 m/s^2.
TEST(Rows, SlideAsOneBody) {
  for (const auto& [count, friction] : {std::pair{2, 0.1}, {3, 0.5}, {4, 1.0}}) {
    SCOPED_TRACE(std::to_string(count) + " boxes, friction " + std::to_string(friction));
    RigidScene2D scene = PiledUp(/*boxes=*/true, count, 0);
    const double height = scene.bodies[0].position[1], width = 2 * scene.bodies[0].polygon[1][0];
    scene.friction = friction;
    for (int i = 0; i < count; ++i) scene.bodies[i].position = {width * i, height};
    scene.bodies[0].pushed = true;
    const RigidBodies2D bodies(scene);
    const MechanicalSystem system(bodies);
    HybridSimulator simulator(system.hybrid());
    HybridInput input{.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = 0.2};
    input.control = {count * (friction * kGravity + 2), 0, 0};
    input.mode = system.FindMode(input.initial, input.control, input.parameters).mode;
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    EXPECT_TRUE(simulator.events().empty());
    for (int i = 0; i < count; ++i) {
      const std::array<double, 3> pose = bodies.PoseOf(i, simulator.final_state().data());
      EXPECT_NEAR(pose[0], width * i + 0.04, 1e-12) << i;
      EXPECT_NEAR(pose[1], height, 1e-12) << i;
      EXPECT_NEAR(pose[2], 0, 1e-12) << i;
    }
  }
}

TEST(PiledUp, ManyFlushBoxesRest) {
  const BodiesInMotion motion(PiledUp(/*boxes=*/true, 50, 0), 0.1, 4);
  ASSERT_EQ(motion.why, "");
  EXPECT_TRUE(motion.simulator.events().empty());
  motion.ExpectRisen(0);
}

// Contacts without forces, whose rates are rounding, neither open nor slide: the pile falls and bounces as one body.
// Each bounce takes half the time of the one before.
TEST(PiledUp, FallsAndBouncesAsOneBody) {
  constexpr double kHeight = 0.05;
  const double fall = std::sqrt(2 * kHeight / kGravity);
  for (const auto& [boxes, count, steps] :
       {Pile{true, 2}, {true, 3}, {true, 10, 4}, {false, 2}, {false, 5}, {false, 20}, {false, 50}}) {
    SCOPED_TRACE((boxes ? "boxes " : "discs ") + std::to_string(count));
    const int bounces = count > 20 || steps > 0 ? 1 : 4;
    const double duration = bounces == 1 ? 1.8 * fall : 2.8 * fall;
    const BodiesInMotion motion(PiledUp(boxes, count, kHeight), duration, steps);
    ASSERT_EQ(motion.why, "");
    ASSERT_EQ(static_cast<int>(motion.simulator.events().size()), bounces);
    double time = fall, flight = fall, speed = 0.5 * kGravity * fall;  // of the bounce that comes next
    for (int i = 0; i < bounces; ++i) {
      EXPECT_NEAR(motion.simulator.events()[i].time, time, 1e-12);
      if (i + 1 == bounces) break;
      time += flight;
      flight *= 0.5;
      speed *= 0.5;
    }
    const double left = duration - time;
    motion.ExpectRisen(speed * left - 0.5 * kGravity * left * left - kHeight);
  }
}

// Discs that are not quite on top of each other begin to fall over, and amplify rounding errors: no jump of the flow,
// and what is lost is said.
TEST(PiledUp, SaysWhatIsLostWhereItFallsOver) {
  RigidScene2D scene = PiledUp(/*boxes=*/false, 6, 0, 0.3);
  scene.bodies[3].position[0] += 1e-12;
  BodiesInMotion motion(scene, 1, 0);
  ASSERT_EQ(motion.why, "");
  EXPECT_GT(motion.simulator.IntegrationError(), 1e-7);
  EXPECT_NE(motion.simulator.ReasonInaccurate(), "");
}

TEST(Pyramids, Rest) {
  for (const auto& [boxes, count, steps] : {Pile{true, 3},
                                            {true, 6},
                                            {true, 10, 4},
                                            {true, 15, 4},
                                            {true, 21, 4},
                                            {false, 3},
                                            {false, 6},
                                            {false, 10, 4},
                                            {false, 15, 4},
                                            {false, 50, 4}}) {
    SCOPED_TRACE((boxes ? "boxes " : "discs ") + std::to_string(count));
    const BodiesInMotion motion(Pyramid(boxes, count, 0), 0.3, steps);
    ASSERT_EQ(motion.why, "");
    EXPECT_TRUE(motion.simulator.events().empty());
    motion.ExpectRisen(0);
  }
}

TEST(Pyramids, OfBoxesThatAreFlushRest) {
  for (const int count : {3, 6}) {
    SCOPED_TRACE(count);
    const BodiesInMotion motion(Pyramid(/*boxes=*/true, count, 0, 0), 0.3, 8);
    ASSERT_EQ(motion.why, "");
    EXPECT_TRUE(motion.simulator.events().empty());
    motion.ExpectRisen(0);
  }
}

TEST(Pyramids, FallAsOneBody) {
  for (const auto& [boxes, count, steps] :
       {Pile{true, 3}, {true, 6}, {true, 15, 4}, {false, 3}, {false, 6}, {false, 15}}) {
    SCOPED_TRACE((boxes ? "boxes " : "discs ") + std::to_string(count));
    const BodiesInMotion motion(Pyramid(boxes, count, 0.1), 0.1, steps);
    ASSERT_EQ(motion.why, "");
    EXPECT_TRUE(motion.simulator.events().empty());
    motion.ExpectRisen(-0.5 * kGravity * 0.01);
  }
}

// A box slides over the joint of two tables of one height, which has corners of both on its way.
TEST(FlushTables, ABoxSlidesOverTheirJoint) {
  for (const double friction : {0.0, 0.2}) {
    for (const double speed : {1.0, -1.0}) {
      for (const double start : {0.0, 0.2}) {
        SCOPED_TRACE(Line("friction %g, speed %g, start %g", friction, speed, start));
        RigidScene2D scene{.bodies = {}, .planes = {{}}, .restitution = 0.5, .friction = friction};
        for (const double x : {-0.3, 0.3}) {
          scene.bodies.push_back({.name = x < 0 ? "left" : "right",
                                  .polygon = BoxPolygon(0.3, 0.1),
                                  .position = {x, 0.1},
                                  .joint = {RigidJoint2D::Kind::kWeld}});
        }
        scene.bodies.push_back({.name = "box",
                                .polygon = BoxPolygon(0.05, 0.05),
                                .position = {-start * speed, 0.25},
                                .velocity = {speed, 0}});
        const BodiesInMotion motion(scene, 0.3, 0);
        ASSERT_EQ(motion.why, "");
        const std::array<double, 3> pose = motion.bodies.PoseOf(2, motion.simulator.final_state().data());
        EXPECT_NEAR(pose[0], speed * (0.3 - start - 0.5 * friction * kGravity * 0.09), 1e-12);
        EXPECT_NEAR(pose[1], 0.25, 1e-12);
        EXPECT_NEAR(pose[2], 0, 1e-12);
      }
    }
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// A column that counts how often its forces are evaluated.
struct CountedColumn : Column {
  int* evaluations = nullptr;

  template <typename T>
  void Force(const T& t, const T* q, const T* v, const T* u, const T* p, T* h) const {
    ++*evaluations;
    Column::Force(t, q, v, u, p, h);
  }
};

// A rollout asks at every step whether to stop, and ends without another step.
TEST(Interrupts, EndARolloutWithinAStep) {
  for (const int steps : {1 << 20, 0}) {
    SCOPED_TRACE(steps);
    int evaluations = 0, then = -1, after = 0, asked = 0;
    const MechanicalSystem system{CountedColumn{{.count = 3}, &evaluations}};
    HybridInput input{.initial = {0.005, 0.015, 0.025, 0, 0, 0}, .parameters = {0.5}, .duration = 1};
    input.mode = system.FindMode(input.initial, {}, input.parameters).mode;
    const auto stop = [&] {
      // The first rollouts that choose a number of steps have fewer.
      if (++asked < 20) return false;
      if (then < 0) then = evaluations;
      after = evaluations - then;
      return true;
    };
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = steps, .stop = stop});
    EXPECT_FALSE(simulator.Rollout(input));
    EXPECT_THAT(simulator.FailureReason(), HasSubstr("interrupted"));
    after = evaluations - then;
    EXPECT_GE(asked, 20);
    // The bounds are the most evaluations of a rollout before its first step.
    EXPECT_LE(after, 200);
    EXPECT_LE(asked, 40);
  }
}

}  // namespace
}  // namespace saltus
