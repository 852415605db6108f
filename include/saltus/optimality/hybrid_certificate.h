// Certificates of hybrid problems: the conditions of the hybrid minimum principle, as those of certificate.h for discs.
//
// The control is constant on intervals, and events divide the time into phases. With the cost l and the flow f,
// H = l + lambda f. The conditions are those of the steps of the integration:
//
//   costate         lambda_k = lambda_{k+1} F_x + the derivatives of the terms, backwards through the steps; at the end
//                   it is the derivative of the terms there (lambda is a row, F the map of one step)
//   costate jump    lambda- = lambda+ D_x R + nu D_x g at each event with reset R and guard g; with the nu that keeps
//                   the loss stationary as the event moves this is the transpose of the saltation matrix
//   Hamiltonian     moving the time of an event, and the intervals of the phases on both sides with it, does not change
//                   the loss. If neither guards nor flows depend on time, the mean of H over each phase is the same;
//                   otherwise it jumps by nu D_t g + lambda+ D_t R
//   stationarity    the derivative of the loss by each control, divided by the length of its interval, is zero, or has
//                   the sign that its bound allows
//   transversality  the derivatives by free components of the initial state, free parameters and a free final time are
//                   zero, or have the sign that a bound allows
//
// Multipliers of events, of equalities and of active inequalities are those of the smallest residual. On a fixed grid,
// events at the ends of intervals where the control jumps are kinks, as in certificate.h. Residuals are relative to the
// size of the terms that cancel, and those of a component of the control to at least a hundredth of the largest such
// size, because the terms of a component that is zero do not cancel. A component that is zero all the time, but for
// errors of the solution, has no effect if a control that, held for the whole motion, changes a state by as much as the
// largest state is changes the loss by less than 1e-6 of it.
//
// Where intervals move with the events, a free final time changes those of the last phase, and an event at a given
// time, such as a waypoint, stays at the end of its interval.
//
// Where a guard just touches zero, or has its event at the final time, the loss has a kink, and the verdict
// kStationaryOnGrid is that of one-sided conditions on both of its sides.
//
// The curvature is the second derivative of the Lagrangian along directions that satisfy active constraints and bounds,
// with the times of events as functions of the variables. Intervals move with the events; on a fixed grid, events at
// the ends of intervals stay there. It is relative to the second derivative of the costs by the control alone (as
// effort) and, for variables without such costs, to the size of the terms that cancel. Curvature::direction has the
// control (K x m), and then the free components of the initial state, free parameters, and the duration if it is free.
#pragma once

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// Certifies the motion of an input, under the unknowns HybridProblem::free. In ImpactCertificate `a` is the name of the
// mode, `b` that of the guard, and `speed` the rate at which the guard falls (unit of the guard per time). The verdict
// is kNotApplicable if the input has no motion, one with transitions at once or grazing guards, or more than 1000
// multipliers. With kAmbiguous the reason names the guards, and Certificate::ambiguous is empty.
Certificate Certify(const HybridProblem& problem, const HybridInput& input);

}  // namespace saltus
