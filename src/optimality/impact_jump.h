// Costates of discs in an exact motion, and how an impact joins those after it to those before.
#pragma once

#include <array>
#include <vector>

#include "control/impact.h"
#include "simulate/flight.h"

namespace saltus {

template <typename T>
struct Costate {
  T time;
  Vec2<T> position, velocity;                   // lambda_q, lambda_v at `time`
  T angle = T(0.0), angular_velocity = T(0.0);  // likewise, of a disc that spins
  // In flight without terms on the way.
  Costate At(const T& t) const {
    return {t, position, velocity + Scale(T(time - t), position), angle, T(angular_velocity + (time - t) * angle)};
  }
};

// The costates just after and just before an impact for both sides, without the multiplier.
struct ImpactJump {
  std::array<int, 2> body = {-1, -1};  // -1: a plane or a fixed disc
  std::array<Costate<double>, 2> after, before;
  std::array<Vec2d, 2> velocity_before, velocity_after;
  std::array<double, 2> spin_gain = {0, 0};  // rad/s

  // The multiplier that keeps the Hamiltonian if accelerations are the same before and after, those of `piece`, and
  // what the motion costs on its way is `gain` more after the impact.
  double MultiplierAt(const Flight::Piece& piece, double speed, double gain = 0) const;
};

// The derivatives of the soft terminal terms by the state of a disc that is not fixed.
Costate<double> FinalCostate(const Scene& scene, const DiscStates& end, int body);

ImpactJump MakeImpactJump(const Scene& scene, const Flight::Hit& hit, const std::array<Costate<double>, 2>& after);

}  // namespace saltus
