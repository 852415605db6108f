// Simbody with contact forces: Hunt and Crossley's, which is Hertz' without dissipation. --softer takes 1e6 Pa for 1e9.
#include "simbody.h"

namespace {

using engines::Scene;
using engines::State;

constexpr double kAccuracy = 1e-13;    // of the integrator: differences at 1e-6 divide its errors
constexpr double kContactStep = 1e-4;  // s: the integrator would step over a whole contact
constexpr double kTransition = 1e-3;   // m/s, of slip, where friction reaches its limit

class ForceWorld : public engines::SimbodyWorld {
 public:
  ForceWorld(const Scene& scene, const std::vector<State>& initial, double stiffness)
      : SimbodyWorld(scene), scene_(scene), initial_(initial), contacts_(system_), integrator_(system_) {
    const SimTK::ContactSetIndex set = contacts_.createContactSet();
    SimTK::HuntCrossleyForce force(forces_, contacts_, set);
    force.setTransitionVelocity(kTransition);
    for (std::size_t i = 0; i < initial.size(); ++i) {
      contacts_.addBody(set,
                        bodies_[i],
                        SimTK::ContactGeometry::Sphere(scene.bodies[i].radius),
                        SimTK::Transform(Centre(scene.bodies[i], initial[i])));
    }
    for (const engines::Plane& plane : scene.planes) {  // a half-space is where x > 0
      const SimTK::Rotation into(SimTK::UnitVec3(-plane.normal[0], -plane.normal[1], 0), SimTK::XAxis);
      contacts_.addBody(set,
                        matter_.updGround(),
                        SimTK::ContactGeometry::HalfSpace(),
                        SimTK::Transform(into, SimTK::Vec3(plane.point[0], plane.point[1], 0)));
    }
    for (std::size_t i = 0; i < initial.size() + scene.planes.size(); ++i) {
      force.setBodyParameters(
          SimTK::ContactSurfaceIndex(static_cast<int>(i)), stiffness, 0, scene.friction, scene.friction, 0);
    }
    integrator_.setAccuracy(kAccuracy);
    integrator_.initialize(Start(initial));
  }

 private:
  SimTK::State& Now() override { return integrator_.updAdvancedState(); }
  const SimTK::State& Now() const override { return integrator_.getAdvancedState(); }

  void Advance(double h) override {
    // A force that changes from step to step: nothing of the last step holds.
    integrator_.reinitialize(SimTK::Stage::Dynamics, false);
    const double begin = integrator_.getTime();
    const int parts = MayTouch(h) ? static_cast<int>(std::ceil(h / kContactStep)) : 1;
    for (int i = 1; i <= parts; ++i) {
      const double end = begin + h * i / parts;
      // It also returns where an interval starts.
      while (integrator_.stepTo(end, end) != SimTK::Integrator::ReachedReportTime) {
      }
    }
  }

  // Whether anything is nearer than it moves in two steps.
  bool MayTouch(double h) const {
    double fastest = 0;
    std::vector<State> now = initial_;
    for (std::size_t i = 0; i < now.size(); ++i) {
      if (!scene_.bodies[i].fixed) now[i] = Get(static_cast<int>(i));
      fastest = std::max(fastest, std::hypot(now[i][2], now[i][3]));
    }
    const double reach = 4 * h * fastest + h;
    for (std::size_t i = 0; i < now.size(); ++i) {
      const double radius = scene_.bodies[i].radius + reach;
      for (std::size_t j = 0; j < i; ++j) {
        if (std::hypot(now[i][0] - now[j][0], now[i][1] - now[j][1]) < radius + scene_.bodies[j].radius) return true;
      }
      for (const engines::Plane& plane : scene_.planes) {
        const double x = now[i][0] - plane.point[0], y = now[i][1] - plane.point[1];
        if (plane.normal[0] * x + plane.normal[1] * y < radius) return true;
      }
    }
    return false;
  }

  const Scene scene_;
  const std::vector<State> initial_;
  SimTK::GeneralContactSubsystem contacts_;
  SimTK::RungeKuttaMersonIntegrator integrator_;
};

}  // namespace

int main(int argc, char** argv) {
  const bool softer = engines::HasFlag(argc, argv, "--softer");
  return engines::Serve({softer ? "Simbody 3.7, Hunt-Crossley 1e6 Pa" : "Simbody 3.7, Hunt-Crossley 1e9 Pa",
                         [softer](const Scene& scene, const std::vector<State>& initial, double) {
                           return std::make_unique<ForceWorld>(scene, initial, softer ? 1e6 : 1e9);
                         },
                         [](const Scene& scene) -> std::string {
                           if (scene.restitution == 1) return "";
                           return "the restitution of a Hunt-Crossley contact depends on the speed: elastic ones only";
                         }});
}
