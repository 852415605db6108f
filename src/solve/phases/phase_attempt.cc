#include "solve/phases/phase_attempt.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/time_grid.h"
#include "control/control_bounds.h"

namespace saltus {
namespace {

constexpr int kMostIterations = 400;  // of one solve
constexpr int kSnaps = 60;            // of impacts to nodes, at most
constexpr double kUneven = 2;         // a step so many times the mean one is too long
// Of the contact distance: by so much pairs that must not meet stay apart, and impacts at the same time come early,
// until rounding does not decide any more what the roll-out does.
constexpr double kMargins[] = {0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4};

// Shares `steps` out over phases that end at `ends`, as a grid of equal steps would: none to those that are tied, at
// least one to each other, and if possible two.
std::vector<int> ShareSteps(int steps, const std::vector<double>& ends, const std::vector<bool>& empty) {
  int left = static_cast<int>(std::count(empty.begin(), empty.end(), false));  // phases still to be served
  const int least = steps >= 2 * left ? 2 : 1;
  std::vector<int> share;
  int node = 0;
  for (size_t j = 0; j < ends.size(); ++j) {
    if (empty[j]) {
      share.push_back(0);
      continue;
    }
    --left;
    const int last = steps - least * left;  // leaves enough for those that follow
    const int end = left == 0 ? steps : static_cast<int>(std::floor(steps * (ends[j] / ends.back())));
    share.push_back(std::clamp(end, node + least, last) - node);
    node += share.back();
  }
  return share;
}

void SimulatePlan(const Scene& scene, const std::vector<OwnTerm>& terms, const PhasePlan& plan, PlanAttempt* attempt) {
  Trial& trial = attempt->trial;
  Simulate(scene, terms, &trial);
  std::vector<double> times;
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (plan.cuts[k]) times.push_back(attempt->times[k]);
  }
  attempt->realized = IsRealized(scene, trial.exact, plan.Sequence(), times);
}

// Moves nodes to just before the impacts that are meant to be there: the exact model moves an impact just before a node
// there. False if they are in place.
bool Snap(const PhasePlan& plan, const std::vector<int>& steps, PlanAttempt* attempt) {
  Trial& trial = attempt->trial;
  const double margin = kNodeMargin * *std::min_element(trial.durations.begin(), trial.durations.end());
  std::vector<double> ends;
  size_t event = 0;
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (plan.cuts[k]) attempt->times[k] = trial.exact.events[event++].time;
    ends.push_back(attempt->times[k] - (plan.cuts[k] ? 0.5 * margin : 0.0));
  }
  ends.push_back(DurationOf(trial));
  for (size_t k = plan.cuts.size(); k-- > 0;) {
    if (plan.tied[k]) ends[k] = ends[k + 1];
  }
  bool moved = false;
  std::vector<double> durations;
  double begin = 0, old_end = 0;
  for (size_t j = 0; j < steps.size(); ++j) {
    if (steps[j] == 0) continue;
    for (int k = 0; k < steps[j]; ++k) old_end += trial.durations[durations.size() + k];
    moved = moved || std::abs(ends[j] - old_end) > 0.25 * margin;
    durations.insert(durations.end(), steps[j], (ends[j] - begin) / steps[j]);
    begin = ends[j];
  }
  if (moved) trial.durations = std::move(durations);
  return moved;
}

class TranscribedPlan {
 public:
  TranscribedPlan(PhaseRun* run, const PhasePlan& plan, const PlanStart& start)
      : run_(*run), plan_(plan), scene_(run->scene()), start_(start) {
    if (scene_.objective.duration) scene_.duration = DurationOf(start.trial);
    if (plan.only_violation) AimAtConstraints();
    for (const NoContact& pair : scene_.no_contact) apart_.push_back({pair.a, pair.b, pair.plane});
    apart_.insert(apart_.end(), plan.apart.begin(), plan.apart.end());
    std::vector<double> ends = start.times;
    ends.push_back(scene_.duration);
    empty_ = {false};
    empty_.insert(empty_.end(), plan.tied.begin(), plan.tied.end());
    const auto phases = std::count(empty_.begin(), empty_.end(), false);
    if (phases <= scene_.steps) steps_ = ShareSteps(scene_.steps, ends, empty_);
  }

  PlanAttempt Try(const MayGoOn& may_go_on) {
    PlanAttempt attempt;
    if (steps_.empty()) return attempt;
    for (const double margin : kMargins) {
      const bool tied = plan_.HasTies();
      if (tied && margin == 0) continue;
      Solve(margin, may_go_on, &attempt);
      if (attempt.converged && IsUneven(attempt.times)) {
        steps_ = ShareSteps(scene_.steps, attempt.times, empty_);
        GoOnFrom(attempt);
        Solve(margin, may_go_on, &attempt);
      }
      if (!attempt.converged || (!TouchesApart(attempt) && (!tied || attempt.realized))) break;
      GoOnFrom(attempt);
    }
    return attempt;
  }

 private:
  void GoOnFrom(const PlanAttempt& attempt) {
    start_ = {{attempt.times.begin(), attempt.times.end() - 1}, attempt.trial};
  }

  // Some phase has become so long that its steps are too few.
  bool IsUneven(const std::vector<double>& times) const {
    double begin = 0;
    for (size_t j = 0; j < steps_.size(); ++j) {
      if (times[j] - begin > kUneven * steps_[j] * times.back() / scene_.steps) return true;
      begin = times[j];
    }
    return false;
  }

  void Solve(double margin, const MayGoOn& may_go_on, PlanAttempt* attempt) {
    std::vector<PhaseCut> cuts;
    int ties = 0;  // the earlier of impacts at the same time come earlier
    for (size_t k = plan_.cuts.size(); k-- > 0;) {
      ties = plan_.tied[k] ? ties + 1 : 0;
      cuts.insert(cuts.begin(), {plan_.cuts[k], start_.times[k], ties * margin, plan_.modes[k]});
    }
    PhaseTranscription transcription(
        BeginningAs(start_.trial, scene_), run_.terms(), cuts, steps_, ForcesOf(scene_, start_.trial), apart_, margin);
    const auto read = [&] {
      attempt->times = transcription.CutTimes();
      attempt->times.push_back(transcription.Duration());
      attempt->speeds = transcription.CutSpeeds();
    };
    bool left = false;
    AugmentedLagrangian::Options options;
    options.iterations = kMostIterations;
    options.callback = [&](double cost) {
      if (!run_.Record(cost)) return false;
      read();
      left = !may_go_on(attempt->times, attempt->speeds);
      return !left;
    };
    const AugmentedLagrangian::Summary summary = transcription.Minimize(options);
    read();
    attempt->valid = true;
    attempt->converged = summary.converged;
    attempt->interrupted = summary.interrupted && !left;
    attempt->jacobians += summary.jacobians;
    TakeControl(transcription, scene_, &attempt->trial);
    saltus::RollOut(scene_, run_.terms(), plan_, steps_, attempt);
    attempt->violation = ViolationOf(scene_, attempt->trial);
  }

  // In natural units, a force that matters costs far less than the misses that it mends.
  void AimAtConstraints() {
    constexpr double kEffort = 1e-6;
    Objective only;
    only.effort = kEffort * std::pow(scene_.duration, 3);
    const auto add = [](const auto& terms, auto* out) {
      for (auto term : terms) {
        if (!term.hard) continue;
        term.hard = false;
        term.weight = 1;
        out->push_back(term);
      }
    };
    add(scene_.objective.terminal, &only.terminal);
    add(scene_.objective.via, &only.via);
    only.duration = scene_.objective.duration;
    if (only.duration) only.duration->weight = 0;
    scene_.objective = only;
  }

  bool TouchesApart(const PlanAttempt& attempt) const {
    const ContactSequence &met = attempt.trial.exact.contacts, planned = plan_.Sequence();
    return std::any_of(apart_.begin(), apart_.end(), [&](const Candidate& pair) {
      return std::count(met.begin(), met.end(), pair) > std::count(planned.begin(), planned.end(), pair);
    });
  }

  PhaseRun& run_;
  const PhasePlan& plan_;
  Scene scene_;
  PlanStart start_;
  ContactSequence apart_;
  std::vector<bool> empty_;  // by phase: without steps
  std::vector<int> steps_;   // of each phase; none if there are too few
};

}  // namespace

void TakeControl(const PhaseTranscription& transcription, const Scene& scene, Trial* trial) {
  transcription.Control(&trial->control, &trial->durations);
  if (scene.optimize != Optimize::kControl) trial->initial = transcription.InitialState();
  // A phase that vanished may be a little less than nothing.
  for (double& duration : trial->durations) duration = std::max(duration, 1e-12 * scene.duration);
  if (!scene.objective.duration) {
    const double whole = DurationOf(*trial);
    for (double& duration : trial->durations) duration *= scene.duration / whole;
  }
  MoveWithinBounds(scene, trial->control);  // multipliers leave about 1e-10 beyond
}

void RollOut(const Scene& scene, const std::vector<OwnTerm>& terms, const PhasePlan& plan,
             const std::vector<int>& steps, PlanAttempt* attempt) {
  SimulatePlan(scene, terms, plan, attempt);
  for (int round = 0; round < kSnaps && attempt->realized && Snap(plan, steps, attempt); ++round) {
    SimulatePlan(scene, terms, plan, attempt);
  }
}

PlanAttempt TryByTranscription(PhaseRun* run, const PhasePlan& plan, const PlanStart& start, const MayGoOn& may_go_on) {
  return TranscribedPlan(run, plan, start).Try(may_go_on);
}

}  // namespace saltus
