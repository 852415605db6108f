// Derivatives of a flight without contact: constant, so that they cost a few operations a step, or none.
//
//   dp' = pp dp + pv dv + pa da,  dv' = vp dp + vv dv + va da,  a = u/m + g; every block is a multiple of the identity.
#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>

#include "saltus/internal/contact_step.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

template <typename S>
struct FreeFlightJacobian {
  S pp, pv, pa, vp, vv, va;  // 1, s, s^2, 1/s, 1, s

  bool operator==(const FreeFlightJacobian&) const = default;

  // Whether the velocity stays constant and the position follows it, as in all models without drag.
  bool IsShear() const { return pp == S(1) && vp == S(0) && vv == S(1); }

  // Returns the Jacobian of n steps without forces; its pa and va are those of one step.
  FreeFlightJacobian Power(int n) const {
    FreeFlightJacobian power{S(1), S(0), pa, S(0), S(1), va};
    if (IsShear()) {
      power.pv = S(n) * pv;
      return power;
    }
    for (FreeFlightJacobian square = *this; n > 0; n /= 2) {
      if (n % 2 == 1) power.Multiply(square);
      square.Multiply(square);
    }
    return power;
  }

  // Replaces the cotangent (p, v) of the state after a step by that of the state before it.
  void PullBack(S* p, S* v) const {
    const S after_p = *p, after_v = *v;
    *p = pp * after_p + vp * after_v;
    *v = pv * after_p + vv * after_v;
  }

 private:
  void Multiply(const FreeFlightJacobian& by) {
    const FreeFlightJacobian was = *this, other = by;
    pp = was.pp * other.pp + was.pv * other.vp;
    pv = was.pp * other.pv + was.pv * other.vv;
    vp = was.vp * other.pp + was.vv * other.vp;
    vv = was.vp * other.pv + was.vv * other.vv;
  }
};

// Pulls the cotangent lambda = (p_x, p_y, v_x, v_y) of one disc back through n steps with a force in each. Calls
// push(j, x, y) with the cotangent of its acceleration in step j, for j = n - 1 down to 0.
template <typename S, typename Push>
void PullBackFlight(const FreeFlightJacobian<S>& free, int n, S* lambda, const Push& push) {
  S px = lambda[0], py = lambda[1], vx = lambda[2], vy = lambda[3];
  if (px == S(0) && py == S(0) && vx == S(0) && vy == S(0)) {
    for (int j = n - 1; j >= 0; --j) push(j, S(0), S(0));
    return;
  }
  if (free.IsShear()) {
    for (int j = n - 1; j >= 0; --j) {
      push(j, free.pa * px + free.va * vx, free.pa * py + free.va * vy);
      vx = free.pv * px + vx;
      vy = free.pv * py + vy;
    }
  } else {
    for (int j = n - 1; j >= 0; --j) {
      push(j, free.pa * px + free.va * vx, free.pa * py + free.va * vy);
      free.PullBack(&px, &vx);
      free.PullBack(&py, &vy);
    }
  }
  lambda[0] = px;
  lambda[1] = py;
  lambda[2] = vx;
  lambda[3] = vy;
}

// Cotangents of a disc's acceleration in n steps, linear in the step: last + (n - 1 - j) change in step j.
template <typename S>
struct LinearCotangents {
  Eigen::Array<S, 2, 1> last, change;
};

// PullBackFlight() in closed form, without a recursion over the steps. Cutting a flight in two changes the last bits.
// Precondition: free.IsShear().
template <typename S>
LinearCotangents<S> PullBackShear(const FreeFlightJacobian<S>& free, int n, S* lambda) {
  const Eigen::Array<S, 2, 1> p(lambda[0], lambda[1]), v(lambda[2], lambda[3]), change = free.pv * p;
  for (int j = 0; j < 2; ++j) lambda[2 + j] = v[j] + S(n) * change[j];
  return {free.pa * p + free.va * v, free.va * change};
}

// Returns the Jacobian of the model's free flight over h, at a state whose numbers are all `offset`. It is NaN if it is
// not isotropic, or if the motion turns discs.
template <typename S, int kRotation>
FreeFlightJacobian<S> DifferentiateFreeFlight(const ContactStep<S, kRotation>& model, S h, S offset) {
  using Jet = StepJet<S>;
  BodyState<Jet, kRotation> x{};
  Vec2<Jet> force;
  for (int j = 0; j < 2; ++j) {
    x.p[j] = Jet(offset, j);
    x.v[j] = Jet(offset, 2 + j);
    force[j] = Jet(offset, 4 + j);
  }
  if constexpr (kRotation > 0) {
    for (int j = 0; j < kRotation; ++j) x.rotation[j] = Jet(model.properties().at_rest.rotation[j]);
  }
  const BodyConstants<Jet> body{Jet(S(1)), Jet(S(1)), S(1), false};
  const auto next = model.Free(LoneDisc(h, body, force), x);
  FreeFlightJacobian<S> free{
      next.p[0].v[0], next.p[0].v[2], next.p[0].v[4], next.v[0].v[0], next.v[0].v[2], next.v[0].v[4]};
  bool isotropic = true;
  for (int by = 0; by < 6; by += 2) {
    for (const Vec2<Jet>& to : {next.p, next.v}) {
      isotropic = isotropic && to[1].v[by + 1] == to[0].v[by] && to[0].v[by + 1] == S(0) && to[1].v[by] == S(0);
    }
    if constexpr (kRotation > 0) {
      for (const Jet& to : next.rotation) isotropic = isotropic && to.v[by] == S(0) && to.v[by + 1] == S(0);
    }
  }
  if (!isotropic) free.pp = std::numeric_limits<S>::quiet_NaN();
  return free;
}

// Returns the derivative of a disc's rotation after a free flight from x by the rotation before.
template <typename S, int kRotation>
Eigen::Matrix<S, kRotation, kRotation> DifferentiateRotation(const ContactStep<S, kRotation>& model, S h,
                                                             const BodyConstants<S>& body,
                                                             const BodyState<S, kRotation>& x) {
  using Jet = StepJet<S>;
  static_assert(kRotation <= kJetWidth);
  BodyState<Jet, kRotation> jets{};
  for (int j = 0; j < 2; ++j) {
    jets.p[j] = Jet(x.p[j]);
    jets.v[j] = Jet(x.v[j]);
  }
  for (int j = 0; j < kRotation; ++j) jets.rotation[j] = Jet(x.rotation[j], j);
  const BodyConstants<Jet> constants{Jet(body.mass), Jet(body.inverse_mass), body.radius, body.fixed};
  const Vec2<Jet> no_force(Jet(S(0)), Jet(S(0)));
  const auto next = model.Free(LoneDisc(h, constants, no_force), jets);
  Eigen::Matrix<S, kRotation, kRotation> jacobian;
  for (int r = 0; r < kRotation; ++r) jacobian.row(r) = next.rotation[r].v.template head<kRotation>();
  return jacobian;
}

// Returns the derivative of angle and angular velocity, of a disc with a torque, by these and by the torque.
template <typename S>
Eigen::Matrix<S, 2, 3> DifferentiateTurn(const ContactStep<S, kSpin>& model, S h, const BodyConstants<S>& body,
                                         const BodyState<S, kSpin>& x, S torque) {
  using Jet = StepJet<S>;
  BodyState<Jet, kSpin> jets{};
  for (int j = 0; j < 2; ++j) {
    jets.p[j] = Jet(x.p[j]);
    jets.v[j] = Jet(x.v[j]);
    jets.rotation[j] = Jet(x.rotation[j], j);
  }
  const BodyConstants<Jet> constants{
      Jet(body.mass), Jet(body.inverse_mass), body.radius, body.fixed, body.material, Jet(body.inverse_inertia)};
  const Jet by_torque(torque, 2);
  const Vec2<Jet> no_force(Jet(S(0)), Jet(S(0)));
  const auto next = model.Free(LoneDisc(h, constants, no_force, &by_torque), jets);
  Eigen::Matrix<S, 2, 3> jacobian;
  for (int r = 0; r < 2; ++r) jacobian.row(r) = next.rotation[r].v.template head<3>();
  return jacobian;
}

// Returns the free flight over h with its derivative by h, if the model accepts lengths of time that are Jets.
template <typename S, int kRotation>
std::optional<VariableFreeFlight> DifferentiateByLength(const ContactStep<S, kRotation>& model, double h) {
  using Jet = StepJet<S>;
  using State = BodyState<Jet, kRotation>;
  const Jet length(S(h), 0);
  State start{};
  if constexpr (kRotation > 0) {
    for (int j = 0; j < kRotation; ++j) start.rotation[j] = Jet(model.properties().at_rest.rotation[j]);
  }
  bool known = true;
  const BodyConstants<Jet> body{Jet(S(1)), Jet(S(1)), S(1), false};
  const auto fly = [&](S p, S v, S a) {
    State x = start, next{};
    x.p[0] = Jet(p);
    x.v[0] = Jet(v);
    const Vec2<Jet> force(Jet(a), Jet(S(0)));
    known = known && model.Free(LoneDisc(length, body, force), x, &next);
    return std::array{next.p[0], next.v[0]};
  };
  // Free flight is linear, so each of the six numbers is the result for a state with a single nonzero entry.
  using Ends = std::array<std::array<Jet, 2>, 3>;
  const Ends flown = {fly(S(1), S(0), S(0)), fly(S(0), S(1), S(0)), fly(S(0), S(0), S(1))};
  if (!known) return std::nullopt;
  const auto pick = [](const Ends& by, const auto& part) -> StepLinearization::FreeFlight {
    return {part(by[0][0]), part(by[1][0]), part(by[2][0]), part(by[0][1]), part(by[1][1]), part(by[2][1])};
  };
  const auto value = [](const Jet& x) { return double(x.a); };
  const auto by_time = [](const Jet& x) { return double(x.v[0]); };
  VariableFreeFlight over{pick(flown, value), pick(flown, by_time)};
  if constexpr (kRotation == kSpin) {
    if (!model.properties().linear_rotation) return over;
    const BodyConstants<Jet> spinning{
        .mass = Jet(S(1)), .inverse_mass = Jet(S(1)), .radius = S(1), .inverse_inertia = Jet(S(1))};
    const Vec2<Jet> no_force(Jet(S(0)), Jet(S(0)));
    const auto turn = [&](S angle, S speed, S torque) {
      State x{}, next{};
      x.rotation[0] = Jet(angle);
      x.rotation[1] = Jet(speed);
      const Jet by(torque);
      model.Free(LoneDisc(length, spinning, no_force, &by), x, &next);
      return std::array{next.rotation[0], next.rotation[1]};
    };
    const Ends turned = {turn(S(1), S(0), S(0)), turn(S(0), S(1), S(0)), turn(S(0), S(0), S(1))};
    over.turn = pick(turned, value);
    over.turn_by_time = pick(turned, by_time);
  }
  return over;
}

}  // namespace saltus
