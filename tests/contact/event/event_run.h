// Loss and exact gradient of a scene under the event-driven model.
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"

namespace saltus::testing {

// The event-driven model in the units of the scene: MakeSimulator() would convert to natural ones.
inline std::unique_ptr<Simulator> MakeEventSimulator(const Scene& scene) {
  return Contact("event").entry()->make(scene, Precision::kDouble, {});
}

inline std::vector<double> HeldControl(const Scene& scene) {
  std::vector<double> control;
  for (int k = 0; k < scene.steps; ++k) {
    for (const Vec2d& force : scene.control.initial) control.insert(control.end(), {force[0], force[1]});
  }
  return control;
}

inline std::vector<double> StartOf(const Scene& scene) { return InitialState(scene); }

// A rollout from the scene's own start under its own forces.
struct EventRun {
  explicit EventRun(const Scene& scene)
      : owned(MakeEventSimulator(scene)), simulator(*owned), control(HeldControl(scene)) {
    Scene named = scene;
    named.name = "test";
    const std::optional<SceneError> error = Validate(named);
    EXPECT_FALSE(error.has_value()) << error->key << ": " << error->message;
    finite = simulator.Rollout(StartOf(scene), control);
    EXPECT_TRUE(finite);
  }

  std::vector<double> State(int k) const {
    std::vector<double> x(simulator.state_size());
    simulator.GetState(k, x);
    return x;
  }
  std::vector<double> End() const { return State(simulator.num_steps()); }

  double Loss() const {
    const Objective& objective = simulator.scene().objective;
    return TerminalLoss(objective, End(), simulator.body_size()) + EffortLoss(objective, control, simulator.step());
  }
  Sensitivity Gradient() {
    const Objective& objective = simulator.scene().objective;
    std::vector<double> cotangent(simulator.state_size());
    TerminalGradient(objective, End(), simulator.body_size(), cotangent);
    Sensitivity gradient;
    simulator.Adjoint(cotangent, true, &gradient);
    AddEffortGradient(objective, control, simulator.step(), gradient.control);
    return gradient;
  }
  // The derivative of one entry of the final state.
  Sensitivity GradientOf(int entry) {
    std::vector<double> cotangent(simulator.state_size());
    cotangent[entry] = 1;
    Sensitivity gradient;
    simulator.Adjoint(cotangent, true, &gradient);
    return gradient;
  }
  double TimeOf(const StepTouch& touch) const { return touch.step * simulator.step() + touch.touch.time; }

  const std::unique_ptr<Simulator> owned;
  Simulator& simulator;
  std::vector<double> control;
  bool finite = false;
};

}  // namespace saltus::testing
