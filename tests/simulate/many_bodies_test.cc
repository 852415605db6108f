// Scenes of many discs: islands against the whole scene, near pairs against all pairs, gradients against differences.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "scene/scene_generators.h"
#include "simulate/broad_phase.h"
#include "simulate/islands.h"

namespace saltus {
namespace {

TEST(Islands, GroupsWithFixedDiscsAndPlanes) {
  const std::vector<char> fixed = {0, 0, 1, 0, 0, 0, 0};
  const std::vector<Candidate> pairs = {{0, 4, false}, {1, 2, false}, {2, 3, false}, {4, 6, false}, {1, 0, true}};
  Islands islands;
  for (int repeat = 0; repeat < 2; ++repeat) {
    islands.Find(pairs, fixed);
    ASSERT_EQ(islands.size(), 3);
    const auto bodies = [&](int i) { return std::vector<int>(islands.bodies(i).begin(), islands.bodies(i).end()); };
    EXPECT_EQ(bodies(0), (std::vector<int>{0, 4, 6}));
    EXPECT_EQ(bodies(1), (std::vector<int>{1, 2}));
    EXPECT_EQ(bodies(2), (std::vector<int>{2, 3}));
    ASSERT_EQ(islands.pairs(1).size(), 2u);
    EXPECT_EQ(islands.pairs(1)[0], pairs[1]);
    EXPECT_EQ(islands.pairs(1)[1], pairs[4]);
    EXPECT_EQ(islands.pairs(2)[0], pairs[2]);
    islands.Find(std::vector<Candidate>{{3, 5, false}}, fixed);
    ASSERT_EQ(islands.size(), 1);
    EXPECT_EQ(bodies(0), (std::vector<int>{3, 5}));
  }
}

// Discs that move, accelerate and bounce at random: the near list never misses what comparing all finds.
TEST(BroadPhase, NearPairsAreAllPairs) {
  for (const bool chains : {false, true}) {
    std::mt19937 engine(5);
    std::uniform_real_distribution<double> uniform(-1, 1);
    constexpr int kDiscs = 300;
    std::vector<BroadPhase::Disc> discs;
    std::vector<double> x, acceleration(kDiscs, 2.0);
    for (int i = 0; i < kDiscs; ++i) {
      discs.push_back({0.03 + 0.02 * std::abs(uniform(engine)), 1 + 0.5 * uniform(engine), i % 50 == 0});
      const double scale = discs.back().fixed ? 0 : i == 7 ? 30 : 1;
      x.insert(x.end(), {2 * uniform(engine), 2 * uniform(engine), scale * uniform(engine), scale * uniform(engine)});
    }
    const std::vector<WallPart> planes = {{.wall = {Vec2d(0.6, 0.8), -1.5}}, {.wall = {Vec2d(-1, 0), -1.9}}};
    BroadPhase::Options options{.dt = 1e-3, .chains = chains, .push_gap = chains ? 0.0 : 0.01, .rounding = 1e-16};
    BroadPhase near(planes, discs, options);
    options.all_pairs = kDiscs;
    BroadPhase all(planes, discs, options);
    near.SetAccelerations(acceleration);
    all.SetAccelerations(acceleration);
    size_t found = 0;
    for (int k = 0; k < 300; ++k) {
      std::vector<Candidate> a, b;
      near.Find(x.data(), 4, &a);
      all.Find(x.data(), 4, &b);
      ASSERT_EQ(a, b) << "step " << k;
      found += b.size();
      for (int i = 0; i < kDiscs; ++i) {
        if (discs[i].fixed) continue;
        for (int j = 0; j < 2; ++j) {
          x[4 * i + 2 + j] += uniform(engine) * options.dt;
          if (std::abs(x[4 * i + j]) > 2 || k % 97 == i % 97) x[4 * i + 2 + j] *= -1;
          x[4 * i + j] += options.dt * x[4 * i + 2 + j];
        }
      }
    }
    EXPECT_GT(found, 1000u);
  }
}

// Two discs on their way to each other: the steps that are called quiet are, and are not far too few.
TEST(BroadPhase, QuietStepsEndShortOfTheContact) {
  const double dt = 1e-3, v = 0.7, a = 0.3, gap = 0.5;
  BroadPhase phase(
      {}, {{0.1, 1, false}, {0.1, 1, false}}, {.dt = dt, .chains = false, .push_gap = 0, .rounding = 1e-16});
  phase.SetAccelerations(std::vector<double>{a, 0});
  std::vector<Candidate> candidates;
  const std::vector<double> x = {0, 0, v, 0, 0.2 + gap, 0, 0, 0};
  const int quiet = phase.Find(x.data(), 4, &candidates);
  ASSERT_TRUE(candidates.empty());
  const double contact = (-v + std::sqrt(v * v + 2 * a * gap)) / a;
  EXPECT_LE(quiet * dt, contact);
  EXPECT_GE(quiet * dt, 0.95 * contact);
}

// Two discs within reach of each other: candidates if they can meet in the step, and if one pushes the other across the
// gap; otherwise quiet until the one that is accelerated can have turned back.
// Of three discs in a row the first moves: impacts can bring the second to the third.
TEST(BroadPhase, AnImpactMayPushADiscIntoTheNext) {
  const double dt = 1e-3, speed = 1, way = speed * dt;
  for (const int all_pairs : {0, 16}) {
    const auto find = [&](bool chains, double mass, double gap) {
      BroadPhase phase({},
                       {{0.1, 1, false}, {0.1, mass, false}, {0.1, 1, false}},
                       {.dt = dt, .chains = chains, .push_gap = 0, .rounding = 1e-16, .all_pairs = all_pairs});
      const double second = 0.2 + 0.2 * way, third = second + 0.2 + gap;
      const std::vector<double> x = {0, 0, speed, 0, second, 0, 0, 0, third, 0, 0, 0};
      std::vector<Candidate> candidates;
      phase.Find(x.data(), 4, &candidates);
      return candidates;
    };
    const std::vector<Candidate> first = {{0, 1, false}}, both = {{0, 1, false}, {1, 2, false}};
    EXPECT_EQ(find(false, 1, 0.5 * way), first);
    EXPECT_EQ(find(true, 1, 0.5 * way), both);
    EXPECT_EQ(find(true, 1, 1.5 * way), first);
    // A light disc may leave faster than the heavy one came.
    EXPECT_EQ(find(true, 1.0 / 9, 1.5 * way), both);
  }
}

TEST(BroadPhase, DiscsThatMoveApartAreQuiet) {
  const double dt = 1e-3, v = 0.7, a = 0.3, gap = 0.9 * v * dt;
  const auto find = [&](double speed, double push_gap, std::vector<Candidate>* candidates) {
    BroadPhase phase(
        {}, {{0.1, 1, false}, {0.1, 1, false}}, {.dt = dt, .chains = true, .push_gap = push_gap, .rounding = 1e-16});
    phase.SetAccelerations(std::vector<double>{a, 0});
    const std::vector<double> x = {0, 0, speed, 0, 0.2 + gap, 0, 0, 0};
    return phase.Find(x.data(), 4, candidates);
  };
  std::vector<Candidate> candidates;
  const double back = (v + std::sqrt(v * v + 2 * a * gap)) / a;
  const int quiet = find(-v, 0, &candidates);
  EXPECT_TRUE(candidates.empty());
  EXPECT_LE(quiet * dt, back);
  EXPECT_GE(quiet * dt, 0.95 * back);
  EXPECT_EQ(find(v, 0, &candidates), 1);
  EXPECT_EQ(candidates.size(), 1u);
  EXPECT_EQ(find(-v, 2 * gap, &candidates), 1);
  EXPECT_EQ(candidates.size(), 1u);
}

class ManyBodies : public testing::TestWithParam<std::string> {};

// A rollout steps islands; Simulator::Step steps the whole scene.
TEST_P(ManyBodies, IslandsHaveTheBitsOfTheWholeScene) {
  Scene scene = GasInABox({.discs = 40, .fraction = 0.35, .speed = 2, .duration = 0.25, .steps = 120}, 3);
  scene.contact.stiffness = 3e4;
  auto simulator = MakeSimulator(GetParam(), scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
  EXPECT_GT(simulator->touches().size(), 10u);
  std::vector<double> x(simulator->state_size()), next(x.size()), stepped(x.size());
  std::vector<double> force(2 * scene.num_bodies());
  size_t touches = 0;
  for (int k = 0; k < simulator->num_steps(); ++k) {
    simulator->GetState(k, x);
    simulator->GetState(k + 1, next);
    std::vector<Touch> touched;
    simulator->Step(x, force, stepped, &touched);
    ASSERT_EQ(stepped, next) << "step " << k;
    touches += touched.size();
  }
  EXPECT_EQ(touches, simulator->touches().size());
}

std::vector<std::string> AllNames() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) {
    if (std::isfinite(model.push_gap)) names.emplace_back(model.name);  // else there are no islands
  }
  return names;
}

INSTANTIATE_TEST_SUITE_P(AllModels, ManyBodies, testing::ValuesIn(AllNames()),
                         [](const auto& test) { return test.param; });

// The gradient of a break of 200 discs over 1000 steps, along random directions of the initial state. The break is
// chaotic, so differences are taken over tiny steps; models with a time grid jump where one of the impacts crosses a
// node of it, which leaves their differences few digits.
struct BreakCase {
  std::string model;
  double tolerance;
};

class BreakGradient : public testing::TestWithParam<BreakCase> {};

TEST_P(BreakGradient, EqualsDirectionalDifferences) {
  const Scene scene = BilliardBreak({.discs = 200, .duration = 0.05, .steps = 1000}, 11);
  ASSERT_FALSE(Validate(scene));
  auto simulator = MakeSimulator(GetParam().model, scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  const auto loss_at = [&](const std::vector<double>& initial) {
    EXPECT_TRUE(simulator->Rollout(initial, control));
    std::vector<double> x(simulator->state_size());
    simulator->GetState(simulator->num_steps(), x);
    return TerminalLoss(scene.objective, x, simulator->body_size());
  };
  const std::vector<double> initial = InitialState(scene);
  loss_at(initial);
  EXPECT_GT(simulator->touches().size(), 300u);
  std::vector<double> x(simulator->state_size()), cotangent(x.size());
  simulator->GetState(simulator->num_steps(), x);
  TerminalGradient(scene.objective, x, simulator->body_size(), cotangent);
  Sensitivity gradient;
  simulator->Adjoint(cotangent, /*with_parameters=*/false, &gradient);

  std::mt19937 engine(2);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int repeat = 0; repeat < 3; ++repeat) {
    std::vector<double> direction(initial.size());
    for (double& d : direction) d = uniform(engine);
    double derivative = 0, best = HUGE_VAL;
    for (size_t i = 0; i < direction.size(); ++i) derivative += direction[i] * gradient.initial[i];
    for (double step = 1e-7; step > 3e-11; step /= 4) {
      std::vector<double> up = initial, down = initial;
      for (size_t i = 0; i < direction.size(); ++i) {
        up[i] += step * direction[i];
        down[i] -= step * direction[i];
      }
      best = std::min(best, std::abs((loss_at(up) - loss_at(down)) / (2 * step) - derivative));
    }
    EXPECT_LE(best, GetParam().tolerance * std::abs(derivative)) << derivative;
  }
}

INSTANTIATE_TEST_SUITE_P(SomeModels, BreakGradient,
                         testing::Values(BreakCase{"event", 1e-5}, BreakCase{"toi_velocity", 1e-2}),
                         [](const auto& test) { return test.param.model; });

}  // namespace
}  // namespace saltus
