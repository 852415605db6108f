// Solves in one line, and results that print.
//
//   const saltus::Run run = saltus::Solve(problem, {.seconds = 10});
//   std::cout << run << run.certificate();
#pragma once

#include <functional>
#include <iosfwd>
#include <string>
#include <utility>
#include <vector>

#include "saltus/optimality/certificate.h"
#include "saltus/outer/problem.h"
#include "saltus/scene/scene.h"
#include "saltus/solve/solver.h"

namespace saltus {

// Limits of a solve, and which solver takes it.
struct RunOptions {
  std::string solver = "auto";  // solvers of hybrid_solver.h, or of scenes those of solver.h
  Contact contact = "event";    // of scenes
  int iterations = 1000;        // at most
  double seconds = 0;           // at most; 0: no limit
  std::function<bool(int iteration, double loss)> callback = nullptr;  // false interrupts
};

// A number with its name.
struct NamedValue {
  std::string name;
  double value = 0;
};

// The result of a solver.
class Run {
 public:
  Run(SolveReport report, Certificate certificate, std::vector<NamedValue> found)
      : report_(std::move(report)), certificate_(std::move(certificate)), found_(std::move(found)) {}

  bool converged() const { return report_.termination == Termination::kConverged; }
  double loss() const { return report_.final_loss; }
  // Control, durations, losses, iterations and all else that a solver reports.
  const SolveReport& report() const { return report_; }
  // Whether the solution is an optimum, and why; kNotApplicable where nothing can be certified.
  const Certificate& certificate() const { return certificate_; }
  // The values of what was free by name: components of the initial state, parameters, the duration.
  const std::vector<NamedValue>& found() const { return found_; }
  // Returns the value of that name. Throws std::invalid_argument if nothing of that name was free.
  double operator[](const std::string& name) const;

 private:
  SolveReport report_;
  Certificate certificate_;
  std::vector<NamedValue> found_;
};
// Prints the solver, the loss before and after, why it ended, and what was found, in a few lines.
std::ostream& operator<<(std::ostream& out, const Run& run);
// Prints verdict, reason, residuals and curvature.
std::ostream& operator<<(std::ostream& out, const Certificate& certificate);

// Solves a problem. Where no control is free, it is solved on 64 control intervals or more, which leaves the motion as
// it is: conditions that hold always are looked at there. A wrong problem, or a solver that cannot take it, throws
// std::invalid_argument; a motion that fails is a run that is not converged, with its reason.
Run Solve(const Problem& problem, const RunOptions& options = {});
Run Solve(const Scene& scene, const RunOptions& options = {});

}  // namespace saltus
