// One solve along a plan by the transcription with a cost for every step (phase_transcription.h).
#pragma once

#include "sequence_mending.h"

namespace saltus {

PlanAttempt TryByTranscription(PhaseRun* run, const PhasePlan& plan, const PlanStart& start, const MayGoOn& may_go_on);

}  // namespace saltus
