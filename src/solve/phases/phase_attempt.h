// One solve along a plan by the transcription with a cost for every step (phase_transcription.h).
#pragma once

#include "solve/phases/phase_transcription.h"
#include "solve/phases/sequence_mending.h"

namespace saltus {

// The control that a transcription stands at, within its bounds and as long as the horizon, to the last bit.
void TakeControl(const PhaseTranscription& transcription, const Scene& scene, Trial* trial);

// The exact roll-out of attempt->trial, whose phases have so many steps: fills trial.exact, times and realized. What a
// solve leaves of gaps moves impacts off their nodes, by far less than a step: these follow them.
void RollOut(const Scene& scene, const std::vector<OwnTerm>& terms, const PhasePlan& plan,
             const std::vector<int>& steps, PlanAttempt* attempt);

PlanAttempt TryByTranscription(PhaseRun* run, const PhasePlan& plan, const PlanStart& start, const MayGoOn& may_go_on);

}  // namespace saltus
