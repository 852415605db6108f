// Event functions and updates with parameters w, for the impacts of discs with planes (Chen, Amos, Nickel 2021,
// Learning neural event functions). Identify() fits w to recordings, through the exact event times.
//
//   impact where the event function c falls to 0:   c(x(t), v(t); w) = 0,  dc/dt < 0
//   velocity after it by the update:                v+ = U(x, v; w)          x, v: of the disc's centre, just before it
//
// Time and state of an event are differentiated by the implicit function theorem, dt = -dc / (dc/dt), by w too. Impacts
// of two discs are those of `event`. c and a c with a > 0 are the same event function: those below have a gradient of
// length 1, or no freedom along the plane's normal. All numbers are in SI units, whatever
// Scene::units is. Sustained contacts are not supported: a motion in which discs come
// to rest on something fails with this reason.
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
  // The functions of a plane, which must not keep state. The parameter blocks of both are position, velocity and radius
  // of a disc (5 numbers: m, m/s, m), and all parameters.
  struct Plane {
    std::shared_ptr<const ceres::CostFunction> event = nullptr;   // one residual, c, m
    std::shared_ptr<const ceres::CostFunction> update = nullptr;  // two, v+, m/s
  };

  std::string name = "own events";  // for messages
  std::vector<Plane> planes;        // those of the scene, in their order
  std::vector<double> parameters;   // w, of all planes; a fit starts here
  // Standard deviation of the normal prior of each parameter around its start, in a fit; > 0.
  double spread = 10;
};

// Returns the first error as "found x, expected y"; empty if there is none. Precondition: the scene is valid.
std::string Validate(const EventFunctions& events, const Scene& scene);

// Returns event functions with an angle and a distance of each plane, and a linear update:
//   c = w.x / |w| - o - radius,   v+ = A v        parameters of each plane: w_x, w_y, o, and A by rows
// The start has the planes of the scene with its restitution, without friction. Because A is linear, it has friction in
// one direction of sliding only, and no sticking.
EventFunctions AffineEvents(const Scene& scene);

// Returns event functions of surfaces that are not flat, with restitution and Coulomb friction about their own normal:
//   c = n.x - offset - radius - h(s),   h = a + sum of c_i tanh(w_i s / length + b_i)      s along the plane
// parameters of each plane: w_0, b_0, w_1, b_1, ... of its `width` units, all c_i, a (m), and the logit of the
// restitution; if the scene has friction, the logarithm of its coefficient. The start has the planes and the contact of
// the scene (with a restitution from 0.001 to 0.999). Precondition: width >= 1.
EventFunctions ProfileEvents(const Scene& scene, int width);

// The values of the event functions of one plane for one disc.
struct EventValues {
  double value = 0;              // c, m
  Vec2d normal = Vec2d::Zero();  // of length 1, along the gradient of c by the position
  Vec2d after = Vec2d::Zero();   // U, m/s
};
// Evaluates the functions of a plane. Precondition: Validate() returns an empty text.
EventValues EvaluateEvents(const EventFunctions& events, int plane, const Vec2d& position, const Vec2d& velocity,
                           double radius);

}  // namespace saltus
