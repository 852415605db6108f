#include "saltus/control/exact_run.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "saltus/control/objective.h"
#include "saltus/dynamics/registry.h"
#include "saltus/physics/units.h"

namespace saltus {
namespace {

const ModelTraits* ExactModel() {
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.event_driven) return &traits;
  }
  return nullptr;
}

// Runs `scene` for control intervals of one length, from number `first` on, from `x` (B x 4) on, which becomes the state
// at the end.
bool RunEqualIntervals(std::string_view model, const Scene& scene, const std::vector<double>& control, int first,
                       double start, std::vector<double>* x, ExactRun* run) {
  const std::unique_ptr<Simulator> simulator = MakeSimulator(model, scene, Precision::kDouble);
  CHECK_EQ(simulator->state_size(), static_cast<int>(x->size()));
  if (!simulator->Rollout(*x, control)) {
    run->reason = "the exact rollout fails: " + simulator->WhyFailed();
    return false;
  }
  simulator->GetState(simulator->num_steps(), *x);
  for (const Event& event : EventsOf(*simulator)) {
    run->events.push_back(event);
    run->events.back().time += start;
  }
  for (const StepTouch& at : EventTouches(*simulator)) {
    run->contacts.push_back(at.touch.candidate);
    run->places.push_back({first + at.step, at.touch.time});
    if (at.touch.kind != ContactKind::kImpact) run->only_impacts = false;
  }
  run->loss += EffortLoss(scene.objective, control, simulator->step());
  return true;
}

// What is wrong with the sizes and numbers of the arguments of SimulateExactly; empty if nothing is.
std::string WhyNotShaped(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations) {
  const auto sizes = [](const char* what, size_t found, const std::string& expected) {
    return std::string(what) + ": found " + std::to_string(found) + " numbers, expected " + expected;
  };
  const size_t size = 4 * scene.bodies.size(), width = 2 * scene.control.bodies.size();
  if (initial.size() != size) return sizes("initial state", initial.size(), std::to_string(size));
  if (!durations.empty() && control.size() != width * durations.size()) {
    return sizes("control", control.size(), std::to_string(width * durations.size()));
  }
  if (width == 0 ? !control.empty() : control.empty() || control.size() % width != 0) {
    return sizes("control",
                 control.size(),
                 width == 0 ? "none, as nothing is pushed" : "a positive multiple of " + std::to_string(width));
  }
  const auto finite = [](double value) { return std::isfinite(value); };
  if (!std::all_of(initial.begin(), initial.end(), finite)) return "initial state: expected finite numbers";
  if (!std::all_of(control.begin(), control.end(), finite)) return "control: expected finite numbers";
  if (!std::all_of(
          durations.begin(), durations.end(), [](double value) { return value >= 0 && std::isfinite(value); })) {
    return "durations: expected finite numbers >= 0";
  }
  return "";
}

}  // namespace

ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations) {
  if (!scene.units.natural) {  // once for all parts
    const Scene natural = InNaturalUnits(scene);
    const UnitFactors to(scene.units, natural.units);
    ExactRun run = SimulateExactly(natural,
                                   ConvertStates(initial, scene.units, natural.units),
                                   Multiplied(control, to.force),
                                   Multiplied(durations, to.time));
    if (run.ok) run.loss = ConvertLoss(run.loss, natural.units, scene.units);
    for (Event& event : run.events) event.time /= to.time;
    return run;
  }
  ExactRun run;
  const ModelTraits* exact = ExactModel();
  if (exact == nullptr) {
    run.reason = "no event-driven contact model is registered";
    return run;
  }
  run.reason = WhyNotApplicable(exact->name, scene);
  if (run.reason.empty()) run.reason = WhyNotShaped(scene, initial, control, durations);
  if (!run.reason.empty()) return run;
  Scene part = scene;
  if (!control.empty()) part.steps = static_cast<int>(control.size() / (2 * scene.num_controlled()));
  run.reason = WhyNotApplicable(exact->name, part);
  if (!run.reason.empty()) return run;

  std::vector<double> x = initial;
  if (durations.empty()) {
    if (!RunEqualIntervals(exact->name, part, control, 0, 0, &x, &run)) return run;
  } else {
    double start = 0;
    for (size_t begin = 0, end = 0; begin < durations.size(); begin = end) {
      while (end < durations.size() && durations[end] == durations[begin]) ++end;
      if (durations[begin] == 0) continue;
      part.steps = static_cast<int>(end - begin);
      part.duration = part.steps * durations[begin];
      const size_t width = 2 * scene.num_controlled();
      const std::vector<double> rows(control.begin() + width * begin, control.begin() + width * end);
      if (!RunEqualIntervals(exact->name, part, rows, static_cast<int>(begin), start, &x, &run)) return run;
      start += part.duration;
    }
  }
  run.ok = true;
  run.loss += TerminalLoss(scene.objective, x, 4);
  return run;
}

}  // namespace saltus
