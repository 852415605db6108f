// An audit of every contact model on the three tasks of the paper: the error of its gradient, its class, and the cost
// of a step.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"
#include "programs/simulators.h"

namespace saltus {

// Audits the models. Precondition: `contacts` has `direct`, whose step is the unit of cost. Simulators are audited
// beside them; the costs of their steps are not measured. The findings are the classes: what each means, and which
// models belong to it. Returns std::nullopt if interrupted.
std::optional<Section> AuditFormulations(const std::vector<TitledScene>& tasks, std::vector<std::string> contacts,
                                         const std::vector<SimulatorCommand>& simulators, int threads,
                                         ProgressMode mode);

}  // namespace saltus
