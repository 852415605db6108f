// Any solution, re-simulated with exact event-driven dynamics.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/simulate/events.h"

namespace saltus {

// The traits of the contact model of the registry whose motion is exact (event-driven); null if there is none.
const ModelTraits* ExactModel();

// The smallest and the largest loss over the orders of impacts at the same time.
struct LossSpread {
  double lowest = 0, highest = 0;
};

// An initial state and a control, re-simulated with exact event-driven dynamics on the same control intervals: the loss
// that may be compared between contact models and time grids.
struct ExactRun {
  bool ok = false;
  std::string reason;  // if not ok
  double loss = 0;
  std::vector<double> end;  // final state as an initial state; if not ok, of the motion in `reason`, or empty
  std::vector<Event> events;
  std::vector<Candidate> contacts;  // of the events, by indices of the scene
  // The place of an event: its control interval, and the time since the start of that, s.
  struct Place {
    int interval = 0;
    double time = 0;
  };
  std::vector<Place> places;
  bool only_impacts = true;  // no event is a resting or grazing contact

  // Ties whose order decides: another one leads to another final state (such as a pile that comes to rest in any case
  // does not). Then also the losses over the orders, each of which is simulated; with several ties, all in orders of
  // the same number.
  std::vector<Tie> ambiguous;
  std::optional<LossSpread> spread;
};
inline constexpr char kStopped[] = "interrupted";  // the reason of what was stopped

// Shapes: initial as in simulator.h; control is K x C x 2, for any K. Its intervals last `durations` (K numbers that
// sum up to the horizon), or equally long if there are none. Wrong shapes, numbers that are not finite and a wrong
// scene are a reason; so is kStopped, if `stop` asked for the end.
ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations = {}, const StopRequest& stop = nullptr);

// TiesToString(), and what the loss is over the orders if that is known.
std::string DescribeTies(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread);

}  // namespace saltus
