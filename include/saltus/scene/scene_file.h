// Scene files: reads a scene from YAML, with errors that name file, line, key and what was expected, and writes it.
//
// docs/reference/scene-files.md lists the keys with their types, units and defaults, and scene/scene.h the conditions
// on their values. A scene file is one YAML document of maps, lists and scalars in UTF-8. Anchors, aliases, tags,
// repeated keys, nesting deeper than kMaxSceneDepth and texts longer than kMaxSceneBytes are refused.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <variant>

#include "saltus/scene/scene.h"

namespace saltus {

inline constexpr std::size_t kMaxSceneBytes = std::size_t{1} << 20;
inline constexpr int kMaxSceneDepth = 16;

// The reason why a text is not a scene.
struct SceneFileError {
  std::string file;
  int line = 0;         // from 1; 0 if the file could not be read
  std::string key;      // path such as "bodies[1].radius"; empty if the text is not YAML that a scene file may use
  std::string message;  // what was found and what was expected

  // One line: "two_balls.yaml:8: bodies[1].radius: found -0.2, expected ...".
  std::string ToString() const;
};

// Reads the scene in the file at `path`; the scene that it returns passes Validate.
std::variant<Scene, SceneFileError> LoadSceneFile(const std::string& path);

// Reads the scene in `text`; it passes Validate. `name` stands for the file in errors.
std::variant<Scene, SceneFileError> ParseScene(std::string_view text, const std::string& name);

// Returns the text of a scene, which must pass Validate. ParseScene returns an equal scene from it, apart from unused
// values: the mass of a fixed body and the target of a term with a component.
std::string WriteScene(const Scene& scene);

}  // namespace saltus
