// How the error of a model's gradient behaves when its time steps are refined: the ground of every verdict.
//
// A single number cannot tell a gradient that is inexact because steps are finite from one that is wrong whatever the
// step. So the gradient is computed at several levels of refinement, each with twice the steps of the one before. Its
// error also depends on where in a step an impact falls; a level therefore stands for several neighbouring step counts,
// and its error is their median. The observed order is the slope of log(error) against log(step) over the finer levels.
//
//   right        within 1e-6 at every step count
//   consistent   the error falls with the step throughout, with an order of at least a half
//   wrong        it does not
//   wrong sign   wrong, and an entry that is not negligible has the wrong sign
//   unknown      the error falls, but is still above one percent at the finest steps that the budget allows
//   biased       a surrogate, which is not meant to be the gradient; there is no study of it
//   ill-conditioned   it would be wrong, but by no more than rounding changes the exact gradient itself, or rounding
//                     leaves no digit of the exact gradient (Conditioning)
//   not applicable    model and exact gradient are of different worlds; there is no study of it
//   ambiguous    there is no gradient: the order of impacts at the same time decides (simulate/events.h, Tie)
//   one-sided    every derivative by the initial state exists from one side only, or from none, and none is judged
//
// Only the time step is refined: stiffness and damping stay as the scene gives them. A compliant model that is called
// wrong thus converges to the gradient of its own soft contact, which at that stiffness is not that of a rigid one.
//
// Entries whose exact derivative exists from one side only, or from none, are reported but not judged: a model need not
// share the kink, and has the derivative of its own motion there.
//
// Gradients by the control are compared as those by forces held over `intervals` equal parts of the horizon, so that
// all step counts have the same reference. The study computes in double whatever the scene is simulated in.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/gradients.h"

namespace saltus {

enum class Verdict {
  kRight,
  kConsistent,
  kWrong,
  kWrongSign,
  kUnknown,
  kBiased,
  kIllConditioned,
  kNotApplicable,
  kAmbiguous,
  kOneSided
};
const char* VerdictToString(Verdict verdict);  // as above
// kWrong or kWrongSign.
bool IsWrong(Verdict verdict);

// A part of the gradient whose entries have one unit, judged on its own.
// kGeometry and kWallAngle are of those of Scene::design that are a length and an angle.
enum class Quantity { kPosition, kVelocity, kControl, kRestitution, kFriction, kMass, kGravity, kGeometry, kWallAngle };
const char* QuantityToString(Quantity quantity);

// Names of the entries of a quantity, and the entries themselves: two for each disc that moves (position, velocity),
// two for each interval and controlled disc, one for each disc that moves (mass), x and y (gravity), one for each
// design parameter of that kind, or one number. Precondition: the gradient's number of steps is a multiple of
// `intervals`.
std::vector<std::string> EntryNames(const Scene& scene, Quantity quantity, int intervals);
std::vector<double> EntriesOf(const Scene& scene, const ModelGradient& gradient, Quantity quantity, int intervals);
// Returns the factor that takes derivatives of the loss by that quantity from the units `from` to those of `to`.
double GradientFactor(Quantity quantity, const Units& from, const Units& to);

struct RefinementOptions {
  int levels = 7;               // at least 4 are run
  int most_levels = 11;         // run as long as the error falls but is large, so that it may yet come to a rest
  int samples = 9;              // step counts per level
  double tolerance = 1e-6;      // relative error of a right gradient
  double smallest_order = 0.5;  // of a consistent one
  double rounding = 1e-9;       // errors below this need not fall
  int most_intervals = 8;       // parts of the horizon over which the control is compared
  bool parameters = true;       // whether derivatives by parameters of the scene are studied too
  // Most work of one level, in steps times discs, or 24 times the contacts of the steps if that is more, where a model
  // lets everything touch always. Levels finer than the fourth are left out above it.
  double budget = 1.5e6;
  // On which the step counts of a level are run; results are the same for any number. More than one needs a contact
  // model whose simulators may run at the same time, as all in the registry.
  int threads = 1;
  // If given, asked before each level for what stands in the place of `threads` from then on.
  std::function<int()> threads_now = nullptr;
};

struct RefinementLevel {
  double steps = 0;  // geometric mean of the step counts
  double error = 0;  // median over the step counts, relative to the exact norm
  double smallest = 0, largest = 0;
};

struct QuantityStudy {
  Quantity quantity = Quantity::kPosition;
  Verdict verdict = Verdict::kUnknown;
  double order = 0;                      // observed over the finer levels; 0 if errors are mere rounding
  std::vector<RefinementLevel> levels;   // from coarse to fine
  std::vector<double> exact;             // entries as of EntryNames
  std::vector<double> finest;            // medians over the finest level: what the model converges to
  std::vector<std::string> one_sided;    // entries that are not judged
  std::vector<std::string> wrong_signs;  // entries that are wrong in sign, at the scene's own steps or at the finest

  // The error on which a verdict of an error that does not fall rests: the median at the finest level, or, where that
  // would be right, the largest of all levels.
  double decisive = 0;

  bool IsJudged() const { return one_sided.size() < exact.size(); }
};

// How much of a gradient rounding leaves.
struct Conditioning {
  // Relative change of the exact gradient by the initial state, per relative change of that state in its last bits; the
  // largest of a few.
  double condition = 0;
  // The relative difference of exact gradients, computed with other numbers of steps, which change nothing but the
  // rounding, and from the other initial states; the largest of a few. A refinement whose errors may be rounding
  // measures it with its own numbers of steps too.
  double rounding = 0;

  // Decimal digits of the exact gradient that rounding takes, of the 16 of double precision.
  double DigitsLost() const;
};
// The gradient of the event-driven model; none where that cannot take the scene or fails. Where discs meet often,
// each impact magnifies what was there before: after a few dozen of them the last bits of the initial state, and the
// rounding of every step since, may decide the leading digits of the derivative. A gradient that differs from the exact
// one by no more than the exact one differs from itself is not wrong: nobody can tell.
std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop = nullptr);

struct RefinementStudy {
  std::string reason;  // why there is none: no exact gradient, an ambiguous one, or a rollout that is not finite
  int intervals = 0;
  std::vector<QuantityStudy> quantities;  // those that the scene has
  // The verdict of position and velocity together, the worse of the two. The control can only make it wrong: every
  // model that integrates forces by an Euler step is merely consistent there, impacts or not. Parameters do not enter,
  // nor does a quantity of which no entry is judged. kOneSided where none of position and velocity is.
  Verdict verdict = Verdict::kUnknown;
  std::optional<Conditioning> conditioning;  // of the exact gradient, measured where a quantity is not right

  bool ok() const { return reason.empty(); }
  const QuantityStudy* Find(Quantity quantity) const;
};

// Where the model cannot take the scene, that is the reason. A study that was stopped is of no use.
RefinementStudy StudyRefinement(const Contact& contact, const Scene& scene, const RefinementOptions& options = {},
                                const StopRequest& stop = nullptr);

}  // namespace saltus
