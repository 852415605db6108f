// Costates along an exact motion, carried backwards from the end: the derivatives of the loss, of hard terms and of
// gaps at impacts by the state at any time. With L the running terms and u held on its intervals,
//
//   lambda_q' = -dL/dq,   lambda_v' = -lambda_q - dL/dv    in flight
//   lambda-   = lambda+ + d(term)/dx                       at the time of a via term
//   lambda-   = Dg^T lambda+ + nu grad psi                 at an impact
//   lambda(T) = d(terminal terms)/dx                       and the multipliers of hard ones.
//
// Discs that spin have such costates of angle and angular velocity too.
//
// All integrals are exact: pieces are cut where targets turn and at via terms, and are polynomials between.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "optimality/impact_jump.h"
#include "simulate/flight.h"

namespace saltus {

class CostateSweep {
  using RunningTerms = std::span<const RunningTerm>;

 public:
  // The scene and the flight must outlive the object; scene.duration is that of the flight.
  CostateSweep(const Scene& scene, const Flight& flight);

  // A part of a piece.
  struct Segment {
    Flight::Piece piece;
    int original = 0;  // the piece that it is a part of
  };
  const std::vector<Segment>& segments() const { return segments_; }
  // Of each impact: the segment that starts there; segments().size() at the final time.
  int SegmentAfter(int hit) const { return segment_after_[hit]; }
  // Of each via term: the segment that starts at its time.
  int num_via() const { return static_cast<int>(via_after_.size()); }
  int SegmentAfterVia(int term) const { return via_after_[term]; }
  // The number of terminal and via terms that are hard.
  int num_hard() const { return num_hard_; }

  // The multiplier of impact k; `gain` as in ImpactJump.
  using MultiplierOf = std::function<double(int k, const ImpactJump& jump, double gain)>;
  // That which keeps the Hamiltonian with the force after (before) the impact on both of its sides: impact times follow
  // the motion, and an impact on a node is late (early).
  double Late(int k, const ImpactJump& jump, double gain) const;
  double Early(int k, const ImpactJump& jump, double gain) const;

  // What costates are of.
  struct Source {
    bool objective = true;  // terms that are not hard
    // Multipliers of hard terms: terminal ones, then those on the way; empty: none. Of spin the first entry counts.
    std::vector<Vec2d> hard = {};
  };
  struct Result {
    std::vector<Costate<double>> start;    // of each disc, at time 0
    std::vector<std::vector<Vec2d>> push;  // of each segment and pushed disc: the integral of lambda_v
    std::vector<std::vector<double>>
        turn;  // of each segment and turned disc: that of the costate of its angular velocity
    // Of each segment: the integral of the Hamiltonian, without the effort, and those of its partial derivative by time
    // and of that times the time since the segment began.
    std::vector<double> hamiltonian, drift, drift_moment;
    std::vector<double> multipliers;  // of impacts
    double clock = 0;                 // the derivative of via terms by their times, times these
    double largest_position = 0, largest_velocity = 0, largest_hamiltonian = 0;
    std::vector<std::vector<Costate<double>>> after_impact;  // of each impact: of each disc
  };
  Result Sweep(const Source& source, const MultiplierOf& multiplier) const;

  struct Derivatives {
    std::vector<Costate<double>> start;  // by the initial state of each disc
    double by_duration = 0;              // if all control intervals scale with the final time
  };
  // Those of scale * q_axis(t) of a disc, t being `offset` after the start of a segment and scaling too. Impact times
  // follow the motion, late. Adds those by the control to `gradient`, of its shape.
  Derivatives OfPoint(int segment, double offset, int body, bool of_position, int axis, double scale,
                      std::span<double> gradient) const;
  // Those of `scale` times the integral of a running term over segments first..end-1.
  Derivatives OfIntegral(const RunningTerm& term, int first, int end, double scale, std::span<double> gradient) const;

 private:
  // What the Hamiltonian and its derivative by time add up to over a segment.
  struct Balance {
    double hamiltonian = 0, drift = 0, drift_moment = 0;
    double largest = 0;  // magnitude of a part of the Hamiltonian
  };

  // All costates from `length` after the start of a segment back to that; `push`, of pushed discs, gains the integral
  // of lambda_v, and `turn`, of turned discs, that of the costate of their angular velocity.
  void CrossFlight(const Flight::Piece& piece, double length, RunningTerms terms, std::vector<Costate<double>>* now,
                   std::vector<Vec2d>* push, std::vector<double>* turn) const;
  Balance BalanceOf(const Flight::Piece& piece, double length, RunningTerms terms,
                    const std::vector<Costate<double>>& end) const;
  double CrossImpact(int k, RunningTerms terms, const MultiplierOf& multiplier,
                     std::vector<Costate<double>>* now) const;
  void CrossVia(size_t term, const Vec2d& derivative, std::vector<Costate<double>>* now, Result* result) const;
  // From costates at `offset` after the start of a segment; `terms` count from segment `first` on.
  Derivatives PullBack(int segment, double offset, RunningTerms terms, int first, std::vector<Costate<double>> now,
                       std::span<double> gradient) const;
  std::vector<Costate<double>> AtEnd(const Source& source) const;
  const std::vector<Vec2d>& AccelerationBefore(int segment) const { return segments_[segment - 1].piece.acceleration; }

  const Scene& scene_;
  const Flight& flight_;
  std::vector<int> place_;  // by body: among the pushed ones, or -1
  std::vector<Segment> segments_;
  std::vector<int> segment_after_;
  std::vector<int> via_after_;  // of each via term: the segment that starts at its time
  int num_hard_ = 0;
};

}  // namespace saltus
