// Solvers of scenes: request, options, report, and the registry.
//
// Solvers do not depend on contact models: they make simulators from a Contact (simulate/registry.h). In this file, C
// is the number of controlled discs; a control has K rows of Scene::control_width() numbers, [u_x u_y] of each of these
// discs and then torque / radius of each disc with a torque control (K x C x 2 without); and an initial state is B x 4,
// or B x 6 in scenes with discs that spin (simulate/simulator.h).
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/control/surrogate.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// Why a solver ended. kNoProgress: without an optimum, because no step lowers the loss further, or because the
// certificate or the exact model denies the solution.
enum class Termination { kConverged, kIterationLimit, kNoProgress, kFailed, kInterrupted, kNotApplicable };
// Returns the name that JSON uses, such as "iteration_limit".
const char* TerminationToString(Termination termination);

// A problem, and the dynamics under which it is solved.
struct SolveRequest {
  Scene scene;
  Contact contact;
  Precision precision = Precision::kDouble;
  // User-defined terms in addition to the scene's objective and constraints: terms of the hybrid problem of the scene
  // (control/scene_problem.h), in SI units; for solvers that support them.
  std::vector<HybridTerm> terms = {};
};

// Limits and starts of a search over collision sequences. The limit that is reached first ends it.
struct SearchOptions {
  // Limit of the work of all solves, in units of about one microsecond on one core: each gradient or Jacobian counts as
  // an estimate of its time. No clock is read, so that the result depends neither on the machine nor on the number of
  // threads. 0: no limit.
  double work = 2e7;
  double seconds = 0;  // limit of time, s; 0: none. The result then depends on the machine and its load
  std::size_t memory = std::size_t{200} << 20;  // limit of the memory, bytes
  int starts = 8;                               // number of random starts, in addition to the initial guess
  std::uint64_t seed = 1;                       // of the random starts
};
// Returns the error in the options and what was expected; empty if there is none.
std::string Validate(const SearchOptions& options);

// An initial guess of the control: K rows of control_width() forces in N, for any K, on intervals that last `durations`
// (K numbers >= 0, s), or on equal intervals if there are none.
struct ControlGuess {
  std::vector<double> control, durations;
};

struct SolverOptions {
  // Limits that end a solve.
  struct Limits {
    int iterations = 1000;                      // largest number of iterations; of mode_search: of solves
    std::size_t memory = std::size_t{1} << 30;  // of Simulator::set_memory_limit, bytes
    // Largest number of impacts of one motion, for solvers by shooting: a motion with more interrupts them.
    std::optional<int> impacts = std::nullopt;
  };
  Limits limits = {};

  // Gradient descent: z <- z - learning_rate * gradient.
  struct Descent {
    double learning_rate = 0.01;
    // Whether the learning rate is divided by the length of a step (s), because a force that acts for a shorter time
    // has a smaller derivative. For controls only.
    bool rate_per_time = false;
  };
  Descent descent = {};

  // A replacement of the gradient, for solvers that support one.
  std::optional<Surrogate> surrogate = std::nullopt;

  // An initial guess that replaces that of the scene; only if a control is optimized. Solvers on a grid of equal steps
  // take its mean over each of them. The sum of the intervals is the scene's duration or, if that is free, its initial
  // guess.
  std::optional<ControlGuess> guess = std::nullopt;

  // Collision sequences, for solvers that need one.
  struct Sequences {
    // The sequence; if none is given, that of the motion of the initial guess. Events of a hybrid system are
    // {a = mode, b = guard}, and {a = last mode, b = -1} ends the sequence.
    std::optional<ContactSequence> given = std::nullopt;
    // Lets mode_search change it, and without a given sequence also solvers with an active-set update of it.
    bool search = true;
    SearchOptions limits = {};  // of mode_search
  };
  Sequences sequences = {};

  // Whether solvers in phases of a hybrid system that end without an optimum try again with few control intervals,
  // whose number they double up to that of the guess, each time from the solution before.
  bool coarse_to_fine = true;
  bool keep_iterates = false;  // whether SolveReport::history.iterates is filled (single shooting)
  // The number of threads for the samples of a surrogate and for the solves of a search; results do not depend on it.
  int threads = 1;

  // How a caller follows and interrupts a solve.
  struct Monitor {
    // Called after each iteration with its number (0 is the initial guess) and the loss there. If it returns false, the
    // solver stops with kInterrupted and reports the result so far.
    std::function<bool(int iteration, double loss)> callback = nullptr;
    // Interrupts within an iteration as soon as it returns true; the result of the last complete iteration is reported.
    StopRequest stop = nullptr;
    // Receives lines about what is being computed, for a user to read, from solvers that take long.
    std::function<void(const std::string&)> status = nullptr;
  };
  Monitor monitor = {};
};

// One optimum of a search over collision sequences.
struct LocalOptimum {
  ContactSequence sequence;
  double loss = 0;
  std::vector<double> times;  // of the impacts, s
};

// Statistics of a search over sequences, and bounds that it has proved.
struct SearchStatistics {
  int sequences = 0;      // number of sequences along which it solved
  int starts = 0;         // number of motions from which it started, with the initial guess
  double work = 0;        // counted as SearchOptions::work
  bool complete = false;  // whether the search ended by its own rule, and no limit restricted it
  double lower_bound =
      0;  // of the loss of any control on as many intervals, with any impacts; 0 if parameters are free
  // The result of branch and bound over all controls, if it was run: the loss less the bound, and the number of boxes.
  struct Proof {
    double gap = 0;
    std::size_t boxes = 0;
  };
  std::optional<Proof> proof;
};

// A motion, by what it depends on. Vectors are empty if the problem or the solver has no such part.
struct Solution {
  double loss = 0;  // under the contact model
  // The violation of constraints: the largest of hard terms and bounds on the control, in natural units of the scene
  // (units.h). It is infinite if discs that must not touch do so. Residuals of a hybrid problem, which a scene with
  // user-defined terms is too, that change by less than 0.1 or more than 500 as the states, controls and parameters
  // that they read change by their sizes in the motion of the guess are divided by this change. Only solvers that
  // support constraints set it.
  double violation = 0;
  std::vector<double> initial_state = {};  // B x 4 or B x 6, or the state of a hybrid system
  std::vector<double> control = {};        // K x control_width() forces, N; K x m for a hybrid system
  std::vector<double> durations = {};      // of the K control intervals, s; none if they are equal
  std::vector<double> parameters = {};     // all of a hybrid system; or the values of Scene::design
  double integration_error = 0;            // of a hybrid system: relative error of final state and event times
};

// The result of a solver. kConverged means that the solver's own measure is met for the loss under the contact model;
// under the exact model, if a certificate applies, its conditions hold too, and the solution is no saddle.
//
// Losses are sums of squares without the half of Ceres. A kNotApplicable run has names and reason only; a kFailed run
// may have no losses, if the initial guess has none.
struct SolveReport {
  std::string contact;                 // Contact::name(); empty for a hybrid problem
  std::string solver;                  // the name of the solver that was used, also by `auto`
  std::optional<Surrogate> surrogate;  // if set, the run is biased: the surrogate replaced the derivative of the loss
  Termination termination = Termination::kFailed;
  std::string reason;  // the reason of kFailed and kNotApplicable; otherwise a remark, if there is one

  // The loss and the violation (Solution) at the initial guess.
  struct Guess {
    double loss = 0, violation = 0;
  };
  Guess guess;
  Solution solution;

  struct Work {
    int iterations = 0;
    int evaluations = 0;  // number of computed gradients or Jacobians
    double seconds = 0;   // time of the solve, s
  };
  Work work;

  // The iterates of solvers that have them.
  struct History {
    std::vector<double> losses;                 // losses[k] after k iterations; losses[0] at the initial guess
    std::vector<std::vector<double>> iterates;  // decision variables after k iterations, if asked for
    // The iterate with the lowest loss, of gradient descent, which returns its last iterate. Its vectors are empty if
    // the last iterate is the best.
    struct Best {
      int iteration = 0;
      Solution solution = {};
    };
    std::optional<Best> best;
    std::vector<double> standard_error;  // of the last smoothed gradient, one per decision variable (single_shooting.h)
    // Step shooting: the largest component of the defect of each step, in natural units of the scene (units.h); one
    // vector each time that defects were computed, the last one at the solution. The loss is that of a rollout, with
    // any defects.
    std::vector<std::vector<double>> defects;
  };
  History history;

  std::optional<Certificate>
      certificate;                        // of solvers with a certificate, and of runs that converged in exact dynamics
  std::optional<Certificate> continuous;  // of hmp: the conditions in continuous time, at the optimum there
  std::vector<LocalOptimum> optima;       // of mode_search: all optima, best first
  std::optional<SearchStatistics> searched;  // of mode_search
};

inline constexpr double kFeasible = 1e-8;  // the largest Solution::violation of a feasible motion

// Returns whether a run ends worse than it began, with a larger violation of constraints above kFeasible or, if both
// motions are feasible, with a loss that is larger by more than 1e-9, relatively.
bool EndsWorse(const SolveReport& report);

struct SolverEntry {
  std::string_view name;     // the value of --solver
  std::string_view summary;  // one line
  // Returns why it does not support a request (apart from reasons of the contact model); empty if it does.
  std::string (*reason_not_applicable)(const SolveRequest&);
  SolveReport (*solve)(const SolveRequest&, const SolverOptions&);
  bool exact_only = false;       // supports the event-driven contact model only
  bool takes_surrogate = false;  // supports surrogates, because it uses the gradient as a direction only
  bool any_units = false;        // has no thresholds; the others compute in the natural units of the scene (units.h)
  bool constraints = false;      // supports what NonTerminalFeatures() names, with exceptions by reason_not_applicable
  bool user_terms = false;       // supports SolveRequest::terms, with the scene as a hybrid problem
  bool design = false;           // supports Scene::design
  // Whether it solves a scene with Scene::design and a control as a hybrid problem whose parameters are Scene::design.
  bool given_design = false;
};

// Returns the solvers without those of SolversByName().
const std::vector<SolverEntry>& AllSolvers();
// Returns the solver of that name, of AllSolvers() or SolversByName(); null if there is none.
const SolverEntry* FindSolver(std::string_view name);

// Runs the solver of that name. The report is kNotApplicable with the reason if the model or the solver does not
// support the request or the surrogate, if the name is unknown, or if the scene, the surrogate or an option is wrong.
SolveReport Solve(std::string_view solver, const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
