// The parts of a mode whose recorded flow is affine with constant coefficients (LinearFlow): blocks of the state
//
//   x_k' = A_k x_k + b_k t + C_k p + B_k u_k + d_k
//
// that read no other block's states or controls, such as the two balls of task 3 between impacts. Each block has a
// closed form. Blocks that the same events concern are one part, if all of them have a control or none has.
#pragma once

#include <vector>

#include "hybrid/recorded_functions.h"
#include "saltus/internal/hybrid_functions.h"
#include "saltus/internal/linear_flow.h"

namespace saltus {

class LinearParts {
 public:
  // Divides a mode with the given numbers of states, parameters and controls. `derivatives` are those of
  // AffineDerivatives(flow.recording(), ...). There are no parts if the flow has one block only, or if a guard reads
  // the control. Precondition: guards read [x t p] or [x t p u], resets [x t p].
  LinearParts(const RecordedFunction& flow, const std::vector<LinearFlow::Entry>& derivatives,
              const std::vector<RecordedSystem::Transition>& transitions, int num_states, int num_parameters,
              int num_controls);

  // Returns the parts; none, or two and more.
  const std::vector<StatePart>& parts() const { return parts_; }
  // Moves a part (HybridFunctions::MovePart).
  void Move(int part, const FlowStep& step, double* after, double* jacobian) const;
  // Returns the parts whose states a guard reads, or its reset reads or changes.
  const std::vector<int>& PartsOf(int guard) const { return of_guards_[guard]; }

 private:
  struct Block {
    std::vector<LinearFlow::Entry> derivatives;  // of the flow, by [x t p u] of the part
    std::vector<double> rest;                    // d
    LinearFlow closed_form;
  };
  void SetSlope(int part, const FlowStep& step, double t, const double* x, double* slope) const;

  int num_parameters_;
  std::vector<StatePart> parts_;
  std::vector<Block> blocks_;
  std::vector<std::vector<int>> of_guards_;
};

}  // namespace saltus
