#include "paper/task_replays.h"

#include <algorithm>

#include "programs/scene_drawing.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

// Of those, which disagree most tellingly, the others are a click away.
constexpr const char* kShown[] = {"event", "direct_toi", "direct"};

}  // namespace

Replay TaskReplay(const Experiments& experiments, const std::string& problem) {
  const Scene& scene = experiments.scene(problem);
  Replay replay = ReplayOf(scene);
  const MotionOptions options = ReplayOptions(scene, experiments.all().size());
  const auto add =
      [&](const Motion& motion, const MotionInput& input, const std::string& label, const std::string& style) {
        if (!motion.times.empty()) replay.motions.push_back(ToReplayMotion(scene, motion, input, label, style));
      };
  for (const Experiment& experiment : experiments.all()) {
    const Scene& own = experiment.scene;
    if (own.name != problem || own.contact != scene.contact || experiment.precision != Precision::kDouble) continue;
    const SolvedRun* run = experiment.Find("gd");
    MotionInput input{InitialState(own), InitialControl(own, own.steps), {}};
    if (run != nullptr) input = {run->report.initial_state, run->report.control, run->report.durations};
    const std::string& contact = experiment.contact;
    // Once if a sweep over stiffnesses has the scene's too.
    if (std::ranges::any_of(replay.motions, [&](const auto& motion) { return motion.label == contact; })) continue;
    add(SimulateMotion(own, contact, input, options), input, contact, contact);
    const bool shown = std::find(std::begin(kShown), std::end(kShown), contact) != std::end(kShown);
    if (!replay.motions.empty()) replay.motions.back().shown = shown;
    if (contact == "direct" && run != nullptr) {
      add(SimulateExactMotion(own, input, options), input, contact + ", in exact dynamics", "analytic");
    }
  }
  return replay;
}

}  // namespace saltus
