#include "scene/units.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "scene/scene_rules.h"

namespace saltus {
namespace {

constexpr double kFar = 64;  // lengths from the origin; the origin moves by multiples of it

// Whether a number can serve as a scale, which is 1 if there is none.
bool IsSize(double x) { return x > 0 && x < std::numeric_limits<double>::infinity(); }

// Returns the power of two nearest to x on a logarithmic scale, with the exponent floor(log2(x sqrt(2))) exactly.
double NearestPower(double x) { return IsSize(x) ? std::ldexp(1.0, std::ilogb(x * std::numbers::sqrt2)) : 1.0; }

// Returns the power of two nearest to sqrt(square).
double NearestPowerOfRoot(double square) {
  if (!IsSize(square)) return 1;
  const int twice = std::ilogb(2 * square);
  return std::ldexp(1.0, (twice - (twice % 2 + 2) % 2) / 2);
}

struct Extent {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  void Include(double from, double to) {
    low = std::min(low, from);
    high = std::max(high, to);
  }
  double size() const { return high > low ? high - low : 0; }
  double middle() const { return high >= low ? low + 0.5 * (high - low) : 0; }
};

bool IsPositionTarget(const TerminalTerm& term) {
  return term.quantity == TerminalTerm::Quantity::kPosition && !term.component;
}

// Calls visit(point) for points whose convex hull has the scene's segments, polygons, arcs and pockets in it.
template <typename Visit>
void VisitEdges(const Scene& scene, const Visit& visit) {
  for (const EdgeSegment& segment : scene.segments) {
    visit(segment.from);
    visit(segment.to);
  }
  for (const EdgePolygon& polygon : scene.polygons) {
    for (const Vec2d& point : polygon.points) visit(point);
  }
  for (const EdgeArc& arc : scene.arcs) {
    for (const double side : {-arc.radius, arc.radius}) visit(Vec2d(arc.center + Vec2d(side, side)));
  }
  for (const Pocket& pocket : scene.pockets) {
    for (const double side : {-pocket.radius, pocket.radius}) visit(Vec2d(pocket.position + Vec2d(side, side)));
  }
}

// Returns the extent of discs and targets along one axis.
Extent ExtentOf(const Scene& scene, int axis) {
  Extent extent;
  for (const Body& body : scene.bodies) {
    extent.Include(body.position[axis] - body.radius, body.position[axis] + body.radius);
  }
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (!IsPositionTarget(term)) continue;
    const TerminalTerm::Region goal = term.Goal();
    for (const double bound : {goal.min[axis], goal.max[axis]}) {
      if (std::isfinite(bound)) extent.Include(bound, bound);
    }
  }
  VisitEdges(scene, [&](const Vec2d& point) { extent.Include(point[axis], point[axis]); });
  return extent;
}

double LengthOf(const Scene& scene) {
  double length = std::max(ExtentOf(scene, 0).size(), ExtentOf(scene, 1).size());
  for (const Plane& plane : scene.planes) {
    const Vec2d normal = plane.normal.normalized();
    for (const Body& body : scene.bodies) {
      if (!body.fixed) length = std::max(length, std::abs(Dot(normal, Vec2d(body.position - plane.point))));
    }
  }
  return NearestPower(length);
}

double MassOf(const Scene& scene) {
  double mass = 0;
  for (int body : scene.control.bodies) mass = std::max(mass, scene.bodies[body].mass);
  for (size_t i = 0; scene.control.bodies.empty() && i < scene.bodies.size(); ++i) {
    if (!scene.bodies[i].fixed) mass = std::max(mass, scene.bodies[i].mass);
  }
  return NearestPower(mass);
}

double SpeedOf(const Scene& scene, double length) {
  const double mean = length / scene.duration;
  const double table = scene.table ? scene.table->friction * scene.table->gravity : 0;
  double square = mean * mean, gravity = scene.gravity.norm() + table, acceleration = gravity;
  for (const Body& body : scene.bodies) {
    square = std::max(square, body.velocity.squaredNorm());
    // Friction can turn the speed of the rim into a speed of the disc.
    if (body.Spins()) square = std::max(square, std::pow(body.radius * body.angular_velocity, 2));
  }
  for (size_t i = 0; i < scene.control.bodies.size(); ++i) {
    const double push = scene.control.initial[i].norm() / scene.bodies[scene.control.bodies[i]].mass;
    acceleration = std::max(acceleration, gravity + push);
  }
  for (int t = 0; t < scene.num_torques(); ++t) {  // of the rim
    const Body& body = scene.bodies[scene.control.torque_bodies[t]];
    const double push = std::abs(scene.control.initial_torque[t]) * body.radius / body.MomentOfInertia();
    acceleration = std::max(acceleration, gravity + push);
  }
  for (const TerminalTerm& term : scene.objective.terminal) {
    const bool velocity = term.quantity == TerminalTerm::Quantity::kVelocity && !term.component;
    if (velocity) square = std::max(square, term.target.squaredNorm());
  }
  return NearestPowerOfRoot(std::max(square, acceleration * length));
}

// Returns the natural unit of the loss, given the other units.
double LossOf(const Scene& scene, const Units& units) {
  double loss = 0;
  for (const TerminalTerm& term : scene.objective.terminal) {
    const double size = UnitFactors(units, {}).of(term.quantity);
    loss = std::max(loss, std::abs(term.weight) * (term.component ? size : size * size));
  }
  if (!scene.control.bodies.empty()) {
    // The force that accelerates the mass over the length in the duration.
    const double force = units.mass * units.length / (scene.duration * scene.duration);
    loss = std::max(loss, scene.objective.effort * force * force * scene.duration);
  }
  if (scene.objective.duration) loss = std::max(loss, scene.objective.duration->weight * scene.duration);
  return NearestPower(loss);
}

}  // namespace

UnitFactors::UnitFactors(const Units& from, const Units& to)
    : length(from.length / to.length),
      time(from.time / to.time),
      mass(from.mass / to.mass),
      loss(from.loss / to.loss),
      speed(from.speed() / to.speed()),
      acceleration(from.acceleration() / to.acceleration()),
      force(from.force() / to.force()),
      rate(to.time / from.time),
      moment_of_inertia(from.moment_of_inertia() / to.moment_of_inertia()) {}

double UnitFactors::of(TerminalTerm::Quantity quantity) const {
  const double factors[] = {length, speed, 1, rate};  // by quantity
  return factors[static_cast<int>(quantity)];
}

double UnitFactors::of(const SceneParameter& parameter) const {
  using Kind = SceneParameter::Kind;
  switch (parameter.kind) {
    case Kind::kRestitution:
    case Kind::kFriction:
    case Kind::kLaw:
    case Kind::kPlaneAngle:
    case Kind::kSegmentAngle:
      return 1;
    case Kind::kStiffness:
      return force / length;
    case Kind::kDamping:
    case Kind::kDrag:
      return force / speed;
    case Kind::kMass:
      return mass;
    case Kind::kGravity:
      return acceleration;
    case Kind::kForce:
      return force;
    case Kind::kRadius:
    case Kind::kPosition:
    case Kind::kPlaneOffset:
    case Kind::kSegmentOffset:
      break;
  }
  return length;
}

Units NaturalUnits(const Scene& scene) {
  if (scene.units.natural) return scene.units;
  if (BrokenRule(scene)) {  // whoever asks is told so by what checks it
    Units units = scene.units;
    units.natural = true;
    return units;
  }
  // The units are found in the scene's present units first.
  Units units;
  units.length = LengthOf(scene);
  units.mass = MassOf(scene);
  units.time = units.length / SpeedOf(scene, units.length);
  units.loss = LossOf(scene, units);
  const double far = kFar * units.length;
  for (int axis = 0; axis < 2; ++axis) units.origin[axis] = far * std::round(ExtentOf(scene, axis).middle() / far);
  for (const TerminalTerm& term : scene.objective.terminal) {
    const bool linear = term.quantity == TerminalTerm::Quantity::kPosition && term.component;
    if (linear) units.loss_at_origin += term.weight * units.origin[*term.component];
  }
  const Units& given = scene.units;
  units.length *= given.length;
  units.mass *= given.mass;
  units.time *= given.time;
  units.loss *= given.loss;
  units.origin = given.origin + given.length * units.origin;
  units.loss_at_origin = given.loss_at_origin + given.loss * units.loss_at_origin;
  units.natural = true;
  return units;
}

Vec2d ConvertPosition(const Vec2d& position, const Units& from, const Units& to) {
  Vec2d moved = from.length * position;
  if (from.origin != to.origin) moved = (moved + from.origin) - to.origin;
  return moved / to.length;
}

double ConvertParameter(const SceneParameter& parameter, double value, const Units& from, const Units& to) {
  if (parameter.kind != SceneParameter::Kind::kPosition) return UnitFactors(from, to).of(parameter) * value;
  Vec2d position = from.origin;
  position[parameter.component] = value;
  return ConvertPosition(position, from, to)[parameter.component];
}

double ConvertLoss(double loss, const Units& from, const Units& to) {
  return (loss * from.loss + (from.loss_at_origin - to.loss_at_origin)) / to.loss;
}

std::vector<double> ConvertStates(std::vector<double> states, const Units& from, const Units& to) {
  const double speed = UnitFactors(from, to).speed;
  for (size_t i = 0; i + 4 <= states.size(); i += 4) {
    const Vec2d position = ConvertPosition({states[i], states[i + 1]}, from, to);
    states[i] = position[0];
    states[i + 1] = position[1];
    states[i + 2] *= speed;
    states[i + 3] *= speed;
  }
  return states;
}

std::vector<double> ConvertInitial(std::vector<double> initial, int bodies, const Units& from, const Units& to) {
  const size_t moves = std::min(initial.size(), 4 * static_cast<size_t>(bodies));
  const std::vector<double> rotations(initial.begin() + static_cast<std::ptrdiff_t>(moves), initial.end());
  initial.resize(moves);
  initial = ConvertStates(std::move(initial), from, to);
  const double rate = UnitFactors(from, to).rate;
  for (size_t i = 0; i < rotations.size(); ++i) initial.push_back(i % 2 == 0 ? rotations[i] : rate * rotations[i]);
  return initial;
}

std::vector<double> Multiplied(std::vector<double> numbers, double factor) {
  for (double& number : numbers) number *= factor;
  return numbers;
}

Scene ToUnits(const Scene& scene, const Units& units) {
  const UnitFactors by(scene.units, units);
  const auto convert_position = [&](Vec2d* position) { *position = ConvertPosition(*position, scene.units, units); };
  const auto convert_path = [&](PrescribedMotion* path) {
    path->times = Multiplied(std::move(path->times), by.time);
    for (Vec2d& position : path->positions) convert_position(&position);
  };
  Scene out = scene;
  out.units = units;
  out.duration *= by.time;
  out.gravity *= by.acceleration;
  for (Body& body : out.bodies) {
    body.radius *= by.length;
    body.mass *= by.mass;
    convert_position(&body.position);
    if (body.path) convert_path(&*body.path);
    body.velocity *= by.speed;
    body.inertia.moment *= by.moment_of_inertia;
    body.angular_velocity *= by.rate;
  }
  for (Plane& plane : out.planes) {
    convert_position(&plane.point);
    if (plane.motion) convert_path(&*plane.motion);
  }
  for (EdgeSegment& segment : out.segments) {
    convert_position(&segment.from);
    convert_position(&segment.to);
  }
  for (EdgePolygon& polygon : out.polygons) {
    for (Vec2d& point : polygon.points) convert_position(&point);
  }
  for (EdgeArc& arc : out.arcs) {
    convert_position(&arc.center);
    arc.radius *= by.length;
  }
  for (Pocket& pocket : out.pockets) {
    convert_position(&pocket.position);
    pocket.radius *= by.length;
  }
  if (out.table) out.table->gravity *= by.acceleration;
  for (StateForce& force : out.forces) {
    if (auto* drag = std::get_if<Drag>(&force)) drag->linear *= by.force / by.speed;
    auto* spring = std::get_if<Spring>(&force);
    if (spring == nullptr) continue;
    convert_position(&spring->point);
    spring->stiffness *= by.force / by.length;
    spring->length *= by.length;
    spring->damping *= by.force / by.speed;
  }
  out.contact.stiffness *= by.force / by.length;
  out.contact.damping *= by.force / by.speed;
  for (Vec2d& force : out.control.initial) force *= by.force;
  out.control.max = Multiplied(std::move(out.control.max), by.force);
  out.control.max_norm = Multiplied(std::move(out.control.max_norm), by.force);
  out.control.initial_torque = Multiplied(std::move(out.control.initial_torque), by.force * by.length);
  out.control.max_torque = Multiplied(std::move(out.control.max_torque), by.force * by.length);
  using Quantity = TerminalTerm::Quantity;
  const auto size_of = [&](const auto& term) { return by.of(term.quantity); };
  const auto convert_target = [&](const auto& term, Vec2d* target) {
    if (term.quantity == Quantity::kPosition) {
      convert_position(target);
    } else {
      *target *= size_of(term);
    }
  };
  for (TerminalTerm& term : out.objective.terminal) {
    if (!term.component) convert_target(term, &term.target);
    if (term.region) convert_target(term, &term.region->min);
    if (term.region) convert_target(term, &term.region->max);
    term.weight *= by.loss / (term.component ? size_of(term) : size_of(term) * size_of(term));
  }
  for (ViaTerm& term : out.objective.via) {
    convert_target(term, &term.target);
    term.time *= by.time;
    term.weight *= by.loss / (size_of(term) * size_of(term));
  }
  for (SpeedLimit& limit : out.objective.limits) limit.max *= by.speed;
  for (RunningTerm& term : out.objective.running) {
    for (Vec2d& target : term.targets) convert_target(term, &target);
    term.times = Multiplied(std::move(term.times), by.time);
    term.weight *= by.loss / (size_of(term) * size_of(term) * by.time);
  }
  if (std::optional<FreeDuration>& free = out.objective.duration) {
    free->min *= by.time;
    free->max *= by.time;
    free->weight *= by.loss / by.time;
  }
  out.objective.effort *= by.loss / (by.force * by.force * by.time);
  for (DesignParameter& design : out.design) {
    for (std::optional<double>* bound : {&design.min, &design.max}) {
      if (*bound) *bound = ConvertParameter(design.parameter, **bound, scene.units, units);
    }
    if (design.moved != 0) design.moved = ConvertParameter(design.parameter, design.moved, scene.units, units);
  }
  return out;
}

Scene NearOrigin(const Scene& scene) {
  const Units natural = NaturalUnits(scene);
  Units units = scene.units;
  units.origin = natural.origin;
  units.loss_at_origin = natural.loss_at_origin;
  return ToUnits(scene, units);
}

Scene ToNaturalUnits(const Scene& scene) { return scene.units.natural ? scene : ToUnits(scene, NaturalUnits(scene)); }

}  // namespace saltus
