// Simbody with rigid contacts: its time stepper for unilateral constraints.
#include "simbody.h"

#include <simbody/internal/SemiExplicitEulerTimeStepper.h>

namespace {

using engines::Scene;
using engines::State;

class RigidWorld : public engines::SimbodyWorld {
 public:
  RigidWorld(const Scene& scene, const std::vector<State>& initial) : SimbodyWorld(scene), stepper_(system_) {
    const double e = scene.restitution, mu = scene.friction;
    for (std::size_t i = 0; i < initial.size(); ++i) {
      const engines::Body& given = scene.bodies[i];
      const SimTK::Vec3 centre = Centre(disc, initial[i]);
      for (std::size_t j = 0; j < i; ++j) {
        const engines::Body& other = scene.bodies[j];
        if (given.fixed && other.fixed) continue;
        matter_.adoptUnilateralContact(new SimTK::SphereSphereContact(
            bodies_[j], Centre(other, initial[j]), other.radius, bodies_[i], centre, given.radius, e, mu, mu, 0));
      }
      for (const engines::Plane& plane : scene.planes) {
        if (given.fixed) continue;
        // A centre that stays above its plane.
        const double height = plane.normal[0] * plane.point[0] + plane.normal[1] * plane.point[1] + given.radius;
        matter_.adoptUnilateralContact(
            new SimTK::PointPlaneContact(matter_.updGround(),
                                         SimTK::UnitVec3(plane.normal[0], plane.normal[1], 0),
                                         height,
                                         bodies_[i],
                                         centre,
                                         e,
                                         mu,
                                         mu,
                                         0));
      }
    }
    stepper_.initialize(Start(initial));
  }

 private:
  SimTK::State& Now() override { return stepper_.updState(); }
  const SimTK::State& Now() const override { return stepper_.getState(); }
  void Advance(double h) override { stepper_.stepTo(stepper_.getTime() + h); }

  SimTK::SemiExplicitEulerTimeStepper stepper_;
};

}  // namespace

int main() {
  return engines::Serve({"Simbody 3.7, rigid", [](const Scene& scene, const std::vector<State>& initial, double) {
                           return std::make_unique<RigidWorld>(scene, initial);
                         }});
}
