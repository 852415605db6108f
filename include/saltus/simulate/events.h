// The collisions of a rollout, by name and time.
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

// Impacts at the same time that are connected through discs that move, where another order of them leads to other
// velocities: what follows is that of one order, and the loss jumps here.
struct Tie {
  double time = 0;                  // s, since the start
  std::vector<std::string> bodies;  // all that take part: discs in scene order, then planes
  int num_contacts = 0;
};

// The touches of the simulator's last rollout that are events, in order of time: impacts, and the beginnings of
// contacts that press for a while (in each of their modes). Empty for models that resolve no impact times.
std::vector<StepTouch> EventTouches(const Simulator& simulator);

// Returns the events of the last rollout, with discs and walls by name.
std::vector<Event> EventsOf(const Simulator& simulator);

// The ambiguous ties of the simulator's last rollout, in order of time. Empty for models that resolve no impact times.
std::vector<Tie> TiesOf(const Simulator& simulator);

// Steps of its last rollout that an event-driven model did not resolve into events: it took them at once, as crowds
// (src/contact/event/event_fallback.h), right to first order only. 0 for models that resolve no impact times.
int NumUnresolvedSteps(const Simulator& simulator);

// "12 of 400 steps, in which a crowd of discs stirs without end, are taken at once"; empty if there are none.
std::string DescribeUnresolved(int unresolved_steps, int num_steps);

// "the order of the impacts of a, b and c at 0.5 s decides", of the first of the ties and how many there are more.
// Empty if there is none.
std::string TiesToString(const std::vector<Tie>& ties);

}  // namespace saltus
