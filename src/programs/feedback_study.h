// The flags of --feedback, and its studies as tables and JSON.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/table.h"
#include "programs/json_output.h"
#include "programs/program.h"

namespace saltus {

// --feedback and the flags of its numbers; nothing without --feedback. Deviations have the names of the states and
// controls, "state" for all states, and "process_" or "measured_" before a state. Throws InputError for unknown names,
// impossible numbers, and numbers without --feedback.
std::optional<FeedbackOptions> FeedbackFromFlags(const std::vector<std::string>& states,
                                                 const std::vector<std::string>& controls);
// The options of a scene: position (m), velocity (m/s), angle (rad), angular_velocity (rad/s), force (N), torque (N m).
std::optional<FeedbackOptions> SceneFeedbackFromFlags();

// With `states`, also the costs to go and the covariances at all nodes.
Json FeedbackToJson(const FeedbackStudy& study, bool states);

// Studies as FeedbackToJson() returns them, with the names of their plans.
using NamedStudies = std::vector<std::pair<std::string, Json>>;
// Prints table and warnings on standard output, with `name` before the caption.
void PrintFeedback(const std::string& name, const NamedStudies& studies);
// Adds the table, and the warnings as a list.
void AddFeedbackSection(const NamedStudies& studies, Page* page);
// The exit code of feedback studies: wrong input, with a message on stderr, if weights of the regulator differ so much
// that there is none.
int FeedbackExitCode(const NamedStudies& studies);

}  // namespace saltus
