// Bodies under constant forces, with h the length of a step, m a mass, I a moment of inertia and g gravity:
//
//   q' = q + h v + h^2/2 (g + u/m),   v' = v + h (g + u/m),   angle' = angle + h w + h^2/2 r f/I,   w' = w + h r f/I
//
// where f is the force at the rim that a torque is stored as. A running term adds weight int |q(s) - r(t + s)|^2 ds,
// whose integrand is a polynomial of degree four between the times at which targets turn: three nodes of the quadrature
// of Gauss and Legendre give the integral exactly.
#include "saltus/control/scene_problem.h"

#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/jet.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "control/control_bounds.h"
#include "control/scene_constraints.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/simulate/simulator.h"
#include "simulate/flight.h"
#include "simulate/impact.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

constexpr int kOfPair = 10;  // positions, velocities and angular velocities of two bodies
using PairJet = ceres::Jet<double, kOfPair>;

// Where the numbers of a scene's bodies are in the state and in the control.
class SceneLayout {
 public:
  explicit SceneLayout(const Scene& scene) : scene_(scene), pushed_(scene.bodies.size(), -1), turned_(pushed_) {
    for (int c = 0; c < scene.num_controlled(); ++c) pushed_[scene.control.bodies[c]] = 2 * c;
    for (int t = 0; t < scene.num_turned(); ++t) {
      turned_[scene.control.turned[t]] = static_cast<int>(scene.TurnIndex(0, t));
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
  int TorqueOn(int body) const { return turned_[body]; }

 private:
  const Scene& scene_;
  std::vector<int> pushed_, turned_;
};

// Returns the times of waypoints, rising, each once.
std::vector<double> WaypointTimes(const Scene& scene) {
  std::set<double> times;
  for (const ViaTerm& term : scene.objective.via) times.insert(term.time);
  return {times.begin(), times.end()};
}

std::string WaypointName(std::size_t index) { return "waypoint " + std::to_string(index + 1); }

// Mode k has passed k waypoints. The guards of a mode are those of the pairs, then that of the next waypoint.
class SceneSystem final : public HybridFunctions {
 public:
  explicit SceneSystem(const Scene& scene)
      : HybridFunctions(LayoutOf(scene)), scene_(scene), at_(scene_), waypoints_(WaypointTimes(scene)) {
    for (const Candidate& contact : AllPairs(scene_)) {
      const bool must_not_touch = std::ranges::any_of(scene_.no_contact, [&](const NoContact& apart) {
        const bool same = apart.a == contact.a && apart.b == contact.b;
        const bool turned = !contact.plane && apart.a == contact.b && apart.b == contact.a;
        return apart.plane == contact.plane && (same || turned);
      });
      pairs_.push_back({contact, MakeImpactConstants(scene_, contact), must_not_touch});
    }
    if (scene_.objective.running.empty() && scene_.num_bodies() > 1) AddParts();
  }

  void Flow(const ModePoint& from, double* xdot) const override {
    std::fill_n(xdot, at_.size(), 0.0);
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (scene_.bodies[i].fixed) continue;
      const Vec2d a = AccelerationOf(i, from.u);
      for (int j = 0; j < 2; ++j) {
        xdot[at_.PositionOf(i) + j] = from.x[at_.VelocityOf(i) + j];
        xdot[at_.VelocityOf(i) + j] = a[j];
      }
      if (!scene_.Spins()) continue;
      xdot[at_.AngleOf(i)] = from.x[at_.AngleOf(i) + 1];
      xdot[at_.AngleOf(i) + 1] = TurningOf(i, from.u);
    }
    for (const RunningTerm& term : scene_.objective.running) {
      xdot[at_.running()] += term.weight * MissOf(term, from.x, from.t).squaredNorm();
    }
  }

  void FlowJacobian(const ModePoint& from, double* xdot, double* jacobian) const override {
    Flow(from, xdot);
    const int n = at_.size(), columns = Columns();
    std::fill_n(jacobian, n * columns, 0.0);
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (scene_.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) {
        jacobian[(at_.PositionOf(i) + j) * columns + at_.VelocityOf(i) + j] = 1;
        if (at_.ForceOn(i) < 0) continue;
        jacobian[(at_.VelocityOf(i) + j) * columns + n + 1 + at_.ForceOn(i) + j] = InverseMass(scene_.bodies[i]);
      }
      if (!scene_.Spins()) continue;
      jacobian[at_.AngleOf(i) * columns + at_.AngleOf(i) + 1] = 1;
      if (at_.TorqueOn(i) >= 0) jacobian[(at_.AngleOf(i) + 1) * columns + n + 1 + at_.TorqueOn(i)] = RateOfTurn(i);
    }
    for (const RunningTerm& term : scene_.objective.running) {
      double* row = jacobian + at_.running() * columns;
      const Vec2d by = 2 * term.weight * MissOf(term, from.x, from.t), rate = RateOfTarget(term, from.t);
      for (int j = 0; j < 2; ++j) row[at_.IndexOf(term.body, term.quantity) + j] += by[j];
      row[n] -= by.dot(rate);
    }
  }

  bool IsLinear(int /*mode*/) const override { return scene_.objective.running.empty(); }

  void Step(const FlowStep& step, const double* /*slope*/, double* /*scratch*/, double* after,
            double* slope_after) const override {
    Fly(step, after, nullptr);
    Flow({step.mode, step.t + step.h, after, step.u, step.p}, slope_after);
  }

  bool Fly(const FlowStep& step, double* after, double* jacobian) const override {
    const int n = at_.size(), columns = Columns();
    const double h = step.h;
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
      jacobian[q * columns + n + 1 + control] = 0.5 * h * h * by;
      jacobian[v * columns + n + 1 + control] = h * by;
    };
    for (int i = 0; i < at_.num_bodies(); ++i) {
      if (scene_.bodies[i].fixed) continue;
      const Vec2d a = AccelerationOf(i, step.u);
      const int force = at_.ForceOn(i);
      for (int j = 0; j < 2; ++j) {
        move(at_.PositionOf(i) + j,
             at_.VelocityOf(i) + j,
             a[j],
             force < 0 ? -1 : force + j,
             InverseMass(scene_.bodies[i]));
      }
      if (!scene_.Spins()) continue;
      move(at_.AngleOf(i), at_.AngleOf(i) + 1, TurningOf(i, step.u), at_.TorqueOn(i), RateOfTurn(i));
    }
    for (const RunningTerm& term : scene_.objective.running) AddRunning(term, step, after, jacobian);
    return true;
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
      if (pairs_[guard].law.inverse_inertia[side] > 0) parts.push_back(turning + parts[side]);
    }
    return parts;
  }
  void MovePart(int part, const FlowStep& step, double* after, double* jacobian) const override {
    const bool turns = part >= at_.num_bodies();
    const int body = part % at_.num_bodies(), m = static_cast<int>(parts_[part].controls.size());
    const int dimension = turns ? 1 : 2, n = 2 * dimension, columns = n + 1 + m + 1;
    const double h = step.h, by = turns ? RateOfTurn(body) : InverseMass(scene_.bodies[body]);
    if (jacobian != nullptr) std::fill_n(jacobian, n * columns, 0.0);
    for (int j = 0; j < dimension; ++j) {
      const int v = dimension + j;
      const double acceleration = (turns ? 0 : scene_.gravity[j]) + (m > 0 ? by * step.u[j] : 0);
      after[j] = step.x[j] + h * (step.x[v] + 0.5 * h * acceleration);
      after[v] = step.x[v] + h * acceleration;
      if (jacobian == nullptr) continue;
      double *of_q = jacobian + j * columns, *of_v = jacobian + v * columns;
      of_q[j] = of_v[v] = 1;
      of_q[v] = h;
      of_q[columns - 1] = after[v];
      of_v[columns - 1] = acceleration;
      if (m == 0) continue;
      of_q[n + 1 + j] = 0.5 * h * h * by;
      of_v[n + 1 + j] = h * by;
    }
  }

  double Guard(const ModePoint& from, int guard) const override {
    if (IsWaypoint(guard)) return waypoints_[from.mode] - from.t;
    return SeparationAt(guard, from.x).distance - pairs_[guard].law.contact_distance;
  }
  double GuardRate(const ModePoint& from, int guard, const double* xdot, double* rate) const override {
    if (IsWaypoint(guard)) {
      *rate = -1;
      return Guard(from, guard);
    }
    const Candidate& c = pairs_[guard].contact;
    const Separation<double> apart = SeparationAt(guard, from.x);
    *rate = Dot(apart.normal,
                Vec2d(TwoAt(xdot, at_.PositionOf(c.a)) - (c.plane ? Vec2d::Zero() : TwoAt(xdot, at_.PositionOf(c.b)))));
    return apart.distance - pairs_[guard].law.contact_distance;
  }
  double GuardGradient(const ModePoint& from, int guard, double* gradient) const override {
    std::fill_n(gradient, Columns(), 0.0);
    if (IsWaypoint(guard)) {
      gradient[at_.size()] = -1;
      return Guard(from, guard);
    }
    const Candidate& c = pairs_[guard].contact;
    const Separation<double> apart = SeparationAt(guard, from.x);
    for (int j = 0; j < 2; ++j) {
      gradient[at_.PositionOf(c.a) + j] = apart.normal[j];
      if (!c.plane) gradient[at_.PositionOf(c.b) + j] = -apart.normal[j];
    }
    return apart.distance - pairs_[guard].law.contact_distance;
  }

  int Reset(const ModePoint& from, int guard, double* x_plus) const override {
    std::copy_n(from.x, at_.size(), x_plus);
    if (IsWaypoint(guard)) return from.mode + 1;
    const Pair& pair = pairs_[guard];
    if (pair.must_not_touch) return -1;
    const std::array<int, kOfPair> places = PlacesOf(pair.contact);
    std::array<double, kOfPair> x{};
    for (int i = 0; i < kOfPair; ++i) x[i] = places[i] < 0 ? 0.0 : from.x[places[i]];
    const std::array<double, kOfPair> after = Strike(pair, x);
    for (int i = 0; i < kOfPair; ++i) {
      if (places[i] >= 0) x_plus[places[i]] = after[i];
    }
    return from.mode;
  }
  int ResetJacobian(const ModePoint& from, int guard, double* x_plus, double* jacobian) const override {
    const int n = at_.size(), columns = n + 1, next = Reset(from, guard, x_plus);
    std::fill_n(jacobian, n * columns, 0.0);
    for (int i = 0; i < n; ++i) jacobian[i * columns + i] = 1;
    if (IsWaypoint(guard) || next < 0) return next;
    const std::array<int, kOfPair> places = PlacesOf(pairs_[guard].contact);
    std::array<PairJet, kOfPair> x;
    for (int i = 0; i < kOfPair; ++i) x[i] = PairJet(places[i] < 0 ? 0.0 : from.x[places[i]], i);
    const std::array<PairJet, kOfPair> after = Strike(pairs_[guard], x);
    for (int i = 0; i < kOfPair; ++i) {
      for (int j = 0; j < kOfPair && places[i] >= 0; ++j) {
        if (places[j] >= 0) jacobian[places[i] * columns + places[j]] = after[i].v[j];
      }
    }
    return next;
  }
  std::string WhyNoMode(const ModePoint& /*from*/, int guard) const override {
    return guard >= 0 && pairs_[guard].must_not_touch
               ? ContactSequenceToString(scene_, {pairs_[guard].contact}) + " touch, which must not (no_contact)"
               : "";
  }

 private:
  struct Pair {
    Candidate contact;
    ImpactConstants law;
    bool must_not_touch;
  };

  static HybridLayout LayoutOf(const Scene& scene) {
    const SceneLayout at(scene);
    const std::vector<double> waypoints = WaypointTimes(scene);
    HybridLayout layout{.num_controls = scene.control_width()};
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
    for (const int body : scene.control.turned) layout.control_names.push_back(scene.bodies[body].name + ".turn");
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
        part.motion = scene_.bodies[i].fixed ? kRests : control >= 0 ? kSteps : kCoasts;
        parts_.push_back(std::move(part));
      }
    }
  }

  int Columns() const { return at_.size() + 1 + scene_.control_width(); }
  bool IsWaypoint(int guard) const { return guard == static_cast<int>(pairs_.size()); }
  static Vec2d TwoAt(const double* x, int place) { return {x[place], x[place + 1]}; }
  Vec2d AccelerationOf(int body, const double* u) const {
    const int force = at_.ForceOn(body);
    return force < 0 ? scene_.gravity : Vec2d(scene_.gravity + InverseMass(scene_.bodies[body]) * TwoAt(u, force));
  }
  double RateOfTurn(int body) const { return scene_.bodies[body].radius / scene_.bodies[body].MomentOfInertia(); }
  double TurningOf(int body, const double* u) const {
    return at_.TorqueOn(body) < 0 ? 0.0 : RateOfTurn(body) * u[at_.TorqueOn(body)];
  }
  Separation<double> SeparationAt(int guard, const double* x) const {
    const Candidate& c = pairs_[guard].contact;
    const Vec2d a = TwoAt(x, at_.PositionOf(c.a));
    if (c.plane) return Separate<double>(a, MakeHalfPlane(scene_.planes[c.b]));
    return Separate<double>(a, TwoAt(x, at_.PositionOf(c.b)));
  }
  Vec2d MissOf(const RunningTerm& term, const double* x, double t) const {
    return TwoAt(x, at_.IndexOf(term.body, term.quantity)) - TargetAt(term, t);
  }
  static Vec2d RateOfTarget(const RunningTerm& term, double t) {
    using Jet = ceres::Jet<double, 1>;
    const Vec2<Jet> target = TargetAt(term, Jet(t, 0));
    return {target[0].v[0], target[1].v[0]};
  }

  // Adds the integral of a running term over a step, and its derivatives by [x t u].
  void AddRunning(const RunningTerm& term, const FlowStep& step, double* after, double* jacobian) const {
    std::vector<double> ends = {0, step.h};
    for (const double turn : term.times) {
      if (turn > step.t && turn < step.t + step.h) ends.push_back(turn - step.t);
    }
    std::ranges::sort(ends);
    const int n = at_.size(), q = at_.PositionOf(term.body), v = at_.VelocityOf(term.body);
    const int force = at_.ForceOn(term.body);
    const bool fixed = scene_.bodies[term.body].fixed, of_position = term.quantity == Quantity::kPosition;
    const Vec2d a = fixed ? Vec2d::Zero() : AccelerationOf(term.body, step.u);
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
        const double by_force = (of_position ? 0.5 * s * s : s) * InverseMass(scene_.bodies[term.body]);
        for (int j = 0; j < 2; ++j) {
          if (of_position) row[q + j] += by[j];
          row[v + j] += (of_position ? s : 1.0) * by[j];
          if (force >= 0) row[n + 1 + force + j] += by_force * by[j];
        }
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
  template <typename T>
  std::array<T, kOfPair> Strike(const Pair& pair, std::array<T, kOfPair> x) const {
    const auto two = [&](int i) { return Vec2<T>(x[i], x[i + 1]); };
    const Candidate& c = pair.contact;
    const Separation<T> apart =
        c.plane ? Separate<T>(two(0), MakeHalfPlane(scene_.planes[c.b])) : Separate<T>(two(0), two(2));
    const Impact<T> impact =
        MakeImpact<T>(pair.law, apart.normal, Vec2<T>(two(4) - two(6)), std::array<T, 2>{x[8], x[9]});
    for (int side = 0; side < 2; ++side) {
      const double gain = side == 0 ? pair.law.inverse_mass_a : -pair.law.inverse_mass_b;
      for (int j = 0; j < 2; ++j) x[4 + 2 * side + j] += gain * impact.impulse[j];
      x[8 + side] += SpinGain(pair.law, side, impact);
    }
    return x;
  }

  const Scene scene_;
  const SceneLayout at_;
  const std::vector<double> waypoints_;
  std::vector<Pair> pairs_;
  std::vector<StatePart> parts_;  // none: the state is one
};

// The residuals factor (x_i - target_i) of successive components of a state.
struct Misses {
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

// NormExcess of a velocity at the beginning and at the end of an interval, given the state, the control and the length.
// Under a constant force the speed is largest at one of them.
struct SpeedExcess {
  NormExcess of;
  int force;  // on the body, in the control; -1: none
  double inverse_mass;
  Vec2d gravity;

  template <typename T>
  bool operator()(T const* const* blocks, T* residuals) const {
    T end[2];
    for (int j = 0; j < 2; ++j) {
      T acceleration(gravity[j]);
      if (force >= 0) acceleration += inverse_mass * blocks[1][force + j];
      end[j] = blocks[0][of.first + j] + blocks[2][0] * acceleration;
    }
    const T* at_end = end;
    of(blocks, residuals);
    return NormExcess{0, of.most}(&at_end, residuals + 1);
  }
};

template <typename F>
std::shared_ptr<const ceres::CostFunction> MakeFunction(F function, const std::vector<int>& blocks, int residuals) {
  auto made = std::make_shared<ceres::DynamicAutoDiffCostFunction<F, 4>>(new F(std::move(function)));
  for (const int block : blocks) made->AddParameterBlock(block);
  made->SetNumResiduals(residuals);
  return made;
}

}  // namespace

std::string WhyNoHybridProblem(const Scene& scene) {
  if (const std::string beyond = BeyondPlanes(scene); !beyond.empty()) return beyond;
  return scene.design.empty() ? "" : "design parameters";
}

HybridProblem HybridProblemOf(const Scene& scene) { return HybridProblemOf(scene, nullptr); }

HybridProblem HybridProblemOf(const Scene& scene, std::vector<SceneConstraint>* constraints) {
  const SceneLayout at(scene);
  const Objective& objective = scene.objective;
  HybridProblem problem{.system = HybridSystem(std::make_shared<SceneSystem>(scene)),
                        .guess = {.initial = InitialState(scene),
                                  .duration = scene.duration,
                                  .num_intervals = scene.steps,
                                  .control = InitialControl(scene, scene.steps)}};
  problem.guess.initial.resize(at.size(), 0.0);

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
    term.function =
        MakeFunction(Misses{at.IndexOf(of.body, of.quantity), of.hard ? 1.0 : std::sqrt(of.weight), std::move(targets)},
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
    for (int j = 0; j < (term.IsOfSpin() ? 1 : 2); ++j) {
      const int i = at.IndexOf(term.body, term.quantity) + j;
      const double min = term.region->min[j], max = term.region->max[j];
      const auto add_side = [&](HybridTerm::Role role, double factor, double bound) {
        tell({.terminal = &term, .by = {factor * Vec2d::Unit(j)}});
        add_row(name, role, Misses{i, factor, {bound}});
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
    if (limit.at == SpeedLimit::At::kEnd) {
      tell({.limit = &limit, .by = {by}});
      add_row(name, HybridTerm::Role::kInequality, excess);
      continue;
    }
    tell({.limit = &limit, .by = {by, by}});
    const Body& body = scene.bodies[limit.body];
    const Vec2d gravity = body.fixed ? Vec2d::Zero() : scene.gravity;
    problem.terms.push_back(
        {.name = name,
         .at = HybridTerm::At::kEachInterval,
         .role = HybridTerm::Role::kInequality,
         .with_state = true,
         .with_control = true,
         .with_length = true,
         .function = MakeFunction(SpeedExcess{excess, at.ForceOn(limit.body), InverseMass(body), gravity},
                                  {at.size(), scene.control_width(), 1},
                                  2)});
  }
  for (const TerminalTerm& term : objective.terminal) {
    if (term.region) {
      add_region(term);
    } else if (term.component) {
      const int component = at.IndexOf(term.body, term.quantity) + *term.component;
      add_row("terminal term of " + scene.bodies[term.body].name,
              HybridTerm::Role::kValue,
              Misses{component, term.weight, {0.0}});
    } else {
      if (term.hard) tell({.terminal = &term, .by = {Vec2d::Unit(0), Vec2d::Unit(1)}});
      add({.name = "terminal term"}, term);
    }
  }
  const std::vector<double> waypoints = WaypointTimes(scene);
  for (const ViaTerm& term : objective.via) {
    const auto index = static_cast<std::size_t>(std::ranges::find(waypoints, term.time) - waypoints.begin());
    if (term.hard) tell({.via = &term, .by = {Vec2d::Unit(0), Vec2d::Unit(1)}});
    add({.name = WaypointName(index), .at = HybridTerm::At::kEvent, .event = WaypointName(index)}, term);
  }
  if (!objective.running.empty()) add_row("running terms", HybridTerm::Role::kValue, Misses{at.running(), 1, {0.0}});
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
      for (int t = 0; t < scene.num_turned(); ++t) free.control_max.push_back(MostTurn(scene, t));
      for (const double most : free.control_max) free.control_min.push_back(-most);
    }
    for (std::size_t c = 0; c < control.max_norm.size(); ++c) {
      problem.terms.push_back(
          {.name = "bound on the force on " + scene.bodies[control.bodies[c]].name,
           .at = HybridTerm::At::kEachInterval,
           .role = HybridTerm::Role::kInequality,
           .with_control = true,
           .function =
               MakeFunction(NormExcess{2 * static_cast<int>(c), control.max_norm[c]}, {scene.control_width()}, 1)});
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
