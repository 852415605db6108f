// Every contact model on the three tasks of the paper: how wrong its gradient is, of which class it is, and what a step
// of it costs.
#pragma once

#include <string>
#include <vector>

#include "paper/paper_figures.h"
#include "paper/solver_comparison.h"
#include "programs/simulators.h"
#include "saltus/audit/audit.h"

namespace saltus {

class FormulationAudit {
 public:
  using Task = TitledScene;

  // Precondition: `contacts` has `direct`, whose step is the unit of cost. Simulators are audited beside them; what
  // their steps cost is not measured.
  FormulationAudit(std::vector<Task> tasks, std::vector<std::string> contacts,
                   std::vector<SimulatorCommand> simulators = {});

  // False if interrupted.
  bool Run(int threads, ProgressMode progress);

  CaptionedTable ToTable() const;
  PaperFigure ToFigure() const;
  // Every class that was found: what it means, and which models are of it.
  std::vector<std::string> Classes() const;

 private:
  struct Results {
    Task task;
    AuditReport report;
    std::vector<double> costs;  // of each model, in those of `direct`; 0 if it cannot take the scene
  };

  // |g - g_exact| / |g_exact| over initial positions and velocities.
  double ErrorByInitialState(const Results& results, size_t model) const;
  // "continuous force" or, where tasks differ, "continuous force (1), force with a jump (2, 3)".
  std::string ClassesOf(size_t model) const;
  double CostOf(size_t model) const;
  ModelAudit Audit(size_t model, const Results& results) const;

  std::vector<std::string> contacts_;  // those of simulators last
  std::vector<SimulatorCommand> simulators_;
  std::vector<Results> tasks_;
};

}  // namespace saltus
