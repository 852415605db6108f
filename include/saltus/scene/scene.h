// The nouns: what stands in a scene, what acts on it, and what is to be minimised. Plain doubles, SI units unless
// Scene::units says otherwise.
//
// Accepted numbers: every one is finite and of magnitude at most kLargestMagnitude; those that must be positive (and
// the length of a normal) are at least kSmallestPositive. Within these bounds dt, inverse masses, accelerations, free
// flight and the loss are far from overflow in double.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

inline constexpr double kLargestMagnitude = 1e24;
inline constexpr double kSmallestPositive = 1e-24;
inline constexpr int kMaxSteps = 10'000'000;
inline constexpr double kOverlapTolerance = 1e-12;  // of the scene's length (units.h), allowed at the start

// A disc's moment of inertia: none, it cannot spin; that of a solid disc, m r^2 / 2; or a given number.
struct Inertia {
  enum class Kind { kNone, kSolid, kGiven };
  Kind kind = Kind::kNone;
  double moment = 0;  // kg m^2, > 0, if given; else not used

  bool operator==(const Inertia&) const = default;
};

// A disc. A fixed disc never moves: its velocity is zero, its mass is not used, and it cannot spin.
struct Body {
  std::string name;   // [A-Za-z0-9_.-]+
  double radius = 0;  // m, > 0
  double mass = 1;    // kg, > 0
  bool fixed = false;
  Vec2d position = Vec2d::Zero();  // m
  Vec2d velocity = Vec2d::Zero();  // m/s
  Inertia inertia = {};
  double angle = 0;             // rad, counter-clockwise; zero if it cannot spin
  double angular_velocity = 0;  // rad/s, counter-clockwise; likewise
  int material = -1;            // index into Scene::materials; -1: none, it has the numbers of Scene::contact

  bool Spins() const { return inertia.kind != Inertia::Kind::kNone; }
  // kg m^2. Precondition: it spins.
  double MomentOfInertia() const {
    return inertia.kind == Inertia::Kind::kSolid ? 0.5 * mass * radius * radius : inertia.moment;
  }

  bool operator==(const Body&) const = default;
};

// A half-plane. Bodies stay on the side that the normal points to.
struct Plane {
  std::string name;              // as of a body; no two bodies, planes, edges or pockets have the same
  Vec2d point = Vec2d::Zero();   // m, any point on the boundary
  Vec2d normal = Vec2d::Zero();  // any length > 0; used normalised
  int material = -1;             // as of a body

  bool operator==(const Plane&) const = default;
};

// A straight wall of finite length. Both sides are solid, and so are its ends. Where walls share an end they are
// joined.
struct EdgeSegment {
  std::string name;                                // as of a body
  Vec2d from = Vec2d::Zero(), to = Vec2d::Zero();  // m; different
  int material = -1;                               // as of a body

  bool operator==(const EdgeSegment&) const = default;
};

// A closed line of straight walls, of which one side is solid.
struct EdgePolygon {
  enum class Solid { kInside, kOutside };
  std::string name;           // as of a body
  std::vector<Vec2d> points;  // m; corners in counter-clockwise order, at least three; its sides do not meet
  Solid solid = Solid::kInside;
  int material = -1;  // as of a body

  bool operator==(const EdgePolygon&) const = default;
};

// A wall along a part of a circle, or a whole one. Both sides are solid, and so are its ends.
struct EdgeArc {
  std::string name;              // as of a body
  Vec2d center = Vec2d::Zero();  // m
  double radius = 0;             // m, > 0
  double from = 0, to = 0;       // rad, counter-clockwise; from < to <= from + 2 pi
  int material = -1;             // as of a body

  bool operator==(const EdgeArc&) const = default;
};

// Discs slide on a horizontal table, seen from above: each slows by friction * gravity against its velocity, and rests
// in the end.
struct TableFriction {
  double friction = 0;    // >= 0
  double gravity = 9.81;  // m/s^2, >= 0; across the plane of the scene

  bool operator==(const TableFriction&) const = default;
};

// A hole that discs fall into: one whose centre comes to the circle is out of play. It stays where it went in, at rest,
// and touches nothing any more; no force moves it.
struct Pocket {
  std::string name;                // as of a body
  Vec2d position = Vec2d::Zero();  // m, of the centre
  double radius = 0;               // m, > 0

  bool operator==(const Pocket&) const = default;
};

// Contact parameters: restitution and friction of all that has no material, and the stiffness and damping of the whole
// scene. A model reads those it knows.
struct ContactParameters {
  double restitution = 1;  // e in [0, 1]
  double friction = 0;     // mu >= 0
  double stiffness = 1e4;  // N/m, compliant models
  double damping = 0;      // N s/m, compliant models; >= 0, as stiffness

  bool operator==(const ContactParameters&) const = default;
};

// Restitution and friction where two things touch.
struct PairContact {
  double restitution = 1;  // e in [0, 1]
  double friction = 0;     // mu >= 0

  bool operator==(const PairContact&) const = default;
};

// A material of bodies and walls.
struct Material {
  std::string name;     // as of a body, but without '-'; not "default", which is what has no material
  PairContact contact;  // from two of these Scene::combine makes the numbers of a pair

  bool operator==(const Material&) const = default;
};

// Two materials, or twice the same, whose restitution or friction is given and not combined.
struct MaterialPair {
  int a = -1, b = -1;  // indices into Scene::materials; -1: what has no material
  std::optional<double> restitution = std::nullopt, friction = std::nullopt;

  bool operator==(const MaterialPair&) const = default;
};

// How the numbers of two materials make those of the pair that they are.
enum class Combine { kMean, kProduct, kMin, kMax };

// Which bodies are pushed and turned, and the constant force and torque on each with which optimisation starts.
//
// A control is made of forces only: a torque is there as torque / radius, the force at the rim that would turn the disc
// so. In these, and only these, terms effort and bounds are the same for both.
struct Control {
  std::vector<int> bodies;     // indices into Scene::bodies, without repetition; none fixed
  std::vector<Vec2d> initial;  // N, one per controlled body
  // Bounds, > 0, one per controlled body, or none: N, of each component of the force, and of its length.
  std::vector<double> max = {}, max_norm = {};
  std::vector<int> turned = {};             // those of the bodies, which spin, that have a torque on them too
  std::vector<double> initial_torque = {};  // N m, counter-clockwise, one per turned body
  std::vector<double> max_torque = {};      // N m, > 0, of its magnitude; one per turned body, or none

  bool IsBounded() const { return !max.empty() || !max_norm.empty() || !max_torque.empty(); }

  bool operator==(const Control&) const = default;
};

// One term of the loss at the final time T.
struct TerminalTerm {
  enum class Quantity { kPosition, kVelocity, kAngle, kAngularVelocity };
  int body = 0;
  Quantity quantity = Quantity::kPosition;
  // Without a component: weight * |q(T) - target|^2. With one (0 is x, 1 is y): weight * q_component(T), linear.
  std::optional<int> component = std::nullopt;
  // m or m/s; not used with a component. Of an angle or angular velocity its first entry, rad or rad/s; the other is 0.
  Vec2d target = Vec2d::Zero();
  double weight = 1;  // any sign with a component, else >= 0
  bool hard = false;  // a constraint, q(T) = target: no part of the loss, and no component or weight

  // True if it is of an angle or an angular velocity, which is one number and has no component.
  bool IsOfSpin() const { return quantity == Quantity::kAngle || quantity == Quantity::kAngularVelocity; }

  bool operator==(const TerminalTerm&) const = default;
};

// weight * the integral of |q(t) - r(t)|^2 dt, with q a position or a velocity: r goes straight from target to target,
// and is constant outside their times.
struct RunningTerm {
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  std::vector<double> times;   // s, rising; at least one
  std::vector<Vec2d> targets;  // m or m/s, one per time
  double weight = 1;           // 1/s, >= 0

  bool operator==(const RunningTerm&) const = default;
};

// weight * |q(time) - target|^2; or a constraint, q(time) = target. Of a position or a velocity too.
struct ViaTerm {
  int body = 0;
  double time = 0;  // s, in (0, duration)
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  Vec2d target = Vec2d::Zero();
  double weight = 1;  // >= 0
  bool hard = false;

  bool operator==(const ViaTerm&) const = default;
};

// A final time that is free: weight * T is part of the loss.
struct FreeDuration {
  double min = 0, max = 0;  // s, 0 < min <= max
  double weight = 0;        // 1/s, >= 0

  bool operator==(const FreeDuration&) const = default;
};

// loss = sum of terminal, running and via terms + effort * sum over controlled bodies of the integral of |u|^2 dt, and
// of that of (torque / radius)^2 for those that are turned
struct Objective {
  std::vector<TerminalTerm> terminal;
  double effort = 0;  // >= 0
  std::vector<RunningTerm> running = {};
  std::vector<ViaTerm> via = {};
  std::optional<FreeDuration> duration = std::nullopt;  // none: the scene's

  // True if every term is a square, so that least-squares solvers apply: no term has a component.
  bool IsSumOfSquares() const;
  // True if a term is hard.
  bool HasConstraints() const;

  bool operator==(const Objective&) const = default;
};

// The units of a scene's numbers: powers of two in SI units, so that going from one set of units to another
// changes no bit. Units that are not named follow: that of a speed is length / time.
struct Units {
  double length = 1;             // m
  double time = 1;               // s
  double mass = 1;               // kg
  double loss = 1;               // of the loss
  Vec2d origin = Vec2d::Zero();  // m; where the position [0, 0] is
  double loss_at_origin = 0;     // the loss where it is 0: linear terms measure positions from the origin
  bool natural = false;          // those that belong to the scene (units.h)

  double speed() const { return length / time; }
  double acceleration() const { return speed() / time; }
  double moment_of_inertia() const { return mass * length * length; }
  double force() const { return mass * acceleration(); }

  bool operator==(const Units&) const = default;
};

// Two discs, or a disc and a plane (then b is its index), that must not touch: a constraint.
struct NoContact {
  int a = 0, b = 0;
  bool plane = false;

  bool operator==(const NoContact&) const = default;
};

// One number of a scene that may be unknown: it is identified from recordings (identify.h), or a solver chooses it as a
// design parameter. Names and values: scene_parameter.h.
struct SceneParameter {
  enum class Kind {
    kRestitution,
    kFriction,
    kStiffness,
    kDamping,
    kMass,
    kGravity,
    kForce,          // on a disc, constant; of identification only
    kLaw,            // of a learned law of impact, which stands in no scene; of identification only
    kRadius,         // m
    kPosition,       // m, of a fixed disc
    kPlaneOffset,    // m, by which the plane is moved along its normal
    kPlaneAngle,     // rad, by which it is turned about its point, counter-clockwise
    kSegmentOffset,  // m, by which the segment is moved to its left, seen from its first end
    kSegmentAngle,   // rad, by which it is turned about its middle, counter-clockwise
  };
  Kind kind = Kind::kRestitution;
  int body = -1;  // of a mass, force, radius or position; or the index of a plane or a segment
  // The component, 0 is x and 1 is y, of gravity, a force or a position; the number of a law's parameter; or the
  // MaterialPairIndex() (materials.h) of a restitution or friction in a scene with materials.
  int component = 0;

  bool operator==(const SceneParameter&) const = default;
};

// A number of the scene that solvers choose beside what Optimize names. They begin at its value in the scene.
struct DesignParameter {
  SceneParameter parameter;
  std::optional<double> min = std::nullopt, max = std::nullopt;  // in the parameter's unit; min < max

  bool operator==(const DesignParameter&) const = default;
};

// The unknowns of the solvers, beside Scene::design.
enum class Optimize { kControl, kVelocity, kPosition, kNone };

// Returns the word of scene files: "control", "velocity", "position", "none".
const char* OptimizeToString(Optimize optimize);

struct Scene {
  // Defined in scene.cc, as most files that use scenes copy some.
  Scene();
  Scene(const Scene& other);
  Scene(Scene&& other) noexcept;
  Scene& operator=(const Scene& other);
  Scene& operator=(Scene&& other) noexcept;
  ~Scene();
  bool operator==(const Scene& other) const;

  std::string name;               // [a-z0-9_]+
  double duration = 1;            // s, > 0
  int steps = 1;                  // equal steps of duration / steps; 1 to kMaxSteps
  Vec2d gravity = Vec2d::Zero();  // m/s^2
  std::vector<Body> bodies;
  std::vector<Plane> planes;
  std::vector<EdgeSegment> segments = {};
  std::vector<EdgePolygon> polygons = {};
  std::vector<EdgeArc> arcs = {};
  std::vector<Pocket> pockets = {};
  std::optional<TableFriction> table = std::nullopt;  // none: nothing slows discs but contact
  ContactParameters contact;
  std::vector<Material> materials = {};  // none: everything has the restitution and friction of `contact`
  std::vector<MaterialPair> pairs = {};  // no pair twice
  Combine combine = Combine::kMean;      // for pairs that are not there; for these a material with itself is a pair too
  Control control;                       // empty if nothing is pushed
  Objective objective;
  std::vector<NoContact> no_contact;
  Optimize optimize = Optimize::kNone;
  // For kVelocity and kPosition: whose, at least one; else not used. Indices of bodies that are not fixed, without
  // repetition.
  std::vector<int> free;
  // For kVelocity: whose angular velocities too. Indices of bodies that spin, without repetition.
  std::vector<int> free_spin = {};
  // Parameters that solvers may change too; none twice. Offsets and angles are 0 in the scene as it stands.
  std::vector<DesignParameter> design = {};
  Units units = {};  // SI in every scene that users give

  double dt() const { return duration / steps; }
  int num_bodies() const { return static_cast<int>(bodies.size()); }
  int num_controlled() const { return static_cast<int>(control.bodies.size()); }
  int num_turned() const { return static_cast<int>(control.turned.size()); }
  // Numbers of a control in each of its intervals, one after the other: [u_x u_y] of each controlled body, and then
  // torque / radius of each that is turned. All are forces, N.
  int control_width() const { return 2 * num_controlled() + num_turned(); }
  // Where in a control the force on controlled body c in interval k begins.
  std::size_t ForceIndex(std::size_t k, int c) const { return k * control_width() + 2 * static_cast<std::size_t>(c); }
  // Where torque / radius of turned body t in interval k stands.
  std::size_t TurnIndex(std::size_t k, int t) const { return ForceIndex(k, num_controlled()) + t; }
  // True if there is a disc that spins.
  bool Spins() const;
  // True if there are walls that end: segments, polygons or arcs.
  bool HasEdges() const { return !segments.empty() || !polygons.empty() || !arcs.empty(); }
};

// A rule of the scene that is broken, and where.
struct SceneError {
  std::string key;      // path in the scene file: "bodies[1].radius"
  std::string message;  // what was found and what was expected

  std::string ToString() const { return key + ": " + message; }
};

// The first rule that `scene` breaks, or nothing. Checked: numbers (see the top), ranges as stated above, names that
// are unique and well formed, indices in range, something to optimise and a terminal term to optimise it for (kNone
// needs neither), and no overlap above kOverlapTolerance, and above what rounding makes of positions far from the
// origin, at the start between discs or of a disc with a plane, a segment, an arc or a polygon (two fixed discs may
// overlap, and a fixed disc may reach into what does not move), and no disc in a pocket there. Quadratic in the number
// of bodies, and of the points of a polygon.
std::optional<SceneError> Validate(const Scene& scene);

// The first of those rules that `scene` breaks and a simulation relies on: numbers, ranges and indices. Names, what is
// to be optimised and overlaps are not looked at. Linear in the size of the scene. Every entry point of the library
// that takes a scene asks this, so that a wrong one is refused with its key.
std::optional<SceneError> ValidateStructure(const Scene& scene);

}  // namespace saltus
