// Files of planar bodies as problems of mechanical systems. docs/reference/box-files.md lists the keys.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {

struct BodiesProblem {
  std::string name;
  HybridProblem problem;
  MechanicalSystem system;  // that of the problem
  RigidBodies2D bodies;
};

// Throws the error of a place in the file, which internal::ReadYaml catches.
BodiesProblem ReadBodies(const YAML::Node& root);

}  // namespace saltus
