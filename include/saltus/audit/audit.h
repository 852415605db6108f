// The gradient of a loss as every contact model sees it, beside the exact one.
//
// The exact gradient is that of the event-driven model; where that one cannot take the scene, a closed form; where
// there is none either, the models stand alone, and differences of their own losses are all that can be said.
//
// To audit a model of your own: write it as one header (contact/contact_model.h says what a model has), and configure
//   cmake -DSALTUS_EXTRA_MODELS="/path/to/my_model.h MyModel" ...
// It then is a value of --contact in every program, AllContactModels() lists it, and AuditModel takes it by name; no
// further code is needed. tests/audit/mirror_model.h is an example.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/attribution.h"
#include "saltus/audit/contact_class.h"
#include "saltus/audit/gradients.h"
#include "saltus/audit/refinement.h"
#include "saltus/audit/width_sweep.h"

namespace saltus {

// How far a gradient is from the exact one, over initial positions, initial velocities and the control. So that entries
// can be compared, those by velocities are divided by the duration, those by forces by its square over the mass.
// Controls on different grids are compared as forces held over the coarser intervals. Entries whose exact derivative
// exists from one side only, or from none, are left out.
struct GradientError {
  double relative = 0;  // |g - g_exact| / |g_exact|
  double angle = 0;     // between the two, rad
  // The difference of an estimate: root mean square over entries, each in its standard error (those of a control in
  // segments by segment). Chance alone gives 1. Infinite if an entry on which all samples agree differs by more than
  // rounding.
  std::optional<double> in_standard_errors;
};
// Precondition: both are ok and of the same scene; the control grid of one is a refinement of the other's.
GradientError CompareGradients(const ModelGradient& gradient, const ModelGradient& exact);

// The gradient with respect to forces held over `intervals` equal parts of the horizon: the sum over the steps of each.
// `control` is K x C x 2 with K = steps, a multiple of `intervals`.
std::vector<double> CoarsenControl(const std::vector<double>& control, int steps, int intervals);

// Whether a gradient is the derivative of the model's own loss.
enum class Agreement {
  kAgrees,    // with differences on at least one side, in every direction
  kDiffers,   // in some direction the differences of both sides settle on another slope
  kUndecided  // they do not settle
};

struct OwnDifferences {
  Agreement agreement = Agreement::kUndecided;
  // The quantity of the direction that differs most, or else of the last one.
  Quantity quantity = Quantity::kPosition;
  double gradient = 0, difference = 0;
};

// A gradient by a parameter of the scene beside the differences of the model's own loss.
struct ParameterAudit {
  std::string name;  // scene_parameter.h
  double gradient = 0;
  std::optional<double> difference;     // if they settle
  Verdict verdict = Verdict::kUnknown;  // kRight, kWrong, kWrongSign; kUnknown without differences
};

struct AuditOptions {
  RefinementOptions refinement = {};
  bool attribution = true;         // of wrong gradients to contacts
  double attribution_seconds = 0;  // its limit of time; 0: none
  bool width_sweep = false;        // also where there is an exact gradient
  WidthSweepOptions widths = {};
  // Audited in the place of the model's own gradient, by its error alone: verdict kBiased, no studies.
  std::optional<Surrogate> surrogate = std::nullopt;
  int threads = 1;  // for its samples, what else is studied, and in the place of refinement.threads
  // The function of RefinementOptions, which is called before each study too.
  std::function<int()> threads_now = nullptr;
  // To stop in the middle: what was found so far stays, and the audit is `interrupted`.
  StopRequest stop = nullptr;
  std::function<void(const std::string&)> status = nullptr;  // as of AttributionOptions
};

// Properties of a simulator that is asked from outside (black_box.h), from its final states.
struct BlackBoxFindings {
  enum class Motion { kUnknown, kExact, kConverges, kDoesNotConverge };
  // A head-on impact of the scene's first pair, without forces and friction: medians over where in a step it falls.
  struct HeadOn {
    int steps = 0;
    double e = 0;     // speed of separation over closing speed
    double keep = 0;  // of a displacement before the impact, what is left just after it
    double feed = 0;  // change of the speed of separation, times the step, by that displacement
  };

  std::string says;         // what it calls itself
  bool refused = false;     // it cannot take the scene, and says so
  int precision_found = 0;  // bits
  double noise = 0;         // relative, of its answers
  bool own_gradient = false;
  Motion motion = Motion::kUnknown;     // whether its loss converges to the exact one
  std::vector<RefinementLevel> levels;  // of the error of its loss, relative to the scene's
  std::optional<HeadOn> head_on, finer;
  std::vector<std::string> remarks;  // in sentences, the loudest first
};
const char* MotionToString(BlackBoxFindings::Motion motion);  // "converges", "does not converge", "exact", "unknown"

struct ModelAudit {
  ModelGradient gradient;              // at the scene's own steps
  std::optional<GradientError> error;  // if there is a gradient and a reference
  // The verdict of the refinement; without a reference that of the width sweep; kBiased of a surrogate; kNotApplicable
  // where the reference is of another world than the model. kAmbiguous if the exact gradient is; then there are no
  // error and no studies but the width sweep.
  Verdict verdict = Verdict::kUnknown;
  std::optional<RefinementStudy> refinement;      // if there are a gradient and a reference
  std::optional<Attribution> attribution;         // if the refinement calls it wrong, unless not asked for
  std::optional<WidthSweepStudy> widths;          // if asked for, or if there is no reference
  std::optional<ContactRecognition> recognition;  // if there is a gradient
  std::optional<OwnDifferences> own;              // likewise, unless it is biased
  std::vector<ParameterAudit> parameters;         // likewise; those that the loss depends on
  std::string not_comparable;                     // why verdict is kNotApplicable
  bool interrupted = false;                       // before all that was asked for was found; the verdict may be missing
  std::vector<Tie> ambiguous;                     // those of the reference
  std::optional<LossSpread> spread;               // likewise
  std::optional<BlackBoxFindings> black_box;      // of a black box

  // The contact that the error begins with, or null.
  const ContactError* FirstWrong() const;
  // Whether the derivative that a black box gives is not that of its own motion: then its contact is not the first
  // fault.
  bool ContradictsItself() const;
  // Why the verdict is what it is, in one sentence; empty for a right or a consistent gradient.
  std::string Why() const;
};

struct AuditReport {
  std::optional<ModelGradient> reference;  // contact is "event", or "closed form"
  std::vector<ModelAudit> models;
};

// Audits one model. `reference` is ExactGradientOf(scene). Where the model cannot take the scene, there is no such
// model or the scene is wrong, the gradient says why and there is nothing else.
ModelAudit AuditModel(const Contact& contact, const Scene& scene, Precision precision,
                      const std::optional<ModelGradient>& reference, const AuditOptions& options = {});

// Why the exact gradient of `scene` is not what the model's should be, though the model can take the scene: the exact
// discs do not spin, and friction turns the model's. Empty if the two can be compared.
std::string WhyNotComparable(const Contact& contact, const Scene& scene);

// The exact gradient of a scene, or nothing; nothing too if it was stopped.
std::optional<ModelGradient> ExactGradientOf(const Scene& scene, const StopRequest& stop = nullptr);

}  // namespace saltus
