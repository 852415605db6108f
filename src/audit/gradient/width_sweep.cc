#include "saltus/audit/width_sweep.h"

#include <glog/logging.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include "audit/gradient/step_study.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

constexpr double kMostSteps = 20000;  // of the refined simulation

// Returns half the smallest gap of a disc at the initial time, m.
double HalfSmallestGap(const Scene& scene, int body) {
  const Body& a = scene.bodies[body];
  double gap = std::numeric_limits<double>::infinity();
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& b = scene.bodies[i];
    if (i != body) gap = std::min(gap, (a.position - b.position).norm() - a.radius - b.radius);
  }
  for (const WallPart& part : WallPartsOf(scene)) {
    if (part.extent.Covers(a.position)) gap = std::min(gap, part.LeastDistance(a.position) - a.radius);
  }
  return gap / 2;
}

// Returns the derivatives of a gradient by each of VariablesOf().
std::vector<double> DerivativesBy(const Scene& scene, const ModelGradient& gradient) {
  std::vector<double> derivatives;
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl}) {
    const std::vector<double> entries = EntriesOf(scene, gradient, quantity, 1);
    derivatives.insert(derivatives.end(), entries.begin(), entries.end());
  }
  return derivatives;
}

void Convert(const Units& from, const Units& to, WidthSweep* sweep) {
  const double by = GradientFactor(sweep->quantity, from, to);
  for (double* slope : {&sweep->gradient, &sweep->narrow, &sweep->wide, &sweep->narrow_spread, &sweep->wide_spread}) {
    *slope *= by;
  }
  sweep->slopes = Multiplied(std::move(sweep->slopes), by);
  const double width = UnitFactors(from, to).loss / by;
  sweep->grid_width *= width;
  sweep->widths = Multiplied(std::move(sweep->widths), width);
}

}  // namespace

void CompareWithExact(const Scene& scene, const ModelGradient& exact, WidthSweepStudy* study) {
  const std::vector<double> derivatives = DerivativesBy(scene, exact);
  for (std::size_t i = 0; i < study->sweeps.size(); ++i) study->sweeps[i].exact = derivatives[i];
  JudgeByExact(study);
}

WidthSweepStudy SweepWidths(const Contact& contact, const Scene& scene, const WidthSweepOptions& options,
                            const StopRequest& stop) {
  WidthSweepStudy refused;
  refused.reason = ReasonNotApplicable(contact, scene);
  if (!refused.ok()) return refused;
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    WidthSweepStudy study = SweepWidths(contact, natural, options, stop);
    for (WidthSweep& sweep : study.sweeps) Convert(natural.units, scene.units, &sweep);
    return study;
  }
  WidthSweepStudy study;
  Scene refined = scene;
  // The number of steps is no exact multiple, so that an impact on a grid node is not on a node of the refined grid.
  refined.steps = scene.steps * std::clamp<int>(kMostSteps / scene.steps, 1, options.refine) +
                  CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const ModelGradient own = ComputeGradient(contact, refined, Precision::kDouble, stop);
  if (!own.ok()) {
    study.reason = own.reason;
    return study;
  }
  const auto by_state = ShootingBy(Quantity::kPosition, contact, refined, stop);
  std::unique_ptr<SingleShooting> by_control;
  if (scene.control_width() > 0) by_control = ShootingBy(Quantity::kControl, contact, refined, stop);
  double loss = 0, speed = 0;
  if (by_state->Evaluate(by_state->initial_guess(), &loss, nullptr)) {
    speed = LargestSpeed(by_state->simulator(), options.most_states);
  }
  const double length = std::max(speed, 1e-9) * by_state->simulator().step();
  std::vector<SweptVariable> variables = VariablesOf(scene, length, by_state->simulator().num_steps());
  const std::vector<double> derivatives = DerivativesBy(scene, own);
  for (std::size_t i = 0; i < variables.size(); ++i) {
    variables[i].gradient = derivatives[i];
    variables[i].function = variables[i].quantity == Quantity::kControl ? by_control.get() : by_state.get();
  }
  int next = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = 0; j < 2 && !scene.bodies[i].fixed; ++j) variables[next++].most = HalfSmallestGap(scene, i);
  }
  Sweep(variables, own.loss, options, &study);
  return study;
}

}  // namespace saltus
