// Event-driven simulation: free flight in exact arcs between impacts, which are found to machine precision.
#pragma once

#include "saltus/contact/event_step.h"

namespace saltus {

struct EventDriven {
  static constexpr ModelTraits kTraits = {.name = "event",
                                          .summary = "event-driven: exact arcs, impacts and impact times",
                                          .source = "saltation matrix; Newton's restitution, Coulomb's friction",
                                          .double_engine = true,
                                          .chains = true,
                                          .event_driven = true};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    const Vec2<T> a = in.Acceleration(i);
    return {x.p + Scale(in.h, Vec2<T>(x.v + Scale(in.h * 0.5, a))), x.v + Scale(in.h, a)};
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    if (in.candidates.empty()) return;
    internal::EventStep<T> step(in, x);
    if (!step.AnythingMayHappen()) return;
    step.Run();
    for (int i = 0; i < static_cast<int>(x.size()); ++i) {
      if (step.Moved(i)) next[i] = step.End(i);
    }
  }
};

}  // namespace saltus
