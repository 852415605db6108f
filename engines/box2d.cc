// Box2D 2.4: discs and boxes as they are, half-planes as long edges.
#include <box2d/box2d.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

constexpr double kFar = 1000;  // m, half the length of an edge

class Box2dWorld : public engines::World {
 public:
  Box2dWorld(const Scene& scene, const std::vector<State>& initial) : world_(Vector(scene.gravity)) {
    world_.SetAllowSleeping(false);
    b2FixtureDef fixture;
    fixture.restitution = static_cast<float>(scene.restitution);
    fixture.friction = static_cast<float>(scene.friction);
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Body& given = scene.bodies[i];
      b2BodyDef body;
      body.type = given.fixed ? b2_staticBody : b2_dynamicBody;
      body.position = Vector({initial[i][0], initial[i][1]});
      body.linearVelocity = Vector({initial[i][2], initial[i][3]});
      body.fixedRotation = given.inertia == 0;
      body.angle = static_cast<float>(given.angle);
      body.angularVelocity = static_cast<float>(given.spin);
      bodies_.push_back(world_.CreateBody(&body));
      b2CircleShape circle;
      circle.m_radius = static_cast<float>(given.radius);
      b2PolygonShape box;
      if (given.radius == 0) box.SetAsBox(static_cast<float>(given.half[0]), static_cast<float>(given.half[1]));
      fixture.shape = &circle;
      if (given.radius == 0) fixture.shape = &box;
      fixture.density = 1;
      bodies_.back()->CreateFixture(&fixture);
      const b2MassData mass{static_cast<float>(given.mass), b2Vec2(0, 0), static_cast<float>(given.inertia)};
      bodies_.back()->SetMassData(&mass);
    }
    for (const engines::Plane& plane : scene.planes) {
      const double tx = plane.normal[1] * kFar, ty = -plane.normal[0] * kFar;
      const b2Vec2 ends[] = {Vector({plane.point[0] - tx, plane.point[1] - ty}),
                             Vector({plane.point[0] + tx, plane.point[1] + ty})};
      b2EdgeShape edge;
      edge.SetTwoSided(ends[0], ends[1]);
      fixture.shape = &edge;
      const b2BodyDef ground;
      world_.CreateBody(&ground)->CreateFixture(&fixture);
    }
  }

  void Push(int disc, double fx, double fy) override { bodies_[disc]->ApplyForceToCenter(Vector({fx, fy}), true); }
  void Step(double h) override { world_.Step(static_cast<float>(h), 8, 3); }
  State Get(int disc) const override {
    const b2Vec2 p = bodies_[disc]->GetPosition(), v = bodies_[disc]->GetLinearVelocity();
    return {p.x, p.y, v.x, v.y};
  }
  engines::Vec2 Turn(int body) const override {
    return {bodies_[body]->GetAngle(), bodies_[body]->GetAngularVelocity()};
  }

 private:
  static b2Vec2 Vector(const engines::Vec2& v) { return {static_cast<float>(v[0]), static_cast<float>(v[1])}; }

  b2World world_;
  std::vector<b2Body*> bodies_;
};

}  // namespace

int main() {
  const std::string name = "Box2D " + std::to_string(b2_version.major) + "." + std::to_string(b2_version.minor) + "." +
                           std::to_string(b2_version.revision);
  return engines::Serve({.name = name,
                         .make = [](const Scene& scene,
                                    const std::vector<State>& initial,
                                    double) { return std::make_unique<Box2dWorld>(scene, initial); },
                         .boxes = true});
}
