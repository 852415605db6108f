// Chipmunk 7: discs and boxes as they are, half-planes as long segments.
#include <chipmunk/chipmunk.h>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

constexpr double kFar = 1000;  // m, half the length of a segment
constexpr double kThick = 1;   // m, half the thickness of a segment

class ChipmunkWorld : public engines::World {
 public:
  ChipmunkWorld(const Scene& scene, const std::vector<State>& initial) : scene_(scene), space_(cpSpaceNew()) {
    cpSpaceSetGravity(space_, cpv(scene.gravity[0], scene.gravity[1]));
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Body& given = scene.bodies[i];
      cpBody* body =
          given.fixed ? cpBodyNewStatic() : cpBodyNew(given.mass, given.inertia > 0 ? given.inertia : INFINITY);
      cpBodySetPosition(body, cpv(initial[i][0], initial[i][1]));
      cpBodySetAngle(body, given.angle);
      if (!given.fixed) {
        cpBodySetVelocity(body, cpv(initial[i][2], initial[i][3]));
        cpBodySetAngularVelocity(body, given.spin);
      }
      bodies_.push_back(cpSpaceAddBody(space_, body));
      Add(given.radius > 0 ? cpCircleShapeNew(body, given.radius, cpvzero)
                           : cpBoxShapeNew(body, 2 * given.half[0], 2 * given.half[1], 0));
    }
    for (const engines::Plane& plane : scene.planes) {
      const cpVect normal = cpv(plane.normal[0], plane.normal[1]);
      const cpVect middle = cpvsub(cpv(plane.point[0], plane.point[1]), cpvmult(normal, kThick));
      const cpVect along = cpvmult(cpvperp(normal), kFar);
      Add(cpSegmentShapeNew(cpSpaceGetStaticBody(space_), cpvsub(middle, along), cpvadd(middle, along), kThick));
    }
  }
  ~ChipmunkWorld() override {
    for (cpShape* shape : shapes_) {
      cpSpaceRemoveShape(space_, shape);
      cpShapeFree(shape);
    }
    for (cpBody* body : bodies_) {
      cpSpaceRemoveBody(space_, body);
      cpBodyFree(body);
    }
    cpSpaceFree(space_);
  }

  void Push(int disc, double fx, double fy) override {
    cpBodyApplyForceAtWorldPoint(bodies_[disc], cpv(fx, fy), cpBodyGetPosition(bodies_[disc]));
  }
  void Step(double h) override { cpSpaceStep(space_, h); }
  State Get(int disc) const override {
    const cpVect p = cpBodyGetPosition(bodies_[disc]), v = cpBodyGetVelocity(bodies_[disc]);
    return {p.x, p.y, v.x, v.y};
  }
  engines::Vec2 Turn(int body) const override {
    return {cpBodyGetAngle(bodies_[body]), cpBodyGetAngularVelocity(bodies_[body])};
  }

 private:
  // Of two shapes, the product counts.
  void Add(cpShape* shape) {
    cpShapeSetElasticity(shape, std::sqrt(scene_.restitution));
    cpShapeSetFriction(shape, std::sqrt(scene_.friction));
    shapes_.push_back(cpSpaceAddShape(space_, shape));
  }

  const Scene scene_;
  cpSpace* space_;
  std::vector<cpBody*> bodies_;
  std::vector<cpShape*> shapes_;
};

}  // namespace

int main() {
  return engines::Serve({.name = std::string("Chipmunk ") + cpVersionString,
                         .make = [](const Scene& scene,
                                    const std::vector<State>& initial,
                                    double) { return std::make_unique<ChipmunkWorld>(scene, initial); },
                         .boxes = true});
}
