// Costates of discs in an exact motion, and how they pass impacts.
//
// CostateSweep carries them backwards from the end: they are the derivatives of the loss, of hard terms and of gaps at
// impacts by the state at any time. With L the running terms and u held on its intervals,
//
//   lambda_q' = -dL/dq,   lambda_v' = -lambda_q - dL/dv    in flight
//   lambda-   = lambda+ + d(term)/dx                       at the time of a via term
//   lambda-   = Dg^T lambda+ + nu grad psi                 at an impact
//   lambda(T) = d(terminal terms)/dx                       and the multipliers of hard ones.
//
// Discs with rotational inertia have such costates of angle and angular velocity too. All integrals are exact: pieces
// are cut where targets turn and at via terms, and are polynomials between.
#pragma once

#include <array>
#include <functional>
#include <span>
#include <vector>

#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"
#include "simulate/flight.h"
#include "simulate/impact.h"

namespace saltus {

// The derivatives of the loss by position and velocity of a disc at a time, lambda_q and lambda_v, and if it has
// rotational inertia by angle and angular velocity.
template <typename T>
struct Costate {
  T time = T(0.0);  // s
  Vec2<T> position = Vec2<T>(T(0.0), T(0.0)), velocity = position;
  T angle = T(0.0), angular_velocity = T(0.0);

  // Returns the costate at time t of the same flight, which has no path costs.
  Costate CostateAt(const T& t) const {
    return {t, position, velocity + Scale(T(time - t), position), angle, T(angular_velocity + (time - t) * angle)};
  }
  // Returns the costate of the angle or angular velocity. Precondition: `quantity` is one of these.
  T& CostateOfSpin(TerminalTerm::Quantity quantity) {
    return quantity == TerminalTerm::Quantity::kAngle ? angle : angular_velocity;
  }
};

// Returns the derivatives of the terminal terms that are not hard by the final state of a disc.
template <typename T>
Costate<T> TerminalCostate(const Objective& objective, int body, const T& time, const Vec2<T>& p, const Vec2<T>& v,
                           const T& angle = T(0.0), const T& spin = T(0.0)) {
  Costate<T> costate;
  costate.time = time;
  for (const TerminalTerm& term : objective.terminal) {
    if (term.body != body || term.hard) continue;
    if (term.IsRotational()) {
      const T& q = term.quantity == TerminalTerm::Quantity::kAngle ? angle : spin;
      costate.CostateOfSpin(term.quantity) += T(2 * term.weight * (q - term.target[0]));
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

// An active constraint on the state of a disc at one time, linearised: it changes by normal . dq, with q its quantity.
// The costate of q jumps there by multiplier * normal.
struct ConstraintRow {
  int owner = 0;  // the constraint that it is a row of
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  Vec2d normal = Vec2d::Zero();  // of an angle or angular velocity the first entry
  int via = -1;                  // the waypoint; -1: the final time
  double multiplier = 1;
};

// Returns the rows of the terminal terms and then of the waypoints of a scene that are hard and have no region.
std::vector<ConstraintRow> RowsOfHardTerms(const Scene& scene);

// The costates of both bodies just after and just before an impact, before without the contribution of the multiplier.
struct ImpactJump {
  std::array<int, 2> body = {-1, -1};  // -1: a plane or a fixed disc
  std::array<Costate<double>, 2> after, before;
  std::array<Vec2d, 2> velocity_before, velocity_after;
  std::array<double, 2> spin_gain = {0, 0};  // rad/s

  // The multiplier with which the Hamiltonian does not jump if accelerations before and after the impact are those of
  // `piece`, and the rate of the path costs jumps by `gain`. `speed` is the normal velocity before the impact.
  double MultiplierAt(const Flight::Piece& piece, double speed, double gain = 0) const;
};

// Returns the TerminalCostate() at the final state of a trajectory.
Costate<double> FinalCostate(const Scene& scene, const DiscStates& end, int body);

ImpactJump MakeImpactJump(const Scene& scene, const Flight::Hit& hit, const std::array<Costate<double>, 2>& after);

class CostateSweep {
  using RunningTerms = std::span<const RunningTerm>;

 public:
  // The scene and the flight must outlive the object; scene.duration is that of the flight.
  CostateSweep(const Scene& scene, const Flight& flight);

  // Returns the segments: parts of pieces between instants at which a target turns or a via term acts.
  const std::vector<Flight::Piece>& segments() const { return segments_; }
  // Returns the segment that starts at the time of a via term.
  int SegmentAfterVia(int term) const { return via_after_[term]; }
  // Returns the multiplier of impact k; `gain` as in ImpactJump.
  using MultiplierOf = std::function<double(int k, const ImpactJump& jump, double gain)>;
  // The multiplier with which the Hamiltonian does not jump if the force after the impact acts on both sides of it:
  // that of the derivative by a motion whose impact on a node is late.
  double LateMultiplier(int k, const ImpactJump& jump, double gain) const;

  struct Result {
    std::vector<Costate<double>> start;    // of each disc, at time 0
    std::vector<std::vector<Vec2d>> push;  // of each segment and pushed disc: the integral of lambda_v
    std::vector<std::vector<double>>
        turn;                // of each segment and turned disc: that of the costate of its angular velocity
    double by_duration = 0;  // if all control intervals scale with the final time, and waypoints keep theirs
    double largest_position = 0, largest_velocity = 0;
    std::vector<std::vector<Costate<double>>> after_impact;  // of each impact: of each disc
  };
  // Carries back the derivatives of the terms that are not hard, and of the constraints times their multipliers.
  Result Sweep(std::span<const ConstraintRow> constraints, const MultiplierOf& multiplier) const;

  // Adds to `gradient`, of the shape of a control, the derivatives by the forces and torques of an interval that follow
  // from `push` and `turn` of one of its segments.
  void AddByControl(int interval, const std::vector<Vec2d>& push, const std::vector<double>& turn,
                    std::span<double> gradient) const;

  struct Derivatives {
    std::vector<Costate<double>> start;  // by the initial state of each disc
    double by_duration = 0;              // if all control intervals scale with the final time
  };
  // The derivatives of scale * q_axis(t) of a disc, with t `offset` after the start of a segment, which scales too.
  // Impact times follow the motion, late. Adds the derivatives by the control to `gradient`, which has the control's
  // shape.
  Derivatives DerivativesOfPoint(int segment, double offset, int body, bool of_position, int axis, double scale,
                                 std::span<double> gradient) const;
  // Returns the derivatives of `scale` times the integral of a running term over segments first..end-1.
  Derivatives DerivativesOfIntegral(const RunningTerm& term, int first, int end, double scale,
                                    std::span<double> gradient) const;

 private:
  // Carries all costates back from `length` after the start of a segment to its start. Adds the integral of lambda_v of
  // each controlled disc to `push`, and that of the costate of the angular velocity of each disc with a torque to
  // `turn`.
  void CrossFlight(const Flight::Piece& piece, double length, RunningTerms terms, std::vector<Costate<double>>* now,
                   std::vector<Vec2d>* push, std::vector<double>* turn) const;
  // Returns the derivative by the factor that scales all times, with what the first `length` of a segment contributes:
  // the integral of the Hamiltonian without the effort, and of its partial derivative by time times the time.
  double StretchOf(const Flight::Piece& piece, double length, RunningTerms terms,
                   const std::vector<Costate<double>>& end) const;
  void CrossImpact(int k, RunningTerms terms, const MultiplierOf& multiplier, std::vector<Costate<double>>* now) const;
  void CrossVia(size_t term, const Vec2d& derivative, std::vector<Costate<double>>* now, Result* result) const;
  // Pulls costates back from `offset` after the start of a segment to time 0; `terms` count from segment `first` on.
  Derivatives PullBack(int segment, double offset, RunningTerms terms, int first, std::vector<Costate<double>> now,
                       std::span<double> gradient) const;
  std::vector<Costate<double>> CostatesAtEnd(std::span<const ConstraintRow> constraints) const;
  static void AddRow(const ConstraintRow& row, std::vector<Costate<double>>* now);
  const DiscArray<Vec2d>& AccelerationBefore(int segment) const { return segments_[segment - 1].acceleration; }

  const Scene& scene_;
  const Flight& flight_;
  std::vector<int> place_;  // by body: among the pushed ones, or -1
  std::vector<Flight::Piece> segments_;
  std::vector<int> segment_after_;
  std::vector<int> via_after_;  // of each via term: the segment that starts at its time
};

}  // namespace saltus
