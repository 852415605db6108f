// The data of a scene: bodies and walls, contacts, the control, and the objective. Numbers are doubles in SI units
// unless Scene::units states others.
//
// Accepted numbers: every one is finite and of magnitude at most kLargestMagnitude; those that must be positive (and
// the length of a normal) are at least kSmallestPositive. Within these bounds dt, inverse masses, accelerations, free
// flight and the loss are far from overflow in double.
#pragma once

#include <cstddef>
#include <limits>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

inline constexpr double kLargestMagnitude = 1e24;
inline constexpr double kSmallestPositive = 1e-24;
inline constexpr int kMaxSteps = 10'000'000;
// The overlap that is allowed at the start, relative to the natural unit of length of the scene (scene/units.h).
inline constexpr double kOverlapTolerance = 1e-12;

// A disc's moment of inertia: kNone (the disc cannot spin), kSolid (m r^2 / 2), or kGiven.
struct Inertia {
  enum class Kind { kNone, kSolid, kGiven };
  Kind kind = Kind::kNone;
  double moment = 0;  // kg m^2, > 0; used for kGiven only

  bool operator==(const Inertia&) const = default;
};

// A prescribed motion: the cubic spline through positions at given times, with two continuous derivatives and a third
// one that is continuous at the second and the last but one time (not-a-knot). Through two positions it is a line, and
// through three a parabola. Outside of the times it goes on with its first and last cubic.
struct PrescribedMotion {
  std::vector<double> times;     // s, rising; at least two, from 0 or before to the end or after
  std::vector<Vec2d> positions;  // m, one for each time

  bool operator==(const PrescribedMotion&) const = default;
};

// A disc. A fixed disc moves along its path, if it has one, and otherwise not at all: `velocity` is zero, `mass` is not
// used, and it cannot spin.
struct Body {
  std::string name;   // [A-Za-z0-9_.-]+
  double radius = 0;  // m, > 0
  double mass = 1;    // kg, > 0
  bool fixed = false;
  Vec2d position = Vec2d::Zero();  // m
  Vec2d velocity = Vec2d::Zero();  // m/s
  Inertia inertia = {};
  double angle = 0;             // rad, counter-clockwise; zero if it cannot spin
  double angular_velocity = 0;  // rad/s, counter-clockwise; zero if it cannot spin
  int material = -1;            // index into Scene::materials; -1: none, it has the numbers of Scene::contact
  // The prescribed motion of a fixed disc. `position` is that of the path at time 0, which Validate() does not check.
  std::optional<PrescribedMotion> path = std::nullopt;

  bool Spins() const { return inertia.kind != Inertia::Kind::kNone; }
  // Returns the moment of inertia, kg m^2. Precondition: it spins.
  double MomentOfInertia() const {
    return inertia.kind == Inertia::Kind::kSolid ? 0.5 * mass * radius * radius : inertia.moment;
  }

  bool operator==(const Body&) const = default;
};

// A half-plane. Bodies stay on the side that the normal points to. A prescribed motion translates the half-plane, and
// never rotates it.
struct Plane {
  std::string name;              // [A-Za-z0-9_.-]+; no two bodies, planes, edges or pockets have the same name
  Vec2d point = Vec2d::Zero();   // m, any point on the boundary
  Vec2d normal = Vec2d::Zero();  // any length > 0; used normalised
  int material = -1;             // as Body::material
  std::optional<PrescribedMotion> motion = std::nullopt;  // of `point`, which is its position at time 0

  bool operator==(const Plane&) const = default;
};

// A straight wall of finite length. Both sides are solid, and so are its ends. Where walls share an end they are
// joined.
struct EdgeSegment {
  std::string name;                                // as Body::name
  Vec2d from = Vec2d::Zero(), to = Vec2d::Zero();  // m; different
  int material = -1;                               // as Body::material

  bool operator==(const EdgeSegment&) const = default;
};

// A closed line of straight walls, of which one side is solid.
struct EdgePolygon {
  enum class Solid { kInside, kOutside };
  std::string name;           // as Body::name
  std::vector<Vec2d> points;  // m; corners in counter-clockwise order, at least three; its sides do not meet
  Solid solid = Solid::kInside;
  int material = -1;  // as Body::material

  bool operator==(const EdgePolygon&) const = default;
};

// A wall along a part of a circle, or a whole one. Both sides are solid, and so are its ends.
struct EdgeArc {
  std::string name;              // as Body::name
  Vec2d center = Vec2d::Zero();  // m
  double radius = 0;             // m, > 0
  double from = 0, to = 0;       // rad, counter-clockwise; from < to <= from + 2 pi
  int material = -1;             // as Body::material

  bool operator==(const EdgeArc&) const = default;
};

// A horizontal table, seen from above, on which all discs slide: each decelerates by friction * gravity and comes to
// rest.
struct TableFriction {
  double friction = 0;    // >= 0
  double gravity = 9.81;  // m/s^2, >= 0; normal to the plane of the scene

  bool operator==(const TableFriction&) const = default;
};

// Linear drag: the force -linear * v on a disc that is not fixed; at most one for each disc.
struct Drag {
  int body = 0;
  double linear = 0;  // N s/m, >= 0

  bool operator==(const Drag&) const = default;
};

// A spring with a damper from the centre of a disc to a point or to the centre of another disc. Let d be the vector
// from that point or centre to the disc, n = d / |d|, and w the velocity of the disc relative to it. The force on
// `body` is
//
//   -(stiffness * (|d| - length) + damping * n.w) n       if length > 0
//   -(stiffness * d + damping * w)                        if length = 0: linear in the state, with a damper in every
//                                                         direction
//
// and the opposite force acts on `to`.
struct Spring {
  int body = 0;                    // not fixed
  int to = -1;                     // another body, which may be fixed; -1: the point
  Vec2d point = Vec2d::Zero();     // m; not used with another body
  double stiffness = 0;            // N/m, >= 0
  double length = 0, damping = 0;  // m and N s/m, >= 0

  bool operator==(const Spring&) const = default;
};

// A force that depends on the state. Scenes with a table or pockets cannot have one.
using StateForce = std::variant<Drag, Spring>;

// A pocket. A disc whose centre reaches the circle is out of play: it stays there, at rest, has no contacts, and no
// force moves it.
struct Pocket {
  std::string name;                // as Body::name
  Vec2d position = Vec2d::Zero();  // m, of the centre
  double radius = 0;               // m, > 0

  bool operator==(const Pocket&) const = default;
};

// Contact parameters: restitution and friction of everything without a material, and stiffness and damping of the whole
// scene. Each contact model reads only the parameters that its law has.
struct ContactParameters {
  double restitution = 1;  // e in [0, 1]
  double friction = 0;     // mu >= 0
  double stiffness = 1e4;  // N/m, compliant models; >= 0
  double damping = 0;      // N s/m, compliant models; >= 0

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
  std::string name;     // as Body::name, but without '-'; not "default", the name of everything without a material
  PairContact contact;  // combined by Scene::combine with that of another material

  bool operator==(const Material&) const = default;
};

// Two materials, or one material twice, whose restitution, friction or both are given. A number that is not given is
// combined (Scene::combine).
struct MaterialPair {
  int a = -1, b = -1;  // indices into Scene::materials; -1: no material
  std::optional<double> restitution = std::nullopt, friction = std::nullopt;

  bool operator==(const MaterialPair&) const = default;
};

// How restitution and friction of two materials, each by itself, are combined to those of their pair: the arithmetic
// mean, the product, the smaller or the larger one.
enum class Combine { kMean, kProduct, kMin, kMax };

// The controlled bodies, and the constant force and torque on each from which optimisation starts.
//
// A control has forces only: a torque is stored as torque / radius, the force at the rim with the same moment. The
// effort counts it as this force.
struct Control {
  std::vector<int> bodies;     // indices into Scene::bodies, without repetition; none fixed
  std::vector<Vec2d> initial;  // N, one per controlled body
  // Bounds of the magnitude of each component of the force, and of its norm, N, > 0; one per controlled body, or none.
  // Both may be given: then both hold.
  std::vector<double> max = {}, max_norm = {};
  std::vector<int> torque_bodies = {};      // those of `bodies` (Scene indices) with a torque control too; they spin
  std::vector<double> initial_torque = {};  // N m, counter-clockwise, one for each of `torque_bodies`
  std::vector<double> max_torque = {};  // bound of its magnitude, N m, > 0; one for each of `torque_bodies`, or none

  bool IsBounded() const { return !max.empty() || !max_norm.empty() || !max_torque.empty(); }

  bool operator==(const Control&) const = default;
};

// One term of the loss at the final time T.
struct TerminalTerm {
  enum class Quantity { kPosition, kVelocity, kAngle, kAngularVelocity };
  // A goal region: bounds of each component of the quantity, in its unit; infinite where there is none. An angle or
  // angular velocity has the first pair only.
  struct Region {
    Vec2d min = Vec2d::Constant(-std::numeric_limits<double>::infinity());
    Vec2d max = Vec2d::Constant(std::numeric_limits<double>::infinity());

    // Returns the point of the region that is nearest to q.
    Vec2d Nearest(const Vec2d& q) const { return q.cwiseMax(min).cwiseMin(max); }

    bool operator==(const Region&) const = default;
  };
  int body = 0;
  Quantity quantity = Quantity::kPosition;
  // Without a component the term is weight * |q(T) - target|^2. With one (0 is x, 1 is y) it is weight *
  // q_component(T), which is linear and has no target.
  std::optional<int> component = std::nullopt;
  // m or m/s; not used with a component. An angle or angular velocity is the first entry, rad or rad/s; the other is 0.
  Vec2d target = Vec2d::Zero();
  double weight = 1;  // in 1/(unit of the quantity)^2, >= 0; with a component 1/(unit of the quantity), of any sign
  bool hard = false;  // q(T) = target is a constraint and no part of the loss; it has no component and no weight
  // The constraint min <= q(T) <= max in place of q(T) = target; `hard` must be set. Equal bounds fix a component.
  std::optional<Region> region = std::nullopt;

  // Returns the region of q(T); without one it is the target alone.
  Region Goal() const {
    if (region) return *region;
    return IsRotational() ? Region{Vec2d(target[0], Region().min[1]), Vec2d(target[0], Region().max[1])}
                          : Region{target, target};
  }
  // Returns whether the quantity is an angle or an angular velocity, which is one number and has no component.
  bool IsRotational() const { return quantity == Quantity::kAngle || quantity == Quantity::kAngularVelocity; }

  bool operator==(const TerminalTerm&) const = default;
};

// A running cost: weight * integral of |q(t) - r(t)|^2 dt. q is a position or a velocity; r is linear between the
// targets, and constant before and after them.
struct RunningTerm {
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  std::vector<double> times;   // s, rising; at least one
  std::vector<Vec2d> targets;  // m or m/s, one per time
  double weight = 1;           // 1/(m^2 s) or s/m^2, >= 0

  bool operator==(const RunningTerm&) const = default;
};

// A waypoint cost, weight * |q(time) - target|^2, or constraint, q(time) = target. q is a position or a velocity.
struct ViaTerm {
  int body = 0;
  double time = 0;  // s, in (0, duration)
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
  Vec2d target = Vec2d::Zero();
  double weight = 1;  // 1/m^2 or s^2/m^2, >= 0; not used if hard
  bool hard = false;  // whether it is a constraint

  bool operator==(const ViaTerm&) const = default;
};

// The constraint that the speed of a disc that is not fixed is at most `max`, at the final time or always.
struct SpeedLimit {
  enum class Timing { kEnd, kAlways };
  int body = 0;
  double max = 0;  // m/s, > 0
  Timing at = Timing::kAlways;

  bool operator==(const SpeedLimit&) const = default;
};

// A free final time T. The loss gains weight * T.
struct FreeDuration {
  double min = 0, max = 0;  // s, 0 < min <= max
  double weight = 0;        // 1/s, >= 0

  bool operator==(const FreeDuration&) const = default;
};

// The objective. The loss is the sum of terminal, running and waypoint terms, and effort times the integral of |u|^2
// over time, summed over the controlled bodies; u has the forces and torque / radius.
struct Objective {
  std::vector<TerminalTerm> terminal;
  double effort = 0;  // 1/(N^2 s), >= 0
  std::vector<RunningTerm> running = {};
  std::vector<ViaTerm> via = {};
  std::vector<SpeedLimit> limits = {};
  std::optional<FreeDuration> duration = std::nullopt;  // none: the duration is that of the scene

  // Returns whether every term is a square (no term has a component), so that least-squares solvers apply.
  bool IsSumOfSquares() const;
  // Returns whether a term is hard, or there are speed limits. Bounds on the control do not count.
  bool HasConstraints() const;

  bool operator==(const Objective&) const = default;
};

// The units of a scene's numbers: powers of two in SI units, so that a conversion is exact. Other units are derived:
// that of a speed is length / time.
struct Units {
  double length = 1;             // m
  double time = 1;               // s
  double mass = 1;               // kg
  double loss = 1;               // the unit of the loss; 1 in scenes of users
  Vec2d origin = Vec2d::Zero();  // m, in SI coordinates: the point that has the position [0, 0] in these units
  double loss_at_origin = 0;     // the part of the loss that linear terms have at `origin`, in SI
  bool natural = false;          // whether they are the natural units of the scene (units.h)

  double speed() const { return length / time; }
  double acceleration() const { return speed() / time; }
  double moment_of_inertia() const { return mass * length * length; }
  double force() const { return mass * acceleration(); }

  bool operator==(const Units&) const = default;
};

// A constraint: two discs a < b, or disc a and plane b (an index into Scene::planes), must not touch.
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
    kForce,          // N, constant force on a disc; for identification only
    kLaw,            // a parameter of a learned law of impact, which no scene has; for identification only
    kRadius,         // m
    kPosition,       // m, of a fixed disc
    kDrag,           // N s/m, of a disc that the scene has drag of
    kPlaneOffset,    // m, by which the plane is moved along its normal
    kPlaneAngle,     // rad, by which the plane is rotated about its point, counter-clockwise
    kSegmentOffset,  // m, by which the segment is moved to its left, seen from its first end
    kSegmentAngle,   // rad, by which the segment is rotated about its middle, counter-clockwise
  };
  Kind kind = Kind::kRestitution;
  int body = -1;  // the disc of a mass, force, radius, position or drag; or the index of a plane or a segment
  // The component, 0 is x and 1 is y, of gravity, a force or a position; the number of a law's parameter; or the
  // MaterialPairIndex() (materials.h) of a restitution or friction in a scene with materials.
  int component = 0;

  bool operator==(const SceneParameter&) const = default;
};

// A parameter of the scene that solvers choose in addition to the unknowns that Optimize names. They start at its
// value.
struct DesignParameter {
  SceneParameter parameter;
  std::optional<double> min = std::nullopt, max = std::nullopt;  // in the parameter's unit; min < max
  double moved = 0;  // the offset or angle (m or rad) by which the scene's wall has been moved from the given place

  bool operator==(const DesignParameter&) const = default;
};

// The unknowns of the solvers, beside Scene::design: the control, or velocities or positions at the start.
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
  Vec2d gravity = Vec2d::Zero();  // m/s^2, in the plane of the scene
  std::vector<Body> bodies;
  std::vector<Plane> planes;
  std::vector<EdgeSegment> segments = {};
  std::vector<EdgePolygon> polygons = {};
  std::vector<EdgeArc> arcs = {};
  std::vector<Pocket> pockets = {};
  std::optional<TableFriction> table = std::nullopt;  // none: no friction slows discs but that of contacts
  std::vector<StateForce> forces = {};
  ContactParameters contact;
  std::vector<Material> materials = {};  // none: everything has the restitution and friction of `contact`
  std::vector<MaterialPair> pairs = {};  // no pair twice
  Combine combine = Combine::kMean;      // for pairs without an entry in `pairs`, of one material too
  Control control;                       // empty if nothing is pushed
  Objective objective;
  std::vector<NoContact> no_contact;
  Optimize optimize = Optimize::kNone;
  // For kVelocity and kPosition: indices of the bodies whose velocity or position is free, at least one, none fixed,
  // without repetition.
  std::vector<int> free;
  // For kVelocity: indices of the bodies whose angular velocity is free too. They spin. Without repetition.
  std::vector<int> free_spin = {};
  // Parameters that solvers may change too, without repetition. Offsets and angles are 0 in the given scene.
  std::vector<DesignParameter> design = {};
  Units units = {};  // SI in scenes of users

  double dt() const { return duration / steps; }
  int num_bodies() const { return static_cast<int>(bodies.size()); }
  int num_controlled() const { return static_cast<int>(control.bodies.size()); }
  int num_torques() const { return static_cast<int>(control.torque_bodies.size()); }
  // Returns how many numbers a control has in each interval: [u_x u_y] of each controlled body, and then torque /
  // radius of each body with a torque control. All are forces, N.
  int control_width() const { return 2 * num_controlled() + num_torques(); }
  // Returns the index in a control of the force on controlled body c in interval k.
  std::size_t ForceIndex(std::size_t k, int c) const { return k * control_width() + 2 * static_cast<std::size_t>(c); }
  // Returns the index in a control of torque / radius of body `control.torque_bodies[t]` in interval k.
  std::size_t TorqueIndex(std::size_t k, int t) const { return ForceIndex(k, num_controlled()) + t; }
  // Returns whether any disc spins.
  bool Spins() const;
  // Returns whether a disc or a plane has a prescribed motion.
  bool HasPaths() const;
  // Returns whether there are segments, polygons or arcs.
  bool HasEdges() const { return !segments.empty() || !polygons.empty() || !arcs.empty(); }
};

// The error in a scene: the first violated rule, and its key.
struct SceneError {
  std::string key;      // path in the scene file: "bodies[1].radius"
  std::string message;  // what was found and what was expected

  std::string ToString() const { return key + ": " + message; }
};

// Returns the first rule that `scene` breaks, or std::nullopt. Checked: numbers (see the top), ranges as stated above,
// names that are unique and well formed, indices in range, something to optimise and a terminal term to optimise it for
// (kNone needs neither), and no overlap above kOverlapTolerance, and above what rounding makes of positions far from
// the origin, at the start between discs or of a disc with a plane, a segment, an arc or a polygon (two fixed discs may
// overlap, and a fixed disc may reach into what does not move), and no disc in a pocket there. Quadratic in the number
// of bodies, and of the points of a polygon.
std::optional<SceneError> Validate(const Scene& scene);

// Returns the first rule of Validate() that `scene` breaks and that a simulation relies on: numbers, ranges and
// indices. Names, what is to be optimised and overlaps are not checked. Linear in the size of the scene. Every entry
// point of the library that takes a scene calls this, and refuses a wrong scene with its key.
std::optional<SceneError> ValidateStructure(const Scene& scene);

}  // namespace saltus
