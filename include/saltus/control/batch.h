// Batches: losses and gradients at many points of one problem, for multi-start, sampling and studies of initial
// conditions or controls.
//
// Points are divided among threads. A thread simulates several points at once, whose free flights use the lanes of the
// core together (SingleShooting::EvaluateTogether). Results have the bits of single evaluations, for any number of
// threads.
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
  // Makes a batch of points that are decision variables of `scene` (single_shooting.h), on at most `threads` threads; 0
  // is one per core. A free final time and design parameters keep their values. The preconditions are those of
  // MakeSimulator.
  Batch(const Contact& contact, const Scene& scene, Precision precision, int threads = 0,
        SingleShooting::Variables variables = SingleShooting::Variables::kOptimized);

  // Sets the limit of Simulator::set_memory_limit for each thread.
  void set_memory_limit(std::size_t bytes);
  // Sets the request of Simulator::set_stop; a loss whose rollout was stopped is NaN.
  void set_stop(const StopRequest& stop);

  int num_variables() const { return shootings_.front()->num_variables(); }
  const std::vector<double>& initial_guess() const { return shootings_.front()->initial_guess(); }
  // Returns how many points a thread evaluates at once.
  int num_lanes() const { return num_lanes_; }
  int num_threads() const { return static_cast<int>(shootings_.size()) / num_lanes_; }

  // Computes the losses at P points (P x num_variables(), row by row) and, unless empty, the gradients (of the same
  // shape). Loss and gradient are NaN if the rollout or the loss is not finite.
  void Evaluate(std::span<const double> points, std::span<double> losses, std::span<double> gradients = {});

  // Calls job(shooting, i) for i = 0 .. count - 1, each once, from several threads. Jobs that run at the same time get
  // different `shooting`s. Results must not depend on earlier uses of it, and must not share memory.
  void ForEach(int count, const std::function<void(SingleShooting* shooting, int i)>& job);

 private:
  std::vector<std::unique_ptr<SingleShooting>> shootings_;  // num_lanes_ per thread
  int num_lanes_ = 1;
};

}  // namespace saltus
