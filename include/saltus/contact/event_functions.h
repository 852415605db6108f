// Event functions and updates that have parameters, after Chen, Amos, Nickel 2021, Learning neural event functions:
// where and how discs bounce off the planes of a scene is learned from recordings (Identify()), through the exact event
// times.
//
//   An impact of a disc with a plane is where the event function c falls to 0:     c(x(t), v(t); w) = 0,  dc/dt < 0
//   Its velocity after it is what the update says:                                 v+ = U(x, v; w)
//
// Time and state of an event are differentiated by the implicit function theorem, dt = -dc / (dc/dt), by w too. Between
// two discs impacts are those of `event`. c and a c with a > 0 are the same event function: those below have a gradient
// of length 1, or no freedom along the plane's normal.
//
// Contacts that last are not known to it: a motion in which discs come to rest on something fails, and says so.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace ceres {
class CostFunction;
}

namespace saltus {

struct EventFunctions {
  // Functions for a plane. Parameter blocks of both: position, velocity, radius of a disc (5 numbers: m, m/s, m), all
  // parameters. Must not keep state.
  struct Plane {
    std::shared_ptr<const ceres::CostFunction> event = nullptr;   // one residual, c, m
    std::shared_ptr<const ceres::CostFunction> update = nullptr;  // two, v+, m/s
  };

  std::string name = "own events";  // for messages
  std::vector<Plane> planes;        // those of the scene, in their order
  std::vector<double> parameters;
  // Where they are learned: each parameter has a normal prior of this standard deviation around its start. > 0.
  double spread = 10;
};

// Returns the first error as "found x, expected y"; empty if there is none. The scene must be valid.
std::string WhatIsWrongWith(const EventFunctions& events, const Scene& scene);

// The gap of a plane at some angle and distance, and a linear update:
//   c = w.x / |w| - o - radius,   v+ = A v        parameters of each plane: w_x, w_y, o, and A by rows
// Begins as the scene's planes with its restitution, without friction. A is linear: it slides with friction to one
// side, and cannot stick.
EventFunctions AffineEvents(const Scene& scene);

// A plane that is not flat, with restitution and Coulomb's friction about its own normal:
//   c = n.x - offset - radius - h(s),   h = a + sum of c_i tanh(w_i s / length + b_i)      s along the plane
// parameters of each plane: w_i, b_i of its `width` units, all c_i, a, and the restitution by its logit; if the scene
// has friction, the logarithm of its coefficient. Begins as the scene's planes and its contact (restitution at most
// 0.999, at least 0.001). Precondition: width >= 1.
EventFunctions ProfileEvents(const Scene& scene, int width);

// Their values for a disc.
struct EventAt {
  double value = 0;              // c, m
  Vec2d normal = Vec2d::Zero();  // of length 1, along the gradient of c by the position
  Vec2d after = Vec2d::Zero();   // U, m/s
};
// Precondition: nothing is wrong with them.
EventAt EvaluateEvents(const EventFunctions& events, int plane, const Vec2d& position, const Vec2d& velocity,
                       double radius);

}  // namespace saltus
