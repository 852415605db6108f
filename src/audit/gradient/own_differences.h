// Whether a model's gradient is the derivative of its own loss, at the scene's own steps.
//
// The loss is followed along a few directions, each a sum of all initial positions, velocities or forces with signs
// that are fixed but arbitrary, by differences of decreasing width to either side. A gradient that is no derivative of
// the steps (detached values, a forgotten dependence) agrees with none of them. Where a hundredth and a thousandth of a
// width change the loss as much as the whole, the loss jumps, and no narrower ones are tried. This says nothing of
// whether the steps are right, which is what the width sweep and the exact gradient are for.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "audit/gradient/step_study.h"
#include "saltus/audit/audit.h"
#include "saltus/control/single_shooting.h"

namespace saltus {

// Undecided where the model cannot simulate the scene. A stopped comparison has no meaning. Results do not depend on
// `threads`; more than one needs a model whose simulators may run in parallel. `most_states`: as in LargestSpeed().
OwnDifferences CompareWithOwnDifferences(const Contact& contact, const Scene& scene, const StopRequest& stop = nullptr,
                                         int threads = 1, int most_states = 0);

// Compares derivatives by parameters: those of `names` that the scene has (scene_parameter.h), each by itself. Left out
// are those that neither gradient nor differences depend on. Empty where the model cannot simulate the scene, or has
// derivatives by parameters in other precisions only.
std::vector<ParameterAudit> CompareParameters(const Contact& contact, const Scene& scene,
                                              const std::vector<std::string>& names, const StopRequest& stop = nullptr);
// Returns the names of the contact parameters, gravity, masses, and optimized ones; none in scenes with many discs.
std::vector<std::string> ParametersToCompare(const Scene& scene);

// Returns the loss of a scene as a function of its initial state or, for kControl, of its control.
std::unique_ptr<SingleShooting> ShootingBy(Quantity quantity, const Contact& contact, const Scene& scene,
                                           const StopRequest& stop);

// Returns the variables of a scene, without derivatives: the initial state of every disc that moves, as
// SingleShooting::Variables::kInitialState has it, and forces that are constant over `steps` rows of the control.
// `length`: the distance that discs move in a step, m.
std::vector<SweptVariable> VariablesOf(const Scene& scene, double length, int steps);

// Returns the largest speed of a disc in the simulator's last rollout, m/s: over all states, or if `most_states` is
// positive and there are more, over about as many at even distances.
double LargestSpeed(const Simulator& simulator, int most_states = 0);

}  // namespace saltus
