// A run of a solver by single shooting on a problem of a hybrid system.
#pragma once

#include "control/hybrid_shooting.h"
#include "solve/solve_run.h"

namespace saltus {

class HybridRun final : public ShootingRun {
 public:
  HybridRun(std::string_view solver, const HybridProblem& problem, const SolverOptions& options);

  HybridShooting& shooting() { return shooting_; }
  ShootingFunction& function() override { return shooting_; }

 private:
  // What is not smooth there. Also notes the error of the integration.
  std::string RemarkOn(std::span<const double> z, Termination termination) override;

  HybridShooting shooting_;
};

}  // namespace saltus
