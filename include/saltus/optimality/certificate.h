// Certificates of scenes: residuals of the conditions of the hybrid minimum principle at a control, and the sign of the
// second derivative of the loss. They are those of the problem that a scene is as a hybrid system
// (control/scene_problem.h, optimality/hybrid_certificate.h).
//
// The control is constant on intervals. In exact dynamics impacts divide the time into phases. The Hamiltonian is
// H = effort |u|^2 + sum lambda_q.v + lambda_v.(u/m + g), with + lambda_angle w for discs that spin. Costates lambda
// are carried backwards along the motion from the derivatives of the terminal terms, through impacts by lambda- = Dg^T
// lambda+ + nu grad psi, with multipliers nu of impacts, of hard terms and of active limits. The multipliers are those
// of the smallest residual of the other conditions:
//
//   stationarity    the force on an interval is the one within the bounds that is nearest to the mean of
//                   -lambda_v / (2 effort m): 2 effort m u + lambda_v is opposite to an outward normal of the bounds
//   Hamiltonian     its mean over each phase is the same, apart from its change by moving targets of running costs; at
//                   a free final time it is -weight. (For piecewise constant forces on a grid that moves with the
//                   impacts this condition is exact, and not the pointwise one; they differ by O(h^2).)
//   transversality  multipliers of bounds have their sign: the loss does not fall into the region that they allow
//
// On a fixed grid the condition of the Hamiltonian is replaced. With an impact on a node and a force that jumps there,
// the loss has a kink, with the gradients `early` and `late` as if the impact were just before and just after the node.
// Each belongs to a nu; at a minimum theta early + (1 - theta) late = 0 with theta in [0, 1] (Clarke).
//
// With design parameters, the derivatives of the loss by them vanish too, or point out of their bounds. Certify() then
// computes the curvature along controls and parameters together (a direction still lists the control alone);
// CurvatureAt() keeps parameters constant.
//
// First-order conditions compare a control with those of the same sequence of impacts only.
//
// Hu, Long, Zang, E, Han, "Solving optimal control of rigid-body dynamics with collisions using the hybrid minimum
// principle" (arXiv 2205.08622). Residuals are relative to the size of the terms that cancel.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/events.h"

namespace saltus {

// The largest relative residual with which a condition holds.
inline constexpr double kCertificateTolerance = 1e-6;

struct ImpactCertificate {
  double time = 0;              // s
  std::string a, b;             // as in Event
  double speed = 0;             // of approach along the normal, m/s
  double multiplier = 0;        // nu of the gap psi, 1/m (the loss has no unit)
  double jump = 0;              // residual of the costate jump; zero except in certificates of hmp
  double hamiltonian = 0;       // residual: the Hamiltonian after the impact less that before it
  bool on_node = false;         // the impact is at the boundary of two control intervals
  std::optional<double> theta;  // of a kink (see above); if the force jumps there
  bool concave = false;  // the force jumps there, and the loss falls as the impact leaves the node to either side
  bool jumps = false;    // the loss is not continuous as the impact leaves the node

  // Returns whether the loss falls, or jumps, as the impact leaves the node, to one side at least, with the intervals
  // as they are: the multiplier of a minimum is between those of the two one-sided gradients, of which the early one is
  // the smaller.
  bool LeavesNode() const { return jumps || (theta && (concave || *theta < 0 || *theta > 1)); }
};

// The multiplier of a hard term or of a limit: if its target, or the bounds that are active, move by a small d, the
// loss of the optimum decreases by multiplier . d.
struct ConstraintCertificate {
  std::string body;  // its name
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  // 1/m or s/m; 0 of a bound that is not active. That of an angle, angular velocity or limit of the speed is the first,
  // 1/rad, s/rad or s/m.
  Vec2d multiplier = Vec2d::Zero();
  std::optional<double> speed_limit = std::nullopt;  // m/s; of a limit of the speed, whose quantity is the velocity
  std::optional<double> time = std::nullopt;         // s; of a limit that always holds: when it is active
};

// The derivative of the loss by a design parameter of the scene.
struct ParameterCertificate {
  SceneParameter parameter;
  std::string name;       // scene_parameter.h
  double value = 0;       // in the parameter's unit
  double derivative = 0;  // of the loss, per unit of the value
  // The magnitude in natural units, relative to the largest costate or to 1, whichever is larger; 0 at a bound that the
  // loss would fall beyond.
  double residual = 0;
};

// The second derivative of the loss along controls d with integral |d|^2 dt = 1, relative to that of the effort alone:
// along eps d from a stationary control the loss changes by effort * curvature * eps^2. Active bounds and hard terms
// remain satisfied. A free final time varies too, with the last interval, and is measured by its own second derivative.
struct Curvature {
  enum class Kind {
    kMinimum,  // positive along all controls: a local minimum along the sequence of impacts
    kSaddle,   // negative along one control: no minimum
    kFlat,     // nearly zero along one control: undecided
  };
  Kind kind = Kind::kFlat;
  double smallest = 0;  // at most 1 if the control has more numbers than the motion depends on
  // A direction of that curvature, in the shape of the control, N; its largest component is positive. Its integral
  // |d|^2 dt is 1 without design parameters.
  std::vector<double> direction;
};

struct Certificate {
  enum class Verdict {
    kStationary,        // all conditions hold, each theta is in [0, 1], and no kink is concave
    kStationaryOnGrid,  // the gradient on the given intervals vanishes, and each theta is in [0, 1]
    kNotStationary,
    kAmbiguous,  // the order of simultaneous impacts changes the motion, so that first-order conditions do not apply
    kNotApplicable,
    kGlobal,  // all conditions hold, and a lower bound proves that no other control is better
  };
  Verdict verdict = Verdict::kNotApplicable;
  // The condition with the largest residual, or why the control is no minimum although all conditions hold, or why
  // there is nothing to certify.
  std::string reason;
  std::vector<Tie> ambiguous;  // if the verdict is kAmbiguous

  // The largest relative residual of each condition at the top of this file.
  double stationarity = 0;
  double costate_jump = 0;
  double hamiltonian = 0;
  double transversality = 0;
  std::vector<ImpactCertificate> impacts;
  // The hard terms, the waypoint constraints, the limits at the final time, and those that always hold, once for each
  // time at which they are active. Hard terms with a region follow the waypoints.
  std::vector<ConstraintCertificate> constraints;
  // Stationarity by the scene's design parameters. If no control is optimized, this and the derivatives by the
  // optimized initial velocities or positions, in `initial`, are the only conditions.
  std::vector<ParameterCertificate> parameters;
  std::optional<double> initial;
  std::optional<double> final_time;  // residual of the derivative of the loss by a free final time

  // The largest component of the gradient of the loss by the control on the given intervals, combined with the thetas,
  // relative to the size of its terms.
  std::optional<double> gradient;

  // The curvature at a stationary control (on the grid too). Absent without effort, with an impact at the final time,
  // and where active bounds with multipliers of zero leave its sign open.
  std::optional<Curvature> curvature;
  // Returns whether all conditions hold. A stationary control may be a saddle.
  bool IsStationary() const {
    return verdict == Verdict::kStationary || verdict == Verdict::kStationaryOnGrid || verdict == Verdict::kGlobal;
  }
  bool IsSaddle() const { return curvature && curvature->kind == Curvature::Kind::kSaddle; }

  // The largest component, 1/N, of the gradients of the loss by the control as if all impacts on nodes were early, as
  // if they were late, and of their combination with the thetas. Set with an impact on a node of a fixed grid only.
  std::optional<double> gradient_early, gradient_late, gradient_combined;

  // kBestOfSearched: no other sequence of impacts among those searched is better. kLocal: there was no search.
  enum class Scope { kLocal, kBestOfSearched };
  Scope scope = Scope::kLocal;
  int sequences_searched = 0;  // 0 if there was no search
};

// Return the names that JSON uses: "stationary", "stationary_on_grid", "not_stationary", "ambiguous", "not_applicable",
// "global"; "local", "best_of_searched"; "minimum", "saddle", "flat".
const char* VerdictToString(Certificate::Verdict verdict);
const char* ScopeToString(Certificate::Scope scope);
const char* CurvatureToString(Curvature::Kind kind);

// Returns verdict and curvature in a few words: "minimum", "saddle on the grid", "not stationary"; empty for
// kNotApplicable.
std::string VerdictInWords(const Certificate& certificate);
// Returns an explanation of the verdict in a sentence or two.
std::string MeaningOf(const Certificate& certificate);
// Returns the largest relative residual: that of `gradient` for kStationaryOnGrid, otherwise that of all conditions.
// Returns std::nullopt for kAmbiguous and kNotApplicable.
std::optional<double> ResidualOf(const Certificate& certificate);

// Certifies the control from the initial state on intervals of `durations`, s, or on equal intervals if there are none;
// shapes as in SimulateExactly() (exact_run.h). The certificate is kNotApplicable with the reason if
//   - the arguments or the scene are wrong, `stop` returned true, or memory ran out;
//   - neither a control nor a design parameter is optimized, or the motion has sustained or grazing contacts;
//   - a control is optimized and it has neither a cost of effort nor bounds, or the scene has segments, polygons, arcs,
//     pockets or a table, or a pair that must not touch is at its limit;
//   - no control is optimized and the objective has constraints or path costs.
Certificate Certify(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                    const std::vector<double>& durations = {}, const StopRequest& stop = nullptr);

// Converts a certificate from the units `from` to `to`. Residuals have no unit, and stay.
Certificate ToUnits(Certificate certificate, const Units& from, const Units& to);

// Returns the curvature at a control that need not be stationary, with the intervals as they are; impacts at their ends
// are held there. Returns std::nullopt if there is nothing to certify.
std::optional<Curvature> CurvatureAt(const Scene& scene, const std::vector<double>& initial,
                                     const std::vector<double>& control, const std::vector<double>& durations = {});

// Sets the verdict from the residuals and the thetas, and the reason from these and the curvature. The verdict does not
// depend on the curvature; it is kNotApplicable if a residual is not finite or the loss jumps at a node.
void Judge(Certificate* certificate);
// Sets the verdict to kAmbiguous if there are ties.
void JudgeTies(const std::vector<Tie>& ambiguous, Certificate* certificate);

}  // namespace saltus
