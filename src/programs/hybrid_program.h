// The main of the programs of hybrid systems:
//
//   int main(int argc, char** argv) { return saltus::RunHybridProgram(argc, argv, Hopper(), HopperProblem()); }
//
// simulates the guess, computes the loss with its gradient, runs solvers and audits a scheme, and writes tables, JSON
// and a page. In addition to hybrid_system.h, the system may have
//
//   template <typename Drawing>
//   void Draw(int mode, double t, const double* x, const double* p, Drawing* drawing) const;
//
// which adds line segments and circles (HybridDrawing) of a state for the replay, and Step (audit/hybrid_audit.h), a
// time-stepping scheme for --audit.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "programs/feedback_study.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/audit/hybrid_audit.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {

// The picture of a state. Lengths are in the system's units; x points to the right, y up.
class HybridDrawing {
 public:
  void Line(double x0, double y0, double x1, double y1) { lines_.push_back({x0, y0, x1, y1}); }
  void Circle(double x, double y, double radius) { circles_.push_back({x, y, radius}); }

  const std::vector<std::array<double, 4>>& lines() const { return lines_; }
  const std::vector<std::array<double, 3>>& circles() const { return circles_; }

 private:
  std::vector<std::array<double, 4>> lines_;
  std::vector<std::array<double, 3>> circles_;
};

using DrawState = std::function<void(int mode, double t, const double* x, const double* p, HybridDrawing* drawing)>;

// The functions of a program's system beside those of the motion; empty if it has none.
struct HybridExtras {
  DrawState draw;
  std::shared_ptr<HybridScheme> scheme;
  nlohmann::ordered_json scene = {};  // what commands of --simulate are told beside the names of the system
};

template <typename S>
HybridExtras ExtrasOf(const S& system) {
  HybridExtras extras;
  if constexpr (requires(const double* x, HybridDrawing* drawing) { system.Draw(0, 0.0, x, x, drawing); }) {
    extras.draw = [system](int mode, double t, const double* x, const double* p, HybridDrawing* drawing) {
      system.Draw(mode, t, x, p, drawing);
    };
  }
  if constexpr (requires(const double& t, const double* x, double* next) { system.Step(0, t, x, x, x, t, next); }) {
    extras.scheme = std::make_shared<HybridSchemeOf<S>>(system);
  }
  return extras;
}

// The problem of a program, and its functions for drawings and schemes.
struct HybridTask {
  HybridProblem problem;
  HybridExtras extras = {};
  std::string name = {};  // in results
};

// `read` is called once flags are read; it may throw InputError.
int RunHybridProgram(int argc, char** argv, const Program& program, const std::function<HybridTask()>& read);

// Runs the program of one problem. Precondition: problem.system is that of `system`.
template <typename S>
int RunHybridProgram(int argc, char** argv, const S& system, const HybridProblem& problem) {
  const Program program = HybridProblemProgram(argv[0]);
  return RunHybridProgram(argc, argv, program, [&] { return HybridTask{problem, ExtrasOf(system), program.name}; });
}

// The document of a problem of a hybrid system, as JSON: the system, its motion from the guess, gradients and
// solutions. The programs print it, their pages show it, and Python reads it; docs/reference/json.md has its keys
// ("hybrid.json").

Json HybridSystemToJson(const HybridSystem& system);
// Returns the input of a motion.
Json HybridInputToJson(const HybridSystem& system, const HybridInput& input);

// Returns the simulator's last rollout. With `states` also "times", "modes", "states" and "guards" (the values of the
// mode's guards): at every step of the integration, and before and after every event; and with `draw` "frames", their
// drawings as {"lines", "circles"}.
Json HybridMotionToJson(const HybridSimulator& simulator, const HybridInput& input, bool ok, bool states,
                        const DrawState& draw = nullptr);

// The motion from an input with as many states as a figure needs.
Json DrawnMotionToJson(const HybridProblem& problem, const HybridInput& input, const DrawState& draw = nullptr);

// Adds "integration_error" of the simulator's last rollout, which succeeded, and the remarks on it. Costs a rollout.
void AddIntegrationError(const HybridProblem& problem, HybridSimulator* simulator, Json* motion);

// The loss at the guess and its gradient by all that the motion depends on, or "failed" with the reason. `motion`, if
// given, becomes that of the guess.
Json HybridLossToJson(const HybridProblem& problem, bool states, Json* motion = nullptr);

// An entry of "runs"; of what is not applicable "solver", "termination" and "reason".
Json HybridRunToJson(const HybridProblem& problem, const SolveReport& report, bool states);

// An entry of "audits" (saltus/audit/hybrid_audit.h).
Json HybridAuditToJson(const HybridProblem& problem, const HybridAudit& audit);

// The tables of a document, for the terminal and for the page.
Table EventsTable(const Json& motion);
Table GradientTable(const Json& document);
Table RunsTable(const Json& document);
// Returns the variables beside the control that some solver has changed: their values in the guess and in each
// solution.
Table SolutionTable(const Json& document);
Table AuditsTable(const Json& document);
// Returns the loss of the initial guess, or why there is none or no gradient.
std::string DescribeLoss(const Json& document);
// Returns the feedback studies of each solution, or of the guess if there are no solvers.
NamedStudies StudiesIn(const Json& document);

// Returns the page of a document, whose motions have their states and, to be played, their frames.
Page HybridPage(Json document);

}  // namespace saltus
