// One fit by Ceres, from one start: the minimum over the unknowns theta and the initial states x_s of the segments s of
//
//   1/2 sum over samples i of rho(|r_i|^2)  +  1/2 sum over learned parameters j of ((theta_j - start_j) / spread)^2
//   r_i = (p(t_i; theta, x_s) - p_i) / sigma_i, and if velocities are measured (v(t_i; theta, x_s) - v_i) / sigma_v,i
//
// with rho the loss of IdentifyOptions. Residuals and Jacobians come from the simulated motion and its sensitivities
// (segment_motion.h), so a model with wrong derivatives ends at wrong parameters.
#pragma once

#include <string>
#include <vector>

#include "identify/segment_motion.h"

namespace saltus {

// The data of a fit, which must outlive it.
struct FitProblem {
  Contact contact;
  Scene scene;  // of known parameters
  const std::vector<Recording>* recordings = nullptr;
  std::vector<Unknown> unknowns;
  std::vector<int> free_bodies;
  const IdentifyOptions* options = nullptr;
  int num_plain = 0;  // unknowns except for the parameters of what is learned, which are the last
  double sigma = 0;   // m, of samples that state none; of velocities by the time that the scene needs for its length
  double sigma_velocity = 0;
  bool drops_outliers = false;  // the loss is constant beyond IdentifyOptions::outlier

  // `law` or `events` as at the point at hand, if one of them is learned.
  MotionRequest RequestOf(const Segment& segment, const std::optional<ImpactLaw>& law,
                          const std::optional<EventFunctions>& events) const {
    return {&(*recordings)[segment.recording].samples,
            unknowns,
            free_bodies,
            law ? &*law : nullptr,
            events ? &*events : nullptr};
  }
  const Sample& SampleAt(const Segment& segment, int i) const {
    return (*recordings)[segment.recording].samples[segment.first + i];
  }
  Scene SceneAt(const std::vector<double>& coordinates) const;
  // Return the learned law and events at these coordinates, std::nullopt if none is learned.
  std::optional<ImpactLaw> LawAt(const std::vector<double>& coordinates) const;
  std::optional<EventFunctions> EventsAt(const std::vector<double>& coordinates) const;
};

// The variables of a fit.
struct FitPoint {
  std::vector<double> coordinates;  // of the unknowns (unknowns.h)
  std::vector<Segment> segments;    // with their initial states
};

struct FitResult {
  bool ok = false;  // there is a cost
  bool converged = false;
  std::string reason;
  double cost = 0;
  int num_fitted = 0;  // numbers that the samples were to determine: unknowns that are not held, and initial states
  int iterations = 0, evaluations = 0;
  FitPoint point;
  std::vector<MotionAtSamples> motion;  // of each segment, at the end, with derivatives
};

// The parameters that are learned, of whichever kind: their start, and the spread about it.
struct LearnedStart {
  std::vector<double> parameters;
  double spread = 1;
};
std::optional<LearnedStart> LearnedStartOf(const IdentifyOptions& options);

// Minimises from `start`, with the loss scale `loss_scale`, until the cost falls by less than a share `gain` of it in
// an iteration (or, of what is learned, by a larger one of its own). Unknowns in `held` stay as they are.
inline constexpr double kNoGain = 1e-12;
FitResult MinimizeFrom(const FitProblem& problem, const FitPoint& start, double loss_scale,
                       const std::vector<bool>& held = {}, double gain = kNoGain);

// Returns the standardised residual of a sample: of its position, then of its velocity if it was measured.
Eigen::VectorXd ResidualOf(const FitProblem& problem, const Sample& sample, const Eigen::Vector4d& state);
// Returns 1 / sigma of each of its entries.
Eigen::VectorXd WeightsOf(const FitProblem& problem, const Sample& sample);

// The loss rho, rho' and rho'' at a squared residual.
struct LossAt {
  double rho[3];
};
LossAt EvaluateLoss(const FitProblem& problem, double scale, double squared);

}  // namespace saltus
