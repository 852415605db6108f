#include "saltus/solve/hybrid_solver.h"

#include <ceres/cost_function.h>
#include <ceres/problem.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>
#include <utility>

#include "base/table.h"
#include "control/hybrid_shooting.h"
#include "hybrid/rollout.h"
#include "optimality/hybrid_conditions.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "solve/enough_steps.h"
#include "solve/phases/hybrid_phases.h"
#include "solve/phases/interior_point.h"
#include "solve/search/hybrid_search.h"
#include "solve/shooting/single_shooting_solvers.h"
#include "solve/solve_chain.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

constexpr int kFewColumns = 200;         // of a dense Jacobian, up to which its factors cost less than those of phases
constexpr int kFirstIterations = 200;    // of phases on all intervals, before the states are eliminated
constexpr int kFromNear = 100;           // iterations of phases from the solution on few intervals
constexpr double kZero = 1e-12;          // of the loss of the guess: a loss that is zero
constexpr double kNoSlope = 1e-8;        // of the largest one: of a state whose target is met
constexpr double kNearJump = 1e-3;       // of an interval: how near to a jump of the control an event is named
constexpr double kSameSaltation = 1e-9;  // relative

// Whether it may change the derivative on which side of a jump of the control, at the beginning of interval k, an event
// happens: its saltation matrix depends on the control, or its time on parameters alone. Modes that are created need
// not exist under the other control.
bool MayHaveKink(const HybridSystem& system, const HybridInput& input, const HybridEvent& event, int k) {
  if (system.functions().CreatesModes()) return true;
  const auto m = static_cast<std::size_t>(system.num_controls());
  const int n = system.state_size(event.mode), num_parameters = system.num_parameters();
  Eigen::RowVectorXd gradient(n + 1 + num_parameters + system.num_controls());
  const ModePoint at{event.mode,
                     event.time,
                     event.before.data(),
                     &input.control[m * static_cast<std::size_t>(k)],
                     input.parameters.data()};
  system.functions().GuardGradient(at, event.guard, gradient.data());
  if (gradient.head(n).isZero(0)) return !gradient.tail(gradient.size() - n - 1).isZero(0);
  const auto saltation = [&](int interval) {
    const std::span<const double> control(input.control);
    const std::span<const double> u = control.subspan(m * static_cast<std::size_t>(interval), m);
    return SaltationMatrix(system, event.mode, event.guard, event.time, event.before, u, input.parameters);
  };
  const std::vector<double> before = saltation(k - 1), after = saltation(k);
  double largest = 0, change = before.size() == after.size() ? 0 : 1;
  for (std::size_t i = 0; i < std::min(before.size(), after.size()); ++i) {
    largest = std::max({largest, std::abs(before[i]), std::abs(after[i])});
    change = std::max(change, std::abs(before[i] - after[i]));
  }
  return !(change <= kSameSaltation * largest);
}

// The events that happen so near to a jump of the control that the solver may have stopped at the kink there.
std::string EventsNearJumps(const HybridSimulator& simulator, const HybridInput& input) {
  std::string near;
  for (const HybridEvent& event : simulator.events()) {
    const int k = ControlJumpNear(input, simulator.system().num_controls(), event.time, kNearJump);
    if (k < 0 || !MayHaveKink(simulator.system(), input, event, k)) continue;
    char text[64];
    std::snprintf(text, sizeof text, "' has an event at t = %.8g, ", event.time);
    near += (near.empty() ? "" : "; ") + ("guard '" + simulator.system().GuardName(event.mode, event.guard)) + text +
            "where the control jumps and the loss has a kink";
  }
  return near;
}

// A run of a solver by single shooting on a problem of a hybrid system.
class HybridRun final : public ShootingRun {
 public:
  HybridRun(std::string_view solver, const HybridProblem& problem, const SolverOptions& options)
      : ShootingRun(solver, options), shooting_(problem) {
    shooting_.set_stop([this] { return options_.monitor.stop && options_.monitor.stop(); });
    guess_ = shooting_.initial_guess();
  }

  HybridShooting& shooting() { return shooting_; }
  ShootingFunction& function() override { return shooting_; }

 private:
  // Reports where the loss is not smooth. Also records the error of the integration.
  std::string RemarkOn(std::span<const double> z, Termination termination) override {
    double loss = 0;
    if (termination == Termination::kFailed || !shooting_.Evaluate(z, &loss, nullptr)) return "";
    report_.solution.integration_error = shooting_.simulator().IntegrationError();
    std::string why = shooting_.simulator().ReasonNotDifferentiable();
    const std::string jumps = shooting_.DescribeJumpsAndKinks(loss);
    if (!jumps.empty()) why += (why.empty() ? "" : "; ") + jumps;
    const std::string near = EventsNearJumps(shooting_.simulator(), shooting_.InputAt(z));
    if (near.empty() || why.find("control jumps") != std::string::npos) return why;
    return why.empty() ? near : why + "; " + near;
  }

  HybridShooting shooting_;
};

std::string UnsupportedByAllSolvers(const HybridProblem& problem) {
  return problem.free.IsEmpty() ? "the problem leaves nothing to optimize: name what is free" : "";
}

std::string UnsupportedByShooting(const HybridProblem& problem) {
  for (const HybridTerm& term : problem.terms) {
    if (!term.IsCost()) {
      return term.name + " is a constraint, which takes multipliers: use ceres_lm, ceres_phases or ipopt";
    }
  }
  return UnsupportedByAllSolvers(problem);
}

bool IsBounded(const HybridFree& free) {
  const auto given = [](const std::vector<double>& min, const std::vector<double>& max) {
    return !min.empty() || !max.empty();
  };
  return (free.control && given(free.control_min, free.control_max)) || given(free.initial_min, free.initial_max) ||
         given(free.parameters_min, free.parameters_max) ||
         (free.duration && (free.duration_min > 0 || std::isfinite(free.duration_max)));
}

std::string UnsupportedByLbfgs(const HybridProblem& problem) {
  if (IsBounded(problem.free)) {
    return "the problem has bounds, which its steps would leave: use ceres_lm, ceres_phases or ipopt";
  }
  return UnsupportedByShooting(problem);
}

// Returns which term has rows whose number changes with the motion; empty if there is none.
std::string UnsupportedByRows(const HybridProblem& problem) {
  for (const HybridTerm& term : problem.terms) {
    const bool at_each_event = term.at == HybridTerm::Timing::kEvent && term.occurrence < 0;
    if (at_each_event && term.role != HybridTerm::Role::kCost) {
      return term.name + " is a " + (term.IsCost() ? "cost that is no square" : "constraint") +
             " at each event, whose number changes with the motion: use ceres_phases or ipopt";
    }
  }
  return UnsupportedByAllSolvers(problem);
}

std::string UnsupportedByLm(const HybridProblem& problem) {
  for (const HybridTerm& term : problem.terms) {
    if (term.role == HybridTerm::Role::kValue) {
      return term.name + " is a cost that is no square: least squares needs squares";
    }
  }
  return UnsupportedByRows(problem);
}

std::string UnsupportedByShootingInside(const HybridProblem& problem) {
  const std::string reason = ReasonNoInteriorPoint();
  return reason.empty() ? UnsupportedByRows(problem) : reason;
}

// Returns a report whose solver can lower the loss no more, as converged if the certificate proves an optimum: steps
// near one, such as those of a warm start, are below the rounding of the loss.
SolveReport AcceptOptimum(const HybridProblem& problem, SolveReport report) {
  if (report.termination != Termination::kNoProgress) return report;
  Certificate certificate = Certify(problem, SolutionOf(problem, report));
  const bool minimum = certificate.curvature && certificate.curvature->kind == Curvature::Kind::kMinimum;
  if (!certificate.IsStationary() || !minimum) return report;
  report.termination = Termination::kConverged;
  report.certificate = std::move(certificate);
  report.reason = "steps no longer lower the loss, and the certificate proves an optimum";
  return report;
}

SolveReport SolveByGradientDescent(const HybridProblem& problem, const SolverOptions& options) {
  HybridRun run("gd", problem, options);
  const HybridShooting& shooting = run.shooting();
  const double length = problem.guess.duration / problem.guess.num_intervals;
  DescentRule rule;
  rule.move_within = [&](std::vector<double>* z) {
    for (std::size_t i = 0; i < z->size(); ++i) {
      (*z)[i] = std::clamp((*z)[i], shooting.variables()[i].min, shooting.variables()[i].max);
    }
  };
  rule.step = [&](const std::vector<double>& gradient, std::vector<double>* z) {
    for (std::size_t i = 0; i < z->size(); ++i) {
      const bool per_time =
          options.descent.rate_per_time && shooting.variables()[i].kind == FreeVariable::Kind::kControl;
      (*z)[i] -= options.descent.learning_rate / (per_time ? length : 1.0) * gradient[i];
    }
    rule.move_within(z);
  };
  return DescendGradient(&run, rule);
}

SolveReport SolveByLbfgs(const HybridProblem& problem, const SolverOptions& options) {
  HybridRun run("ceres_lbfgs", problem, options);
  return AcceptOptimum(problem, MinimizeByLbfgs(&run));
}

// The residuals of a cost in several intervals, of each of which it reads the control and perhaps the length, as a
// function of the block of variables that these controls are in and, if it is free, of the final time.
class IntervalCosts final : public ceres::CostFunction {
 public:
  struct Interval {
    int first;    // variable of its control in the block
    double part;  // of the final time, which is the last block, or `duration` if there is none
  };
  IntervalCosts(const HybridTerm& term, int size, std::vector<Interval> intervals, std::optional<double> duration)
      : term_(term), intervals_(std::move(intervals)), duration_(duration) {
    set_num_residuals(static_cast<int>(intervals_.size()) * term.function->num_residuals());
    mutable_parameter_block_sizes()->push_back(size);
    if (!duration) mutable_parameter_block_sizes()->push_back(1);
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const int size = parameter_block_sizes()[0], width = term_.function->parameter_block_sizes()[0];
    const Eigen::Index rows = term_.function->num_residuals();
    Matrix by_control(rows, width);
    Eigen::VectorXd by_length(rows);
    double* by[] = {by_control.data(), by_length.data()};
    double* const of_control = jacobians != nullptr ? jacobians[0] : nullptr;
    double* const of_time = jacobians != nullptr && !duration_ ? jacobians[1] : nullptr;
    if (of_control != nullptr) std::fill_n(of_control, num_residuals() * size, 0.0);
    if (of_time != nullptr) std::fill_n(of_time, num_residuals(), 0.0);
    for (Eigen::Index k = 0, row = 0; row < num_residuals(); ++k, row += rows) {
      const auto& [first, part] = intervals_[k];
      const double length = part * (duration_ ? *duration_ : blocks[1][0]);
      const double* const arguments[] = {blocks[0] + first, &length};
      if (!term_.function->Evaluate(arguments, residuals + row, jacobians != nullptr ? by : nullptr)) return false;
      if (of_control != nullptr) {
        Eigen::Map<Matrix>(of_control, num_residuals(), size).block(row, first, rows, width) = by_control;
      }
      if (of_time != nullptr && term_.with_length) {
        Eigen::Map<Eigen::VectorXd>(of_time, num_residuals()).segment(row, rows) = part * by_length;
      }
    }
    return true;
  }

 private:
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const HybridTerm& term_;
  const std::vector<Interval> intervals_;
  const std::optional<double> duration_;
};

// Adds the residuals of each cost that reads the control of an interval alone. Each control is within one block.
void AddCostsOfIntervals(const HybridProblem& problem, const VariableBlocks& variables, ceres::Problem* ceres) {
  const HybridInput& guess = problem.guess;
  const std::vector<double> times = guess.Times();
  const int width = problem.system.num_controls();
  for (const HybridTerm& term : problem.terms) {
    if (!HybridShooting::IsOfIntervalAlone(term)) continue;
    int k = 0, begin = 0;  // the next interval, and the first variable of a block
    for (size_t block = 0; k < guess.num_intervals; begin += variables.sizes[block++]) {
      std::vector<IntervalCosts::Interval> intervals;
      for (; k < guess.num_intervals && k * width < begin + variables.sizes[block]; ++k) {
        if (term.interval >= 0 && term.interval != k) continue;
        intervals.push_back({k * width - begin, (times[k + 1] - times[k]) / guess.duration});
      }
      if (intervals.empty()) continue;
      std::vector<double*> blocks = {variables.blocks[block]};
      if (problem.free.duration) blocks.push_back(variables.blocks.back());
      const std::optional<double> duration =
          problem.free.duration ? std::nullopt : std::optional<double>(guess.duration);
      ceres->AddResidualBlock(
          new IntervalCosts(term, variables.sizes[block], std::move(intervals), duration), nullptr, blocks);
    }
  }
}

// Minimises with constraints, and reports by how much they are violated.
SolveReport MinimizeWithConstraints(HybridRun* run, AugmentedLagrangian::Algorithm algorithm,
                                    const std::function<void(const VariableBlocks&, ceres::Problem*)>& set_bounds) {
  HybridShooting& shooting = run->shooting();
  const RowRoles roles{.equalities = shooting.num_equalities(),
                       .inequalities = shooting.num_inequalities(),
                       .values = shooting.num_values()};
  HybridShooting::Outcome at_guess, at_end;
  shooting.Simulate(shooting.InputAt(run->initial_guess()), &at_guess);
  SolveReport report = MinimizeWithConstraints(run, run->initial_guess(), roles, algorithm, set_bounds);
  shooting.Simulate(SolutionOf(shooting.problem(), report), &at_end);
  report.guess.violation = at_guess.violation;
  report.solution.violation = at_end.violation;
  return report;
}

// Sets the bounds of the variables of a run.
void SetBounds(const HybridShooting& shooting, const VariableBlocks& variables, ceres::Problem* ceres) {
  std::size_t at = 0;
  for (std::size_t block = 0; block < variables.sizes.size(); ++block) {
    for (int i = 0; i < variables.sizes[block]; ++i, ++at) {
      const auto& [kind, index, min, max] = shooting.variables()[at];
      if (std::isfinite(min)) ceres->SetParameterLowerBound(variables.blocks[block], i, min);
      if (std::isfinite(max)) ceres->SetParameterUpperBound(variables.blocks[block], i, max);
    }
  }
}

SolveReport MinimizeInside(const HybridProblem& problem, const SolverOptions& options) {
  HybridRun run("ipopt", problem, options);
  const auto set_bounds = [&](const VariableBlocks& variables, ceres::Problem* ceres) {
    SetBounds(run.shooting(), variables, ceres);
  };
  return AcceptOptimum(problem,
                       MinimizeWithConstraints(&run, AugmentedLagrangian::Algorithm::kInteriorPoint, set_bounds));
}

// The interior-point method of IPOPT with the states eliminated: it never leaves the motions of the system. An
// iteration takes a roll-out for each variable, so that of many intervals few are solved in this way, and the others
// by phases from there.
SolveReport SolveByShootingInside(const HybridProblem& problem, const SolverOptions& options) {
  if (std::optional<SolveReport> report = RecogniseGuess("ipopt", problem, options)) return *report;
  const std::vector<int> grids = GridsOf(problem, options);
  if (grids.size() == 1) return MinimizeInside(problem, options);
  SolveChain chain(options);
  const HybridProblem coarse = ResampleOnGrid(problem, grids.front());
  SolveReport report = MinimizeInside(coarse, options);
  if (report.termination == Termination::kInterrupted || report.history.losses.empty()) return report;
  chain.Add(report);
  HybridProblem fine = problem;
  fine.guess_states.clear();
  fine.guess = SolutionOf(coarse, report);
  fine.guess.lengths.clear();
  fine = ResampleOnGrid(std::move(fine), problem.guess.num_intervals);
  const bool has_few_columns = problem.guess.num_intervals * problem.system.num_controls() <= kFewColumns;
  SolverOptions by_phases = chain.Next();
  if (has_few_columns) by_phases.limits.iterations = std::min(by_phases.limits.iterations, kFromNear);
  report = SolveHybridByInteriorPoint(fine, by_phases);
  chain.Add(report);
  const bool has_ended =
      report.termination == Termination::kConverged || report.termination == Termination::kInterrupted;
  if (!has_ended && has_few_columns && !chain.IsOutOfIterations()) {
    report = MinimizeInside(fine, chain.Next());
    chain.Add(report);
  }
  return chain.Finish(std::move(report));
}

SolveReport SolveByLm(const HybridProblem& problem, const SolverOptions& options) {
  HybridRun run("ceres_lm", problem, options);
  HybridShooting& shooting = run.shooting();
  if (shooting.num_equalities() + shooting.num_inequalities() > 0) {
    const auto set_bounds = [&](const VariableBlocks& variables, ceres::Problem* ceres) {
      SetBounds(shooting, variables, ceres);
    };
    return AcceptOptimum(problem,
                         MinimizeWithConstraints(&run, AugmentedLagrangian::Algorithm::kLeastSquares, set_bounds));
  }
  const bool apart = problem.free.control && shooting.LeaveOutCostsOfIntervals();
  const auto add_terms = [&](const VariableBlocks& variables, ceres::Problem* ceres) {
    SetBounds(shooting, variables, ceres);
    if (apart) AddCostsOfIntervals(problem, variables, ceres);
  };
  return AcceptOptimum(problem,
                       MinimizeLeastSquares(&run,
                                            run.initial_guess(),
                                            problem.free.duration,
                                            /*offset=*/0,
                                            add_terms,
                                            problem.system.num_controls()));
}

// Whether no motion of the system has events.
bool HasNoEvents(const HybridSystem& system) {
  if (system.functions().CreatesModes()) return false;
  for (int mode = 0; mode < system.num_modes(); ++mode) {
    if (system.num_guards(mode) > 0) return false;
  }
  return true;
}

// The parts of a motion that no small change of the variables changes, though the loss, or a constraint that is
// violated, depends on them.
struct OutOfReach {
  bool motion = false;              // all of it, as where contacts stick, or where a switch is never reached
  std::vector<std::string> states;  // at the end, if the control alone is free
};
OutOfReach FindOutOfReach(const HybridProblem& problem, const HybridInput& input) {
  OutOfReach found;
  const HybridFree& free = problem.free;
  HybridShooting shooting(problem);
  HybridShooting::Outcome outcome;
  std::vector<HybridShooting::TermAt> terms;
  if (!shooting.Simulate(input, &outcome) || !shooting.EvaluateTerms(&terms)) return found;
  HybridSimulator& simulator = shooting.simulator();
  std::vector<double> at_end(simulator.final_state().size(), 0.0);  // slopes of the loss and of violated constraints
  double steepest = 0;
  const auto slope_of = [](const HybridTerm& term, double residual) {
    if (term.IsCost()) return term.SlopeOf(residual);
    const bool holds = residual <= kFeasible && (term.role == HybridTerm::Role::kInequality || residual >= -kFeasible);
    return holds ? 0 : 2 * residual;
  };
  for (const HybridShooting::TermAt& at : terms) {
    if (!at.term->with_state) continue;
    const std::size_t size = at.blocks[0].size();
    for (std::size_t i = 0; i < size; ++i) {
      double slope = 0;
      for (std::size_t row = 0; row < at.residuals.size(); ++row) {
        slope += slope_of(*at.term, at.residuals[row]) * at.jacobians[0][row * size + i];
      }
      steepest = std::max(steepest, std::abs(slope));
      if (at.term->at == HybridTerm::Timing::kEnd) at_end[i] += slope;
    }
  }
  if (steepest == 0) return found;
  const auto changes = [&](const HybridCotangent& cotangent) {
    const HybridGradient gradient = simulator.Adjoint(cotangent);
    const auto by_variable = [&](const FreeVariable& of) {
      return of.kind != FreeVariable::Kind::kControl && of.Access(gradient) != 0;
    };
    return (free.control && std::ranges::any_of(gradient.control, [](double by) { return by != 0; })) ||
           std::ranges::any_of(shooting.variables(), by_variable);
  };
  const auto weights = [](std::size_t size) {  // of no combination of states that a motion would keep
    std::vector<double> of(size);
    for (std::size_t i = 0; i < size; ++i) of[i] = 1 + 0.1 * std::sqrt(static_cast<double>(i));
    return of;
  };
  HybridCotangent all;
  all.final_state = weights(at_end.size());
  for (int k = 0; k < input.num_intervals; ++k) all.nodes.push_back(weights(simulator.StateAt(k).size()));
  for (const HybridEvent& event : simulator.events()) {
    all.before.push_back(weights(event.before.size()));
    all.event_times.push_back(1);
  }
  found.motion = !changes(all);
  if (!free.control || !free.initial.empty() || !free.parameters.empty() || HasNoEvents(problem.system)) return found;
  for (std::size_t i = 0; i < at_end.size(); ++i) {
    HybridCotangent one;
    one.final_state.assign(at_end.size(), 0.0);
    one.final_state[i] = 1;
    if (std::abs(at_end[i]) > kNoSlope * steepest && !changes(one)) {
      found.states.push_back(problem.system.StateName(simulator.final_mode(), static_cast<int>(i)));
    }
  }
  return found;
}

// Removes the verdict of a certificate on derivatives where squares are zero: they are small beside terms that are
// rounding.
void JudgeSquaresOfZero(const HybridProblem& problem, SolveReport* report) {
  const bool squares =
      std::ranges::none_of(problem.terms, [](const HybridTerm& term) { return term.role == HybridTerm::Role::kValue; });
  const bool zero = squares && report->solution.violation <= kFeasible && std::isfinite(report->guess.loss) &&
                    report->solution.loss <= kZero * report->guess.loss;
  if (!zero || !report->certificate || report->certificate->verdict != Certificate::Verdict::kNotStationary) return;
  if (!HasNoLoss(problem, *report)) return;  // the guess was far off
  report->certificate->verdict = Certificate::Verdict::kNotApplicable;
  report->certificate->reason =
      "all costs are squares and zero, so that no motion has a lower loss; conditions relative to their size do not "
      "apply";
}

// Certifies a run that has converged, and takes back what its certificate contradicts. Where modes are created, a state
// that no small change of the control changes is one that contacts would move: a solver that tries no larger changes
// has found no optimum there.
void JudgeSolution(const HybridProblem& problem, SolveReport* report) {
  if (report->termination != Termination::kConverged) return;
  if (!report->certificate) report->certificate = Certify(problem, SolutionOf(problem, *report));
  JudgeSquaresOfZero(problem, report);
  JudgeByCertificate(report);
  if (report->termination != Termination::kConverged) return;
  const OutOfReach out = FindOutOfReach(problem, SolutionOf(problem, *report));
  if (out.states.empty() && !out.motion) return;
  const bool searches = report->solver == "mode_search";
  const std::string larger = std::string(": start from a control that does") +
                             (searches ? "" : ", or use mode_search, which tries larger ones");
  const bool converged = !out.motion && (searches || !problem.system.functions().CreatesModes());
  if (!converged) report->termination = Termination::kNoProgress;
  report->reason +=
      (report->reason.empty() ? ""
       : converged            ? "; "
                              : ", but ") +
      (!problem.free.control ? "no small change of what is optimized changes the motion: start from values "
                               "that do, or bound them there"
       : out.motion          ? "no small change of the control changes the motion, as where all contacts stick" + larger
                             : "no small change of the control changes " + Joined(out.states) + " at the end" + larger);
}

// Whether the loss has a kink where a run has ended that no step along its slope passes: small ones, which keep the
// constraints to first order, raise it in proportion to their length, though its derivative says that they lower it.
bool EndsAtKink(const HybridProblem& problem, const SolveReport& report) {
  constexpr double kActive = 1e-6, kRise = 0.1;  // the latter: of the fall that the derivative tells
  if (report.history.losses.empty() || report.solution.violation > kFeasible) return false;
  if (report.termination != Termination::kNoProgress && report.termination != Termination::kIterationLimit)
    return false;
  HybridProblem at_end = problem;
  at_end.guess = SolutionOf(problem, report);
  HybridShooting shooting(at_end);
  const std::vector<double>& z = shooting.initial_guess();
  const auto n = static_cast<Eigen::Index>(z.size());
  const int rows = shooting.num_residuals(), equalities = shooting.num_equalities();
  double loss = 0;
  Eigen::VectorXd gradient(n), residuals(rows), size(n), step(n);
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> jacobian(rows, n);
  if (!shooting.Evaluate(z, &loss, gradient.data()) || !gradient.allFinite()) return false;
  if (!shooting.EvaluateResiduals(z, residuals.data(), jacobian.data()) || !jacobian.allFinite()) return false;
  for (Eigen::Index i = 0; i < n; ++i) {
    const FreeVariable& of = shooting.variables()[i];
    const double width = of.max - of.min;
    size[i] = std::isfinite(width) ? width : std::max(1.0, std::abs(z[i]));
    const bool at_min = z[i] - of.min <= kActive * size[i], at_max = of.max - z[i] <= kActive * size[i];
    if ((at_min && gradient[i] > 0) || (at_max && gradient[i] < 0)) size[i] = 0;
  }
  Eigen::MatrixXd held(0, n);
  for (int row = 0; row < equalities + shooting.num_inequalities(); ++row) {
    if (row >= equalities && residuals[row] < -kActive) continue;
    held.conservativeResize(held.rows() + 1, n);
    held.bottomRows(1) = jacobian.row(row).cwiseProduct(size.transpose());
  }
  step = -size.cwiseProduct(gradient);
  if (held.rows() > 0) step -= held.completeOrthogonalDecomposition().solve(held * step);
  const double slope = step.norm();
  if (!(slope > 0)) return false;
  step /= slope;
  for (const double length : {1e-4, 1e-5, 1e-6}) {
    std::vector<double> moved = z;
    for (Eigen::Index i = 0; i < n; ++i) moved[i] += length * size[i] * step[i];
    double after = 0;
    if (!shooting.Evaluate(moved, &after, nullptr) || !(after - loss > kRise * length * slope)) return false;
  }
  return true;
}

// ---------------------------------------------------------------------------------------------------------------- auto

// Returns the reason why Gauss-Newton steps miss an important part of the curvature; empty if they do not.
std::string UnsupportedByGaussNewton(const HybridProblem& problem) {
  for (const HybridTerm& term : problem.terms) {
    if (term.role == HybridTerm::Role::kValue) return term.name + " is a cost that is no square";
    if (!term.IsCost()) return term.name + " is a constraint";
  }
  if (problem.free.duration) return "the duration is free";
  int rows = 0;
  for (const HybridTerm& term : problem.terms) {
    const bool repeats = term.at == HybridTerm::Timing::kEachInterval && term.interval < 0;
    rows += term.function->num_residuals() * (repeats ? problem.guess.num_intervals : 1);
  }
  const int columns = problem.free.control ? problem.guess.num_intervals * problem.system.num_controls() : 0;
  if (rows < columns) return "the loss has fewer squares than the control has numbers";
  return "";
}

SolveReport SolveAutomatically(const HybridProblem& problem, const SolverOptions& options);

// Solves, and again with more steps of the integration where the solution needs them, unless the solver does so itself.
SolveReport SolveBy(const HybridSolverEntry& entry, const HybridProblem& problem, const SolverOptions& options) {
  if (entry.solve == SolveHybridByModeSearch || entry.solve == SolveAutomatically) return entry.solve(problem, options);
  return SolveWithEnoughSteps(problem, options, entry.solve);
}

SolveReport SolveAutomatically(const HybridProblem& problem, const SolverOptions& options) {
  const HybridSystem& system = problem.system;
  std::string why = UnsupportedByHybridPhases(problem);
  std::vector<std::string_view> order = {"ceres_lm", "ceres_lbfgs", "gd"};
  if (why.empty()) {
    // Without constraints and bounds, shooting never leaves the motions of the system, and ends where phases go astray.
    why = UnsupportedByGaussNewton(problem);
    order = {"ipopt", "ceres_lbfgs", "ceres_phases", "ceres_lm"};
    if (why.empty()) {
      why = "all costs are squares, without constraints";
      order = {"ceres_phases", "ipopt", "ceres_lbfgs", "ceres_lm"};
      const int columns = problem.guess.num_intervals * system.num_controls();
      if (HasNoEvents(system) && columns <= kFewColumns && problem.guess_states.empty()) {
        why += " and events";
        order = {"ceres_lm", "ceres_phases", "ipopt", "ceres_lbfgs"};
      }
    }
  }
  if (system.functions().CreatesModes()) {  // contacts may stick, and all others would end at the guess
    const HybridShooting guess(problem);
    const bool is_stuck = FindOutOfReach(problem, guess.InputAt(guess.initial_guess())).motion;
    if (is_stuck && problem.free.control && UnsupportedByHybridPhases(problem).empty()) {
      why = "no small change of the control changes the motion of the guess";
      order.clear();
    }
    order.push_back("mode_search");
  }
  const bool constrained = !std::ranges::all_of(problem.terms, &HybridTerm::IsCost);
  // Where phases are slow to find a way, eliminated states may be fast. Where no motion of about the guess's duration
  // meets the constraints, their least violation may be a local minimum.
  constexpr std::string_view kInside = "ipopt with the states eliminated", kLonger = "ipopt from twice the duration",
                             kMore = "ipopt in more iterations";
  const HybridFree& free = problem.free;
  const bool is_smooth = HasNoEvents(system) && problem.guess_states.empty();
  if (const auto first = std::ranges::find(order, "ipopt"); first != order.end()) {
    // Phases pass by motions that miss squares of states by much; without these, nothing is gained by leaving motions.
    const bool has_targets = std::ranges::any_of(
        problem.terms, [](const HybridTerm& term) { return term.role == HybridTerm::Role::kCost && term.with_state; });
    std::vector<std::string_view> attempts = {"ipopt", kInside};
    if (!constrained && !has_targets && is_smooth) std::swap(attempts[0], attempts[1]);
    if (constrained && free.duration && 2 * problem.guess.duration <= free.duration_max) attempts.push_back(kLonger);
    if (is_smooth) attempts.push_back(kMore);
    order.insert(order.erase(first), attempts.begin(), attempts.end());
  }
  bool misses = false, ran_out = false;  // whether the last solve by ipopt missed constraints; ended before its time
  bool at_kink = false;
  const auto solve = [&](std::string_view name, SolverOptions of_solve, const SolveReport* from) {
    static const HybridSolverEntry inside = {kInside, "", UnsupportedByShootingInside, SolveByShootingInside};
    const bool is_phases = name == "ipopt" || name == kLonger || name == kMore;
    const HybridSolverEntry& entry =
        name == kInside ? inside
                        : *std::ranges::find(HybridSolvers(), is_phases ? "ipopt" : name, &HybridSolverEntry::name);
    SolveReport report;
    report.termination = Termination::kNotApplicable;
    if (at_kink || (name == kLonger && !misses) || (name == kMore && !ran_out)) {
      report.reason = why;
      return report;
    }
    const bool is_first = name == "ipopt" && from == nullptr && is_smooth;
    if (is_first) {
      of_solve.limits.iterations = std::min(of_solve.limits.iterations, kFirstIterations);
      of_solve.coarse_to_fine = false;
    }
    // With constraints, shooting has found no optimum that phases have not.
    report.reason =
        name == "ceres_lm" && constrained ? UnsupportedByShooting(problem) : entry.reason_not_applicable(problem);
    if (!report.reason.empty()) return report;
    HybridProblem start = problem;
    if (from != nullptr) {
      start.guess = SolutionOf(problem, *from);
      start.guess_states.clear();
    }
    if (name == kLonger) {
      start.guess.duration *= 2;
      for (double& length : start.guess.lengths) length *= 2;
    }
    report = SolveBy(entry, start, of_solve);
    JudgeSolution(problem, &report);
    if (is_phases || name == kInside) misses = report.solution.violation > kFeasible;
    if (is_first) ran_out = report.termination == Termination::kIterationLimit;
    at_kink = is_smooth && EndsAtKink(problem, report);
    if (at_kink) {
      report.termination = Termination::kNoProgress;
      report.reason =
          "the loss has a kink at the solution, as of max or abs, where steps down its slope raise it: it may be "
          "an optimum, which derivatives do not prove";
    }
    return report;
  };
  // Shooting comes first: it never leaves the motions of the system, of which the best is one.
  return SolveInTurn(order, {"ceres_lm", "ceres_phases", "ipopt"}, why, options, solve);
}

// -------------------------------------------------------------------------------------------------------- idle events

// Returns the problem without events that change nothing, such as reversals of contacts without friction, which a plan
// would hold for no gain; nothing if it has none, or names events or modes.
std::optional<HybridProblem> RemoveIdleEvents(const HybridProblem& problem, const SolverOptions& options) {
  const bool names = options.sequences.given || std::ranges::any_of(problem.terms, [](const HybridTerm& term) {
                       return term.at == HybridTerm::Timing::kEvent || term.mode >= 0;
                     });
  if (names) return std::nullopt;
  auto lean = problem.system.functions().RemoveIdleEvents(problem.guess.parameters.data(), problem.free.parameters);
  if (lean == nullptr) return std::nullopt;
  HybridProblem without = problem;
  without.guess.mode = lean->EquivalentMode(problem.system.ModeName(problem.guess.mode));
  without.system = HybridSystem(std::move(lean));
  return without;
}

// Names the events of optima, which are those of the system `of`, as events of the system `as`.
void RenameEvents(const HybridSystem& of, const HybridSystem& as, std::vector<LocalOptimum>* optima) {
  for (LocalOptimum& optimum : *optima) {
    for (Candidate& event : optimum.sequence) {
      const int mode = std::exchange(event.a, as.functions().EquivalentMode(of.ModeName(event.a)));
      if (event.b < 0) continue;  // a jump of the control
      const std::string name = of.GuardName(mode, event.b);
      for (int guard = 0; guard < as.num_guards(event.a); ++guard) {
        if (as.GuardName(event.a, guard) == name) event.b = guard;
      }
    }
  }
}

void NameTermsWithoutEvents(const HybridProblem& problem, SolveReport* report) {
  const auto is_at_event = [](const HybridTerm& term) { return term.at == HybridTerm::Timing::kEvent; };
  if (std::ranges::none_of(problem.terms, is_at_event)) return;
  HybridShooting shooting(problem);
  HybridShooting::Outcome outcome;
  if (!shooting.Simulate(SolutionOf(problem, *report), &outcome)) return;
  const std::string remark = shooting.TermsWithoutEvents();
  if (!remark.empty()) report->reason += (report->reason.empty() ? "" : "; ") + remark;
}

}  // namespace

const std::vector<HybridSolverEntry>& HybridSolvers() {
  static const std::vector<HybridSolverEntry> solvers = {
      {"auto",
       "chooses from the structure of the problem, and goes on with another",
       UnsupportedByAllSolvers,
       SolveAutomatically},
      {"gd", "gradient descent at a fixed rate", UnsupportedByShooting, SolveByGradientDescent},
      {"ceres_lbfgs", "L-BFGS on the adjoint gradient", UnsupportedByLbfgs, SolveByLbfgs},
      {"ceres_lm", "Levenberg-Marquardt, states eliminated", UnsupportedByLm, SolveByLm},
      {"ceres_phases", "phases between events, a cost for every step", UnsupportedByHybridPhases, SolveHybridByPhases},
      {"ipopt",
       "phases between events, by an interior-point method",
       UnsupportedByInteriorPoint,
       SolveHybridByInteriorPoint},
      {"mode_search",
       "search over sequences of events, by ceres_phases",
       UnsupportedByHybridPhases,
       SolveHybridByModeSearch},
  };
  return solvers;
}

SolveReport Solve(std::string_view solver, const HybridProblem& given, const SolverOptions& options) {
  SolveReport report;
  report.solver = solver;
  report.termination = Termination::kNotApplicable;
  const auto entry = std::find_if(
      HybridSolvers().begin(), HybridSolvers().end(), [&](const HybridSolverEntry& e) { return e.name == solver; });
  if (entry == HybridSolvers().end()) {
    report.reason = "solver: found '" + std::string(solver) + "', expected a solver of hybrid systems:";
    for (const HybridSolverEntry& known : HybridSolvers()) report.reason += " " + std::string(known.name);
    return report;
  }
  report.reason = Validate(given);
  if (report.reason.empty()) report.reason = Validate(options);
  if (report.reason.empty()) report.reason = entry->reason_not_applicable(given);
  if (!report.reason.empty()) return report;
  if (const auto without = RemoveIdleEvents(given, options)) {
    report = Solve(solver, *without, options);
    RenameEvents(without->system, given.system, &report.optima);
    return report;
  }
  const HybridProblem problem = ScaleConstraints(given, given.guess);
  report = SolveBy(*entry, problem, options);
  if (entry->solve != SolveAutomatically) JudgeSolution(problem, &report);
  if (!report.history.losses.empty()) NameTermsWithoutEvents(problem, &report);
  return report;
}

}  // namespace saltus
