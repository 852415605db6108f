// An audit of every contact model on the three tasks of the paper: the error of its gradient, its class, and the cost
// of a step.
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

  // Precondition: `contacts` has `direct`, whose step is the unit of cost. Simulators are audited beside them; the
  // costs of their steps are not measured.
  FormulationAudit(std::vector<Task> tasks, std::vector<std::string> contacts,
                   std::vector<SimulatorCommand> simulators = {});

  // Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  CaptionedTable ToTable() const;
  PaperFigure ToFigure() const;
  // Returns every class that was found: what it means, and which models belong to it.
  std::vector<std::string> Classes() const;

 private:
  struct Results {
    Task task;
    AuditReport report;
    std::vector<double> costs;  // of each model, in those of `direct`; 0 if it cannot take the scene
  };

  // Returns |g - g_exact| / |g_exact| over initial positions and velocities.
  double ErrorByInitialState(const Results& results, size_t model) const;
  // Returns "continuous force" or, where tasks differ, "continuous force (1), force with a jump (2, 3)".
  std::string ClassesOf(size_t model) const;
  double CostOf(size_t model) const;
  ModelAudit Audit(size_t model, const Results& results) const;

  std::vector<std::string> contacts_;  // those of simulators last
  std::vector<SimulatorCommand> simulators_;
  std::vector<Results> tasks_;
};

}  // namespace saltus
