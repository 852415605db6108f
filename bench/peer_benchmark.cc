// Steps a second of two balls, one of which is pushed in every step (problem two_balls), of many motions on one core,
// in turns: by a Batch, and by simulators of others in a loop over motions, as far as their packages are found.
// MuJoCo's own `rollout` is such a loop.
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#ifdef SALTUS_HAS_BOX2D
#include <box2d/box2d.h>
#endif
#ifdef SALTUS_HAS_MUJOCO
#include <mujoco/mujoco.h>

#include <cstring>
#endif

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "saltus/control/batch.h"
#include "timing.h"

namespace saltus {
namespace {

constexpr int kMotions = 64;

using Place = std::array<double, 2>;

// Each returns where the ball that is struck ends.

#ifdef SALTUS_HAS_BOX2D
class Box2dWorld {
 public:
  explicit Box2dWorld(const Scene& scene) : step_(static_cast<float>(scene.dt())), world_(b2Vec2(0, 0)) {
    world_.SetAllowSleeping(false);
    for (const Body& of : scene.bodies) {
      b2BodyDef body;
      body.type = b2_dynamicBody;
      body.fixedRotation = true;
      starts_.push_back(Vector(of.position.data()));
      body.position = starts_.back();
      bodies_.push_back(world_.CreateBody(&body));
      b2CircleShape circle;
      circle.m_radius = static_cast<float>(of.radius);
      b2FixtureDef fixture;
      fixture.shape = &circle;
      fixture.restitution = 1;
      fixture.friction = 0;
      fixture.density = static_cast<float>(of.mass / (M_PI * of.radius * of.radius));
      bodies_.back()->CreateFixture(&fixture);
    }
  }
  Place Run(const double* control, int steps) {
    for (size_t i = 0; i < bodies_.size(); ++i) {
      bodies_[i]->SetTransform(starts_[i], 0);
      bodies_[i]->SetLinearVelocity(b2Vec2(0, 0));
    }
    for (int k = 0; k < steps; ++k) {
      bodies_[0]->ApplyForceToCenter(Vector(control + 2 * k), true);
      world_.Step(step_, 8, 3);
    }
    return {bodies_[1]->GetPosition().x, bodies_[1]->GetPosition().y};
  }

 private:
  static b2Vec2 Vector(const double* v) { return {static_cast<float>(v[0]), static_cast<float>(v[1])}; }

  const float step_;
  b2World world_;
  std::vector<b2Vec2> starts_;
  std::vector<b2Body*> bodies_;
};
#endif

#ifdef SALTUS_HAS_MUJOCO
class MujocoWorld {
 public:
  explicit MujocoWorld(const Scene& scene) {
    std::string xml = "<mujoco><option timestep='" + std::to_string(scene.dt()) +
                      "' gravity='0 0 0'/><default><geom solref='-40000 0' condim='1'/></default><worldbody>";
    for (const Body& body : scene.bodies) {
      xml += "<body pos='" + std::to_string(body.position[0]) + " " + std::to_string(body.position[1]) +
             " 0'><joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 1 0'/><geom type='sphere' size='" +
             std::to_string(body.radius) + "' mass='" + std::to_string(body.mass) + "'/></body>";
    }
    xml += "</worldbody></mujoco>";
    const auto files = std::make_unique<mjVFS>();
    mj_defaultVFS(files.get());
    mj_makeEmptyFileVFS(files.get(), "scene.xml", static_cast<int>(xml.size()));
    std::memcpy(files->filedata[mj_findFileVFS(files.get(), "scene.xml")], xml.data(), xml.size());
    char error[500] = "";
    model_ = mj_loadXML("scene.xml", files.get(), error, sizeof(error));
    mj_deleteVFS(files.get());
    CHECK(model_ != nullptr) << error;
    data_ = mj_makeData(model_);
    target_ = {scene.bodies[1].position.x(), scene.bodies[1].position.y()};
  }
  MujocoWorld(const MujocoWorld&) = delete;
  MujocoWorld& operator=(const MujocoWorld&) = delete;
  ~MujocoWorld() {
    mj_deleteData(data_);
    mj_deleteModel(model_);
  }
  Place Run(const double* control, int steps) {
    mj_resetData(model_, data_);
    for (int k = 0; k < steps; ++k) {
      data_->qfrc_applied[0] = control[2 * k];
      data_->qfrc_applied[1] = control[2 * k + 1];
      mj_step(model_, data_);
    }
    return {target_[0] + data_->qpos[2], target_[1] + data_->qpos[3]};
  }

 private:
  mjModel* model_ = nullptr;
  mjData* data_ = nullptr;
  Place target_;
};
#endif

template <typename World>
void BesideBatch(benchmark::State& state, const char* contact) {
  const Scene scene = ProblemScene("two_balls", 480);
  Batch batch(contact, scene, Precision::kDouble, 1);
  World world(scene);
  const size_t size = batch.num_variables();
  std::vector<double> points, losses(kMotions), gradients(kMotions * size);
  for (int i = 0; i < kMotions; ++i) {
    for (const double u : batch.initial_guess()) points.push_back(u + 0.002 * i);
  }
  // The balls meet, and part as in the exact motion to the accuracy of such a step.
  SingleShooting exact(MakeSimulator("event", scene, Precision::kDouble));
  double loss = 0;
  CHECK(exact.Evaluate({points.data(), size}, &loss, nullptr));
  const Place end = world.Run(points.data(), scene.steps);
  std::vector<double> final_state(exact.simulator().state_size());
  exact.simulator().GetState(scene.steps, final_state);
  for (auto _ : state) {
    const auto [ours, with_gradients, theirs] =
        TimeInTurns([&] { batch.Evaluate(points, losses); },
                    [&] { batch.Evaluate(points, losses, gradients); },
                    [&] {
                      for (int i = 0; i < kMotions; ++i) {
                        benchmark::DoNotOptimize(world.Run(&points[i * size], scene.steps));
                      }
                    });
    const double steps = static_cast<double>(kMotions) * scene.steps;
    state.SetIterationTime(theirs);
    state.counters["steps_per_s"] = steps / ours;
    state.counters["steps_with_gradient_per_s"] = steps / with_gradients;
    state.counters["peer_steps_per_s"] = steps / theirs;
    state.counters["ratio"] = theirs / ours;
    state.counters["peer_error"] = std::max(std::abs(end[0] - final_state[4]), std::abs(end[1] - final_state[5]));
  }
}

#ifdef SALTUS_HAS_BOX2D
void Box2d(benchmark::State& state, const char* contact) { BesideBatch<Box2dWorld>(state, contact); }
BENCHMARK_CAPTURE(Box2d, direct_toi, "direct_toi")->UseManualTime()->Iterations(1);
BENCHMARK_CAPTURE(Box2d, event, "event")->UseManualTime()->Iterations(1);
#endif
#ifdef SALTUS_HAS_MUJOCO
void Mujoco(benchmark::State& state, const char* contact) { BesideBatch<MujocoWorld>(state, contact); }
BENCHMARK_CAPTURE(Mujoco, direct_toi, "direct_toi")->UseManualTime()->Iterations(1);
BENCHMARK_CAPTURE(Mujoco, event, "event")->UseManualTime()->Iterations(1);
#endif

}  // namespace
}  // namespace saltus
