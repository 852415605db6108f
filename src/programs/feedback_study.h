// The study of --feedback about a solution: the regulator along it, the covariance of its errors in open and in closed
// loop, and simulated runs with noise beside both.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/table.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/feedback/closed_loop.h"
#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// --feedback and the flags of its numbers; nothing without --feedback. Deviations have the names of the states and
// controls, "state" for all states, and "process_" or "measured_" before a state. Throws InputError for unknown names,
// impossible numbers, and numbers without --feedback.
std::optional<FeedbackOptions> FeedbackFromFlags(const std::vector<std::string>& states,
                                                 const std::vector<std::string>& controls);
// The options of a scene: position (m), velocity (m/s), angle (rad), angular_velocity (rad/s), force (N), torque (N m).
std::optional<FeedbackOptions> SceneFeedbackFromFlags();

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

// With `states`, also the costs to go and the covariances at all nodes.
Json FeedbackToJson(const FeedbackStudy& study, bool states);

using NamedStudies = std::vector<std::pair<std::string, const FeedbackStudy*>>;
// One row for each loop of each study.
Table FeedbackTable(const NamedStudies& studies);
// Prints table and warnings on standard output, with `name` before the caption.
void PrintFeedback(const std::string& name, const FeedbackOptions& options, const NamedStudies& studies);
// Returns the caption of the table, a sentence without its full stop.
std::string FeedbackCaption(const FeedbackOptions& options);
// The warnings of the studies.
std::vector<std::string> FeedbackWarnings(const NamedStudies& studies);

}  // namespace saltus
