// The task of two balls by solvers that shoot over the impact and by those that treat it as an event, on the paper's
// time grid and on a finer one; and with bounds on the force, beside the optima in continuous time.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "paper/solver_comparison.h"

namespace saltus {

// An optimum of data/constrained_references.json under a bound on the force.
struct BoundedReference {
  Vec2d target = Vec2d::Zero();         // m, where the disc that is struck starts
  std::optional<double> max, max_norm;  // N
  double loss = 0, impact_time = 0;
  Vec2d at_start = Vec2d::Zero(), at_impact = Vec2d::Zero();  // N, the force without the bound, linear between

  Vec2d Force(double time) const;  // that within the bound
};

// Reads the references that the figure shows. Throws InputError.
std::vector<BoundedReference> ReadBoundedReferences(const std::string& path);

class StrikeComparison {
 public:
  // `scene` is the scene of the task.
  StrikeComparison(const Scene& scene, std::vector<BoundedReference> references);

  // Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  std::vector<CaptionedTable> Tables() const;
  std::vector<PaperFigure> Figures() const;
  std::vector<std::string> Findings() const;

 private:
  struct Entry {
    std::string label;
    Scene scene;
    std::string solver;
    SolverOptions options;
    double optimum = 0;
    int reference = -1;  // -1: without bounds
    SolvedRun run;
  };

  void Plan(const Scene& scene, const std::string& solver, const std::string& label, double optimum, int reference,
            bool rate_per_time);
  const Entry* Find(int reference, const std::string& label, int steps) const;

  std::vector<BoundedReference> references_;
  std::vector<Entry> entries_;
};

}  // namespace saltus
