// Which constraints of a scene the rows of its hybrid problem are (saltus/control/scene_problem.h).
#pragma once

#include <vector>

#include "saltus/control/scene_problem.h"

namespace saltus {

// The rows of a term of the problem. If row i has the multiplier theta_i, that of the constraint in the scene is the
// sum of theta_i by_i.
struct SceneConstraint {
  int term = 0;  // HybridProblem::terms
  const TerminalTerm* terminal = nullptr;
  const ViaTerm* via = nullptr;
  const SpeedLimit* limit = nullptr;  // one of these three is not null
  std::vector<Vec2d> by = {};         // of each row
};

// Makes the problem, and tells which of its terms are hard terms, goal regions and limits of the speed. The pointers
// are into `scene`, which must outlive them.
HybridProblem HybridProblemOf(const Scene& scene, std::vector<SceneConstraint>* constraints);

}  // namespace saltus
