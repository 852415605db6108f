// A comparison of every solver under every contact model.
//
// Tasks 2 (without and with friction) and 3 under the models that the published comparisons report, and task 3 under
// all others. Losses under a contact model may not be compared between models; exact losses may, and their gap to the
// optimum is what is left to gain. Solvers that know exact dynamics only (optima on the grid, phases between events,
// the minimum principle) appear with the event-driven model.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"

namespace saltus {

class SolverComparison {
 public:
  // The solvers that run under models without experiments: none; those that take a second or two; or every general
  // solver, however slow the model.
  enum class Others { kNone, kQuick, kEverySolver };

  // Takes the results that `experiments`, which have been run, contain; the rest is left to Run.
  explicit SolverComparison(const Experiments& experiments, Others others = Others::kQuick);

  // Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  // Contact models whose gradients take so long that gradient descent was left out.
  const std::set<std::string>& slow() const { return slow_; }

  // Returns the iterates that DescentAudit examines, of gradient descent on task 3 under a model without experiments;
  // empty if it was not run.
  std::vector<std::vector<double>> IteratesOf(const std::string& contact) const;

  Section Results() const { return {Findings(), Tables(), {LearningCurves(), ControlProfiles(), Defects()}}; }
  // Returns the table of task 3 under exact dynamics: three solvers compared with the optimum.
  Table Headline() const;

 private:
  // One scene and the runs on it.
  struct Task {
    std::string name;  // of its table
    std::string title;
    Scene scene;
    double optimum = 0;           // of the exact loss
    std::vector<SolvedRun> runs;  // contact models outermost; planned ones have names only

    const SolvedRun* Find(const std::string& contact, const std::string& solver) const;
    // Returns the gap to the optimum of the best exact loss by a general solver under a model.
    double SmallestGap(const std::string& contact) const;
  };

  void PlanOthers(Others others);
  std::vector<CaptionedTable> Tables() const;
  std::vector<std::string> Findings() const;
  std::string FindingOnOthers() const;
  Table TaskTable(const Task& task) const;
  Table StepShootingTable() const;
  PaperFigure LearningCurves() const;
  PaperFigure ControlProfiles() const;
  PaperFigure Defects() const;

  std::string exact_;           // the event-driven contact model
  std::set<std::string> slow_;  // models whose gradient takes long
  Task launch_, launch_with_friction_, strike_, strike_on_fine_grid_;
  Task others_;  // task 3 under the models that are not in `experiments`
};

}  // namespace saltus
