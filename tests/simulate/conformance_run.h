// Runs of one contact model, and the scenes in which every model is checked (conformance.h).
#pragma once

#include <Eigen/Dense>
#include <functional>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus::conformance {

struct Model {
  ModelTraits traits;
  std::function<std::unique_ptr<Simulator>(const Scene&)> make;
  std::function<std::string(const Scene&)> reason_not_applicable;  // as ReasonNotApplicable
};

template <typename... Parts>
std::string Say(const Parts&... parts) {
  std::ostringstream out;
  out.precision(10);
  (out << ... << parts);
  return out.str();
}

// A rollout of a scene from its initial state, under its initial control.
class Run {
 public:
  Run(const Model& model, const Scene& scene) : simulator_(model.make(scene)), x_(simulator_->state_size()) {
    finite_ = simulator_->Rollout(InitialState(scene), InitialControl(scene, simulator_->num_steps()));
  }
  const Simulator& simulator() const { return *simulator_; }
  bool finite() const { return finite_; }
  int last() const { return simulator_->num_steps(); }
  Vec2d Position(int k, int i) { return Entry(k, i, 0); }
  Vec2d Velocity(int k, int i) { return Entry(k, i, 2); }

  // Gap of two discs, or of disc 0 and plane 0 in a scene of one disc, m; and the speed at which it grows, m/s.
  double Gap(int k) {
    const Scene& scene = simulator_->scene();
    if (scene.num_bodies() > 1) {
      return (Position(k, 0) - Position(k, 1)).norm() - scene.bodies[0].radius - scene.bodies[1].radius;
    }
    return Dot(Normal(k), Vec2d(Position(k, 0) - scene.planes[0].point)) - scene.bodies[0].radius;
  }
  double GapSpeed(int k) {
    const bool pair = simulator_->scene().num_bodies() > 1;
    return Dot(Normal(k), pair ? Vec2d(Velocity(k, 0) - Velocity(k, 1)) : Velocity(k, 0));
  }
  Vec2d Normal(int k) {
    const Scene& scene = simulator_->scene();
    if (scene.num_bodies() > 1) return (Position(k, 0) - Position(k, 1)).normalized();
    return scene.planes[0].normal.normalized();
  }
  Vec2d Momentum(int k) {
    Vec2d sum = Vec2d::Zero();
    for (int i = 0; i < simulator_->num_bodies(); ++i) sum += simulator_->scene().bodies[i].mass * Velocity(k, i);
    return sum;
  }

 private:
  Vec2d Entry(int k, int i, int offset) {
    simulator_->GetState(k, x_);
    const double* at = &x_[i * simulator_->body_size() + offset];
    return {at[0], at[1]};
  }

  std::unique_ptr<Simulator> simulator_;
  std::vector<double> x_;
  bool finite_;
};

// ---------------------------------------------------------------------------------------------------------------------
// Scenes.

// Two discs of 1 kg and 3 kg that close at 3 m/s, head-on up to `offset`, and meet once after about 0.13 s.
inline Scene TwoDiscs(double restitution, double friction = 0, double offset = 0) {
  const Vec2d along(0.6, 0.8), across(-0.8, 0.6);
  Scene scene;
  scene.name = "two_discs";
  scene.duration = 0.5;
  scene.steps = 240;
  scene.bodies = {
      {.name = "a", .radius = 0.2, .mass = 1, .position = -0.5 * along + offset * across, .velocity = 2 * along},
      {.name = "b", .radius = 0.3, .mass = 3, .position = 0.401 * along, .velocity = -along}};
  scene.contact = {.restitution = restitution, .friction = friction, .stiffness = 1e4, .damping = 0};
  return scene;
}

// A disc that meets a tilted plane at 2 m/s after about 0.15 s, sliding at `sliding`.
inline Scene DiscOnPlane(double restitution, double friction = 0, double sliding = 0) {
  const Vec2d normal(-0.28, 0.96), along(0.96, 0.28);
  Scene scene;
  scene.name = "disc_on_plane";
  scene.duration = 0.5;
  scene.steps = 240;
  scene.bodies = {
      {.name = "a", .radius = 0.2, .mass = 1.5, .position = 0.501 * normal, .velocity = -2 * normal + sliding * along}};
  scene.planes = {{"ground", {0, 0}, normal}};
  scene.contact = {.restitution = restitution, .friction = friction, .stiffness = 1e4, .damping = 0};
  return scene;
}

inline std::vector<Scene> Impacts(double restitution) { return {TwoDiscs(restitution), DiscOnPlane(restitution)}; }

}  // namespace saltus::conformance
