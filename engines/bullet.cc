// Bullet: discs as spheres that stay in the plane z = 0, half-planes as planes. Built once for each precision. It sees
// a plane from 0.02 m on, and with steps in which a disc moves less it brakes there: nothing rebounds.
#include <btBulletDynamicsCommon.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

class BulletWorld : public engines::World {
 public:
  BulletWorld(const Scene& scene, const std::vector<State>& initial)
      : scene_(scene), dispatcher_(&configuration_), world_(&dispatcher_, &broadphase_, &solver_, &configuration_) {
    world_.setGravity(Vector(scene.gravity));
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Disc& disc = scene.discs[i];
      const auto radius = static_cast<btScalar>(disc.radius);
      btRigidBody& body = Add(std::make_unique<btSphereShape>(radius), disc.fixed ? 0 : disc.mass);
      btTransform at;
      at.setIdentity();
      at.setOrigin(Vector({initial[i][0], initial[i][1]}));
      body.setWorldTransform(at);
      body.setInterpolationWorldTransform(at);
      if (!disc.fixed) body.setLinearVelocity(Vector({initial[i][2], initial[i][3]}));
    }
    for (const engines::Plane& plane : scene.planes) {
      const double height = plane.normal[0] * plane.point[0] + plane.normal[1] * plane.point[1];
      Add(std::make_unique<btStaticPlaneShape>(Vector(plane.normal), static_cast<btScalar>(height)), 0);
    }
    for (const auto& body : bodies_) world_.addRigidBody(body.get());
  }
  ~BulletWorld() override {
    for (const auto& body : bodies_) world_.removeRigidBody(body.get());
  }

  void Push(int disc, double fx, double fy) override { bodies_[disc]->applyCentralForce(Vector({fx, fy})); }
  void Step(double h) override { world_.stepSimulation(static_cast<btScalar>(h), 0); }
  State Get(int disc) const override {
    const btVector3 &p = bodies_[disc]->getCenterOfMassPosition(), &v = bodies_[disc]->getLinearVelocity();
    return {p.x(), p.y(), v.x(), v.y()};
  }

 private:
  static btVector3 Vector(const engines::Vec2& v) {
    return {static_cast<btScalar>(v[0]), static_cast<btScalar>(v[1]), 0};
  }

  // Of two bodies, the product of restitutions and of frictions counts.
  btRigidBody& Add(std::unique_ptr<btCollisionShape> shape, double mass) {
    btRigidBody::btRigidBodyConstructionInfo info(static_cast<btScalar>(mass), nullptr, shape.get());
    info.m_restitution = static_cast<btScalar>(std::sqrt(scene_.restitution));
    info.m_friction = static_cast<btScalar>(std::sqrt(scene_.friction));
    shapes_.push_back(std::move(shape));
    bodies_.push_back(std::make_unique<btRigidBody>(info));
    bodies_.back()->setActivationState(DISABLE_DEACTIVATION);
    bodies_.back()->setLinearFactor(btVector3(1, 1, 0));
    return *bodies_.back();
  }

  const Scene scene_;
  btDefaultCollisionConfiguration configuration_;
  btCollisionDispatcher dispatcher_;
  btDbvtBroadphase broadphase_;
  btSequentialImpulseConstraintSolver solver_;
  btDiscreteDynamicsWorld world_;
  std::vector<std::unique_ptr<btCollisionShape>> shapes_;
  std::vector<std::unique_ptr<btRigidBody>> bodies_;
};

}  // namespace

int main() {
  const int version = btGetVersion();
  const std::string name = "Bullet " + std::to_string(version / 100) + "." + std::to_string(version % 100) +
                           (btIsDoublePrecision() ? ", float64" : ", float32");
  return engines::Serve({name, [](const Scene& scene, const std::vector<State>& initial, double) {
                           return std::make_unique<BulletWorld>(scene, initial);
                         }});
}
