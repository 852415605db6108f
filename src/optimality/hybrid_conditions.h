// The conditions of saltus/optimality/hybrid_certificate.h of a motion that stays on one side of its kinks.
#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// A guard that touches zero within a phase or at the end, and must not fall below it there: a constraint, whose
// multiplier is among those of the events.
struct GuardTouch {
  int mode = 0, guard = 0;
  double time = 0;  // s
};

// The multiplier of a residual of a constraint: an equality, or an inequality that is active.
struct TermMultiplier {
  int term = 0;                   // HybridProblem::terms
  int interval = -1, event = -1;  // at whose beginning, or at which, it is evaluated; neither: the end
  int row = 0;                    // of the term
  double value = 0;               // the loss of the optimum decreases by it per unit by which the residual may grow
};

// The derivative of the loss by a parameter, with the multipliers that are found, and the size of the terms that
// cancel.
struct ParameterDerivative {
  double value = 0, size = 1;
};

struct ConditionsOptions {
  std::vector<GuardTouch> touches = {};  // with these there is no curvature
  // Sets the names in the certificate of an event; by default those of its mode and its guard.
  std::function<void(int mode, int guard, ImpactCertificate* impact)> name = {};
  std::vector<TermMultiplier>* multipliers = nullptr;      // unless null, it is set
  std::vector<ParameterDerivative>* parameters = nullptr;  // unless null, it is set
  // Whether there is a curvature where the conditions do not hold, too: with the intervals as they are, and events at
  // their ends held there.
  bool always_curvature = false;
  double least_parameter = 0;  // the size of parameters that are smaller, for second derivatives by them
};

// Returns a function whose rows are those of another one, each times a factor.
std::shared_ptr<const ceres::CostFunction> WithFactors(std::shared_ptr<const ceres::CostFunction> function,
                                                       Eigen::VectorXd factors);

// Certifies as Certify() does, without a look at kinks. Precondition: Validate(input, problem.system) is empty,
// and the motion begins at time 0.
Certificate CertifyConditions(const HybridProblem& problem, const HybridInput& input, const ConditionsOptions& options);

// Returns the input after a step of Newton's method for the conditions, which keeps active bounds: with intervals that
// move with the events, or on the given intervals, where events at their ends stay there. Returns std::nullopt if there
// is no motion, or if the second derivative is singular. Preconditions: those of CertifyConditions.
std::optional<HybridInput> AfterNewtonStep(const HybridProblem& problem, const HybridInput& input, bool moving);

// The sizes of what a motion consists of.
struct MotionSizes {
  std::vector<Eigen::VectorXd> state;   // by mode: the largest values, of zero ones those that are asked for
  Eigen::VectorXd control, parameters;  // likewise
  // The component of the control that, held for the whole motion, changes a state by as much as the largest state is,
  // or misses what costs and constraints ask for; and the largest change of each state by one of these, by mode.
  Eigen::VectorXd asked_control;
  std::vector<Eigen::VectorXd> asked_state;
  double asked_loss = 0;  // after such changes
};

// Returns the sizes of the motion of an input; std::nullopt if it has none to which all terms apply.
std::optional<MotionSizes> SizesOf(const HybridProblem& problem, const HybridInput& input);

// Returns the problem with the rows of its constraints divided by their sizes, where these are not of order one: by how
// much a row changes as what it reads changes by its size in the motion of the input. Without a motion, returns the
// problem as it is.
HybridProblem ScaleConstraints(HybridProblem problem, const HybridInput& input);

}  // namespace saltus
