// Loss and exact gradient of a scene under the event-driven model.
#pragma once

#include <gtest/gtest.h>

#include "contact/event.h"
#include "saltus/control/objective.h"
#include "saltus/internal/model_simulator.h"

namespace saltus::testing {

using EventSimulator = ModelSimulator<EventDriven, double>;

inline std::vector<double> HeldControl(const Scene& scene) {
  std::vector<double> control;
  for (int k = 0; k < scene.steps; ++k) {
    for (const Vec2d& force : scene.control.initial) control.insert(control.end(), {force[0], force[1]});
  }
  return control;
}

inline std::vector<double> StartOf(const Scene& scene) { return InitialState(scene); }

// A rollout from the scene's own start under its own forces.
template <ContactModel M>
struct EventRunOf {
  explicit EventRunOf(const Scene& scene) : simulator(scene, Precision::kDouble), control(HeldControl(scene)) {
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

  ModelSimulator<M, double> simulator;
  std::vector<double> control;
  bool finite = false;
};

using EventRun = EventRunOf<EventDriven>;
// Of scenes with discs that spin.
using SpinRun = EventRunOf<EventSpinning>;

}  // namespace saltus::testing
