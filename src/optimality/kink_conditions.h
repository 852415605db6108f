// The conditions of optimality where the loss has a kink: a guard just touches zero, or has its event at the final
// time.
//
// With g the guard at that time as a function of the control, g = 0 separates motions without the event from those with
// it, on either of which the loss is smooth.
//
//   touch    The loss L without the event is stationary with g >= 0: grad L = mu grad g, mu >= 0. With it the state
//            jumps by a part of the rate at which the guard falls, which grows as the root of -g: the loss must not
//            fall with such a jump.
//   strike   On the side of the motion L is stationary, grad L = mu grad g without the event and -mu grad g with it,
//            mu >= 0. On the other side the loss is greater by a jump of its terms; or if there is none, its gradient
//            has a multiplier of the right sign, too.
//
// (Nocedal and Wright, Numerical Optimization, 2nd edition, section 12.3, on each side.)
#pragma once

#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The verdict is kStationaryOnGrid, as the gradient is that by the control on the given intervals, or kNotStationary if
// a multiplier has the wrong sign; kNotApplicable without a kink, where the gradient is no combination of those of the
// guards, and for constraints, terms at events or in some modes only, terms of the state at the start, systems that
// create modes, and problems whose control has no cost of its own. The guards are among the impacts, with their
// multipliers.
Certificate CertifyKinks(const HybridProblem& problem, const HybridInput& input);

// Certifies the kinks of a scene, as of the problem that it is (control/scene_problem.h). The verdict is kNotApplicable
// also with what BeyondTerminalCost() names. Precondition: the scene optimizes a control.
Certificate CertifyKinks(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations);

}  // namespace saltus
