// The programs as a user runs them, on the problems' scenes.
#pragma once

#include "folders.h"
#include "programs/run_command.h"

namespace saltus {

inline std::string SceneFlag(const std::string& name) {
  return " --scene=" + SourceFolder() + "/problems/" + name + ".yaml ";
}

}  // namespace saltus
