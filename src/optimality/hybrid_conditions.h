// The conditions of saltus/optimality/hybrid_certificate.h of a motion that stays on one side of its kinks.
#pragma once

#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// A guard that touches zero within a phase or at the end, and must not fall below it there: a constraint, whose
// multiplier is among those of the events.
struct GuardTouch {
  int mode = 0, guard = 0;
  double time = 0;  // s
};

// Certifies as Certify() does, with these constraints and without a look at kinks; with touches there is no curvature.
// Precondition: WhatIsWrongWith(input, problem.system) is empty, and the motion begins at time 0.
Certificate CertifyWithTouches(const HybridProblem& problem, const HybridInput& input,
                               const std::vector<GuardTouch>& touches);

}  // namespace saltus
