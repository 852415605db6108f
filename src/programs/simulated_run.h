// What a solution does, whatever found it: under the contact model asked for, and under exact dynamics.
#pragma once

#include <string>
#include <vector>

#include "programs/motion.h"
#include "programs/program.h"
#include "programs/solved_run.h"

namespace saltus {

// Fills all that follows from the report's initial state and control: the exact run, the certificate, final_state.
void CheckRun(const Scene& scene, const Contact& contact, Precision precision, SolvedRun* run);

// The start of the scene under a contact model, with nothing changed: solver "none", its loss as `final_loss`, and no
// losses on the way. kFailed if the rollout fails, kNotApplicable if the model cannot take the scene.
SolvedRun SimulateOnly(const Request& request, const std::string& contact);

// A solution's motion under its own contact model or, if `exact`, under exact dynamics.
Motion MotionOf(const Request& request, const SolveReport& report, bool exact, const MotionOptions& options = {});

// The ends of the control intervals of a solution, from 0 on, s: the nodes of its own model's motion.
std::vector<double> NodesOf(const Scene& scene, const SolveReport& report);

}  // namespace saltus
