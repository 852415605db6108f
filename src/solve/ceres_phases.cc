#include "ceres_phases.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "phase_run.h"
#include "phase_transcription.h"
#include "saltus/dynamics/registry.h"
#include "solve_run.h"

namespace saltus {
namespace {

constexpr double kVanished = 1e-3;                    // of the horizon: a phase so short wants to be none
constexpr double kFeasible = 1e-8;                    // largest violation on the exact roll-out
constexpr int kMostIterations = 150;                  // of one attempt: a wrong sequence does not end by itself
constexpr int kSnaps = 2;                             // of impacts to nodes
constexpr int kMostAttempts = 24;                     // sequences
constexpr double kMargins[] = {0, 1e-6, 1e-5, 1e-4};  // of the reach, by which pairs that must not meet stay apart

// Which impacts, in which order; and whether the last one happens at the final time.
struct Plan {
  ContactSequence sequence;
  bool ends_with_impact = false;
  bool operator==(const Plan&) const = default;
};

// A control, and what comes of it.
struct Attempt {
  Plan plan;
  std::vector<double> times;  // of the impacts, s
  AugmentedLagrangian::Summary summary;
  Trial trial;
  bool realized = false;  // the exact roll-out has the plan's impacts and no others
  double violation = 0;   // of constraints, on the exact roll-out

  bool feasible() const { return realized && violation <= kFeasible; }
  double loss() const { return trial.exact.loss; }
};

// Force k of a trial holds at its time.
ForceAt ForcesOf(const Scene& scene, const Trial& trial) {
  std::vector<double> ends(trial.durations.size());
  std::partial_sum(trial.durations.begin(), trial.durations.end(), ends.begin());
  return [&scene, &trial, ends](int c, double t) {
    const size_t last = ends.size() - 1;
    const size_t k = std::min<size_t>(std::upper_bound(ends.begin(), ends.end(), t) - ends.begin(), last);
    const double* u = &trial.control[2 * (k * scene.num_controlled() + c)];
    return Vec2d(u[0], u[1]);
  };
}

// Shares `steps` out over phases that end at `ends`, as a grid of equal steps would, but at least one each.
std::vector<int> ShareSteps(int steps, const std::vector<double>& ends) {
  const int phases = static_cast<int>(ends.size());
  std::vector<int> share;
  int node = 0;
  for (int j = 0; j < phases; ++j) {
    const int last = steps - (phases - 1 - j);  // leaves one for each that follows
    const int end = j + 1 == phases ? steps : static_cast<int>(std::floor(steps * (ends[j] / ends.back())));
    share.push_back(std::clamp(end, node + 1, last) - node);
    node += share.back();
  }
  return share;
}

class PhaseSolver {
 public:
  explicit PhaseSolver(PhaseRun* run) : run_(*run), scene_(run->scene()) {}

  SolveReport Solve() {
    Plan plan{SequenceFor(run_.options(), run_.guess())};
    // From where an attempt starts: a motion that is real, since one that is not has gone astray.
    Start start{GuessFrom(scene_, FlightOf(scene_, run_.guess()), plan.sequence).times, run_.guess()};
    std::optional<Attempt> best, last;
    while (static_cast<int>(tried_.size()) < kMostAttempts && iterations_ < run_.options().iterations) {
      tried_.push_back(plan);
      last = Try(plan, start.times, start.trial);
      if (!last || last->summary.interrupted) break;
      if (last->realized) start = {last->times, last->trial};
      if (last->feasible() && (!best || last->loss() < best->loss())) best = last;
      const std::optional<Plan> next = Mend(*last);
      if (!next) break;
      plan = *next;
      start = StartFor(plan, *last, std::move(start));
    }
    return Report(best, last);
  }

 private:
  struct Start {
    std::vector<double> times;  // of the impacts, s
    Trial trial;
  };

  // One solve along a plan, from the impact times and forces given; nothing if its steps do not suffice.
  std::optional<Attempt> Try(const Plan& plan, const std::vector<double>& times, const Trial& from) {
    std::vector<PhaseCut> cuts;
    for (size_t k = 0; k < times.size(); ++k) cuts.push_back({plan.sequence[k], times[k]});
    for (const ViaTerm& via : scene_.objective.via) cuts.push_back({std::nullopt, via.time});
    std::stable_sort(cuts.begin(), cuts.end(), [](const PhaseCut& a, const PhaseCut& b) { return a.time < b.time; });
    Scene scene = scene_;
    if (scene.objective.duration) scene.duration = Duration(from);
    std::vector<double> ends;
    for (const PhaseCut& cut : cuts) ends.push_back(cut.time);
    if (!plan.ends_with_impact) ends.push_back(scene.duration);
    if (ends.empty() || static_cast<int>(ends.size()) > scene.steps) return std::nullopt;
    std::vector<int> steps = ShareSteps(scene.steps, ends);
    if (plan.ends_with_impact) {
      cuts.back().time = scene.duration;
      steps.push_back(0);
    }
    Attempt attempt;
    for (const double margin : kMargins) {
      PhaseTranscription transcription(scene, cuts, steps, ForcesOf(scene, from));
      for (const NoContact& pair : scene.no_contact) transcription.KeepApart({pair.a, pair.b, pair.plane}, margin);
      AugmentedLagrangian::Options options;
      options.iterations = std::min(kMostIterations, run_.options().iterations - iterations_);
      options.callback = [&](double cost) { return run_.Record(cost); };
      attempt = {plan, {}, transcription.Minimize(options), {}};
      iterations_ += attempt.summary.iterations;
      jacobians_ += attempt.summary.jacobians;
      const std::vector<double> found = transcription.CutTimes();
      for (size_t k = 0; k < cuts.size(); ++k) {
        if (cuts[k].impact) attempt.times.push_back(found[k]);
      }
      transcription.Control(&attempt.trial.control, &attempt.trial.durations);
      RollOut(&attempt, steps);
      if (!TouchesForbidden(attempt) || attempt.summary.interrupted) break;
    }
    return attempt;
  }

  void RollOut(Attempt* attempt, const std::vector<int>& steps) const {
    Trial& trial = attempt->trial;
    // A phase that vanished may be a little less than nothing.
    for (double& duration : trial.durations) duration = std::max(duration, 1e-12 * scene_.duration);
    if (!scene_.objective.duration) {
      const double whole = Duration(trial);
      for (double& duration : trial.durations) duration *= scene_.duration / whole;
    }
    ClampToBounds(&trial.control);
    Simulate(attempt);
    // What gaps and clamping leave moves impacts off the nodes that are meant for them, by far less than a step.
    for (int round = 0; round < kSnaps && attempt->realized && scene_.objective.via.empty(); ++round) {
      const double whole = Duration(trial);
      double begin = 0;
      size_t k = 0;
      for (size_t j = 0; j < steps.size(); ++j) {
        const bool last = j >= trial.exact.events.size();
        const double end = last ? whole : trial.exact.events[j].time;
        std::fill_n(trial.durations.begin() + k, steps[j], (end - begin) / std::max(1, steps[j]));
        if (!last) attempt->times[j] = end;
        k += steps[j];
        begin = end;
      }
      Simulate(attempt);
    }
    attempt->violation = Violation(*attempt);
  }

  void Simulate(Attempt* attempt) const {
    Trial& trial = attempt->trial;
    trial.exact = SimulateExactly(scene_, InitialState(scene_), trial.control, trial.durations);
    attempt->realized = IsRealized(scene_, trial.exact, attempt->plan.sequence, attempt->times);
  }

  static double Duration(const Trial& trial) {
    return std::accumulate(trial.durations.begin(), trial.durations.end(), 0.0);
  }

  // Multipliers leave about 1e-10 beyond a bound.
  void ClampToBounds(std::vector<double>* control) const {
    const Control& bounds = scene_.control;
    for (size_t k = 0; k < control->size() / 2; ++k) {
      const size_t c = k % scene_.num_controlled();
      Eigen::Map<Vec2d> u(&(*control)[2 * k]);
      if (!bounds.max.empty()) u = u.cwiseMax(-bounds.max[c]).cwiseMin(bounds.max[c]);
      if (!bounds.max_norm.empty() && u.norm() > bounds.max_norm[c]) u *= bounds.max_norm[c] / u.norm();
    }
  }

  double Violation(const Attempt& attempt) const {
    if (!attempt.trial.exact.ok || !attempt.trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
    if (!scene_.objective.HasConstraints()) return 0;
    const Flight flight = FlightOf(scene_, attempt.trial);
    double violation = 0;
    const auto miss = [&](const DiscStates& x, const auto& term) {
      const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
      violation = std::max(violation, (q - term.target).norm());
    };
    for (const TerminalTerm& term : scene_.objective.terminal) {
      if (term.hard) miss(flight.end(), term);
    }
    for (const ViaTerm& term : scene_.objective.via) {
      if (term.hard) miss(flight.Before(term.time), term);
    }
    return violation;
  }

  bool TouchesForbidden(const Attempt& attempt) const {
    return std::any_of(scene_.no_contact.begin(), scene_.no_contact.end(), [&](const NoContact& pair) {
      const ContactSequence& met = attempt.trial.exact.contacts;
      return std::find(met.begin(), met.end(), Candidate{pair.a, pair.b, pair.plane}) != met.end();
    });
  }

  bool IsNew(const Plan& plan) const { return std::find(tried_.begin(), tried_.end(), plan) == tried_.end(); }

  // The plan to go on with; none if this one is as good as any near by.
  std::optional<Plan> Mend(const Attempt& attempt) const {
    const Plan& plan = attempt.plan;
    const size_t impacts = attempt.times.size();
    const double end = Duration(attempt.trial);
    const double vanished = kVanished * scene_.duration;
    std::vector<Plan> plans;
    for (size_t k = 0; k + 1 < impacts; ++k) {
      if (attempt.times[k + 1] - attempt.times[k] > vanished || plan.sequence[k] == plan.sequence[k + 1]) continue;
      plans.push_back(plan);
      std::swap(plans.back().sequence[k], plans.back().sequence[k + 1]);
    }
    if (impacts > 0 && !plan.ends_with_impact && end - attempt.times.back() <= vanished) {
      plans.push_back({plan.sequence, true});
      plans.push_back({{plan.sequence.begin(), plan.sequence.end() - 1}, false});
    }
    if (attempt.trial.exact.ok && attempt.trial.exact.only_impacts)
      plans.push_back({attempt.trial.exact.contacts, false});
    const auto next = std::find_if(plans.begin(), plans.end(), [&](const Plan& one) { return IsNew(one); });
    if (next == plans.end()) return std::nullopt;
    return *next;
  }

  // Where an attempt at a mended plan starts, if the one before started or ended at `start`.
  Start StartFor(const Plan& plan, const Attempt& last, Start start) const {
    if (plan.sequence == last.trial.exact.contacts) {
      start = {{}, last.trial};
      for (const Event& event : last.trial.exact.events) start.times.push_back(event.time);
    }
    // Without an impact that is dropped; those in excess go first.
    start.times.resize(plan.sequence.size(), start.times.empty() ? 0.5 * Duration(start.trial) : start.times.back());
    return start;
  }

  SolveReport Report(const std::optional<Attempt>& best, const std::optional<Attempt>& last) {
    const Attempt* result = best ? &*best : last ? &*last : nullptr;
    if (result == nullptr) {
      return run_.Finish(run_.guess(),
                         run_.guess().exact.loss,
                         Termination::kFailed,
                         "there are more phases than steps, " + std::to_string(scene_.steps));
    }
    run_.report().evaluations = jacobians_;
    auto [termination, reason] = Judge(*result, last && last->summary.interrupted);
    return run_.Finish(result->trial, result->loss(), termination, std::move(reason));
  }

  std::pair<Termination, std::string> Judge(const Attempt& result, bool interrupted) const {
    if (interrupted) return {Termination::kInterrupted, ""};
    if (!result.trial.exact.ok) return {Termination::kFailed, result.trial.exact.reason};
    const ContactSequence& sequence = result.plan.sequence;
    if (!result.summary.converged && result.summary.violation > 1e-6) {
      return {Termination::kNoProgress,
              "no motion along " + ContactSequenceToString(scene_, sequence) +
                  " that meets all constraints was found; the least violation is " +
                  std::to_string(result.summary.violation)};
    }
    if (!result.realized) return {Termination::kNoProgress, WhyNotRealized(scene_, result.trial.exact, sequence)};
    if (!result.feasible()) return {Termination::kNoProgress, "constraints are open on the exact roll-out"};
    const std::string passed = tried_.size() > 1 ? Passed() : "";
    if (result.summary.converged) return {Termination::kConverged, passed};
    return {iterations_ >= run_.options().iterations ? Termination::kIterationLimit : Termination::kNoProgress, passed};
  }

  std::string Passed() const {
    std::string text = "sequences passed: ";
    for (size_t i = 0; i < tried_.size(); ++i) {
      text += (i > 0 ? "; " : "") + ContactSequenceToString(scene_, tried_[i].sequence);
      if (tried_[i].ends_with_impact) text += " (the last one at the final time)";
    }
    return text;
  }

  PhaseRun& run_;
  const Scene& scene_;
  std::vector<Plan> tried_;
  int iterations_ = 0, jacobians_ = 0;
};

}  // namespace

std::string WhyNotPhases(const SolveRequest& request) {
  const Scene& scene = request.scene;
  const ModelTraits* model = FindContactModel(request.contact);
  if (model != nullptr && !model->event_driven) return "it solves with exact impacts only (contact model event)";
  if (const std::string reason = WhyNothingToOptimize(scene); !reason.empty()) return reason;
  if (scene.optimize != Optimize::kControl) return "it finds a control, and the scene optimizes something else";
  if (!scene.objective.IsSumOfSquares()) return "least squares needs a sum of squares";
  return "";
}

SolveReport SolveByCeresPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_phases", request, options);
  if (auto refused = run.WhyNotStart()) return *refused;
  return PhaseSolver(&run).Solve();
}

}  // namespace saltus
