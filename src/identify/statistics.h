// Statistics of a fit: which parameters the data determine and how well, which samples are outliers, and what was
// learned of the law of impact or of event functions.
#pragma once

#include "identify/fit.h"

namespace saltus {

// Calls visit(segment, i, sample, residual) for sample i of each of the fit's segments, with its standardised residual.
template <typename Visit>
void ForEachSample(const FitProblem& problem, const FitResult& fit, const Visit& visit) {
  for (std::size_t s = 0; s < fit.point.segments.size(); ++s) {
    const Segment& segment = fit.point.segments[s];
    for (int i = 0; i < segment.last - segment.first; ++i) {
      const Sample& sample = problem.SampleAt(segment, i);
      visit(static_cast<int>(s), i, sample, ResidualOf(problem, sample, fit.motion[s].state[i]));
    }
  }
}

// |r| of every sample, as a multiple of what is typical of noise in so many coordinates: the median is 1 if the model
// and sigma are right.
double MisfitOf(const FitProblem& problem, const FitResult& fit);

// Share of the samples with |r| above IdentifyOptions::outlier.
double OutlierShareOf(const FitProblem& problem, const FitResult& fit);

// Which unknowns the data leave open at the minimum: from the information on them, initial states and parameters of a
// law eliminated, in units of a change that matters. The latter, which have a prior, are never open.
struct Openness {
  std::vector<Determination> determination;
  std::vector<std::vector<int>> with;  // of combined ones: the others
};
Openness FindOpenUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale);

// By how much the loss and the true noise change (J^T J)^-1: Huber's factor for M-estimators.
double CovarianceFactor(const FitProblem& problem, const FitResult& fit, double loss_scale);

// Precondition: a law is learned, and the fit has its motion.
LearnedLaw LearnedLawOf(const FitProblem& problem, const FitResult& fit, double loss_scale);

// Precondition: event functions are learned, and the fit has its motion.
LearnedEventFunctions LearnedEventsOf(const FitProblem& problem, const FitResult& fit);

}  // namespace saltus
