// Whether a motion of a hybrid system is optimal for a problem: the conditions of the hybrid minimum principle, as
// certificate.h has them for discs.
//
// The control is constant on intervals, and events cut the time into phases. With l the cost and f the flow,
// H = l + lambda f, for each step of the integration in the place of the differential equation:
//
//   costate         lambda is carried backwards through the steps: lambda_k = lambda_{k+1} F_x + the derivatives of
//                   the terms; at the end it is the derivative of the terms there
//   costate jump    lambda- = lambda+ D_x R + nu D_x g at each event; with the nu that keeps the loss stationary as
//                   the event moves this is the transpose of the saltation matrix
//   Hamiltonian     moving the time of an event, and the intervals of the phases on both sides with it, does not change
//                   the loss. If neither guards nor flows depend on time, the mean of H over each phase is the same;
//                   otherwise it jumps by nu D_t g + lambda+ D_t R
//   stationarity    the derivative of the loss by each control, divided by the length of its interval, is zero, or has
//                   the sign that its bound allows
//   transversality  so is that by the initial state and the parameters that are free, and by the final time
//
// Multipliers of events, of equalities and of active inequalities are those that meet the conditions best. On a grid
// that does not move, events at the ends of intervals where the control jumps are kinks, as certificate.h says.
// Residuals are relative to the size of the terms that cancel; those of a component of the control to a hundredth of
// the largest size of a component if that is larger, as the terms of one that is to be zero do not cancel.
//
// Curvature is the second derivative of the Lagrangian along directions that keep constraints and bounds that are
// active, with the times of events as functions of the variables; intervals move with the events, or on a grid that
// does not, events at the ends of intervals stay there. It is a part of the second derivative of the costs by the
// control alone (as effort), and for variables without such costs, of the size of the terms that cancel. It is left out
// with more than 400 free variables. Curvature::direction has the control (K x m), and then those components of the
// initial state, parameters and the duration that are free.
#pragma once

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// Certifies the motion of an input. In ImpactCertificate a is the name of the mode, b that of the guard, and speed the
// rate at which the guard falls. kNotApplicable if the input has no motion, or one with transitions at once or grazing
// guards; kAmbiguous has no counterpart in Certificate::ambiguous: the reason names the guards.
Certificate Certify(const HybridProblem& problem, const HybridInput& input);

}  // namespace saltus
