// Random scenes of one to three boxes that are tossed on the ground and at each other, and what must hold of each.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {

inline std::vector<Point2D> CornersOf(const RigidBodies2D& bodies, int body, const double* x) {
  const std::array<double, 3> pose = bodies.PoseOf(body, x);
  const double c = std::cos(pose[2]), s = std::sin(pose[2]);
  std::vector<Point2D> corners;
  for (const Point2D& at : bodies.scene().bodies[body].polygon) {
    corners.push_back({pose[0] + c * at[0] - s * at[1], pose[1] + s * at[0] + c * at[1]});
  }
  return corners;
}

// The largest distance between two polygons along a normal of an edge of either: below zero where they overlap.
inline double SeparationOf(const RigidBodies2D& bodies, int one, int other, const double* x) {
  double largest = -std::numeric_limits<double>::infinity();
  for (const auto& [of_edges, of_corners] : {std::pair{one, other}, {other, one}}) {
    const std::vector<Point2D> edges = CornersOf(bodies, of_edges, x), corners = CornersOf(bodies, of_corners, x);
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const Point2D &from = edges[i], &to = edges[(i + 1) % edges.size()];
      const double along_x = to[0] - from[0], along_y = to[1] - from[1], length = std::hypot(along_x, along_y);
      double nearest = std::numeric_limits<double>::infinity();
      for (const Point2D& at : corners) {
        nearest = std::min(nearest, (along_y * (at[0] - from[0]) - along_x * (at[1] - from[1])) / length);
      }
      largest = std::max(largest, nearest);
    }
  }
  return largest;
}

// The smallest distance of bodies above the ground y = 0 and from each other, from their corners alone.
inline double LowestGapOf(const RigidBodies2D& bodies, const double* x) {
  double lowest = std::numeric_limits<double>::infinity();
  for (int i = 0; i < std::ssize(bodies.scene().bodies); ++i) {
    for (const Point2D& corner : CornersOf(bodies, i, x)) lowest = std::min(lowest, corner[1]);
    for (int j = 0; j < i; ++j) lowest = std::min(lowest, SeparationOf(bodies, i, j, x));
  }
  return lowest;
}

class TossedBoxes {
 public:
  explicit TossedBoxes(int seed) : scene_(SceneOf(seed)), system_(scene_) {}

  struct Result {
    std::string refused;  // why there is no motion
    std::string wrong;    // what does not hold; empty if all does
    std::string why_no_derivative;
    int impacts = 0, closed = 0, gains = 0;  // closed: steps with a closed contact
    double lowest_gap = 0;                   // m
    double slowest = 0;                      // m/s: the smallest v_n after an impact
    double energy = 0;                       // gained over what the law of impact allows, of the largest
    bool gradient_compared = false;
    double gradient_error = 0;  // of the largest entry
  };

  Result Run(bool with_gradient, int most_events = 1000) {
    constexpr double kPenetration = 1e-9, kEnergy = 1e-9, kGradient = 1e-5, kApproaches = 1e-9;
    Result result;
    const HybridInput input{.initial = scene_.InitialState(), .parameters = scene_.Parameters(), .duration = 0.9};
    // Flights are polynomials, which need no small steps.
    HybridSimulator simulator(system_.hybrid(), {.steps_per_interval = 100, .most_events = most_events});
    const bool done = simulator.Rollout(input);
    if (!done) {
      result.refused = simulator.FailureReason();
      if (result.refused.empty()) result.wrong = "refused without a reason";
    }
    const MechanicalReport report = system_.Examine(simulator, input);
    result.impacts = static_cast<int>(report.impacts.size());
    result.gains = static_cast<int>(report.energy_gains.size());
    for (const MechanicalImpact& impact : report.impacts) {
      for (const MechanicalImpact::Contact& contact : impact.contacts) {
        result.slowest = std::min(result.slowest, contact.normal_after);
      }
    }
    // Energy, which impacts of Newton's law may raise by what the report says, and gaps.
    const double* p = input.parameters.data();
    const double size = std::abs(scene_.EnergyOf(input.initial.data(), p)) + 1;
    double bound = scene_.EnergyOf(input.initial.data(), p);
    std::size_t impact = 0;
    for (int k = 0; k < simulator.num_steps(); ++k) {
      const double* x = simulator.StepState(k).data();
      const bool is_closed =
          system_.hybrid().ModeName(simulator.StepMode(k)).find_first_not_of('o') != std::string::npos;
      result.closed += is_closed ? 1 : 0;
      const double now = scene_.EnergyOf(x, p);
      while (impact < report.impacts.size() && report.impacts[impact].time <= simulator.StepTime(k)) {
        bound += std::max(report.impacts[impact++].energy, 0.0);
      }
      result.energy = std::max(result.energy, (now - bound) / size);
      bound = std::min(bound, now);
      result.lowest_gap = std::min(result.lowest_gap, LowestGapOf(scene_, x));
    }
    char text[160];
    if (result.lowest_gap < -kPenetration) {
      std::snprintf(text, sizeof text, "penetration by %.3g; ", -result.lowest_gap);
      result.wrong += text;
    }
    if (result.slowest < -kApproaches) {
      std::snprintf(text, sizeof text, "approaches by %.3g after an impact; ", -result.slowest);
      result.wrong += text;
    }
    if (result.energy > kEnergy) {
      std::snprintf(text, sizeof text, "energy grows by %.3g; ", result.energy);
      result.wrong += text;
    }
    if (!done) return result;
    result.why_no_derivative = simulator.ReasonNotDifferentiable();
    if (!with_gradient || !result.why_no_derivative.empty()) return result;
    CompareGradient(input, simulator, &result);
    if (result.gradient_compared && result.gradient_error > kGradient) {
      std::snprintf(text, sizeof text, "the gradient differs from differences by %.3g; ", result.gradient_error);
      result.wrong += text;
    }
    return result;
  }

 private:
  static RigidBodies2D SceneOf(int seed) {
    std::mt19937 random(static_cast<unsigned>(seed));
    const auto uniform = [&](double low, double high) {
      return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
    };
    RigidScene2D scene{.bodies = {},
                       .planes = {{}},
                       .gravity = {0, -9.81},
                       .restitution = uniform(0, 0.8),
                       .friction = uniform(0.05, 0.8)};
    const int count = 1 + seed % 3;
    for (int i = 0; i < count; ++i) {
      RigidBody2D box{.name = "box" + std::to_string(i),
                      .polygon = BoxPolygon(uniform(0.05, 0.15), uniform(0.05, 0.15)),
                      .mass = uniform(0.2, 2)};
      // Beside each other, on the way to the middle.
      const double place = count == 1 ? 0 : 0.5 * (i - 0.5 * (count - 1));
      box.position = {place, uniform(0.3, 0.6)};
      box.velocity = {uniform(-0.5, 0.5) - 3 * place, uniform(-1, 1)};
      box.angle = uniform(-3, 3);
      box.spin = uniform(-6, 6);
      scene.bodies.push_back(box);
    }
    return RigidBodies2D(scene);
  }

  // A random function of the final state against differences of second order along a random direction of the start,
  // with two steps: where these disagree, the motion is not smooth over them.
  void CompareGradient(const HybridInput& input, HybridSimulator& simulator, Result* result) {
    const std::size_t size = input.initial.size();
    std::vector<double> weights(size), direction(size);
    for (std::size_t i = 0; i < size; ++i) {
      weights[i] = std::sin(1.0 + 2.3 * static_cast<double>(i));
      direction[i] = std::cos(0.7 + 1.9 * static_cast<double>(i));
    }
    const HybridGradient gradient = simulator.Adjoint(weights);
    double slope = 0;
    for (std::size_t i = 0; i < size; ++i) slope += gradient.initial[i] * direction[i];
    const std::vector<HybridEvent> events = simulator.events();
    const auto value_at = [&](double step, double* value) {
      HybridInput moved = input;
      for (std::size_t i = 0; i < size; ++i) moved.initial[i] += step * direction[i];
      if (!simulator.Rollout(moved) || simulator.events().size() != events.size()) return false;
      for (std::size_t i = 0; i < events.size(); ++i) {
        if (simulator.events()[i].guard != events[i].guard || simulator.events()[i].mode != events[i].mode)
          return false;
      }
      *value = 0;
      for (std::size_t i = 0; i < size; ++i) *value += weights[i] * simulator.final_state()[i];
      return true;
    };
    // Small steps for motions that amplify much.
    const double h = 1e-4 / std::max(1.0, std::abs(slope));
    double on = 0, back = 0, far_on = 0, far_back = 0;
    if (!value_at(h, &on) || !value_at(-h, &back) || !value_at(2 * h, &far_on) || !value_at(-2 * h, &far_back)) return;
    const double near = (on - back) / (2 * h), far = (far_on - far_back) / (4 * h), best = near + (near - far) / 3;
    if (std::abs(near - far) > 1e-5 * std::max(1.0, std::abs(best))) return;
    result->gradient_compared = true;
    result->gradient_error = std::abs(slope - best) / std::max(1.0, std::abs(best));
  }

  const RigidBodies2D scene_;
  const MechanicalSystem system_;
};

}  // namespace saltus
