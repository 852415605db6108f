// Audits of gradients: the gradient of a loss under each contact model is compared with the exact one.
//
// The exact gradient is that of the event-driven model or, if that model does not support the scene, a closed form. If
// there is none either, each gradient is compared with differences of the model's own loss.
//
// A model of your own is audited by UserContact() (simulate/user_contact.h) or, with -DSALTUS_EXTRA_MODELS, by its
// name.
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

// The difference of a gradient from the exact one, over initial state and control. So that all entries have one unit,
// those by velocities are divided by the duration, those by forces by its square over the mass, those by angles and
// angular velocities by the length and by the length times the duration (ModelGradient::SetScales).
// Controls on different grids are compared as forces held over the coarser intervals. Entries whose exact derivative
// exists from one side only, or from none, are left out.
struct GradientError {
  double relative = 0;  // |g - g_exact| / |g_exact|
  double angle = 0;     // between the two, rad
  // Error of a smoothed gradient: root mean square over entries, each divided by its standard error (those of a control
  // in segments by segment). Chance alone gives 1. Infinite if an entry on which all samples agree differs by more than
  // rounding.
  std::optional<double> in_standard_errors;
};
// Compares two gradients. Precondition: both are ok() and of one scene; one control grid is a refinement of the other.
GradientError CompareGradients(const ModelGradient& gradient, const ModelGradient& exact);

// Returns the gradient with respect to forces held over `intervals` equal parts of the horizon: the sum over the steps
// of each part. `control` has `steps` rows of the control's width; steps is a multiple of `intervals`.
std::vector<double> CoarsenControl(const std::vector<double>& control, int steps, int intervals);

// Whether a gradient is the derivative of the model's own loss.
enum class Agreement {
  kAgrees,    // it agrees with differences on at least one side, in every direction
  kDiffers,   // in some direction the differences of both sides converge to another slope
  kUndecided  // the differences do not converge
};

struct GradientCheck {
  Agreement agreement = Agreement::kUndecided;
  // The quantity of the direction that differs most; if none differs, that of the last direction.
  Quantity quantity = Quantity::kPosition;
  double gradient = 0, difference = 0;  // the derivative along this direction, by the gradient and by differences
};

// A derivative by a parameter of the scene, and the difference of the model's own loss.
struct ParameterAudit {
  std::string name;  // scene_parameter.h
  double gradient = 0;
  std::optional<double> difference;     // absent if differences of decreasing width do not converge
  Verdict verdict = Verdict::kUnknown;  // kRight, kWrong, kWrongSign; kUnknown without differences
};

struct AuditOptions {
  RefinementOptions refinement = {};
  bool attribution = true;         // whether errors of wrong gradients are attributed to contacts
  double attribution_seconds = 0;  // AttributionOptions::seconds
  bool width_sweep = false;        // whether widths are swept even if there is an exact gradient
  WidthSweepOptions widths = {};
  // A surrogate that is audited in place of the model's own gradient, by its error alone: verdict kBiased, no studies.
  std::optional<Surrogate> surrogate = std::nullopt;
  int threads = 1;  // of all parts of the audit, in place of refinement.threads
  // RefinementOptions::threads_now, which is called before each study too.
  std::function<int()> threads_now = nullptr;
  // Stops the audit: results so far are kept, and the audit is `interrupted`.
  StopRequest stop = nullptr;
  std::function<void(const std::string&)> status = nullptr;  // AttributionOptions::status
};

// Properties of a black box (black_box.h), measured from its final states.
struct BlackBoxFindings {
  enum class Motion { kUnknown, kExact, kConverges, kDoesNotConverge };
  // A head-on impact of the scene's first pair, without forces and friction: medians over where in a step it falls.
  struct HeadOn {
    int steps = 0;
    double e = 0;                  // speed of separation over closing speed
    double retention = 0;          // fraction of a displacement before the impact that is left just after it
    double velocity_feedback = 0;  // step * d(speed of separation) / d(that displacement)
  };

  std::string reported_name;  // the name that the black box reports (BlackBoxTraits::name)
  bool refused = false;       // it reports that it does not support the scene
  int precision_found = 0;    // bits of its arithmetic
  double noise = 0;           // relative noise of its answers
  bool own_gradient = false;
  Motion motion = Motion::kUnknown;      // whether its loss converges to the exact one
  std::vector<RefinementLevel> levels;   // of the error of its loss, over ModelGradient::loss_scale
  std::optional<HeadOn> head_on, finer;  // at the scene's own step, and at a finer one
  std::vector<std::string> remarks;      // sentences, the most important first
};
const char* MotionToString(BlackBoxFindings::Motion motion);  // "converges", "does not converge", "exact", "unknown"

struct ModelAudit {
  ModelGradient gradient;              // at the scene's own steps
  std::optional<GradientError> error;  // if there is a gradient and a reference
  // The verdict of the refinement or, without a reference, of the width sweep. It is kBiased for a surrogate,
  // kNotApplicable if the reference has another motion than the model (ReasonNotComparable), and kAmbiguous if the
  // exact gradient is ambiguous: then there is no error, and no study but the width sweep.
  Verdict verdict = Verdict::kUnknown;
  std::optional<RefinementStudy> refinement;      // if there are a gradient and a reference
  std::optional<Attribution> attribution;         // of a gradient that the refinement finds wrong, if asked for
  std::optional<WidthSweepStudy> widths;          // if asked for, or if there is no reference
  std::optional<ContactRecognition> recognition;  // if there is a gradient
  std::optional<GradientCheck> gradient_check;    // if there is a gradient that is not biased
  std::vector<ParameterAudit> parameters;         // of a gradient that is not biased; those that the loss depends on
  std::string not_comparable;                     // why the verdict is kNotApplicable
  bool interrupted = false;                       // the audit was stopped; the verdict may be missing
  std::vector<Tie> ambiguous;                     // ties of the reference
  std::optional<LossSpread> spread;               // of the reference, over the orders of its ties
  std::optional<BlackBoxFindings> black_box;      // if the model is a black box

  // Returns the contact Attribution::first_wrong, or null.
  const ContactError* FirstWrong() const;
  // Returns whether the derivative that a black box reports disagrees with differences of its own loss.
  bool ContradictsItself() const;
  // Returns the reason of the verdict in one sentence; empty for a right or a consistent gradient.
  std::string VerdictReason() const;
};

struct AuditReport {
  std::optional<ModelGradient> reference;  // contact is "event", or "closed form"
  std::vector<ModelAudit> models;
};

// Audits one model. `reference` is ComputeExactGradient(scene), also where that is nothing. If the model does not
// support the scene, if there is no such model or if the scene is wrong, the audit has only the gradient, whose reason
// states this.
ModelAudit AuditModel(const Contact& contact, const Scene& scene, Precision precision,
                      const std::optional<ModelGradient>& reference, const AuditOptions& options = {});

// Returns why the exact gradient of `scene` and that of the model cannot be compared although the model supports the
// scene: friction rotates the model's discs, and the exact ones do not spin. Empty if they can be compared.
std::string ReasonNotComparable(const Contact& contact, const Scene& scene);

// Returns the exact gradient of a scene: that of the event-driven model or, if that does not support the scene, of a
// closed form. Returns std::nullopt if there is none or if it was stopped.
std::optional<ModelGradient> ComputeExactGradient(const Scene& scene, const StopRequest& stop = nullptr);

}  // namespace saltus
