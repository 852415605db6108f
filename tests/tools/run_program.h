// The programs as a user runs them, on the problems' scenes.
#pragma once

#include "tools/run_command.h"

namespace saltus {

inline std::string Scene(const std::string& name) {
  return " --scene=" SALTUS_SOURCE_DIR "/problems/" + name + ".yaml ";
}

}  // namespace saltus
