// The scenes of the problems, with what a test wants changed.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "saltus/io/scene_file.h"

namespace saltus {

inline Scene ProblemScene(const std::string& name) {
  std::variant<Scene, SceneFileError> scene = LoadSceneFile(SALTUS_SOURCE_DIR "/problems/" + name + ".yaml");
  if (const SceneFileError* error = std::get_if<SceneFileError>(&scene)) {
    ADD_FAILURE() << error->ToString();
    return {};
  }
  return std::get<Scene>(scene);
}

}  // namespace saltus
