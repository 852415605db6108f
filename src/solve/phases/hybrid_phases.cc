#include "solve/phases/hybrid_phases.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <span>
#include <tuple>
#include <utility>

#include "optimality/hybrid_conditions.h"
#include "solve/phases/interior_point.h"
#include "solve/phases/phase_attempt.h"
#include "solve/phases/sequence_update.h"
#include "solve/solve_chain.h"

namespace saltus {
namespace {

constexpr double kMissWeight = 1e3;     // of constraints beside the loss, relative to its scale
constexpr double kNodeMargin = 2e-13;   // of the duration: nodes are by half of it behind the events that belong there
constexpr double kDelay = 1e-7;         // of the duration
constexpr double kLeastOfAsked = 0.01;  // of the change of a state, or of the loss, that costs ask for
constexpr double kMisses = 1e-3;
constexpr double kUnnoticed = 1e-6;   // of the root of the loss: a change of a residual
constexpr double kRounding = 1e-10;   // of a parameter, at least of 1: one that near to a bound is at it
constexpr int kFewestIntervals = 64;  // where no control or cost of intervals gives their number

// The problem with as many intervals as phases need, where their number means nothing, from the piece of the mode in
// which the motion begins.
HybridProblem RefineIntervals(HybridProblem problem) {
  const bool of_intervals = std::any_of(problem.terms.begin(), problem.terms.end(), [](const HybridTerm& term) {
    return term.at == HybridTerm::Timing::kEachInterval;
  });
  HybridInput& guess = problem.guess;
  const int width = problem.system.num_controls();
  if (guess.control.empty()) guess.control.assign(static_cast<size_t>(guess.num_intervals) * width, 0.0);
  if (!problem.free.control && !of_intervals && guess.num_intervals < kFewestIntervals && !IsOnGrid(problem)) {
    const std::vector<double> row(guess.control.begin(), guess.control.begin() + width);
    guess.control.clear();
    for (int k = 0; k < kFewestIntervals; ++k) guess.control.insert(guess.control.end(), row.begin(), row.end());
    guess.num_intervals = kFewestIntervals;
    guess.lengths.clear();
  }
  guess.mode = problem.system.functions().PieceAt(
      {guess.mode, guess.begin, guess.initial.data(), guess.control.data(), guess.parameters.data()});
  return problem;
}

// Returns the integration steps of an interval that motions of this length from the guessed states need.
int StepsFromStates(const HybridProblem& problem) {
  const size_t n = problem.guess.initial.size();
  const auto width = static_cast<std::ptrdiff_t>(problem.system.num_controls());
  HybridInput input = problem.guess;
  input.num_intervals = 1;
  input.duration = problem.guess.duration / problem.guess.num_intervals;
  input.lengths.clear();
  int steps = 1;
  for (size_t row = 0; row < problem.guess_states.size() / n; ++row) {
    const auto state = problem.guess_states.begin() + static_cast<std::ptrdiff_t>(row * n);
    input.initial.assign(state, state + static_cast<std::ptrdiff_t>(n));
    input.control.assign(problem.guess.control.begin(), problem.guess.control.begin() + width);
    HybridSimulator simulator(problem.system, problem.integration);
    if (simulator.Rollout(input)) steps = std::max(steps, simulator.steps_per_interval());
  }
  return steps;
}

// Moves the end of an interval that is nearest to a time by a part of an interval, later if the part is positive.
void MoveEndNear(double time, double part, std::vector<double>* durations) {
  std::vector<double>& lengths = *durations;
  double end = lengths[0];
  size_t k = 0;
  for (; k + 2 < lengths.size() && end + 0.5 * lengths[k + 1] < time; ++k) end += lengths[k + 1];
  if (k + 1 >= lengths.size()) return;
  const double by = part * std::min(lengths[k], lengths[k + 1]);
  lengths[k] += by;
  lengths[k + 1] -= by;
}

// Moves times, which rise, with the ends of the intervals in which they are.
void MoveTimes(const std::vector<double>& from, const std::vector<double>& to, std::vector<double>* times) {
  double begin = 0, begin_to = 0;
  size_t k = 0;
  for (double& time : *times) {
    for (; k + 1 < from.size() && begin + from[k] < time; ++k) {
      begin += from[k];
      begin_to += to[k];
    }
    time = begin_to + (time - begin) * to[k] / from[k];
  }
}

// Puts the ends of intervals, as instants, between the events of a plan, which are at these times.
void AddGrid(const std::vector<double>& durations, PlanOf<ModeEvent>* plan, std::vector<double>* times) {
  plan->on_grid = true;
  const auto events = std::exchange(plan->cuts, {});
  const std::vector<double> event_times = std::exchange(*times, {});
  size_t event = 0;
  double end = 0;
  for (const double& length : durations) {
    end += length;
    const bool is_last = &length == &durations.back();
    bool jumps = false;  // to another mode, as the control does at the end of the interval
    const auto is_before_end = [&] {
      const double rounding = events[event]->is_switch() ? 1e-9 * length : 0;
      return is_last || event_times[event] <= end + rounding;
    };
    for (; event < events.size() && !jumps && is_before_end(); ++event) {
      jumps = events[event]->is_switch();
      plan->cuts.push_back(events[event]);
      times->push_back(jumps ? end : event_times[event]);
    }
    if (is_last) break;
    if (jumps) continue;
    plan->cuts.emplace_back(std::nullopt);
    times->push_back(end);
  }
  plan->tied.assign(plan->cuts.size(), false);
  plan->regimes.resize(plan->cuts.size());
}

}  // namespace

// The transcriptions of one plan, and the motions of what they find.
class HybridPhaseRun::Transcriber {
 public:
  Transcriber(const HybridPhaseRun& run, const PlanOf<ModeEvent>& plan, const PlanStartOf<HybridMotion>& start)
      : run_(run), plan_(plan), duration_(DurationOf(start.trial)) {}

  double duration() const { return duration_; }
  const std::vector<ModeEvent>& apart() const { return plan_.apart; }

  // If the first event of a motion that the plan lacks is of a guard that is at zero along the plan, holds all guards
  // that are: they stay above zero, by the margins of solves, from the next one on; where one does not, also within the
  // step. Otherwise returns false.
  bool HoldBorders(HybridTranscription* transcription, const HybridMotion& motion) {
    const std::vector<ModeEvent>&met = motion.exact.contacts, planned = plan_.Sequence();
    const auto first = std::ranges::mismatch(met, planned).in1;
    if (first == met.end()) return false;
    const auto find = [](std::vector<HeldGuard>& in, const auto& guard) {
      return std::ranges::find_if(
          in, [&](const HeldGuard& one) { return one.mode == guard.mode && one.guard == guard.guard; });
    };
    if (const auto held = find(held_, *first); held != held_.end()) {
      held->times.push_back(motion.exact.events[first - met.begin()].time);
      return true;
    }
    std::vector<HeldGuard> at_zero = transcription->GuardsAtZero();
    if (find(at_zero, *first) == at_zero.end()) return false;
    for (const HeldGuard& guard : at_zero) {
      if (find(held_, guard) == held_.end()) held_.push_back(guard);
    }
    return true;
  }
  // Names the guards that are held.
  std::string borders() const {
    std::string names;
    for (const HeldGuard& one : held_) {
      names += (names.empty() ? "" : ", ") + run_.NameOf(ModeEvent{one.mode, one.guard});
    }
    return names;
  }

  std::unique_ptr<HybridTranscription> Make(const PlanStartOf<HybridMotion>& start, const std::vector<double>& overlaps,
                                            const std::vector<int>& steps, double margin) const {
    HybridTranscription::Start from{
        start.trial.initial, start.trial.parameters, start.times, ControlOf(start.trial, run_.control_width())};
    from.states = start.trial.guess_states;
    from.times.push_back(run_.problem_.free.duration ? DurationOf(start.trial) : run_.problem_.guess.duration);
    auto transcription = std::make_unique<HybridTranscription>(run_.problem_,
                                                               run_.scales_,
                                                               plan_,
                                                               from,
                                                               overlaps,
                                                               steps,
                                                               run_.shooting_->simulator().steps_per_interval(),
                                                               margin,
                                                               held_);
    return transcription->valid() ? std::move(transcription) : nullptr;
  }

  void TakeControl(const HybridTranscription& transcription, HybridMotion* motion) const {
    transcription.Control(&motion->control, &motion->durations);
    motion->initial = transcription.InitialState();
    motion->parameters = transcription.Parameters();
    // A phase that vanished may be a little less than nothing.
    const double whole = transcription.Duration();
    for (double& duration : motion->durations) duration = std::max(duration, 1e-12 * whole);
    const double stretch = whole / DurationOf(*motion);
    for (double& duration : motion->durations) duration *= stretch;
    run_.MoveWithin(motion);  // multipliers leave about 1e-10 beyond
    DelayNodes(transcription, motion);
  }

  void Simulate(HybridMotion* motion) const { run_.Simulate(motion); }
  double ViolationOf(const HybridMotion& motion) const { return run_.ViolationOf(motion); }
  // The control of a phase acts until its event has happened; where the next mode depends on the control, but the guard
  // does not, that of the next phase acts.
  double NodeMargin(const HybridMotion& motion) const { return -kNodeMargin * DurationOf(motion); }
  int SideOf(const ModeEvent& event) const {
    const HybridFunctions& functions = run_.problem_.system.functions();
    if (event.is_switch()) return 0;
    return functions.CreatesModes() && !functions.ReadsControl(event.mode, event.guard) ? -1 : 1;
  }
  bool IsRealized(const HybridMotion& motion, const std::vector<ModeEvent>& sequence,
                  const std::vector<double>& times) const {
    return HasEvents(motion.exact, sequence, times, DurationOf(motion));
  }

 private:
  // Moves nodes to the sides of the events where they belong, for systems whose modes depend on the control.
  void DelayNodes(const HybridTranscription& transcription, HybridMotion* motion) const {
    const std::vector<double> times = transcription.CutTimes();
    if (!run_.problem_.system.functions().CreatesModes() || plan_.on_grid) return;
    for (size_t j = 0; j < times.size(); ++j) {
      const ModeEvent& event = *plan_.cuts[j];
      const double delay = SideOf(event) * kDelay * DurationOf(*motion);
      double end = 0;
      size_t k = 0;
      while (k + 1 < motion->durations.size() && end + 0.5 * motion->durations[k] < times[j]) {
        end += motion->durations[k++];
      }
      if (k == 0 || !(std::min(motion->durations[k - 1], motion->durations[k]) > 2 * std::abs(delay))) continue;
      motion->durations[k - 1] += delay;
      motion->durations[k] -= delay;
    }
  }

  const HybridPhaseRun& run_;
  const PlanOf<ModeEvent>& plan_;
  double duration_;
  std::vector<HeldGuard> held_;
};

HybridMotion MotionOf(const HybridInput& input) {
  HybridMotion motion{input.control, {}, input.initial, input.parameters, {}};
  const std::vector<double> times = input.Times();
  for (int k = 0; k < input.num_intervals; ++k) motion.durations.push_back(times[k + 1] - times[k]);
  return motion;
}

HybridPhaseRun::HybridPhaseRun(std::string_view solver, const HybridProblem& problem, const SolverOptions& options,
                               std::optional<HybridMotion> start, std::optional<std::vector<ModeEvent>> sequence)
    : SequenceRun(solver, options),
      problem_(RefineIntervals(problem)),
      shooting_(std::make_unique<HybridShooting>(problem_)),
      sequence_(std::move(sequence)) {
  guess_ = MotionOf(problem_.guess);
  MoveWithin(&guess_);
  Simulate(&guess_);
  BeginWhereMotionGoes();
  guess_.guess_states = problem_.guess_states;
  if (!guess_.exact.ok && !guess_.guess_states.empty() && problem_.integration.steps_per_interval <= 0) {
    problem_.integration.steps_per_interval = StepsFromStates(problem_);
    shooting_ = std::make_unique<HybridShooting>(problem_);
  }
  FindScales();
  if (start) {
    guess_ = std::move(*start);
    Simulate(&guess_);
    BeginWhereMotionGoes();
  }
  if (Starts()) Record(guess_.exact.loss);  // infinite without a motion
}

std::optional<SolveReport> HybridPhaseRun::StartFailure() {
  if (sequence_ && !IsPossible(*sequence_)) {
    return Refuse(Termination::kNotApplicable,
                  "the sequence " + NameOf(*sequence_) +
                      " does not lead from the mode at the start to one in which the terms at the end apply, or lacks "
                      "an event of a term");
  }
  if (!Starts()) return Refuse(Termination::kFailed, guess_.exact.reason);
  if (!guess_.exact.ok || guess_.exact.only_impacts) return std::nullopt;
  const bool all_costs = std::ranges::all_of(problem_.terms, &HybridTerm::IsCost);
  return Refuse(Termination::kNotApplicable,
                "from the initial guess a guard grazes zero, or a transition happens at once; phases support events at "
                "distinct times only: start from a guess beside it" +
                    std::string(all_costs ? ", or use ceres_lm" : ""));
}

// A motion that begins at the zero of a switch goes on in a piece of the mode that its flow decides.
void HybridPhaseRun::BeginWhereMotionGoes() {
  const HybridSimulator& simulator = shooting_->simulator();
  if (!guess_.exact.moves || simulator.num_steps() == 0) return;
  const HybridFunctions& functions = problem_.system.functions();
  const int mode = simulator.StepMode(0);
  if (functions.num_switches(mode) > 0 && functions.BaseMode(mode) == functions.BaseMode(problem_.guess.mode)) {
    problem_.guess.mode = mode;
  }
}

// Finds the scales of the last motion.
void HybridPhaseRun::FindScales() {
  const HybridSystem& system = problem_.system;
  const HybridSimulator& simulator = shooting_->simulator();
  for (int mode = 0; mode < system.num_modes() && !system.functions().CreatesModes(); ++mode) {
    scales_.state.emplace_back(system.state_size(mode), 0.0);
    scales_.guard.emplace_back(system.num_guards(mode), 0.0);
  }
  const std::vector<double> zeros(system.num_controls());
  std::vector<double> u(zeros.size());
  const auto control = ControlOf(guess_, system.num_controls());
  const double* p = problem_.guess.parameters.data();
  std::vector<double> slope;
  const auto add = [&](int mode, double t, std::span<const double> x) {
    slope.resize(x.size());
    system.functions().Flow({mode, t, x.data(), zeros.data(), p}, slope.data());
    for (size_t i = 0; i < u.size(); ++i) u[i] = control(static_cast<int>(i), t);
    scales_.Add(system.functions(), {mode, t, x.data(), u.data(), p}, slope.data(), problem_.guess.duration);
  };
  for (int step = 0; guess_.exact.moves && step < simulator.num_steps(); ++step) {
    add(simulator.StepMode(step), simulator.StepTime(step), simulator.StepState(step));
  }
  const size_t n = problem_.guess.initial.size(), rows = guess_.guess_states.size() / n;
  for (size_t row = 0; row < rows; ++row) {
    const double t = problem_.guess.duration * static_cast<double>(row) / static_cast<double>(rows - 1);
    add(problem_.guess.mode, t, std::span(guess_.guess_states).subspan(row * n, n));
  }
  // Where contacts stick, changes are not in proportion to the control.
  const bool is_proportional = guess_.exact.ok && !system.functions().CreatesModes();
  const auto sizes = is_proportional ? SizesOf(problem_, InputOf(guess_)) : std::nullopt;
  for (size_t mode = 0; sizes && mode < scales_.state.size(); ++mode) {
    for (size_t i = 0; i < scales_.state[mode].size(); ++i) {
      double& scale = scales_.state[mode][i];
      const double asked = sizes->asked_state[mode][static_cast<Eigen::Index>(i)];
      scale = scale > 0 ? std::max(scale, kLeastOfAsked * asked) : asked;
    }
  }
  if (is_proportional) RaiseUnnoticedSizes();
  scales_.Finish();
  if (guess_.exact.ok && guess_.exact.loss != 0) scales_.loss = std::abs(guess_.exact.loss);
  // The loss of a guess that misses constraints tells little of that of motions that meet them.
  if (sizes && guess_.exact.violation > kMisses) {
    scales_.loss = std::max(scales_.loss, kLeastOfAsked * sizes->asked_loss);
  }
}

// Raises the sizes of states that move to changes that no cost notices. Smaller sizes, as of the far end of a chain
// that a wave has not reached, would ask for an accuracy of these states that means nothing, and that linear solvers do
// not have.
void HybridPhaseRun::RaiseUnnoticedSizes() {
  HybridShooting::Outcome outcome;
  std::vector<HybridShooting::TermAt> terms;
  if (!shooting_->Simulate(InputOf(guess_), &outcome) || !shooting_->EvaluateTerms(&terms)) return;
  const HybridSimulator& simulator = shooting_->simulator();
  std::vector<std::vector<double>> slopes;  // of costs, the largest by each state
  for (const std::vector<double>& sizes : scales_.state) slopes.emplace_back(sizes.size());
  for (const HybridShooting::TermAt& at : terms) {
    if (at.term->role != HybridTerm::Role::kCost || !at.term->with_state || at.event >= 0) continue;
    std::vector<double>& largest = slopes[at.interval < 0 ? simulator.final_mode() : simulator.ModeAt(at.interval)];
    for (std::size_t i = 0; i < at.jacobians[0].size(); ++i) {
      double& slope = largest[i % largest.size()];
      slope = std::max(slope, std::abs(at.jacobians[0][i]));
    }
  }
  const double unnoticed = kUnnoticed * std::sqrt(std::abs(guess_.exact.loss));
  for (std::size_t mode = 0; mode < slopes.size(); ++mode) {
    for (std::size_t i = 0; i < slopes[mode].size(); ++i) {
      double& size = scales_.state[mode][i];
      if (size > 0 && slopes[mode][i] > 0) size = std::max(size, unnoticed / slopes[mode][i]);
    }
  }
}

HybridInput HybridPhaseRun::InputOf(const HybridMotion& motion) const {
  return {.mode = problem_.guess.mode,
          .initial = motion.initial,
          .parameters = motion.parameters,
          .duration = problem_.free.duration ? DurationOf(motion) : problem_.guess.duration,
          .num_intervals = static_cast<int>(motion.durations.size()),
          .control = motion.control,
          .lengths = motion.durations};
}

void HybridPhaseRun::Simulate(HybridMotion* motion) const {
  motion->exact = {};
  HybridMotion::Exact& exact = motion->exact;
  HybridShooting::Outcome outcome;
  exact.ok = shooting_->Simulate(InputOf(*motion), &outcome);
  const HybridSimulator& simulator = shooting_->simulator();
  exact.moves = exact.ok || shooting_->HasMotion();
  // Where the control jumps just behind an event, its mode is that under the new control.
  std::vector<HybridEvent> events = simulator.events();
  events.insert(events.end(), simulator.switches().begin(), simulator.switches().end());
  std::stable_sort(events.begin(), events.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  for (HybridEvent& event : events) {
    event.before = event.after = {};
    if (event.immediate) exact.only_impacts = false;
    std::vector<HybridEvent>& all = exact.events;
    const bool joins = event.guard < 0 && !all.empty() && all.back().guard >= 0 &&
                       event.time - all.back().time <= kNodeMargin * DurationOf(*motion);
    if (joins) {
      all.back().next_mode = event.next_mode;
    } else {
      all.push_back(event);
    }
  }
  for (const HybridEvent& event : exact.events) exact.contacts.push_back({event.mode, event.guard, event.next_mode});
  if (!simulator.grazings().empty()) exact.only_impacts = false;
  if (exact.ok && simulator.accumulation()) {
    exact.ok = false;
    exact.reason = "events accumulate (Zeno behaviour), and every event ends a phase";
    return;
  }
  if (!exact.ok) {
    exact.reason = shooting_->FailureReason();
    return;
  }
  exact.loss = outcome.loss;
  exact.violation = outcome.violation;
  exact.worst = outcome.worst;
}

double HybridPhaseRun::ViolationOf(const HybridMotion& motion) const {
  return motion.exact.ok && motion.exact.only_impacts ? motion.exact.violation : INFINITY;
}

double HybridPhaseRun::MeritOf(const HybridMotion& motion) const {
  const double violation = ViolationOf(motion);
  return motion.exact.loss + (violation > 0 ? kMissWeight * scales_.loss * violation * violation : 0.0);
}

void HybridPhaseRun::MoveWithin(HybridMotion* motion) const {
  const HybridFree& free = problem_.free;
  for (const FreeVariable& variable :
       FreeVariables(free, control_width(), static_cast<int>(motion->durations.size()))) {
    if (variable.kind == FreeVariable::Kind::kDuration) continue;
    double& value = variable.Access(*motion);
    value = std::min(std::max(value, variable.min), variable.max);
    if (variable.kind != FreeVariable::Kind::kParameter) continue;
    for (const double bound : {variable.min, variable.max}) {
      if (std::abs(value - bound) <= kRounding * std::max(1.0, std::abs(value))) value = bound;
    }
  }
  if (!free.duration) return;
  const double duration = DurationOf(*motion), within = std::clamp(duration, free.duration_min, free.duration_max);
  if (within == duration) return;
  for (double& length : motion->durations) length *= within / duration;
}

HybridMotion HybridPhaseRun::ClampToBounds(HybridMotion motion) const {
  const HybridMotion before = motion;
  MoveWithin(&motion);
  const bool same = motion.control == before.control && motion.initial == before.initial &&
                    motion.parameters == before.parameters && motion.durations == before.durations;
  if (!same) Simulate(&motion);
  return motion;
}

void HybridPhaseRun::BlendStart(const HybridMotion& to, const HybridMotion& from, double part,
                                HybridMotion* between) const {
  between->guess_states.clear();
  for (size_t i = 0; i < to.initial.size(); ++i) {
    between->initial[i] = part * to.initial[i] + (1 - part) * from.initial[i];
  }
  for (size_t i = 0; i < to.parameters.size(); ++i) {
    between->parameters[i] = part * to.parameters[i] + (1 - part) * from.parameters[i];
  }
}

bool HybridPhaseRun::IsPossible(const std::vector<ModeEvent>& sequence) const {
  int mode = problem_.guess.mode;
  for (const ModeEvent& event : sequence) {
    if (event.mode != mode) return false;
    mode = event.next_mode;
  }
  return std::all_of(problem_.terms.begin(), problem_.terms.end(), [&](const HybridTerm& term) {
    const auto counts = [&](const ModeEvent& event) {
      return term.CountsAt(problem_.system.functions(), event.mode, event.guard);
    };
    if (term.at == HybridTerm::Timing::kEvent) return std::ranges::count_if(sequence, counts) > term.occurrence;
    if (term.at != HybridTerm::Timing::kEnd) return true;
    const bool fits = !term.with_state || term.function->parameter_block_sizes()[0] == problem_.system.state_size(mode);
    return fits && (term.mode < 0 || term.mode == problem_.system.functions().BaseMode(mode));
  });
}

void HybridPhaseRun::PlanAlong(const std::vector<ModeEvent>& sequence, const HybridMotion& motion,
                               PlanOf<ModeEvent>* plan, std::vector<double>* times) const {
  const std::vector<int> found = LongestCommon(sequence, motion.exact.contacts);
  const double duration = DurationOf(motion);
  const size_t count = sequence.size();
  times->resize(count);
  for (size_t k = 0; k < count; ++k) plan->cuts.emplace_back(sequence[k]);
  for (size_t k = 0; k < count;) {
    if (found[k] >= 0) {
      (*times)[k] = motion.exact.events[found[k]].time;
      ++k;
      continue;
    }
    size_t end = k;  // of a run of new events, which share the time between their neighbours
    while (end < count && found[end] < 0) ++end;
    const double from = k > 0 ? (*times)[k - 1] : 0.0;
    const double to = end < count ? motion.exact.events[found[end]].time : duration;
    for (size_t i = k; i < end; ++i) (*times)[i] = from + (to - from) * (i - k + 0.5) / (end - k);
    k = end;
  }
  const bool always = std::ranges::any_of(problem_.terms, &HybridTerm::always);
  const bool too_few_intervals = static_cast<int>(count) >= num_steps() && !always;
  const bool is_given = IsOnGrid(problem_) || (count == 0 && !problem_.guess.lengths.empty());
  if (is_given || too_few_intervals) AddGrid(motion.durations, plan, times);
}

std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> HybridPhaseRun::PlansWithJumpsOnGrid(
    const PlanOf<ModeEvent>& plan, const HybridMotion& motion) const {
  const bool jumps = std::ranges::any_of(plan.cuts, [](const auto& cut) { return cut && cut->is_switch(); });
  if (!jumps || plan.on_grid || std::ranges::any_of(problem_.terms, &HybridTerm::always)) return {};
  std::pair<PlanOf<ModeEvent>, std::vector<double>> on_grid;
  PlanAlong(plan.Sequence(), motion, &on_grid.first, &on_grid.second);
  if (!on_grid.first.on_grid) AddGrid(motion.durations, &on_grid.first, &on_grid.second);
  return {on_grid};
}

std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> HybridPhaseRun::PlansThroughTouches(
    const HybridMotion& motion) const {
  constexpr double kTouch = 1e-6;      // of the size of a guard
  constexpr double kHere = 1e-6;       // of the duration: from an event
  constexpr double kBeforeEnd = 0.01;  // of the duration: the last phase begins with this length
  std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> plans;
  HybridShooting::Outcome outcome;
  if (!motion.exact.only_impacts || !shooting_->Simulate(InputOf(motion), &outcome)) return plans;
  HybridSimulator& simulator = shooting_->simulator();
  const HybridFunctions& functions = problem_.system.functions();
  const auto control = ControlOf(motion, control_width());
  std::vector<double> u(control_width()), slope(functions.most_states()), after(slope.size());
  std::vector<std::pair<int, int>> known;
  const double duration = DurationOf(motion);
  for (int i = 1; i <= simulator.num_steps() && !functions.CreatesModes(); ++i) {
    const bool ends = i == simulator.num_steps();
    if (simulator.IsReset(i - 1) || (!ends && simulator.IsReset(i))) continue;
    const int mode = ends ? simulator.final_mode() : simulator.StepMode(i);
    const double t = ends ? duration : simulator.StepTime(i);
    const auto is_here = [&](const HybridEvent& event) { return std::abs(event.time - t) <= kHere * duration; };
    if (std::ranges::any_of(motion.exact.events, is_here)) continue;
    for (int c = 0; c < control_width(); ++c) u[c] = control(c, t);
    const double* x = ends ? simulator.final_state().data() : simulator.StepState(i).data();
    const ModePoint at{mode, t, x, u.data(), motion.parameters.data()};
    functions.Flow(at, slope.data());
    // Pieces of modes that are new here have no sizes yet.
    const int known_guards = mode < std::ssize(scales_.guard) ? static_cast<int>(scales_.guard[mode].size()) : 0;
    for (int guard = 0; guard < known_guards; ++guard) {
      double rate = 0;
      const double zero = kTouch * scales_.guard[mode][guard];
      const double value = functions.GuardRate(at, guard, slope.data(), &rate);
      if (std::abs(value) > zero || functions.IsSwitch(mode, guard)) continue;
      if (std::ranges::count(known, std::pair(mode, guard)) > 0) continue;
      const int next = functions.Reset(at, guard, after.data());
      if (next < 0) continue;
      known.emplace_back(mode, guard);
      std::vector<ModeEvent> sequence = motion.exact.contacts;
      const auto place = std::ranges::upper_bound(motion.exact.events, t, {}, &HybridEvent::time);
      const auto k = place - motion.exact.events.begin();
      sequence.insert(sequence.begin() + k, {mode, guard, next});
      auto& [plan, times] = plans.emplace_back();
      PlanAlong(sequence, motion, &plan, &times);
      if (!plan.on_grid) times[k] = std::min(t, (1 - kBeforeEnd) * duration);
      plan.tied.assign(plan.cuts.size(), false);
      plan.regimes.resize(plan.cuts.size());
    }
  }
  return plans;
}

std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> HybridPhaseRun::PlansOnGrid(const HybridMotion& motion) {
  constexpr double kPart = 1e-3;  // of an interval, by which an event begins beside its end
  const std::vector<ImpactCertificate>& impacts = Certify(motion).impacts;
  std::vector<std::pair<PlanOf<ModeEvent>, std::vector<double>>> plans;
  if (std::ranges::none_of(impacts, &ImpactCertificate::LeavesNode)) return plans;
  for (const double part : {kPart, -kPart}) {
    HybridMotion moved = motion;  // whose events are those beside the ends of intervals
    for (const ImpactCertificate& impact : impacts) {
      if (impact.LeavesNode()) MoveEndNear(impact.time, part, &moved.durations);
    }
    Simulate(&moved);
    if (!moved.exact.ok || !moved.exact.only_impacts) continue;
    auto& [plan, times] = plans.emplace_back();
    for (const HybridEvent& event : moved.exact.events) times.push_back(event.time);
    plan.cuts.assign(moved.exact.contacts.begin(), moved.exact.contacts.end());
    AddGrid(moved.durations, &plan, &times);
    MoveTimes(moved.durations, motion.durations, &times);
  }
  return plans;
}

std::string HybridPhaseRun::ReasonNoDerivative(const HybridMotion& motion) const {
  HybridShooting::Outcome outcome;
  if (!motion.exact.ok || !shooting_->Simulate(InputOf(motion), &outcome)) return "";
  std::vector<HybridShooting::TermAt> terms;
  if (!shooting_->EvaluateTerms(&terms)) return shooting_->FailureReason();
  HybridSimulator& simulator = shooting_->simulator();
  simulator.Adjoint(std::vector<double>(simulator.final_state().size(), 1.0));
  return simulator.ReasonNotFinite();
}

std::string HybridPhaseRun::NameOf(const ModeEvent& event) const {
  const HybridSystem& system = problem_.system;
  return system.ModeName(event.mode) + "/" +
         (event.is_switch() ? "control jump" : system.GuardName(event.mode, event.guard));
}

std::string HybridPhaseRun::NameOf(const std::vector<ModeEvent>& sequence) const {
  if (sequence.empty()) return "none";
  constexpr size_t kMostNamed = 20;
  std::string text = NameOf(sequence[0]);
  for (size_t i = 1; i < std::min(sequence.size(), kMostNamed); ++i) text += "," + NameOf(sequence[i]);
  return sequence.size() <= kMostNamed ? text : text + ",... (" + std::to_string(sequence.size()) + " events)";
}

std::string HybridPhaseRun::NameOf(const PlanOf<ModeEvent>& plan) const {
  std::string text = NameOf(plan.Sequence());
  if (plan.HasTies()) text += plan.tied.back() ? " (at the final time)" : " (some at the same time)";
  for (const ModeEvent& event : plan.apart) text += ", without another " + NameOf(event);
  if (plan.on_grid) text += " (with the intervals as they are)";
  return text;
}

std::string HybridPhaseRun::NamesOf(const std::vector<PlanOf<ModeEvent>>& plans) const {
  std::string text;
  for (const PlanOf<ModeEvent>& plan : plans) text += (text.empty() ? "" : "; ") + NameOf(plan);
  return text;
}

std::string HybridPhaseRun::KinksOf(const PlanOf<ModeEvent>& plan) const {
  std::string text;
  const auto add = [&](const std::string& what) { text += (text.empty() ? "" : ", ") + what; };
  for (const ModeEvent& event : plan.apart) add("the guard of " + NameOf(event) + " just reaches zero");
  if (plan.HasTies()) add(plan.tied.back() ? "an event is at the final time" : "events are at the same time");
  return text;
}

std::string HybridPhaseRun::DescribeMiss(const HybridMotion& motion) const {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", motion.exact.violation);
  return std::string(text) + ", of " + motion.exact.worst;
}

std::string HybridPhaseRun::ReasonNotRealized(const HybridMotion& motion,
                                              const std::vector<ModeEvent>& sequence) const {
  if (!motion.exact.ok) return motion.exact.reason;
  if (!motion.exact.only_impacts) {
    return "in simulation of the solution a guard grazes zero or has a transition at once";
  }
  const std::string planned = NameOf(sequence), met = NameOf(motion.exact.contacts);
  if (sequence == motion.exact.contacts) {
    return "in simulation the events " + planned + " are at other times than in the solution";
  }
  return "the optimum for the sequence " + planned + " is not a motion of the system: in simulation its events are " +
         met;
}

const Certificate& HybridPhaseRun::Certify(const HybridMotion& motion) {
  const auto variables = [](const HybridMotion& of) {
    return std::tie(of.control, of.durations, of.initial, of.parameters);
  };
  if (!certified_ || variables(certified_->motion) != variables(motion)) {
    certified_ = {motion, saltus::Certify(problem_, InputOf(motion))};
  }
  return certified_->certificate;
}

size_t HybridPhaseRun::DirectionSize(const HybridMotion& motion) const {
  const HybridFree& free = problem_.free;
  return motion.control.size() + free.initial.size() + free.parameters.size() + (free.duration ? 1 : 0);
}

std::vector<HybridMotion> HybridPhaseRun::SearchBothSides(const HybridMotion& motion,
                                                          const std::vector<double>& direction) const {
  double size = 1;
  for (const double u : motion.control) size = std::max(size, std::abs(u));
  const auto move = [&](double length, HybridMotion* moved) {
    auto next = direction.begin();
    for (double& u : moved->control) u += (problem_.free.control ? length : 0.0) * *next++;
    for (const int i : problem_.free.initial) moved->initial[i] += length * *next++;
    for (const int i : problem_.free.parameters) moved->parameters[i] += length * *next++;
    if (problem_.free.duration) {
      const double whole = DurationOf(motion), stretch = std::max(0.1, 1 + length * *next / whole);
      for (double& duration : moved->durations) duration *= stretch;
    }
    MoveWithin(moved);
    Simulate(moved);
  };
  // Along a bound that is curved, short steps lower the loss by more than they violate it.
  return StepsToBothSides(motion, size, move, [this](const HybridMotion& of) { return MeritOf(of); });
}

SolveReport HybridPhaseRun::Finish(const HybridMotion& motion, double loss, Termination termination,
                                   std::string reason) {
  constexpr double kSameLength = 1e-6;  // of an interval
  const std::vector<double>& given = problem_.guess.lengths;
  const bool keeps_lengths =
      given.empty() || std::ranges::equal(given, motion.durations, [](double length, double other) {
        return std::abs(length - other) <= kSameLength * length;
      });
  if (!keeps_lengths && !problem_.free.duration) {
    reason += std::string(reason.empty() ? "" : "; ") +
              "the control intervals of the solution end at its events, and are not those of the guess";
  }
  FinishReport(loss, termination, std::move(reason));
  report_.guess.violation = ViolationOf(guess_);
  report_.solution.violation = ViolationOf(motion);
  report_.solution.initial_state = motion.initial;
  report_.solution.control = motion.control;
  report_.solution.durations = motion.durations;
  report_.solution.parameters = motion.parameters;
  HybridShooting::Outcome outcome;
  if (shooting_->Simulate(InputOf(motion), &outcome)) {
    report_.solution.integration_error = shooting_->simulator().IntegrationError();
  }
  return std::move(report_);
}

std::string UnsupportedByHybridPhases(const HybridProblem& problem) {
  if (problem.free.IsEmpty()) return "the problem leaves nothing to optimize: name what is free";
  const auto always = std::ranges::find_if(problem.terms, &HybridTerm::always);
  if (always == problem.terms.end() || !IsOnGrid(problem)) return "";
  return always->name +
         " holds always, for which intervals end at events, and the control or a term is given on intervals "
         "that do not: make its time an event, by a guard t1 - t";
}

SolveReport UpdateHybridSequence(HybridPhaseRun* run) {
  return SolveWithSequenceUpdates<HybridPhaseRun>(
      run,
      [run](const PlanOf<ModeEvent>& plan,
            const PlanStartOf<HybridMotion>& start,
            const ContinuePredicate& may_continue) { return TryByTranscription(run, plan, start, may_continue); });
}

std::vector<int> GridsOf(const HybridProblem& problem, const SolverOptions& options) {
  constexpr int kCoarsest = 20;
  std::vector<int> grids = {problem.guess.num_intervals};
  const bool is_given = IsOnGrid(problem) || !problem.guess.lengths.empty();
  if (!options.coarse_to_fine || !problem.free.control || is_given) return grids;
  while (grids.back() >= 2 * kCoarsest) grids.push_back((grids.back() + 1) / 2);
  std::reverse(grids.begin(), grids.end());
  return grids;
}

HybridProblem ResampleOnGrid(HybridProblem problem, int intervals) {
  HybridInput& guess = problem.guess;
  if (intervals == guess.num_intervals) return problem;
  const int width = problem.system.num_controls();
  std::vector<double> control;
  for (int k = 0; k < intervals && !guess.control.empty(); ++k) {
    const int from = static_cast<int>((k + 0.5) * guess.num_intervals / intervals);
    control.insert(control.end(), &guess.control[from * width], &guess.control[from * width] + width);
  }
  guess.control = std::move(control);
  guess.num_intervals = intervals;
  return problem;
}

std::optional<SolveReport> RecogniseGuess(std::string_view solver, const HybridProblem& problem,
                                          const SolverOptions& options) {
  SolverOptions silent = options;
  silent.monitor.callback = nullptr;
  HybridPhaseRun run(solver, problem, silent);
  const HybridMotion& guess = run.guess();
  if (!guess.exact.ok || !(run.ViolationOf(guess) <= kFeasible)) return std::nullopt;
  const Certificate& certificate = run.Certify(guess);
  // With neither a curvature nor a reason no direction is left that keeps the constraints.
  const bool is_minimum =
      certificate.curvature ? certificate.curvature->kind == Curvature::Kind::kMinimum : certificate.reason.empty();
  if (certificate.verdict != Certificate::Verdict::kStationary || !is_minimum) return std::nullopt;
  if (options.monitor.callback) options.monitor.callback(0, guess.exact.loss);
  run.report().certificate = certificate;
  return run.Finish(guess, guess.exact.loss, Termination::kConverged, "the guess is an optimum");
}

namespace {

using Algorithm = AugmentedLagrangian::Algorithm;

// The events along which the options ask to solve; none: those of the motion.
std::optional<std::vector<ModeEvent>> GivenSequence(const SolverOptions& options) {
  if (!options.sequences.given) return std::nullopt;
  std::vector<ModeEvent> events;
  for (std::size_t i = 0; i + 1 < options.sequences.given->size(); ++i) {
    const Candidate &event = (*options.sequences.given)[i], &next = (*options.sequences.given)[i + 1];
    events.push_back({event.a, event.b, next.a});
  }
  return events;
}

// One solve for each grid, from the solution of the grid before; all together take the iterations that are allowed.
SolveReport SolveHybrid(std::string_view solver, Algorithm algorithm, const HybridProblem& problem,
                        const SolverOptions& options) {
  const std::vector<int> grids = GridsOf(problem, options);
  std::optional<HybridMotion> start;
  SolveChain chain(options);
  SolveReport report;
  SolverOptions silent = options;
  silent.monitor.callback = nullptr;
  std::optional<HybridPhaseRun> guess;
  if (grids.size() > 1) guess.emplace(solver, problem, silent);
  for (const int intervals : grids) {
    const SolverOptions of_grid = chain.Next();
    const bool last = intervals == grids.back();
    if (of_grid.limits.iterations == 0 && !last) continue;
    HybridPhaseRun run(solver, ResampleOnGrid(problem, intervals), of_grid, start, GivenSequence(options));
    run.set_algorithm(algorithm);
    if (auto refused = run.StartFailure()) {
      if (!last) continue;
      return *refused;
    }
    report = UpdateHybridSequence(&run);
    chain.Add(report);
    if (report.termination == Termination::kInterrupted && !last) continue;
    const bool ran_out = report.termination == Termination::kIterationLimit && !last &&
                         report.solution.loss < guess->guess().exact.loss &&
                         report.solution.violation <= guess->ViolationOf(guess->guess());
    if (report.termination == Termination::kConverged || ran_out) {
      start = {report.solution.control,
               report.solution.durations,
               report.solution.initial_state,
               report.solution.parameters,
               {}};
    }
  }
  if (!guess) return report;
  report = chain.Finish(std::move(report));
  if (!guess->guess().exact.ok) return report;
  report.guess.loss = report.history.losses.front() = guess->guess().exact.loss;
  report.guess.violation = guess->ViolationOf(guess->guess());
  return report;
}

// Solves on the intervals asked for; if that ends without an optimum, from coarse to fine: the optimum of a coarse grid
// may share the intervals among the phases in another way, and an interior-point method gains nothing from a near
// start. Newton's iterations of an interior-point method end soon or go astray: of many, most are left to the coarse
// grids.
SolveReport SolveDirectlyFirst(std::string_view solver, Algorithm algorithm, const HybridProblem& problem,
                               const SolverOptions& options) {
  constexpr int kLeastDirectly = 100;
  if (!options.sequences.given) {
    if (std::optional<SolveReport> report = RecogniseGuess(solver, problem, options)) return *report;
  }
  const bool has_coarse = GridsOf(problem, options).size() > 1;
  SolverOptions directly = options;
  directly.coarse_to_fine = false;
  if (has_coarse && algorithm == Algorithm::kInteriorPoint) {
    const int all = options.limits.iterations;
    directly.limits.iterations = std::max(std::min(all, kLeastDirectly), (all + 2) / 3);
  }
  SolveChain chain(options);
  SolveReport report = SolveHybrid(solver, algorithm, problem, directly);
  const bool ended = report.termination == Termination::kConverged || report.termination == Termination::kInterrupted;
  chain.Add(report);
  if (ended || chain.IsOutOfIterations() || !has_coarse) return report;
  SolveReport refined = SolveHybrid(solver, algorithm, problem, chain.Next());
  chain.Add(refined);
  const bool takes = refined.termination == Termination::kInterrupted || EndsBetter(refined, report);
  return chain.Finish(takes ? std::move(refined) : std::move(report));
}

}  // namespace

SolveReport SolveHybridByPhases(const HybridProblem& problem, const SolverOptions& options) {
  return SolveDirectlyFirst("ceres_phases", Algorithm::kLeastSquares, problem, options);
}

std::string UnsupportedByInteriorPoint(const HybridProblem& problem) {
  const std::string reason = ReasonNoInteriorPoint();
  return reason.empty() ? UnsupportedByHybridPhases(problem) : reason;
}

SolveReport SolveHybridByInteriorPoint(const HybridProblem& problem, const SolverOptions& options) {
  return SolveDirectlyFirst("ipopt", Algorithm::kInteriorPoint, problem, options);
}

}  // namespace saltus
