// Discs that rest on curved walls and on each other, with friction, under the event-driven model: against an
// integration of the angle, and differences.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "contact/event/event_run.h"
#include "spinning_disc.h"

namespace saltus {
namespace {

using testing::EventRun;

constexpr double kGravity = 9.81, kRadius = 0.1, kMass = 1.5;
constexpr double kTolerance = 1e-7;  // motion is of second order in arcs below 1e-3 rad
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

// The same by the classical Runge-Kutta method, in steps of 1e-5 s. It rolls while its friction suffices.
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

// The derivative of entry `row` of the final state along changes of a start that leave it on the circle: exact, and by
// differences of the end of `of` it.
template <typename Of>
std::pair<double, double> AlongCircle(const OnCircle& start, double OnCircle::*changed, double duration, Made made,
                                      int row, const Of& of) {
  constexpr double kWidth = 1e-4;
  EventRun run(SceneOf(start, duration, 7, made));
  const std::vector<double> gradient = run.GradientOf(row).initial;
  std::pair<double, double> by(0, 0);
  for (const double side : {-1.0, 1.0}) {
    OnCircle moved = start;
    moved.*changed += side * kWidth;
    const std::vector<double> from = InitialState(SceneOf(moved, duration, 7, made));
    for (std::size_t c = 0; c < gradient.size(); ++c) by.first += gradient[c] * side * from[c] / (2 * kWidth);
    by.second += side * of(moved) / (2 * kWidth);
  }
  return by;
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
      for (int row = 0; row < 6; ++row) {
        const auto end = [&, made = made](const OnCircle& at) {
          return EventRun(SceneOf(at, 0.2, 7, made)).End()[row];
        };
        const auto [exact, differences] = AlongCircle(start, changed, 0.2, made, row, end);
        EXPECT_NEAR(exact, differences, 1e-4 * std::max(1.0, std::abs(exact))) << row << " from " << start.angle;
      }
    }
  }
}

// Without spin: slides off a hill and flies.
TEST(EventSliding, DerivativesBeyondItsEnd) {
  constexpr double kWidth = 1e-4;
  for (const double friction : {0.5, 0.2}) {
    for (const double speed : {0.8, 1.2}) {
      const auto scene_at = [&](double angle) {
        Scene scene = SceneOf({.angle = angle, .speed = speed, .friction = friction}, 0.6, 10, Made::kOfDisc);
        scene.bodies[0].inertia = {};
        return scene;
      };
      EventRun run(scene_at(0.6));
      const std::vector<double> above = InitialState(scene_at(0.6 + kWidth)),
                                below = InitialState(scene_at(0.6 - kWidth));
      const std::vector<double> last_above = EventRun(scene_at(0.6 + kWidth)).End(),
                                last_below = EventRun(scene_at(0.6 - kWidth)).End();
      for (const int row : {2, 3}) {
        const std::vector<double> gradient = run.GradientOf(row).initial;
        double derivative = 0;
        for (std::size_t c = 0; c < above.size(); ++c) derivative += gradient[c] * (above[c] - below[c]) / (2 * kWidth);
        EXPECT_NEAR(derivative, (last_above[row] - last_below[row]) / (2 * kWidth), 1e-6) << row;
      }
    }
  }
}

// Rolls, slides and flies: the derivative of the spin then is a small rest of what it was while it rolled.
TEST(EventRolling, DerivativesOfTheEndOfRolling) {
  for (const double angle : {0.2, 0.3, 0.4}) {
    const OnCircle start{.angle = angle, .friction = 1};
    const auto spin = [](const OnCircle& at) {
      Reference reference(at);
      reference.Run(1);
      EXPECT_TRUE(reference.flies());
      return reference.spin();
    };
    const double rolled = AlongCircle(start, &OnCircle::angle, 0.4, Made::kOfDisc, 5, spin).first;
    const auto [exact, differences] = AlongCircle(start, &OnCircle::angle, 1, Made::kOfDisc, 5, spin);
    EXPECT_NEAR(exact, differences, 1e-5 * std::abs(rolled)) << angle;
  }
}

}  // namespace
}  // namespace saltus
