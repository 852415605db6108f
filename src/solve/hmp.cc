#include "solve/hmp.h"

#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "base/linear_algebra.h"
#include "base/statistics.h"
#include "saltus/control/objective.h"
#include "simulate/costate_sweep.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_solution.h"

namespace saltus {
namespace {

constexpr int kStride = 4;  // derivatives in one pass
constexpr double kResidualTolerance = 1e-9;
constexpr double kSameLossAsOnGrid = 1e-3;  // relative, between the grid and continuous time
constexpr double kAtEnd = 1e-6;             // of the bounds of a free final time
constexpr double kLeastStep = 1e-14;        // of Newton's method for the costates, relative
constexpr int kFineSteps = 480;             // of a control that is near the optimum in continuous time

struct PathConditions {
  HmpSystem system;
  template <typename T>
  bool operator()(T const* const* y, T* residuals) const {
    Path<T> path;
    return system.Evaluate(y[0], &path, residuals);
  }
};

struct ShootingConditions {
  const CostateShooting* shooting;
  template <typename T>
  bool operator()(T const* const* y, T* residuals) const {
    return shooting->Evaluate(y[0], residuals);
  }
};

// Newton's method, damped where the full step fails, for as many equations as there are numbers in y. Returns the
// number of Jacobians that it has computed. It ends where a step is at most `least_step`, relative to y.
template <int kJetWidth, typename Equations>
int FindRoot(const Equations& equations, int num_equations, std::vector<double>* y, int most_iterations,
             double least_step = 0) {
  auto* cost = new ceres::DynamicAutoDiffCostFunction<Equations, kJetWidth>(new Equations(equations));
  cost->AddParameterBlock(static_cast<int>(y->size()));
  cost->SetNumResiduals(num_equations);
  ceres::Problem problem;
  problem.AddResidualBlock(cost, nullptr, y->data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = most_iterations;
  options.initial_trust_region_radius = 1e12;  // Newton's method until that fails
  options.max_trust_region_radius = 1e20;
  options.min_lm_diagonal = 1e-12;
  options.gradient_tolerance = 0;
  options.function_tolerance = 0;
  options.parameter_tolerance = least_step;
  options.max_num_consecutive_invalid_steps = 20;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.num_jacobian_evaluations;
}

// The multipliers that leave the least sum of squares.
bool StartMultipliers(const HmpSystem& system, std::vector<double>* y) {
  const int n = system.sizes.Sum(), variables = system.phases->num_variables();
  Path<double> path;
  Eigen::VectorXd base(n), moved(n);
  if (!system.Evaluate(y->data(), &path, base.data())) return false;
  Eigen::MatrixXd columns(n, system.num_impacts());
  for (int k = 0; k < system.num_impacts(); ++k) {
    (*y)[variables + k] = 1;
    system.Evaluate(y->data(), &path, moved.data());
    (*y)[variables + k] = 0;
    columns.col(k) = moved - base;
  }
  if (system.num_impacts() == 0) return true;
  const Eigen::VectorXd best = -LeastSquaresSolution(columns, base);
  std::copy_n(best.data(), system.num_impacts(), y->begin() + variables);
  return true;
}

Certificate CertifyOptimum(const ContinuousOptimum& optimum, const Certificate& on_grid) {
  const ConditionSizes& sizes = optimum.shooting.sizes();
  const double* hamiltonian = optimum.residuals.data() + sizes.jumps;
  const double* terminal = hamiltonian + sizes.hamiltonians + sizes.gaps;
  Certificate certificate;
  certificate.costate_jump = Largest(std::span(optimum.residuals.data(), sizes.jumps)) / optimum.scale;
  certificate.hamiltonian = Largest(std::span(hamiltonian, sizes.hamiltonians)) / optimum.scale;
  certificate.transversality = Largest(std::span(terminal, sizes.terminal)) / optimum.scale;
  certificate.impacts = on_grid.impacts;
  for (size_t k = 0; k < certificate.impacts.size(); ++k) {
    ImpactCertificate& impact = certificate.impacts[k];
    impact.time = optimum.shooting.Time(optimum.y.data(), static_cast<int>(k));
    impact.multiplier = optimum.shooting.Multiplier(optimum.y.data(), static_cast<int>(k));
    impact.speed = optimum.speeds[k];
    impact.jump = certificate.costate_jump;
    impact.hamiltonian = hamiltonian[k] / optimum.scale;
    impact.on_node = true;
    impact.theta.reset();
  }
  certificate.constraints = on_grid.constraints;
  for (size_t i = 0; i < certificate.constraints.size(); ++i) {
    certificate.constraints[i].multiplier = optimum.shooting.Hard(optimum.y.data(), static_cast<int>(i));
  }
  if (sizes.hamiltonians > static_cast<int>(certificate.impacts.size())) {
    certificate.final_time = hamiltonian[sizes.hamiltonians - 1] / optimum.scale;
  }
  Judge(&certificate);
  return certificate;
}

std::string UnsupportedByConstrainedHmp(const SolveRequest& request) {
  if (std::string reason = UnsupportedByExactPhases(request); !reason.empty()) return reason;
  return CostateShooting::ReasonNotSupported(request.scene);
}

// Returns the report with the best control along its impacts on so many intervals that it is near that in continuous
// time, if there is one.
SolveReport RefineIntervals(Scene scene, SolveReport report) {
  Trial trial{report.solution.control, report.solution.durations, {}};
  Simulate(scene, &trial);
  const ContactSequence& sequence = trial.exact.contacts;
  if (!trial.exact.ok || !trial.exact.only_impacts || scene.steps >= kFineSteps) return report;
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, trial), sequence);
  scene.steps = kFineSteps;
  PhaseSolution fine = SolveAlong(scene, sequence, guess, {});
  if (!fine.optimal()) return report;
  report.solution.loss = fine.attempt.trial.exact.loss;
  report.solution.control = std::move(fine.attempt.trial.control);
  report.solution.durations = std::move(fine.attempt.trial.durations);
  return report;
}

}  // namespace

HmpRoot FindHmpRoot(const EventPhases& phases, std::vector<double> z, int most_iterations) {
  HmpRoot root;
  const PathConditions conditions{HmpSystem(&phases)};
  const HmpSystem& system = conditions.system;
  std::vector<double> y = std::move(z);
  y.resize(system.num_variables(), 0.0);
  if (!StartMultipliers(system, &y)) return root;
  const int n = system.sizes.Sum();
  const int jacobians = n > 0 ? FindRoot<kStride>(conditions, n, &y, most_iterations) : 0;
  Path<double> path;
  std::vector<double> r(n);
  if (!system.Evaluate(y.data(), &path, r.data())) return root;
  root.valid = true;
  root.residual = Largest(std::span(r.data(), n));
  for (int k = 0; k < system.num_impacts(); ++k) {
    root.scale = std::max(root.scale, std::abs(y[phases.num_variables() + k]));
  }
  for (const Arc<double>& arc : path.arcs) {
    const double mass = phases.scene().bodies[arc.body].mass;
    const double weight = 2 * phases.scene().objective.effort * mass * mass;
    root.scale = std::max({root.scale, weight * arc.slope.norm(), weight * arc.AccelerationAtStart().norm()});
  }
  root.jacobians = jacobians;
  y.resize(phases.num_variables());
  root.z = std::move(y);
  return root;
}

double ContinuousOptimum::Residual() const { return Largest(residuals) / scale; }

std::optional<ContinuousOptimum> FindContinuousOptimum(const Scene& scene, const SolveReport& start,
                                                       int most_iterations) {
  Scene whole = scene;
  if (scene.objective.duration) {
    whole.duration = std::accumulate(start.solution.durations.begin(), start.solution.durations.end(), 0.0);
  }
  const ExactRun exact =
      SimulateExactly(scene, start.solution.initial_state, start.solution.control, start.solution.durations);
  if (!exact.ok || !exact.only_impacts) return std::nullopt;
  const Certificate certificate =
      start.certificate
          ? *start.certificate
          : Certify(scene, start.solution.initial_state, start.solution.control, start.solution.durations);
  if (!certificate.IsStationary() && certificate.impacts.size() != exact.contacts.size()) return std::nullopt;
  const Flight flight(whole, start.solution.initial_state, start.solution.control, start.solution.durations, exact);
  std::vector<Vec2d> hard;
  for (const ConstraintCertificate& constraint : certificate.constraints) hard.push_back(constraint.multiplier);
  std::vector<ConstraintRow> rows = RowsOfHardTerms(scene);
  for (ConstraintRow& row : rows) row.multiplier = hard[row.owner].dot(row.normal);
  std::vector<double> times, multipliers;
  for (const Event& event : exact.events) times.push_back(event.time);
  for (const ImpactCertificate& impact : certificate.impacts) multipliers.push_back(impact.multiplier);
  const CostateSweep::Result costates =
      CostateSweep(whole, flight).Sweep(rows, [&](int k, const ImpactJump&, double) { return multipliers[k]; });

  const std::optional<FreeDuration>& free = scene.objective.duration;
  const bool moving_end =
      free && whole.duration > free->min * (1 + kAtEnd) && whole.duration < free->max * (1 - kAtEnd);
  ContinuousOptimum found(CostateShooting(whole, exact.contacts, moving_end));
  const CostateShooting& shooting = found.shooting;
  found.y = shooting.Unknowns(costates.start, costates.after_impact, times, multipliers, hard, whole.duration);
  found.jacobians = FindRoot<kCostateShootingStride>(
      ShootingConditions{&shooting}, shooting.num_unknowns(), &found.y, most_iterations, kLeastStep);
  found.residuals.resize(shooting.num_unknowns());
  if (!shooting.Evaluate(found.y.data(), found.residuals.data(), &found.loss, &found.legs, &found.speeds)) {
    return std::nullopt;
  }
  found.scale = std::max({costates.largest_position, costates.largest_velocity, 1e-300});
  return found;
}

std::string UnsupportedByHmp(const SolveRequest& request) {
  return NonTerminalFeatures(request.scene).empty() ? UnsupportedByEventPhases(request)
                                                    : UnsupportedByConstrainedHmp(request);
}

SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const Scene& scene = request.scene;
  const bool by_arcs = NonTerminalFeatures(scene).empty();
  SolveReport report = by_arcs ? SolveByCeresEvent(request, options) : SolveByCeresPhases(request, options);
  report.solver = "hmp";
  if (report.termination == Termination::kNotApplicable || report.termination == Termination::kFailed ||
      report.termination == Termination::kInterrupted) {
    return report;
  }
  const bool at_kink = report.certificate &&
                       report.certificate->verdict == Certificate::Verdict::kNotApplicable;  // where a pair touches
  const SolveReport near = by_arcs && !at_kink ? RefineIntervals(scene, report) : report;
  std::optional<ContinuousOptimum> optimum;
  if (!at_kink) optimum = FindContinuousOptimum(scene, near, options.limits.iterations);
  const auto give_up = [&](const std::string& reason) {
    if (report.termination == Termination::kConverged) report.termination = Termination::kNoProgress;
    report.reason += (report.reason.empty() ? "" : "; ") + reason;
  };
  if (at_kink) {
    give_up("conditions in continuous time are not checked at a motion that touches or ends at an impact: " +
            report.certificate->reason);
  } else if (!optimum) {
    give_up("Newton's method for the costates left the motions with this sequence of impacts");
  } else if (optimum->Residual() > kResidualTolerance) {
    give_up("the conditions of the minimum principle are not met");
  } else if (std::abs(optimum->loss - near.solution.loss) > kSameLossAsOnGrid * std::abs(near.solution.loss)) {
    give_up("the optimum in continuous time has another loss than that on these intervals: raise `steps`");
  } else {
    if (!report.certificate) {
      report.certificate =
          Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    }
    report.continuous = CertifyOptimum(*optimum, *report.certificate);
    if (report.termination != Termination::kConverged) report.reason.clear();  // that of ceres_phases
    report.termination = Termination::kConverged;
    report.solution.loss = optimum->loss;
    report.history.losses.back() = optimum->loss;  // of the last iteration, whose control it goes on from
    report.work.evaluations += optimum->jacobians;
  }
  report.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

}  // namespace saltus
