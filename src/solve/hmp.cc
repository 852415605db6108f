#include "hmp.h"

#include <algorithm>
#include <cmath>

#include "hmp_roots.h"
#include "phase_run.h"

namespace saltus {
namespace {

constexpr double kResidualTolerance = 1e-9;
constexpr double kSameLoss = 1e-4;  // relative: Newton's method has stayed with the minimum it started from

double LargestOf(const double* begin, int count) {
  double largest = 0;
  for (int i = 0; i < count; ++i) largest = std::max(largest, std::abs(begin[i]));
  return largest;
}

// The conditions as HmpSystem has them, relative to the costates met.
Certificate CertifyRoot(const EventPhases& phases, const HmpRoot& root, const ExactRun& exact) {
  const HmpSystem system(&phases);
  std::vector<double> y = root.z, r(system.num_residuals());
  y.insert(y.end(), root.multipliers.begin(), root.multipliers.end());
  Path<double> path;
  system.Evaluate(y.data(), &path, r.data());
  const double scale = root.scale;
  Certificate certificate;
  const double* at = r.data();
  certificate.costate_jump = LargestOf(at, system.num_jumps()) / scale;
  at += system.num_jumps();
  const double* hamiltonian = at;  // last impact first
  certificate.hamiltonian = LargestOf(at, system.num_impacts()) / scale;
  at += system.num_impacts() + system.num_gaps();
  certificate.transversality = LargestOf(at, system.num_terminal()) / scale;
  const int n = system.num_impacts();
  for (int k = 0; k < n; ++k) {
    const PhaseImpact<double>& impact = path.impacts[k];
    ImpactCertificate item{.time = impact.time,
                           .a = exact.events[k].a,
                           .b = exact.events[k].b,
                           .speed = -impact.impact.speed,
                           .multiplier = root.multipliers[k],
                           .jump = certificate.costate_jump,
                           .hamiltonian = hamiltonian[n - 1 - k] / scale,
                           .on_node = true,
                           .theta = std::nullopt};
    certificate.impacts.push_back(std::move(item));
  }
  Judge(&certificate);
  JudgeTies(exact.ambiguous, &certificate);
  return certificate;
}

// A piecewise constant control with the same impacts.
bool WriteControl(const Scene& scene, const ContactSequence& sequence, const std::vector<double>& z,
                  const std::vector<double>& times, Trial* trial) {
  std::vector<int> intervals = DistributeIntervals(scene, sequence, times);
  if (intervals.empty()) return false;
  const EventPhases phases(scene, sequence, std::move(intervals));
  Path<double> path;
  if (!phases.Unroll(z.data(), &path)) return false;
  phases.Control(path, &trial->control, &trial->durations);
  trial->exact = SimulateExactly(scene, InitialState(scene), trial->control, trial->durations);
  return true;
}

}  // namespace

SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("hmp", request, options);
  const Scene& scene = run.scene();
  const ContactSequence sequence = SequenceFor(options, run.guess());
  if (auto refused = run.WhyNot(sequence)) return *refused;
  const auto fail = [&](Termination termination, const std::string& reason) {
    return run.Finish(run.guess(), run.guess().exact.loss, termination, reason);
  };

  const EventPhases phases(scene, sequence);
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, run.guess()), sequence);
  PhaseMinimumOptions minimum_options;
  minimum_options.iterations = options.iterations;
  minimum_options.callback = [&](double loss) { return run.Record(loss); };
  const PhaseMinimum minimum =
      MinimizeLoss(phases, phases.Variables(guess.times, guess.before, guess.end), minimum_options);
  if (minimum.interrupted) return fail(Termination::kInterrupted, "");
  if (!minimum.valid) {
    return fail(Termination::kFailed, "no path along " + ContactSequenceToString(scene, sequence) + " to start from");
  }
  const HmpRoot root = FindHmpRoot(phases, minimum.z, options.iterations);
  Path<double> path;
  if (!root.valid || !phases.Unroll(root.z.data(), &path)) {
    return fail(Termination::kFailed, "Newton's method has left the paths along the sequence");
  }
  run.report().evaluations = minimum.jacobians + root.jacobians;
  const double loss = phases.Loss(path);
  run.Record(loss);
  std::vector<double> times;
  for (const PhaseImpact<double>& impact : path.impacts) times.push_back(impact.time);
  Trial trial;
  if (!WriteControl(scene, sequence, root.z, times, &trial)) {
    return fail(Termination::kFailed, "there are too few steps to write the control down");
  }
  if (!IsRealized(scene, trial.exact, sequence, times)) {
    return run.Finish(trial, loss, Termination::kNoProgress, WhyNotRealized(scene, trial.exact, sequence));
  }
  run.report().certificate = CertifyRoot(phases, root, trial.exact);
  if (root.residual > kResidualTolerance * root.scale) {
    return run.Finish(trial, loss, Termination::kNoProgress, "the conditions are not met");
  }
  if (std::abs(loss - minimum.loss) > kSameLoss * std::abs(loss)) {
    return run.Finish(trial, loss, Termination::kNoProgress, "the conditions are met at a point that is no minimum");
  }
  return run.Finish(trial, loss, Termination::kConverged);
}

}  // namespace saltus
