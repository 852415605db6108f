// The one definition of an event on a node of the time grid.
#pragma once

namespace saltus {

// Of the step: nearer to a node than this is on it. What the event-driven model finds this near to the end of a step
// belongs to the next one.
inline constexpr double kNodeMargin = 1e-9;

// Whether the time `since` the start of a step of length `step` is on the node that it starts with.
inline bool IsOnNode(double since, double step) { return since <= kNodeMargin * step; }

}  // namespace saltus
