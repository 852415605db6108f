// One fit by Ceres, from one start: the minimum over the unknowns theta and the initial states x_s of the segments s of
//
//   1/2 sum over samples i of rho(|r_i|^2)  +  1/2 sum over learned parameters j of ((theta_j - start_j) / spread)^2
//   r_i = (h_i(theta, x_s) - y_i) / sigma_i
//
// with rho the loss of IdentifyOptions, y_i what was measured and h_i what a motion has in its place. Residuals and
// Jacobians come from a simulation and its sensitivities (FitModel), so a model with wrong derivatives ends at wrong
// parameters.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "identify/unknowns.h"
#include "saltus/contact/step_input.h"

namespace saltus {

// A part of one recording, with an initial state of its own.
struct Segment {
  int recording = 0;
  double begin = 0;             // s, of the recording
  int first = 0, last = 0;      // samples [first, last) of the recording
  std::vector<double> initial;  // as the model has it: of a scene B x 4
};

// Numbers that were measured together; they are outliers together.
struct FitSample {
  double time = 0;                 // s
  int quantity = 0;                // what was measured, such as the disc; into FitProblem::quantities
  Eigen::VectorXd value;           // measured
  Eigen::VectorXd sigma;           // standard deviations, 0 where none is stated
  Eigen::VectorXd unit;            // of FitProblem::sigma, which takes the place of these
  Eigen::Index num_positions = 1;  // numbers, the first ones, whose range is the extent of the motion
  int line = 0;                    // of a file, from 1; 0: of none
  Eigen::Index size() const { return value.size(); }
};

// The motion of one segment beside its samples.
struct FitMotion {
  bool ok = false;
  std::string reason;
  std::vector<Eigen::VectorXd> miss;        // of each sample: what the motion has less what was measured
  std::vector<Eigen::MatrixXd> derivative;  // of each, if asked for, by the unknowns' values and free initial states
  std::vector<Candidate> events;            // what touches what; of a hybrid system modes and guards
};

struct FitRequest;

// The motions that a fit compares with samples. Calls for different segments may come from different threads.
class FitModel {
 public:
  virtual ~FitModel() = default;
  // Makes the problem of the fit and its segments. Returns the reason if there is none.
  virtual std::string Prepare(FitRequest* request) = 0;
  // Simulates a segment up to its last sample, with these values of the unknowns.
  virtual FitMotion Move(const std::vector<double>& values, const Segment& segment, bool with_derivatives) const = 0;
  // Returns the number of ways in which initial states are found from samples; starts differ in it.
  virtual int num_start_kinds() const { return 1; }
  // Returns an initial state of a segment for these values, found in one of those ways.
  virtual std::vector<double> StartOf(const std::vector<double>& /*values*/, const Segment& segment,
                                      int /*kind*/) const {
    return segment.initial;
  }
  // Returns an estimated sigma with its unit.
  virtual std::string SigmaToText(double sigma) const = 0;
  // Return what may lack an effect, and what to check where no parameters explain the samples.
  virtual std::string Subject() const = 0;
  virtual std::string SuggestChecks() const = 0;
  // Adds what was learned beside the unknowns, whose values and covariance are given; that is empty if there is none.
  virtual void AddLearned(const std::vector<Segment>& /*segments*/, const std::vector<double>& /*values*/,
                          const Eigen::MatrixXd& /*covariance*/, IdentifyReport* /*report*/) const {}
};

// A prior of learned parameters, the last unknowns, which keeps them near their start where the data leave them open.
struct LearnedStart {
  std::vector<double> parameters;
  double spread = 1;     // about the start
  int learned_last = 0;  // so many of the first ones are held until the others are found
};

struct FitProblem {
  std::shared_ptr<const FitModel> model;
  struct Recording {
    std::string name;
    std::vector<FitSample> samples;  // in the order of time
  };
  std::vector<Recording> recordings;
  std::vector<std::string> quantities;  // their names
  std::vector<FitUnknown> unknowns;     // those that are learned are the last
  std::optional<LearnedStart> learned;
  // The numbers of Segment::initial that are unknown, each with the quantity whose samples determine it.
  struct FreeInitial {
    int number = 0, quantity = 0;
  };
  std::vector<FreeInitial> free_initial;
  IdentifyOptions options;
  bool states_sigma = false;    // whether samples do
  double sigma = 0;             // of numbers that state none, in their units
  bool drops_outliers = false;  // the loss is constant beyond IdentifyOptions::outlier

  int num_plain() const { return static_cast<int>(unknowns.size() - (learned ? learned->parameters.size() : 0)); }
  int num_columns() const { return static_cast<int>(unknowns.size() + free_initial.size()); }
  const FitSample& SampleAt(const Segment& segment, int i) const {
    return recordings[segment.recording].samples[segment.first + i];
  }
  std::vector<double> ValuesAt(const std::vector<double>& coordinates) const;
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
  std::vector<FitMotion> motion;  // of each segment, at the end, with derivatives
};

// Minimises from `start`, with the loss scale `loss_scale`, until the cost falls by less than a share `gain` of it in
// an iteration (or, of what is learned, by a larger one of its own). Unknowns in `held` stay as they are.
inline constexpr double kNoGain = 1e-12;
FitResult MinimizeFrom(const FitProblem& problem, const FitPoint& start, double loss_scale,
                       const std::vector<bool>& held = {}, double gain = kNoGain);

// Returns 1 / sigma of each number of a sample.
Eigen::VectorXd WeightsOf(const FitProblem& problem, const FitSample& sample);

// The loss rho, rho' and rho'' at a squared residual.
struct LossAt {
  double rho[3];
};
LossAt EvaluateLoss(const FitProblem& problem, double scale, double squared);

// A problem without its model, and the segments of its recordings.
struct FitRequest {
  FitProblem problem;
  std::vector<Segment> segments;
};
// Returns the first option that is out of range, with what was expected; empty if there is none.
std::string Validate(const IdentifyOptions& options);
// Fits from several starts, and judges the best fit (identify.h). `length` is the length of the motion in the unit of
// sigma, from which its estimates start.
IdentifyReport IdentifyBy(const std::shared_ptr<FitModel>& model, double length);

}  // namespace saltus
