// Models whose gradients are wrong in ways that no value shows.
#pragma once

#include "audit/mirror_model.h"

namespace saltus {

// Forgets to say what touches.
struct Silent : Mirror {
  static constexpr ModelTraits kTraits = {
      .name = "silent", .summary = "reports no contact", .source = "a fault", .friction = false};
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepInput<T> silent = in;
    silent.touches = nullptr;
    Mirror::Step(silent, x, next);
  }
};

// Computes what a contact does from copies that carry no derivatives.
struct Detached : Mirror {
  static constexpr ModelTraits kTraits = {
      .name = "detached", .summary = "contacts without derivatives", .source = "a fault", .friction = false};
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    Mirror::Step(in, x, next);
    for (std::size_t i = 0; i < x.size(); ++i) {
      const State<T> flying = Free(in, static_cast<int>(i), x[i]);
      const auto detach = [](const Vec2<T>& flown, const Vec2<T>& moved) {
        return Vec2<T>(flown[0] + S(Value(moved[0]) - Value(flown[0])),
                       flown[1] + S(Value(moved[1]) - Value(flown[1])));
      };
      if (Value(flying.v[0]) == Value(next[i].v[0]) && Value(flying.v[1]) == Value(next[i].v[1])) continue;
      next[i].p = detach(flying.p, next[i].p);
      next[i].v = detach(flying.v, next[i].v);
    }
  }
};

}  // namespace saltus
