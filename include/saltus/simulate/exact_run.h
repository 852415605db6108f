// Exact event-driven simulation of any initial state and control.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/simulate/events.h"

namespace saltus {

// Returns the traits of the contact model of the registry whose motion is exact (event-driven); null if there is none.
const ModelTraits* ExactModel();

// The smallest and the largest loss over the orders of impacts at the same time.
struct LossSpread {
  double lowest = 0, highest = 0;
};

// The result of an exact simulation. Its loss may be compared between contact models and time grids.
struct ExactRun {
  bool ok = false;
  std::string reason;  // why there is no result, if not ok
  double loss = 0;     // all terms of the objective that are no constraints, with effort and duration
  // The final state, in the layout of an initial state (simulator.h). If not ok, that of the time-stepping fallback
  // where this is the reason, or empty.
  std::vector<double> end;
  std::vector<Event> events;
  std::vector<Candidate> contacts;  // one for each event, with indices of the scene
  // The place of an event: its control interval, and the time since the start of this interval, s.
  struct Place {
    int interval = 0;
    double time = 0;
  };
  std::vector<Place> places;  // one for each event
  bool only_impacts = true;   // no event is a sustained or grazing contact, or a disc that falls into a pocket

  // Ties of which another order leads to another final state, and the range of the losses over the orders. Each order
  // is simulated; if there are several ties, all are in orders of the same number.
  std::vector<Tie> ambiguous;
  std::optional<LossSpread> spread;
};
inline constexpr char kStopped[] = "interrupted";  // the reason of results that were stopped

// Simulates a scene exactly. `initial` is an initial state as in simulator.h (B x 4, or B x 6 with spin), `control` has
// K rows of Scene::control_width() numbers, for any K. Its intervals last `durations` (K numbers >= 0, s, whose sum is
// the scene's duration, or any if the duration is free), or equally long if there are none. Wrong shapes, numbers that
// are not finite and a wrong scene are reported in `reason`, which is kStopped if `stop` returned true.
ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations = {}, const StopRequest& stop = nullptr);

// Returns TiesToString(), with the range of the loss over the orders if it is given.
std::string DescribeTies(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread);

}  // namespace saltus
