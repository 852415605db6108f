// Gradients of every contact model against the exact one.
#pragma once

#include <vector>

#include "audit/audit_text.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "programs/simulators.h"
#include "saltus/audit/attribution.h"
#include "saltus/audit/audit.h"

namespace saltus {

// Interruption (SIGINT, under an InterruptGuard) leaves out the models that were not begun; those that were at work are
// `interrupted`. Throws InputError if there is no exact gradient but there should be.
AuditReport RunAudit(const Request& request, bool needs_reference = false,
                     const std::vector<SimulatorCommand>& simulators = {});
Json AuditToJson(const Request& request, const AuditReport& report);
// Prints gradients and verdicts as tables on stdout, in colour on a terminal.
void PrintAuditTable(const Request& request, const AuditReport& report);
// Whether the model cannot take the scene, or has no such surrogate; else a gradient that is not ok has failed.
bool IsNotApplicable(const ModelGradient& gradient, const Scene& scene);
bool IsNotApplicable(const ModelAudit& audit, const Scene& scene);
// Returns "wrong input" if the only model asked for cannot simulate the scene; "failed" if a rollout was not finite, or
// if models are missing.
int AuditExitCode(const Request& request, const AuditReport& report, std::size_t simulators = 0);

// Writes <scene>_{gradients,refinement,contacts,classes}.csv and <scene>_verdicts.md, and with a width sweep
// <scene>_widths.csv; of a surrogate <scene>_<surrogate>_biased_{gradients.csv,verdicts.md}. Throws OutputError if it
// cannot. Writes nothing without --output_dir.
void WriteAuditFiles(const Request& request, const AuditReport& report);

// Adds verdicts, gradients, errors against step and width, the motions under each model, and for each wrong model the
// first contact that makes it wrong.
void AddAuditSections(const Request& request, const AuditReport& audit, Page* page);

}  // namespace saltus
