// Feedback along a motion with events: its linearization, and the linear-quadratic regulator with jumps.
//
// A motion is linearized over its control intervals,
//
//   dx_{k+1} = A_k dx_k + B_k du_k,
//
// from state to state at the fixed times at which the intervals begin. A state of a scene has the numbers of each disc
// in turn, as Simulator::GetState(). Events within an interval contribute their saltation matrices, so that A_k has the
// size of the state at the end times that at the beginning. Hybrid systems, mechanical ones among them, and scenes of
// discs supply the same form.
//
// Sources: Kong, Payne, Council, Johnson 2021, The salted Kalman filter and hybrid iLQR; Kong, Payne, Zhu, Johnson
// 2024, Saltation matrices, section V.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// An event of the motion, and the derivatives of its time by the state at the beginning of the interval and by the
// control.
struct LinearEvent {
  double time = 0;                                    // s
  std::string name = {};                              // "guard 'ground' in mode 'flight'"; "a and b" of a scene
  Eigen::RowVectorXd by_state = {}, by_control = {};  // of the time, by x_k and u_k
  // The discs of the event that move, in a scene: the order of events that share none does not matter. Empty: it does.
  std::vector<int> discs = {};
  bool immediate = false;  // whether it follows the event before it without time passing
};

// The least value of a quantity that stays above zero in an interval, and its derivatives. The quantity is a guard of a
// hybrid system; in a scene, the gap of a pair without contact, or the overlap of the paths of a pair with an impact.
struct LinearGuard {
  std::string name = {};
  double time = 0;                                    // s
  double value = 0;                                   // >= 0; 0 if it reaches zero without crossing it
  Eigen::RowVectorXd by_state = {}, by_control = {};  // by x_k and u_k
};

struct LinearInterval {
  double begin = 0;                // s
  int mode = 0;                    // at the beginning
  Eigen::MatrixXd A = {}, B = {};  // A: (size at the end) x (size at the beginning); B: (size at the end) x m
  std::vector<LinearEvent> events = {};
  std::vector<LinearGuard> guards = {};
};

struct LinearMotion {
  std::vector<LinearInterval> intervals = {};  // K
  double end = 0;                              // s
};

// Linearizes the last rollout, which succeeded, of `input`. Precondition: ReasonNotDifferentiable() is empty.
LinearMotion Linearize(HybridSimulator& motion, const HybridInput& input);
// Linearizes a rollout of a scene under a control (K rows of its control width); du_k is a row. Under the
// event-driven model A_k and B_k contain the saltation matrices; under other models they are the derivatives of its
// step. Precondition: Rollout returned true.
LinearMotion Linearize(const Simulator& motion, std::span<const double> control);

// The cost that a regulator minimises: the sum over the intervals of dx' Q dx + du' R du, plus dx_K' QT dx_K, without a
// factor 1/2. For TrackContinuously the sum is an integral over time. Q: one symmetric matrix for all modes, or one for
// each mode. R: symmetric and positive definite.
struct TrackingCost {
  std::vector<Eigen::MatrixXd> Q = {};
  Eigen::MatrixXd R = {}, QT = {};
  bool per_time = false;  // for Track: Q and R are multiplied by the length of each interval
};

struct Regulator {
  std::vector<Eigen::MatrixXd> gains = {};        // K: du = -gains[k] dx at the beginning of interval k
  std::vector<Eigen::MatrixXd> cost_to_go = {};   // K + 1: dx' cost_to_go[k] dx, symmetric
  std::vector<Eigen::MatrixXd> closed_loop = {};  // K: dx_{k+1} = closed_loop[k] dx_k
  // TrackContinuously only: at the events, in their order.
  struct EventJump {
    double time = 0;
    Eigen::MatrixXd saltation = {}, gain_before = {}, gain_after = {}, cost_before = {}, cost_after = {};
  };
  std::vector<EventJump> events = {};
};

// Checks sizes, symmetry, and that R is positive definite. Returns the first error as "found x, expected y"; empty if
// there is none.
std::string Validate(const TrackingCost& cost, const HybridSimulator& motion);
// Checks gains in the same way: their number, their shapes, and whether they are finite.
std::string Validate(const Regulator& regulator, const LinearMotion& motion);

// Computes the regulator with du constant in each interval (Riccati recursion, backwards). Cost: K products of matrices
// of the size of the state. The gains are empty if they are not finite, or if R + B' S B is not positive definite
// within rounding, because the weights differ too much. Precondition: sizes match, R is positive definite.
Regulator Track(const LinearMotion& motion, const TrackingCost& cost);

// Computes the regulator with du continuous in time, for the last rollout of `input`: -S' = Q + S A + A' S - S B R^-1
// B' S between events, S- = Xi' S+ Xi at an event, du = -R^-1 B' S dx. The flow of S is the transition matrix of the
// Hamiltonian system of (dx, S dx), integrated by a Runge-Kutta method of order 8; twice as many steps change the
// result by less than `tolerance`, relatively. The gains are empty if the motion has two transitions without time
// between them, or states that are projected.
Regulator TrackContinuously(const HybridSimulator& motion, const HybridInput& input, const TrackingCost& cost,
                            double tolerance = 1e-13);

}  // namespace saltus
