// How the events of a motion of discs move with its state, and where other events might happen.
//
// Between its impacts the acceleration of a disc is constant in an interval. The time t of an event is where the gap g
// of its pair is zero, dt = -dg / g'. The least gap of a pair that does not touch is where the gap stops falling: at a
// zero of its rate, at an impact that turns one of the discs aside, or at the end of the motion. The gap of a pair that
// touches without a force is looked at when the motion begins, where disturbances act on this contact first, and where
// the pair separates or the motion ends: with disturbances in several intervals it may fall below zero in any of them.
// To first order a least gap changes as the positions there do, as the rate is zero; at an impact, the change of its
// time is added. Between two impacts of the same disc in an interval gaps are not looked at.
#pragma once

#include <span>
#include <vector>

#include "feedback/scene_intervals.h"
#include "saltus/feedback/regulator.h"

namespace saltus {

// Adds the events and the guards of interval k, given its A and B, under `force` on all discs. `columns`: which numbers
// of the forces are those of a row of the control.
void AddEventsAndNearMisses(const SceneIntervals& motion, int k, std::span<const SceneEvent> events,
                            std::span<const double> force, const std::vector<double>& columns,
                            LinearInterval* interval);

// Returns the columns of derivatives by the forces on all discs that belong to a row of the control.
Eigen::MatrixXd Select(const Eigen::MatrixXd& by_force, const std::vector<double>& columns);

}  // namespace saltus
