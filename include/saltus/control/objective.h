// The part of the loss that is a function of the final state and the control: terminal terms and the effort.
//
//   loss = sum of terminal terms + effort * sum_k |u_k|^2 dt        (a control is constant in each step of length dt)
//
// States and controls have the shapes of simulate/simulator.h.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>

#include "saltus/scene/scene.h"

namespace saltus {

// Returns in words a part of an objective besides terminal costs and effort: path costs, a free duration, constraints;
// empty if there is none. The functions below compute terminal costs and effort only.
std::string NonTerminalTerms(const Objective& objective);
// Returns in words the constraints of an objective; empty if it has none.
std::string ConstraintsOf(const Objective& objective);
// Returns in words a part of a problem besides terminal costs and effort, with bounds on the control and pairs that
// must not touch; empty if there is none.
std::string NonTerminalFeatures(const Scene& scene);

// Return the sum of the terminal terms that are not hard at state x, and its derivative with respect to x (x.size()
// numbers, overwritten). x is a state of the simulator, with body_size numbers for each disc.
double TerminalLoss(const Objective& objective, std::span<const double> x, int body_size);
void TerminalGradient(const Objective& objective, std::span<const double> x, int body_size, std::span<double> gradient);

// The terminal terms as least squares: loss = |r(x)|^2, without a half. Each term has the two rows sqrt(weight) * (q -
// target), or one row if it is of spin, in the order of the terms. Preconditions: objective.IsSumOfSquares(), and no
// term is hard: a hard term has rows here, which are no part of TerminalLoss().
int NumTerminalResiduals(const Objective& objective);
void TerminalResiduals(const Objective& objective, std::span<const double> x, int body_size,
                       std::span<double> residuals);
// Returns dr/dx, NumTerminalResiduals x state size, which is constant.
Eigen::MatrixXd TerminalJacobian(const Objective& objective, int state_size, int body_size);

// Returns effort * sum |u|^2 dt over all entries u of the control, torque / radius among them. Its gradient is
// EffortWeight() u, which AddEffortGradient adds to `gradient`.
double EffortLoss(const Objective& objective, std::span<const double> control, double dt);
inline double EffortWeight(const Objective& objective, double dt) { return 2 * objective.effort * dt; }
void AddEffortGradient(const Objective& objective, std::span<const double> control, double dt,
                       std::span<double> gradient);

}  // namespace saltus
