#include "solve/hmp_constrained.h"

#include <ceres/dynamic_autodiff_cost_function.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "optimality/costate_sweep.h"
#include "solve/hmp_roots.h"
#include "solve/phases/ceres_phases.h"
#include "solve/phases/phase_solution.h"

namespace saltus {
namespace {

constexpr double kResidualTolerance = 1e-9;
constexpr double kSameLoss = 1e-3;  // relative, between the grid and continuous time
constexpr double kAtEnd = 1e-6;     // of the bounds of a free final time

struct Conditions {
  const CostateShooting* shooting;
  template <typename T>
  bool operator()(T const* const* y, T* residuals) const {
    return shooting->Evaluate(y[0], residuals);
  }
};

double LargestOf(const double* begin, int count) {
  double largest = 0;
  for (int i = 0; i < count; ++i) largest = std::max(largest, std::abs(begin[i]));
  return largest;
}

Certificate CertifyOptimum(const ContinuousOptimum& optimum, const Certificate& on_grid) {
  const CostateShooting::Sizes& sizes = optimum.shooting.sizes();
  const double* at = optimum.residuals.data();
  Certificate certificate;
  certificate.costate_jump = LargestOf(at, sizes.jumps) / optimum.scale;
  const double* hamiltonian = at + sizes.jumps;
  certificate.hamiltonian = LargestOf(hamiltonian, sizes.hamiltonians) / optimum.scale;
  at = hamiltonian + sizes.hamiltonians + sizes.gaps;
  certificate.transversality = LargestOf(at, sizes.terminal) / optimum.scale;
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

}  // namespace

double ContinuousOptimum::Residual() const {
  return LargestOf(residuals.data(), static_cast<int>(residuals.size())) / scale;
}

std::optional<ContinuousOptimum> FindContinuousOptimum(const Scene& scene, const SolveReport& start,
                                                       int most_iterations) {
  Scene whole = scene;
  if (scene.objective.duration) {
    whole.duration = std::accumulate(start.durations.begin(), start.durations.end(), 0.0);
  }
  const ExactRun exact = SimulateExactly(scene, start.initial_state, start.control, start.durations);
  if (!exact.ok || !exact.only_impacts) return std::nullopt;
  const Certificate certificate = Certify(scene, start.initial_state, start.control, start.durations);
  if (!certificate.IsStationary() && certificate.impacts.size() != exact.contacts.size()) return std::nullopt;
  const Flight flight(whole, start.initial_state, start.control, start.durations, exact);
  CostateSweep::Source source;
  for (const ConstraintCertificate& constraint : certificate.constraints) source.hard.push_back(constraint.multiplier);
  std::vector<double> times, multipliers;
  for (const ImpactCertificate& impact : certificate.impacts) {
    times.push_back(impact.time);
    multipliers.push_back(impact.multiplier);
  }
  const CostateSweep::Result costates =
      CostateSweep(whole, flight).Sweep(source, [&](int k, const ImpactJump&, double) { return multipliers[k]; });

  const std::optional<FreeDuration>& free = scene.objective.duration;
  const bool moving_end =
      free && whole.duration > free->min * (1 + kAtEnd) && whole.duration < free->max * (1 - kAtEnd);
  ContinuousOptimum found(CostateShooting(whole, exact.contacts, moving_end));
  const CostateShooting& shooting = found.shooting;
  found.y = shooting.Unknowns(costates.start, costates.after_impact, times, multipliers, source.hard, whole.duration);
  auto* cost = new ceres::DynamicAutoDiffCostFunction<Conditions, kCostateShootingStride>(new Conditions{&shooting});
  cost->AddParameterBlock(shooting.num_unknowns());
  cost->SetNumResiduals(shooting.num_unknowns());
  const NewtonSummary summary = FindRoot(cost, &found.y, most_iterations);
  found.iterations = summary.iterations;
  found.jacobians = summary.jacobians;
  found.residuals.resize(shooting.num_unknowns());
  if (!shooting.Evaluate(found.y.data(), found.residuals.data(), &found.loss, &found.legs)) return std::nullopt;
  found.scale = std::max({costates.largest_position, costates.largest_velocity, 1e-300});
  return found;
}

std::string WhyNotConstrainedHmp(const SolveRequest& request) {
  if (std::string reason = WhyNotExactPhases(request); !reason.empty()) return reason;
  return CostateShooting::WhyNot(request.scene);
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
  const std::optional<ContinuousOptimum> optimum = FindContinuousOptimum(scene, report, options.iterations);
  const auto give_up = [&](const std::string& reason) {
    if (report.termination == Termination::kConverged) report.termination = Termination::kNoProgress;
    report.reason += (report.reason.empty() ? "" : "; ") + reason;
  };
  if (!optimum) {
    give_up("Newton's method has left the motions along the sequence");
  } else if (optimum->Residual() > kResidualTolerance) {
    give_up("the conditions are not met");
  } else if (std::abs(optimum->loss - report.final_loss) > kSameLoss * std::abs(report.final_loss)) {
    give_up("the conditions are met at a point that is no minimum");
  } else {
    const Certificate on_grid = Certify(scene, report.initial_state, report.control, report.durations);
    report.certificate = CertifyOptimum(*optimum, on_grid);
    report.termination = Termination::kConverged;
    report.final_loss = optimum->loss;
    report.losses.push_back(optimum->loss);
    report.iterations += 1;
    report.evaluations += optimum->jacobians;
  }
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

}  // namespace saltus
