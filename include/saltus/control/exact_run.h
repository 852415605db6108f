// Any solution, re-simulated with exact event-driven dynamics.
#pragma once

#include <string>
#include <vector>

#include "saltus/dynamics/events.h"

namespace saltus {

// An initial state and a control, re-simulated with exact event-driven dynamics on the same control intervals: the loss
// that may be compared between contact models and time grids.
struct ExactRun {
  bool ok = false;
  std::string reason;  // if not ok
  double loss = 0;
  std::vector<Event> events;
  std::vector<Candidate> contacts;  // of the events, by indices of the scene
  // Of the events: the control interval, and the time since its start, s.
  struct Place {
    int interval = 0;
    double time = 0;
  };
  std::vector<Place> places;
  bool only_impacts = true;         // no event is a resting or grazing contact
};
// Shapes: initial is B x 4; control is K x C x 2, for any K. Its intervals last `durations` (K numbers that sum up to
// the horizon), or equally long if there are none. Wrong shapes, numbers that are not finite and a wrong scene are a
// reason.
ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations = {});

}  // namespace saltus
