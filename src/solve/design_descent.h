// Optimal design parameters around solvers without them: a descent on the least loss over controls.
//
//   minimise over p in bounds   V(p) = min over control of loss(control, p)
//
// A solver evaluates V, starting from the control of the last p; the gradient is the partial derivative of the loss at
// its solution (optimality/design_gradient.h). The descent is a projected BFGS method with backtracking (Nocedal and
// Wright, Numerical Optimization, 2nd edition, sections 3.1, 6.1 and 16.7). As V jumps or has kinks where the sequence
// of impacts changes, trial points at which the solver does not converge, or finds another sequence of greater loss,
// are refused by the line search.
#pragma once

#include <string>

#include "saltus/solve/solver.h"

namespace saltus {

// Returns the reason why the descent does not support a scene; empty if it does. A control has to be optimized.
std::string WhyNotDescent(const Scene& scene);

// The request without design parameters.
SolveRequest WithGivenDesign(SolveRequest request);

// Losses are those at the accepted points; iterations and evaluations are those of the solver, in all. Preconditions:
// WhyNotDescent() is empty, the scene is in natural units, and the solver can take the request with a given design.
SolveReport DescendDesign(const SolverEntry& solver, const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
