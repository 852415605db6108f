// ODE: discs as spheres and boxes as deep ones, which stay in the plane z = 0, half-planes as planes. --quick takes its
// iterative stepper.
#include <ode/ode.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

constexpr int kMaxContacts = 8;  // of two geometries; spheres and planes have one
constexpr double kDepth = 1;     // m, of a box

class OdeWorld : public engines::World {
 public:
  OdeWorld(const Scene& scene, const std::vector<State>& initial, bool quick)
      : scene_(scene),
        quick_(quick),
        world_(dWorldCreate()),
        space_(dSimpleSpaceCreate(nullptr)),
        contacts_(dJointGroupCreate(0)) {
    dWorldSetGravity(world_, scene.gravity[0], scene.gravity[1], 0);
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Body& given = scene.bodies[i];
      const dGeomID geometry = given.radius > 0 ? dCreateSphere(space_, given.radius)
                                                : dCreateBox(space_, 2 * given.half[0], 2 * given.half[1], kDepth);
      dMatrix3 turned;
      dRFromAxisAndAngle(turned, 0, 0, 1, given.angle);
      dBodyID body = nullptr;
      if (given.fixed) {
        dGeomSetPosition(geometry, initial[i][0], initial[i][1], 0);
        dGeomSetRotation(geometry, turned);
      } else {
        body = dBodyCreate(world_);
        dMass mass;
        dMassSetSphereTotal(&mass, given.mass, given.radius > 0 ? given.radius : 1);
        if (given.inertia > 0) {
          const double about = given.inertia;
          dMassSetParameters(&mass, given.mass, 0, 0, 0, about, about, about, 0, 0, 0);
        }
        dBodySetMass(body, &mass);
        if (given.inertia > 0) {
          dJointAttach(dJointCreatePlane2D(world_, nullptr), body, nullptr);
        } else {
          dBodySetMaxAngularSpeed(body, 0);
        }
        dBodySetRotation(body, turned);
        dBodySetAngularVel(body, 0, 0, given.spin);
        dBodySetPosition(body, initial[i][0], initial[i][1], 0);
        dBodySetLinearVel(body, initial[i][2], initial[i][3], 0);
        dGeomSetBody(geometry, body);
      }
      bodies_.push_back(body);
    }
    for (const engines::Plane& plane : scene.planes) {
      const double height = plane.normal[0] * plane.point[0] + plane.normal[1] * plane.point[1];
      dCreatePlane(space_, plane.normal[0], plane.normal[1], 0, height);
    }
  }
  ~OdeWorld() override {
    dJointGroupDestroy(contacts_);
    dSpaceDestroy(space_);
    dWorldDestroy(world_);
  }

  void Push(int disc, double fx, double fy) override { dBodyAddForce(bodies_[disc], fx, fy, 0); }
  void Step(double h) override {
    dSpaceCollide(space_, this, &OdeWorld::Near);
    quick_ ? dWorldQuickStep(world_, h) : dWorldStep(world_, h);
    dJointGroupEmpty(contacts_);
  }
  State Get(int disc) const override {
    const dReal *p = dBodyGetPosition(bodies_[disc]), *v = dBodyGetLinearVel(bodies_[disc]);
    return {p[0], p[1], v[0], v[1]};
  }
  engines::Vec2 Turn(int body) const override {
    const dReal* turned = dBodyGetRotation(bodies_[body]);
    return {std::atan2(turned[4], turned[0]), dBodyGetAngularVel(bodies_[body])[2]};
  }

 private:
  static void Near(void* self, dGeomID a, dGeomID b) { static_cast<OdeWorld*>(self)->AddContacts(a, b); }
  void AddContacts(dGeomID a, dGeomID b) {
    const dBodyID body_a = dGeomGetBody(a), body_b = dGeomGetBody(b);
    if (!body_a && !body_b) return;
    dContact contact[kMaxContacts] = {};
    const int count = dCollide(a, b, kMaxContacts, &contact[0].geom, sizeof(dContact));
    for (int i = 0; i < count; ++i) {
      contact[i].surface.mode = dContactBounce | dContactApprox1;
      contact[i].surface.mu = scene_.friction;
      contact[i].surface.bounce = scene_.restitution;
      contact[i].surface.bounce_vel = 0;
      dJointAttach(dJointCreateContact(world_, contacts_, &contact[i]), body_a, body_b);
    }
  }

  const Scene scene_;
  const bool quick_;
  const dWorldID world_;
  const dSpaceID space_;
  const dJointGroupID contacts_;
  std::vector<dBodyID> bodies_;
};

}  // namespace

int main(int argc, char** argv) {
  const bool quick = engines::HasFlag(argc, argv, "--quick");
  dInitODE2(0);
  return engines::Serve({.name = quick ? "ODE, quickStep" : "ODE",
                         .make = [quick](const Scene& scene,
                                         const std::vector<State>& initial,
                                         double) { return std::make_unique<OdeWorld>(scene, initial, quick); },
                         .boxes = true});
}
