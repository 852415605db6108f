#include "saltus/audit/refinement.h"

#include <glog/logging.h>

#include <algorithm>
#include <utility>

#include "audit/gradient/step_study.h"
#include "saltus/audit/audit.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

std::vector<Quantity> QuantitiesOf(const Scene& scene, bool parameters) {
  std::vector<Quantity> quantities = {Quantity::kPosition, Quantity::kVelocity};
  if (scene.num_controlled() > 0) quantities.push_back(Quantity::kControl);
  if (!parameters) return quantities;
  quantities.push_back(Quantity::kRestitution);
  // At zero friction the loss has only a right derivative with respect to friction.
  if (HasFriction(scene)) quantities.push_back(Quantity::kFriction);
  quantities.push_back(Quantity::kMass);
  quantities.push_back(Quantity::kGravity);
  for (const Quantity design : {Quantity::kGeometry, Quantity::kWallAngle}) {
    if (!EntryNames(scene, design, 0).empty()) quantities.push_back(design);
  }
  return quantities;
}

// Returns the names (EntryNames) of the entries of `exact` that are one-sided derivatives or none.
std::vector<std::string> OneSidedNames(const Scene& scene, const ModelGradient& exact, Quantity quantity) {
  std::vector<std::string> names;
  for (const OneSided& entry : exact.one_sided) {
    const bool position = entry.quantity == OneSided::Quantity::kPosition;
    if (quantity != (position ? Quantity::kPosition : Quantity::kVelocity)) continue;
    names.push_back((position ? "p" : "v") + std::string(entry.component == 0 ? "x " : "y ") +
                    scene.bodies[entry.body].name);
  }
  return names;
}

// Returns the number of parts of the horizon over which the control is compared, each of several steps.
int NumIntervals(const Scene& scene, int most) {
  int intervals = 1;
  while (2 * intervals <= most && scene.steps >= 32 * intervals) intervals *= 2;
  return intervals;
}

// The work of a touch, relative to a step of one disc in free flight.
constexpr double kWorkOfATouch = 24;

}  // namespace

std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop) {
  const ModelTraits* exact = ExactModel();
  if (exact == nullptr) return std::nullopt;
  const auto compute = [&](const Change& change, int more) {
    Scene other = scene;
    other.steps += more;
    for (Body& body : other.bodies) {
      for (Vec2d* vector : {&body.position, &body.velocity}) {
        for (int j = 0; j < 2; ++j) (*vector)[j] *= change();
      }
    }
    const ModelGradient gradient = ComputeGradient(exact->name, other, Precision::kDouble, stop);
    return gradient.ok() ? gradient.gradient.initial : std::vector<double>();
  };
  return MeasureConditioning(compute, stop);
}

RefinementStudy StudyRefinement(const Contact& contact, const Scene& scene, const RefinementOptions& options,
                                const StopRequest& stop) {
  RefinementStudy refused;
  refused.reason = ReasonNotApplicable(contact, scene);
  if (!refused.ok()) return refused;
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    RefinementStudy study = StudyRefinement(contact, natural, options, stop);
    for (QuantityStudy& quantity : study.quantities) {
      const double by = GradientFactor(quantity.quantity, natural.units, scene.units);
      quantity.exact = Multiplied(std::move(quantity.exact), by);
      quantity.finest = Multiplied(std::move(quantity.finest), by);
    }
    return study;
  }
  RefinementStudy study;
  study.intervals = NumIntervals(scene, options.most_intervals);
  Scene coarse = scene;
  coarse.steps = study.intervals;
  const std::optional<ModelGradient> exact = ComputeExactGradient(coarse, stop);
  if (!exact) {
    study.reason = "there is no exact gradient";
    return study;
  }
  if (!exact->ambiguous.empty()) {
    study.reason = TiesToString(exact->ambiguous);
    study.verdict = Verdict::kAmbiguous;
    return study;
  }
  for (const Quantity quantity : QuantitiesOf(scene, options.parameters)) {
    QuantityStudy& added = study.quantities.emplace_back();
    added.quantity = quantity;
    added.entries = EntryNames(scene, quantity, study.intervals);
    added.exact = EntriesOf(scene, *exact, quantity, study.intervals);
    added.one_sided = OneSidedNames(scene, *exact, quantity);
  }
  const auto by = [&](const Contact& model, int steps) {
    Scene refined = scene;
    refined.steps = steps;
    const ModelGradient gradient = ComputeGradient(model, refined, Precision::kDouble, stop);
    SteppedGradient::Parts parts{.reason = gradient.reason, .contacts = gradient.num_touches};
    if (!gradient.ok()) return parts;
    for (const QuantityStudy& quantity : study.quantities) {
      parts.entries.push_back(EntriesOf(scene, gradient, quantity.quantity, study.intervals));
    }
    return parts;
  };
  const int unit = study.intervals * CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const SteppedGradient gradient{
      .at = [&](int steps) { return by(contact, steps); },
      .exact_at = [&](int steps) { return by(ExactModel()->name, steps); },
      .condition = [&] { return MeasureConditioning(scene, stop); },
      .unit = unit,
      .coarsest = std::max(1, scene.steps / unit),
      .work =
          [&](int contacts) { return std::max(double(scene.steps) * scene.num_bodies(), kWorkOfATouch * contacts); }};
  StudyErrors(gradient, exact->loss, options, stop, &study);
  return study;
}

}  // namespace saltus
