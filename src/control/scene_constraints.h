// Which constraints of a scene the rows of its hybrid problem are (saltus/control/scene_problem.h).
#pragma once

#include <algorithm>
#include <vector>

#include "saltus/control/scene_problem.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/simulator.h"

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
HybridProblem MakeHybridProblem(const Scene& scene, std::vector<SceneConstraint>* constraints);

// The parameters of a scene's system: none, those of Scene::design in its order, whose values change the motion, or
// all, by which the motion has derivatives alone.
enum class SceneParameters { kNone, kDesign, kAll };

// Where all parameters are: restitution and friction of each pair of materials by MaterialPairIndex(), gravity, and of
// each disc its mass, its moment of inertia and the coefficient of a linear drag. They are constants: the functions of
// the system have the values that the scene gives, whatever the values of its parameters.
struct ParameterPlaces {
  ParameterPlaces(const Scene& scene, SceneParameters parameters)
      : num_pairs(std::max(1, static_cast<int>(PairContactsOf(scene).size()))),
        num_bodies(scene.num_bodies()),
        exist(parameters == SceneParameters::kAll) {}

  int Restitution(int pair) const { return 2 * pair; }
  int Friction(int pair) const { return 2 * pair + 1; }
  int Gravity() const { return 2 * num_pairs; }
  int Mass(int body) const { return Gravity() + 2 + body; }
  int Inertia(int body) const { return Mass(num_bodies) + body; }
  int Drag(int body) const { return Inertia(num_bodies) + body; }
  int size() const { return exist ? Drag(num_bodies) : 0; }

  int num_pairs, num_bodies;
  bool exist;
};

// Makes the system alone. Discs fly as in a step of `flight`, which must outlive the system and fly over any length; if
// it is null, exactly.
HybridSystem SceneSystemOf(const Scene& scene, SceneParameters parameters, const Simulator* flight = nullptr);

// Returns the guess of the problem of a scene with another initial state (of the scene), control and lengths of its
// intervals, s.
HybridInput InputOf(const HybridProblem& problem, const std::vector<double>& initial,
                    const std::vector<double>& control, const std::vector<double>& lengths);

}  // namespace saltus
