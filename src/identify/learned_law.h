// What a fit has learned of the law of impact, or of event functions.
#pragma once

#include "identify/fit.h"

namespace saltus {

// Precondition: a law is learned, and the fit has its motion.
LearnedLaw LearnedLawOf(const FitProblem& problem, const FitResult& fit, double loss_scale);

// Precondition: event functions are learned, and the fit has its motion.
LearnedEventFunctions LearnedEventsOf(const FitProblem& problem, const FitResult& fit);

}  // namespace saltus
