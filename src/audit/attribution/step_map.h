// The linearization of several steps of a simulator, composed, over some of its discs: as a matrix (StepMap); or, where
// discs are many, as a costate that is pulled back (PulledCostate). Time and memory for the matrix grow with the square
// of the number of discs; its transpose times a vector takes one rollout and two reverse sweeps.
#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// Sets the force on every disc (B x 2) in step k.
using ForceOfStep = std::function<void(int k, std::span<double> force)>;

struct StepMap {
  std::vector<double> end;         // state after the steps
  std::vector<StepTouch> touches;  // steps counted from the begin
  Eigen::MatrixXd A;  // d(end) / d(begin) over the given discs: [p v] of each, and [angle w] if the scene spins
};

// Returns the number of entries of a disc in the state of a scene: 4, or 6 if it spins.
int NumbersOfDisc(const Scene& scene);

// Whether number j of a disc is a velocity or an angular velocity.
inline bool IsRate(Eigen::Index j) { return j == 2 || j == 3 || j == 5; }

// Returns factors that put lengths and angles on one scale, for each disc of `bodies`: 1 and `time` for [p v], and if
// the scene spins the radius and the radius times `time` for [angle w]. Costates are divided by them.
Eigen::VectorXd StateScales(const Scene& scene, const std::vector<int>& bodies, double time);

// Runs `steps` steps from state `begin` under force(0), force(1), ..., and composes their linearization over `bodies`,
// unless that is null. A rotation that only the model has takes part, but is not in A.
StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                 const std::vector<int>* bodies);

// The product A^T lambda over some discs ([p v] of each, and [angle w] if the scene spins), as the sum of the
// contributions of positions and of velocities at the end.
struct PulledCostate {
  Eigen::VectorXd by_positions, by_velocities;
  Eigen::VectorXd Sum() const { return by_positions + by_velocities; }
};

// Pulls a costate back through all steps of the simulator, from state `begin` under its scene's initial control.
// `lambda` has the numbers of each disc of `bodies`; those of other discs are zero. The result is NaN if the rollout
// fails. Precondition: discs have no rotation but that of a scene that spins.
PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda);

// The linearization of one impact in closed form, with terms that models are known to drop.
//
// Variations (dq, dv) of a pair at the nominal time of impact, w and s = n . w the relative velocity and its normal
// part, a the accelerations (constant over the impact):
//
//   dtau = -(n . dd) / s                                 shift of the time of impact, dd = dq_a - dq_b
//   dv_c = dv + [a dtau]                                 at the shifted impact
//   th   = t . (dd + [w dtau]) / rho                     turning of the normal; 0 at planes
//   dv+  = dv_c +- dP / m - [a dtau]                     P as a function of n and w
//   dq+  = dq + [(v - v+) dtau]
//
// If discs spin, the impulse P follows the sliding of the rims, t . w - [r_a w_a + r_b w_b], and [turns them]:
//
//   dw_k+  = dw_k - r_k dP_t / I_k,   dangle_k+ = dangle_k + [(w_k - w_k+) dtau].
//
// Brackets mark what may be missing. Source: the saltation matrix of a rigid impact with Newton's restitution and
// Coulomb's friction.

// An exact impact within an interval of time.
struct PairImpact {
  Vec2d normal;                                   // towards a
  double inverse_distance = 0;                    // 1/m, of the centres; 0 at planes
  double inverse_mass_a = 0, inverse_mass_b = 0;  // 1/kg; 0 if fixed
  Vec2d velocity_a, velocity_b;                   // m/s, before; zero if fixed
  Vec2d acceleration_a, acceleration_b;
  double restitution = 1, friction = 0;
  ContactMode mode = ContactMode::kFrictionless;
  double before = 0, after = 0;  // s, from the begin of the interval, and to its end
  double step = 0;               // s, the model's
  // Data of discs a and b in a scene that spins: m; 1/(kg m^2), 0 if it cannot spin; rad/s, before the impact.
  bool spins = false;
  std::array<double, 2> radius = {0, 0}, inverse_inertia = {0, 0}, spin = {0, 0};

  int num_moving() const { return (inverse_mass_a > 0) + (inverse_mass_b > 0); }
};

// The terms of the exact linearization that a model has.
struct ImpactTerms {
  enum class Normal { kTurning, kAtFixedTime, kFrozen };
  // kCone is a cone program whose solution is multiplied by 1 + restitution, its tangential part included.
  enum class Friction { kNone, kSlip, kStick, kCone };

  double position_shift = 1;             // factor of (v - v+) dtau
  bool shift_along_normal_only = false;  // what friction adds to that is left out
  bool acceleration = true;              // a dtau
  Normal normal = Normal::kTurning;      // th; th without w dtau; 0
  double restitution = 1;
  Friction law = Friction::kNone;
  double friction = 0;  // coefficient
  // 1/s; where positions are projected to contact and velocities are their differences, one over the step.
  double overlap_rate = 0;
  bool turns = true;  // friction turns discs that spin
  bool rims = true;   // and follows the sliding of their rims, not that of the centres
};

ImpactTerms ExactTerms(const PairImpact& impact);

// Returns d(state at the end of the interval) / d(state at its begin) over the moving discs, a before b: [p v] of each,
// and [angle w] in a scene that spins.
Eigen::MatrixXd LinearizeImpact(const PairImpact& impact, const ImpactTerms& terms);

// Returns the Frobenius norm of a difference of two linearizations, scaled by the StateScales() (step_map.h).
double ScaledNorm(const Eigen::MatrixXd& difference, const Eigen::VectorXd& scales);

// Returns the known fault, or faults, with which LinearizeImpact() comes close to `model`, in words; std::nullopt if
// none does. Positions and velocities are compared on the scale of `duration`.
std::optional<std::string> RecogniseFault(const PairImpact& impact, const Eigen::MatrixXd& model, double duration);

}  // namespace saltus
