// The impacts and other events of a rollout, with the names of bodies and the times. Only models that resolve impact
// times (ModelTraits::event_driven) have events.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

struct Event {
  double time = 0;  // s, since the start
  std::string a;    // a disc
  std::string b;    // the other disc, or the wall, a part of a wall, a pocket or "table" (WallPart::name)
  ContactMode mode = ContactMode::kFrictionless;
};

// Simultaneous impacts that are connected through discs that move, and whose order changes the velocities after them.
// The motion is that of one order, and the loss jumps here.
struct Tie {
  double time = 0;                  // s, since the start
  std::vector<std::string> bodies;  // names of discs in the order of the scene, then of walls
  int num_contacts = 0;
};

// Returns the touches of the last rollout that are events: impacts, grazing contacts, and the beginnings of sustained
// contacts, again for each mode (slip, stick) and after each step without the contact; in order of time. Empty for
// models that resolve no impact times.
std::vector<StepTouch> EventTouches(const Simulator& simulator);

// Returns the events of the last rollout, in order of time, with discs and walls by name.
std::vector<Event> EventsOf(const Simulator& simulator);

// Returns where discs graze others or walls in the last rollout, under `control`, up to rounding: derivatives are then
// those of motions that pass by without a contact. The times are in order. Empty for models that resolve no impact
// times; between two impacts of a disc in one step, and with forces that depend on the state, only what the model
// itself takes for a touch is found.
std::vector<Event> GrazesOf(const Simulator& simulator, std::span<const double> control);

// Returns the ties of the last rollout whose order changes the motion, in order of time. Empty for models that resolve
// no impact times.
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
