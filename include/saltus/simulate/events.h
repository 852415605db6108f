// The impacts and other events of a rollout, with the names of bodies and the times.
#pragma once

#include <string>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

struct Event {
  double time = 0;  // s, since the start
  std::string a;    // a disc
  std::string b;    // a disc or a plane, a part of an edge (walls.h), or "table"
  ContactMode mode = ContactMode::kFrictionless;
};

// Simultaneous impacts that are connected through discs that move, and whose order changes the velocities after them.
// The motion is that of one order, and the loss jumps here.
struct Tie {
  double time = 0;                  // s, since the start
  std::vector<std::string> bodies;  // discs in the order of the scene, then planes
  int num_contacts = 0;
};

// Returns the touches of the last rollout that are events, in order of time: impacts, and the beginnings of sustained
// contacts (of each of their modes). Empty for models that resolve no impact times.
std::vector<StepTouch> EventTouches(const Simulator& simulator);

// Returns the events of the last rollout, with discs and walls by name.
std::vector<Event> EventsOf(const Simulator& simulator);

// Returns the ambiguous ties of the last rollout, in order of time. Empty for models that resolve no impact times.
std::vector<Tie> TiesOf(const Simulator& simulator);

// Returns how many steps of the last rollout an event-driven model computed by the time-stepping fallback, which is of
// first order (src/contact/event/event_fallback.h). 0 for models that resolve no impact times.
int NumUnresolvedSteps(const Simulator& simulator);

// Returns "12 of 400 steps use the time-stepping fallback, as ..."; empty if there are none.
std::string DescribeUnresolved(int unresolved_steps, int num_steps);

// Returns a text about the first of the ties, with its bodies and time, and the number of the others; empty if there
// are none.
std::string TiesToString(const std::vector<Tie>& ties);

}  // namespace saltus
