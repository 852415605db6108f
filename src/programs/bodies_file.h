// Files of planar bodies as problems of mechanical systems. docs/reference/box-files.md lists the keys.
#pragma once

#include <yaml-cpp/yaml.h>

#include "programs/hybrid_program.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {

struct BodiesTask : HybridTask {
  MechanicalSystem system;
};

// Throws the error of a place in the file, which internal::ReadYaml catches.
BodiesTask ReadBodies(const YAML::Node& root);

}  // namespace saltus
