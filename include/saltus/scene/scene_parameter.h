// The names and values of the numbers of a scene that may be unknown (SceneParameter in scene.h).
//
//   restitution, friction, stiffness, damping    1, 1, N/m, N s/m: the members of Scene::contact
//   restitution.A-B, friction.A-B                in a scene with materials, in the place of restitution and friction:
//                                                of the pair of two materials; "default": without a material
//   gravity.x, gravity.y                         m/s^2; "gravity" is both
//   mass.BODY                                    kg, of a disc that moves
//   force.BODY.x, force.BODY.y                   N, constant, on a disc that moves; "force.BODY" is both
//   radius.BODY                                  m
//   position.BODY.x, position.BODY.y             m, of a fixed disc; "position.BODY" is both
//   drag.BODY                                    N s/m, of a disc that has drag in Scene::forces
//   offset.WALL                                  m, by which a plane is moved along its normal, or a segment to its
//                                                left, seen from its first end
//   angle.WALL                                   rad, by which a plane is rotated about its point, or a segment about
//                                                its middle, counter-clockwise
//
// Offsets and angles are 0 in the given scene; a value moves the wall from its given place.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// Returns the parameters of that name: one, or two for a vector without a component. Empty if the scene has none.
std::vector<SceneParameter> ParametersNamed(std::string_view name, const Scene& scene);
// Returns the name of a parameter, such as "restitution", "mass.ball" or "position.post.x". Precondition: the scene has
// it.
std::string NameOf(const SceneParameter& parameter, const Scene& scene);

// Returns whether a parameter is the angle of a wall.
bool IsAngle(SceneParameter::Kind kind);

// Returns the names of restitution and friction (of each pair of materials that may touch, if the scene has materials),
// stiffness and damping, separated by commas.
std::string ContactParametersOf(const Scene& scene);

// Returns the value of a parameter, in the scene's units; 0 for a parameter of a law, and for the force on a disc
// without a control.
double ValueOf(const SceneParameter& parameter, const Scene& scene);
// Sets the value of a parameter; does nothing for a parameter of a law. Restitution or friction of a pair of materials
// is written to Scene::pairs, with a new entry if needed.
void SetValue(const SceneParameter& parameter, double value, Scene* scene);
// Sets several parameters, in any order: walls are rotated before they are moved along their normal. Precondition: one
// value at least for each parameter.
void SetValues(std::span<const SceneParameter> parameters, std::span<const double> values, Scene* scene);

// The range of a design parameter: its bounds, and the range of its kind (restitution from 0 to 1; mass, radius,
// friction, stiffness and damping not negative). Infinite without a bound.
struct ParameterRange {
  double min = 0, max = 0;
};
ParameterRange RangeOf(const DesignParameter& design);

// Returns the value of a design parameter. Offset and angle of a wall are measured from its place in the given scene,
// and not from its present place.
double ValueOf(const DesignParameter& design, const Scene& scene);
// Returns the values of Scene::design in the scene, in its order.
std::vector<double> DesignOf(const Scene& scene);
// Returns the scene with these values, one for each of Scene::design; an empty span leaves the scene as it is. Walls
// are rotated before they are moved along their normal.
Scene WithDesign(const Scene& scene, std::span<const double> values);

}  // namespace saltus
