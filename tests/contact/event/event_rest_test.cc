// Where impacts die out: resting, sliding and rolling-off contact, simultaneous impacts, grazing.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "contact/event/event_queue.h"
#include "contact/event/event_run.h"
#include "contact/random_scene.h"
#include "saltus/simulate/events.h"

namespace saltus {
namespace {

using testing::EventRun;

const Plane kGround{"ground", {0, 0}, {0, 1}};

Scene Dropped(double restitution, double friction, double speed, double duration, int steps) {
  Scene scene;
  scene.duration = duration;
  scene.steps = steps;
  scene.gravity = {0, -9.8};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 2, .position = {0, 1}, .velocity = {speed, 0}}};
  scene.planes = {kGround};
  scene.contact.restitution = restitution;
  scene.contact.friction = friction;
  return scene;
}

// A closed pair changes by its release only, and to free flight; forces close a pair; prediction never does.
TEST(PairStates, TransitionsOfTheTable) {
  using internal::PairChange, internal::PairState;
  int transitions = 0;
  for (int from = 0; from < internal::kNumPairStates; ++from) {
    for (int to = 0; to < internal::kNumPairStates; ++to) {
      const auto f = static_cast<PairState>(from), t = static_cast<PairState>(to);
      const bool was_closed = internal::IsClosed(f), closes = internal::IsClosed(t);
      EXPECT_EQ(IsTransition(f, PairChange::kPredicted, t), !was_closed && !closes) << from << " " << to;
      EXPECT_EQ(IsTransition(f, PairChange::kSettled, t), !was_closed && t != PairState::kWaiting) << from << " " << to;
      EXPECT_EQ(IsTransition(f, PairChange::kReleased, t), was_closed && t == PairState::kFree) << from << " " << to;
      for (const auto change : {PairChange::kPredicted, PairChange::kSettled, PairChange::kReleased}) {
        transitions += IsTransition(f, change, t);
      }
    }
  }
  EXPECT_EQ(transitions, std::ssize(internal::kPairTransitions)) << "a transition is listed twice";
}

TEST(EventRest, ADroppedBallComesToRestAndStays) {
  for (int steps : {1, 9, 1000}) {
    EventRun run(Dropped(0.5, 0, 0, 10, steps));
    const std::vector<double> end = run.End();
    EXPECT_NEAR(end[1], 0.1, 1e-13);
    EXPECT_NEAR(end[3], 0, 1e-13);
    int impacts = 0, sustained = 0;
    for (const StepTouch& touch : run.simulator.touches()) {
      (touch.touch.kind == ContactKind::kSustained ? sustained : impacts) += 1;
    }
    EXPECT_EQ(impacts, 23) << "from 4.2 m/s down by halves to 1e-6 m/s";
    EXPECT_GT(sustained, 0);
    for (double derivative : run.GradientOf(1).initial) EXPECT_NEAR(derivative, 0, 1e-12);
  }
}

TEST(EventRest, RestIsOneEventHoweverManySteps) {
  for (int steps : {1, 9, 1000}) {
    EventRun run(Dropped(0.5, 0, 0, 10, steps));
    EXPECT_EQ(EventsOf(run.simulator).size(), 24u) << "23 impacts, and then rest";
  }
}

// The sum of all impulses is known in closed form, so is where friction stops the ball.
TEST(EventRest, ABouncingBallIsStoppedByFriction) {
  const double mu = 0.1, e = 0.5, v0 = 3, g = 9.8, fall = std::sqrt(2 * 0.9 / g), down = g * fall;
  // Every impact slips. Bounces last 2 e^k down / g and take mu (1 + e) e^k down from the speed.
  double x = v0 * fall, v = v0, bounce = down;
  while (bounce > 1e-9) {
    v -= mu * (1 + e) * bounce;
    bounce *= e;
    x += v * 2 * bounce / g;
  }
  x += v * v / (2 * mu * g);
  for (int steps : {1, 11, 500}) {
    EventRun run(Dropped(e, mu, v0, 10, steps));
    const std::vector<double> end = run.End();
    EXPECT_NEAR(end[0], x, 1e-6);
    EXPECT_NEAR(end[1], 0.1, 1e-13);
    EXPECT_NEAR(end[2], 0, 1e-12);
    EXPECT_EQ(run.simulator.touches().back().touch.mode, ContactMode::kStick);
  }
}

// Whenever steps begin, amid the last of the bounces too: friction has its share of all normal impulses, which make up
// for gravity and for the speed along the normal at the start.
TEST(EventRest, AStepMayBeginAmidTheLastBounce) {
  const double mu = 0.05, e = 0.5, v0 = 3, g = 9.8, fall = std::sqrt(2 * 0.9 / g), down = g * fall;
  double time = fall, bounce = e * down;
  for (; e * bounce > 1e-6; bounce *= e) time += 2 * bounce / g;
  for (const double part : {0.2, 0.4, 0.6, 0.8}) {
    const double begin = time + part * 2 * bounce / g;
    EventRun run(Dropped(e, mu, v0, 2 * begin, 2));
    EXPECT_NEAR(run.End()[2], v0 - mu * g * 2 * begin, 1e-9);
    const Sensitivity gradient = run.GradientOf(2);
    EXPECT_NEAR(gradient.initial[1], 0, 1e-6) << part;
    EXPECT_NEAR(gradient.initial[3], mu, 1e-6) << part;
  }
}

// Down a slope: sticks below the friction angle, slides with g (sin - mu cos) above.
TEST(EventRest, Slope) {
  for (double angle : {0.2, 0.6}) {
    const double mu = 0.4, g = 9.8;
    Scene scene = Dropped(0.3, mu, 0, 1, 50);
    const Vec2d normal(std::sin(angle), std::cos(angle)), down(std::cos(angle), -std::sin(angle));
    scene.planes = {{"slope", {0, 0}, normal}};
    scene.bodies[0].position = 0.1 * normal;
    EventRun run(scene);
    const std::vector<double> end = run.End();
    const Vec2d p(end[0], end[1]), v(end[2], end[3]);
    const double a = std::tan(angle) < mu ? 0.0 : g * (std::sin(angle) - mu * std::cos(angle));
    EXPECT_NEAR(Dot(normal, p), 0.1, 1e-13);
    EXPECT_NEAR(Dot(down, p), 0.5 * a, 1e-12);
    EXPECT_NEAR(Dot(down, v), a, 1e-12);
    if (a > 0) {
      const Sensitivity gradient = run.GradientOf(0);
      EXPECT_NEAR(gradient.parameters.friction, -0.5 * g * std::cos(angle) * down[0], 1e-11);
      // Lifted, it falls without friction: it is mu times the height further down.
      EXPECT_NEAR(gradient.initial[0], down[0] * (down[0] + mu * normal[0]), 1e-12);
      EXPECT_NEAR(gradient.initial[1], down[0] * (down[1] + mu * normal[1]), 1e-12);
    }
  }
}

TEST(EventRest, SlidingStopsAndTheForceThatStartsItAgain) {
  Scene scene = Dropped(0.3, 0.5, 2, 1, 4);
  scene.bodies[0].position = {0, 0.1};
  scene.control = {{0}, {Vec2d(0, 0)}};
  EventRun run(scene);
  EXPECT_NEAR(run.End()[0], 4 / (2 * 0.5 * 9.8), 1e-12);
  EXPECT_EQ(run.End()[2], 0);
  const Sensitivity gradient = run.GradientOf(0);
  EXPECT_NEAR(gradient.initial[2], 2 * 2 / (2 * 0.5 * 9.8), 1e-11) << "v^2 / (2 mu g)";
  EXPECT_NEAR(gradient.parameters.friction, -4 / (2 * 0.25 * 9.8), 1e-11);

  scene.bodies[0].velocity = {0, 0};
  for (double push : {9.7, 9.9}) {  // mu m g = 9.8 N
    scene.control.initial = {Vec2d(push, 0)};
    EXPECT_NEAR(EventRun(scene).End()[0], 0.5 * std::max(0.0, push - 9.8) / 2, 1e-12);
  }
  scene.control.initial = {Vec2d(0, 20)};  // more than its weight
  EXPECT_NEAR(EventRun(scene).End()[1], 0.1 + 0.5 * (20 - 19.6) / 2, 1e-12);
}

TEST(EventRest, APileInACornerStays) {
  Scene scene = Dropped(0.4, 0, 0, 10, 300);
  scene.planes = {{"left", {0, 0}, {1, 1}}, {"right", {0, 0}, {-1, 1}}};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 2, .position = {0, 0.5}},
                  {.name = "b", .radius = 0.1, .mass = 1, .position = {0.001, 1}},
                  {.name = "c", .radius = 0.1, .mass = 3, .position = {-0.3, 1.5}}};
  for (double friction : {0.0, 0.3}) {
    scene.contact.friction = friction;
    EventRun run(scene);
    const std::vector<double> before = run.State(290), end = run.End();
    for (int i = 0; i < 12; ++i) {
      EXPECT_NEAR(end[i], before[i], 1e-9) << i;
      if (i % 4 >= 2) {
        EXPECT_NEAR(end[i], 0, 1e-9);
      }
    }
  }
}

// One disc slides off a fixed one without friction: it leaves where cos(angle) = 2/3 of the start's height, by energy.
TEST(EventRest, SlidingOffADisc) {
  Scene scene = Dropped(0.3, 0, 0, 0.9, 900);
  const double start = 0.1, reach = 0.5;
  scene.planes.clear();
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {reach * std::sin(start), reach * std::cos(start)}},
                  {.name = "hill", .radius = 0.4, .fixed = true}};
  EventRun run(scene);
  for (int k = 0; k <= scene.steps; ++k) {
    const std::vector<double> x = run.State(k);
    const double distance = std::hypot(x[0], x[1]);
    ASSERT_GT(distance, reach - 1e-9);
    const double energy = 0.5 * (x[2] * x[2] + x[3] * x[3]) + 9.8 * x[1];
    EXPECT_NEAR(energy, 9.8 * reach * std::cos(start), 1e-9);
  }
  const std::vector<double> leaving = run.State(run.simulator.touches().back().step);
  EXPECT_NEAR(leaving[1] / reach, 2.0 / 3 * std::cos(start), 0.003) << "one step changes it by 0.0026";
}

// A disc that is lifted as it slides around another has more angular momentum, so it goes on faster when its bounces
// are over. The bounces take a time of the order of the square root of the lift, by which the difference is off.
TEST(EventRest, LiftedAsItSlidesOffADisc) {
  const double start = 0.1, reach = 0.5, speed = 0.8, lift = 1e-6;
  const Vec2d normal(std::sin(start), std::cos(start)), tangent(std::cos(start), -std::sin(start));
  Scene scene = Dropped(0.3, 0, 0, 0.1, 4);
  scene.planes.clear();
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = reach * normal, .velocity = speed * tangent},
                  {.name = "hill", .radius = 0.4, .fixed = true}};
  Scene lifted = scene;
  lifted.bodies[0].position += lift * normal;
  EventRun run(scene), lifted_run(lifted);
  for (int i = 0; i < 4; ++i) {
    const std::vector<double> by = run.GradientOf(i).initial;
    const double difference = (lifted_run.End()[i] - run.End()[i]) / lift;
    EXPECT_NEAR(normal[0] * by[0] + normal[1] * by[1], difference, 4e-3) << i;
    EXPECT_GT(std::abs(difference), 0.01) << i;
  }
}

// Contact forces without friction do no work, also if an impact elsewhere ends the sliding of a pair early.
TEST(EventRest, SlidingAlongDiscsDoesNoWork) {
  Scene scene = Dropped(1, 0, 0, 0.4, 10);
  scene.bodies = {{.name = "lowest", .radius = 0.125, .mass = 1.6, .position = {0, 0.125}, .velocity = {-0.7, 0}},
                  {.name = "middle", .radius = 0.125, .mass = 2.6, .position = {0, 0.375}},
                  {.name = "top", .radius = 0.125, .mass = 0.4, .position = {0, 0.625}}};
  scene.planes.push_back({"wall", {-0.2, 0}, {1, 0}});
  EventRun run(scene);
  int impacts = 0;
  for (const StepTouch& touch : run.simulator.touches()) impacts += touch.touch.kind == ContactKind::kImpact;
  EXPECT_GT(impacts, 0);
  const auto energy = [&](int k) {
    const std::vector<double> x = run.State(k);
    double sum = 0;
    for (int i = 0; i < 3; ++i) {
      const double* of = &x[4 * i];
      sum += scene.bodies[i].mass * (0.5 * (of[2] * of[2] + of[3] * of[3]) + 9.8 * of[1]);
    }
    return sum;
  };
  for (int k = 1; k <= scene.steps; ++k) EXPECT_LE(energy(k), energy(k - 1) + 1e-9) << k;
}

// In a pile what stops one pair makes the next close.
// The lower disc touches the wall and is not pressed against it; as the upper one is pushed along it, their normal
// turns, and then it is.
TEST(EventRest, AWallThatIsTouchedIsMetAsNormalsTurn) {
  Scene scene = Dropped(0.4, 0, 0, 0.02, 3);
  scene.bodies = {{.name = "lower", .radius = 0.125, .mass = 0.84, .position = {0, 0.125}},
                  {.name = "upper", .radius = 0.125, .mass = 1.6, .position = {0, 0.375}}};
  scene.planes.push_back({"wall", {-0.125, 0}, {1, 0}});
  scene.control = {{1}, {Vec2d(1.26, -1.1)}};
  EventRun run(scene);
  for (int k = 0; k <= scene.steps; ++k) {
    const std::vector<double> x = run.State(k);
    EXPECT_GT(x[0], -1e-10) << k;
    EXPECT_GT(Vec2d(x[4] - x[0], x[5] - x[1]).norm() - 0.25, -1e-10) << k;
  }
  EXPECT_GT(run.End()[6], 1e-3);
}

// Two discs, one of them on the ground, close so slowly that they do not bounce, and that turns the slow sliding of the
// one round. Held by friction, they stay.
TEST(EventRest, FrictionDoesNotPushWhereSlidingIsTurnedRound) {
  Scene scene = Dropped(0, 0.5, 0, 1, 10);
  scene.bodies = {{.name = "light", .radius = 0.1, .mass = 1, .position = {0, 0.1}, .velocity = {5e-7, 0}},
                  {.name = "heavy", .radius = 0.1, .mass = 10, .position = {0.2, 0.1}, .velocity = {-4e-7, 0}}};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.control = {{0, 1}, {Vec2d(3, 0), Vec2d(-3, 98)}};
  EventRun run(scene);
  const std::vector<double> end = run.End();
  EXPECT_NEAR(end[0], 0, 1e-9);
  EXPECT_NEAR(end[4], 0.2, 1e-9);
  EXPECT_NEAR(end[2], 0, 1e-12);
  EXPECT_NEAR(end[6], 0, 1e-12);
}

TEST(EventRest, APileWithoutFrictionSettles) {
  testing::RandomScenes random(2);
  Scene scene = Dropped(0.5, 0, 0, 0.7, 34);
  scene.bodies.clear();
  scene.planes = {kGround, {"left", {-0.5, 0}, {1, 0}}, {"right", {0.5, 0}, {-1, 0}}};
  for (int i = 0; i < 15; ++i) {
    const Vec2d at(0.24 * (i % 4) - 0.36 + random.Uniform(-0.01, 0.01), 0.26 * (i / 4) + random.Uniform(0.13, 0.14));
    scene.bodies.push_back({.name = "disc" + std::to_string(i),
                            .radius = random.Uniform(0.09, 0.105),
                            .mass = random.Uniform(0.5, 2),
                            .position = at,
                            .velocity = random.InSquare(0.5)});
  }
  EXPECT_TRUE(EventRun(scene).finite);
}

// Two discs pushed against each other off their line of centres: momentum, and no overlap.
TEST(EventRest, PushedDiscsTurnAroundEachOther) {
  Scene scene;
  scene.steps = 40;
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {0, 0}},
                  {.name = "b", .radius = 0.2, .mass = 2, .position = {0.4, 0}}};
  scene.contact.restitution = 0.5;
  scene.control = {{0, 1}, {Vec2d(3, 0.2), Vec2d(-1, 0)}};
  for (double friction : {0.0, 0.05, 0.5}) {
    scene.contact.friction = friction;
    EventRun run(scene);
    for (int k = 0; k <= scene.steps; ++k) {
      const std::vector<double> x = run.State(k);
      EXPECT_GT(std::hypot(x[0] - x[4], x[1] - x[5]), 0.4 - 1e-9);
      EXPECT_NEAR(x[2] + 2 * x[6], 2 * k / 40.0, 1e-12);
      EXPECT_NEAR(x[3] + 2 * x[7], 0.2 * k / 40.0, 1e-12);
    }
  }
}

TEST(EventSimultaneous, NewtonsCradle) {
  Scene scene;
  scene.steps = 3;
  for (int i = 0; i < 5; ++i) {
    scene.bodies.push_back(
        {.name = std::string(1, 'a' + i), .radius = 0.1, .position = {0.2 * i, 0}, .velocity = {0, 0}});
  }
  scene.bodies[0].position[0] = -0.3;
  scene.bodies[0].velocity[0] = 1;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(end[4 * i + 2], 0, 1e-12);
  EXPECT_NEAR(end[4 * 4 + 2], 1, 1e-12);
  EXPECT_NEAR(end[4 * 4], 0.8 + 0.7, 1e-12);

  // Mirrored: the last hits the first.
  for (int i = 0; i < 5; ++i) {
    scene.bodies[i].position = {0.2 * i, 0};
    scene.bodies[i].velocity = {0, 0};
  }
  scene.bodies[4].position[0] = 1.1;
  scene.bodies[4].velocity[0] = -1;
  const std::vector<double> mirrored = EventRun(scene).End();
  for (int i = 0; i < 5; ++i) {
    EXPECT_NEAR(mirrored[4 * i], 0.8 - end[4 * (4 - i)], 1e-12);
    EXPECT_NEAR(mirrored[4 * i + 2], -end[4 * (4 - i) + 2], 1e-12);
  }
}

TEST(EventSimultaneous, CornerOfTwoPlanes) {
  Scene scene;
  scene.steps = 5;
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {0.6, 0.6}, .velocity = {-1, -1}}};
  scene.planes = {kGround, {"wall", {0, 0}, {1, 0}}};
  scene.contact.restitution = 0.7;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  EXPECT_NEAR(end[0], 0.1 + 0.7 * 0.5, 1e-12);
  EXPECT_NEAR(end[1], 0.1 + 0.7 * 0.5, 1e-12);
  EXPECT_NEAR(end[2], 0.7, 1e-12);
  EXPECT_NEAR(end[3], 0.7, 1e-12);
  EXPECT_EQ(run.simulator.touches().size(), 2u);
  EXPECT_NEAR(run.GradientOf(0).initial[0], -0.7, 1e-12);
  EXPECT_NEAR(run.GradientOf(0).initial[1], 0, 1e-12);
}

TEST(EventGrazing, IsFlaggedAndFinite) {
  // Along the ground, and past a disc, with the gap closing to zero exactly and to within rounding.
  for (double dip : {0.0, 1e-16, -1e-16, 1e-12, -1e-12}) {
    Scene scene;
    scene.steps = 4;
    scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1, 0.5 + dip}, .velocity = {2, 0}},
                    {.name = "b", .radius = 0.4, .position = {0, 0}}};
    scene.contact.friction = 0.3;
    EventRun run(scene);
    const std::vector<double> end = run.End();
    EXPECT_NEAR(end[0], 1, 1e-5);
    EXPECT_NEAR(end[3], 0, 1e-5);
    const Sensitivity gradient = run.GradientOf(1);
    for (double derivative : gradient.initial) EXPECT_TRUE(std::isfinite(derivative));
    for (const StepTouch& touch : run.simulator.touches()) {
      if (touch.touch.kind != ContactKind::kGrazing) continue;
      EXPECT_NEAR(gradient.initial[1], 1, 1e-12) << "that of the side which does not touch";
    }
  }
}

// From a stack that has fallen over: after an impact two discs touch with speeds across and along the normal of 1e-33
// m/s or so, as one is pushed along the other. In natural units rounding closed their gap at once, again and again.
TEST(EventGrazing, IsPassedOnceWhereRoundingClosesTheGapAgain) {
  const struct {
    Vec2d position, velocity;
  } starts[] = {{{0.07950189345069789, 0.1}, {-0.032175644704634423, 0}},
                {{-0.5807874484604614, 0.1}, {-1.9418349672750452, 0}},
                {{-0.3789543986598207, 0.1}, {-2.4608215983984025, 0}},
                {{-0.25931208314493226, 0.26026763971006717}, {-1.5256735801720094, -0.6981027140111861}},
                {{0.046194749063566784, 0.29985865507743326}, {1.0965177074978842, -2.8010546820028384}},
                {{-0.10341022260076513, 0.4406364836290785}, {-0.9733693799360298, -4.173292174361458}}};
  Scene scene = Dropped(0, 0, 0, 0.25, 60);
  scene.bodies.clear();
  for (const auto& [position, velocity] : starts) {
    scene.bodies.push_back({.name = "disc" + std::to_string(scene.bodies.size()),
                            .radius = 0.1,
                            .position = position,
                            .velocity = velocity});
  }
  const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), {}));
  EXPECT_EQ(NumUnresolvedSteps(*simulator), 0);
}

}  // namespace
}  // namespace saltus
