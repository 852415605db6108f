// The studies of an audit over any problem whose loss and gradient a model computes by N steps: errors at several
// numbers of steps, and differences of every width. Scenes of discs (refinement.cc, width_sweep.cc) and hybrid systems
// (hybrid_audit.cc) are such problems.
#pragma once

#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/audit.h"
#include "saltus/control/shooting_function.h"
#include "saltus/control/single_shooting.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/one_sided_derivatives.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The gradient of a problem by N steps of a model.
struct SteppedGradient {
  // The entries of each quantity of a study, in their order.
  struct Parts {
    std::string reason = "";  // why there is no gradient; empty if there is one
    std::vector<std::vector<double>> entries = {};
    int contacts = 0;  // of all steps
  };

  // Computes the gradient by so many steps. Several threads call it if RefinementOptions::threads asks for them.
  std::function<Parts(int steps)> at;
  // Computes the exact gradient with another number of steps, which changes its rounding only.
  std::function<Parts(int steps)> exact_at;
  std::function<std::optional<Conditioning>()> condition;
  int unit = 1, coarsest = 1;  // numbers of steps are multiples of `unit`; the first is `coarsest` of these
  // Returns the work of the first, in the unit of RefinementOptions::budget, given its contacts.
  std::function<double(int contacts)> work;
};

// Studies the errors of a gradient at levels of unit (coarsest 2^level + 0, 1, ...) steps. Preconditions: the
// quantities of `study` have their names and exact entries; `loss` is the exact one.
void StudyErrors(const SteppedGradient& gradient, double loss, const RefinementOptions& options,
                 const StopRequest& stop, RefinementStudy* study);

// Measures the conditioning of an exact gradient. `compute` returns the entries by an initial state whose numbers are
// multiplied by change(), with `more` steps than usual; empty if there is no gradient.
using Change = std::function<double()>;
std::optional<Conditioning> MeasureConditioning(
    const std::function<std::vector<double>(const Change& change, int more)>& compute, const StopRequest& stop);

// A variable of a width sweep: one of a function of many variables, or several of these that change together.
struct SweptVariable {
  Quantity quantity = Quantity::kPosition;
  std::string entry;
  int first = 0, count = 1, stride = 0;  // variables first, first + stride, ...
  double grid_width = 0;
  double gradient = 0;                                    // the model's derivative
  std::optional<double> exact = std::nullopt;             // the exact one
  double most = std::numeric_limits<double>::infinity();  // widths above this are left out
  ShootingFunction* function = nullptr;                   // the loss, which is evaluated around its initial guess

  // Returns the sum of the entries of these variables: the derivative by them, of a gradient.
  double SumOf(const std::vector<double>& entries) const;
};

// Adds the sweeps of the variables, and judges them. `loss` is that of the guess. Stops if a function is stopped.
void Sweep(const std::vector<SweptVariable>& variables, double loss, const WidthSweepOptions& options,
           WidthSweepStudy* study);

// A loss at its initial guess, with the gradient; `ok` is false if there is none.
struct LossAtGuess {
  explicit LossAtGuess(ShootingFunction* of);

  ShootingFunction* function;
  double value = 0;
  std::vector<double> gradient;
  bool ok = false;
};

// Compares the gradient along a direction with differences of the loss of decreasing width, to either side. `widest` is
// in the units of the direction.
GradientCheck CompareAlong(const LossAtGuess& loss, const std::vector<double>& direction, double widest);

// Compares the gradient with differences of its own loss, along sums of all variables of a quantity with signs that are
// fixed but arbitrary, each in its grid width. `loss` returns that of a thread, of which one direction is computed at a
// time; without a gradient a direction is left out.
GradientCheck CompareAlongSums(const std::vector<SweptVariable>& variables, int threads,
                               const std::function<const LossAtGuess&(int thread, Quantity quantity)>& loss);

// Marks the sweeps whose wide differences are farther from their exact derivatives than the gradient is: these are not
// counted against it.
void JudgeByExact(WidthSweepStudy* study);

// Returns the Euclidean norm of the difference. Precondition: the sizes are equal.
double Distance(const std::vector<double>& a, const std::vector<double>& b);

// Whether a model's gradient is the derivative of its own loss, at the scene's own steps.
//
// The loss is followed along a few directions, each a sum of all initial positions, velocities or forces with signs
// that are fixed but arbitrary, by differences of decreasing width to either side. A gradient that is no derivative of
// the steps (detached values, a forgotten dependence) agrees with none of them. Where a hundredth and a thousandth of a
// width change the loss as much as the whole, the loss jumps, and no narrower ones are tried. This says nothing of
// whether the steps are right, which is what the width sweep and the exact gradient are for.

// Undecided where the model cannot simulate the scene. A stopped comparison has no meaning. Results do not depend on
// `threads`; more than one needs a model whose simulators may run in parallel. `most_states`: as in LargestSpeed().
GradientCheck CheckGradient(const Contact& contact, const Scene& scene, const StopRequest& stop = nullptr,
                            int threads = 1, int most_states = 0);

// Compares derivatives by parameters: those of `names` that the scene has (scene_parameter.h), each by itself. Left out
// are those that neither gradient nor differences depend on. Empty where the model cannot simulate the scene, or has
// derivatives by parameters in other precisions only.
std::vector<ParameterAudit> CompareParameters(const Contact& contact, const Scene& scene,
                                              const std::vector<std::string>& names, const StopRequest& stop = nullptr);
// Returns the names of the contact parameters, gravity, masses, and optimized ones; none in scenes with many discs.
std::vector<std::string> ParametersToCompare(const Scene& scene);

// Returns the loss of a scene as a function of its initial state or, for kControl, of its control.
std::unique_ptr<SingleShooting> ShootingBy(Quantity quantity, const Contact& contact, const Scene& scene,
                                           const StopRequest& stop);

// Returns the variables of a scene, without derivatives: the initial state of every disc that moves, as
// SingleShooting::Variables::kInitialState has it, and forces that are constant over `steps` rows of the control.
// `length`: the distance that discs move in a step, m.
std::vector<SweptVariable> VariablesOf(const Scene& scene, double length, int steps);

// Returns the largest speed of a disc in the simulator's last rollout, m/s: over all states, or if `most_states` is
// positive and there are more, over about as many at even distances.
double LargestSpeed(const Simulator& simulator, int most_states = 0);

// Derivatives of the exact loss that exist from one side only because events happen at the same time, or because
// two discs pass each other with a gap of zero.
//
// Where a disc meets two others at once, a change of the initial state makes it meet one of them first. If the motion
// is the same in both orders, the loss is continuous there, but its slopes to either side may differ: the gradient of
// the event-driven model is that of one order. Which entries that concerns follows from differences of its own loss:
// an entry that agrees with those of one side alone, while those of the other side settle on another slope, is the
// derivative from that side; one that agrees with neither, while both settle, is none. Likewise where discs pass each
// other without a gap: moved to one side they meet.

// Returns the one-sided derivatives by the initial state that are not among `known`. Empty where no impact coincides
// with another event of one of its discs and no discs pass each other without a gap, and where rollouts are so long
// that differences by every entry would take minutes. The result has no meaning if it was stopped. `contact` is
// event-driven and can simulate the scene, which is in natural units.
std::vector<OneSided> OneSidedBySimultaneousEvents(const Contact& contact, const Scene& scene,
                                                   const std::vector<OneSided>& known,
                                                   const StopRequest& stop = nullptr);

}  // namespace saltus
