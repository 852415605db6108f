// Simulators of scenes whose discs are moved by more than gravity, the control and contacts (NonBallisticForces).
#pragma once

#include <memory>
#include <string>

#include "saltus/simulate/simulator.h"

namespace saltus {

// Returns the scene without its forces that depend on the state and without its prescribed motions, for the simulator
// of a time-stepping model that AddForces() takes.
Scene RemoveForces(const Scene& scene);

// Makes a simulator of a scene from one of RemoveForces(). Each step has the forces at the state in which it begins,
// and what has a prescribed motion moves at its mean velocity during the step.
std::unique_ptr<Simulator> AddForces(const Scene& scene, std::unique_ptr<Simulator> inner);

// Returns why MakeIntegratedScene() does not take a scene; empty if it does. Precondition: the contact model `event`
// takes the scene without forces and prescribed motions.
std::string UnsupportedByIntegratedScene(const Scene& scene);

// Makes the simulator of the contact model `event`, whose traits are given, for such a scene: flights between impacts
// are those of the scene as a hybrid system (saltus/control/scene_problem.h), in closed form or integrated to 1e-12. A
// public step begins at time 0. Precondition: UnsupportedByIntegratedScene() is empty.
std::unique_ptr<Simulator> MakeIntegratedScene(const Scene& scene, const ModelTraits& event);

}  // namespace saltus
