#include "saltus/dynamics/events.h"

#include <map>
#include <tuple>

namespace saltus {

std::vector<StepTouch> EventTouches(const Simulator& simulator) {
  std::vector<StepTouch> events;
  std::map<std::tuple<bool, int, int, ContactMode>, int> pressed_in;  // the last step in which a pair pressed
  for (const StepTouch& at : simulator.touches()) {
    if (at.touch.time < 0) continue;
    if (at.touch.kind == ContactKind::kSustained) {
      const Candidate& c = at.touch.candidate;
      const auto [last, first_time] = pressed_in.try_emplace({c.plane, c.a, c.b, at.touch.mode}, at.step);
      const bool goes_on = !first_time && at.step <= last->second + 1;
      last->second = at.step;
      if (goes_on) continue;
    }
    events.push_back(at);
  }
  return events;
}

std::vector<Event> EventsOf(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  std::vector<Event> events;
  for (const StepTouch& at : EventTouches(simulator)) {
    const Candidate& c = at.touch.candidate;
    events.push_back({at.step * simulator.step() + at.touch.time,
                      scene.bodies[c.a].name,
                      c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name,
                      at.touch.mode});
  }
  return events;
}

}  // namespace saltus
