// Common parts of the tests of learned contacts, laws of impact and event functions.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <type_traits>
#include <vector>

#include "identify/generated_problem.h"
#include "identify/segment_motion.h"
#include "saltus/control/objective.h"
#include "test_scenes.h"

namespace saltus {

// The loss of a scene under a contact model, with its gradient by the adjoint.
struct LossAndGradient {
  double loss = 0;
  Sensitivity gradient;
};
inline LossAndGradient Evaluate(const Contact& contact, const Scene& scene) {
  LossAndGradient out;
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())))
      << simulator->FailureReason();
  std::vector<double> end(simulator->state_size()), cotangent(end.size());
  simulator->GetState(simulator->num_steps(), end);
  out.loss = TerminalLoss(scene.objective, end, 4);
  TerminalGradient(scene.objective, end, 4, cotangent);
  simulator->Adjoint(cotangent, true, &out.gradient);
  return out;
}

// The values of task 2, without and with friction, from closed forms, where contact_of(scene) is the contact.
template <typename ContactOf>
void ExpectExactLaunches(const ContactOf& contact_of) {
  struct Launch {
    double friction, loss, dp[2], dv[2];
  };
  for (const Launch& exact : {Launch{0, 8.316138586, {-5.277120, 0.216286}, {-3.166272, -0.212230}},
                              Launch{0.1, 11.484328848, {-6.313214, -0.228822}, {-3.787928, -0.773744}}}) {
    Scene scene = ProblemScene("ground_wall");
    scene.contact.friction = exact.friction;
    const LossAndGradient launch = Evaluate(contact_of(scene), scene);
    EXPECT_NEAR(launch.loss, exact.loss, 1e-8);
    for (int j = 0; j < 2; ++j) {
      EXPECT_NEAR(launch.gradient.initial[j], exact.dp[j], 1e-6);
      EXPECT_NEAR(launch.gradient.initial[2 + j], exact.dv[j], 1e-6);
    }
  }
}

// A ball in a corner, thrown hard, and another: with steps of 0.1 s, some with two impacts.
inline Scene ThrowIntoACorner() {
  Scene scene;
  scene.name = "corner";
  scene.duration = 1.5;
  scene.steps = 15;
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.05, .mass = 0.3, .position = {0, 0.6}, .velocity = {4, -2}},
                  {.name = "other", .radius = 0.1, .mass = 0.5, .position = {-0.6, 0.4}, .velocity = {0, 1}}};
  scene.planes = {{"floor", {0, 0}, {0, 1}}, {"right", {0.5, 0}, {-1, 0}}, {"left", {-1, 0}, {1, 0}}};
  scene.contact = {.restitution = 0.8};
  scene.objective.terminal = {{.body = 0, .target = {0.1, 0.3}}, {.body = 1, .target = {-0.2, 0.5}}};
  return scene;
}

// A ball above a floor.
inline Scene BallAboveAFloor(double duration, int steps, const Vec2d& velocity) {
  Scene scene;
  scene.name = "ball";
  scene.duration = duration;
  scene.steps = steps;
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.05, .mass = 0.3, .position = {0, 1}, .velocity = velocity}};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  return scene;
}

// Where the only disc of a scene is after every so many steps, with noise (m).
inline Recording RecordDisc(const Contact& contact, const Scene& scene, int every, double noise,
                            GeneratedRandom* random) {
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, scene.steps)));
  Recording recording{"disc", {}};
  std::vector<double> x(4);
  for (int k = every; k <= scene.steps; k += every) {
    simulator->GetState(k, x);
    recording.samples.push_back({.time = k * simulator->step(),
                                 .position = {x[0] + noise * random->Normal(), x[1] + noise * random->Normal()},
                                 .sigma = std::max(noise, 1e-6)});
  }
  return recording;
}

// The motion of all discs from a scene's start, measured as `recording`, with derivatives by all parameters of a law or
// of event functions, whichever `learned` is.
template <typename Learned>
MotionAtSamples MoveFromStart(const Scene& scene, const Recording& recording, const Learned& learned) {
  MotionRequest request;
  request.samples = &recording.samples;
  for (int i = 0; i < scene.num_bodies(); ++i) request.free_bodies.push_back(i);
  if constexpr (std::is_same_v<Learned, ImpactLaw>) {
    request.law = &learned;
  } else {
    request.events = &learned;
  }
  for (int i = 0; i < static_cast<int>(learned.parameters.size()); ++i) {
    request.unknowns.push_back({.kind = Unknown::Kind::kLaw, .component = i});
  }
  const Segment segment{0, 0, 0, static_cast<int>(recording.samples.size()), InitialState(scene)};
  return MoveThrough("event", scene, segment, request, true);
}

// Compares the derivatives by parameters, which are those of `motion`, with differences.
template <typename Learned>
void ExpectDerivativesByParameters(const MotionAtSamples& motion, const Scene& scene, const Recording& recording,
                                   const Learned& learned, double tolerance) {
  for (std::size_t p = 0; p < learned.parameters.size(); ++p) {
    const auto shifted = [&](double by) {
      Learned other = learned;
      other.parameters[p] += by;
      return MoveFromStart(scene, recording, other);
    };
    const double width = 1e-6;
    const MotionAtSamples up = shifted(width), down = shifted(-width);
    for (std::size_t i = 0; i < recording.samples.size(); ++i) {
      const Eigen::Vector4d difference = (up.state[i] - down.state[i]) / (2 * width);
      ASSERT_LT((motion.derivative[i].col(static_cast<Eigen::Index>(p)) - difference).norm(),
                tolerance * (1 + difference.norm()))
          << learned.name << ", parameter " << p << " at " << recording.samples[i].time;
    }
  }
}

}  // namespace saltus
