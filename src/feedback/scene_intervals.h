// A scene on control intervals of any lengths: one simulator for each run of intervals of one length.
#pragma once

#include <algorithm>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "saltus/feedback/closed_loop.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

class SceneIntervals {
 public:
  struct Interval {
    double begin = 0, length = 0;          // s
    const Simulator* simulator = nullptr;  // none of an interval without length
    int step = 0;                          // of the simulator
    // Whether a touch in the interval is a contact that lasts from the start of the motion, which is no event.
    bool LastsFromStart(const Touch& touch) const;
  };

  // The steps of one simulator, which outlives this object.
  explicit SceneIntervals(const Simulator& simulator);
  explicit SceneIntervals(std::unique_ptr<Simulator> simulator);
  // Intervals that last `lengths` (K numbers >= 0, s, one of them not 0), whose sum is the scene's duration. One step
  // of the model covers one of them. Precondition: the contact model is applicable to the scene with K steps, or with
  // as many more as its steps cover.
  SceneIntervals(const Contact& contact, const Scene& scene, std::span<const double> lengths);

  int size() const { return static_cast<int>(intervals_.size()); }
  const Interval& operator[](int k) const { return intervals_[k]; }
  double end() const { return end_; }  // s
  // One of the simulators, for what all have in common.
  const Simulator& simulator() const { return *any_; }

  // Simulates all intervals in turn, those with own simulators only. Returns why it cannot, or an empty text.
  std::string Rollout(std::vector<double> initial, std::span<const double> control);
  // A simulator of one step from the beginning of interval k, which is shorter. Precondition: the model is exact.
  std::unique_ptr<Simulator> MakeStep(int k, double length) const;
  // Returns, after a rollout, the state at the beginning of interval k, or at the end for k = size().
  std::vector<double> State(int k) const;
  const std::vector<std::unique_ptr<Simulator>>& simulators() const { return own_; }
  // Returns the touches of interval k, in order of time.
  std::span<const Touch> touches(int k) const { return touches_[k]; }

 private:
  void AddStepsOf(const Simulator& simulator);
  void AddTouchesOf(const Simulator& simulator, int first);

  const Scene whole_;
  std::vector<std::unique_ptr<Simulator>> own_;
  const Simulator* any_ = nullptr;  // the last one
  double end_ = 0;
  std::vector<Interval> intervals_;
  std::vector<std::vector<Touch>> touches_;
};

inline EventLabel LabelOf(const Candidate& c, int interval) { return {c.a, c.b, c.plane ? 1 : 0, interval}; }

// The touches of consecutive steps as events: impacts that have a time, and the beginnings of contacts that last.
class TouchEvents {
 public:
  // Calls visit(i) for each of the touches of step k that is an event. Steps follow each other.
  template <typename Visit>
  void Add(std::span<const Touch> touches, const Visit& visit) {
    std::vector<Candidate> now;
    for (std::size_t i = 0; i < touches.size(); ++i) {
      const Touch& touch = touches[i];
      const auto in = [&](const std::vector<Candidate>& pairs) {
        return std::find(pairs.begin(), pairs.end(), touch.candidate) != pairs.end();
      };
      const bool impact = touch.time >= 0 && touch.kind == ContactKind::kImpact;
      if (impact || (!in(before_) && !in(now))) visit(i);
      now.push_back(touch.candidate);
    }
    before_ = std::move(now);
  }

 private:
  std::vector<Candidate> before_;
};

struct SceneEvent {
  EventLabel label;
  std::size_t touch = 0;   // in touches(label.interval)
  std::vector<int> discs;  // that move
};
// The events of a motion, in order of time: all but contacts that last from the start.
std::vector<SceneEvent> PlannedEvents(const SceneIntervals& motion);

// Plan and linearization of a motion that Rollout() has simulated, or of the simulator that is given.
Plan MakePlan(const SceneIntervals& motion, std::span<const double> control);
LinearMotion Linearize(const SceneIntervals& motion, std::span<const double> control);

}  // namespace saltus
