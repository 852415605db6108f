// Many points of one problem at once: multi-start, sampling, studies of initial conditions or controls.
//
// Points are shared among threads, and those of a thread simulated in groups whose flights go through the lanes of the
// core together (SingleShooting::EvaluateTogether). No two motions of a group share a simulator and no two results
// share a place, so that results have the bits of single evaluations, for any number of threads.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"

namespace saltus {

class Batch {
 public:
  // Points are decision variables of `scene` (single_shooting.h). `threads` at most; 0 is one per core. Preconditions
  // as those of MakeSimulator.
  Batch(const Contact& contact, const Scene& scene, Precision precision, int threads = 0,
        SingleShooting::Variables variables = SingleShooting::Variables::kOfScene);

  // Sets the limit of Simulator::set_memory_limit for each thread.
  void set_memory_limit(std::size_t bytes);
  // Sets the request of Simulator::set_stop; a loss whose rollout was stopped is NaN.
  void set_stop(const StopRequest& stop);

  int num_variables() const { return shootings_.front()->num_variables(); }
  const std::vector<double>& initial_guess() const { return shootings_.front()->initial_guess(); }
  // How many points of a thread are evaluated at once.
  int num_lanes() const { return num_lanes_; }
  int num_threads() const { return static_cast<int>(shootings_.size()) / num_lanes_; }

  // The losses at P points (P x num_variables(), row by row) and, unless empty, the gradients there (the same shape).
  // Where rollout or loss are not finite, the loss is NaN, and the gradient too.
  void Evaluate(std::span<const double> points, std::span<double> losses, std::span<double> gradients = {});

  // Calls job(shooting, i) for i = 0 .. count - 1, each once, from several threads; no two jobs that run at the same
  // time get the same `shooting`. Results must neither depend on what it has been used for nor share a place.
  void ForEach(int count, const std::function<void(SingleShooting* shooting, int i)>& job);

 private:
  std::vector<std::unique_ptr<SingleShooting>> shootings_;  // num_lanes_ per thread
  int num_lanes_ = 1;
};

}  // namespace saltus
