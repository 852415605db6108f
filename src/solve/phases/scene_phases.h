// A plan of a scene of discs as one of its hybrid system (scene_problem.h), for the transcription of hybrid systems.
//
// The scene is one without units: its lengths, times and loss are of order one. Terms are those of the hybrid problem
// of the scene, except for the effort, running terms and limits of the speed, which stay squares and limits of single
// steps, and read no other discs than they name.
#pragma once

#include <memory>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/simulate/simulator.h"
#include "solve/phases/hybrid_transcription.h"
#include "solve/phases/phase_plan.h"
#include "solve/phases/phase_solution.h"

namespace saltus {

class ScenePhases {
 public:
  // The instants that the plan has besides impacts are those of `waypoints`, in their order, of which the scene may
  // have some. The pairs of `apart` never come nearer than the distance at which they touch, except for the phases that
  // an impact of theirs begins or ends. Discs fly as in a step of `flight`, which must outlive this object and fly over
  // any length; if it is null, exactly.
  ScenePhases(const Scene& scene, const PlanOf<Candidate>& plan, const std::vector<double>& waypoints,
              const ContactSequence& apart, const Simulator* flight = nullptr);

  // Makes the transcription with so many steps of each phase, along the cuts at these times, with events that come
  // early by `overlaps` and gaps that stay open by `margin`. Nodes start where the discs get under the control of
  // `start`, with the impacts at the times of their cuts, whatever the gaps there. Null if that is no motion.
  std::unique_ptr<HybridTranscription> Make(const Trial& start, std::vector<double> times,
                                            const std::vector<double>& overlaps, const std::vector<int>& steps,
                                            double margin) const;
  // Sets the control that a transcription stands at, within its bounds and as long as the horizon, to the last bit.
  void TakeControl(const HybridTranscription& transcription, Trial* trial) const;

 private:
  void AddEfforts();
  void AddRunning(const RunningTerm& term);
  void AddLimit(const SpeedLimit& limit);
  void AddSeparationAtStart();

  Scene scene_;
  HybridProblem problem_;
  HybridScales scales_;
  PlanOf<ModeEvent> plan_;
  std::vector<double> instants_;  // of each cut that is one; NaN: an impact
};

// Returns the times of waypoints, rising, each once.
std::vector<double> WaypointsOf(const Scene& scene);

}  // namespace saltus
