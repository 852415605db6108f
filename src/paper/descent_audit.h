// Gradient descent under each contact model: the angle of its gradient to the exact one, and the exact loss along the
// descent. Shows how optimisation can succeed with wrong gradients, and where it fails.
#pragma once

#include <string>
#include <vector>

#include "paper/paper_figures.h"
#include "programs/program.h"

namespace saltus {

class DescentAudit {
 public:
  using Task = TitledScene;

  // Returns the iterations that are examined: 0, 1, 2, 3, 5, 8, ... to the last.
  static std::vector<int> ExaminedIterations();

  // Contact models that cannot simulate a scene are left out there; so are those of `slow`.
  DescentAudit(std::vector<Task> tasks, std::vector<std::string> contacts, const std::vector<std::string>& slow);

  // Takes the iterates at ExaminedIterations() of a descent that was run elsewhere with the same rate: it is not run
  // again.
  void UseIterates(size_t task, const std::string& contact, std::vector<std::vector<double>> iterates);

  // Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  PaperFigure ToFigure() const;
  // Returns the findings, in a sentence or two each.
  std::vector<std::string> Findings() const;

 private:
  // One descent, examined at some of its iterates.
  struct Descent {
    size_t task = 0;
    std::string contact;
    std::vector<double> iterations, angles, exact_losses, losses;  // angles in degrees
    std::vector<std::vector<double>> known = {};                   // iterates that are looked at, or nothing
  };
  void Follow(Descent* descent) const;

  std::vector<Task> tasks_;
  std::vector<std::string> left_out_;
  std::vector<Descent> descents_;
};

}  // namespace saltus
