// Solution of a problem in one line, and results that print.
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

// The solver, and limits of a solve.
struct RunOptions {
  std::string solver = "auto";  // a name of hybrid_solver.h or, for scenes, of solver.h
  Contact contact = "event";    // for scenes only
  int iterations = 1000;        // largest number of iterations
  double seconds = 0;           // limit of time, s; 0: none
  std::function<bool(int iteration, double loss)> callback =
      nullptr;  // SolverOptions::Monitor::callback; false interrupts
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
  double loss() const { return report_.solution.loss; }
  // Returns control, durations, losses, iterations and everything else that the solver reports.
  const SolveReport& report() const { return report_; }
  // Returns the certificate of the solution; kNotApplicable if there is nothing to certify.
  const Certificate& certificate() const { return certificate_; }
  // Returns the values of the unknowns with names: components of the initial state, parameters, "duration"; of a scene
  // its design parameters and "duration" only.
  const std::vector<NamedValue>& found() const { return found_; }
  // Returns the value of that name. Throws std::invalid_argument if nothing of that name was free.
  double operator[](const std::string& name) const;

 private:
  SolveReport report_;
  Certificate certificate_;
  std::vector<NamedValue> found_;
};
// Prints solver, termination with its reason, the loss before and after, and the values found, in a few lines.
std::ostream& operator<<(std::ostream& out, const Run& run);
// Prints verdict, reason, residuals and curvature.
std::ostream& operator<<(std::ostream& out, const Certificate& certificate);

// Solves a problem. If no control is free, it is solved on 64 control intervals or more, at which equalities of
// kAlways are checked; this does not change the motion. Throws std::invalid_argument if the problem is wrong or the
// solver does not support it. If the motion fails, the run has not converged, and has the reason.
Run Solve(const Problem& problem, const RunOptions& options = {});
Run Solve(const Scene& scene, const RunOptions& options = {});

}  // namespace saltus
