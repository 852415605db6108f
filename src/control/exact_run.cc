#include "saltus/control/exact_run.h"

#include <glog/logging.h>

#include <cmath>
#include <numeric>

#include "running_loss.h"
#include "saltus/control/objective.h"
#include "saltus/dynamics/registry.h"

namespace saltus {
namespace {

const ModelTraits* ExactModel() {
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.event_driven) return &traits;
  }
  return nullptr;
}

// Runs `scene` for control intervals of one length from `x` (B x 4) on, which becomes the state at the end.
bool RunEqualIntervals(std::string_view model, const Scene& scene, const std::vector<double>& control, double start,
                       std::vector<double>* x, ExactRun* run) {
  const std::unique_ptr<Simulator> simulator = MakeSimulator(model, scene, Precision::kDouble);
  CHECK_EQ(simulator->state_size(), static_cast<int>(x->size()));
  if (!simulator->Rollout(*x, control)) {
    run->reason = "the exact rollout is not finite";
    return false;
  }
  simulator->GetState(simulator->num_steps(), *x);
  for (const Event& event : EventsOf(*simulator)) {
    run->events.push_back(event);
    run->events.back().time += start;
  }
  for (const StepTouch& at : EventTouches(*simulator)) {
    run->contacts.push_back(at.touch.candidate);
    if (at.touch.kind != ContactKind::kImpact) run->only_impacts = false;
  }
  run->loss += EffortLoss(scene.objective, control, simulator->step());
  return true;
}

// Running and via terms, and the price of time.
void AddLossOnTheWay(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                     const std::vector<double>& durations, ExactRun* run) {
  const Objective& objective = scene.objective;
  std::vector<double> lengths = durations;
  if (lengths.empty()) lengths.assign(scene.steps, scene.dt());
  if (objective.duration) {
    run->loss += objective.duration->weight * std::accumulate(lengths.begin(), lengths.end(), 0.0);
  }
  if (objective.running.empty() && objective.via.empty()) return;
  if (!run->only_impacts) {
    run->ok = false;
    run->reason = "discs rest on or graze each other or a plane; running and via terms are integrated between impacts";
    return;
  }
  run->loss += RunningLoss(scene, Flight(scene, initial, control, lengths, *run));
}

}  // namespace

ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations) {
  ExactRun run;
  const ModelTraits* exact = ExactModel();
  if (exact == nullptr) {
    run.reason = "no event-driven contact model is registered";
    return run;
  }
  const size_t width = 2 * scene.num_controlled();
  CHECK(durations.empty() || control.size() == width * durations.size());
  Scene part = scene;
  if (width > 0) {
    CHECK_EQ(control.size() % width, 0u);
    part.steps = static_cast<int>(control.size() / width);
  }
  run.reason = WhyNotApplicable(exact->name, part);
  if (!run.reason.empty()) return run;

  std::vector<double> x = initial;
  if (durations.empty()) {
    if (!RunEqualIntervals(exact->name, part, control, 0, &x, &run)) return run;
  } else {
    double start = 0;
    for (size_t begin = 0, end = 0; begin < durations.size(); begin = end) {
      while (end < durations.size() && durations[end] == durations[begin]) ++end;
      part.steps = static_cast<int>(end - begin);
      part.duration = part.steps * durations[begin];
      const std::vector<double> rows(control.begin() + width * begin, control.begin() + width * end);
      if (!RunEqualIntervals(exact->name, part, rows, start, &x, &run)) return run;
      start += part.duration;
    }
  }
  run.ok = true;
  run.loss += TerminalLoss(scene.objective, x, 4);
  AddLossOnTheWay(scene, initial, control, durations, &run);
  return run;
}

}  // namespace saltus
