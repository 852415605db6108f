// Discs at rest under exact events are not stepped, nor differentiated, again and again: against steps one by one.
#include <gtest/gtest.h>

#include <atomic>
#include <memory>

#include "contact/event/event.h"
#include "contact/event/event_run.h"
#include "saltus/internal/contact_step.h"

extern template class saltus::ContactStepOf<saltus::EventDriven, double>;

namespace saltus {
namespace {

constexpr int kSteps = 96;

// Six discs one above the other between two walls, the uppermost of which is lifted for a moment; later another falls
// on it. All have come to rest long before the end.
Scene Stack() {
  Scene scene;
  scene.name = "test";
  scene.duration = 1.5;
  scene.steps = kSteps;
  scene.gravity = {0, -9.8};
  scene.contact.restitution = 0;
  scene.planes = {{"ground", {0, 0}, {0, 1}}, {"left", {-0.125, 0}, {1, 0}}, {"right", {0.125, 0}, {-1, 0}}};
  for (int i = 0; i < 6; ++i) {
    scene.bodies.push_back(
        {.name = "disc" + std::to_string(i), .radius = 0.125, .mass = 1, .position = {0, 0.125 * (2 * i + 1)}});
  }
  scene.bodies.push_back({.name = "falling", .radius = 0.125, .mass = 2, .position = {0, 3}});
  scene.control.bodies = {5, 0};
  scene.control.initial = {{0, 0}, {0, 0}};
  return scene;
}

// K x C x 2.
std::vector<double> Lift() {
  std::vector<double> control(kSteps * 4);
  for (int k = 20; k < 26; ++k) control[4 * k + 1] = 15;
  for (int k = 80; k < 85; ++k) control[4 * k + 2] = 0.5;  // presses it against a wall
  return control;
}

// The step from x under `control` by a simulator that has seen nothing else.
std::unique_ptr<Simulator> OneStep(Scene scene, const std::vector<double>& x, std::span<const double> control) {
  scene.duration /= scene.steps;
  scene.steps = 1;
  std::unique_ptr<Simulator> simulator = testing::MakeEventSimulator(scene);
  EXPECT_TRUE(simulator->Rollout(x, control));
  return simulator;
}

std::vector<double> StateOf(const Simulator& simulator, int k) {
  std::vector<double> x(simulator.state_size());
  simulator.GetState(k, x);
  return x;
}

TEST(Rest, StepsAreThoseOneByOne) {
  const Scene scene = Stack();
  const std::vector<double> control = Lift();
  const std::unique_ptr<Simulator> owned = testing::MakeEventSimulator(scene);
  Simulator& all = *owned;
  ASSERT_TRUE(all.Rollout(InitialState(scene), control));
  std::size_t touches = 0;
  for (int k = 0; k < kSteps; ++k) {
    const auto one = OneStep(scene, StateOf(all, k), std::span(control).subspan(4 * k, 4));
    ASSERT_EQ(StateOf(*one, 1), StateOf(all, k + 1)) << "step " << k;
    for (const StepTouch& at : one->touches()) {
      ASSERT_LT(touches, all.touches().size());
      const StepTouch& same = all.touches()[touches++];
      EXPECT_EQ(same.step, k);
      EXPECT_EQ(same.touch.candidate, at.touch.candidate) << "step " << k;
      EXPECT_EQ(same.touch.kind, at.touch.kind) << "step " << k;
      EXPECT_EQ(same.touch.mode, at.touch.mode) << "step " << k;
      EXPECT_EQ(same.touch.time, at.touch.time) << "step " << k;
    }
  }
  EXPECT_EQ(touches, all.touches().size());
  const std::vector<double> end = StateOf(all, kSteps);
  for (std::size_t i = 0; i < end.size(); ++i) EXPECT_NEAR(end[i], StateOf(all, kSteps - 1)[i], 1e-14) << "it rests";
}

TEST(Rest, DerivativesAreThoseOneByOne) {
  const Scene scene = Stack();
  const std::vector<double> control = Lift();
  const std::unique_ptr<Simulator> owned = testing::MakeEventSimulator(scene);
  Simulator& all = *owned;
  ASSERT_TRUE(all.Rollout(InitialState(scene), control));
  std::vector<double> cotangent(all.state_size());
  for (std::size_t i = 0; i < cotangent.size(); ++i) cotangent[i] = 1 + 0.1 * static_cast<double>(i);
  Sensitivity found;
  all.Adjoint(cotangent, /*with_parameters=*/true, &found);

  Sensitivity expected;
  expected.control.resize(control.size());
  for (int k = kSteps - 1; k >= 0; --k) {
    const auto one = OneStep(scene, StateOf(all, k), std::span(control).subspan(4 * k, 4));
    Sensitivity step;
    one->Adjoint(cotangent, /*with_parameters=*/true, &step);
    cotangent = step.initial;
    std::copy(step.control.begin(), step.control.end(), expected.control.begin() + 4 * k);
    expected.parameters.gravity += step.parameters.gravity;
  }
  expected.initial = cotangent;
  const auto near = [](double a, double b) { EXPECT_NEAR(a, b, 1e-11 * (1 + std::abs(b))); };
  for (std::size_t i = 0; i < found.initial.size(); ++i) {
    SCOPED_TRACE("initial " + std::to_string(i));
    near(found.initial[i], expected.initial[i]);
  }
  for (std::size_t i = 0; i < found.control.size(); ++i) {
    SCOPED_TRACE("control " + std::to_string(i));
    near(found.control[i], expected.control[i]);
  }
  near(found.parameters.gravity[1], expected.parameters.gravity[1]);
}

std::atomic<int> steps_taken = 0, steps_taped = 0;

// Counts what is computed, by the step that the library has.
struct CountedEvents : EventDriven {
  using Spinning = void;
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    (std::is_same_v<T, double> ? steps_taken : steps_taped) += 1;
    const ContactStep<double, kRotation>& events = ContactStepOf<EventDriven, double>(*this);
    events.Step(in, x, next);
  }
};

TEST(Rest, IsSteppedAndDifferentiatedOnce) {
  Scene scene = Stack();
  scene.bodies.pop_back();
  const std::vector<double> still(kSteps * 4);
  const std::unique_ptr<Simulator> made = MakeModelSimulator<CountedEvents>(scene);
  Simulator& simulator = *made;
  steps_taken = steps_taped = 0;
  ASSERT_TRUE(simulator.Rollout(InitialState(scene), still));
  EXPECT_EQ(simulator.touches().size(), kSteps * 6u);
  EXPECT_EQ(StateOf(simulator, kSteps), StateOf(simulator, 0));
  EXPECT_EQ(steps_taken, 1);
  Sensitivity sensitivity;
  simulator.Adjoint(std::vector<double>(simulator.state_size(), 1.0), /*with_parameters=*/true, &sensitivity);
  EXPECT_EQ(steps_taped, 1);

  // Another force is another step; so is what it leaves, until all is still again.
  std::vector<double> pushed = still;
  pushed[4 * 50 + 1] = 1;
  ASSERT_TRUE(simulator.Rollout(InitialState(scene), pushed));
  EXPECT_GE(steps_taken, 1 + 3);
  EXPECT_LT(steps_taken, 1 + 25);
}

}  // namespace
}  // namespace saltus
