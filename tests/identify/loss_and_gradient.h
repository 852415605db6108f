// What a contact model makes of a scene's loss at the end, with its gradient by the adjoint.
#pragma once

#include <gtest/gtest.h>

#include <vector>

#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"

namespace saltus {

struct LossAndGradient {
  double loss = 0;
  Sensitivity gradient;
};
inline LossAndGradient Evaluate(const Contact& contact, const Scene& scene) {
  LossAndGradient out;
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())))
      << simulator->WhyFailed();
  std::vector<double> end(simulator->state_size()), cotangent(end.size());
  simulator->GetState(simulator->num_steps(), end);
  out.loss = TerminalLoss(scene.objective, end, 4);
  TerminalGradient(scene.objective, end, 4, cotangent);
  simulator->Adjoint(cotangent, true, &out.gradient);
  return out;
}

}  // namespace saltus
