// The results of an audit as text and as tables.
#pragma once

#include <optional>
#include <string>

#include "base/table.h"
#include "saltus/audit/audit.h"

namespace saltus {

// Returns the tone of a verdict: right and consistent ones are good, wrong ones bad.
Tone ToneOf(Verdict verdict);

// Returns a gradient with the standard errors of an estimate in the place of its entries.
ModelGradient StandardErrorsOf(ModelGradient gradient);

// Returns loss and gradient at the scene's steps, one row a model (a second for standard errors), the exact one first.
Table GradientTable(const Scene& scene, const AuditReport& report);

// Returns the verdicts, toned, and for wrong models the first wrong step with its cause.
Table VerdictTable(const AuditReport& report);

// Returns the findings from final states of black boxes, one row each.
Table BlackBoxTable(const AuditReport& report);

// Returns the plateaus of the width sweep, one row an entry and model.
Table PlateauTable(const AuditReport& report);

// Returns all these tables with their captions, and the remarks on the models. A surrogate that was audited in the
// place of the gradient is named.
std::string AuditText(const Scene& scene, const AuditReport& report, const std::optional<Surrogate>& surrogate,
                      const TextLayout& layout);

}  // namespace saltus
