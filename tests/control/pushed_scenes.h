// Short scenes of pushed discs with an impact or two, whose second derivatives are looked at.
#pragma once

#include "saltus/scene/scene.h"

namespace saltus {

// A disc that bounces straight back from a post on its way to the other side.
inline Scene HeadOn() {
  Scene scene;
  scene.name = "head_on_saddle";
  scene.duration = 1;
  scene.steps = 200;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {-1, 0}, .velocity = {2.5, 0}},
                  {.name = "post", .radius = 0.2, .fixed = true, .position = {0, 0}}};
  scene.contact.restitution = 0.9;
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {1, 0}}};
  scene.objective.effort = 0.5;
  scene.optimize = Optimize::kControl;
  return scene;
}

// Both pushed, one of them onto the ground, with friction and a term for each.
inline Scene TwoPushed() {
  Scene scene;
  scene.name = "two_pushed";
  scene.steps = 20;
  scene.gravity = {0.2, -3};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1.3, .position = {0, 0.7}, .velocity = {1.5, -1}},
                  {.name = "b", .radius = 0.15, .mass = 0.8, .position = {0.9, 1}, .velocity = {-0.3, -0.2}}};
  scene.planes = {{"ground", {0, 0}, {0.1, 1}}};
  scene.contact = {.restitution = 0.7, .friction = 0.1};
  scene.control = {{1, 0}, {{-1, 0.3}, {2, 0.4}}};
  scene.objective.terminal = {
      {.body = 0, .target = {1.2, 0.4}, .weight = 3},
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0}, .weight = 0.3},
      {.body = 1, .component = 1, .weight = -0.4}};
  scene.objective.effort = 0.1;
  scene.optimize = Optimize::kControl;
  return scene;
}

// Returns the scene with discs that spin, whose impacts slip or stick, and with terms of their spin.
inline Scene TwoSpin(double friction) {
  Scene scene = TwoPushed();
  scene.name = "two_spin";
  scene.contact.friction = friction;
  scene.bodies[0].inertia = {Inertia::Kind::kSolid};
  scene.bodies[0].angular_velocity = 8;
  scene.bodies[1].inertia = {Inertia::Kind::kGiven, 0.012};
  scene.bodies[1].angle = 0.3;
  using Quantity = TerminalTerm::Quantity;
  scene.objective.terminal.push_back({.body = 0, .quantity = Quantity::kAngle, .target = {2, 0}, .weight = 0.2});
  scene.objective.terminal.push_back(
      {.body = 1, .quantity = Quantity::kAngularVelocity, .target = {1, 0}, .weight = 0.1});
  return scene;
}

// Without the ground: they strike each other, with their spins as they were.
inline Scene SpinStrike(double friction) {
  Scene scene = TwoSpin(friction);
  scene.planes.clear();
  scene.bodies[1].position[1] = 0.35;
  return scene;
}

// Returns the scene with running terms of both of its discs, whose targets turn.
inline Scene WithRunningTerms(Scene scene) {
  scene.objective.running = {
      {.body = 0, .times = {0, 0.37, 1.3}, .targets = {{0, 0.7}, {0.6, 0.2}, {1, 0.5}}, .weight = 1.5},
      {.body = 1, .times = {0.2}, .targets = {{0.7, 0.6}}, .weight = 0.5},
      {.body = 0,
       .quantity = TerminalTerm::Quantity::kVelocity,
       .times = {0, 1.4},
       .targets = {{1, 0}, {0.5, 0.3}},
       .weight = 0.3}};
  return scene;
}

// Returns the scene, of two discs that are pushed, with torques on them too.
inline Scene WithTorques(Scene scene) {
  scene.control.torque_bodies = scene.control.bodies;
  scene.control.initial_torque = {0.03, -0.05};
  return scene;
}

}  // namespace saltus
