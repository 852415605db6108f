// Many discs in lasting contact: stacks, piles, rows and cradles, by exact references, differences and Jets.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "contact/event/event.h"
#include "contact/event/event_run.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/exact_run.h"
#include "scene/scene_generators.h"

namespace saltus {
namespace {

using testing::EventRun;

constexpr double kRadius = 0.1;

Scene Empty(double friction, double duration, int steps) {
  Scene scene;
  scene.duration = duration;
  scene.steps = steps;
  scene.gravity = {0, -9.8};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact.restitution = 0.5;
  scene.contact.friction = friction;
  return scene;
}

void AddDisc(const Vec2d& position, double mass, Scene* scene) {
  const std::string name = "disc" + std::to_string(scene->bodies.size());
  scene->bodies.push_back({.name = name, .radius = kRadius, .mass = mass, .position = position});
}

Scene Stack(int discs, double friction, double duration, int steps) {
  Scene scene = Empty(friction, duration, steps);
  for (int i = 0; i < discs; ++i) AddDisc({0, kRadius * (2 * i + 1)}, 1 + 0.1 * (i % 3), &scene);
  return scene;
}

// Rows of discs in the gaps of those below, between walls.
Scene Pile(int levels, double friction, double duration, int steps) {
  Scene scene = Empty(friction, duration, steps);
  for (int level = 0; level < levels; ++level) {
    for (int i = 0; i < levels - level; ++i) {
      const Vec2d position(kRadius * (2 * i + level), kRadius * (1 + std::sqrt(3.0) * level));
      AddDisc(position, 1 + 0.1 * (i % 3), &scene);
    }
  }
  scene.planes.push_back({"left", {-kRadius, 0}, {1, 0}});
  scene.planes.push_back({"right", {kRadius * (2 * levels - 1), 0}, {-1, 0}});
  return scene;
}

std::vector<double> Cotangent(std::size_t size) {
  std::vector<double> cotangent(size);
  for (std::size_t i = 0; i < size; ++i) cotangent[i] = std::sin(1.0 + 2.0 * static_cast<double>(i));
  return cotangent;
}

// Compares the reverse sweep (on a tape) of a cotangent through one step with the Jacobian by Jets.
void ExpectTapeAsJets(const Scene& scene, double tolerance) {
  Scene one = scene;
  one.duration /= one.steps;
  one.steps = 1;
  one.control.bodies.clear();
  for (int i = 0; i < one.num_bodies(); ++i) one.control.bodies.push_back(i);
  one.control.initial.assign(one.num_bodies(), Vec2d(0.1, -0.2));
  EventRun run(one);
  const int n = one.num_bodies();
  ASSERT_GE(n, EventDriven::kTapedFrom);
  const std::vector<double> cotangent = Cotangent(4 * n);
  Sensitivity gradient;
  run.simulator.Adjoint(cotangent, true, &gradient);
  StepLinearization step;
  run.simulator.Linearize(run.State(0), run.control, /*with_parameters=*/true, &step);
  ASSERT_EQ(step.islands.size(), 1u) << "this compares what all discs have in common";
  const StepLinearization::Island& island = step.islands[0];
  ASSERT_EQ(static_cast<int>(island.bodies.size()), n);
  const Eigen::Map<const Eigen::VectorXd> after(cotangent.data(), 4 * n);
  const Eigen::VectorXd state = island.A.transpose() * after, force = island.B.transpose() * after;
  const Eigen::VectorXd parameters = island.P.transpose() * after;
  const double size = std::max({1.0, state.lpNorm<Eigen::Infinity>(), parameters.lpNorm<Eigen::Infinity>()});
  for (int i = 0; i < 4 * n; ++i) EXPECT_NEAR(gradient.initial[i], state[i], tolerance * size) << i;
  for (int i = 0; i < 2 * n; ++i) EXPECT_NEAR(gradient.control[i], force[i], tolerance * size) << i;
  EXPECT_NEAR(gradient.parameters.restitution, parameters[0], tolerance * size);
  EXPECT_NEAR(gradient.parameters.friction, parameters[1], tolerance * size);
  for (int i = 0; i < n; ++i) EXPECT_NEAR(gradient.parameters.mass[i], parameters[4 + i], tolerance * size) << i;
}

TEST(EventPiles, AStackStays) {
  for (const double friction : {0.0, 0.5}) {
    EventRun run(Stack(80, friction, 0.5, 50));
    const std::vector<double> start = run.State(0), end = run.End();
    for (std::size_t i = 0; i < end.size(); ++i) EXPECT_NEAR(end[i], start[i], 1e-12) << i;
    EXPECT_EQ(run.simulator.touches().size(), 50u * 80u);
  }
}

// Its contacts are redundant: which of them are active is not unique, the motion of the discs is.
TEST(EventPiles, APileStays) {
  for (const double friction : {0.0, 0.5}) {
    EventRun run(Pile(8, friction, 0.2, 20));
    const std::vector<double> start = run.State(0), end = run.End();
    for (std::size_t i = 0; i < end.size(); ++i) EXPECT_NEAR(end[i], start[i], 1e-11) << i;
  }
}

// A frictionless stack, pushed sideways at its top, buckles: all its contacts last, and turn.
TEST(EventPiles, TheGradientOfAStackEqualsDifferences) {
  Scene scene = Stack(30, 0, 0.1, 10);
  scene.control = {{29}, {Vec2d(0.5, -1)}};
  EventRun run(scene);
  const std::vector<double> cotangent = Cotangent(4 * 30);
  Sensitivity gradient;
  run.simulator.Adjoint(cotangent, true, &gradient);
  Vec2d derivative(0, 0);
  for (std::size_t k = 0; k < gradient.control.size(); k += 2) {
    derivative += Vec2d(gradient.control[k], gradient.control[k + 1]);
  }
  const auto along = [&](const Vec2d& force) {
    scene.control.initial = {force};
    const std::vector<double> end = EventRun(scene).End();
    double sum = 0;
    for (std::size_t i = 0; i < end.size(); ++i) sum += cotangent[i] * end[i];
    return sum;
  };
  const double by = 1e-4;
  for (int j = 0; j < 2; ++j) {
    Vec2d step(0, 0);
    step[j] = by;
    const double difference = (along(Vec2d(0.5, -1) + step) - along(Vec2d(0.5, -1) - step)) / (2 * by);
    EXPECT_NEAR(derivative[j], difference, 1e-6 * derivative.norm()) << j;
  }
}

TEST(EventPiles, ATapeGivesWhatJetsGive) {
  ExpectTapeAsJets(Stack(6, 0, 0.01, 1), 1e-11);
  ExpectTapeAsJets(Stack(40, 0, 0.01, 1), 1e-9);
  ExpectTapeAsJets(Stack(40, 0.5, 0.01, 1), 1e-9);
  Scene sliding = Stack(40, 0.2, 0.01, 1);
  for (Body& body : sliding.bodies) body.velocity = {1, 0};
  ExpectTapeAsJets(sliding, 1e-9);
  Scene rolling = Stack(20, 0, 0.001, 1);  // without friction all roll off each other
  for (int i = 0; i < 20; ++i) rolling.bodies[i].velocity = {0.05 * std::sin(i), 0};
  ExpectTapeAsJets(rolling, 1e-9);
  ExpectTapeAsJets(Pile(6, 0, 0.01, 1), 1e-8);
  ExpectTapeAsJets(Pile(6, 0.5, 0.01, 1), 1e-8);
}

// Discs of many sizes, to be dropped into a box.
Scene Bag(int n, double friction, double restitution, double duration, int steps) {
  const int width = static_cast<int>(std::lround(std::sqrt(n)));
  Scene scene = Empty(friction, duration, steps);
  scene.contact.restitution = restitution;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int i = 0; i < n; ++i) {
    const double radius = kRadius * (1 + 0.1 * uniform(random));
    const double x = 0.15 + 0.25 * (i % width) + 0.01 * uniform(random);
    AddDisc({x, 0.15 + 0.25 * (i / width) + 0.01 * uniform(random)}, 1, &scene);
    scene.bodies.back().radius = radius;
  }
  scene.planes.push_back({"left", {0, 0}, {1, 0}});
  scene.planes.push_back({"right", {0.25 * width + 0.05, 0}, {-1, 0}});
  return scene;
}

// Nothing overlaps and no energy is gained on the way. Returns the kinetic energy at the end.
double ExpectNoOverlapAndNoGain(const EventRun& run) {
  const Scene& scene = run.simulator.scene();
  double before = HUGE_VAL, kinetic = 0;
  for (int k = 0; k <= scene.steps; ++k) {
    const std::vector<double> x = run.State(k);
    double energy = kinetic = 0;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      const Vec2d p(x[4 * i], x[4 * i + 1]), v(x[4 * i + 2], x[4 * i + 3]);
      kinetic += 0.5 * scene.bodies[i].mass * v.squaredNorm();
      energy -= scene.bodies[i].mass * Dot(scene.gravity, p);
      for (const Plane& plane : scene.planes) {
        const Vec2d normal = plane.normal.normalized(), above = p - plane.point;
        EXPECT_GT(Dot(normal, above) - scene.bodies[i].radius, -1e-9) << i << " in step " << k;
      }
      for (int j = 0; j < i; ++j) {
        const double touch = scene.bodies[i].radius + scene.bodies[j].radius;
        EXPECT_GT((p - Vec2d(x[4 * j], x[4 * j + 1])).norm() - touch, -1e-9) << i << " and " << j << " in step " << k;
      }
    }
    EXPECT_LE(energy + kinetic, before + 1e-9) << "step " << k;
    before = energy + kinetic;
  }
  return kinetic;
}

TEST(EventPiles, ABagSettles) { EXPECT_LT(ExpectNoOverlapAndNoGain(EventRun(Bag(40, 0.3, 0.3, 3, 300))), 1e-20); }

// Without friction each bounce within the pile sets off others; these must end, at every length of the steps. Nothing
// ends a last slow slide.
TEST(EventPiles, ABagWithoutFrictionSettles) {
  for (const int steps : {30, 300}) {
    EXPECT_LT(ExpectNoOverlapAndNoGain(EventRun(Bag(14, 0, 0.5, 4, steps))), 1e-6) << steps;
  }
}

TEST(EventPiles, AValleyWithoutFrictionFills) {
  Scene scene = Bag(16, 0, 0.5, 5, 250);
  scene.planes = {{"left", {0.5, -0.5}, {1, 1}}, {"right", {0.5, -0.5}, {-1, 1}}};
  EXPECT_LT(ExpectNoOverlapAndNoGain(EventRun(scene)), 1e-6);
}

// At their first impact on the ground, with all above them still falling.
TEST(EventPiles, ManyDiscsBecomeAPile) { ExpectNoOverlapAndNoGain(EventRun(Bag(50, 0, 0.5, 0.36, 36))); }

// Returns a bag in which every other row falls into the gaps of the one below.
Scene StaggeredBag(int n, double friction, double duration, int steps) {
  Scene scene = Bag(n, friction, 0.3, duration, steps);
  const int width = static_cast<int>(std::lround(std::sqrt(n)));
  for (int i = 0; i < n; ++i) scene.bodies[i].position[0] += i / width % 2 * 0.1;
  scene.planes.back().point[0] += 0.1;
  return scene;
}

// Steps that are taken at once: of contacts that are no events.
int NumStepsAtOnce(const EventRun& run) {
  std::vector<char> at_once(run.simulator.num_steps());
  for (const StepTouch& at : run.simulator.touches()) at_once[at.step] = at_once[at.step] || at.touch.time < 0;
  return static_cast<int>(std::ranges::count(at_once, 1));
}

// Without calming, a step of all impacts would have so many that it fails, and be taken at once.
TEST(EventPiles, ABagWithoutFrictionSettlesWithinAStep) {
  for (const int discs : {9, 14}) {
    const EventRun run(Bag(discs, 0, 0.8, 4, 1));
    EXPECT_LT(ExpectNoOverlapAndNoGain(run), 1e-12) << discs;
    EXPECT_EQ(NumStepsAtOnce(run), 0) << discs;
  }
}

TEST(EventPiles, AJammedBagSettles) {
  for (const double friction : {0.0, 0.3}) {
    const EventRun run(StaggeredBag(50, friction, 2, 400));
    EXPECT_LT(ExpectNoOverlapAndNoGain(run), friction > 0 ? 1e-15 : 1) << friction;
    EXPECT_GT(NumStepsAtOnce(run), 20) << friction;
  }
}

// Hundreds of contacts that depend on each other, at once while the discs come down and as they rest.
TEST(EventPiles, APileOfManySettles) {
  EXPECT_LT(ExpectNoOverlapAndNoGain(EventRun(FallingPile({.discs = 100, .duration = 2, .steps = 400}, 1))), 1e-15);
}

// A pile at rest does not move, and needs no step of the fallback.
TEST(EventPiles, ABagThatRestsStays) {
  Scene scene = StaggeredBag(50, 0.3, 2, 400);
  const EventRun run(scene);
  const std::vector<double> end = run.End(), before = run.State(390);
  for (std::size_t i = 0; i < end.size(); ++i) EXPECT_NEAR(end[i], before[i], 1e-9) << i;
}

// By velocities, forces and friction, wherever the difference to one side is that to the other.
TEST(EventPiles, TheGradientOfStepsTakenAtOnceEqualsDifferences) {
  for (const double friction : {0.0, 0.3}) {
    const int n = 50;
    const Scene scene = StaggeredBag(n, friction, 2, 400);
    const EventRun whole(scene);
    const std::vector<double> cotangent = Cotangent(4 * n), direction = Cotangent(4 * n), push = Cotangent(2 * n);
    Scene part = scene;
    part.steps = 1;
    part.duration = scene.duration / scene.steps;
    for (int i = 0; i < n; ++i) part.control.bodies.push_back(i);
    part.control.initial.assign(n, Vec2d(0, 0));
    int smooth = 0;
    for (int k = 50; k < 150; k += 3) {
      const std::vector<double> start = whole.State(k);
      const auto after = [&](double by, double by_friction, Simulator* simulator) {
        std::vector<double> x = start, force = push;
        Scene moved = part;
        moved.contact.friction += by_friction * by;
        const std::unique_ptr<Simulator> made_own = testing::MakeEventSimulator(moved);
        Simulator& own = *made_own;
        if (simulator == nullptr) simulator = &own;
        for (int i = 0; i < 4 * n; ++i) x[i] += i % 4 < 2 ? 0 : by * direction[i];
        for (double& entry : force) entry *= by;
        EXPECT_TRUE(simulator->Rollout(x, force));
        simulator->GetState(1, x);
        return std::inner_product(x.begin(), x.end(), cotangent.begin(), 0.0);
      };
      const double by = 1e-5, by_friction = friction > 0 ? 1 : 0;
      const double more = after(by, by_friction, nullptr), less = after(-by, by_friction, nullptr);
      const std::unique_ptr<Simulator> made_simulator = testing::MakeEventSimulator(part);
      Simulator& simulator = *made_simulator;
      const double here = after(0, 0, &simulator);
      const bool at_once =
          std::ranges::any_of(simulator.touches(), [](const StepTouch& at) { return at.touch.time < 0; });
      if (!at_once || std::abs((more - here) - (here - less)) > 1e-4 * std::abs(more - less)) continue;
      Sensitivity gradient;
      simulator.Adjoint(cotangent, true, &gradient);
      double exact = std::inner_product(push.begin(), push.end(), gradient.control.begin(), 0.0) +
                     by_friction * gradient.parameters.friction;
      for (int i = 0; i < 4 * n; ++i) exact += i % 4 < 2 ? 0 : direction[i] * gradient.initial[i];
      ++smooth;
      // The tolerance is relative to the sum of the terms at both ends, as some gradients are far smaller.
      double terms = 0;
      for (int i = 0; i < 4 * n; ++i) terms += std::abs(start[i] * cotangent[i]);
      const double rounding = std::numeric_limits<double>::epsilon() * terms / by;
      EXPECT_NEAR(exact, (more - less) / (2 * by), 1e-5 * std::abs(exact) + rounding)
          << "step " << k << ", friction " << friction;
    }
    EXPECT_GT(smooth, 3) << friction;
  }
}

// By forces on all discs, on the way to rest: wherever the difference to one side is that to the other.
TEST(EventPiles, TheGradientOfASettlingBagEqualsDifferences) {
  const Scene scene = Bag(14, 0, 0.5, 2, 200);
  const EventRun whole(scene);
  const std::vector<double> cotangent = Cotangent(4 * 14), direction = Cotangent(2 * 14);
  Scene part = scene;
  part.steps = 1;
  part.duration = scene.duration / scene.steps;
  for (int i = 0; i < 14; ++i) part.control.bodies.push_back(i);
  part.control.initial.assign(14, Vec2d(0, 0));
  const std::unique_ptr<Simulator> made_simulator = testing::MakeEventSimulator(part);
  Simulator& simulator = *made_simulator;
  int smooth = 0;
  for (int k = 40; k < 200; k += 8) {
    const auto after = [&](double by) {
      std::vector<double> force = direction, x(4 * 14);
      for (double& entry : force) entry *= by;
      EXPECT_TRUE(simulator.Rollout(whole.State(k), force));
      simulator.GetState(1, x);
      return std::inner_product(x.begin(), x.end(), cotangent.begin(), 0.0);
    };
    const double by = 1e-5, more = after(by), less = after(-by), here = after(0);
    Sensitivity gradient;
    simulator.Adjoint(cotangent, false, &gradient);
    const double exact = std::inner_product(direction.begin(), direction.end(), gradient.control.begin(), 0.0);
    if (std::abs((more - here) - (here - less)) > 1e-4 * std::abs(more - less)) continue;
    ++smooth;
    EXPECT_NEAR(exact, (more - less) / (2 * by), 1e-4 * std::abs(exact)) << k;
  }
  EXPECT_GT(smooth, 5);
}

// A step of first order is no reference: there is no exact motion, and no exact gradient.
TEST(EventPiles, StepsTakenAtOnceAreNoReference) {
  Scene scene = StaggeredBag(50, 0.3, 0.5, 100);
  scene.objective.terminal = {{.body = 0, .target = {0, 0}, .weight = 1}};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  const ModelGradient own = ComputeGradient("event", scene, Precision::kDouble);
  ASSERT_TRUE(own.ok()) << own.reason;
  EXPECT_GT(own.unresolved_steps, 10);
  EXPECT_FALSE(ComputeExactGradient(scene));
  const ExactRun run = SimulateExactly(scene, InitialState(scene), {});
  EXPECT_FALSE(run.ok);
  EXPECT_EQ(run.reason, "there is no exact motion: " + DescribeUnresolved(own.unresolved_steps, scene.steps));
  EXPECT_EQ(DescribeUnresolved(12, 400),
            "12 of 400 steps use the time-stepping fallback, as impacts of many discs accumulate in them");
  ModelAudit audit;
  audit.gradient = own;
  EXPECT_EQ(audit.VerdictReason(), DescribeUnresolved(own.unresolved_steps, scene.steps));
}

// A row of discs that touch, struck at one end: the last leaves, at its speed, and all others stay.
TEST(EventPiles, ACradleOfFifty) {
  const int n = 50;
  Scene scene = Empty(0, 1, 20);
  scene.gravity = {0, 0};
  scene.planes.clear();
  scene.contact.restitution = 1;
  for (int i = 0; i < n; ++i) AddDisc({2 * kRadius * i, 0}, 2, &scene);
  scene.bodies[0].position[0] = -0.63;
  scene.bodies[0].velocity[0] = 1.7;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  const double gap = 0.63, last = 2 * kRadius * (n - 1);
  for (int i = 0; i + 1 < n; ++i) EXPECT_NEAR(end[4 * i], 2 * kRadius * i, 1e-12) << i;
  EXPECT_NEAR(end[4 * (n - 1)], last + 1.7 - gap, 1e-12);
  EXPECT_NEAR(end[4 * (n - 1) + 2], 1.7, 1e-12);
  const Sensitivity gradient = run.GradientOf(4 * (n - 1));
  EXPECT_NEAR(gradient.initial[0], 1, 1e-11);
  EXPECT_NEAR(gradient.initial[2], 1, 1e-11) << "the duration";
}

}  // namespace
}  // namespace saltus
