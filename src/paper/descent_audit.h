// Gradient descent under each contact model: the angle of its gradient to the exact one, and the exact loss along the
// descent. Shows how optimisation can succeed with wrong gradients, and where it fails.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"

namespace saltus {

// Returns the iterations that are examined: 0, 1, 2, 3, 5, 8, ... to the last, about equally many in every power of
// ten.
std::vector<int> ExaminedIterations();

// Returns the iterates at ExaminedIterations() of a descent that was run elsewhere with the same rate, so that it is
// not run again; others if there is none.
using KnownIterates = std::function<std::vector<std::vector<double>>(size_t task, const std::string& contact)>;

// Follows the descents. Contact models that cannot simulate a scene are left out there; so are those of `slow`. Returns
// std::nullopt if interrupted.
std::optional<Section> AuditDescents(const std::vector<TitledScene>& tasks, const std::vector<std::string>& contacts,
                                     const std::vector<std::string>& slow, const KnownIterates& known, int threads,
                                     ProgressMode mode);

}  // namespace saltus
