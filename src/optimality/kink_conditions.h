// The conditions of optimality where the loss has a kink: a pair just touches, or strikes at the final time.
//
// With g the gap of the pair at that time as a function of the control, g = 0 separates motions without the impact from
// those with it, on either of which the loss is smooth.
//
//   touch    The loss L without the impact is stationary with g >= 0: grad L = mu grad g, mu >= 0. With it the relative
//            velocity jumps by a part of the closing speed, which grows as the root of -g: the loss must not fall with
//            an impulse between the two.
//   strike   The loss with the impact is stationary with g <= 0: grad L = -mu grad g, mu >= 0. Without it the loss is
//            greater by a jump of the terminal terms; or if there is none, its gradient is nu grad g, nu >= 0.
//
// (Nocedal and Wright, Numerical Optimization, 2nd edition, section 12.3, on each side.)
#pragma once

#include <vector>

#include "saltus/optimality/certificate.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// The verdict is kStationaryOnGrid, as the gradient is that by the control on the given intervals, or kNotStationary if
// a multiplier has the wrong sign; kNotApplicable without a kink, with what BeyondTerminalCost() names, and where the
// gradient is no combination of those of the gaps. The pairs are among the impacts, with their multipliers.
// Precondition: the scene is in natural units, and optimizes a control.
Certificate CertifyKinks(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations, const StopRequest& stop = nullptr);

}  // namespace saltus
