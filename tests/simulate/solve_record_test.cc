// Models that iterate do so once a step: derivatives recall what the rollout has found.
#include <gtest/gtest.h>

#include <array>
#include <memory_resource>

#include "saltus/control/single_shooting.h"
#include "saltus/internal/contact_step.h"
#include "test_scenes.h"

namespace saltus {
namespace {

int solves = 0;

// Direct impulses with a "solution" per touching pair: the normal impulse.
struct Counting {
  static constexpr ModelTraits kTraits = {.name = "counting", .summary = "counts its solves", .source = "a test"};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    return SemiImplicitEuler(in, i, x);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return next[i].p; });
      const T s = Dot(at.normal, RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return x[i].v; }));
      if (!(at.distance < in.ContactDistance(c)) || !(s < Base<T>(0))) continue;
      in.Report(c);
      const T impulse = -(in.contact.restitution + Base<T>(1)) * in.EffectiveMass(c) * s;
      const std::span<const double> found = in.Solved([&] {
        ++solves;
        return std::array{static_cast<double>(Value(impulse)), 0.0};
      });
      EXPECT_EQ(found[0], static_cast<double>(Value(impulse)));
      ApplyImpulse(in, c, Scale(impulse, at.normal), [&](int i, const Vec2<T>& dv) { next[i].v += dv; });
    }
  }
};

class SolveRecordTest : public testing::Test {
 protected:
  void SetUp() override { solves = 0; }

  static SingleShooting Shooting(const Scene& scene, SingleShooting::Variables variables) {
    return SingleShooting(MakeModelSimulator<Counting>(scene), variables);
  }
};

TEST_F(SolveRecordTest, AGradientSolvesNothing) {
  SingleShooting shooting = Shooting(ProblemScene("two_balls"), SingleShooting::Variables::kOptimized);
  std::vector<double> gradient(shooting.num_variables());
  double loss;
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr));
  const int of_rollout = solves;
  EXPECT_GT(of_rollout, 0);
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data()));
  EXPECT_EQ(solves, 2 * of_rollout);
  Sensitivity all;
  ASSERT_TRUE(shooting.EvaluateAll(shooting.initial_guess(), &loss, &all));
  EXPECT_EQ(solves, 3 * of_rollout);
}

TEST_F(SolveRecordTest, NeitherDoTheOtherIslandsOfAStep) {
  // Two pairs of discs that meet at the same time.
  Scene scene = ProblemScene("two_balls");
  scene.bodies.resize(2);
  for (int i = 0; i < 2; ++i) {
    Body body = scene.bodies[i];
    body.name += "_above";
    body.position[1] += 10;
    scene.bodies.push_back(body);
  }
  for (int i : {0, 2}) scene.bodies[i].velocity = 2 * (scene.bodies[i + 1].position - scene.bodies[i].position);
  SingleShooting shooting = Shooting(scene, SingleShooting::Variables::kInitialState);
  double loss;
  std::vector<double> gradient(shooting.num_variables());
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr));
  EXPECT_GE(solves, 2);
  const int of_rollout = solves;
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data()));
  EXPECT_EQ(solves, 2 * of_rollout);
}

TEST_F(SolveRecordTest, ALinearizationSolvesOnceInAllItsPasses) {
  const Scene scene = ProblemScene("two_balls");
  const std::unique_ptr<const Simulator> simulator = MakeModelSimulator<Counting>(scene);
  // The two overlap and approach each other.
  const double radii = scene.bodies[0].radius + scene.bodies[1].radius;
  const std::vector<double> x{0, 0, 1, 0.2, 0.9 * radii, 0.1, -1, 0}, force(4, 0.0);
  StepLinearization linearization;
  simulator->Linearize(x, force, /*with_parameters=*/true, &linearization);
  ASSERT_EQ(linearization.islands.size(), 1u);
  EXPECT_EQ(solves, 2);  // that of the step, and one for the passes
}

TEST(SolveRecord, AStepThatAsksFromAnotherPlaceRecallsNothing) {
  SolveRecord record;
  std::pmr::monotonic_buffer_resource scratch;
  StepInput<double> in{};
  in.solved = &record;
  in.scratch = &scratch;
  int solved = 0;
  const auto one = [&] {
    return in.Solved([&] {
      ++solved;
      return std::array{1.0};
    })[0];
  };
  const auto two = [&] {
    return in.Solved([&] {
      ++solved;
      return std::array{5.0, 2.0};
    })[1];
  };
  EXPECT_EQ(one() + two(), 3);
  EXPECT_EQ(solved, 2);
  record.Rewind();
  EXPECT_EQ(one() + two(), 3);
  EXPECT_EQ(solved, 2);
  record.Rewind();
  EXPECT_EQ(two(), 2);  // the record begins with the vector of the other place
  EXPECT_EQ(solved, 3);
  EXPECT_EQ(one(), 1);  // and what followed it was replaced
  EXPECT_EQ(solved, 4);
  record.Rewind();
  EXPECT_EQ(two() + one(), 3);
  EXPECT_EQ(solved, 4);
}

}  // namespace
}  // namespace saltus
