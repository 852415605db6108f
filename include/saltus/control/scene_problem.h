// Conversion of a scene of discs to a problem of a hybrid system (hybrid/hybrid_problem.h), to which a user can add
// costs at events and user-defined costs and constraints, and whose solvers then apply.
//
// The system has the bodies of the scene in its units, fixed ones too. Its state is
//
//   [x y v_x v_y] of each body, then [angle, angular velocity] of each body if one spins, then the integral of the
//   running terms if there are any
//
// with names as "puck.x", "puck.vx", "puck.angle", "puck.spin", "running"; its control is that of the scene
// (Scene::control_width), with names as "striker.fx", "striker.fy", "striker.turn". Events have the names of pairs, as
// "striker-puck". Between events the motion has a closed form, so that a step of the integration has any length and no
// error, unless there are springs that have a length, drag or springs beside prescribed motions or in a system of more
// than 64 states, or running terms beside any of these. A waypoint is an event "waypoint 1" at a given time, after
// which the system is in another mode with the same flow.
#pragma once

#include <string>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Returns the part of a scene that such a problem does not support; empty if it supports all. Not supported are walls
// that end, pockets, a table that slows discs, and terms and springs of a fixed disc whose position is a design
// parameter.
std::string UnsupportedByHybridProblem(const Scene& scene);

// Makes the problem: the motion of the contact model `event`, the loss of the scene, its constraints and bounds, and
// its unknowns: design parameters are its parameters, in the order of Scene::design. Pairs that must not touch have no
// motion behind a touch. Precondition: UnsupportedByHybridProblem() is empty, and ValidateStructure finds nothing.
HybridProblem MakeHybridProblem(const Scene& scene);

}  // namespace saltus
