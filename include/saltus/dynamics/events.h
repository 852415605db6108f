// The collisions of a rollout, by name and time.
#pragma once

#include <string>
#include <vector>

#include "saltus/dynamics/simulator.h"

namespace saltus {

struct Event {
  double time = 0;  // s, since the start
  std::string a;    // a disc
  std::string b;    // a disc or a plane
  ContactMode mode = ContactMode::kFrictionless;
};

// The touches of the simulator's last rollout that are events, in order of time: impacts, and the beginnings of
// contacts that press for a while (in each of their modes). Empty for models that resolve no impact times.
std::vector<StepTouch> EventTouches(const Simulator& simulator);

// The same, by name.
std::vector<Event> EventsOf(const Simulator& simulator);

}  // namespace saltus
