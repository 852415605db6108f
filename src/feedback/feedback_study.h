// A study of a planned motion: the regulator along it, the covariance of its errors in open and in closed loop, and
// simulated runs with noise beside both.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "saltus/feedback/closed_loop.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Prefixes of components of the state in the names of standard deviations: none for the initial state, then those for
// the process of each step and for measurements.
inline constexpr std::array<const char*, 3> kDeviationPrefixes = {"", "process_", "measured_"};
inline constexpr char kAllStates[] = "state";  // the name of every component of the state

// The options of a study.
struct FeedbackOptions {
  // The regulator minimizes the integral of state |dx|^2 + control |du|^2, plus final |dx|^2 at the end, in SI units.
  double state = 10, control = 1e-3, final = 10;
  // The standard deviations of independent normal errors, by name; not yet multiplied by `scale`.
  std::vector<std::pair<std::string, double>> deviations;
  double scale = 1;
  std::string plant = "event";  // the contact model of the simulated runs of a scene
  int samples = 1000;           // 0: no runs
  std::uint64_t seed = 1;
};

struct FeedbackStudy {
  struct Loop {
    Covariance covariance = {};
    std::optional<double> expected_loss = {};  // to first order in the errors
    std::optional<MonteCarlo> runs = {};
  };

  std::string reason;          // why there is no study, and then there is nothing else; empty otherwise
  std::string remark;          // why derivatives of the motion are one-sided; empty if they are not
  std::vector<double> times;   // K + 1, s: the beginnings of the intervals, and the end
  std::optional<double> loss;  // of the plan without errors; of scenes whose loss is of the final state and the control
  Eigen::VectorXd planned;     // the final state
  std::vector<Eigen::MatrixXd> gains, cost_to_go;  // as in Regulator; none without controls
  std::string plant;                               // empty for hybrid systems, which are simulated as they are
  int samples = 0;
  Loop open;
  std::optional<Loop> closed;  // nothing without controls
};

// Studies the exact motion of a scene under a control, on the intervals of the control.
FeedbackStudy StudyFeedback(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                            const std::vector<double>& durations, const FeedbackOptions& options, int threads);
FeedbackStudy StudyFeedback(const HybridProblem& problem, const HybridInput& input, const FeedbackOptions& options,
                            int threads);

// Returns the root mean square of the final error of the runs, or to first order; positions in m, velocities in m/s,
// angles in rad together. Not a number if fewer than two runs count.
double FinalError(const FeedbackStudy& study, const MonteCarlo& runs);
double FinalError(const Covariance& covariance);

}  // namespace saltus
