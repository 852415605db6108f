// Where costates end.
#pragma once

#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The derivatives of the loss by position and velocity of a disc, lambda_q, lambda_v, and of one that spins by angle
// and angular velocity.
template <typename T>
struct DiscCostate {
  Vec2<T> position = Vec2<T>(T(0.0), T(0.0)), velocity = Vec2<T>(T(0.0), T(0.0));
  T angle = T(0.0), angular_velocity = T(0.0);

  // That of what a term is of, if it is an angle or an angular velocity.
  T& OfSpin(TerminalTerm::Quantity quantity) {
    return quantity == TerminalTerm::Quantity::kAngle ? angle : angular_velocity;
  }
};

// Those of the terminal terms that are not hard, for a disc that ends at p with velocity v, and if it spins with
// `angle` and `spin`.
template <typename T>
DiscCostate<T> TerminalCostate(const Objective& objective, int body, const Vec2<T>& p, const Vec2<T>& v,
                               const T& angle = T(0.0), const T& spin = T(0.0)) {
  DiscCostate<T> costate;
  for (const TerminalTerm& term : objective.terminal) {
    if (term.body != body || term.hard) continue;
    if (term.IsOfSpin()) {
      const T& q = term.quantity == TerminalTerm::Quantity::kAngle ? angle : spin;
      costate.OfSpin(term.quantity) += T(2 * term.weight * (q - term.target[0]));
      continue;
    }
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
