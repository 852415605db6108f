// Derivatives of a flight without contact: constant, so that they cost a few operations a step, or none.
//
//   dp' = pp dp + pv dv + pa da,  dv' = vp dp + vv dv + va da,  a = u/m + g; every block is a multiple of the identity.
#pragma once

#include <Eigen/Core>

namespace saltus {

template <typename S>
struct FreeFlightJacobian {
  S pp, pv, pa, vp, vv, va;  // 1, s, s^2, 1/s, 1, s

  bool operator==(const FreeFlightJacobian&) const = default;

  // True if the velocity stays as it is and the position follows it, as in all models without drag.
  bool IsShear() const { return pp == S(1) && vp == S(0) && vv == S(1); }

  // That of n steps, without forces: its pa and va are those of one step.
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

  // Takes the cotangent (p, v) of the state after a step to that before it.
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

// Cotangents of a disc's acceleration in n steps: last + (n - 1 - j) change in step j.
template <typename S>
struct LinearCotangents {
  Eigen::Array<S, 2, 1> last, change;
};

// The same in one go, so that no step waits for another. A flight that is cut in two differs in the last bits.
// Precondition: free.IsShear().
template <typename S>
LinearCotangents<S> PullBackShear(const FreeFlightJacobian<S>& free, int n, S* lambda) {
  const Eigen::Array<S, 2, 1> p(lambda[0], lambda[1]), v(lambda[2], lambda[3]), change = free.pv * p;
  for (int j = 0; j < 2; ++j) lambda[2 + j] = v[j] + S(n) * change[j];
  return {free.pa * p + free.va * v, free.va * change};
}

}  // namespace saltus
