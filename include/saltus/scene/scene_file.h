// Scene files: a scene in YAML, read with messages that say where and why, and written back.
//
// Keys, defaults and units:
//   name, duration, steps                    required
//   gravity                                  default [0, 0]
//   bodies                                   required: a list of name, radius, position (required), velocity (default
//                                            [0, 0]), fixed (default false), mass (required, unless fixed: then
//                                            refused)
//   planes                                   default none: a list of name, point, normal
//   contact                                  restitution, friction, stiffness, damping: defaults of ContactParameters
//   control                                  optional: bodies (a list of names), initial (a list of [x, y]); torque
//                                            (names of those that are turned too, of which initial has [x, y, torque]);
//                                            max, max_norm, max_torque (a number, or a list)
//   objective                                terminal (required: a list of body, quantity, weight (default 1), and
//   either
//                                            target or component), effort (default 0)
//   optimize                                 required: control | velocity | position | none
//   free                                     a list of names; default, for velocity and position: all bodies that move
// SI units, radians; every vector is [x, y]. What the values must satisfy stands in scene/scene.h.
//
// A scene file is one YAML document of maps, lists and scalars in UTF-8. Anchors, aliases, tags, repeated keys,
// nesting deeper than kMaxSceneDepth and texts longer than kMaxSceneBytes are refused.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <variant>

#include "saltus/scene/scene.h"

namespace saltus {

inline constexpr std::size_t kMaxSceneBytes = std::size_t{1} << 20;
inline constexpr int kMaxSceneDepth = 16;

// Why a text is not a scene.
struct SceneFileError {
  std::string file;
  int line = 0;         // from 1; 0 if the file could not be read
  std::string key;      // path such as "bodies[1].radius"; empty if the text is not YAML that a scene file may use
  std::string message;  // what was found and what was expected

  // One line: "two_balls.yaml:8: bodies[1].radius: found -0.2, expected ...".
  std::string ToString() const;
};

// The scene in the file at `path`; it passes Validate.
std::variant<Scene, SceneFileError> LoadSceneFile(const std::string& path);

// The scene in `text`; it passes Validate. Errors call the text `name`.
std::variant<Scene, SceneFileError> ParseScene(std::string_view text, const std::string& name);

// The text of a scene, which must pass Validate. Numbers are written so that ParseScene gives back an equal scene, save
// for what is not used: the mass of a fixed body and the target of a term with a component.
std::string WriteScene(const Scene& scene);

}  // namespace saltus
