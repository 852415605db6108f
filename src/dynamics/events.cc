#include "saltus/dynamics/events.h"

namespace saltus {

std::vector<Event> EventsOf(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  std::vector<Event> events;
  for (const StepTouch& at : simulator.touches()) {
    if (at.touch.time < 0) continue;
    const Candidate& c = at.touch.candidate;
    events.push_back({at.step * simulator.step() + at.touch.time,
                      scene.bodies[c.a].name,
                      c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name,
                      at.touch.mode});
  }
  return events;
}

}  // namespace saltus
