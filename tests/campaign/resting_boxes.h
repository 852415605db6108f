// Boxes that are tossed until they rest, bodies that rest from the start, and columns that move; what must hold of
// each.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {

class RandomNumbers {
 public:
  explicit RandomNumbers(int seed) : random_(static_cast<unsigned>(seed)) {}
  double Uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(random_()) / 4294967296.0);
  }
  int UniformIndex(int count) { return static_cast<int>(random_() % static_cast<unsigned>(count)); }

 private:
  std::mt19937 random_;
};

template <typename... Numbers>
std::string Line(const char* format, Numbers... numbers) {
  std::array<char, 200> text;
  std::snprintf(text.data(), text.size(), format, numbers...);
  return text.data();
}

// The properties that a motion violates, and its end.
struct RestingReport {
  std::string refused, wrong;
  bool rests = false;  // all velocities are zero at the end
  int impacts = 0;
  bool compared = false;  // with time stepping
  double deviation = 0;   // from it
};

// Forces in the mode of each step must be within the cones of friction, energy must not grow where nothing pushes, but
// in an impact of which the report says so, and gaps must not be below zero.
inline void CheckMotion(const RigidBodies2D& scene, const MechanicalSystem& system, const HybridSimulator& simulator,
                        const HybridInput& input, RestingReport* report) {
  const std::vector<double>& p = input.parameters;
  const int contacts = system.functions().layout().num_contacts, width = system.hybrid().num_controls();
  const MechanicalReport impacts = system.Examine(simulator, input);
  report->impacts = static_cast<int>(impacts.impacts.size());
  double lowest_gap = 0, outside = 0, growth = 0, bound = scene.EnergyOf(input.initial.data(), p.data());
  const double size = std::abs(bound) + 1;
  std::size_t impact = 0, resets = 0;
  for (int k = 0; k < simulator.num_steps(); ++k) {
    const std::span<const double> x = simulator.StepState(k);
    for (int i = 0; i < contacts; ++i) {
      lowest_gap = std::min(lowest_gap, system.functions().Gap(i, x.data(), p.data()));
    }
    const double now = scene.EnergyOf(x.data(), p.data());
    growth = std::max(growth, (now - bound) / size);
    bound = std::min(bound, now);
    if (simulator.IsReset(k)) {
      // Newton's law with friction may gain energy in an impact, which the report says.
      const HybridEvent& event = simulator.events()[resets++];
      if (impact < impacts.impacts.size() && system.hybrid().GuardName(event.mode, event.guard).starts_with("hit ")) {
        bound += std::max(impacts.impacts[impact++].energy, 0.0);
      }
      continue;
    }
    const std::span<const double> u = std::span(input.control).first(input.control.empty() ? 0 : width);
    const std::vector<double> none(width);
    const MechanicalSystem::Motion motion =
        system.MotionIn(simulator.StepMode(k), x, u.empty() ? std::span<const double>(none) : u, p);
    double most = 0;
    for (int i = 0; i < contacts; ++i) most = std::max(most, std::abs(motion.normal[i]));
    for (int i = 0; i < contacts; ++i) {
      const double limit = system.functions().Friction(i, p.data()) * motion.normal[i];
      outside =
          std::max({outside, -motion.normal[i] / (most + 1), (std::abs(motion.tangential[i]) - limit) / (most + 1)});
    }
  }
  if (lowest_gap < -1e-9) report->wrong += Line("penetration by %.3g m; ", -lowest_gap);
  if (width == 0 && growth > 1e-9) report->wrong += Line("energy grows by %.3g; ", growth);
  if (outside > 1e-8) report->wrong += Line("a force is outside its cone by %.3g; ", outside);
}

inline bool Rests(std::span<const double> x, double zero) {
  return std::all_of(
      x.begin() + static_cast<std::ptrdiff_t>(x.size() / 2), x.end(), [&](double v) { return std::abs(v) <= zero; });
}

// ---------------------------------------------------------------------------------------------------------------------
// One box that is tossed onto the ground: a cube, or one that is up to six times as high as wide.
class TossUntilRest {
 public:
  static constexpr double kDuration = 2.5;

  explicit TossUntilRest(int seed) {
    RandomNumbers random(seed);
    half_ = {random.Uniform(0.04, 0.08), 0};
    half_[1] = seed % 2 == 0 ? half_[0] : half_[0] * random.Uniform(1, 6);
    friction_ = random.Uniform(0, 1.5);
    restitution_ = seed % 5 == 0 ? 0 : random.Uniform(0, 0.9);
    const double reach = std::hypot(half_[0], half_[1]);
    start_ = {0,
              reach + random.Uniform(0, 0.2),
              random.Uniform(-3, 3),
              random.Uniform(-2, 2),
              random.Uniform(-1, 1),
              random.Uniform(-8, 8)};
    if (seed % 3 == 0) {
      // It stands on a corner, or slides.
      const double angle = seed % 6 == 0 ? 0 : random.Uniform(-0.5, 0.5);
      start_ = {0,
                half_[0] * std::abs(std::sin(angle)) + half_[1] * std::cos(angle),
                angle,
                angle == 0 ? random.Uniform(-3, 3) : 0.0,
                0,
                0};
    }
  }

  RigidBodies2D Scene() const {
    return RigidBodies2D({.bodies = {{.name = "box",
                                      .polygon = BoxPolygon(half_[0], half_[1]),
                                      .position = {start_[0], start_[1]},
                                      .velocity = {start_[3], start_[4]},
                                      .angle = start_[2],
                                      .spin = start_[5]}},
                          .planes = {{}},
                          .restitution = restitution_,
                          .friction = friction_});
  }

  RestingReport Run(bool compare) const {
    const RigidBodies2D scene = Scene();
    const MechanicalSystem system(scene);
    HybridInput input{.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = kDuration};
    RestingReport report;
    const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
    if (start.mode < 0) {
      report.refused = start.reason;
      return report;
    }
    input.mode = start.mode;
    HybridSimulator simulator(system.hybrid(), {.most_events = 20000});
    if (!simulator.Rollout(input)) {
      report.refused = simulator.FailureReason();
      if (report.refused.empty()) report.wrong = "refused without a reason";
      return report;
    }
    CheckMotion(scene, system, simulator, input, &report);
    report.rests = Rests(simulator.final_state(), 1e-9);
    if (compare) Compare(simulator.final_state(), &report);
    return report;
  }

 private:
  // Moreau's time stepping with the law of impact, by projected Gauss-Seidel over the corners.
  std::array<double, 6> TimeStepping(int steps) const {
    std::array<double, 6> x = start_;
    const double h = kDuration / steps, inertia = (half_[0] * half_[0] + half_[1] * half_[1]) / 3;
    const std::array<std::array<double, 2>, 4> corners = {
        {{-half_[0], -half_[1]}, {half_[0], -half_[1]}, {half_[0], half_[1]}, {-half_[0], half_[1]}}};
    for (int k = 0; k < steps; ++k) {
      std::array<double, 3> v = {x[3], x[4] - 9.81 * h, x[5]};
      const std::array<double, 3> middle = {x[0] + 0.5 * h * x[3], x[1] + 0.5 * h * x[4], x[2] + 0.5 * h * x[5]};
      struct Corner {
        double rx, ry, before, normal = 0, tangent = 0;
      };
      std::vector<Corner> touching;
      const double c = std::cos(middle[2]), s = std::sin(middle[2]);
      for (const auto& corner : corners) {
        const double rx = c * corner[0] - s * corner[1], ry = s * corner[0] + c * corner[1];
        if (middle[1] + ry > 0) continue;
        touching.push_back({rx, ry, x[4] + rx * x[5]});
      }
      for (int sweep = 0; sweep < 2000; ++sweep) {
        double change = 0;
        for (Corner& at : touching) {
          const double nn = 1 + at.rx * at.rx / inertia, tt = 1 + at.ry * at.ry / inertia;
          const double v_n = v[1] + at.rx * v[2] + std::min(restitution_ * at.before, 0.0);
          const double p_n = std::max(at.normal - v_n / nn, 0.0), d_n = p_n - at.normal;
          v[1] += d_n;
          v[2] += at.rx * d_n / inertia;
          at.normal = p_n;
          const double v_t = v[0] - at.ry * v[2];
          const double p_t = std::clamp(at.tangent - v_t / tt, -friction_ * p_n, friction_ * p_n),
                       d_t = p_t - at.tangent;
          v[0] += d_t;
          v[2] -= at.ry * d_t / inertia;
          at.tangent = p_t;
          change = std::max({change, std::abs(d_n), std::abs(d_t)});
        }
        if (change < 1e-13) break;
      }
      for (int i = 0; i < 3; ++i) {
        x[i] += 0.5 * h * (x[3 + i] + v[i]);
        x[3 + i] = v[i];
      }
    }
    return x;
  }
  // Where time stepping has converged and the end is not that of another sequence of impacts, it must be near.
  void Compare(std::span<const double> found, RestingReport* report) const {
    const std::array<double, 6> fine = TimeStepping(160000), coarse = TimeStepping(80000);
    double converged = 0, deviation = 0;
    for (int i = 0; i < 3; ++i) {
      converged = std::max(converged, std::abs(fine[i] - coarse[i]));
      deviation = std::max(deviation, std::abs(fine[i] - found[i]));
    }
    if (converged > 1e-3) return;
    report->compared = true;
    report->deviation = deviation;
    if (deviation > 1e-2) report->wrong += Line("it ends %.3g from where time stepping does; ", deviation);
  }

  std::array<double, 2> half_;
  double friction_ = 0, restitution_ = 0;
  std::array<double, 6> start_;
};

// ---------------------------------------------------------------------------------------------------------------------
// Bodies whose equilibrium is known: they rest, but for a disc that rolls.
class RestingScene {
 public:
  enum Kind { kIncline, kPushed, kStack, kCorner, kRolling, kNumKinds };

  explicit RestingScene(int seed) : kind_(static_cast<Kind>(seed % kNumKinds)) {
    RandomNumbers random(seed);
    RigidScene2D scene{.bodies = {}, .planes = {{}}, .restitution = random.UniformIndex(2) * random.Uniform(0, 0.9)};
    const double a = random.Uniform(0.05, 0.3), b = a * random.Uniform(0.5, 4), m = random.Uniform(0.3, 3);
    RigidBody2D box{.name = "box", .polygon = BoxPolygon(a, b), .mass = m, .position = {0, b}};
    switch (kind_) {
      case kIncline: {
        // tan(angle) below a / b, at which it tips, and friction from 1.0001 to 2 times the tangent.
        angle_ = std::atan(a / b * random.Uniform(0.05, 0.95));
        scene.friction =
            std::tan(angle_) * (random.UniformIndex(2) ? random.Uniform(1.0001, 1.01) : random.Uniform(1.01, 2));
        const double along = random.Uniform(-1, 1), s = std::sin(angle_), c = std::cos(angle_);
        box.position = {along * c - b * s, along * s + b * c};
        box.angle = angle_;
        scene.planes[0].normal = {-s, c};
        scene.bodies = {box};
        break;
      }
      case kPushed: {
        // At the centre: below the force at which it slides and that at which it tips about the lower corner.
        scene.friction = random.Uniform(0.2, 1.5);
        const double limit = std::min(scene.friction, a / b) * m * 9.81;
        box.pushed = true;
        box.position[0] = random.UniformIndex(2) * random.Uniform(-1, 1);
        control_ = {limit * random.Uniform(-0.999, 0.999), 0, 0};
        scene.bodies = {box};
        break;
      }
      case kStack: {
        // Each box is narrower than that below it, and its centre is above it.
        scene.friction = random.Uniform(0, 1);
        const int count = 2 + random.UniformIndex(4);
        double width = 0.3, top = 0, place = 0;
        for (int i = 0; i < count; ++i) {
          const double height = random.Uniform(0.03, 0.1);
          scene.bodies.push_back({.name = "box" + std::to_string(i),
                                  .polygon = BoxPolygon(width, height),
                                  .mass = random.Uniform(0.3, 3),
                                  .position = {place, top + height}});
          top += 2 * height;
          const double next = width * random.Uniform(0.5, 0.9);
          place += random.UniformIndex(2) * random.Uniform(-0.9, 0.9) * (width - next);
          width = next;
        }
        break;
      }
      case kCorner: {
        // Against a wall, away from it with less than the friction of the ground, or not at all.
        scene.friction = random.Uniform(0.1, 1);
        scene.planes.push_back({.normal = {1, 0}});
        box.position[0] = a;
        box.pushed = true;
        const double limit = std::min(scene.friction, a / b) * m * 9.81;
        control_ = {random.UniformIndex(3) == 0 ? 0.0 : random.Uniform(-0.99, 0.99) * limit, 0, 0};
        scene.bodies = {box};
        break;
      }
      default: {
        // A uniform disc on an incline rolls if the friction is at least a third of the tangent.
        angle_ = random.Uniform(0.05, 1.2);
        scene.friction = std::tan(angle_) / 3;
        const double s = std::sin(angle_), c = std::cos(angle_);
        scene.planes[0].normal = {-s, c};
        scene.bodies = {{.name = "disc", .radius = a, .mass = m, .position = {-a * s, a * c}}};
      }
    }
    scene_ = scene;
  }

  RestingReport Run() const {
    const RigidBodies2D bodies(scene_);
    const MechanicalSystem system(bodies);
    HybridInput input{
        .initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = 1, .control = control_};
    RestingReport report;
    const MechanicalSystem::Start start = system.FindMode(input.initial, control_, input.parameters);
    if (start.mode < 0) {
      report.refused = start.reason;
      return report;
    }
    input.mode = start.mode;
    HybridSimulator simulator(system.hybrid(), {.most_events = 100});
    if (!simulator.Rollout(input)) {
      report.refused = simulator.FailureReason();
      return report;
    }
    CheckMotion(bodies, system, simulator, input, &report);
    const double rolled = kind_ == kRolling ? -9.81 * std::sin(angle_) / 3 : 0;  // along the incline
    for (std::size_t i = 0; i < scene_.bodies.size(); ++i) {
      const RigidBody2D& body = scene_.bodies[i];
      const std::array<double, 3> pose = bodies.PoseOf(static_cast<int>(i), simulator.final_state().data());
      const double turned = kind_ == kRolling ? -rolled / body.radius : 0;
      report.deviation = std::max({report.deviation,
                                   std::abs(pose[0] - body.position[0] - rolled * std::cos(angle_)),
                                   std::abs(pose[1] - body.position[1] - rolled * std::sin(angle_)),
                                   std::abs(pose[2] - body.angle - turned)});
    }
    if (report.deviation > 1e-9) report.wrong += Line("it ends %.3g from where it must; ", report.deviation);
    if (!simulator.events().empty()) report.wrong += Line("%d events; ", static_cast<int>(simulator.events().size()));
    report.rests = kind_ == kRolling || Rests(simulator.final_state(), 1e-12);
    if (!report.rests) report.wrong += "it moves; ";
    return report;
  }

 private:
  Kind kind_;
  RigidScene2D scene_;
  std::vector<double> control_;
  double angle_ = 0;
};

// ---------------------------------------------------------------------------------------------------------------------
// Boxes on top of each other, on the ground or above it, of which the lowest or all move along it: they slide, tip and
// fall over.
class MovingColumn {
 public:
  explicit MovingColumn(int seed) {
    RandomNumbers random(seed);
    const int count = 2 + random.UniformIndex(4);
    scene_.friction = random.UniformIndex(4) == 0 ? 0 : random.Uniform(0.05, 1.2);
    scene_.restitution = random.UniformIndex(2) * random.Uniform(0, 0.9);
    double top = random.UniformIndex(2) * random.Uniform(0, 0.1), place = 0;
    const double speed = random.UniformIndex(2) * random.Uniform(-2, 2);
    const bool all_move = random.UniformIndex(2) != 0, equal = random.UniformIndex(2) != 0;
    for (int i = 0; i < count; ++i) {
      const double width = equal ? 0.1 : random.Uniform(0.05, 0.2), height = equal ? 0.05 : random.Uniform(0.03, 0.1);
      if (i > 0 && !equal) place += random.Uniform(-0.05, 0.05);
      scene_.bodies.push_back({.name = "box" + std::to_string(i),
                               .polygon = BoxPolygon(width, height),
                               .mass = equal ? 1 : random.Uniform(0.3, 3),
                               .position = {place, top + height},
                               .velocity = {all_move || i == 0 ? speed : 0, 0}});
      top += 2 * height;
    }
  }

  // `steps`: of the motion; 0: chosen.
  RestingReport Run(double duration, int steps) const {
    const RigidBodies2D bodies(scene_);
    const MechanicalSystem system(bodies);
    HybridInput input{.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = duration};
    RestingReport report;
    const MechanicalSystem::Start start = system.FindMode(input.initial, {}, input.parameters);
    input.mode = start.mode;
    report.refused = start.reason;
    if (start.mode < 0) return report;
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = steps, .most_events = 20000});
    if (!simulator.Rollout(input)) report.refused = simulator.FailureReason();
    if (!report.refused.empty()) return report;
    CheckMotion(bodies, system, simulator, input, &report);
    report.rests = Rests(simulator.final_state(), 1e-9);
    return report;
  }

 private:
  RigidScene2D scene_{.bodies = {}, .planes = {{}}};
};

}  // namespace saltus
