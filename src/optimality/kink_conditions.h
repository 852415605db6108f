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

// The verdict is kStationaryOnGrid if the conditions hold on both sides of each kink, and kNotStationary if they hold
// on the side of the motion alone. It is kNotApplicable without a kink, where they do not hold on that side, for
// systems that create modes, and for events at a final time that is free. The guards are among the impacts, with their
// multipliers.
Certificate CertifyKinks(const HybridProblem& problem, const HybridInput& input);

// Certifies the kinks of a scene, as of the problem that it is. The verdict is kNotApplicable also for what
// UnsupportedByHybridProblem() names (control/scene_problem.h). Precondition: the scene optimizes a control.
Certificate CertifyKinks(const Scene& scene, const std::vector<double>& control, const std::vector<double>& durations);

// Sets the names of an impact of a pair.
void NamePair(const Scene& scene, const Candidate& pair, ImpactCertificate* impact);

}  // namespace saltus
