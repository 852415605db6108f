#include "solve/hmp.h"

#include <algorithm>
#include <cmath>

#include "saltus/control/objective.h"
#include "solve/hmp_constrained.h"
#include "solve/hmp_roots.h"
#include "solve/phases/phase_run.h"

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

// How a solve along one sequence has ended.
struct Attempt {
  Trial trial;
  double loss = 0;  // in continuous time
  Termination termination = Termination::kFailed;
  std::string reason;
  std::optional<Certificate> certificate;
};

Attempt SolveFrom(const Trial& start, const ContactSequence& sequence, PhaseRun* run) {
  const Scene& scene = run->scene();
  const auto fail = [&](Termination termination, const std::string& reason) {
    return Attempt{start, start.exact.loss, termination, reason, std::nullopt};
  };
  const EventPhases phases(scene, sequence);
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, start), sequence);
  PhaseMinimumOptions minimum_options;
  minimum_options.iterations = run->options().iterations;
  minimum_options.callback = [&](double loss) { return run->Record(loss); };
  const PhaseMinimum minimum =
      MinimizeLoss(phases, phases.Variables(guess.times, guess.before, guess.end), minimum_options);
  run->report().evaluations += minimum.jacobians;
  if (minimum.interrupted) return fail(Termination::kInterrupted, "");
  if (!minimum.valid) {
    return fail(Termination::kFailed, "no path along " + ContactSequenceToString(scene, sequence) + " to start from");
  }
  HmpRoot root;
  root.z = minimum.z;
  if (!minimum.touches) {
    root = FindHmpRoot(phases, minimum.z, run->options().iterations);
    run->report().evaluations += root.jacobians;
  }
  Path<double> path;
  if (!(root.valid || minimum.touches) || !phases.Unroll(root.z.data(), &path)) {
    return fail(Termination::kFailed, "Newton's method has left the paths along the sequence");
  }
  PhaseSolution solution;
  solution.sequence = sequence;
  solution.minimum = minimum;
  Attempt attempt;
  attempt.loss = phases.Loss(path);
  run->Record(attempt.loss);
  std::vector<double> times;
  for (const PhaseImpact<double>& impact : path.impacts) times.push_back(impact.time);
  if (!WriteControl(scene, sequence, root.z, times, &attempt.trial)) {
    return fail(Termination::kFailed, "there are too few steps to write the control down");
  }
  solution.trial = attempt.trial;
  attempt.termination = Termination::kNoProgress;
  if (minimum.touches || !IsRealized(scene, attempt.trial.exact, sequence, times)) {
    attempt.reason = WhyNotOptimal(scene, solution);
    return attempt;
  }
  attempt.certificate = CertifyRoot(phases, root, attempt.trial.exact);
  attempt.certificate->curvature =
      CurvatureAt(scene, InitialState(scene), attempt.trial.control, attempt.trial.durations);
  Judge(&*attempt.certificate);
  if (root.residual > kResidualTolerance * root.scale) {
    attempt.reason = "the conditions are not met";
  } else if (std::abs(attempt.loss - minimum.loss) > kSameLoss * std::abs(attempt.loss)) {
    attempt.reason = "the conditions are met at a point that is no minimum";
  } else {
    attempt.termination = Termination::kConverged;
  }
  return attempt;
}

}  // namespace

std::string WhyNotHmp(const SolveRequest& request) {
  return BeyondTerminalCost(request.scene).empty() ? WhyNotEventPhases(request) : WhyNotConstrainedHmp(request);
}

SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options) {
  if (!BeyondTerminalCost(request.scene).empty()) return SolveConstrainedByHmp(request, options);
  PhaseRun run("hmp", request, options);
  const Scene& scene = run.scene();
  const ContactSequence sequence = SequenceFor(options, run.guess());
  if (auto refused = run.WhyNot(sequence)) return *refused;
  Attempt attempt = SolveFrom(run.guess(), sequence, &run);
  for (int saddles = 0; saddles < kMostSaddles && attempt.termination == Termination::kConverged; ++saddles) {
    if (!attempt.certificate->IsSaddle()) break;
    const std::vector<Trial> aside = LeaveSaddle(scene, attempt.trial, *attempt.certificate->curvature);
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
  return run.Finish(attempt.trial, attempt.loss, attempt.termination, std::move(attempt.reason));
}

}  // namespace saltus
