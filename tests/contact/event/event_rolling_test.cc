// Discs that rest on curved walls and on each other, with friction, under the event-driven model: against closed forms,
// an integration of the angle, and differences.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "contact/event/event_run.h"
#include "exact/exact_scenes.h"
#include "spinning_disc.h"

namespace saltus {
namespace {

using testing::EventRun;

constexpr double kGravity = 9.81, kRadius = 0.1, kMass = 1.5;
constexpr double kTolerance = 1e-9;  // that of the reference where a mode ends
constexpr double kShare = 0.5;       // I / (m r^2)

// A solid disc on a hill (side = 1) or in a bowl (side = -1), circles around the origin; at an angle from the top of
// the hill or the bottom of the bowl, with the speed of its centre along the circle, both to the right, and with a
// spin.
struct OnCircle {
  double side = 1;
  double bend = 0.5;  // radius of the circle, m
  double angle = 0, speed = 0, spin = 0;
  double friction = 0.5;

  double distance() const { return bend + side * kRadius; }
  double Sliding() const { return speed + kRadius * spin; }
};

// A reference by the classical Runge-Kutta method, in steps of 1e-5 s. The disc rolls while its friction suffices.
class Reference {
 public:
  explicit Reference(const OnCircle& start) : x_{start.angle, start.speed, start.spin}, start_(start) {
    rolls_ = std::abs(start.Sliding()) < 1e-12;
    slides_ = start.Sliding();
  }
  bool flies() const { return flies_; }
  bool rolls() const { return rolls_; }
  double angle() const { return x_[0]; }
  double speed() const { return x_[1]; }
  double spin() const { return x_[2]; }

  void Run(double duration) {
    const int steps = static_cast<int>(std::lround(duration / kStep));
    for (int k = 0; k < steps && !flies_; ++k) Step();
  }

 private:
  static constexpr double kStep = 1e-5;
  using State = std::array<double, 3>;

  double Pressing(const State& x) const {
    return kGravity * std::cos(x[0]) - start_.side * x[1] * x[1] / start_.distance();
  }
  double Down(const State& x) const { return start_.side * kGravity * std::sin(x[0]); }
  static double Sliding(const State& x) { return x[1] + kRadius * x[2]; }
  State Rate(const State& x) const {
    double along = -kShare / (1 + kShare) * Down(x);  // friction, per mass
    if (!rolls_) along = -std::copysign(start_.friction * Pressing(x), slides_);
    return {x[1] / start_.distance(), Down(x) + along, along / (kShare * kRadius)};
  }
  State Advanced(const State& x, double h) const {
    const auto plus = [](State a, double s, const State& b) {
      for (int i = 0; i < 3; ++i) a[i] += s * b[i];
      return a;
    };
    const State k1 = Rate(x), k2 = Rate(plus(x, h / 2, k1)), k3 = Rate(plus(x, h / 2, k2)), k4 = Rate(plus(x, h, k3));
    return plus(plus(plus(plus(x, h / 6, k1), h / 3, k2), h / 3, k3), h / 6, k4);
  }
  // How far it is from the end of its mode: from sliding, from rolling, and from flying.
  double Left(const State& x) const {
    if (rolls_) return start_.friction * Pressing(x) - std::abs(kShare / (1 + kShare) * Down(x));
    return std::min(Sliding(x) * slides_, Pressing(x));
  }
  void Step() {
    double h = kStep;
    while (h > 0 && !flies_) {
      const double left = Left(x_);
      const State next = Advanced(x_, h);
      if (Left(next) > 0 || (!rolls_ && begins_)) {
        x_ = next;
        begins_ = false;
        return;
      }
      const double until = h * left / (left - Left(next));
      x_ = Advanced(x_, until);
      h -= until;
      if (rolls_) {
        rolls_ = false;
        begins_ = true;
        slides_ = Down(x_);
      } else if (Pressing(x_) < 1e-6) {
        flies_ = true;
      } else {
        x_[2] = -x_[1] / kRadius;
        rolls_ = true;
      }
    }
  }

  State x_;
  OnCircle start_;
  bool rolls_ = false, flies_ = false;
  bool begins_ = false;  // to slide, from no speed
  double slides_ = 0;
};

enum class Made { kOfDisc, kOfArc, kOfPoint };  // the circle

Scene SceneOf(const OnCircle& at, double duration, int steps, Made made) {
  Scene scene;
  scene.duration = duration;
  scene.steps = steps;
  scene.gravity = {0, -kGravity};
  const Vec2d out(std::sin(at.angle), at.side * std::cos(at.angle));
  const Vec2d right(std::cos(at.angle), -at.side * std::sin(at.angle));
  scene.bodies = {Spinning("disc", kRadius, kMass, at.distance() * out, at.speed * right, at.spin)};
  scene.contact = {.restitution = 0, .friction = at.friction};
  if (made == Made::kOfDisc) scene.bodies.push_back({.name = "hill", .radius = at.bend, .fixed = true});
  if (made == Made::kOfArc) scene.arcs = {{"circle", {0, 0}, at.bend, -std::numbers::pi, std::numbers::pi}};
  if (made == Made::kOfPoint) scene.segments = {{"post", {0, 0}, {0, -1}}};
  return scene;
}

double EnergyOf(const std::vector<double>& x) {
  const double inertia = kShare * kMass * kRadius * kRadius;
  return 0.5 * kMass * (x[2] * x[2] + x[3] * x[3]) + 0.5 * inertia * x[5] * x[5] + kMass * kGravity * x[1];
}

// Until it flies, which must not be at once. What slides must not stick again.
void ExpectMotion(const OnCircle& start, double duration, int steps, Made made, bool rolls) {
  EventRun run(SceneOf(start, duration, steps, made));
  ASSERT_TRUE(run.finite);
  Reference reference(start);
  int k = 0;
  while (k < steps) {
    reference.Run(duration / steps);
    if (reference.flies()) break;
    const std::vector<double> x = run.State(++k);
    const double angle = std::atan2(x[0], start.side * x[1]);
    const double speed = x[2] * std::cos(angle) - start.side * x[3] * std::sin(angle);
    EXPECT_NEAR(angle, reference.angle(), kTolerance) << k;
    EXPECT_NEAR(speed, reference.speed(), kTolerance) << k;
    EXPECT_NEAR(kRadius * x[5], kRadius * reference.spin(), kTolerance) << k;
    EXPECT_NEAR(std::hypot(x[0], x[1]), start.distance(), 1e-10) << k;
  }
  EXPECT_GT(k, steps / 2);
  EXPECT_EQ(reference.rolls(), rolls);
  if (rolls) return;
  bool slid = false;
  for (const StepTouch& at : run.simulator.touches()) {
    EXPECT_FALSE(slid && at.touch.mode == ContactMode::kStick) << run.TimeOf(at);
    slid = slid || at.touch.mode == ContactMode::kSlip;
  }
}

TEST(EventRolling, InABowl) {
  const OnCircle start{.side = -1, .angle = 0.5};
  ExpectMotion(start, 1.5, 30, Made::kOfArc, true);
  // Nothing is lost on the way down.
  EventRun run(SceneOf(start, 0.35, 1, Made::kOfArc));
  EXPECT_NEAR(EnergyOf(run.End()), EnergyOf(run.State(0)), 1e-12);
}

TEST(EventRolling, DownAHill) {
  for (const Made made : {Made::kOfDisc, Made::kOfArc})
    ExpectMotion({.angle = 0.1, .friction = 5}, 0.7, 14, made, true);
}

TEST(EventRolling, OffAPoint) { ExpectMotion({.bend = 0, .angle = 0.1, .friction = 5}, 0.3, 10, Made::kOfPoint, true); }

TEST(EventRolling, SlidesThenRolls) {
  ExpectMotion({.side = -1, .angle = -0.3, .speed = 1.5, .spin = 10, .friction = 0.2}, 0.5, 10, Made::kOfArc, true);
}

TEST(EventRolling, RollsThenSlides) { ExpectMotion({.angle = 0.2, .friction = 0.2}, 0.5, 10, Made::kOfDisc, false); }

// Expects of each entry of the final state of scene_of(change), for small changes, that its derivative is that of
// differences. `width` is that of the differences.
template <typename SceneOfChange>
void ExpectDerivatives(const SceneOfChange& scene_of, double width, double tolerance) {
  EventRun run(scene_of(0));
  const std::size_t size = run.End().size();
  for (std::size_t row = 0; row < size; ++row) {
    const std::vector<double> gradient = run.GradientOf(static_cast<int>(row)).initial;
    double exact = 0;
    for (std::size_t c = 0; c < size; ++c) {
      if (gradient[c] == 0) continue;
      exact += gradient[c] * exact_test::Richardson([&](double by) { return InitialState(scene_of(by))[c]; }, width);
    }
    const double difference =
        exact_test::Richardson([&](double by) { return EventRun(scene_of(by)).End()[row]; }, width);
    EXPECT_NEAR(exact, difference, tolerance * std::max(1.0, std::abs(exact))) << row;
  }
}

TEST(EventRolling, Differences) {
  const std::pair<OnCircle, Made> starts[] = {
      {{.side = -1, .angle = 0.5}, Made::kOfArc},
      {{.angle = 0.1, .friction = 5}, Made::kOfDisc},
      {{.bend = 0, .angle = 0.3, .friction = 5}, Made::kOfPoint},
      {{.side = -1, .angle = -0.3, .speed = 1.5, .spin = 10, .friction = 0.2}, Made::kOfArc},
  };
  for (const auto& [start, made] : starts) {
    for (double OnCircle::*changed : {&OnCircle::angle, &OnCircle::speed, &OnCircle::spin}) {
      // A disc that rolls without sliding has one motion only: a change of its speed alone begins to slide.
      if (changed != &OnCircle::angle && start.Sliding() == 0) continue;
      SCOPED_TRACE(start.angle);
      const auto scene_of = [&, made = made](double by) {
        OnCircle moved = start;
        moved.*changed += by;
        return SceneOf(moved, 0.2, 7, made);
      };
      ExpectDerivatives(scene_of, 4e-3, 1e-9);
    }
  }
}

// A pendulum, whose length is that of the way of its centre times 1 + I / (m r^2): its quarter period is a complete
// elliptic integral, and so is the change of that by the amplitude.
TEST(EventRolling, QuarterOfAPendulumsPeriod) {
  const OnCircle start{.side = -1, .angle = 0.9};
  const double length = start.distance(), rate = std::sqrt(kGravity / ((1 + kShare) * length));
  const double k = std::sin(start.angle / 2), first = std::comp_ellint_1(k), second = std::comp_ellint_2(k);
  const double turning = -rate * std::sqrt(2 * (1 - std::cos(start.angle)));  // at the bottom, rad/s
  const double by_amplitude = (second / (k * (1 - k * k)) - first / k) * std::cos(start.angle / 2) / 2 / rate;
  for (const int steps : {1, 7}) {
    EventRun run(SceneOf(start, first / rate, steps, Made::kOfArc));
    const std::vector<double> x = run.End(), gradient = run.GradientOf(0).initial;
    EXPECT_NEAR(x[0], 0, 1e-12);
    EXPECT_NEAR(x[2], length * turning, 1e-12);
    EXPECT_NEAR(kRadius * x[5], -x[2], 1e-12);
    const double exact = gradient[0] * length * std::cos(start.angle) + gradient[1] * length * std::sin(start.angle);
    EXPECT_NEAR(exact, -length * turning * by_amplitude, 1e-10);
  }
}

// A disc that rolls down a hill strikes a post, and bounces off both.
TEST(EventRolling, DerivativesBeyondAnImpact) {
  const auto scene_of = [](double by) {
    Scene scene = SceneOf({.angle = 0.3 + by, .speed = 0.5, .spin = -5, .friction = 2}, 0.25, 9, Made::kOfDisc);
    scene.bodies.push_back({.name = "post", .radius = 0.05, .fixed = true, .position = {0.4056, 0.434}});
    scene.contact.restitution = 0.9;
    return scene;
  };
  EXPECT_LT(EventRun(scene_of(0)).End()[2], 0);
  ExpectDerivatives(scene_of, 1e-3, 1e-8);
}

// Returns the energy of solid discs.
double EnergyOf(const Scene& scene, const std::vector<double>& x) {
  double sum = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& body = scene.bodies[i];
    const double* at = &x[6 * i];
    sum += body.mass * (0.5 * (at[2] * at[2] + at[3] * at[3]) + kGravity * at[1]);
    sum += 0.25 * body.mass * body.radius * body.radius * at[5] * at[5];
  }
  return sum;
}

// On a floor, with a disc at an angle from the top of the first.
Scene OnFloor(double angle, double friction) {
  Scene scene;
  scene.duration = 0.2;
  scene.steps = 5;
  scene.gravity = {0, -kGravity};
  const double apart = 2.5 * kRadius;
  scene.bodies = {
      Spinning("lower", kRadius, 1.3, {0, kRadius}, {0, 0}, 0),
      Spinning("upper", 1.5 * kRadius, kMass, {apart * std::sin(angle), kRadius + apart * std::cos(angle)}, {0, 0}, 0)};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0, .friction = friction};
  return scene;
}

TEST(EventRolling, ADiscOnADiscThatRolls) {
  ExpectDerivatives([](double by) { return OnFloor(0.3 + by, 3); }, 1e-3, 1e-9);
  EventRun run(OnFloor(0.3, 3));
  EXPECT_NEAR(EnergyOf(run.simulator.scene(), run.End()), EnergyOf(run.simulator.scene(), run.State(0)), 1e-12);
  EXPECT_LT(run.End()[0], -0.005);
  // With little friction the upper one slides.
  ExpectDerivatives([](double by) { return OnFloor(0.4 + by, 0.1); }, 1e-3, 1e-9);
}

// Without spin: slides off a hill and flies.
TEST(EventSliding, DerivativesBeyondItsEnd) {
  for (const double friction : {0.5, 0.2}) {
    for (const double speed : {0.8, 1.2}) {
      const auto scene_of = [&](double by) {
        Scene scene = SceneOf({.angle = 0.6 + by, .speed = speed, .friction = friction}, 0.6, 10, Made::kOfDisc);
        scene.bodies[0].inertia = {};
        return scene;
      };
      ExpectDerivatives(scene_of, 1e-3, 1e-9);
    }
  }
}

// Rolls, slides and flies.
TEST(EventRolling, DerivativesOfTheEndOfRolling) {
  for (const double angle : {0.2, 0.3, 0.4}) {
    SCOPED_TRACE(angle);
    ExpectDerivatives(
        [&](double by) { return SceneOf({.angle = angle + by, .friction = 1}, 1, 7, Made::kOfDisc); }, 4e-3, 1e-9);
  }
}

}  // namespace
}  // namespace saltus
