// The conditions of the hybrid minimum principle in continuous time as a square system, with bounds on the forces, hard
// terms, running and via terms and a free final time. States and costates are integrated forward from the start
// (indirect shooting): for every disc that has an influence, between events (impacts, via terms, corners of targets),
//
//   p' = v,  v' = u/m + g,  lambda_q' = -dL/dq,  lambda_v' = -lambda_q - dL/dv,
//   u = the force within the bounds that is nearest to -lambda_v / (2 effort m).
//
// The unknowns are the costates at the start; of each impact the time, the multiplier nu and the costates after it; the
// multipliers of hard terms; and the final time if it is free. The residuals are, in this order: the jumps of the
// costates at impacts; the jumps of the Hamiltonian there, and its value at a free final time; gaps at impacts and hard
// terms; and the costates at the end.
//
// Where the force is within its bounds the equations are linear with constant coefficients, and Taylor's series solves
// them to rounding. Where it is bounded it is integrated by Gauss' rule between the times at which a bound becomes
// active or inactive. These times are computed for costates that are linear in time, so a disc may have bounds or
// running terms and not both. Derivatives need not move these times, as forces are continuous.
#pragma once

#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/scene/scene.h"
#include "simulate/costate_sweep.h"

namespace saltus {

inline constexpr int kCostateShootingStride = 4;  // of the Jets that Evaluate takes, and double

// The number of residuals of each condition, in their order.
struct ConditionSizes {
  int jumps = 0, hamiltonians = 0, gaps = 0, terminal = 0;
  int Sum() const { return jumps + hamiltonians + gaps + terminal; }
};

class CostateShooting {
 public:
  // State and costates of a disc. q is lambda_q, w is lambda_v.
  template <typename T>
  struct Flying {
    Vec2<T> p, v, q, w;
  };
  // A flight of one disc from one event to the next.
  struct Leg {
    int body = 0;
    double begin = 0;  // s
    Flying<double> start;
  };

  // `moving_end`: the final time is unknown. Preconditions: ReasonNotSupported() is empty, effort > 0.
  CostateShooting(const Scene& scene, std::vector<Candidate> sequence, bool moving_end);

  // Returns the reason why the method does not apply to a scene; empty if it does.
  static std::string ReasonNotSupported(const Scene& scene);

  int num_unknowns() const { return num_unknowns_; }
  const Scene& scene() const { return scene_; }

  // Returns the vector of unknowns for given costates of all discs at the start and after each impact, times and
  // multipliers of impacts, multipliers of hard terms (terminal ones first), and the final time.
  std::vector<double> Unknowns(const std::vector<Costate<double>>& start,
                               const std::vector<std::vector<Costate<double>>>& after_impact,
                               const std::vector<double>& times, const std::vector<double>& multipliers,
                               const std::vector<Vec2d>& hard, double end) const;

  const ConditionSizes& sizes() const { return sizes_; }

  // Writes as many residuals as there are unknowns. Returns false if there is no motion with these unknowns: impact
  // times are not in order, or the two bodies of an impact separate. The loss, the legs and the speeds of approach at
  // the impacts are not computed where null.
  template <typename T>
  bool Evaluate(const T* y, T* residuals, T* loss = nullptr, std::vector<Leg>* legs = nullptr,
                std::vector<double>* speeds = nullptr) const;
  // Returns the force on pushed disc c at a time. Precondition: `legs` are those of a motion that contains the time.
  Vec2d ForceAt(const std::vector<Leg>& legs, int c, double time) const;

  double Time(const double* y, int impact) const { return y[impact_index_[impact]]; }
  double Multiplier(const double* y, int impact) const { return y[impact_index_[impact] + 1]; }
  double Duration(const double* y) const { return end_index_ < 0 ? scene_.duration : y[end_index_]; }
  Vec2d Hard(const double* y, int term) const { return {y[hard_index_ + 2 * term], y[hard_index_ + 2 * term + 1]}; }

 private:
  bool HasCostate(int body) const { return index_[body] >= 0; }
  template <typename T>
  Vec2<T> ForceOf(int body, const Vec2<T>& lambda_v) const;
  // Moves state and costates of a disc from time `from` on by `length`, and adds the effort and the running terms of
  // the flight to `loss` unless it is null.
  template <typename T>
  void Fly(int body, const T& from, const T& length, Flying<T>* x, T* loss) const;
  template <typename T>
  void FlyBySeries(int body, const T& from, const T& length, Flying<T>* x, T* loss) const;
  template <typename T>
  void FlyAtBounds(int body, const T& length, Flying<T>* x, T* loss) const;
  std::vector<double> Switches(int body, const Vec2d& lambda_q, const Vec2d& lambda_v, double length) const;
  template <typename T>
  T Running(int body, const T& time, const Flying<T>& x, bool of_velocity_only) const;
  template <typename T>
  T Hamiltonian(int body, const T& time, const Flying<T>& x, bool of_velocity_only) const;

  Scene scene_;
  std::vector<Candidate> sequence_;
  std::vector<int> place_;                  // by body: among the pushed ones, or -1
  std::vector<int> index_;                  // by body: of its costates at the start, or -1
  std::vector<int> impact_index_;           // by impact: of its time, its multiplier and the costates after it
  std::vector<std::vector<double>> turns_;  // by body: of its targets, rising
  int hard_index_ = 0, end_index_ = -1, num_unknowns_ = 0;
  ConditionSizes sizes_;
};

}  // namespace saltus
