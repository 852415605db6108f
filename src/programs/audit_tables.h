// The audit as tables: for people and, with all digits, as CSV.
#pragma once

#include "output/table.h"
#include "programs/program.h"
#include "saltus/audit/audit.h"
#include "saltus/audit/given.h"

namespace saltus {

// Right and consistent verdicts are good, wrong ones bad.
Tone ToneOf(Verdict verdict);

// Loss and gradient at the scene's own steps, one row a model (a second one for standard errors), the exact one first.
Table GradientTable(const Request& request, const AuditReport& report);

// Verdicts, and for wrong models the first wrong step and why. Toned.
Table VerdictTable(const AuditReport& report);

// Every entry of the gradient beside the exact one, and what it converges to. One row an entry and model.
Table EntryTable(const Scene& scene, const AuditReport& report);

// Every entry of the surrogates beside the exact gradient, one row an entry and model.
Table SurrogateTable(const Scene& scene, const AuditReport& report);

// Error by level of refinement.
Table RefinementTable(const AuditReport& report);

// Every contact of the models that are wrong.
Table ContactTable(const AuditReport& report);

// How every model makes contact, and the numbers that tell.
Table ClassTable(const AuditReport& report);

// What final states tell of black boxes, one row each.
Table BlackBoxTable(const AuditReport& report);

// Plateaus of the width sweep, one row an entry and model.
Table PlateauTable(const AuditReport& report);

// A given gradient, entry by entry.
Table GivenTable(const std::vector<GivenEntry>& entries);

// All slopes of the width sweep.
Table SlopeTable(const AuditReport& report);

}  // namespace saltus
