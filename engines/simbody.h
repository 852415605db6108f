// What both drivers of Simbody share: discs as spheres that translate.
#pragma once

#include <Simbody.h>

#include "protocol.h"

namespace engines {

class SimbodyWorld : public World {
 public:
  explicit SimbodyWorld(const Scene& scene)
      : matter_(system_),
        forces_(system_),
        gravity_(forces_, matter_, SimTK::Vec3(scene.gravity[0], scene.gravity[1], 0)),
        pushes_(forces_, matter_) {
    for (const Body& disc : scene.bodies) {
      if (disc.fixed) {
        bodies_.push_back(matter_.Ground());
      } else {
        const SimTK::Body::Rigid body(
            SimTK::MassProperties(disc.mass, SimTK::Vec3(0), disc.mass * SimTK::UnitInertia::sphere(disc.radius)));
        bodies_.push_back(SimTK::MobilizedBody::Translation(matter_.Ground(), body));
      }
    }
  }

  void Push(int disc, double fx, double fy) override {
    pushes_.setOneBodyForce(Now(), bodies_[disc], SimTK::SpatialVec(SimTK::Vec3(0), SimTK::Vec3(fx, fy, 0)));
  }
  void Step(double h) override {
    Advance(h);
    pushes_.clearAllBodyForces(Now());
  }
  State Get(int disc) const override {
    const SimTK::State& now = Now();
    system_.realize(now, SimTK::Stage::Velocity);
    const SimTK::Vec3 p = bodies_[disc].getBodyOriginLocation(now), v = bodies_[disc].getBodyOriginVelocity(now);
    return {p[0], p[1], v[0], v[1]};
  }

 protected:
  virtual SimTK::State& Now() = 0;
  virtual const SimTK::State& Now() const = 0;
  virtual void Advance(double h) = 0;

  // Where the centre of a disc is in the frame of its body.
  static SimTK::Vec3 Centre(const Body& disc, const State& initial) {
    return disc.fixed ? SimTK::Vec3(initial[0], initial[1], 0) : SimTK::Vec3(0);
  }
  // The state to begin with. Once all that is in the system has been added.
  SimTK::State Start(const std::vector<State>& initial) {
    SimTK::State state = system_.realizeTopology();
    for (std::size_t i = 0; i < initial.size(); ++i) {
      if (bodies_[i].isGround()) continue;
      for (int axis = 0; axis < 2; ++axis) {
        bodies_[i].setOneQ(state, axis, initial[i][axis]);
        bodies_[i].setOneU(state, axis, initial[i][axis + 2]);
      }
    }
    return state;
  }

  SimTK::MultibodySystem system_;
  SimTK::SimbodyMatterSubsystem matter_;
  SimTK::GeneralForceSubsystem forces_;
  SimTK::Force::UniformGravity gravity_;
  SimTK::Force::DiscreteForces pushes_;
  std::vector<SimTK::MobilizedBody> bodies_;
};

}  // namespace engines
