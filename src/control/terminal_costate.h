// Where costates end.
#pragma once

#include "saltus/physics/geometry.h"
#include "saltus/physics/scene.h"

namespace saltus {

// The derivatives of the loss by position and velocity of a disc: lambda_q, lambda_v.
template <typename T>
struct DiscCostate {
  Vec2<T> position = Vec2<T>(T(0.0), T(0.0)), velocity = Vec2<T>(T(0.0), T(0.0));
};

// Those of the terminal terms, for a disc that ends at p with velocity v.
template <typename T>
DiscCostate<T> TerminalCostate(const Objective& objective, int body, const Vec2<T>& p, const Vec2<T>& v) {
  DiscCostate<T> costate;
  for (const TerminalTerm& term : objective.terminal) {
    if (term.body != body) continue;
    const bool of_position = term.quantity == TerminalTerm::Quantity::kPosition;
    Vec2<T>& out = of_position ? costate.position : costate.velocity;
    if (term.component) {
      out[*term.component] += T(term.weight);
    } else {
      out += Scale(2 * term.weight, Vec2<T>((of_position ? p : v) - term.target.template cast<T>()));
    }
  }
  return costate;
}

}  // namespace saltus
