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
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_run.h"
#include "solve/phases/phase_solution.h"

namespace saltus {
namespace {

constexpr int kStride = 4;  // derivatives in one pass
constexpr double kResidualTolerance = 1e-9;
constexpr double kSameLoss = 1e-4;          // relative: Newton's method has stayed with the minimum it started from
constexpr double kSameLossAsOnGrid = 1e-3;  // relative, between the grid and continuous time
constexpr double kAtEnd = 1e-6;             // of the bounds of a free final time

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
// number of Jacobians that it has computed.
template <int kJetWidth, typename Equations>
int FindRoot(const Equations& equations, int num_equations, std::vector<double>* y, int most_iterations) {
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
  options.parameter_tolerance = 0;
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

// A certificate with the residuals of the conditions, relative to `scale`.
Certificate MakeResidualCertificate(const std::vector<double>& residuals, const ConditionSizes& sizes, double scale) {
  const double* hamiltonian = residuals.data() + sizes.jumps;
  const double* terminal = hamiltonian + sizes.hamiltonians + sizes.gaps;
  Certificate certificate;
  certificate.costate_jump = Largest(std::span(residuals.data(), sizes.jumps)) / scale;
  certificate.hamiltonian = Largest(std::span(hamiltonian, sizes.hamiltonians)) / scale;
  certificate.transversality = Largest(std::span(terminal, sizes.terminal)) / scale;
  return certificate;
}

Certificate CertifyOptimum(const ContinuousOptimum& optimum, const Certificate& on_grid) {
  const ConditionSizes& sizes = optimum.shooting.sizes();
  const double* hamiltonian = optimum.residuals.data() + sizes.jumps;
  Certificate certificate = MakeResidualCertificate(optimum.residuals, sizes, optimum.scale);
  certificate.impacts = on_grid.impacts;
  for (size_t k = 0; k < certificate.impacts.size(); ++k) {
    ImpactCertificate& impact = certificate.impacts[k];
    impact.time = optimum.shooting.Time(optimum.y.data(), static_cast<int>(k));
    impact.multiplier = optimum.shooting.Multiplier(optimum.y.data(), static_cast<int>(k));
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

SolveReport SolveConstrainedByHmp(const SolveRequest& request, const SolverOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const Scene& scene = request.scene;
  SolveReport report = SolveByCeresPhases(request, options);
  report.solver = "hmp";
  if (report.termination == Termination::kNotApplicable || report.termination == Termination::kFailed ||
      report.termination == Termination::kInterrupted) {
    return report;
  }
  const std::optional<ContinuousOptimum> optimum = FindContinuousOptimum(scene, report, options.limits.iterations);
  const auto give_up = [&](const std::string& reason) {
    if (report.termination == Termination::kConverged) report.termination = Termination::kNoProgress;
    report.reason += (report.reason.empty() ? "" : "; ") + reason;
  };
  if (!optimum) {
    give_up("Newton's method for the costates left the motions with this sequence of impacts");
  } else if (optimum->Residual() > kResidualTolerance) {
    give_up("the conditions of the minimum principle are not met");
  } else if (std::abs(optimum->loss - report.solution.loss) > kSameLossAsOnGrid * std::abs(report.solution.loss)) {
    give_up("the optimum in continuous time has another loss than that on these intervals: raise `steps`");
  } else {
    report.certificate =
        Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    report.continuous = CertifyOptimum(*optimum, *report.certificate);
    if (report.termination != Termination::kConverged) report.reason.clear();  // that of ceres_phases
    report.termination = Termination::kConverged;
    report.solution.loss = optimum->loss;
    report.history.losses.push_back(optimum->loss);
    report.work.iterations += 1;
    report.work.evaluations += optimum->jacobians;
  }
  report.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

// The conditions as HmpSystem has them, relative to the costates met.
Certificate CertifyRoot(const EventPhases& phases, const HmpRoot& root, const ExactRun& exact) {
  const HmpSystem system(&phases);
  std::vector<double> y = root.z, r(system.sizes.Sum());
  y.insert(y.end(), root.multipliers.begin(), root.multipliers.end());
  Path<double> path;
  system.Evaluate(y.data(), &path, r.data());
  Certificate certificate = MakeResidualCertificate(r, system.sizes, root.scale);
  const double* hamiltonian = r.data() + system.sizes.jumps;  // last impact first
  const int n = system.num_impacts();
  for (int k = 0; k < n; ++k) {
    const PhaseImpact<double>& impact = path.impacts[k];
    ImpactCertificate item{.time = impact.time,
                           .a = exact.events[k].a,
                           .b = exact.events[k].b,
                           .speed = -impact.impact.speed,
                           .multiplier = root.multipliers[k],
                           .jump = certificate.costate_jump,
                           .hamiltonian = hamiltonian[n - 1 - k] / root.scale,
                           .on_node = true,
                           .theta = std::nullopt};
    certificate.impacts.push_back(std::move(item));
  }
  Judge(&certificate);
  JudgeTies(exact.ambiguous, &certificate);
  return certificate;
}

// A piecewise constant control with the same impacts: the best one near by, if there is one.
bool WriteControl(const Scene& scene, const ContactSequence& sequence, const std::vector<double>& z,
                  const std::vector<double>& times, Trial* trial) {
  std::vector<int> intervals = DistributeIntervals(scene, sequence, times);
  if (intervals.empty()) return false;
  const EventPhases phases(scene, sequence, std::move(intervals));
  Path<double> path;
  if (!phases.Unroll(z.data(), &path)) return false;
  phases.Control(path, &trial->control, &trial->durations);
  Simulate(scene, trial);
  if (!trial->exact.ok || trial->exact.contacts != sequence) return true;
  PhaseSolution best = SolveAlong(scene, sequence, GuessFrom(scene, FlightOf(scene, *trial), sequence), {});
  if (best.optimal() && best.trial.exact.loss <= trial->exact.loss) *trial = std::move(best.trial);
  return true;
}

// The result of a solve along one sequence.
struct Attempt {
  Trial trial;
  double loss = 0;  // in continuous time
  Termination termination = Termination::kFailed;
  std::string reason;
  std::optional<Certificate> certificate, continuous;
};

Attempt SolveFrom(const Trial& start, const ContactSequence& sequence, PhaseRun* run) {
  const Scene& scene = run->scene();
  const auto fail = [&](Termination termination, const std::string& reason) {
    return Attempt{start, start.exact.loss, termination, reason, std::nullopt, std::nullopt};
  };
  const EventPhases phases(scene, sequence);
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, start), sequence);
  PhaseMinimumOptions minimum_options;
  const int left = run->iterations_left();
  minimum_options.iterations = std::max(0, left - 1);  // Newton's method for the costates counts as the last one
  minimum_options.callback = [&](double loss) { return run->Record(loss); };
  const PhaseMinimum minimum =
      MinimizeLoss(phases, phases.Variables(guess.times, guess.before, guess.end), minimum_options);
  run->report().work.evaluations += minimum.jacobians;
  if (minimum.interrupted) return fail(Termination::kInterrupted, "");
  if (!minimum.valid) {
    return fail(Termination::kFailed,
                "no motion with the sequence " + ContactSequenceToString(scene, sequence) + " was found to start from");
  }
  HmpRoot root;
  root.z = minimum.z;
  if (!minimum.touches) {
    root = FindHmpRoot(phases, minimum.z, run->options().limits.iterations);
    run->report().work.evaluations += root.jacobians;
  }
  Path<double> path;
  if (!(root.valid || minimum.touches) || !phases.Unroll(root.z.data(), &path)) {
    return fail(Termination::kFailed,
                "Newton's method for the costates left the motions with this sequence of impacts");
  }
  Attempt attempt;
  attempt.loss = phases.Loss(path);
  if (left > 0) run->Record(attempt.loss);
  std::vector<double> times;
  for (const PhaseImpact<double>& impact : path.impacts) times.push_back(impact.time);
  if (!WriteControl(scene, sequence, root.z, times, &attempt.trial)) {
    return fail(Termination::kFailed,
                "the scene has too few steps for the phases between the impacts; increase `steps`");
  }
  attempt.termination = Termination::kNoProgress;
  if (minimum.touches || !attempt.trial.exact.only_impacts || attempt.trial.exact.contacts != sequence) {
    attempt.reason = ReasonNotOptimal(scene, sequence, minimum.touches, attempt.trial.exact);
    return attempt;
  }
  attempt.continuous = CertifyRoot(phases, root, attempt.trial.exact);
  attempt.certificate = CertifyTrial(scene, attempt.trial);
  if (root.residual > kResidualTolerance * root.scale) {
    attempt.reason = "the conditions of the minimum principle are not met";
  } else if (std::abs(attempt.loss - minimum.loss) > kSameLoss * std::abs(attempt.loss)) {
    attempt.reason = "the conditions of the minimum principle are met at a point with another loss than the minimum";
  } else {
    attempt.termination = Termination::kConverged;
  }
  return attempt;
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
  root.multipliers.assign(y.begin() + phases.num_variables(), y.end());
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
      Certify(scene, start.solution.initial_state, start.solution.control, start.solution.durations);
  if (!certificate.IsStationary() && certificate.impacts.size() != exact.contacts.size()) return std::nullopt;
  const Flight flight(whole, start.solution.initial_state, start.solution.control, start.solution.durations, exact);
  std::vector<Vec2d> hard;
  for (const ConstraintCertificate& constraint : certificate.constraints) hard.push_back(constraint.multiplier);
  std::vector<ConstraintRow> rows = RowsOfHardTerms(scene);
  for (ConstraintRow& row : rows) row.multiplier = hard[row.owner].dot(row.normal);
  std::vector<double> times, multipliers;
  for (const ImpactCertificate& impact : certificate.impacts) {
    times.push_back(impact.time);
    multipliers.push_back(impact.multiplier);
  }
  const CostateSweep::Result costates =
      CostateSweep(whole, flight).Sweep(rows, [&](int k, const ImpactJump&, double) { return multipliers[k]; });

  const std::optional<FreeDuration>& free = scene.objective.duration;
  const bool moving_end =
      free && whole.duration > free->min * (1 + kAtEnd) && whole.duration < free->max * (1 - kAtEnd);
  ContinuousOptimum found(CostateShooting(whole, exact.contacts, moving_end));
  const CostateShooting& shooting = found.shooting;
  found.y = shooting.Unknowns(costates.start, costates.after_impact, times, multipliers, hard, whole.duration);
  found.jacobians = FindRoot<kCostateShootingStride>(
      ShootingConditions{&shooting}, shooting.num_unknowns(), &found.y, most_iterations);
  found.residuals.resize(shooting.num_unknowns());
  if (!shooting.Evaluate(found.y.data(), found.residuals.data(), &found.loss, &found.legs)) return std::nullopt;
  found.scale = std::max({costates.largest_position, costates.largest_velocity, 1e-300});
  return found;
}

std::string UnsupportedByHmp(const SolveRequest& request) {
  return NonTerminalFeatures(request.scene).empty() ? UnsupportedByEventPhases(request)
                                                    : UnsupportedByConstrainedHmp(request);
}

SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options) {
  if (!NonTerminalFeatures(request.scene).empty()) return SolveConstrainedByHmp(request, options);
  PhaseRun run("hmp", request, options);
  const Scene& scene = run.scene();
  const ContactSequence sequence = SequenceFor(options, run.guess());
  if (auto refused = run.SequenceFailure(sequence)) return *refused;
  Attempt attempt = SolveFrom(run.guess(), sequence, &run);
  for (int saddles = 0; saddles < kMostSaddles && attempt.termination == Termination::kConverged; ++saddles) {
    if (!attempt.certificate->IsSaddle()) break;
    const std::vector<Trial> aside = SearchBothSides(scene, attempt.trial, attempt.certificate->curvature->direction);
    if (aside.empty()) break;
    Attempt next;
    next.trial = aside.front();
    next.loss = next.trial.exact.loss;
    next.termination = Termination::kNoProgress;
    next.reason = "from there nothing better was found";
    for (const Trial& trial : aside) {
      if (!trial.exact.only_impacts) continue;
      Attempt found = SolveFrom(trial, trial.exact.contacts, &run);
      const bool ended = found.termination != Termination::kFailed && found.trial.exact.ok;
      if (ended && found.trial.exact.loss <= next.trial.exact.loss) next = std::move(found);
    }
    next.reason = DescribeSaddle(next.reason);
    attempt = std::move(next);
  }
  run.report().certificate = std::move(attempt.certificate);
  run.report().continuous = std::move(attempt.continuous);
  return run.Finish(attempt.trial, attempt.loss, attempt.termination, std::move(attempt.reason));
}

}  // namespace saltus
