// Bullet: discs as spheres and boxes as deep ones, which stay in the plane z = 0, half-planes as planes. Built once for
// each precision. It sees a plane from 0.02 m on, and with steps in which a disc moves less it brakes there: nothing
// rebounds.
#include <btBulletDynamicsCommon.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

constexpr btScalar kHalfDepth = 0.5;  // m, of a box

class BulletWorld : public engines::World {
 public:
  BulletWorld(const Scene& scene, const std::vector<State>& initial)
      : scene_(scene),
        configuration_(SmallPools()),
        dispatcher_(&configuration_),
        world_(&dispatcher_, &broadphase_, &solver_, &configuration_) {
    world_.setGravity(Vector(scene.gravity));
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Body& given = scene.bodies[i];
      const auto radius = static_cast<btScalar>(given.radius), inertia = static_cast<btScalar>(given.inertia);
      std::unique_ptr<btCollisionShape> shape = std::make_unique<btSphereShape>(radius);
      if (given.radius == 0) shape = std::make_unique<btBoxShape>(Vector(given.half) + btVector3(0, 0, kHalfDepth));
      btRigidBody& body = Add(std::move(shape), given.fixed ? 0 : given.mass, btVector3(inertia, inertia, inertia));
      btTransform at;
      at.setIdentity();
      at.setOrigin(Vector({initial[i][0], initial[i][1]}));
      at.setRotation(btQuaternion(btVector3(0, 0, 1), static_cast<btScalar>(given.angle)));
      body.setWorldTransform(at);
      body.setInterpolationWorldTransform(at);
      if (given.fixed) continue;
      body.setLinearVelocity(Vector({initial[i][2], initial[i][3]}));
      if (given.inertia == 0) continue;
      body.setAngularFactor(btVector3(0, 0, 1));
      body.setAngularVelocity(btVector3(0, 0, static_cast<btScalar>(given.spin)));
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
  engines::Vec2 Turn(int body) const override {
    const btMatrix3x3& turned = bodies_[body]->getCenterOfMassTransform().getBasis();
    return {btAtan2(turned[1].x(), turned[0].x()), bodies_[body]->getAngularVelocity().z()};
  }

 private:
  // The default ones take longer to be made than a step does.
  static btDefaultCollisionConstructionInfo SmallPools() {
    btDefaultCollisionConstructionInfo info;
    info.m_defaultMaxPersistentManifoldPoolSize = info.m_defaultMaxCollisionAlgorithmPoolSize = 64;
    return info;
  }
  static btVector3 Vector(const engines::Vec2& v) {
    return {static_cast<btScalar>(v[0]), static_cast<btScalar>(v[1]), 0};
  }

  // Of two bodies, the product of restitutions and of frictions counts.
  btRigidBody& Add(std::unique_ptr<btCollisionShape> shape, double mass, const btVector3& inertia = {0, 0, 0}) {
    btRigidBody::btRigidBodyConstructionInfo info(static_cast<btScalar>(mass), nullptr, shape.get(), inertia);
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
  return engines::Serve({.name = name,
                         .make = [](const Scene& scene,
                                    const std::vector<State>& initial,
                                    double) { return std::make_unique<BulletWorld>(scene, initial); },
                         .boxes = true});
}
