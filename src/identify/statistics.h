// Statistics of a fit: which parameters the data determine and how well, and which samples are outliers.
#pragma once

#include "identify/fit.h"

namespace saltus {

// Calls visit(segment, i, sample, residual) for sample i of each of the fit's segments, with its standardised residual.
template <typename Visit>
void ForEachSample(const FitProblem& problem, const FitResult& fit, const Visit& visit) {
  for (std::size_t s = 0; s < fit.point.segments.size(); ++s) {
    const Segment& segment = fit.point.segments[s];
    for (int i = 0; i < segment.last - segment.first; ++i) {
      const FitSample& sample = problem.SampleAt(segment, i);
      const Eigen::VectorXd residual = WeightsOf(problem, sample).cwiseProduct(fit.motion[s].miss[i]);
      visit(static_cast<int>(s), i, sample, residual);
    }
  }
}

// The scatter of the samples over their sigma: 1 if the model and sigma are right. It is the median of |r| over what is
// typical of noise in so many coordinates, without the smallest, of which there are as many as the numbers that were
// fitted make samples (Holland and Welsch 1977): a robust fit may pass through so many samples.
double MisfitOf(const FitProblem& problem, const FitResult& fit);

// Share of the samples with |r| above IdentifyOptions::outlier.
double OutlierShareOf(const FitProblem& problem, const FitResult& fit);

// The extent of the motion, in units of sigma: the diagonal of the largest box around the positions of one quantity in
// one recording, of that of its samples and that of the fit the smaller one, as samples have outliers.
double ExtentOf(const FitProblem& problem, const FitResult& fit);

// The standard deviations below the expected number of runs from which on errors are systematic.
constexpr double kSystematic = 3;

// Runs of samples in time that are alike, beside the number that independent errors have (Wald and Wolfowitz 1940).
struct Runs {
  int found = 0, signs = 0;
  double expected = 0, deviation = 0;  // mean, standard deviation
  bool Systematic() const { return found < expected - kSystematic * deviation; }
};
// Runs of residuals of one sign, by disc and coordinate, without outliers: of all, or of one of these that is
// systematic.
Runs CountRuns(const FitProblem& problem, const FitResult& fit);

// How outliers lie in time, disc by disc through all recordings.
struct OutlierRuns {
  bool follow_each_other = false;  // in fewer runs than random outliers form with a probability of 0.13 %
  double largest = 0;              // |r| of a position
  bool are_one_sided = false;      // most are in runs of three or more with one sign of a coordinate of the residual
};
OutlierRuns FindOutlierRuns(const FitProblem& problem, const FitResult& fit);

// Which unknowns the data leave open at the minimum: from the information on them, initial states and parameters of a
// law eliminated, in units of a change that matters. The latter, which have a prior, are never open.
// Unknowns that the samples push beyond their bounds are at their bounds.
struct Openness {
  std::vector<Determination> determination;
  std::vector<std::vector<int>> with;  // of combined ones: the others
};
Openness FindOpenUnknowns(const FitProblem& problem, const FitResult& fit, double loss_scale);

// The confidence in the fitted values, from the residuals.
//
// Huber's (1973) covariance of M-estimators takes the mean of the loss's slope over all samples. With few of them it
// matters which ones are outliers, as these say nothing where they are. So means are taken over the samples up to
// IdentifyOptions::outlier and over those beyond separately, and with J of a sample, its initial state eliminated,
//   covariance = A^-1 B A^-1,   A = sum slope J^T J,   B = sum force^2 J^T J.
struct Confidence {
  double scatter = 1;     // mean square of standardised numbers that are no outliers, per degree of freedom
  double degrees = 0;     // of freedom: numbers that are no outliers, less those that were fitted
  bool is_noise = false;  // the scatter may be that of noise of the sigma of the samples
  // Degrees of freedom of Student's t in intervals: `degrees`, and more where a stated sigma agrees with the scatter,
  // which then says less about noise than it.
  double interval_degrees = 0;
  Eigen::MatrixXd covariance;  // of the unknowns' values, 0 for those in `held`; empty if it has not full rank
};
Confidence ConfidenceOf(const FitProblem& problem, const FitResult& fit, double loss_scale,
                        const std::vector<bool>& held = {});

// The number that a variable of Student's t distribution exceeds in magnitude with a probability of 5 %. Precondition:
// degrees >= 3, for an error below 0.2 %.
double StudentQuantile(double degrees);

}  // namespace saltus
