// The studies of an audit over any problem whose loss and gradient a model computes by N steps: errors at several
// numbers of steps, and differences of every width. Scenes of discs (refinement.cc, width_sweep.cc) and hybrid systems
// (hybrid_audit.cc) are such problems.
#pragma once

#include <functional>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "saltus/audit/audit.h"
#include "saltus/control/shooting_function.h"

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
OwnDifferences CompareAlong(const LossAtGuess& loss, const std::vector<double>& direction, double widest);

// Compares the gradient with differences of its own loss, along sums of all variables of a quantity with signs that are
// fixed but arbitrary, each in its grid width. `loss` returns that of a thread, of which one direction is computed at a
// time; without a gradient a direction is left out.
OwnDifferences CompareAlongSums(const std::vector<SweptVariable>& variables, int threads,
                                const std::function<const LossAtGuess&(int thread, Quantity quantity)>& loss);

// Marks the sweeps whose wide differences are farther from their exact derivatives than the gradient is: these are not
// counted against it.
void JudgeByExact(WidthSweepStudy* study);

// Returns the Euclidean norm of the difference. Precondition: the sizes are equal.
double Distance(const std::vector<double>& a, const std::vector<double>& b);

}  // namespace saltus
