// Bodies under constant forces, with h the length of a step, m a mass, I a moment of inertia and g gravity:
//
//   q' = q + h v + h^2/2 (g + u/m),   v' = v + h (g + u/m),   angle' = angle + h w + h^2/2 r f/I,   w' = w + h r f/I
//
// where f is the force at the rim that a torque is stored as. A running term adds weight int |q(s) - r(t + s)|^2 ds,
// whose integrand is a polynomial of degree four between the times at which targets turn: three nodes of the quadrature
// of Gauss and Legendre give the integral exactly.
//
// Drag and springs without a length make the flow linear in the state (saltus/internal/linear_flow.h), and a prescribed
// motion is a cubic between its times. With springs that have a length, with forces and prescribed motions, and with
// running terms beside either, steps are those of the integration.
#include "saltus/control/scene_problem.h"

#include <ceres/jet.h>
#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <list>
#include <memory>
#include <mutex>
#include <numeric>
#include <set>
#include <type_traits>
#include <utility>
#include <vector>

#include "control/control_bounds.h"
#include "control/phase_costs.h"
#include "control/scene_constraints.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/internal/linear_flow.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/simulator.h"
#include "scene/path_motion.h"
#include "simulate/flight.h"
#include "simulate/impact.h"
#include "simulate/state_forces.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

constexpr int kOfPair = 10;  // positions, velocities and angular velocities of two bodies
constexpr int kOfLaw = 6;    // restitution, friction, and the inverse masses and moments of inertia of two bodies

// Where the numbers of a scene's bodies are in the state and in the control.
class SceneLayout {
 public:
  explicit SceneLayout(const Scene& scene) : scene_(scene), pushed_(scene.bodies.size(), -1), torque_index_(pushed_) {
    for (int c = 0; c < scene.num_controlled(); ++c) pushed_[scene.control.bodies[c]] = 2 * c;
    for (int t = 0; t < scene.num_torques(); ++t) {
      torque_index_[scene.control.torque_bodies[t]] = static_cast<int>(scene.TorqueIndex(0, t));
    }
  }

  int num_bodies() const { return scene_.num_bodies(); }
  int PositionOf(int body) const { return 4 * body; }
  int VelocityOf(int body) const { return 4 * body + 2; }
  // Precondition: a body of the scene spins.
  int AngleOf(int body) const { return 4 * num_bodies() + kSpin * body; }
  int IndexOf(int body, Quantity quantity) const {
    switch (quantity) {
      case Quantity::kPosition:
        return PositionOf(body);
      case Quantity::kVelocity:
        return VelocityOf(body);
      case Quantity::kAngle:
        return AngleOf(body);
      case Quantity::kAngularVelocity:
        return AngleOf(body) + 1;
    }
    return -1;
  }
  int running() const { return (4 + (scene_.Spins() ? kSpin : 0)) * num_bodies(); }
  int size() const { return running() + !scene_.objective.running.empty(); }
  // The first number of a body's force in a row of the control, and the number of its torque; -1: it has none.
  int ForceOn(int body) const { return pushed_[body]; }
  int TorqueOn(int body) const { return torque_index_[body]; }

 private:
  const Scene& scene_;
  std::vector<int> pushed_, torque_index_;
};

// Whether flights of a scene have no closed form, with derivatives by these parameters.
bool Integrates(const Scene& scene, SceneParameters parameters) {
  if (parameters == SceneParameters::kAll) return true;
  const bool running = !scene.objective.running.empty(), moves = scene.HasPaths();
  if (scene.forces.empty()) return running && moves;
  return running || moves || !AreLinear(scene.forces) || SceneLayout(scene).size() > LinearFlow::kMostStates;
}

// Returns the times of waypoints, rising, each once. Steps that are integrated end where targets and paths turn, too,
// but at the final time, where the motion ends.
std::vector<double> WaypointTimes(const Scene& scene, bool integrates) {
  std::set<double> times;
  for (const ViaTerm& term : scene.objective.via) times.insert(term.time);
  constexpr double kBeforeEnd = 1 - 1e-9;  // the sum of the intervals is the duration within rounding
  const double end = scene.objective.duration ? std::numeric_limits<double>::infinity() : kBeforeEnd * scene.duration;
  const auto add = [&](const std::vector<double>& turns) {
    for (const double turn : turns) {
      if (turn > 0 && turn < end) times.insert(turn);
    }
  };
  if (!integrates) return {times.begin(), times.end()};
  for (const RunningTerm& term : scene.objective.running) add(term.times);
  for (const Body& body : scene.bodies) add(body.path ? body.path->times : std::vector<double>());
  for (const Plane& plane : scene.planes) add(plane.motion ? plane.motion->times : std::vector<double>());
  return {times.begin(), times.end()};
}

std::string WaypointName(std::size_t index) { return "waypoint " + std::to_string(index + 1); }

// Mode k has passed k waypoints. The guards of a mode are those of the pairs, then that of the next waypoint. Design
// parameters are the parameters of the system, and derivatives by them differences of fourth order of the functions.
class SceneSystem final : public HybridFunctions {
  struct Constants;

 public:
  // Discs fly as in a step of `flight`, which must outlive this object and fly over any length; if it is null, exactly.
  SceneSystem(const Scene& scene, SceneParameters parameters, const Simulator* flight,
              std::optional<ContactMode> regime)
      : HybridFunctions(LayoutOf(scene, parameters)),
        scene_(SelectParameters(scene, parameters)),
        flight_(flight),
        regime_(regime),
        at_(scene_),
        parameters_(scene, parameters),
        integrates_(Integrates(scene, parameters)),
        waypoints_(WaypointTimes(scene, integrates_)),
        placed_(scene_.bodies.size(), false) {
    for (const DesignParameter& design : scene_.design) {
      using enum SceneParameter::Kind;
      const SceneParameter& parameter = design.parameter;
      flight_is_designed_ = flight_is_designed_ || parameter.kind == kMass || parameter.kind == kGravity ||
                            parameter.kind == kDrag || (parameter.kind == kRadius && scene_.Spins());
      if (parameter.kind == kPosition) placed_[parameter.body] = true;
    }
    for (const Candidate& contact : AllPairs(scene_)) {
      const bool must_not_touch = std::ranges::any_of(scene_.no_contact, [&](const NoContact& apart) {
        const bool same = apart.a == contact.a && apart.b == contact.b;
        const bool turned = !contact.plane && apart.a == contact.b && apart.b == contact.a;
        return apart.plane == contact.plane && (same || turned);
      });
      const int a = scene_.bodies[contact.a].material + 1;
      const int b = (contact.plane ? scene_.planes[contact.b].material : scene_.bodies[contact.b].material) + 1;
      pairs_.push_back({contact, MaterialPairIndex(a, b), must_not_touch});
    }
    const auto motion_of = [](const std::optional<PrescribedMotion>& path) {
      return path ? std::optional(PathMotion(*path)) : std::nullopt;
    };
    for (const Body& body : scene_.bodies) paths_.push_back(motion_of(body.path));
    for (const Plane& plane : scene_.planes) motions_.push_back(motion_of(plane.motion));
    given_ = ConstantsOf(scene_);
    const bool flies = NonBallisticForces(scene_).empty() && !parameters_.exist && scene_.objective.running.empty();
    arcs_ = flies && scene_.design.empty();
    if (flies && (scene_.num_bodies() > 1 || flight_ != nullptr)) AddParts();
  }

  void Flow(const ModePoint& from, double* xdot) const override {
    CallWithConstants(from.p, [&](const Constants& of) { Flow(of, from, xdot); });
  }
  void Flow(const Constants& of, const ModePoint& from, double* xdot) const {
    std::fill_n(xdot, at_.size(), 0.0);
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (paths_[i]) {
        const PathMotion::Point point = paths_[i]->SampleAt(from.t);
        std::copy_n(point.velocity.data(), 2, xdot + at_.PositionOf(i));
        std::copy_n(point.acceleration.data(), 2, xdot + at_.VelocityOf(i));
      }
      if (scene_.bodies[i].fixed) continue;
      const Vec2d a = AccelerationOf(of.scene, i, from.u);
      for (int j = 0; j < 2; ++j) {
        xdot[at_.PositionOf(i) + j] = from.x[at_.VelocityOf(i) + j];
        xdot[at_.VelocityOf(i) + j] = a[j];
      }
      if (!scene_.Spins()) continue;
      xdot[at_.AngleOf(i)] = from.x[at_.AngleOf(i) + 1];
      xdot[at_.AngleOf(i) + 1] = TurningOf(of.scene, i, from.u);
    }
    ForEachForce(of.scene, from.x, [&](int row, double inverse_mass, const ForceAtState& force) {
      for (int j = 0; j < 2; ++j) xdot[row + j] += inverse_mass * force.value[j];
    });
    for (const RunningTerm& term : scene_.objective.running) {
      xdot[at_.running()] += term.weight * RunningResidual(term, from.x, from.t).squaredNorm();
    }
  }

  void FlowJacobian(const ModePoint& from, double* xdot, double* jacobian) const override {
    CallWithConstants(from.p, [&](const Constants& of) { FlowJacobian(of, from, xdot, jacobian); });
    if (!flight_is_designed_ || !from.by_parameters) return;
    AddDifferences(from.p, at_.size(), at_.size() + 1, Columns(), jacobian, [&](const Constants& of, double* out) {
      Flow(of, from, out);
    });
  }
  void FlowJacobian(const Constants& of, const ModePoint& from, double* xdot, double* jacobian) const {
    Flow(of, from, xdot);
    const int n = at_.size(), columns = Columns();
    std::fill_n(jacobian, n * columns, 0.0);
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (paths_[i]) {
        const PathMotion::Point point = paths_[i]->SampleAt(from.t);
        for (int j = 0; j < 2; ++j) {
          jacobian[(at_.PositionOf(i) + j) * columns + n] = point.acceleration[j];
          jacobian[(at_.VelocityOf(i) + j) * columns + n] = point.jerk[j];
        }
      }
      if (scene_.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) {
        jacobian[(at_.PositionOf(i) + j) * columns + at_.VelocityOf(i) + j] = 1;
        if (at_.ForceOn(i) < 0) continue;
        jacobian[(at_.VelocityOf(i) + j) * columns + FirstControl() + at_.ForceOn(i) + j] =
            InverseMass(of.scene.bodies[i]);
      }
      if (!scene_.Spins()) continue;
      jacobian[at_.AngleOf(i) * columns + at_.AngleOf(i) + 1] = 1;
      if (at_.TorqueOn(i) >= 0)
        jacobian[(at_.AngleOf(i) + 1) * columns + FirstControl() + at_.TorqueOn(i)] = RateOfTurn(of.scene, i);
    }
    ForEachForce(of.scene, from.x, [&](int row, double inverse_mass, const ForceAtState& force) {
      for (int j = 0; j < 2; ++j) {
        for (int i = 0; i < 4; ++i) {
          const double by = inverse_mass * force.by(j, i);
          jacobian[(row + j) * columns + at_.PositionOf(force.body) + i] += by;
          if (force.other >= 0) jacobian[(row + j) * columns + at_.PositionOf(force.other) + i] -= by;
        }
      }
    });
    for (int i = 0; i < at_.num_bodies() && parameters_.exist; ++i) {
      const double inverse_mass = InverseMass(scene_.bodies[i]);
      if (inverse_mass == 0) continue;
      for (int j = 0; j < 2; ++j) {
        const int v = at_.VelocityOf(i) + j;
        double* row = jacobian + v * columns + n + 1;
        row[parameters_.Gravity() + j] = 1;
        row[parameters_.Mass(i)] = -inverse_mass * (xdot[v] - scene_.gravity[j]);
        row[parameters_.Drag(i)] = -inverse_mass * from.x[v];
      }
      if (!scene_.bodies[i].Spins()) continue;
      const int spin = at_.AngleOf(i) + 1;
      jacobian[spin * columns + n + 1 + parameters_.Inertia(i)] = -xdot[spin] / scene_.bodies[i].MomentOfInertia();
    }
    for (const RunningTerm& term : scene_.objective.running) {
      double* row = jacobian + at_.running() * columns;
      const Vec2d by = 2 * term.weight * RunningResidual(term, from.x, from.t), rate = RateOfTarget(term, from.t);
      for (int j = 0; j < 2; ++j) row[at_.IndexOf(term.body, term.quantity) + j] += by[j];
      row[n] -= by.dot(rate);
    }
  }

  bool IsLinear(int /*mode*/) const override {
    return scene_.objective.running.empty() && AreLinear(scene_.forces) && !scene_.HasPaths() && !flight_is_designed_;
  }

  void Step(const FlowStep& step, const double* slope, double* scratch, double* after,
            double* slope_after) const override {
    if (!Fly(step, after, nullptr)) return HybridFunctions::Step(step, slope, scratch, after, slope_after);
    Flow({step.mode, step.t + step.h, after, step.u, step.p}, slope_after);
  }

  bool Fly(const FlowStep& step, double* after, double* jacobian) const override {
    if (integrates_) return false;
    CallWithConstants(step.p, [&](const Constants& of) { Fly(of, step, after, jacobian); });
    if (jacobian != nullptr && flight_is_designed_ && step.by_parameters) {
      AddDifferences(step.p, at_.size(), at_.size() + 1, Columns(), jacobian, [&](const Constants& of, double* out) {
        Fly(of, step, out, nullptr);
      });
    }
    return true;
  }
  void Fly(const Constants& of, const FlowStep& step, double* after, double* jacobian) const {
    const int n = at_.size(), columns = Columns();
    const double h = step.h;
    CHECK(flight_ == nullptr) << "the state of a contact model moves by its parts";
    if (of.linear) {
      std::array<double, LinearFlow::kMostStates> slope;
      Flow(of, step, slope.data());
      of.linear->Step(h, step.x, slope.data(), after);
      if (jacobian != nullptr) of.linear->Jacobian(h, jacobian);
      return;
    }
    std::copy_n(step.x, n, after);
    if (jacobian != nullptr) {
      std::fill_n(jacobian, n * columns, 0.0);
      for (int i = 0; i < n; ++i) jacobian[i * columns + i] = 1;
    }
    // Moves a coordinate and its velocity under an acceleration, of which `by` is the derivative by a number of u.
    const auto move = [&](int q, int v, double acceleration, int control, double by) {
      after[q] += h * (step.x[v] + 0.5 * h * acceleration);
      after[v] += h * acceleration;
      if (jacobian == nullptr) return;
      jacobian[q * columns + v] = h;
      if (control < 0) return;
      jacobian[q * columns + FirstControl() + control] = 0.5 * h * h * by;
      jacobian[v * columns + FirstControl() + control] = h * by;
    };
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (paths_[i]) {
        const PathMotion::Point begin = paths_[i]->SampleAt(step.t), end = paths_[i]->SampleAt(step.t + h);
        for (int j = 0; j < 2; ++j) {
          const int q = at_.PositionOf(i) + j, v = at_.VelocityOf(i) + j;
          after[q] += end.position[j] - begin.position[j];
          after[v] += end.velocity[j] - begin.velocity[j];
          if (jacobian == nullptr) continue;
          jacobian[q * columns + n] = end.velocity[j] - begin.velocity[j];
          jacobian[v * columns + n] = end.acceleration[j] - begin.acceleration[j];
        }
      }
      if (scene_.bodies[i].fixed) continue;
      const Vec2d a = AccelerationOf(of.scene, i, step.u);
      const int force = at_.ForceOn(i);
      for (int j = 0; j < 2; ++j) {
        move(at_.PositionOf(i) + j,
             at_.VelocityOf(i) + j,
             a[j],
             force < 0 ? -1 : force + j,
             InverseMass(of.scene.bodies[i]));
      }
      if (!scene_.Spins()) continue;
      move(
          at_.AngleOf(i), at_.AngleOf(i) + 1, TurningOf(of.scene, i, step.u), at_.TorqueOn(i), RateOfTurn(of.scene, i));
    }
    for (const RunningTerm& term : scene_.objective.running) AddRunning(of.scene, term, step, after, jacobian);
  }

  // Discs fly by themselves, and turn by themselves; a running term integrates what discs do.
  std::vector<StatePart> Parts(int mode) const override {
    return parts_.empty() ? HybridFunctions::Parts(mode) : parts_;
  }
  std::vector<int> PartsOf(int mode, int guard) const override {
    if (parts_.empty()) return HybridFunctions::PartsOf(mode, guard);
    if (IsWaypoint(guard)) return {};
    const Candidate& c = pairs_[guard].contact;
    const int turning = scene_.Spins() ? at_.num_bodies() : 0;
    std::vector<int> parts = {c.a};
    if (!c.plane) parts.push_back(c.b);
    for (int side = 0; side < (c.plane ? 1 : 2); ++side) {
      if (given_.laws[guard].inverse_inertia[side] > 0) parts.push_back(turning + parts[side]);
    }
    return parts;
  }
  void MovePart(int part, const FlowStep& step, double* after, double* jacobian) const override {
    CallWithConstants(step.p, [&](const Constants& of) { MovePart(of, part, step, after, jacobian); });
    if (jacobian == nullptr || !flight_is_designed_ || !step.by_parameters) return;
    const int n = static_cast<int>(parts_[part].states.size()), m = static_cast<int>(parts_[part].controls.size());
    AddDifferences(
        step.p, n, n + 1, n + 1 + layout().num_parameters + m + 1, jacobian, [&](const Constants& of, double* out) {
          MovePart(of, part, step, out, nullptr);
        });
  }
  void MovePart(const Constants& of, int part, const FlowStep& step, double* after, double* jacobian) const {
    const bool turns = part >= at_.num_bodies();
    const int body = part % at_.num_bodies(), m = static_cast<int>(parts_[part].controls.size());
    const int dimension = turns ? 1 : 2, n = 2 * dimension, control = n + 1 + layout().num_parameters;
    const int columns = control + m + 1;
    const double h = step.h, by = turns ? RateOfTurn(of.scene, body) : InverseMass(of.scene.bodies[body]);
    if (jacobian != nullptr) std::fill_n(jacobian, n * columns, 0.0);
    const std::optional<VariableFreeFlight> over = flight_ != nullptr ? flight_->FreeFlightOfLength(h) : std::nullopt;
    if (flight_ != nullptr && !over) std::fill_n(after, n, NAN);
    for (int j = 0; j < dimension; ++j) {
      const int v = dimension + j;
      const double acceleration = (turns ? 0 : of.scene.gravity[j]) + (m > 0 ? by * step.u[j] : 0);
      if (over) {
        const auto fly = [&](const StepLinearization::FreeFlight& map, double* q, double* rate) {
          *q = map.pp * step.x[j] + map.pv * step.x[v] + map.pa * acceleration;
          *rate = map.vp * step.x[j] + map.vv * step.x[v] + map.va * acceleration;
        };
        const StepLinearization::FreeFlight& map = turns ? over->turn : over->flight;
        fly(map, &after[j], &after[v]);
        if (jacobian == nullptr) continue;
        double *of_q = jacobian + j * columns, *of_v = jacobian + v * columns;
        of_q[j] = map.pp;
        of_q[v] = map.pv;
        of_v[j] = map.vp;
        of_v[v] = map.vv;
        fly(turns ? over->turn_by_time : over->by_time, &of_q[columns - 1], &of_v[columns - 1]);
        if (m > 0) of_q[control + j] = map.pa * by;
        if (m > 0) of_v[control + j] = map.va * by;
      }
      if (flight_ != nullptr) continue;
      after[j] = step.x[j] + h * (step.x[v] + 0.5 * h * acceleration);
      after[v] = step.x[v] + h * acceleration;
      if (jacobian == nullptr) continue;
      double *of_q = jacobian + j * columns, *of_v = jacobian + v * columns;
      of_q[j] = of_v[v] = 1;
      of_q[v] = h;
      of_q[columns - 1] = after[v];
      of_v[columns - 1] = acceleration;
      if (m == 0) continue;
      of_q[control + j] = 0.5 * h * h * by;
      of_v[control + j] = h * by;
    }
  }

  double Guard(const ModePoint& from, int guard) const override {
    if (IsWaypoint(guard)) return waypoints_[from.mode] - from.t;
    return CallWithConstants(from.p, [&](const Constants& of) { return GapOf(of, guard, from); });
  }
  double GuardRate(const ModePoint& from, int guard, const double* xdot, double* rate) const override {
    if (IsWaypoint(guard)) {
      *rate = -1;
      return Guard(from, guard);
    }
    const Candidate& c = pairs_[guard].contact;
    return CallWithConstants(from.p, [&](const Constants& of) {
      const Separation<double> apart = SeparationAt(of, guard, from);
      const Vec2d of_b = c.plane ? WallAt(c, from.t).velocity : TwoAt(xdot, at_.PositionOf(c.b));
      *rate = Dot(apart.normal, Vec2d(TwoAt(xdot, at_.PositionOf(c.a)) - of_b));
      return apart.distance - of.laws[guard].contact_distance;
    });
  }
  double GuardGradient(const ModePoint& from, int guard, double* gradient) const override {
    std::fill_n(gradient, Columns(), 0.0);
    if (IsWaypoint(guard)) {
      gradient[at_.size()] = -1;
      return Guard(from, guard);
    }
    if (from.by_parameters) {
      AddDifferences(from.p, 1, at_.size() + 1, Columns(), gradient, [&](const Constants& of, double* out) {
        *out = GapOf(of, guard, from);
      });
    }
    const Candidate& c = pairs_[guard].contact;
    return CallWithConstants(from.p, [&](const Constants& of) {
      const Separation<double> apart = SeparationAt(of, guard, from);
      if (c.plane) gradient[at_.size()] = -Dot(apart.normal, WallAt(c, from.t).velocity);
      for (int j = 0; j < 2; ++j) {
        if (!placed_[c.a]) gradient[at_.PositionOf(c.a) + j] = apart.normal[j];
        if (!c.plane && !placed_[c.b]) gradient[at_.PositionOf(c.b) + j] = -apart.normal[j];
      }
      return apart.distance - of.laws[guard].contact_distance;
    });
  }

  // In flight under constant forces, where the two come nearest.
  bool LeastGuard(const FlowStep& step, int guard, double* value, double* gradient) const override {
    if (!arcs_ || IsWaypoint(guard)) return HybridFunctions::LeastGuard(step, guard, value, gradient);
    const Candidate& c = pairs_[guard].contact;
    const int sides = c.plane ? 1 : 2;
    const Separation<double> begin = SeparationAt(given_, guard, step);
    // Position, velocity and acceleration of a relative to b; a plane rests at the point next to a.
    Vec2d p = begin.distance * begin.normal, v = TwoAt(step.x, at_.VelocityOf(c.a)), a = Vec2d::Zero();
    if (!c.plane) v -= TwoAt(step.x, at_.VelocityOf(c.b));
    for (int side = 0; side < sides; ++side) {
      const int body = side == 0 ? c.a : c.b;
      if (!scene_.bodies[body].fixed) a += (side == 0 ? 1 : -1) * AccelerationOf(scene_, body, step.u);
    }
    const double part = NearestPart(p, v, a, c.plane ? &begin.normal : nullptr, step.h), s = part * step.h;
    const Vec2d there = p + s * (v + 0.5 * s * a);
    const double distance = c.plane ? Dot(begin.normal, there) : there.norm();
    *value = distance - given_.laws[guard].contact_distance;
    if (!std::isfinite(*value)) return false;
    if (gradient == nullptr) return true;
    const Vec2d normal = c.plane ? begin.normal : Vec2d(there / distance);
    std::fill_n(gradient, Columns() + 1, 0.0);
    for (int side = 0; side < sides; ++side) {
      const int body = side == 0 ? c.a : c.b;
      for (int j = 0; j < 2; ++j) {
        const double by = (side == 0 ? 1 : -1) * normal[j];
        gradient[at_.PositionOf(body) + j] = by;
        if (scene_.bodies[body].fixed) continue;
        gradient[at_.VelocityOf(body) + j] = s * by;
        if (at_.ForceOn(body) < 0) continue;
        gradient[FirstControl() + at_.ForceOn(body) + j] = 0.5 * s * s * InverseMass(scene_.bodies[body]) * by;
      }
    }
    // The time of the nearest point has no derivative to first order; the end of the step moves with its length.
    gradient[Columns()] = part * Dot(normal, Vec2d(v + s * a));
    return true;
  }

  // That the two do not separate and, in a regime, that they slip or stick.
  int num_event_rows(int /*mode*/, int guard) const override { return IsWaypoint(guard) ? 0 : regime_ ? 2 : 1; }
  void EventRows(const ModePoint& from, int guard, double* rows, double* jacobian) const override {
    if (IsWaypoint(guard)) return;
    using Jet = ceres::Jet<double, kOfPair>;
    const int n = at_.size(), columns = FirstControl(), count = num_event_rows(from.mode, guard);
    const std::array<int, kOfPair> places = PlacesOf(pairs_[guard].contact);
    const PathMotion::Point wall = WallAt(pairs_[guard].contact, from.t);
    const auto evaluate = [&](const Constants& of, const auto& x, auto* out) {
      const auto impact = ImpactOf(of, guard, x, LawOf(of.laws[guard]), wall.velocity);
      out[0] = impact.speed;
      if (!regime_) return;
      const auto most = of.laws[guard].MaxStickRatio() * impact.speed;
      const auto slip = impact.sliding * impact.sliding - most * most;
      out[1] = *regime_ == ContactMode::kSlip ? -slip : slip;
    };
    std::array<Jet, kOfPair> x;
    for (int i = 0; i < kOfPair; ++i) x[i] = Jet(places[i] < 0 ? 0.0 : from.x[places[i]], i);
    std::array<Jet, 2> out;
    CallWithConstants(from.p, [&](const Constants& of) { evaluate(of, x, out.data()); });
    for (int row = 0; row < count; ++row) rows[row] = out[row].a;
    if (jacobian == nullptr) return;
    std::fill_n(jacobian, count * columns, 0.0);
    for (int row = 0; row < count; ++row) {
      for (int i = 0; i < kOfPair; ++i) {
        if (places[i] >= 0) jacobian[row * columns + places[i]] = out[row].v[i];
      }
      jacobian[row * columns + n] = -Dot(Vec2d(out[row].v[4], out[row].v[5]), wall.acceleration);
    }
    if (!from.by_parameters) return;
    std::array<double, kOfPair> values;
    for (int i = 0; i < kOfPair; ++i) values[i] = x[i].a;
    AddDifferences(
        from.p, count, n + 1, columns, jacobian, [&](const Constants& of, double* at) { evaluate(of, values, at); });
  }
  std::shared_ptr<const HybridFunctions> RegimeOf(int regime) const override {
    return std::make_shared<SceneSystem>(scene_, SceneParameters::kDesign, flight_, static_cast<ContactMode>(regime));
  }

  int Reset(const ModePoint& from, int guard, double* x_plus) const override {
    if (!IsWaypoint(guard) && pairs_[guard].must_not_touch) return -1;
    CallWithConstants(from.p, [&](const Constants& of) { Reset(of, from, guard, x_plus); });
    return IsWaypoint(guard) ? from.mode + 1 : from.mode;
  }
  void Reset(const Constants& of, const ModePoint& from, int guard, double* x_plus) const {
    std::copy_n(from.x, at_.size(), x_plus);
    if (IsWaypoint(guard)) return;
    const std::array<int, kOfPair> places = PlacesOf(pairs_[guard].contact);
    std::array<double, kOfPair> x{};
    for (int i = 0; i < kOfPair; ++i) x[i] = places[i] < 0 ? 0.0 : from.x[places[i]];
    const Vec2d of_wall = WallAt(pairs_[guard].contact, from.t).velocity;
    const std::array<double, kOfPair> after = Strike(of, guard, x, LawOf(of.laws[guard]), of_wall);
    for (int i = 0; i < kOfPair; ++i) {
      if (places[i] >= 0) x_plus[places[i]] = after[i];
    }
  }
  int ResetJacobian(const ModePoint& from, int guard, double* x_plus, double* jacobian) const override {
    const int n = at_.size(), columns = FirstControl(), next = Reset(from, guard, x_plus);
    std::fill_n(jacobian, n * columns, 0.0);
    for (int i = 0; i < n; ++i) jacobian[i * columns + i] = 1;
    if (IsWaypoint(guard) || next < 0) return next;
    CallWithConstants(from.p, [&](const Constants& of) {
      if (parameters_.exist) {
        SetByPair<kOfPair + kOfLaw>(of, from, guard, jacobian);
      } else {
        SetByPair<kOfPair>(of, from, guard, jacobian);
      }
    });
    if (from.by_parameters) {
      AddDifferences(
          from.p, n, n + 1, columns, jacobian, [&](const Constants& of, double* out) { Reset(of, from, guard, out); });
    }
    return next;
  }
  std::string ReasonNoMode(const ModePoint& /*from*/, int guard) const override {
    return guard >= 0 && pairs_[guard].must_not_touch
               ? ContactSequenceToString(scene_, {pairs_[guard].contact}) + " touch, which must not (no_contact)"
               : "";
  }

 private:
  struct Pair {
    Candidate contact;
    int material;  // MaterialPairIndex()
    bool must_not_touch;
  };
  // The scene with values of its design parameters, and what follows from these.
  struct Constants {
    std::vector<double> values;
    Scene scene;
    std::vector<ImpactConstants> laws;  // of the pairs
    std::vector<HalfPlane<double>> planes;
    std::optional<LinearFlow> linear;  // of scenes with forces, if their flow is linear
  };
  Constants ConstantsOf(Scene scene) const {
    Constants constants;
    for (const Pair& pair : pairs_) constants.laws.push_back(MakeImpactConstants(scene, pair.contact));
    for (const Plane& plane : scene.planes) constants.planes.push_back(MakeHalfPlane(plane));
    constants.scene = std::move(scene);
    if (!constants.scene.forces.empty() && !integrates_) constants.linear.emplace(MakeLinear(constants));
    return constants;
  }
  // Returns function(constants) of the parameters p. The last constants are kept, as many as a derivative takes.
  template <typename Function>
  std::invoke_result_t<Function, const Constants&> CallWithConstants(const double* p, const Function& function) const {
    if (scene_.design.empty()) return function(given_);
    std::shared_ptr<const Constants> constants;
    {
      const std::lock_guard lock(mutex_);
      const auto found = std::ranges::find_if(
          known_, [&](const auto& known) { return std::equal(known->values.begin(), known->values.end(), p); });
      if (found != known_.end()) constants = *found;
    }
    if (constants == nullptr) {
      std::vector<double> values(p, p + scene_.design.size());
      for (std::size_t k = 0; k < values.size(); ++k) {
        using enum SceneParameter::Kind;
        const SceneParameter::Kind kind = scene_.design[k].parameter.kind;
        if ((kind == kMass || kind == kRadius) && !(values[k] > 0)) values[k] = NAN;  // no such disc has a motion
      }
      Constants made = ConstantsOf(WithDesign(scene_, values));
      made.values.assign(p, p + scene_.design.size());
      constants = std::make_shared<const Constants>(std::move(made));
      const std::lock_guard lock(mutex_);
      known_.push_front(constants);
      if (known_.size() > 2 * (1 + 4 * scene_.design.size())) known_.pop_back();
    }
    return function(*constants);
  }
  // Sets the columns by p, from `first` on, of a derivative of `rows` numbers, which function(constants, out) computes,
  // beyond the bounds of parameters too, where solvers step.
  template <typename Function>
  void AddDifferences(const double* p, int rows, int first, int columns, double* jacobian,
                      const Function& function) const {
    constexpr double kWidth = 3e-4;
    constexpr std::array<std::pair<int, double>, 4> kRule = {
        {{-2, 1. / 12}, {-1, -8. / 12}, {1, 8. / 12}, {2, -1. / 12}}};
    std::vector<double> values(p, p + scene_.design.size()), out(rows), sum(rows);
    for (std::size_t k = 0; k < values.size(); ++k) {
      const bool is_mass = scene_.design[k].parameter.kind == SceneParameter::Kind::kMass;
      const double width = is_mass ? kWidth * values[k] : kWidth;
      std::ranges::fill(sum, 0.0);
      for (const auto& [node, weight] : kRule) {
        values[k] = p[k] + node * width;
        CallWithConstants(values.data(), [&](const Constants& of) { function(of, out.data()); });
        for (int row = 0; row < rows; ++row) sum[row] += weight / width * out[row];
      }
      values[k] = p[k];
      for (int row = 0; row < rows; ++row) jacobian[row * columns + first + static_cast<int>(k)] = sum[row];
    }
  }

  static Scene SelectParameters(Scene scene, SceneParameters parameters) {
    if (parameters != SceneParameters::kDesign) scene.design.clear();
    return scene;
  }
  static HybridLayout LayoutOf(const Scene& scene, SceneParameters parameters) {
    const SceneLayout at(scene);
    const std::vector<double> waypoints = WaypointTimes(scene, Integrates(scene, parameters));
    HybridLayout layout{.num_controls = scene.control_width(),
                        .num_parameters = ParameterPlaces(scene, parameters).size()};
    if (parameters == SceneParameters::kDesign) {
      layout.num_parameters = static_cast<int>(scene.design.size());
      for (const DesignParameter& design : scene.design) {
        layout.parameter_names.push_back(NameOf(design.parameter, scene));
      }
    }
    std::vector<std::string> states;
    for (const Body& body : scene.bodies) {
      for (const char* of : {".x", ".y", ".vx", ".vy"}) states.push_back(body.name + of);
    }
    for (const Body& body : scene.bodies) {
      if (scene.Spins()) states.insert(states.end(), {body.name + ".angle", body.name + ".spin"});
    }
    if (at.size() > at.running()) states.emplace_back("running");
    std::vector<std::string> guards;
    for (const Candidate& contact : AllPairs(scene)) guards.push_back(ContactSequenceToString(scene, {contact}));
    for (std::size_t mode = 0; mode <= waypoints.size(); ++mode) {
      const bool has_next = mode < waypoints.size();
      layout.state_sizes.push_back(at.size());
      layout.num_guards.push_back(static_cast<int>(guards.size()) + has_next);
      layout.mode_names.push_back(mode == 0 ? "flight" : "after " + WaypointName(mode - 1));
      layout.state_names.insert(layout.state_names.end(), states.begin(), states.end());
      layout.guard_names.insert(layout.guard_names.end(), guards.begin(), guards.end());
      if (has_next) layout.guard_names.push_back(WaypointName(mode));
    }
    for (const int body : scene.control.bodies) {
      for (const char* of : {".fx", ".fy"}) layout.control_names.push_back(scene.bodies[body].name + of);
    }
    for (const int body : scene.control.torque_bodies)
      layout.control_names.push_back(scene.bodies[body].name + ".turn");
    return layout;
  }

  // Adds the parts of flight of all bodies, and then those of their rotations.
  void AddParts() {
    using enum StatePart::Motion;
    for (const bool turns : {false, true}) {
      for (int i = 0; i < at_.num_bodies() && (!turns || scene_.Spins()); ++i) {
        StatePart part;
        const int first = turns ? at_.AngleOf(i) : at_.PositionOf(i), size = turns ? kSpin : 4;
        const int control = turns ? at_.TorqueOn(i) : at_.ForceOn(i);
        for (int k = 0; k < size; ++k) part.states.push_back(first + k);
        for (int k = 0; k < size / 2 && control >= 0; ++k) part.controls.push_back(control + k);
        // A step of a contact model has one length, that of the steps of the control.
        const bool steps = control >= 0 || flight_ != nullptr;
        part.motion = scene_.bodies[i].fixed ? kRests : steps ? kSteps : kCoasts;
        part.always_moves_by_part = true;
        parts_.push_back(std::move(part));
      }
    }
  }

  int FirstControl() const { return at_.size() + 1 + layout().num_parameters; }
  int Columns() const { return FirstControl() + scene_.control_width(); }
  bool IsWaypoint(int guard) const { return guard == static_cast<int>(pairs_.size()); }
  static Vec2d TwoAt(const double* x, int place) { return {x[place], x[place + 1]}; }
  Vec2d AccelerationOf(const Scene& scene, int body, const double* u) const {
    const int force = at_.ForceOn(body);
    return force < 0 ? scene.gravity : Vec2d(scene.gravity + InverseMass(scene.bodies[body]) * TwoAt(u, force));
  }
  static double RateOfTurn(const Scene& scene, int body) {
    return scene.bodies[body].radius / scene.bodies[body].MomentOfInertia();
  }
  double TurningOf(const Scene& scene, int body, const double* u) const {
    return at_.TorqueOn(body) < 0 ? 0.0 : RateOfTurn(scene, body) * u[at_.TorqueOn(body)];
  }
  // Calls add(row, inverse mass, force) for each disc that a force accelerates, with the row of its velocity; the
  // forces and derivatives of the other disc have the opposite inverse mass.
  template <typename Add>
  void ForEachForce(const Scene& scene, const double* x, const Add& add) const {
    for (const StateForce& one : scene.forces) {
      const ForceAtState force = ForceAt(one, {x, static_cast<std::size_t>(4 * at_.num_bodies())}, 4);
      add(at_.VelocityOf(force.body), InverseMass(scene.bodies[force.body]), force);
      if (force.other >= 0) add(at_.VelocityOf(force.other), -InverseMass(scene.bodies[force.other]), force);
    }
  }
  LinearFlow MakeLinear(const Constants& of) const {
    const std::vector<double> zeros(Columns());
    std::vector<double> slope(at_.size()), jacobian(at_.size() * Columns());
    FlowJacobian(of, {0, 0, zeros.data(), zeros.data(), nullptr}, slope.data(), jacobian.data());
    std::vector<LinearFlow::Entry> entries;
    for (int i = 0; i < std::ssize(jacobian); ++i) {
      // Without a motion, as with a mass that is none, the slope is not a number, and so is a step.
      const bool is_entry = jacobian[i] != 0 && std::isfinite(jacobian[i]);
      if (is_entry) entries.push_back({i / Columns(), i % Columns(), jacobian[i]});
    }
    return {at_.size(), Columns(), entries};
  }
  // Returns the motion of a pair's plane at a time; for two discs, and for a plane that rests, velocities are zero.
  PathMotion::Point WallAt(const Candidate& c, double t) const {
    if (c.plane && motions_[c.b]) return motions_[c.b]->SampleAt(t);
    const Vec2d none = Vec2d::Zero();
    return {c.plane ? scene_.planes[c.b].point : none, none, none, none};
  }
  Separation<double> SeparationAt(const Constants& of, int guard, const ModePoint& from) const {
    const Candidate& c = pairs_[guard].contact;
    const Vec2d a = PositionIn(of, c.a, TwoAt(from.x, at_.PositionOf(c.a)));
    if (!c.plane) return Separate<double>(a, PositionIn(of, c.b, TwoAt(from.x, at_.PositionOf(c.b))));
    HalfPlane<double> wall = of.planes[c.b];
    if (motions_[c.b]) wall.offset = Dot(wall.normal, WallAt(c, from.t).position);
    return Separate<double>(a, wall);
  }
  // Discs whose positions are parameters are there, whatever the state.
  template <typename T>
  Vec2<T> PositionIn(const Constants& of, int body, const Vec2<T>& in_state) const {
    return placed_[body] ? Vec2<T>(of.scene.bodies[body].position.template cast<T>()) : in_state;
  }
  double GapOf(const Constants& of, int guard, const ModePoint& from) const {
    return SeparationAt(of, guard, from).distance - of.laws[guard].contact_distance;
  }
  Vec2d RunningResidual(const RunningTerm& term, const double* x, double t) const {
    return TwoAt(x, at_.IndexOf(term.body, term.quantity)) - TargetAt(term, t);
  }
  static Vec2d RateOfTarget(const RunningTerm& term, double t) {
    using Jet = ceres::Jet<double, 1>;
    const Vec2<Jet> target = TargetAt(term, Jet(t, 0));
    return {target[0].v[0], target[1].v[0]};
  }

  // Adds the integral of a running term over a step, and its derivatives by [x t u].
  void AddRunning(const Scene& scene, const RunningTerm& term, const FlowStep& step, double* after,
                  double* jacobian) const {
    std::vector<double> ends = {0, step.h};
    for (const double turn : term.times) {
      if (turn > step.t && turn < step.t + step.h) ends.push_back(turn - step.t);
    }
    std::ranges::sort(ends);
    const int n = at_.size(), q = at_.PositionOf(term.body), v = at_.VelocityOf(term.body);
    const int force = at_.ForceOn(term.body);
    const bool fixed = scene_.bodies[term.body].fixed, of_position = term.quantity == Quantity::kPosition;
    const Vec2d a = fixed ? Vec2d::Zero() : AccelerationOf(scene, term.body, step.u);
    const Vec2d p = TwoAt(step.x, q), velocity = TwoAt(step.x, v);
    double* row = jacobian != nullptr ? jacobian + at_.running() * Columns() : nullptr;
    for (std::size_t i = 0; i + 1 < ends.size(); ++i) {
      const double length = ends[i + 1] - ends[i];
      for (std::size_t g = 0; g < kGaussNodes.size(); ++g) {
        const double s = ends[i] + kGaussNodes[g] * length, weight = kGaussWeights[g] * length * term.weight;
        const Vec2d there = of_position ? Vec2d(p + s * (velocity + 0.5 * s * a)) : Vec2d(velocity + s * a);
        const Vec2d miss = there - TargetAt(term, step.t + s);
        after[at_.running()] += weight * miss.squaredNorm();
        if (row == nullptr) continue;
        const Vec2d by = 2 * weight * miss;
        row[n] -= by.dot(RateOfTarget(term, step.t + s));
        const double by_force = (of_position ? 0.5 * s * s : s) * InverseMass(scene.bodies[term.body]);
        for (int j = 0; j < 2; ++j) {
          if (of_position) row[q + j] += by[j];
          row[v + j] += (of_position ? s : 1.0) * by[j];
          if (force >= 0) row[FirstControl() + force + j] += by_force * by[j];
        }
      }
    }
  }

  // Sets the rows of the Jacobian of a reset that an impact changes; with kVariables == kOfPair, by the state and time
  // alone.
  template <int kVariables>
  void SetByPair(const Constants& of, const ModePoint& from, int guard, double* jacobian) const {
    const Pair& pair = pairs_[guard];
    using Jet = ceres::Jet<double, kVariables>;
    const int n = at_.size(), columns = FirstControl();
    const std::array<int, kOfPair> places = PlacesOf(pair.contact);
    std::array<Jet, kOfPair> x;
    for (int i = 0; i < kOfPair; ++i) x[i] = Jet(places[i] < 0 ? 0.0 : from.x[places[i]], i);
    const std::array<double, kOfLaw> values = LawOf(of.laws[guard]);
    std::array<Jet, kOfLaw> law;
    for (int i = 0; i < kOfLaw; ++i) {
      law[i] = Jet(values[i]);
      if constexpr (kVariables > kOfPair) law[i].v[kOfPair + i] = 1;
    }
    const PathMotion::Point wall = WallAt(pair.contact, from.t);
    const std::array<Jet, kOfPair> after = Strike(of, guard, x, law, wall.velocity);
    for (int i = 0; i < kOfPair; ++i) {
      if (places[i] < 0) continue;
      double* row = jacobian + places[i] * columns;
      for (int j = 0; j < kOfPair; ++j) {
        if (places[j] >= 0) row[places[j]] = after[i].v[j];
      }
      // A wall acts by the difference of its velocity from that of disc a, whose own part does not count.
      const Vec2d by_velocity(after[i].v[4] - (i == 4), after[i].v[5] - (i == 5));
      row[n] = -Dot(by_velocity, wall.acceleration);
      if constexpr (kVariables == kOfPair) continue;
      double* by = row + n + 1;
      by[parameters_.Restitution(pair.material)] += after[i].v[kOfPair];
      by[parameters_.Friction(pair.material)] += after[i].v[kOfPair + 1];
      for (int side = 0; side < (pair.contact.plane ? 1 : 2); ++side) {
        const int body = side == 0 ? pair.contact.a : pair.contact.b;
        by[parameters_.Mass(body)] -= after[i].v[kOfPair + 2 + side] * values[2 + side] * values[2 + side];
        by[parameters_.Inertia(body)] -= after[i].v[kOfPair + 4 + side] * values[4 + side] * values[4 + side];
      }
    }
  }

  // Returns the places of [p_a p_b v_a v_b w_a w_b] in the state; -1: there is none.
  std::array<int, kOfPair> PlacesOf(const Candidate& c) const {
    std::array<int, kOfPair> places;
    places.fill(-1);
    for (int side = 0; side < (c.plane ? 1 : 2); ++side) {
      const int body = side == 0 ? c.a : c.b;
      for (int j = 0; j < 2; ++j) {
        places[2 * side + j] = at_.PositionOf(body) + j;
        places[4 + 2 * side + j] = at_.VelocityOf(body) + j;
      }
      if (scene_.Spins()) places[8 + side] = at_.AngleOf(body) + 1;
    }
    return places;
  }
  static std::array<double, kOfLaw> LawOf(const ImpactConstants& law) {
    return {law.restitution,
            law.friction,
            law.inverse_mass_a,
            law.inverse_mass_b,
            law.inverse_inertia[0],
            law.inverse_inertia[1]};
  }
  // The part of a step of length h after which two that are p apart come nearest; v and a are relative too. `normal` is
  // that of a plane.
  static double NearestPart(const Vec2d& p, const Vec2d& v, const Vec2d& a, const Vec2d* normal, double h) {
    double least = std::numeric_limits<double>::infinity(), at = 0;
    constexpr int kSamples = 4, kNewtonSteps = 10;
    const auto consider = [&](double part) {
      const double s = part * h;
      const Vec2d there = p + s * (v + 0.5 * s * a);
      const double distance = normal != nullptr ? Dot(*normal, there) : there.norm();
      if (!(distance < least)) return;
      least = distance;
      at = part;
    };
    for (int i = 0; i <= kSamples; ++i) consider(static_cast<double>(i) / kSamples);
    for (int i = 0; i < kNewtonSteps; ++i) {
      const double s = at * h;
      const Vec2d w = v + s * a, there = p + s * (v + 0.5 * s * a);
      const double slope = normal != nullptr ? Dot(*normal, w) : Dot(there, w);
      const double curvature = normal != nullptr ? Dot(*normal, a) : Dot(w, w) + Dot(there, a);
      if (!(curvature > 0) || h == 0) break;
      const double before = at;
      consider(std::clamp((s - slope / curvature) / h, 0.0, 1.0));
      if (at == before) break;
    }
    return at;
  }
  // Returns the impact of a pair with these numbers. `law` has the numbers of LawOf().
  template <typename T, typename L>
  Impact<T> ImpactOf(const Constants& of, int guard, const std::array<T, kOfPair>& x, const std::array<L, kOfLaw>& law,
                     const Vec2d& of_wall) const {
    const auto two = [&](int i) { return Vec2<T>(x[i], x[i + 1]); };
    const Candidate& c = pairs_[guard].contact;
    const Vec2<T> a = PositionIn<T>(of, c.a, two(0));
    const Separation<T> apart =
        c.plane ? Separate<T>(a, of.planes[c.b]) : Separate<T>(a, PositionIn<T>(of, c.b, two(2)));
    const std::array<double, 2>& radius = of.laws[guard].radius;
    const Vec2<T> w = two(4) - two(6) - of_wall.cast<T>();
    const T speed = Dot(apart.normal, w);
    const L mobility = law[2] + law[3], turning = radius[0] * radius[0] * law[4] + radius[1] * radius[1] * law[5];
    const T sliding = Dot(Perpendicular(apart.normal), w) - RimVelocity(of.laws[guard], std::array<T, 2>{x[8], x[9]});
    return MakeImpact<T>(apart.normal,
                         speed,
                         sliding,
                         L(1.0 / mobility),
                         L(1.0 / (mobility + turning)),
                         L(1.0 + law[0]),
                         law[1],
                         /*head_on=*/0,
                         regime_);
  }
  // Returns what an impact makes of the numbers of its pair.
  template <typename T>
  std::array<T, kOfPair> Strike(const Constants& of, int guard, std::array<T, kOfPair> x,
                                const std::array<T, kOfLaw>& law, const Vec2d& of_wall) const {
    const Impact<T> impact = ImpactOf(of, guard, x, law, of_wall);
    const std::array<double, 2>& radius = of.laws[guard].radius;
    for (int side = 0; side < 2; ++side) {
      const T gain = side == 0 ? law[2] : T(-law[3]);
      for (int j = 0; j < 2; ++j) x[4 + 2 * side + j] += gain * impact.impulse[j];
      x[8 + side] -= radius[side] * law[4 + side] * impact.tangential;
    }
    return x;
  }

  const Scene scene_;
  const Simulator* const flight_;
  const std::optional<ContactMode> regime_;  // of all impacts
  const SceneLayout at_;
  const ParameterPlaces parameters_;
  const bool integrates_;
  bool arcs_ = false;  // under constant forces, and without parameters
  const std::vector<double> waypoints_;
  std::vector<bool> placed_;         // discs whose positions are design parameters
  bool flight_is_designed_ = false;  // design parameters change the flow
  std::vector<Pair> pairs_;
  std::vector<StatePart> parts_;                            // none: the state is one
  std::vector<std::optional<PathMotion>> paths_, motions_;  // of each body, and of each plane
  Constants given_;
  mutable std::mutex mutex_;
  mutable std::list<std::shared_ptr<const Constants>> known_;
};

// The residuals factor (x_i - target_i) of successive components of a state.
struct ComponentResiduals {
  int first;
  double factor;
  std::vector<double> targets;

  template <typename T>
  bool operator()(T const* const* blocks, T* residuals) const {
    for (std::size_t i = 0; i < targets.size(); ++i) {
      residuals[i] = factor * (blocks[0][first + static_cast<int>(i)] - targets[i]);
    }
    return true;
  }
};

// The residual |v|^2 / most^2 - 1 of two successive components, of a force or a velocity.
struct NormExcess {
  int first;
  double most;

  template <typename T>
  bool operator()(T const* const* blocks, T* residuals) const {
    const T &x = blocks[0][first], &y = blocks[0][first + 1];
    residuals[0] = (x * x + y * y) / (most * most) - 1.0;
    return true;
  }
};

}  // namespace

std::string UnsupportedByHybridProblem(const Scene& scene) {
  if (const std::string beyond = NonPlaneGeometry(scene); !beyond.empty()) return beyond;
  const auto has_force = [&](int body) {
    return std::ranges::any_of(scene.forces, [&](const StateForce& force) {
      const ForceAtState at = ForceAt(force, std::vector<double>(4 * scene.num_bodies()), 4);
      return at.body == body || at.other == body;
    });
  };
  // The state has these discs where the scene has them.
  for (const auto& [parameter, min, max, moved] : scene.design) {
    const auto is_of = [&](const auto& term) { return term.body == parameter.body; };
    const Objective& objective = scene.objective;
    if (parameter.kind != SceneParameter::Kind::kPosition) continue;
    if (has_force(parameter.body))
      return "a spring to " + scene.bodies[parameter.body].name + ", whose position is a parameter";
    if (std::ranges::any_of(objective.terminal, is_of) || std::ranges::any_of(objective.via, is_of) ||
        std::ranges::any_of(objective.running, is_of)) {
      return "a term of " + scene.bodies[parameter.body].name + ", whose position is a parameter";
    }
  }
  return "";
}

HybridProblem MakeHybridProblem(const Scene& scene) { return MakeHybridProblem(scene, nullptr); }

HybridSystem SceneSystemOf(const Scene& scene, SceneParameters parameters, const Simulator* flight) {
  return HybridSystem(std::make_shared<SceneSystem>(scene, parameters, flight, std::nullopt));
}

HybridInput InputOf(const HybridProblem& problem, const std::vector<double>& initial,
                    const std::vector<double>& control, const std::vector<double>& lengths) {
  HybridInput input = problem.guess;
  std::ranges::copy(initial, input.initial.begin());
  input.control = control;
  input.lengths = lengths;
  input.num_intervals = static_cast<int>(lengths.size());
  input.duration = std::accumulate(lengths.begin(), lengths.end(), 0.0);
  return input;
}

HybridProblem MakeHybridProblem(const Scene& scene, std::vector<SceneConstraint>* constraints) {
  const SceneLayout at(scene);
  const Objective& objective = scene.objective;
  HybridProblem problem{.system = SceneSystemOf(scene, SceneParameters::kDesign),
                        .guess = {.initial = InitialState(scene),
                                  .duration = scene.duration,
                                  .num_intervals = scene.steps,
                                  .control = InitialControl(scene, scene.steps)}};
  problem.guess.initial.resize(at.size(), 0.0);
  problem.guess.parameters = DesignOf(scene);
  for (std::size_t k = 0; k < scene.design.size(); ++k) {
    const ParameterRange range = RangeOf(scene.design[k]);
    problem.free.parameters.push_back(static_cast<int>(k));
    problem.free.parameters_min.push_back(range.min);
    problem.free.parameters_max.push_back(range.max);
  }

  // Says that the term that is added next is a constraint of the scene.
  const auto tell = [&](SceneConstraint constraint) {
    if (constraints == nullptr) return;
    constraint.term = static_cast<int>(problem.terms.size());
    constraints->push_back(std::move(constraint));
  };
  // A term of a position, a velocity or a number of spin, at the end or at a waypoint.
  const auto add = [&](HybridTerm term, const auto& of) {
    const bool is_one = of.quantity == Quantity::kAngle || of.quantity == Quantity::kAngularVelocity;
    std::vector<double> targets(of.target.begin(), of.target.begin() + (is_one ? 1 : 2));
    const auto count = static_cast<int>(targets.size());
    term.name += " of " + scene.bodies[of.body].name;
    term.with_state = true;
    if (of.hard) term.role = HybridTerm::Role::kEquality;
    term.function = MakeFunction(
        ComponentResiduals{at.IndexOf(of.body, of.quantity), of.hard ? 1.0 : std::sqrt(of.weight), std::move(targets)},
        {at.size()},
        count);
    problem.terms.push_back(std::move(term));
  };
  const auto add_row = [&](const std::string& name, HybridTerm::Role role, auto function) {
    problem.terms.push_back({.name = name,
                             .role = role,
                             .with_state = true,
                             .function = MakeFunction(std::move(function), {at.size()}, 1)});
  };
  const auto add_region = [&](const TerminalTerm& term) {
    const std::string name = "goal region of " + scene.bodies[term.body].name;
    for (int j = 0; j < (term.IsRotational() ? 1 : 2); ++j) {
      const int i = at.IndexOf(term.body, term.quantity) + j;
      const double min = term.region->min[j], max = term.region->max[j];
      const auto add_side = [&](HybridTerm::Role role, double factor, double bound) {
        tell({.terminal = &term, .by = {factor * Vec2d::Unit(j)}});
        add_row(name, role, ComponentResiduals{i, factor, {bound}});
      };
      if (min == max) {
        add_side(HybridTerm::Role::kEquality, 1, min);
        continue;
      }
      if (std::isfinite(max)) add_side(HybridTerm::Role::kInequality, 1, max);
      if (std::isfinite(min)) add_side(HybridTerm::Role::kInequality, -1, min);
    }
  };
  for (const SpeedLimit& limit : objective.limits) {
    const std::string name = "limit of the speed of " + scene.bodies[limit.body].name;
    const NormExcess excess{at.VelocityOf(limit.body), limit.max};
    const Vec2d by(2 / limit.max, 0);  // |v|^2 / max^2 at the limit, by the limit
    if (limit.at == SpeedLimit::Timing::kEnd) {
      tell({.limit = &limit, .by = {by}});
      add_row(name, HybridTerm::Role::kInequality, excess);
      continue;
    }
    tell({.limit = &limit, .by = {by, by}});
    std::vector<int> blocks = {at.size(), scene.control_width(), static_cast<int>(scene.design.size()), 1, 1};
    std::erase(blocks, 0);
    problem.terms.push_back({.name = name,
                             .at = HybridTerm::Timing::kEachInterval,
                             .role = HybridTerm::Role::kInequality,
                             .always = true,
                             .with_state = true,
                             .with_control = scene.control_width() > 0,
                             .with_parameters = !scene.design.empty(),
                             .with_time = true,
                             .with_length = true,
                             .function = MakeFunction(excess, blocks, 1)});
  }
  for (const TerminalTerm& term : objective.terminal) {
    if (term.region) {
      add_region(term);
    } else if (term.component) {
      const int component = at.IndexOf(term.body, term.quantity) + *term.component;
      add_row("terminal term of " + scene.bodies[term.body].name,
              HybridTerm::Role::kValue,
              ComponentResiduals{component, term.weight, {0.0}});
    } else {
      if (term.hard) tell({.terminal = &term, .by = {Vec2d::Unit(0), Vec2d::Unit(1)}});
      add({.name = "terminal term"}, term);
    }
  }
  const std::vector<double> waypoints = WaypointTimes(scene, Integrates(scene, SceneParameters::kDesign));
  for (const ViaTerm& term : objective.via) {
    const auto index = static_cast<std::size_t>(std::ranges::find(waypoints, term.time) - waypoints.begin());
    if (term.hard) tell({.via = &term, .by = {Vec2d::Unit(0), Vec2d::Unit(1)}});
    add({.name = WaypointName(index), .at = HybridTerm::Timing::kEvent, .event = WaypointName(index)}, term);
  }
  if (!objective.running.empty())
    add_row("running terms", HybridTerm::Role::kValue, ComponentResiduals{at.running(), 1, {0.0}});
  if (objective.effort > 0 && scene.control_width() > 0) {
    problem.terms.push_back(MakeEffortCost(objective.effort, scene.control_width()));
  }

  HybridFree& free = problem.free;
  if (objective.duration) {
    free.duration = true;
    free.duration_min = objective.duration->min;
    free.duration_max = objective.duration->max;
    if (objective.duration->weight > 0) problem.terms.push_back(MakeDurationCost(objective.duration->weight));
  }
  if (scene.optimize == Optimize::kControl) {
    free.control = true;
    const Control& control = scene.control;
    if (!control.max.empty() || !control.max_torque.empty()) {
      for (int c = 0; c < scene.num_controlled(); ++c) {
        free.control_max.insert(free.control_max.end(), 2, control.max.empty() ? INFINITY : control.max[c]);
      }
      for (int t = 0; t < scene.num_torques(); ++t) free.control_max.push_back(MaxTorqueForce(scene, t));
      for (const double most : free.control_max) free.control_min.push_back(-most);
    }
    for (std::size_t c = 0; c < control.max_norm.size(); ++c) {
      problem.terms.push_back(
          {.name = "bound on the force on " + scene.bodies[control.bodies[c]].name,
           .at = HybridTerm::Timing::kEachInterval,
           .role = HybridTerm::Role::kInequality,
           .with_control = true,
           .function =
               MakeFunction(NormExcess{2 * static_cast<int>(c), control.max_norm[c]}, {scene.control_width()}, 1),
           .reads_controls = {2 * static_cast<int>(c), 2 * static_cast<int>(c) + 1}});
    }
  } else if (scene.optimize != Optimize::kNone) {
    for (const int body : scene.free) {
      const int first = scene.optimize == Optimize::kVelocity ? at.VelocityOf(body) : at.PositionOf(body);
      free.initial.insert(free.initial.end(), {first, first + 1});
    }
    for (const int body : scene.free_spin) free.initial.push_back(at.AngleOf(body) + 1);
  }
  return problem;
}

}  // namespace saltus
