// Total derivatives by parameters of a scene, from those by the constants of a step.
#pragma once

#include <optional>

#include "saltus/simulate/simulator.h"

namespace saltus {

// Returns the derivative by a parameter; std::nullopt for one of the scene's geometry, of which `by` has none. The mass
// of a solid disc changes its moment of inertia.
inline std::optional<double> SceneParameterDerivative(const Scene& scene, const SceneParameter& parameter,
                                                      const ParameterGradient& by) {
  using Kind = SceneParameter::Kind;
  const auto [kind, body, component] = parameter;
  switch (kind) {
    case Kind::kRestitution:
    case Kind::kFriction:
      return ContactDerivative(parameter, by);
    case Kind::kStiffness:
      return by.stiffness;
    case Kind::kDamping:
      return by.damping;
    case Kind::kGravity:
      return by.gravity[component];
    case Kind::kForce:
      return by.force[body][component];
    case Kind::kDrag:
      return by.drag[body];
    case Kind::kMass: {
      const bool solid = scene.bodies[body].inertia.kind == Inertia::Kind::kSolid && !by.inertia.empty();
      const double radius = scene.bodies[body].radius;
      return by.mass[body] + (solid ? 0.5 * radius * radius * by.inertia[body] : 0.0);
    }
    default:
      return std::nullopt;
  }
}

}  // namespace saltus
