// Refinement studies: the error of a model's gradient at decreasing time steps, from which every verdict follows.
//
// One number does not distinguish a gradient that is inexact because steps are finite from one that is wrong at every
// step size. The gradient is therefore computed at several levels of refinement, each with twice the steps of the level
// before. Its error also depends on where in a step an impact happens; a level therefore has several neighbouring step
// counts, and its error is their median. The order is the slope of log(error) against log(step) over the finer levels.
//
//   right        within 1e-6 at every step count
//   consistent   the error falls with the step throughout, with an order of at least a half
//   wrong        the error does not fall with the step in this way
//   wrong sign   wrong, and an entry that is not negligible has the wrong sign
//   unknown      the error falls, but is still above one percent at the finest steps that the budget allows
//   biased       the gradient is a surrogate; there is no study of it
//   ill-conditioned   the error does not exceed the effect of rounding on the exact gradient, or rounding leaves no
//                     digit of the exact gradient (Conditioning)
//   not applicable    the exact gradient is that of another motion; there is no study of it
//   ambiguous    there is no gradient: the order of simultaneous impacts changes the motion (simulate/events.h, Tie)
//   one-sided    every derivative by the initial state exists from one side only, or from none, and none is judged
//
// Only the time step is refined; stiffness and damping are those of the scene. A compliant model with the verdict
// `wrong` may converge to the gradient of its own soft contact, which at that stiffness is not that of a rigid contact.
//
// Entries whose exact derivative is one-sided or does not exist are reported and not judged, because the motion of a
// model need not have the kink of the exact one.
//
// Gradients by the control are compared as those by forces held over `intervals` equal parts of the horizon, so that
// all step counts have the same reference. The study computes in double precision.
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
const char* VerdictToString(Verdict verdict);  // the names in the table above
// Returns whether a verdict is kWrong or kWrongSign.
bool IsWrong(Verdict verdict);

// A part of the gradient whose entries have one unit, judged on its own.
// kGeometry and kWallAngle have the parameters of Scene::design that are a length, or an angle. The last three are
// those of a hybrid system, of which each entry has a unit of its own.
enum class Quantity {
  kPosition,
  kVelocity,
  kControl,
  kRestitution,
  kFriction,
  kMass,
  kGravity,
  kGeometry,
  kWallAngle,
  kSystemState,
  kSystemControl,
  kSystemParameter
};
// Returns the name that outputs use, such as "position".
const char* QuantityToString(Quantity quantity);
inline bool IsHybridQuantity(Quantity quantity) { return quantity >= Quantity::kSystemState; }

// Return the names of the entries of a quantity, and the entries themselves: two for each disc that moves (position,
// velocity), two for each interval and controlled disc and then one for each torque control, one for each disc that
// moves (mass), x and y (gravity), one for each design parameter of that kind, or one for restitution and friction
// (with materials: one for each of PairsInUse(), of friction only if it is above zero). Precondition: the gradient's
// number of steps is a multiple of `intervals`, and the quantity is one of a scene.
std::vector<std::string> EntryNames(const Scene& scene, Quantity quantity, int intervals);
std::vector<double> EntriesOf(const Scene& scene, const ModelGradient& gradient, Quantity quantity, int intervals);
// Returns the factor by which a derivative of the loss by that quantity in the units `from` is multiplied to have it in
// the units `to`.
double GradientFactor(Quantity quantity, const Units& from, const Units& to);

struct RefinementOptions {
  int levels = 7;               // number of levels, each with twice the steps; at least 4 are run
  int most_levels = 11;         // run while the error is large and still falls
  int samples = 9;              // step counts per level
  double tolerance = 1e-6;      // relative error of a right gradient
  double smallest_order = 0.5;  // of a consistent one
  double rounding = 1e-9;       // errors below this need not fall
  int most_intervals = 8;       // parts of the horizon over which the control is compared
  bool parameters = true;       // whether derivatives by parameters of the scene are studied too
  // Largest work of one level: steps times discs or, if that is more, 24 times the number of contacts of all steps.
  // Levels finer than the fourth are left out if their work exceeds it.
  double budget = 1.5e6;
  double seconds = 0;  // limit of time for the levels beyond the fourth; 0: none
  // Number of threads that run the step counts of a level; results do not depend on it. More than one needs a contact
  // model whose simulators may run at the same time, as those of all models of the registry may.
  int threads = 1;
  // If set, called before each level; the number that it returns replaces `threads` from then on.
  std::function<int()> threads_now = nullptr;
};

struct RefinementLevel {
  double steps = 0;                  // geometric mean of the step counts
  double error = 0;                  // median over the step counts, relative to the exact norm
  double smallest = 0, largest = 0;  // errors over the step counts
};

struct QuantityStudy {
  Quantity quantity = Quantity::kPosition;
  Verdict verdict = Verdict::kUnknown;
  double order = 0;                      // observed over the finer levels; 0 if errors are rounding
  std::vector<RefinementLevel> levels;   // from coarse to fine
  std::vector<std::string> entries;      // their names
  std::vector<double> exact;             // one for each entry
  std::vector<double> finest;            // medians over the finest level: what the model converges to
  std::vector<std::string> one_sided;    // entries that are not judged
  std::vector<std::string> wrong_signs;  // entries that are wrong in sign, at the scene's own steps or at the finest

  // The error that decides the verdict if errors do not fall: the median at the finest level or, if that would be
  // right, the largest error of all levels.
  double decisive = 0;

  bool IsJudged() const { return one_sided.size() < exact.size(); }
};

// The effect of rounding on a gradient.
struct Conditioning {
  // Relative change of the exact gradient per relative change of the initial state in its last bits; the largest of a
  // few.
  double condition = 0;
  // Relative difference of exact gradients that are computed with other numbers of steps, which change the rounding
  // only, and from the changed initial states; the largest of a few. A refinement whose errors may be rounding measures
  // it with its own numbers of steps too.
  double rounding = 0;

  // Returns how many of the 16 decimal digits of double precision the exact gradient loses by rounding.
  double DigitsLost() const;
  // Returns the numbers in one sentence.
  std::string Describe() const;
};
// Measures the conditioning of the gradient of the event-driven model. Returns std::nullopt if that model does not
// support the scene or fails. Each impact amplifies earlier errors: after a few dozen impacts, the last bits of the
// initial state and the rounding of every step may change the leading digits of the derivative.
std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop = nullptr);

struct RefinementStudy {
  std::string reason;  // why there is no study: no exact gradient, an ambiguous one, or a rollout that is not finite
  int intervals = 0;
  std::vector<QuantityStudy> quantities;  // those that the scene has
  // The worse verdict of position and velocity. The control counts only if it is wrong, because every model that
  // integrates forces by Euler steps is at most consistent there. Parameters, and quantities without an entry that is
  // judged, do not count. kOneSided if no entry of position and velocity is judged. All quantities of a hybrid system
  // count.
  Verdict verdict = Verdict::kUnknown;
  std::optional<Conditioning> conditioning;  // of the exact gradient, measured if a quantity is not right

  bool ok() const { return reason.empty(); }
  // Returns the study of a quantity; null if there is none.
  const QuantityStudy* Find(Quantity quantity) const;
};

// Studies a model. If it does not support the scene, `reason` states it. A study that was stopped has no meaning.
RefinementStudy StudyRefinement(const Contact& contact, const Scene& scene, const RefinementOptions& options = {},
                                const StopRequest& stop = nullptr);

}  // namespace saltus
