// ODE: discs as spheres that stay in the plane z = 0, half-planes as planes. --quick takes its iterative stepper.
#include <ode/ode.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

constexpr int kMaxContacts = 4;  // of two geometries; spheres and planes have one

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
      const engines::Disc& disc = scene.discs[i];
      const dGeomID geometry = dCreateSphere(space_, disc.radius);
      dBodyID body = nullptr;
      if (disc.fixed) {
        dGeomSetPosition(geometry, initial[i][0], initial[i][1], 0);
      } else {
        body = dBodyCreate(world_);
        dMass mass;
        dMassSetSphereTotal(&mass, disc.mass, disc.radius);
        dBodySetMass(body, &mass);
        dBodySetMaxAngularSpeed(body, 0);
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
  return engines::Serve(
      {quick ? "ODE, quickStep" : "ODE", [quick](const Scene& scene, const std::vector<State>& initial, double) {
         return std::make_unique<OdeWorld>(scene, initial, quick);
       }});
}
