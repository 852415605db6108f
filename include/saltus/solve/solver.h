// The request and the report of every solver, and the registry of solvers: one line each in solver.cc.
//
// A solver knows no contact model: it gets a name and asks the registry of simulate/ for a simulator.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/control/own_term.h"
#include "saltus/control/surrogate.h"
#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {

enum class Termination { kConverged, kIterationLimit, kNoProgress, kFailed, kInterrupted, kNotApplicable };
const char* TerminationToString(Termination termination);

// A problem, and the dynamics under which it is solved.
struct SolveRequest {
  Scene scene;
  Contact contact;
  Precision precision = Precision::kDouble;
  // Beside the scene's objective and constraints; for solvers that take them. In SI units, whatever the scene's.
  std::vector<OwnTerm> terms = {};
};

// Limits of a search over collision sequences, and where it begins. The limit that is reached first ends it.
struct SearchOptions {
  // Most work of all its solves together: the gradients and Jacobians, each counted with about as many
  // microseconds as it takes one core. No clock is read, so that the answer depends neither on the machine nor on the
  // number of threads. 0: no limit.
  double work = 2e7;
  double seconds = 0;  // 0: no limit. Where this ends a search, its answer depends on the machine and its load
  std::size_t memory = std::size_t{200} << 20;  // bytes, of what it keeps
  int starts = 8;                               // at random, beside the initial guess
  std::uint64_t seed = 1;                       // of these
};
// Which of them is impossible, and what was expected; empty if none.
std::string WhyNotValid(const SearchOptions& options);

// A control to start from: K x C x 2 forces in N, for any K, on intervals that last `durations` (K numbers, s), or
// equally long ones if there are none.
struct ControlGuess {
  std::vector<double> control, durations;
};

struct SolverOptions {
  int iterations = 1000;        // at most
  double learning_rate = 0.01;  // gradient descent only: z <- z - learning_rate * gradient
  // The rate is one per unit of time: divided by the length of a step, since a force that is held for a shorter time
  // has a smaller derivative. Of a control only.
  bool rate_per_time = false;

  bool keep_iterates = false;  // fill SolveReport::iterates (single shooting)

  // Whether solvers in phases of a hybrid system that end without an optimum try again from few control intervals on,
  // whose number they double up to that of the guess, each time from the solution before.
  bool coarse_to_fine = true;

  // For solvers along a collision sequence: which; if none is given, that of the initial guess. `search` lets
  // mode_search leave it for others, and with none given those that mend it. Hybrid: {mode, guard}..., {last mode, -1}.
  std::optional<ContactSequence> sequence = std::nullopt;
  bool search = true;
  SearchOptions search_options = {};  // of mode_search

  // Where a control is optimized: what to start from in the place of the scene's. Solvers on a grid of equal steps take
  // its mean over each of them. The intervals fill the scene's duration; if that is free, theirs is the first.
  std::optional<ControlGuess> guess = std::nullopt;

  // A replacement of the gradient, for solvers that take one; samples are evaluated on `threads` threads,
  // as are the solves of a search. Results are the same for any number.
  std::optional<Surrogate> surrogate = std::nullopt;
  int threads = 1;

  std::size_t memory_limit = std::size_t{1} << 30;  // bytes, as Simulator::set_memory_limit
  // Most impacts of one motion, for solvers by shooting: a motion that has more interrupts them.
  std::optional<int> most_impacts = std::nullopt;

  // Called after each iteration with its number (0 is the initial guess) and the loss there. Return false to interrupt:
  // the solver stops with kInterrupted and reports what it has.
  std::function<bool(int iteration, double loss)> callback = nullptr;
  // Interrupts too, but in the middle of an iteration: what the last whole one has reached is reported.
  StopRequest stop = nullptr;
  // Called by solvers that take long with what they are at, for a person.
  std::function<void(const std::string&)> status = nullptr;
};

// One optimum of a search over collision sequences.
struct LocalOptimum {
  ContactSequence sequence;
  double loss = 0;
  std::vector<double> times;  // of the impacts, s
};

// Sequences that a search has tried, and bounds that it has proved.
struct Searched {
  int sequences = 0;       // along which it solved
  int starts = 0;          // motions of its own from which it began, the initial guess included
  double work = 0;         // as SearchOptions::work
  bool complete = false;   // it has ended by its own rule: no limit has kept it from anything
  double lower_bound = 0;  // of the loss of any control on as many intervals, whatever its impacts
  // The result of a branch and bound over all controls, if one was run: the loss less the bound, and the boxes.
  struct Proof {
    double gap = 0;
    std::size_t boxes = 0;
  };
  std::optional<Proof> proof;
};

// The iterate of least loss, of a solver that returns another.
struct BestIterate {
  double loss = 0;
  int iteration = 0;                  // after how many it was met
  std::vector<double> initial_state;  // B x 4; this and the control are left out if it is the one that is returned
  std::vector<double> control;        // K x C x 2
  std::vector<double> durations;      // as of SolveReport
  std::vector<double> parameters;     // as of SolveReport
};

// kConverged: by the solver's own measure, on the loss under the contact model; if that is exact and the conditions of
// the certificate apply, they hold as well, and it is no saddle.
//
// Losses are sums of squares without Ceres' half. Of a kNotApplicable run only names and reason are filled; a kFailed
// one may have no losses, if the initial guess already has none.
struct SolveReport {
  std::string contact;
  std::string solver;
  std::optional<Surrogate> surrogate;  // the run is biased: its direction was this, not the derivative of its loss
  Termination termination = Termination::kFailed;
  std::string reason;  // for kFailed and kNotApplicable; otherwise may hold a remark
  double initial_loss = 0;
  double final_loss = 0;  // at `initial_state` and `control`, under the contact model
  // The violation of the constraints at the initial guess and at the solution: the largest miss of a hard term or of a
  // bound on the control, a multiple of the scene's natural units (units.h), or the violation of a user's
  // constraint. It is infinite where discs touch that must not. Only solvers that take constraints fill them.
  double initial_violation = 0, final_violation = 0;
  std::vector<double> losses;                 // losses[k] after k iterations; losses[0] at the initial guess
  std::vector<std::vector<double>> iterates;  // decision variables after k iterations, if asked for
  std::optional<BestIterate> best;            // of gradient descent, which returns its last iterate
  int iterations = 0;
  int evaluations = 0;  // gradients (or Jacobians) computed
  double seconds = 0;
  std::vector<double> standard_error;  // of the last smoothed gradient, one per decision variable (single_shooting.h)
  // Step shooting: of each step, the largest component of its defect, a multiple of the scene's natural length or speed
  // (units.h); one vector each time that defects were looked at, the last one at the solution. The loss is that of a
  // rollout, whatever they are.
  std::vector<std::vector<double>> defects;
  std::vector<double> initial_state;       // B x 4
  std::vector<double> control;             // K x C x 2
  std::vector<double> durations;           // of the K control intervals, s; none if they are equal
  std::vector<double> parameters;          // of a hybrid system; or the values of Scene::design
  double integration_error = 0;            // of a hybrid system: relative, of final state and event times
  std::optional<Certificate> certificate;  // of solvers that certify themselves, and of what has converged exactly
  std::optional<Certificate> continuous;   // of hmp: the conditions in continuous time, at the optimum there
  std::vector<LocalOptimum> optima;        // of mode_search: all it found, best first
  std::optional<Searched> searched;        // of mode_search
};

inline constexpr double kFeasible = 1e-8;  // the largest violation of a motion that meets the constraints

// Whether a run ends worse than it began by more than rounding. Violations of constraints are compared first, and
// losses where both motions meet the constraints: the loss of a guess that does not meet them says nothing.
bool EndsWorse(const SolveReport& report);

struct SolverEntry {
  std::string_view name;     // the value of --solver
  std::string_view summary;  // one line
  // Why it cannot take a request (not counting the contact model's own reasons); empty if it can.
  std::string (*why_not)(const SolveRequest&);
  SolveReport (*solve)(const SolveRequest&, const SolverOptions&);
  bool exact_only = false;       // takes the event-driven contact model and no other
  bool takes_surrogate = false;  // needs no more of a gradient than a direction
  bool any_units = false;        // has no thresholds; the others work in the natural units of the scene (units.h)
  bool constraints = false;      // takes what BeyondTerminalCost() names; why_not says which of it not
  bool own_terms = false;        // takes SolveRequest::terms
  bool design = false;           // takes Scene::design
  // Finds optima in exact dynamics whose impacts are on boundaries of control intervals, if on any: Scene::design is
  // then changed by a descent around it.
  bool given_design = false;
};

const std::vector<SolverEntry>& AllSolvers();
const SolverEntry* FindSolver(std::string_view name);

// Runs the solver of that name, after asking the model and the solver whether they can, and with the surrogate, if one
// is given: if not, the report is kNotApplicable with the reason. So it is for unknown names, and where the scene, the
// surrogate or an option is wrong.
SolveReport Solve(std::string_view solver, const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
