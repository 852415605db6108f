// The gradient of a randomly smoothed loss, estimated from samples (Suh, Simchowitz, Zhang, Tedrake 2022, "Do
// Differentiable Simulators Give Better Policy Gradients?").
//
// With z the decision variables and L the terminal terms of the loss, the smoothed loss is
//
//   F(z) = E L(z + sigma w),  w ~ N(0, I);       its gradient is estimated from S samples in pairs (w, -w) by
//
//   first order    mean of grad L(z + sigma w) over all samples
//   zeroth order   mean of [L(z + sigma w) - L(z - sigma w)] / (2 sigma) w over all pairs
//
// The effort is known, and its gradient is added exactly. Both estimates are unbiased for grad F where L has no jumps.
// A model whose impacts wait for the end of a step makes L jump wherever an impact changes step: first order misses the
// jumps, zeroth order does not, provided sigma is larger than the distance between them (the length of a step times the
// speed of impact, for positions). The difference of F from L is O(sigma^2), so both are biased for grad L. The
// standard error of zeroth order is that of the mean of |grad L| w-like numbers, about |grad L| sqrt(2 / S) in each
// component; fewer variables (segments of the control) have a smaller gradient to disturb them.
#pragma once

#include <span>
#include <vector>

#include "saltus/control/batch.h"
#include "saltus/control/surrogate.h"

namespace saltus {

class SmoothedGradient {
 public:
  using Variables = SingleShooting::Variables;

  // Samples are evaluated on `threads` threads; estimates have the same bits for any number. Preconditions: as those of
  // MakeSimulator, `surrogate` smooths, is valid and applicable.
  SmoothedGradient(const Contact& contact, const Scene& scene, Precision precision, const Surrogate& surrogate,
                   int threads = 1, Variables variables = Variables::kOptimized);

  void set_memory_limit(std::size_t bytes) { batch_.set_memory_limit(bytes); }
  void set_stop(const StopRequest& stop) { batch_.set_stop(stop); }
  int num_variables() const { return batch_.num_variables(); }
  const std::vector<double>& initial_guess() const { return batch_.initial_guess(); }

  // The estimate at z, from normals with the seed of that iteration, and the standard error of each component
  // (num_variables() numbers each). With segments, zeroth order gives all steps of a segment their mean. False if the
  // loss of a sample is not finite, or if it was stopped.
  bool Evaluate(std::span<const double> z, int iteration, std::span<double> gradient, std::span<double> standard_error);

 private:
  bool zeroth() const { return surrogate_.kind == SurrogateKind::kSmoothedZeroth; }
  void Perturb(std::span<const double> z, int pairs);

  Objective objective_;
  double step_;  // s, of the control
  bool controls_;
  Surrogate surrogate_;
  Batch batch_;                                                // of the terminal terms
  std::vector<int> place_;                                     // of each variable: the normal that perturbs it
  std::vector<double> multiplicity_;                           // of each normal: how many variables it perturbs
  std::vector<double> normals_, points_, losses_, gradients_;  // of some pairs at a time
};

}  // namespace saltus
