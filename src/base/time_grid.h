// The tolerance by which all models decide whether an event lies on a node of the time grid.
#pragma once

namespace saltus {

// An event closer to a node than this fraction of the step is on the node. The event-driven model leaves events this
// close to the end of a step to the next step.
inline constexpr double kNodeMargin = 1e-9;

// Whether the time `since` the start of a step of length `step` is on the node that it starts with.
inline bool IsOnNode(double since, double step) { return since <= kNodeMargin * step; }

}  // namespace saltus
