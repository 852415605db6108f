#include "saltus/solve/solver.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>
#include <utility>

#include "control/hybrid_shooting.h"
#include "control/scene_constraints.h"
#include "optimality/hybrid_conditions.h"
#include "optimality/kink_conditions.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/hybrid_solver.h"
#include "saltus/solve/solvers_by_name.h"
#include "scene/units.h"
#include "solve/control_guess.h"
#include "solve/grid_solver.h"
#include "solve/hmp.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/hybrid_phases.h"
#include "solve/phases/phase_solution.h"
#include "solve/phases/sequence_run.h"
#include "solve/search/global_search.h"
#include "solve/search/mode_search.h"
#include "solve/shooting/single_shooting_solvers.h"
#include "solve/shooting/step_shooting_solvers.h"
#include "solve/solve_chain.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

constexpr double kRounding = 1e-9;  // relative: two losses or violations that differ by less are the same

bool IsLess(double less, double than) { return than - less > kRounding * std::max(std::abs(less), std::abs(than)); }

std::string UnsupportedByGradientDescent(const SolveRequest& request) {
  return UnsupportedByShooting(request, {.components = true, .norm = true});
}

std::string UnsupportedByLbfgs(const SolveRequest& request) { return UnsupportedByShooting(request, {}); }

std::string UnsupportedByLeastSquares(const SolveRequest& request) {
  if (!request.scene.objective.IsSumOfSquares()) {
    return "the loss has a linear term and is no sum of squares: use gd or ceres_lbfgs";
  }
  return ReasonNothingToOptimize(request.scene);
}

std::string UnsupportedByLm(const SolveRequest& request) {
  const std::string reason = UnsupportedByLeastSquares(request);
  return reason.empty() ? UnsupportedByShooting(request, {.components = true}) : reason;
}

std::string UnknownSolver(std::string_view name) {
  std::string known;
  for (const auto* solvers : {&AllSolvers(), &SolversByName()}) {
    for (const SolverEntry& solver : *solvers) known += (known.empty() ? "" : ", ") + std::string(solver.name);
  }
  return "solver: found '" + std::string(name) + "', expected a solver: " + known;
}

std::string Validate(const SolverOptions& options, const Scene& scene) {
  if (std::string wrong = Validate(options); !wrong.empty()) return wrong;
  if (options.descent.rate_per_time && scene.optimize != Optimize::kControl) {
    return "rate_per_time: expected a scene in which a control is optimized";
  }
  if (options.guess) {
    if (scene.optimize != Optimize::kControl) return "guess: expected a scene in which a control is optimized";
    if (std::string wrong = Validate(*options.guess, scene); !wrong.empty()) return wrong;
  }
  if (!options.sequences.given) return "";
  const ContactSequence pairs = AllPairs(scene);
  for (const Candidate& pair : *options.sequences.given) {
    if (std::find(pairs.begin(), pairs.end(), pair) == pairs.end()) {
      return "sequence: found the pair " + std::to_string(pair.a) + ", " + std::to_string(pair.b) +
             ", expected two discs by increasing index, or a disc and a plane, that could collide";
    }
  }
  return "";
}

// Returns the parts of a scene that require a solver with constraints and states along the motion, as a reason.
std::string UnsupportedWithoutConstraints(const Scene& scene) {
  const std::string found = NonTerminalFeatures(scene);
  return found.empty() ? "" : "the scene has " + found + ", which ceres_phases takes";
}

std::string UnsupportedSurrogate(const SolverEntry& entry, const SolveRequest& request, const Surrogate& surrogate) {
  if (std::string wrong = Validate(surrogate); !wrong.empty()) return wrong;
  if (const std::string found = NonTerminalFeatures(request.scene); !found.empty()) {
    return "the scene has " + found + "; surrogates are of a loss at the end";
  }
  if (!request.scene.design.empty()) {
    return "optimize: found " + NameOf(request.scene.design.front().parameter, request.scene) +
           "; surrogates have no derivatives by parameters of the scene";
  }
  if (!request.terms.empty()) return "surrogates are of the objective of the scene, without user-defined cost terms";
  if (!entry.takes_surrogate) return "a surrogate is not the derivative of the loss, which this solver relies on";
  return ReasonNotApplicable(surrogate, request.contact, request.scene);
}

std::string UnsupportedUserTerms(const SolverEntry& entry, const SolveRequest& request) {
  if (request.terms.empty() || entry.user_terms) return "";
  return "it minimises the objective of the scene only; ceres_phases takes user-defined cost terms";
}

std::string UnsupportedDesign(const SolverEntry& entry, const SolveRequest& request) {
  const Scene& scene = request.scene;
  if (scene.design.empty() || entry.design) return "";
  const std::string found = "optimize: found " + NameOf(scene.design.front().parameter, scene);
  if (!entry.given_design) {
    return found + ", a parameter of the scene, which this solver does not change; gd, ceres_lbfgs, ceres_lm, " +
           "ceres_event, ceres_phases, ipopt and mode_search do";
  }
  if (!IsExact(request)) return found + ", which this solver changes under the contact model event only";
  if (scene.optimize != Optimize::kControl) {
    return found + " without a control" +
           (scene.objective.duration
                ? ", and the duration is free: no solver takes both; give a duration, or optimize the "
                  "control too"
                : "; gd, ceres_lbfgs and ceres_lm take parameters alone");
  }
  return "";
}

std::string UnsupportedByAllSolvers(const SolveRequest& request) { return ReasonNothingToOptimize(request.scene); }

// Returns which term of the loss no small change of the control changes at a solution, though it did at the initial
// guess, as where discs that touched pass by one another; empty if there is none.
std::string FindLossOfReach(const SolveRequest& request, const SolverOptions& options, const SolveReport& report) {
  const Scene& scene = request.scene;
  const bool shot = scene.optimize == Optimize::kControl && scene.design.empty() && scene.objective.IsSumOfSquares() &&
                    !options.surrogate;
  if (!shot) return "";
  const auto rows_at = [&](const std::optional<ControlGuess>& control, std::vector<double>* residuals) {
    SolverOptions own;
    own.monitor.stop = options.monitor.stop;
    own.limits.memory = options.limits.memory;
    own.guess = control;
    SolveRun run("auto", request, own);
    SingleShooting& shooting = run.shooting();
    residuals->resize(shooting.num_residuals());
    std::vector<double> jacobian(residuals->size() * run.initial_guess().size());
    const bool ok = shooting.EvaluateResiduals(run.initial_guess(), residuals->data(), jacobian.data());
    std::vector<double> largest(residuals->size(), NAN);
    const size_t columns = run.initial_guess().size();
    for (size_t row = 0; ok && row < largest.size(); ++row) {
      largest[row] = 0;
      for (size_t j = 0; j < columns; ++j) largest[row] = std::max(largest[row], std::abs(jacobian[row * columns + j]));
    }
    return largest;
  };
  std::vector<double> at_guess, at_solution;
  const std::vector<double> before = rows_at(options.guess, &at_guess);
  const std::vector<double> after =
      rows_at(ControlGuess{report.solution.control, report.solution.durations}, &at_solution);
  for (size_t row = 0; row < after.size(); ++row) {
    if (before[row] > 0 && after[row] == 0 && at_solution[row] != 0) {
      return "no small change of its control changes a term of the loss that the control of the initial guess changes, "
             "as where a contact is lost";
    }
  }
  return "";
}

// The solver `auto`.
SolveReport SolveAutomatically(const SolveRequest& request, const SolverOptions& options) {
  const Scene& scene = request.scene;
  const std::string beyond = NonTerminalFeatures(scene);
  using Names = std::vector<std::string_view>;
  Names order = {"ceres_lm", "ceres_phases", "ceres_lbfgs", "gd"};
  std::string why = "the loss is a sum of squares of a rollout";
  if (options.surrogate) {
    order = {"gd"};
    why = "a surrogate takes the place of the gradient";
  } else if (!beyond.empty()) {
    order = {"ceres_phases", "ipopt", "ceres_lm", "gd"};
    why = "the scene has " + beyond;
  } else if (!scene.objective.IsSumOfSquares()) {
    order = {"ceres_lbfgs", "gd"};
    why = "the loss is no sum of squares";
  } else if (IsExact(request) && scene.optimize == Optimize::kControl) {
    order = {"ceres_phases", "ipopt", "ceres_lm", "ceres_lbfgs", "gd"};
    why = "the control is free and contact is exact";
  }
  const auto solve = [&](std::string_view name, SolverOptions of_solve, const SolveReport* from) {
    if (from != nullptr) of_solve.guess = ControlGuess{from->solution.control, from->solution.durations};
    return Solve(name, request, of_solve);
  };
  const Names refine = scene.optimize == Optimize::kControl ? Names{"ceres_lm", "ceres_phases", "ipopt"} : Names{};
  return SolveInTurn(order, refine, why, options, solve, [&](const SolveReport& report) {
    return FindLossOfReach(request, options, report);
  });
}

// Goes on from a solution on unequal intervals that its certificate denies, with the scene as a hybrid system: by
// steps of Newton's method, which are more accurate than differences of losses, and then by the solver in phases, which
// also holds the intervals where they are, as where the loss falls as an impact leaves the end of its interval. Design
// parameters stay.
void RefineAsHybrid(const Scene& designed, const SolverOptions& options, SolveReport* report) {
  constexpr int kNewtonSteps = 3;
  const int left = options.limits.iterations - report->work.iterations;
  Scene scene = designed;
  scene.design.clear();
  if (report->solution.durations.empty() || left <= 0 || !UnsupportedByHybridProblem(scene).empty()) return;
  if (options.monitor.stop && options.monitor.stop()) return;
  HybridProblem problem = MakeHybridProblem(scene);
  const HybridInput& guess = problem.guess =
      InputOf(problem, report->solution.initial_state, report->solution.control, report->solution.durations);
  HybridShooting shooting(problem);
  // Takes a control, if it is feasible, certified and no worse.
  const auto take = [&](const std::vector<double>& control, const std::vector<double>& durations) {
    const HybridInput input = InputOf(problem, guess.initial, control, durations);
    HybridShooting::Outcome outcome;
    if (!shooting.Simulate(input, &outcome) || outcome.violation > std::max(kFeasible, report->solution.violation)) {
      return false;
    }
    const ExactRun exact =
        SimulateExactly(designed, report->solution.initial_state, control, durations, options.monitor.stop);
    if (!exact.ok || IsLess(report->solution.loss, exact.loss)) return false;
    Certificate certificate =
        Certify(designed, report->solution.initial_state, control, durations, options.monitor.stop);
    if (!certificate.IsStationary() || certificate.IsSaddle()) return false;
    report->certificate = std::move(certificate);
    report->solution.control = control;
    report->solution.durations = durations;
    report->solution.loss = exact.loss;
    report->solution.violation = outcome.violation;
    return true;
  };
  std::optional<HybridInput> input = guess;
  for (int step = 0; step < kNewtonSteps; ++step) {
    input = AfterNewtonStep(problem, *input, /*moving=*/true);
    if (!input || !Validate(*input, problem.system).empty()) break;
    if (take(input->control, input->lengths)) return;
  }
  SolverOptions rest;
  rest.limits.iterations = left;
  rest.coarse_to_fine = false;
  rest.monitor.stop = options.monitor.stop;
  if (options.monitor.callback) {
    rest.monitor.callback = [&](int iteration, double loss) {
      return options.monitor.callback(report->work.iterations + iteration, loss);
    };
  }
  const SolveReport found = SolveHybridByPhases(problem, rest);
  report->work.evaluations += found.work.evaluations;
  report->work.seconds += found.work.seconds;
  if (found.termination != Termination::kConverged || !take(found.solution.control, found.solution.durations)) return;
  if (!report->history.iterates.empty()) return;  // of which there is one for each loss
  report->work.iterations += found.work.iterations;
  report->history.losses.insert(
      report->history.losses.end(), found.history.losses.begin() + 1, found.history.losses.end());
}

// Whether a solver of scenes is one of hybrid systems too, which takes scenes that its own flights do not cover.
bool HasHybrid(std::string_view solver) {
  return solver == "ceres_phases" || solver == "ipopt" || solver == "mode_search";
}

// Whether a solver solves a scene as a hybrid system, of which design parameters are parameters.
bool SolvesAsHybrid(const SolverEntry& entry, const SolveRequest& request) {
  if (!request.terms.empty()) return entry.user_terms;
  if (!NonBallisticForces(request.scene).empty()) return HasHybrid(entry.name);
  return entry.given_design && !request.scene.design.empty();
}

// Returns why a solver does not support a scene that is solved as a hybrid system, or whose flights are not those of
// constant acceleration; empty if it does, and for other scenes.
std::string UnsupportedAsHybrid(const SolverEntry& entry, const SolveRequest& request, bool given_sequence) {
  const Scene& scene = request.scene;
  const bool as_hybrid = SolvesAsHybrid(entry, request), has_terms = !request.terms.empty();
  const std::string beyond = NonBallisticForces(scene);
  const std::string has = "the scene has " + (!beyond.empty() ? beyond
                                              : has_terms     ? "user-defined cost terms"
                                                              : "free parameters");
  if (beyond.empty() && !as_hybrid) return "";
  if (!scene.design.empty() && !beyond.empty()) {
    return has +
           " and free parameters, for which no solver of scenes has derivatives: identify or sweep them, or solve its "
           "hybrid problem (saltus.hybrid_problem)";
  }
  if (as_hybrid) {
    if (given_sequence && !scene.objective.via.empty()) {
      return has + " and waypoints, beside which sequences are not taken: leave the sequence out";
    }
    if (!IsExact(request)) {
      return has + ", which this solver takes under the contact model event only" + (has_terms ? "" : ": use ceres_lm");
    }
    const std::string part = UnsupportedByHybridProblem(scene);
    return part.empty() ? "" : has + " and " + part;
  }
  if (entry.name != "gd" && entry.name != "ceres_lbfgs" && entry.name != "ceres_lm") {
    return has + ", whose flights this solver does not support: use ceres_phases, ipopt, mode_search or ceres_lm";
  }
  const Objective& objective = scene.objective;
  if (objective.running.empty() && objective.via.empty() && !objective.duration) return "";
  return has + " beside path costs or a free duration: use ceres_phases under the contact model event";
}

// Solves a scene as a hybrid system, of which design parameters are parameters. The certificate, which has the names of
// events, is left to Confirm(), which goes on where it denies a solution; with user-defined terms it stays.
SolveReport SolveAsHybrid(std::string_view solver, const SolveRequest& request, const SolverOptions& given,
                          const std::vector<double>& parameters) {
  const Scene& scene = request.scene;
  const ContactSequence pairs = AllPairs(scene);
  SolverOptions options = given;
  options.guess.reset();
  if (given.sequences.given) {
    for (Candidate& event : *options.sequences.given) {
      event = {.a = 0, .b = static_cast<int>(std::ranges::find(pairs, event) - pairs.begin())};
    }
    options.sequences.given->push_back({.a = 0, .b = -1});
  }
  HybridProblem problem = MakeHybridProblem(scene);
  problem.terms.insert(problem.terms.end(), request.terms.begin(), request.terms.end());
  if (given.guess) {
    problem.guess = InputOf(problem, problem.guess.initial, given.guess->control, LengthsOf(*given.guess, scene));
  }
  problem.guess.parameters = parameters;
  SolveReport report = Solve(solver, problem, options);
  report.contact = request.contact.name();
  if (report.solution.parameters.empty()) report.solution.parameters = DesignOf(scene);
  report.solution.initial_state.resize(std::min<size_t>(report.solution.initial_state.size(), InitialSize(scene)));
  if (!scene.design.empty())
    report.solution.initial_state = InitialState(WithDesign(scene, report.solution.parameters));
  if (request.terms.empty()) ForgetCertificate(&report);
  if (report.history.losses.empty() && report.termination == Termination::kFailed) {  // in words of scenes
    const ControlGuess start = given.guess.value_or(ControlGuess{InitialControl(scene, scene.steps), {}});
    const Scene designed = WithDesign(scene, parameters);
    const ExactRun guess =
        SimulateExactly(designed, InitialState(designed), start.control, start.durations, options.monitor.stop);
    if (!guess.ok && guess.reason != kStopped) report.reason = guess.reason;
  }
  for (LocalOptimum& optimum : report.optima) {
    LocalOptimum impacts{{}, optimum.loss, {}};
    for (size_t i = 0; i < optimum.sequence.size(); ++i) {
      const int guard = optimum.sequence[i].b;
      if (guard < 0 || guard >= std::ssize(pairs)) continue;  // a jump of the control, or a waypoint
      impacts.sequence.push_back(pairs[guard]);
      impacts.times.push_back(optimum.times[i]);
    }
    optimum = std::move(impacts);
  }
  return report;
}

// Solves a scene with design parameters by turns with these free, as a hybrid system, and with those that were found,
// as a scene, which may take it to a lower loss along other impacts.
SolveReport SolveDesign(const SolverEntry& entry, const SolveRequest& request, const SolverOptions& options) {
  constexpr int kMostTurns = 4;
  constexpr double kGain = 1e-9;  // relative: of the loss, for which it goes on
  SolveChain chain(options);
  SolverOptions limited = options;
  if (entry.name != "mode_search") limited.sequences.limits.seconds = 0;
  const TimeLimit limit(limited);
  bool interrupted = false;
  const auto add = [&](const SolveReport& report) {
    chain.Add(report);
    interrupted = interrupted || (report.termination == Termination::kInterrupted && !limit.IsOver());
  };
  const auto ends = [&] { return interrupted || limit.IsOver(); };
  const auto solve_from = [&](const SolveReport* start) {
    SolverOptions own = chain.Next();
    own.limits.iterations = options.limits.iterations;
    own.monitor.stop = limit.stop();
    own.sequences.limits.seconds = limit.SecondsLeft();
    if (start != nullptr) own.guess = ControlGuess{start->solution.control, start->solution.durations};
    return own;
  };
  // A search over sequences is one of the scene, which is far faster.
  const std::string_view as_hybrid = entry.name == "ipopt" ? "ipopt" : "ceres_phases";
  std::vector<double> parameters = DesignOf(request.scene);
  SolveReport best = SolveAsHybrid(as_hybrid, request, solve_from(nullptr), parameters);
  add(best);
  std::vector<LocalOptimum> optima;
  std::optional<SearchStatistics> searched;
  for (int turn = 0; turn < kMostTurns && !ends(); ++turn) {
    SolveRequest given{WithDesign(request.scene, parameters), request.contact};
    given.scene.design.clear();
    if (!entry.reason_not_applicable(given).empty()) break;
    SolveReport found = entry.solve(given, solve_from(turn == 0 ? nullptr : &best));
    add(found);
    optima = found.optima;
    if ((searched = found.searched)) {  // what a search proves, it proves for these parameters alone
      searched->lower_bound = 0;
      searched->proof.reset();
    }
    found.certificate.reset();
    const bool gains = found.solution.loss < best.solution.loss - kGain * std::abs(best.solution.loss);
    if (found.history.losses.empty() && best.history.losses.empty()) return found;  // whose reason is that of a scene
    if (ends()) {
      found.solution.parameters = parameters;
      if (EndsBetter(found, best)) best = std::move(found);
      break;
    }
    if (found.history.losses.empty() || (turn > 0 && !gains)) break;
    SolveReport next = SolveAsHybrid(as_hybrid, request, solve_from(&found), parameters);
    add(next);
    found.solution.parameters = parameters;
    if (found.termination == Termination::kConverged) {
      const Scene designed = WithDesign(request.scene, parameters);
      found.certificate = Certify(designed,
                                  found.solution.initial_state,
                                  found.solution.control,
                                  found.solution.durations,
                                  options.monitor.stop);
      if (!found.certificate->IsStationary() || found.certificate->IsSaddle()) {
        found.termination = Termination::kNoProgress;
        found.reason = "the solution is optimal with these parameters, and not among other ones";
      }
    }
    for (SolveReport* report : {&found, &next}) {
      if (EndsBetter(*report, best)) best = std::move(*report);
    }
    parameters = best.solution.parameters;
  }
  best = chain.Finish(std::move(best));
  best.solver = entry.name;
  best.optima = std::move(optima);
  best.searched = searched;
  if (interrupted) best.termination = Termination::kInterrupted;
  if (limit.IsOver()) best.reason += std::string(best.reason.empty() ? "" : "; ") + "not complete: the limit of time";
  return best;
}

// Under exact contact the loss minimized is that of the certificate, which has the last word on "converged".
void Confirm(const SolveRequest& request, const SolverOptions& options, const TimeLimit& limit, SolveReport* report) {
  if (report->termination != Termination::kConverged || !IsExact(request) || !request.terms.empty()) return;
  const Scene scene = WithDesign(request.scene, report->solution.parameters);
  const bool control =
      scene.optimize == Optimize::kControl && (scene.objective.effort != 0 || !NonTerminalFeatures(scene).empty());
  if (!control && scene.design.empty()) return;
  if (!report->certificate) {
    report->certificate = Certify(scene,
                                  report->solution.initial_state,
                                  report->solution.control,
                                  report->solution.durations,
                                  options.monitor.stop);
  }
  if (report->certificate->verdict == Certificate::Verdict::kNotStationary) {
    SolverOptions in_time = options;
    if (report->searched) in_time.monitor.stop = limit.stop();
    RefineAsHybrid(scene, in_time, report);
  }
  Certificate& certificate = *report->certificate;
  if (certificate.verdict == Certificate::Verdict::kNotApplicable && scene.design.empty()) {
    Certificate kinks = CertifyKinks(scene, report->solution.control, report->solution.durations);
    if (kinks.verdict != Certificate::Verdict::kNotApplicable) certificate = std::move(kinks);
  }
  const bool flat = certificate.curvature && certificate.curvature->kind == Curvature::Kind::kFlat;
  std::string without;
  for (const ParameterCertificate& entry : certificate.parameters) {
    const bool has_slope = std::abs(entry.derivative) > kCertificateTolerance;
    if (has_slope || entry.parameter.kind == SceneParameter::Kind::kGravity) continue;
    without += (without.empty() ? "" : ", ") + entry.name;
  }
  if (flat && certificate.impacts.empty() && !without.empty()) {
    report->reason += (report->reason.empty() ? "" : "; ") +
                      std::string("nothing touches, and the loss does not depend on ") + without +
                      ": try another initial guess";
  }
  JudgeByCertificate(report);
}

// A free duration between equal bounds is none: the scene lasts as long, and its price is a part of every loss.
double FixDuration(Scene* scene) {
  std::optional<FreeDuration>& duration = scene->objective.duration;
  if (!duration || duration->min != duration->max) return 0;
  const double price = duration->weight * duration->min;
  scene->duration = duration->min;
  duration.reset();
  return price;
}

// Calls apply(&loss) for every loss in the report.
template <typename Apply>
void ForEachLoss(SolveReport* report, const Apply& apply) {
  if (!report->history.losses.empty()) {
    apply(&report->guess.loss);
    apply(&report->solution.loss);
  }
  for (double& loss : report->history.losses) apply(&loss);
  if (report->history.best) apply(&report->history.best->solution.loss);
  if (report->searched) apply(&report->searched->lower_bound);
  for (LocalOptimum& optimum : report->optima) apply(&optimum.loss);
}

// The next functions are the border between the units of users, SI, and those in which a solver works on `scene`.
// First the values of design parameters and the decision variables (single_shooting.h), from the latter to SI.
void ConvertDesign(const Scene& scene, std::span<double> values) {
  for (size_t i = 0; i < values.size(); ++i) {
    values[i] = ConvertParameter(scene.design[i].parameter, values[i], scene.units, {});
  }
}

void ConvertDecisions(const Scene& scene, std::span<double> z) {
  const UnitFactors to_si(scene.units, {});
  ConvertDesign(scene, z.last(scene.design.size()));
  z = z.first(z.size() - scene.design.size());
  if (scene.optimize == Optimize::kPosition) {
    for (size_t i = 0; i + 1 < z.size(); i += 2) {
      const Vec2d position = ConvertPosition({z[i], z[i + 1]}, scene.units, {});
      std::copy_n(position.data(), 2, &z[i]);
    }
  } else if (scene.optimize == Optimize::kVelocity) {
    const size_t turning = z.size() - scene.free_spin.size();
    for (size_t i = 0; i < z.size(); ++i) z[i] *= i < turning ? to_si.speed : to_si.rate;
  } else {
    const size_t forces = z.size() - scene.objective.duration.has_value();
    for (size_t i = 0; i < z.size(); ++i) z[i] *= i < forces ? to_si.force : to_si.time;
  }
}

// The options for a solver; it calls back with losses in SI units.
SolverOptions OptionsFor(const Scene& scene, const SolverOptions& options) {
  SolverOptions out = options;
  if (options.guess) {
    const UnitFactors from_si({}, scene.units);
    out.guess->control = Multiplied(options.guess->control, from_si.force);
    out.guess->durations = Multiplied(options.guess->durations, from_si.time);
  }
  if (options.monitor.callback) {
    out.monitor.callback = [&options, units = scene.units](int iteration, double loss) {
      return options.monitor.callback(iteration, ConvertLoss(loss, units, {}));
    };
  }
  return out;
}

// The report of a solver.
SolveReport ToSiUnits(const Scene& scene, SolveReport report) {
  const Units si;
  const UnitFactors to_si(scene.units, si);
  const auto convert_motion = [&](auto* motion) {
    motion->solution.initial_state =
        ConvertInitial(std::move(motion->solution.initial_state), scene.num_bodies(), scene.units, si);
    motion->solution.control = Multiplied(std::move(motion->solution.control), to_si.force);
    motion->solution.durations = Multiplied(std::move(motion->solution.durations), to_si.time);
    ConvertDesign(scene, motion->solution.parameters);
  };
  ForEachLoss(&report, [&](double* loss) { *loss = ConvertLoss(*loss, scene.units, si); });
  if (report.searched && report.searched->proof) {
    double& gap = report.searched->proof->gap;
    gap = ConvertLoss(gap, scene.units, si);
  }
  convert_motion(&report);
  if (report.history.best) convert_motion(&*report.history.best);
  for (std::vector<double>& z : report.history.iterates) ConvertDecisions(scene, z);
  for (std::optional<Certificate>* certificate : {&report.certificate, &report.continuous}) {
    if (*certificate) *certificate = ToUnits(**certificate, scene.units, si);
  }
  for (LocalOptimum& optimum : report.optima) optimum.times = Multiplied(std::move(optimum.times), to_si.time);
  return report;
}

}  // namespace

std::string Validate(const SearchOptions& options) {
  if (!(options.work >= 0) || std::isinf(options.work)) return "search_work: expected a number >= 0";
  if (!(options.seconds >= 0) || std::isinf(options.seconds)) return "search_seconds: expected a number >= 0";
  if (options.memory == 0) return "search_memory: expected more than nothing";
  if (options.starts < 0) return "search_starts: found " + std::to_string(options.starts) + ", expected 0 or more";
  return "";
}

const std::vector<SolverEntry>& AllSolvers() {
  static const std::vector<SolverEntry>& solvers = *new std::vector<SolverEntry>{
      {.name = "auto",
       .summary = "chooses from the structure of the scene, and goes on with another solver without an optimum",
       .reason_not_applicable = UnsupportedByAllSolvers,
       .solve = SolveAutomatically,
       .takes_surrogate = true,
       .any_units = true,
       .constraints = true,
       .user_terms = true,
       .design = true},
      {.name = "gd",
       .summary = "gradient descent at a fixed rate",
       .reason_not_applicable = UnsupportedByGradientDescent,
       .solve = SolveByGradientDescent,
       .takes_surrogate = true,
       .any_units = true,
       .constraints = true,
       .user_terms = true,
       .design = true},
      {.name = "ceres_lbfgs",
       .summary = "L-BFGS of Ceres on the adjoint gradient",
       .reason_not_applicable = UnsupportedByLbfgs,
       .solve = SolveByCeresLbfgs,
       .constraints = true,
       .user_terms = true,
       .design = true},
      {.name = "ceres_lm",
       .summary = "Levenberg-Marquardt of Ceres, single shooting",
       .reason_not_applicable = UnsupportedByLm,
       .solve = SolveByCeresLm,
       .constraints = true,
       .user_terms = true,
       .design = true},
      {.name = "ceres_shooting",
       .summary = "Levenberg-Marquardt of Ceres, step shooting, every iterate a rollout",
       .reason_not_applicable = UnsupportedByLeastSquares,
       .solve = SolveByCeresShooting},
      {.name = "ceres_lagrangian",
       .summary = "step shooting of Ceres, augmented Lagrangian; not for collisions",
       .reason_not_applicable = UnsupportedByLeastSquares,
       .solve = SolveByCeresLagrangian},
      {.name = "grid_optimum",
       .summary = "best control on the time grid, two discs in closed form",
       .reason_not_applicable = UnsupportedByGridOptimum,
       .solve = SolveByGridOptimum,
       .exact_only = true},
      {.name = "ceres_event",
       .summary = "Ceres on phases between the impacts of a given sequence",
       .reason_not_applicable = UnsupportedByEventPhases,
       .solve = SolveByCeresEvent,
       .exact_only = true,
       .given_design = true},
      {.name = "ceres_phases",
       .summary = "Ceres through impacts, a cost for every step: bounds, constraints, running costs, free time",
       .reason_not_applicable = UnsupportedByCeresPhases,
       .solve = SolveByPhasesFromStarts,
       .constraints = true,
       .user_terms = true,
       .given_design = true},
      {.name = "ipopt",
       .summary = "phases of ceres_phases by the interior-point method of IPOPT, with second derivatives",
       .reason_not_applicable = UnsupportedByInteriorPoint,
       .solve = SolveByInteriorPoint,
       .constraints = true,
       .user_terms = true,
       .given_design = true},
      {.name = "hmp",
       .summary = "hybrid minimum principle: costates through impacts, continuous time",
       .reason_not_applicable = UnsupportedByHmp,
       .solve = SolveByHmp,
       .exact_only = true,
       .constraints = true},
      {.name = "mode_search",
       .summary = "search over sequences of impacts, each solved by ceres_event or ceres_phases",
       .reason_not_applicable = UnsupportedByModeSearch,
       .solve = SolveByModeSearch,
       .exact_only = true,
       .constraints = true,
       .user_terms = true,
       .given_design = true},
  };
  return solvers;
}

const std::vector<SolverEntry>& SolversByName() {
  static const std::vector<SolverEntry>& solvers =
      *new std::vector<SolverEntry>{{.name = "global",
                                     .summary = "mode_search, and a rigorous lower bound over all controls",
                                     .reason_not_applicable = UnsupportedByGlobalSearch,
                                     .solve = SolveByGlobal,
                                     .exact_only = true,
                                     .constraints = true}};
  return solvers;
}

const SolverEntry* FindSolver(std::string_view name) {
  for (const auto* solvers : {&AllSolvers(), &SolversByName()}) {
    for (const SolverEntry& solver : *solvers) {
      if (solver.name == name) return &solver;
    }
  }
  return nullptr;
}

bool EndsWorse(const SolveReport& report) {
  const auto beyond = [](double violation) { return violation > kFeasible ? violation : 0.0; };
  const double before = beyond(report.guess.violation), after = beyond(report.solution.violation);
  if (before != after) return after > before;
  return IsLess(report.guess.loss, report.solution.loss);
}

SolveReport Solve(std::string_view solver, const SolveRequest& given, const SolverOptions& given_options) {
  const SolverEntry* entry = FindSolver(solver);
  if (entry != nullptr && entry->solve == SolveAutomatically && given.terms.empty()) {
    return SolveAutomatically(given, given_options);
  }
  SolveRequest request = given;
  const double price = FixDuration(&request.scene);
  const bool fixed = given.scene.objective.duration && !request.scene.objective.duration;
  SolverOptions options = given_options;
  if (price != 0 && options.monitor.callback) {
    options.monitor.callback = [&given_options, price](int iteration, double loss) {
      return given_options.monitor.callback(iteration, loss + price);
    };
  }
  std::string reason = entry == nullptr ? UnknownSolver(solver) : ReasonNotApplicable(request.contact, request.scene);
  if (reason.empty()) reason = Validate(options, request.scene);
  if (reason.empty()) reason = UnsupportedUserTerms(*entry, request);
  if (reason.empty()) reason = UnsupportedDesign(*entry, request);
  if (reason.empty() && !entry->constraints) reason = UnsupportedWithoutConstraints(request.scene);
  if (reason.empty()) reason = UnsupportedAsHybrid(*entry, request, options.sequences.given.has_value());
  const bool as_hybrid = reason.empty() && SolvesAsHybrid(*entry, request);
  SolveRequest converted = request;
  if (reason.empty()) {
    if (request.terms.empty()) {
      converted.scene = entry->any_units ? NearOrigin(request.scene) : ToNaturalUnits(request.scene);
    }
    if (!as_hybrid) reason = entry->reason_not_applicable(converted);
  }
  if (reason.empty() && options.surrogate) reason = UnsupportedSurrogate(*entry, request, *options.surrogate);

  SolveReport report;
  if (reason.empty()) {
    const SolverOptions own = OptionsFor(converted.scene, options);
    const TimeLimit limit(own);
    const bool takes_turns = converted.terms.empty() && !converted.scene.design.empty();
    report = !as_hybrid    ? entry->solve(converted, own)
             : takes_turns ? SolveDesign(*entry, converted, own)
                           : SolveAsHybrid(solver, converted, own, DesignOf(converted.scene));
    Confirm(converted, own, limit, &report);
    report = ToSiUnits(converted.scene, std::move(report));
    ForEachLoss(&report, [&](double* loss) { *loss += price; });
    if (fixed && report.solution.durations.empty() && !report.solution.control.empty()) {
      const size_t intervals = report.solution.control.size() / request.scene.control_width();
      report.solution.durations.assign(intervals, request.scene.duration / static_cast<double>(intervals));
    }
    return report;
  }
  report.contact = request.contact.name();
  report.solver = solver;
  report.surrogate = options.surrogate;
  report.termination = Termination::kNotApplicable;
  report.reason = std::move(reason);
  return report;
}

const char* TerminationToString(Termination termination) {
  constexpr const char* kNames[] = {
      "converged", "iteration_limit", "no_progress", "failed", "interrupted", "not_applicable"};
  return kNames[static_cast<int>(termination)];
}

}  // namespace saltus
