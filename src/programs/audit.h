// Gradients of every contact model against the exact one.
#pragma once

#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/audit/audit.h"

namespace saltus {

AuditReport RunAudit(const Request& request);
Json AuditToJson(const Request& request, const AuditReport& report);
// Gradients and verdicts as tables on stdout, in colour on a terminal.
void PrintAuditTable(const Request& request, const AuditReport& report);
// Whether the model cannot take the scene, or has no such surrogate; else a gradient that is not ok has failed.
bool IsNotApplicable(const ModelGradient& gradient, const Scene& scene);
// Wrong input if the only model asked for cannot take the scene; failed if a rollout was not finite.
int AuditExitCode(const Request& request, const AuditReport& report);

// `saltus_audit`.
int AuditMain(int argc, char** argv);

}  // namespace saltus
