#include "saltus/hybrid/rigid_bodies.h"

#include <glog/logging.h>

#include <algorithm>

namespace saltus {
namespace {

double Cross(const Point2D& a, const Point2D& b) { return a[0] * b[1] - a[1] * b[0]; }
Point2D Minus(const Point2D& a, const Point2D& b) { return {a[0] - b[0], a[1] - b[1]}; }
bool IsUnit(const Point2D& vector) { return std::abs(std::hypot(vector[0], vector[1]) - 1) < 1e-9; }

// Returns the moment of inertia about the origin of a polygon of uniform density and mass 1.
double UniformInertia(const std::vector<Point2D>& polygon) {
  double area = 0, moment = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Point2D &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
    const double cross = Cross(a, b);
    area += cross / 2;
    moment += cross * (a[0] * a[0] + a[0] * b[0] + b[0] * b[0] + a[1] * a[1] + a[1] * b[1] + b[1] * b[1]) / 12;
  }
  return moment / area;
}

}  // namespace

std::vector<Point2D> BoxPolygon(double half_width, double half_height) {
  return {
      {-half_width, -half_height}, {half_width, -half_height}, {half_width, half_height}, {-half_width, half_height}};
}

std::string Validate(const RigidBody2D& body) {
  if ((body.radius > 0) == !body.polygon.empty()) return "expected either a polygon or a radius above zero";
  if (!(body.mass > 0)) return "found mass " + std::to_string(body.mass) + ", expected more than zero";
  if (!(body.inertia >= 0)) return "found a negative inertia";
  if (!body.polygon.empty() && body.polygon.size() < 3) return "found a polygon of less than three vertices";
  for (std::size_t i = 0; i < body.polygon.size(); ++i) {
    const std::size_t count = body.polygon.size();
    const Point2D &a = body.polygon[i], &b = body.polygon[(i + 1) % count], &c = body.polygon[(i + 2) % count];
    if (!(Cross(Minus(b, a), Minus(c, b)) > 0)) return "the polygon is not convex and counterclockwise";
  }
  if (body.joint.kind == RigidJoint2D::Kind::kPrismatic && !IsUnit(body.joint.axis)) {
    return "the axis of its joint has another length than 1";
  }
  return "";
}

std::string Validate(const RigidScene2D& scene) {
  bool moves = false;
  for (const RigidBody2D& body : scene.bodies) {
    const std::string wrong = Validate(body);
    if (!wrong.empty()) return "body '" + body.name + "': " + wrong;
    moves = moves || body.joint.kind != RigidJoint2D::Kind::kWeld;
  }
  if (!moves) return "no body can move";
  for (const RigidPlane2D& plane : scene.planes) {
    if (!IsUnit(plane.normal)) return "the normal of a plane has another length than 1";
  }
  if (!(scene.restitution >= 0 && scene.restitution <= 1)) return "expected a restitution from 0 to 1";
  if (!(scene.friction >= 0)) return "expected a friction of zero or more";
  return "";
}

RigidBodies2D::RigidBodies2D(RigidScene2D scene) : scene_(std::move(scene)) {
  CHECK_EQ(Validate(scene_), "");
  const auto count = scene_.bodies.size();
  normals_.resize(count);
  for (std::size_t b = 0; b < count; ++b) {
    const RigidBody2D& body = scene_.bodies[b];
    first_.push_back(size_);
    size_ += Count(b);
    const double uniform = body.polygon.empty() ? 0.5 * body.radius * body.radius : UniformInertia(body.polygon);
    inertia_.push_back(body.inertia > 0 ? body.inertia : body.mass * uniform);
    size_of_.push_back(0);
    for (std::size_t i = 0; i < body.polygon.size(); ++i) {
      size_of_[b] = std::max(size_of_[b], std::hypot(body.polygon[i][0], body.polygon[i][1]));
      const Point2D edge = Minus(body.polygon[(i + 1) % body.polygon.size()], body.polygon[i]);
      const double length = std::hypot(edge[0], edge[1]);
      normals_[b].push_back({edge[1] / length, -edge[0] / length});
    }
  }
  const auto fixed = [&](std::size_t b) { return scene_.bodies[b].joint.kind == RigidJoint2D::Kind::kWeld; };
  for (std::size_t a = 0; a < count; ++a) {
    const auto vertices = static_cast<int>(scene_.bodies[a].polygon.size());
    for (int plane = 0; plane < static_cast<int>(scene_.planes.size()) && !fixed(a); ++plane) {
      for (int v = 0; v < vertices; ++v) contacts_.push_back({Contact::kVertexPlane, static_cast<int>(a), plane, v, 0});
      if (vertices == 0) contacts_.push_back({Contact::kDiscPlane, static_cast<int>(a), plane, 0, 0});
    }
    for (std::size_t b = 0; b < count; ++b) {
      if (a == b || (fixed(a) && fixed(b))) continue;
      const auto edges = static_cast<int>(scene_.bodies[b].polygon.size());
      for (int v = 0; v < vertices; ++v) {
        for (int e = 0; e < edges; ++e) {
          contacts_.push_back({Contact::kVertexEdge, static_cast<int>(a), static_cast<int>(b), v, e});
        }
      }
      if (vertices > 0) continue;
      if (edges > 0) contacts_.push_back({Contact::kDiscPolygon, static_cast<int>(a), static_cast<int>(b), 0, 0});
      if (edges == 0 && a < b)
        contacts_.push_back({Contact::kDiscDisc, static_cast<int>(a), static_cast<int>(b), 0, 0});
    }
  }
}

std::string RigidBodies2D::NameOf(const Contact& contact) const {
  std::string name = scene_.bodies[contact.a].name;
  if (!scene_.bodies[contact.a].polygon.empty()) name += "." + std::to_string(contact.vertex);
  if (contact.kind == Contact::kVertexPlane || contact.kind == Contact::kDiscPlane) {
    return name + "-plane " + std::to_string(contact.b);
  }
  name += "-" + scene_.bodies[contact.b].name;
  return contact.kind == Contact::kVertexEdge ? name + "." + std::to_string(contact.edge) : name;
}

MechanicalLayout RigidBodies2D::Layout() const {
  MechanicalLayout layout{.num_coordinates = size_,
                          .num_parameters = 4,
                          .num_contacts = static_cast<int>(contacts_.size()),
                          .parameter_names = {"restitution", "friction", "gravity_x", "gravity_y"}};
  for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
    const RigidBody2D& body = scene_.bodies[b];
    const std::array<const char*, 3> free = {".x", ".y", ".angle"};
    for (int i = 0; i < Count(b); ++i) {
      layout.coordinate_names.push_back(body.name + (Count(b) >= 2               ? free[i]
                                                     : TurningCoordinate(b) == 0 ? ".angle"
                                                                                 : ".distance"));
    }
    if (!body.pushed) continue;
    layout.num_controls += 3;
    for (const char* what : {".force_x", ".force_y", ".torque"}) layout.control_names.push_back(body.name + what);
  }
  for (const Contact& contact : contacts_) {
    layout.contact_names.push_back(NameOf(contact));
    layout.has_friction.push_back(scene_.friction > 0);
    layout.has_reach.push_back(contact.kind == Contact::kVertexEdge);
    std::vector<int>& coordinates = layout.contact_coordinates.emplace_back();
    const bool meets_plane = contact.kind == Contact::kVertexPlane || contact.kind == Contact::kDiscPlane;
    for (int body = 0; body < static_cast<int>(scene_.bodies.size()); ++body) {
      if (body != contact.a && (meets_plane || body != contact.b)) continue;
      for (int i = 0; i < Count(body); ++i) coordinates.push_back(first_[body] + i);
    }
  }
  return layout;
}

std::vector<double> RigidBodies2D::InitialState() const {
  std::vector<double> q, v;
  for (const RigidBody2D& body : scene_.bodies) {
    switch (body.joint.kind) {
      case RigidJoint2D::Kind::kFree:
        q.insert(q.end(), {body.position[0], body.position[1], body.angle});
        v.insert(v.end(), {body.velocity[0], body.velocity[1], body.spin});
        break;
      case RigidJoint2D::Kind::kTranslation:
        q.insert(q.end(), body.position.begin(), body.position.end());
        v.insert(v.end(), body.velocity.begin(), body.velocity.end());
        break;
      case RigidJoint2D::Kind::kRevolute:
        q.push_back(body.angle);
        v.push_back(body.spin);
        break;
      case RigidJoint2D::Kind::kPrismatic:
        q.push_back(0);
        v.push_back(body.velocity[0] * body.joint.axis[0] + body.velocity[1] * body.joint.axis[1]);
        break;
      case RigidJoint2D::Kind::kWeld:
        break;
    }
  }
  q.insert(q.end(), v.begin(), v.end());
  return q;
}

double RigidBodies2D::MassOf(std::size_t body, int coordinate) const {
  const RigidBody2D& of = scene_.bodies[body];
  switch (of.joint.kind) {
    case RigidJoint2D::Kind::kRevolute: {
      const Point2D arm = Minus(of.position, of.joint.point);
      return inertia_[body] + of.mass * (arm[0] * arm[0] + arm[1] * arm[1]);
    }
    default:
      return coordinate == 2 ? inertia_[body] : of.mass;
  }
}

double RigidBodies2D::EnergyOf(const double* x, const double* p) const {
  double energy = 0;
  for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
    for (int i = 0; i < Count(b); ++i) {
      const double rate = x[size_ + first_[b] + i];
      energy += 0.5 * MassOf(b, i) * rate * rate;
    }
    const Pose<double> pose = PoseAt(static_cast<int>(b), x);
    energy -= scene_.bodies[b].mass * (p[2] * pose.x + p[3] * pose.y);
  }
  return energy;
}

}  // namespace saltus
