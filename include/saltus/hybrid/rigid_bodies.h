// Planar rigid bodies as a mechanical system: convex polygons and discs with friction, whose contacts are generated.
//
//   RigidBodies2D scene({.bodies = {{.name = "box", .polygon = BoxPolygon(0.2, 0.1), .mass = 2, .position = {0, 1}}},
//                        .planes = {{.point = {0, 0}, .normal = {0, 1}}}});
//   MechanicalSystem system(scene);
//   HybridSimulator simulator(system.hybrid());
//   simulator.Rollout({.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = 2});
//
// Contacts: each vertex or disc against each plane; each vertex of a polygon against each edge of another; each disc
// against each polygon and disc. A vertex that slides off the end of an edge opens its contact. Bodies may lie flush on
// each other, as boxes of one width in a column, and slide over the joint of two others that are flush.
// Restitution and friction are the same at all contacts. Units are SI; angles are in rad, counterclockwise.
//
// The normal n of a contact of bodies a and b points towards a, which has the vertex or is the disc (of two discs the
// first), or away from the plane. v_t is the velocity of a's point of contact relative to b along (n_y, -n_x), which is
// n rotated clockwise: opposite to Perpendicular(n) of scenes (scene/geometry.h).
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "saltus/internal/mechanical_functions.h"

namespace saltus {

using Point2D = std::array<double, 2>;

// How a body may move: freely (3 coordinates); without rotation (2); about a point that is fixed in the world (1);
// along an axis, without rotation (1); not at all (0).
struct RigidJoint2D {
  enum class Kind { kFree, kTranslation, kRevolute, kPrismatic, kWeld } kind = Kind::kFree;
  Point2D point = {0, 0};  // kRevolute: in the world
  Point2D axis = {1, 0};   // kPrismatic: of length 1, in the world
};

// A body at the initial time. Velocities that its joint does not allow are not read.
struct RigidBody2D {
  std::string name = "body";
  // Either the vertices of a convex polygon, counterclockwise, relative to the centre of mass, or the radius of a disc.
  std::vector<Point2D> polygon = {};
  double radius = 0;                             // m; 0 for a polygon
  double mass = 1;                               // kg, > 0
  double inertia = 0;                            // kg m^2, about the centre of mass; 0: that of uniform density
  Point2D position = {0, 0}, velocity = {0, 0};  // of the centre of mass
  double angle = 0, spin = 0;
  RigidJoint2D joint = {};
  // Whether the control has a force (N) along x and y at the centre of mass, and a torque (N m), for the body. The
  // three follow those of the pushed bodies before it; parts that the joint does not allow have no effect.
  bool pushed = false;
};

// A half-plane. Bodies stay on the side of the normal, which has length 1.
struct RigidPlane2D {
  Point2D point = {0, 0}, normal = {0, 1};
};

struct RigidScene2D {
  std::vector<RigidBody2D> bodies;
  std::vector<RigidPlane2D> planes = {};
  Point2D gravity = {0, -9.81};
  double restitution = 0.5, friction = 0.3;
};

// Returns the vertices of a rectangle about its centre, counterclockwise from the lower left one.
std::vector<Point2D> BoxPolygon(double half_width, double half_height);

// Returns the first error as "found x, expected y"; empty if there is none.
std::string Validate(const RigidBody2D& body);
std::string Validate(const RigidScene2D& scene);

// The coordinates are x, y and the angle of a free body; x and y of a body without rotation; the angle of a body on a
// revolute joint; the distance from the given position along the axis of a prismatic joint. The parameters are
// restitution, friction, and gravity along x and y.
class RigidBodies2D {
 public:
  // Precondition: Validate(scene) is empty.
  explicit RigidBodies2D(RigidScene2D scene);

  const RigidScene2D& scene() const { return scene_; }
  // Returns the sizes and names of the mechanical system: coordinates such as "box.x", contacts such as "box.0-plane 0"
  // (vertex 0 of the body).
  MechanicalLayout Layout() const;
  // Returns [q v]: the coordinates of all bodies in order, and then their rates.
  std::vector<double> InitialState() const;
  std::vector<double> Parameters() const {
    return {scene_.restitution, scene_.friction, scene_.gravity[0], scene_.gravity[1]};
  }
  // Returns [x y angle] of a body in a state, of which only q is read.
  std::array<double, 3> PoseOf(int body, const double* x) const {
    const Pose<double> pose = PoseAt(body, x);
    return {pose.x, pose.y, pose.angle};
  }
  // Returns the kinetic energy and the potential energy of gravity in a state [q v], J.
  double EnergyOf(const double* x, const double* p) const;
  // Returns the moment of inertia of a body about its centre of mass, kg m^2.
  double InertiaOf(int body) const { return inertia_[body]; }

  // Draws outlines of bodies, a radius of each disc, and planes, for the replay of a program
  // (programs/hybrid_program.h).
  template <typename Drawing>
  void Draw(int /*mode*/, double /*t*/, const double* x, const double* /*p*/, Drawing* drawing) const {
    constexpr double kReach = 2;  // m, of a plane to each side of its point
    for (const RigidPlane2D& plane : scene_.planes) {
      const double along_x = kReach * plane.normal[1], along_y = -kReach * plane.normal[0];
      drawing->Line(
          plane.point[0] - along_x, plane.point[1] - along_y, plane.point[0] + along_x, plane.point[1] + along_y);
    }
    for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
      const RigidBody2D& body = scene_.bodies[b];
      const Pose<double> pose = PoseAt(static_cast<int>(b), x);
      const double c = std::cos(pose.angle), s = std::sin(pose.angle);
      const auto place = [&](const Point2D& of) {
        return Point2D{pose.x + c * of[0] - s * of[1], pose.y + s * of[0] + c * of[1]};
      };
      for (std::size_t i = 0; i < body.polygon.size(); ++i) {
        const Point2D from = place(body.polygon[i]), to = place(body.polygon[(i + 1) % body.polygon.size()]);
        drawing->Line(from[0], from[1], to[0], to[1]);
      }
      if (!body.polygon.empty()) continue;
      const Point2D rim = place({body.radius, 0});
      drawing->Circle(pose.x, pose.y, body.radius);
      drawing->Line(pose.x, pose.y, rim[0], rim[1]);
    }
  }

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    for (int i = 0; i < size_ * size_; ++i) M[i] = T(0.0);
    for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
      for (int i = 0; i < Count(b); ++i) M[(first_[b] + i) * (size_ + 1)] = T(MassOf(b, i));
    }
  }
  template <typename T>
  void Force(const T&, const T* q, const T*, const T* u, const T* p, T* h) const {
    for (int i = 0; i < size_; ++i) h[i] = T(0.0);
    const T* control = u;
    for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
      const RigidBody2D& body = scene_.bodies[b];
      T force[2] = {body.mass * p[2], body.mass * p[3]};
      T torque(0.0);
      if (body.pushed) {
        force[0] += control[0];
        force[1] += control[1];
        torque = control[2];
        control += 3;
      }
      const Pose<T> pose = PoseAt(static_cast<int>(b), q);
      T row[3] = {T(0.0), T(0.0), T(0.0)};
      for (int k = 0; k < 2; ++k) {
        RowOf(static_cast<int>(b), pose, pose.x, pose.y, T(k == 0 ? 1.0 : 0.0), T(k == 1 ? 1.0 : 0.0), row);
        for (int i = 0; i < Count(b); ++i) h[first_[b] + i] += force[k] * row[i];
      }
      const int turns = TurningCoordinate(b);
      if (turns >= 0) h[first_[b] + turns] += torque;
    }
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return ClosestAt(contact, q).gap;
  }
  template <typename T>
  void SlideRow(int contact, const T* q, const T*, T* row) const {
    for (int i = 0; i < size_; ++i) row[i] = T(0.0);
    const Contact& of = contacts_[contact];
    const Closest<T> at = ClosestAt(contact, q);
    T entries[3] = {T(0.0), T(0.0), T(0.0)};
    RowOf(of.a, PoseAt(of.a, q), at.x, at.y, at.normal_y, -at.normal_x, entries);
    for (int i = 0; i < Count(of.a); ++i) row[first_[of.a] + i] += entries[i];
    if (of.kind == Contact::kVertexPlane || of.kind == Contact::kDiscPlane) return;
    RowOf(of.b, PoseAt(of.b, q), at.x, at.y, at.normal_y, -at.normal_x, entries);
    for (int i = 0; i < Count(of.b); ++i) row[first_[of.b] + i] -= entries[i];
  }
  // The distance of a vertex from the line through the edge, where the gap has a kink at the ends of the edge.
  template <typename T>
  T Distance(int contact, const T* q, const T*) const {
    const Closest<T> at = ClosestAt(contact, q);
    return contacts_[contact].kind == Contact::kVertexEdge ? at.from_line : at.gap;
  }
  // The reach of a vertex on an edge: its distance from the lines through the edges beside it.
  template <typename T>
  T Reach(int contact, const T* q, const T*) const {
    return ClosestAt(contact, q).reach;
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[1];
  }

 private:
  template <typename T>
  struct Pose {
    T x, y, angle;
  };
  // The point of contact, the normal from b or the plane towards a, the gap, how far the point is from the ends of what
  // the gap is measured from, and of a vertex on an edge the distance from the line through the edge.
  template <typename T>
  struct Closest {
    T x, y, normal_x, normal_y, gap, reach, from_line;
  };
  struct Contact {
    enum Kind { kVertexPlane, kDiscPlane, kVertexEdge, kDiscPolygon, kDiscDisc } kind;
    int a = 0, b = 0;          // bodies; kVertexPlane, kDiscPlane: b is a plane
    int vertex = 0, edge = 0;  // of a, of b
  };

  int Count(std::size_t body) const {
    switch (scene_.bodies[body].joint.kind) {
      case RigidJoint2D::Kind::kFree:
        return 3;
      case RigidJoint2D::Kind::kTranslation:
        return 2;
      case RigidJoint2D::Kind::kWeld:
        return 0;
      default:
        return 1;
    }
  }
  double MassOf(std::size_t body, int coordinate) const;
  // The coordinate that is an angle; -1 if there is none.
  int TurningCoordinate(std::size_t body) const {
    const RigidJoint2D::Kind kind = scene_.bodies[body].joint.kind;
    return kind == RigidJoint2D::Kind::kFree ? 2 : kind == RigidJoint2D::Kind::kRevolute ? 0 : -1;
  }
  std::string NameOf(const Contact& contact) const;

  template <typename T>
  Pose<T> PoseAt(int body, const T* q) const {
    using std::cos, std::sin;
    const RigidBody2D& of = scene_.bodies[body];
    const T* own = q + first_[body];
    switch (of.joint.kind) {
      case RigidJoint2D::Kind::kFree:
        return {own[0], own[1], own[2]};
      case RigidJoint2D::Kind::kTranslation:
        return {own[0], own[1], T(of.angle)};
      case RigidJoint2D::Kind::kRevolute: {
        const double dx = of.position[0] - of.joint.point[0], dy = of.position[1] - of.joint.point[1];
        const T turn = own[0] - of.angle, c = cos(turn), s = sin(turn);
        return {of.joint.point[0] + (dx * c - dy * s), of.joint.point[1] + (dx * s + dy * c), own[0]};
      }
      case RigidJoint2D::Kind::kPrismatic:
        return {of.position[0] + of.joint.axis[0] * own[0], of.position[1] + of.joint.axis[1] * own[0], T(of.angle)};
      default:
        return {T(of.position[0]), T(of.position[1]), T(of.angle)};
    }
  }
  // How the velocity along (t_x, t_y) of the body's point at (x, y) depends on the rates of its coordinates.
  template <typename T>
  void RowOf(int body, const Pose<T>& pose, const T& x, const T& y, const T& t_x, const T& t_y, T* row) const {
    const RigidJoint2D& joint = scene_.bodies[body].joint;
    switch (joint.kind) {
      case RigidJoint2D::Kind::kFree:
        row[0] = t_x;
        row[1] = t_y;
        row[2] = (x - pose.x) * t_y - (y - pose.y) * t_x;
        return;
      case RigidJoint2D::Kind::kTranslation:
        row[0] = t_x;
        row[1] = t_y;
        return;
      case RigidJoint2D::Kind::kRevolute:
        row[0] = (x - joint.point[0]) * t_y - (y - joint.point[1]) * t_x;
        return;
      case RigidJoint2D::Kind::kPrismatic:
        row[0] = joint.axis[0] * t_x + joint.axis[1] * t_y;
        return;
      default:
        return;
    }
  }

  template <typename T>
  Closest<T> ClosestAt(int contact, const T* q) const {
    using std::cos, std::sin, std::sqrt;
    const Contact& of = contacts_[contact];
    const RigidBody2D& body = scene_.bodies[of.a];
    const Pose<T> a = PoseAt(of.a, q);
    Closest<T> at{a.x, a.y, T(0.0), T(0.0), T(0.0), T(1.0), T(0.0)};
    T a_c(1.0), a_s(0.0);
    if (of.kind == Contact::kVertexPlane || of.kind == Contact::kVertexEdge) {
      const Point2D& vertex = body.polygon[of.vertex];
      a_c = cos(a.angle);
      a_s = sin(a.angle);
      at.x += vertex[0] * a_c - vertex[1] * a_s;
      at.y += vertex[0] * a_s + vertex[1] * a_c;
    }
    if (of.kind == Contact::kVertexPlane || of.kind == Contact::kDiscPlane) {
      const RigidPlane2D& plane = scene_.planes[of.b];
      at.gap = plane.normal[0] * (at.x - plane.point[0]) + plane.normal[1] * (at.y - plane.point[1]);
      at.normal_x = T(plane.normal[0]);
      at.normal_y = T(plane.normal[1]);
      if (of.kind == Contact::kVertexPlane) return at;
      at.gap -= body.radius;
      at.x -= body.radius * at.normal_x;
      at.y -= body.radius * at.normal_y;
      return at;
    }
    const RigidBody2D& other = scene_.bodies[of.b];
    const Pose<T> b = PoseAt(of.b, q);
    if (of.kind == Contact::kDiscDisc) {
      const T dx = a.x - b.x, dy = a.y - b.y, distance = sqrt(dx * dx + dy * dy);
      at.normal_x = dx / distance;
      at.normal_y = dy / distance;
      at.gap = distance - (body.radius + other.radius);
      at.x = a.x - body.radius * at.normal_x;
      at.y = a.y - body.radius * at.normal_y;
      return at;
    }
    // In the frame of the polygon.
    const T c = cos(b.angle), s = sin(b.angle), dx = at.x - b.x, dy = at.y - b.y;
    const T x = c * dx + s * dy, y = c * dy - s * dx;
    const int edges = static_cast<int>(other.polygon.size());
    const auto beyond = [&](int edge) {
      const Point2D &from = other.polygon[edge], &normal = normals_[of.b][edge];
      return normal[0] * (x - from[0]) + normal[1] * (y - from[1]);
    };
    const auto turned = [](const T& cosine, const T& sine, const Point2D& by) {
      return std::pair<T, T>(cosine * by[0] - sine * by[1], sine * by[0] + cosine * by[1]);
    };
    if (of.kind == Contact::kVertexEdge) {
      std::tie(at.normal_x, at.normal_y) = turned(c, s, normals_[of.b][of.edge]);
      // How much nearer than the vertex another one of its body is to the line of an edge.
      const auto nearer = [&](int edge) {
        const auto [n_x, n_y] = turned(c, s, normals_[of.b][edge]);
        const T own_x = a_c * n_x + a_s * n_y, own_y = a_c * n_y - a_s * n_x;
        const auto vertices = static_cast<int>(body.polygon.size());
        const auto along = [&](int vertex) {
          return own_x * (body.polygon[of.vertex][0] - body.polygon[vertex][0]) +
                 own_y * (body.polygon[of.vertex][1] - body.polygon[vertex][1]);
        };
        T most = along((of.vertex + 1) % vertices);
        for (int vertex = 0; vertex < vertices; ++vertex) {
          if (vertex == of.vertex) continue;
          if (const T here = along(vertex); here > most) most = here;
        }
        return most;
      };
      // The gap is the distance from the line of the edge where the vertex is above the edge, no other vertex is nearer
      // to the line, and the vertex is not above another edge of which that holds, too: bodies that touch at a corner
      // are apart as long as they are apart along one normal. Elsewhere the gap is larger. Where the vertex is beside
      // no edge, that is the distance of its body from the other edge, so that a gap stays below zero in bodies that
      // overlap. Bodies that lie flush on each other are not moved by rounding.
      const double flush = kFlush * (size_of_[of.a] + size_of_[of.b]);
      const T distance = beyond(of.edge);
      T nearest = beyond((of.edge + 1) % edges), excess = nearer(of.edge) - flush;
      for (int edge = 0; edge < edges; ++edge) {
        if (edge == of.edge) continue;
        const T beside = beyond(edge);
        if (beside > nearest) nearest = beside;
        T apart = beside - distance + flush;
        if (apart > excess) {
          const T more = nearer(edge);
          if (more > T(flush)) apart -= T(2.0 * flush);
          if (more > T(flush) && !(beside > T(flush))) apart -= more;
        }
        if (apart > excess) excess = apart;
      }
      at.from_line = distance;
      at.gap = excess > T(0.0) ? distance + 2.0 * excess : distance;
      at.reach = 2.0 * flush - nearest;
      return at;
    }
    // The nearest point of the polygon is on the outermost edge or at one of its ends.
    int outermost = 0;
    T most = beyond(0);
    for (int edge = 1; edge < edges; ++edge) {
      const T distance = beyond(edge);
      if (distance > most) {
        most = distance;
        outermost = edge;
      }
    }
    T n_x(0.0), n_y(0.0);
    const Point2D &from = other.polygon[outermost], &to = other.polygon[(outermost + 1) % edges];
    const Point2D& normal = normals_[of.b][outermost];
    const T along = normal[0] * (y - from[1]) - normal[1] * (x - from[0]);
    const double length = std::hypot(to[0] - from[0], to[1] - from[1]);
    const bool before = along<T(0.0), behind = along> T(length);
    if (before || behind) {
      const Point2D& end = before ? from : to;
      const T to_x = x - end[0], to_y = y - end[1], distance = sqrt(to_x * to_x + to_y * to_y);
      n_x = to_x / distance;
      n_y = to_y / distance;
      at.gap = distance - body.radius;
    } else {
      n_x = T(normal[0]);
      n_y = T(normal[1]);
      at.gap = most - body.radius;
    }
    at.normal_x = c * n_x - s * n_y;
    at.normal_y = s * n_x + c * n_y;
    at.x -= body.radius * at.normal_x;
    at.y -= body.radius * at.normal_y;
    return at;
  }

  // Distances that are zero where bodies lie flush on each other, of the sizes of both.
  static constexpr double kFlush = 1e-10;
  const RigidScene2D scene_;
  std::vector<double> size_of_;                // m: the largest distance of a vertex of each body from its centre
  std::vector<int> first_;                     // coordinate of each body
  int size_ = 0;                               // number of coordinates
  std::vector<double> inertia_;                // about the centre of mass
  std::vector<std::vector<Point2D>> normals_;  // of the edges of each body, outwards
  std::vector<Contact> contacts_;
};

}  // namespace saltus
