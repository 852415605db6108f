#include "hybrid/rollout.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/interrupt.h"
#include "base/number_text.h"
#include "base/table.h"

namespace saltus {
namespace {

constexpr double kNear = 1e-6;         // of the duration: guards that are examined for a tie
constexpr double kAccumulated = 1e-9;  // of the duration: intervals between events that shrink to a point
constexpr int kShrinking = 8;          // intervals that tell
constexpr double kShrinks = 0.9999;    // largest ratio of such intervals, and of changes of the state
constexpr double kSmallChange = 1e-3;  // of the state: a change of it within a step that is short enough
constexpr double kAtJump = 1e-9;       // of a control interval: an event so near to its end is at it
constexpr int kShortSteps = 1 << 13;   // of a motion: what depends on longer ones is refused with these
constexpr double kSameSlope = 1e-9;    // relative: slopes on both sides of a switch at which the flow does not jump
constexpr double kStays = 1e-9;        // of its rates beside a switch: the rate of a motion that stays on it
constexpr double kResolved = 1e-4;     // of the size of a guard in a step: how far it may be from its cubic
constexpr double kHides = 8;           // of that distance at one point: how far it may be at others
constexpr double kRoundingOfGuard = 1e-12;  // of the size of a guard's terms
constexpr double kOffEquations = 0.01;      // of the change in a step: how far off its mode's equations it may end
constexpr double kOnEquations = 1e-9;       // of the largest number of a motion: a distance that tells nothing
constexpr int kResolvedSteps = 1024;        // of a motion: fewer must resolve the guards everywhere
constexpr int kFlownSteps = 1 << 14;        // likewise by closed forms, whose accuracy asks for no short steps
constexpr int kPlaces = 64;                 // one step in so many may be one that does not

constexpr int kMostRemarks = 8;  // that one text tells

constexpr const char *kSinks = " falls from zero", *kAtRateZero = ", with a rate of zero";

std::string Text(double value) { return ToText(value, 10); }

}  // namespace

std::string JoinRemarks(const std::vector<TimedRemark>& remarks) {
  std::string text;
  int different = 0;
  for (auto first = remarks.begin(); first != remarks.end(); ++first) {
    const auto same = [&](const TimedRemark& other) {
      return other.what == first->what && other.where == first->where;
    };
    if (std::any_of(remarks.begin(), first, same) || ++different > kMostRemarks) continue;
    const auto more = std::count_if(first + 1, remarks.end(), same);
    text += (text.empty() ? "" : "; ") + first->what;
    if (first->time) text += " at t = " + ToText(*first->time, 6);
    if (first->time && more > 0) text += " and " + std::to_string(more) + " more times";
    text += first->where;
  }
  if (different > kMostRemarks) text += "; and " + std::to_string(different - kMostRemarks) + " more such remarks";
  return text;
}

TimedRemark RemarkOnTie(const HybridSystem& system, const HybridTie& tie, const std::string& consequence) {
  std::ptrdiff_t switches = 0;
  std::vector<std::string> names;
  for (const int guard : tie.guards) {
    switches += system.functions().IsSwitch(tie.mode, guard) ? 1 : 0;
    names.push_back(system.GuardName(tie.mode, guard));
  }
  const char* what = switches == 0 ? " guards" : switches == std::ssize(names) ? " switches" : " guards and switches";
  return {std::to_string(names.size()) + what + " reach zero",
          tie.time,
          ", and " + consequence + ": " + Joined(names, ", ", "'")};
}

int IntervalBeginNear(const HybridInput& input, double time, double margin) {
  if (input.control.empty() || input.num_intervals == 1) return -1;
  int k = 0;
  double begin = 0, length = input.duration / input.num_intervals;
  if (input.lengths.empty()) {
    k = static_cast<int>(std::round((time - input.begin) / length));
    begin = input.begin + k * length;
  } else {
    const std::vector<double> times = input.Times();
    k = static_cast<int>(std::upper_bound(times.begin(), times.end(), time) - times.begin());
    if (k > 0 && (k > input.num_intervals || time - times[k - 1] < times[k] - time)) --k;
    begin = times[k];
    length = k > 0 ? times[k] - times[k - 1] : length;
  }
  return k <= 0 || k >= input.num_intervals || std::abs(time - begin) > margin * length ? -1 : k;
}

int ControlJumpNear(const HybridInput& input, int num_controls, double time, double margin) {
  const int k = IntervalBeginNear(input, time, margin);
  const double* u = input.control.data() + static_cast<std::ptrdiff_t>(std::max(k, 0)) * num_controls;
  return k < 0 || std::equal(u - num_controls, u, u) ? -1 : k;
}

RolloutRun::RolloutRun(const HybridSystem& system, const HybridOptions& options)
    : system_(system), functions_(system.functions()), options_(options), search_(system.functions()) {
  const int most = functions_.most_states(), most_guards = functions_.most_guards();
  for (std::vector<double>* numbers : {&at_.x, &at_.slope, &next_state_, &next_slope_, &state_within_}) {
    numbers->resize(most);
  }
  at_.guards.resize(most_guards);
  at_.armed.resize(most_guards);
  at_.at_zero.resize(most_guards);
  next_guards_.resize(most_guards);
}

std::string RolloutRun::DescribeTime() const {
  return "mode '" + system_.ModeName(at_.mode) + "' at t = " + Text(at_.t);
}

std::string RolloutRun::QualifiedGuardName(int mode, int guard) const {
  return (functions_.IsSwitch(mode, guard) ? "switch '" : "guard '") + system_.GuardName(mode, guard) + "'";
}

// Says what to do where events of a guard may not end.
std::string RolloutRun::DescribeContinuations(int mode, int guard) const {
  if (functions_.IsSwitch(mode, guard)) {
    return "; if they do not end, make the change of the flow gradual, or end the motion before";
  }
  if (functions_.EndsAccumulations()) {
    return "; if they do not end, raise rest_speed (in C++ MechanicalOptions), below which a contact closes at an "
           "impact, or end the motion before";
  }
  return "; if they do not end, name the mode in which the motion goes on there (on_accumulation, in C++ "
         "OnAccumulation)";
}

bool RolloutRun::Refuse(const std::string& what) {
  why_ = what;
  end_ = RolloutEnd::kRefused;
  failure_time_ = at_.t;
  flow_fails_ = false;
  return false;
}

// Adds a remark on the present time, which stands between `what` and `where`; or on no time, if that is empty.
void RolloutRun::Remark(const std::string& what, const std::string& where) {
  if (!what.empty()) remarks_.push_back({what, where.empty() ? std::optional<double>() : at_.t, where});
}

FlowStep RolloutRun::StepFrom(double h) const {
  const double* control = input_->control.data() + static_cast<std::ptrdiff_t>(interval_) * system_.num_controls();
  return {{at_.mode, at_.t, at_.x.data(), control, input_->parameters.data()}, h};
}

TapeEntry& RolloutRun::Record(TapeEntry::Kind kind, double h) {
  const std::size_t x = tape_.Keep(at_.x.data(), system_.state_size(at_.mode));
  return tape_.entries.emplace_back(
      TapeEntry{.kind = kind, .mode = at_.mode, .interval = interval_, .t = at_.t, .h = h, .x = x});
}

// A step from at_ leads to numbers that are not finite. Finds out whether the flow is the reason, at a finite state.
bool RolloutRun::FailAt(const FlowStep& step) {
  using cooper_verner::kStages;
  const auto not_finite = [](double number) { return !std::isfinite(number); };
  end_ = RolloutEnd::kNotFinite;
  failure_time_ = at_.t;
  flow_fails_ = false;
  const int n = system_.state_size(at_.mode);
  std::vector<double> slopes(kStages * n + n), stage(n);
  std::copy_n(at_.slope.begin(), n, slopes.begin());
  double size = 0, change = 0;
  bool integrates = true;
  for (int i = 0; i < n; ++i) size = std::max(size, std::abs(step.x[i]));
  for (int i = 1; i <= kStages; ++i) {
    cooper_verner::CombineSlopes(i, n, step.h, step.x, slopes.data(), stage.data());
    integrates = std::ranges::none_of(stage, not_finite);
    if (!integrates) break;
    double* slope = &slopes[i * n];
    const double t = step.t + (i < kStages ? cooper_verner::kC[i] : 1) * step.h;
    functions_.Flow({step.mode, t, stage.data(), step.u, step.p}, slope);
    const double* found = std::find_if(slope, slope + n, not_finite);
    if (found == slope + n) continue;
    for (int j = 0; j < n; ++j) change = std::max(change, std::abs(stage[j] - step.x[j]));
    flow_fails_ = change <= kSmallChange * size || size == 0;
    failure_time_ = t;
    why_ = "the flow of mode '" + system_.ModeName(at_.mode) + "' at t = " + Text(t) +
           " gives no finite derivative of " + system_.StateName(at_.mode, static_cast<int>(found - slope));
    return false;
  }
  if (integrates && functions_.Fly(step, stage.data(), nullptr)) {
    const auto found = std::ranges::find_if(stage, not_finite);
    if (found != stage.end()) {
      why_ = "the closed form of the flow of " + DescribeTime() + " gives no finite " +
             system_.StateName(at_.mode, static_cast<int>(found - stage.begin()));
      return false;
    }
  }
  why_ = "the state of " + DescribeTime() + " does not stay finite: it overflows";
  for (int i = n; i-- > 0;) {
    if (not_finite(next_state_[i]) || not_finite(next_slope_[i])) {
      why_ =
          "the state of " + DescribeTime() + " does not stay finite: " + system_.StateName(at_.mode, i) + " overflows";
    }
  }
  return false;
}

// The slope at at_, and whether it is finite.
bool RolloutRun::UpdateSlope() {
  const int n = system_.state_size(at_.mode);
  std::fill_n(at_.slope.begin(), n, std::numeric_limits<double>::quiet_NaN());
  functions_.Flow(StepFrom(0), at_.slope.data());
  for (int i = 0; i < n; ++i) {
    if (std::isfinite(at_.slope[i])) continue;
    return Refuse("the flow of " + DescribeTime() + " gives no finite derivative of " + system_.StateName(at_.mode, i));
  }
  return true;
}

// The time over which errors of the integration that guards see at a time have come about: at most a step.
double RolloutRun::Elapsed(double time) const { return std::min(time - input_->begin, tape_.step); }

void RolloutRun::UpdateGuards() { functions_.GuardRates(StepFrom(0), at_.slope.data(), at_.guards.data()); }

// Whether a guard of the mode jumps where the control does. Systems that create modes determine, by
// ModeAfterControlJump, where a jump of the control leads to.
bool RolloutRun::JumpsWithControl(int guard) const {
  return !functions_.CreatesModes() && functions_.ReadsControl(at_.mode, guard) &&
         !functions_.IsSwitch(at_.mode, guard);
}

// The control has jumped: the motion goes on in the mode that the system's functions return.
// Returns guards that have fallen to zero up to rounding where at_ is.
std::vector<int> RolloutRun::TouchingGuards() {
  std::vector<int> touching;
  for (int guard = 0; guard < system_.num_guards(at_.mode); ++guard) {
    const GuardValue& value = at_.guards[guard];
    if (at_.armed[guard] == 0 || at_.armed[guard] == kHeld) continue;
    if (!(value.value <= kNear * -value.rate * input_->duration)) continue;
    if (value.value <= search_.WindowOf(StepFrom(0), guard, value.rate, Elapsed(at_.t)).integrated)
      touching.push_back(guard);
  }
  return touching;
}

bool RolloutRun::SwitchControl() {
  const FlowStep here = StepFrom(0);
  const int next = functions_.ModeAfterControlJump(here);
  if (next < 0) {
    return Refuse("there is no mode under the control that begins in " + DescribeTime() + ": " +
                  functions_.ReasonNoMode(here, -1));
  }
  if (next != at_.mode) {
    switches_.push_back({.time = at_.t, .mode = at_.mode, .guard = -1, .next_mode = next, .before = {}, .after = {}});
    at_.mode = next;
    return EnterMode(Entry::kAfterReset);
  }
  const int mode = at_.mode;
  const std::vector<int> touching = TouchingGuards();
  const std::size_t events = events_.size();
  const auto note_touches = [&] {  // that end where the control jumps
    for (const int guard : touching) {
      const int now = events_.size() == events ? NumberIn(at_.mode, mode, guard) : -1;
      const bool returns =
          now >= 0 && at_.guards[now].rate > 0 && (!functions_.IsSwitch(mode, guard) || FlowJumpsAt(StepFrom(0), now));
      if (returns && !IsLastGrazing(mode, guard, at_.t)) grazings_.push_back({at_.t, mode, guard});
    }
  };
  bool enters = std::count(at_.at_zero.begin(), at_.at_zero.end(), 0) < std::ssize(at_.at_zero);
  for (int guard = 0; guard < system_.num_guards(mode); ++guard) {
    enters = enters || functions_.IsSwitch(mode, guard) || JumpsWithControl(guard);
  }
  if (enters) {
    if (!EnterMode(Entry::kControlJump)) return false;
    note_touches();
    if (at_.mode != mode && events_.size() == events) {
      switches_.push_back({.time = at_.t, .mode = mode, .guard = -1, .next_mode = at_.mode, .before = {}, .after = {}});
    }
    return true;
  }
  Remark(functions_.ReasonNoDerivative(here, -1));
  if (!UpdateSlope()) return false;
  UpdateGuards();
  note_touches();
  return true;
}

// Sets the times of the grid: each part of a control interval, which the times in `divided` divide, has as many steps.
void RolloutRun::SetGrid(int steps, std::span<const double> divisions) {
  const HybridInput& input = *input_;
  tape_.step = input.duration / (input.num_intervals * steps);
  tape_.num_nodes = input.num_intervals * steps;
  for (int k = 0; k < input.num_intervals; ++k) tape_.begins.push_back(k * steps);
  if (input.lengths.empty() && divisions.empty()) return;
  const std::vector<double> ends = input.Times();
  tape_.fractions = {0};
  auto next = divisions.begin();
  for (int k = 0; k < input.num_intervals; ++k) {
    tape_.begins[k] = static_cast<int>(tape_.fractions.size()) - 1;
    const double end_of_interval = ends[k + 1] - input.begin;
    double begin = ends[k] - input.begin;
    do {  // once for an interval of length zero
      while (next != divisions.end() && !(*next * input.duration > begin)) ++next;
      const double end = next == divisions.end() ? end_of_interval : std::min(*next * input.duration, end_of_interval);
      for (int i = 1; i <= steps; ++i) tape_.fractions.push_back((begin + (end - begin) * i / steps) / input.duration);
      tape_.fractions.back() = end / input.duration;
      begin = end;
    } while (begin < end_of_interval);
  }
  tape_.fractions.back() = 1;
  tape_.num_nodes = static_cast<int>(tape_.fractions.size()) - 1;
}

RolloutEnd RolloutRun::Run(const HybridInput& input, const RolloutSteps& steps, bool compare_guards) {
  input_ = &input;
  compare_guards_ = compare_guards;
  unresolved_ = {};
  search_.Forget();
  tape_.Clear();
  SetGrid(steps.per_interval, steps.divisions);
  events_.clear();
  switches_.clear();
  befores_.clear();
  afters_.clear();
  grazings_.clear();
  ties_.clear();
  why_.clear();
  remarks_.clear();
  at_start_.clear();
  accumulation_.reset();
  accumulations_at_once_ = 0;
  largest_ = 0;
  for (const std::vector<double>* numbers : {&input.initial, &input.parameters, &input.control}) {
    for (const double number : *numbers) largest_ = std::max(largest_, std::abs(number));
  }
  end_ = RolloutEnd::kDone;
  at_.mode = input.mode;
  at_.t = input.begin;
  interval_ = 0;
  std::copy(input.initial.begin(), input.initial.end(), at_.x.begin());
  at_.mode = functions_.PieceAt(StepFrom(0));
  bool goes_on = EnterMode(Entry::kStart);
  for (int node = 1; goes_on && node <= tape_.num_nodes; ++node) {
    const auto next = static_cast<int>(tape_.intervals.size());
    if (next < input.num_intervals && node - 1 == tape_.begins[next]) {
      const bool jumps = interval_ != next;
      interval_ = next;
      tape_.intervals.push_back(tape_.entries.size());
      if (jumps && system_.num_controls() > 0) goes_on = SwitchControl();
    }
    goes_on = goes_on && StepTo(node);
  }
  Finish();
  return end_;
}

void RolloutRun::Finish() {
  tape_.final_mode = at_.mode;
  tape_.final_state = tape_.Keep(at_.x.data(), system_.state_size(at_.mode));
  for (std::size_t i = 0; i < events_.size(); ++i) {
    HybridEvent& event = events_[i];
    event.before = {&tape_.numbers[befores_[i]], static_cast<std::size_t>(system_.state_size(event.mode))};
    event.after = {&tape_.numbers[afters_[i]], static_cast<std::size_t>(system_.state_size(event.next_mode))};
  }
}

// Whether the flow differs from the slope before a switch.
bool RolloutRun::JumpsFrom(const std::vector<double>& slope) const {
  double largest = 0, change = 0;
  for (int i = 0; i < system_.state_size(at_.mode); ++i) {
    largest = std::max({largest, std::abs(slope[i]), std::abs(at_.slope[i])});
    change = std::max(change, std::abs(slope[i] - at_.slope[i]));
  }
  return change > kSameSlope * largest;
}

// Whether a motion on zero of a switch stays there. `fastest`: the largest rate of a switch beside it, as far as known.
bool RolloutRun::StaysOnSwitch(const FlowStep& ahead, int guard, double fastest) {
  for (const double part : {0.5, 1.0}) {
    const GuardValue then = search_.GuardAfter(ahead, at_.slope.data(), guard, part * ahead.h);
    if (std::abs(then.value - at_.guards[guard].value) > kStays * fastest * ahead.h) return false;
  }
  return true;
}

// Whether the motion has just met a switch, and this one fell to zero at the same time without having been met yet: it
// then has an event of its own, as its time depends on other numbers.
bool RolloutRun::IsSecondSwitch(int other) const {
  if (events_.empty() || !events_.back().is_switch || tape_.entries.back().kind != TapeEntry::Kind::kReset)
    return false;
  if (!IsWithinTie()) return false;
  const Coincidence& tied = tape_.coincidences.back();
  const FlowStep here = StepFrom(0);
  const auto is_same = [&](int mode, int guard) {
    return functions_.BaseMode(mode) == functions_.BaseMode(at_.mode) &&
           AreParallel({mode, here.t, here.x, here.u, here.p}, guard, here, other);
  };
  bool met = functions_.IsOn(at_.mode, other);
  for (std::size_t i = tied.begin; i < tape_.entries.size() && !met; ++i) {
    const TapeEntry& entry = tape_.entries[i];
    met = entry.kind == TapeEntry::Kind::kReset && is_same(entry.mode, entry.guard);
  }
  const int first_mode = tape_.entries[tied.begin].mode;
  return !met && std::ranges::any_of(tied.guards, [&](int guard) { return is_same(first_mode, guard); });
}

// Whether a switch falls behind its zero, in the piece `next`, as it does before.
bool RolloutRun::Passes(int falling, int next) const {
  if (next < 0) return false;
  const FlowStep here = StepFrom(0);
  FlowStep behind = here;
  behind.mode = next;
  std::vector<double> slope(system_.state_size(next));
  functions_.Flow(behind, slope.data());
  return search_.GuardAt(here, slope.data(), falling).rate < 0;
}

// Whether the gradients of two guards are parallel.
bool RolloutRun::AreParallel(const ModePoint& a, int guard_a, const ModePoint& b, int guard_b) const {
  constexpr double kSame = 1e-12;  // relative
  const int columns = system_.state_size(a.mode) + 1 + system_.num_parameters() + system_.num_controls();
  Eigen::VectorXd of_a(columns), of_b(columns);
  functions_.GuardGradient(a, guard_a, of_a.data());
  functions_.GuardGradient(b, guard_b, of_b.data());
  Eigen::Index largest = 0;
  const double size = of_a.cwiseAbs().maxCoeff(&largest) * of_b.lpNorm<Eigen::Infinity>();
  return (of_a * of_b[largest] - of_b * of_a[largest]).lpNorm<Eigen::Infinity>() <= kSame * size;
}

// Whether another guard, as the share of a side in the flow along a switch, differs from side to side of a switch. If
// none does, its side determines nothing about how the motion goes on along others.
bool RolloutRun::GuardsChangeWith(int guard) const {
  using Side = HybridFunctions::Side;
  const FlowStep here = StepFrom(0);
  std::vector<double> values[2];
  for (const int i : {0, 1}) {
    FlowStep beside = here;
    beside.mode = functions_.AdjacentPiece(here, guard, i == 0 ? Side::kBelow : Side::kAbove);
    if (beside.mode < 0) return true;
    const int itself = NumberIn(beside.mode, at_.mode, guard);
    for (int other = 0; other < system_.num_guards(beside.mode); ++other) {
      if (other != itself) values[i].push_back(functions_.Guard(beside, other));
    }
  }
  const auto same = [](double a, double b) { return std::abs(a - b) <= kSameSlope * (std::abs(a) + std::abs(b)); };
  return !std::ranges::equal(values[0], values[1], same);
}

// The number of a guard of the piece `from` in the piece `to` of the same mode, where at_ is; -1 if it has none.
int RolloutRun::NumberIn(int to, int from, int guard) const {
  if (from == to) return guard;
  if (functions_.BaseMode(from) != functions_.BaseMode(to)) return -1;
  if (!functions_.IsSwitch(from, guard)) return guard;
  FlowStep before = StepFrom(0), behind = before;
  before.mode = from;
  behind.mode = to;
  const int count = system_.num_guards(to);
  for (int other = count - functions_.num_switches(to); other < count; ++other) {
    if (AreParallel(before, guard, behind, other)) return other;
  }
  return -1;
}

// Whether a switch that does not read the control was above zero before the control jumped, in the piece `before`.
bool RolloutRun::WaitsBehindJump(int before, int guard) const {
  if (functions_.ReadsControl(at_.mode, guard)) return false;
  const int then = NumberIn(before, at_.mode, guard);
  return then >= 0 && at_.armed[then] != 0 && at_.armed[then] != kHeld;
}

// Finds the piece of the mode in which the motion goes on, and leaves its slope and guards in at_: a switch below zero,
// or at zero and falling, takes its other side. If both sides point at the switch, the motion stays on it if the flow
// there keeps it. A jump of the control turns no switch that does not read it: one that is about to fall through zero
// does so in the step behind, as an event.
bool RolloutRun::ChooseSwitchSides(Entry entry) {
  const int mode = at_.mode;
  double fastest = 0;
  std::vector<int> seen;
  for (;;) {
    if (!UpdateSlope()) return false;
    UpdateGuards();
    const FlowStep here = StepFrom(tape_.step);
    search_.EnterMode(here);
    const int count = system_.num_guards(at_.mode);
    int turns = -1, next = -1;
    bool is_second = false;  // what is met first is settled first
    for (int guard = count - functions_.num_switches(at_.mode); guard < count && (turns < 0 || is_second); ++guard) {
      const GuardValue& value = at_.guards[guard];
      if (!std::isfinite(value.value))
        return Refuse(QualifiedGuardName(at_.mode, guard) + " is not a finite number in " + DescribeTime());
      using GuardStatus = EventSearch::GuardStatus;
      const GuardStatus standing = search_.Classify(here, at_.slope.data(), guard, value, Elapsed(at_.t));
      const bool rises = standing == GuardStatus::kArmed || standing == GuardStatus::kRising;
      const bool on = functions_.IsOn(at_.mode, guard);
      using Side = HybridFunctions::Side;
      const bool stays =
          on && functions_.AdjacentPiece(here, guard, Side::kSliding) < 0 && StaysOnSwitch(here, guard, fastest);
      const bool waits =
          entry == Entry::kControlJump && standing == GuardStatus::kFalling && WaitsBehindJump(mode, guard);
      if (on ? stays : rises || waits) continue;
      const bool second = IsSecondSwitch(guard);
      if (turns >= 0 && second) continue;
      is_second = second;
      turns = guard;
      next = functions_.AdjacentPiece(here, guard, !on ? Side::kOther : rises ? Side::kAbove : Side::kBelow);
    }
    if (turns < 0) break;
    fastest = std::max(fastest, std::abs(at_.guards[turns].rate));
    seen.push_back(at_.mode);
    const auto known = [&](int piece) { return std::find(seen.begin(), seen.end(), piece) != seen.end(); };
    if (known(next)) {
      const int along = functions_.AdjacentPiece(here, turns, HybridFunctions::Side::kSliding);
      if (along >= 0 && !known(along)) {
        if (!events_.empty() && events_.back().is_switch && tape_.entries.back().kind == TapeEntry::Kind::kReset &&
            (&tape_.entries.back())[-1].h > 0 && GuardsChangeWith(turns)) {
          Remark("the motion meets switch '" + system_.GuardName(at_.mode, turns) + "' and another one",
                 ", where Filippov's convention need not determine how it goes on");
        }
        if (!ApplyReset(turns, /*with_step=*/true, /*immediate=*/true)) return false;
        continue;
      }
      const int on = functions_.AdjacentPiece(here, turns, HybridFunctions::Side::kOn);
      if (on < 0 || known(on)) {
        Refuse("the flow on both sides of switch '" + system_.GuardName(at_.mode, turns) + "' points at it in " +
               DescribeTime() +
               ": the motion would slide along the switch. Give the motion along it a mode of its own, or make "
               "the change of the flow gradual; in Python sliding='filippov' goes on along it, where Filippov's "
               "convention determines the flow and the switch is no step of floor or %");
        // A piece that the motion has just left: errors of long steps may be the reason.
        if (along >= 0 && tape_.num_nodes < kShortSteps) {
          end_ = RolloutEnd::kNotFinite;
          failure_time_ = at_.t;
          flow_fails_ = false;
        }
        return false;
      }
      next = on;
    } else if (is_second) {
      const bool passes = Passes(turns, next);
      const int on = passes ? -1 : functions_.AdjacentPiece(here, turns, HybridFunctions::Side::kOn);
      const bool stops = on >= 0 && functions_.AdjacentPiece(here, turns, HybridFunctions::Side::kSliding) < 0;
      if (passes || stops) {
        if (!ApplyReset(turns, /*with_step=*/true, /*immediate=*/false)) return false;
        if (stops) at_.mode = on;
        continue;
      }
    }
    at_.mode = next;
  }
  if (at_.mode != mode && !tape_.entries.empty() && tape_.entries.back().kind == TapeEntry::Kind::kReset) {
    events_.back().next_mode = at_.mode;
  }
  return true;
}

// The numbers of the input on which a guard depends, where at_ is.
RolloutRun::StartDependence RolloutRun::DependenceOf(int guard) const {
  const int n = system_.state_size(at_.mode), num_parameters = system_.num_parameters();
  std::vector<double> gradient(n + 1 + num_parameters + system_.num_controls());
  functions_.GuardGradient(StepFrom(0), guard, gradient.data());
  std::vector<char> depends;
  for (const double number : gradient) depends.push_back(number != 0);
  const auto parameters = depends.begin() + n + 1, control = parameters + num_parameters;
  return {{}, {depends.begin(), depends.begin() + n}, {parameters, control}, {control, depends.end()}};
}

// Notes events at the start. Guards that are not the first ones see what resets have made of the input.
void RolloutRun::RemarkOnStart(const std::vector<int>& guards, bool first) {
  const auto any = [](const std::vector<char>& depends) {
    return std::ranges::count(depends, 0) < std::ssize(depends);
  };
  const auto depends = [&](const StartDependence& of) {
    return any(of.initial) || any(of.parameters) || any(of.control);
  };
  if (!first && std::ranges::any_of(at_start_, depends)) return;
  StartDependence all;
  std::string names;
  for (const int guard : guards) {
    StartDependence of_guard = DependenceOf(guard);
    if (!first) {
      const char reads_state = any(of_guard.initial) ? 1 : 0;
      of_guard.initial.assign(input_->initial.size(), reads_state);
      for (char& parameter : of_guard.parameters) parameter |= reads_state;
    }
    names += (names.empty() ? "'" : ", '") + system_.GuardName(at_.mode, guard) + "'";
    const auto add = [](const std::vector<char>& from, std::vector<char>* to) {
      to->resize(from.size());
      for (std::size_t i = 0; i < from.size(); ++i) (*to)[i] |= from[i];
    };
    add(of_guard.initial, &all.initial);
    add(of_guard.parameters, &all.parameters);
    add(of_guard.control, &all.control);
  }
  all.what = guards.size() == 1 ? "guard " + names + " has an event at the start"
                                : "guards " + names + " have events at the start";
  at_start_.push_back(std::move(all));
}

// Whether the last reset leads onto a switch or guard from all motions nearby, too: behind it its number changes only
// as the guard did before.
bool RolloutRun::AllLandOn(int guard) const {
  const TapeEntry& reset = tape_.entries.back();
  const FlowStep here = StepFrom(0);
  const ModePoint before{reset.mode, reset.t, &tape_.numbers[reset.x], here.u, here.p};
  const int n = system_.state_size(reset.mode), rows = system_.state_size(at_.mode);
  const int num_parameters = system_.num_parameters(), columns = n + 1 + num_parameters;
  const int most = functions_.most_states();
  using Vector = Eigen::RowVectorXd;
  Eigen::VectorXd after(most);
  Vector of_guard(columns + system_.num_controls()), of_switch(rows + 1 + num_parameters + system_.num_controls());
  RungeKutta::Matrix jacobian(most, columns);
  functions_.ResetJacobian(before, reset.guard, after.data(), jacobian.data());
  functions_.GuardGradient(before, reset.guard, of_guard.data());
  functions_.GuardGradient(here, guard, of_switch.data());
  Vector change = of_switch.head(rows) * jacobian.topRows(rows);
  change.tail(1 + num_parameters) += of_switch.segment(rows, 1 + num_parameters);
  const Vector direction = of_guard.head(columns).normalized();
  return (change - change.dot(direction) * direction).norm() <= kSameSlope * change.norm();
}

// Whether the motion is among the events of guards that reach zero together, which TiedEvents compares.
bool RolloutRun::IsWithinTie() const {
  return !tape_.coincidences.empty() && tape_.coincidences.back().end == 0 &&
         tape_.coincidences.back().guards.size() > 1;
}

// A motion that begins on a switch, or is reset onto it, has one-sided derivatives if the flow jumps there.
void RolloutRun::RemarkOnSwitches(Entry entry) {
  if (entry != Entry::kStart && IsWithinTie()) return;
  const FlowStep here = StepFrom(tape_.step);
  const int count = system_.num_guards(at_.mode), mode = at_.mode;
  const std::vector<double> slope = at_.slope;
  for (int guard = count - functions_.num_switches(mode); guard < count; ++guard) {
    if (search_.Classify(here, slope.data(), guard, at_.guards[guard], Elapsed(at_.t)) ==
        EventSearch::GuardStatus::kArmed)
      continue;
    bool jumps = false;
    using Side = HybridFunctions::Side;
    for (const Side side : {Side::kOther, Side::kBelow, Side::kAbove}) {
      const int beside = functions_.AdjacentPiece(here, guard, side);
      if (beside < 0) continue;
      at_.mode = beside;
      functions_.Flow(StepFrom(0), at_.slope.data());
      jumps = jumps || JumpsFrom(slope);
    }
    at_.mode = mode;
    at_.slope = slope;
    if (!jumps) continue;
    const std::string name = "switch '" + system_.GuardName(mode, guard) + "', where the flow jumps";
    if (entry == Entry::kStart) {
      at_start_.push_back(DependenceOf(guard));
      at_start_.back().what = "the motion begins on " + name;
    } else if (!AllLandOn(guard)) {
      Remark("the reset", " leads onto " + name);
    }
  }
}

// A reset onto a guard of the mode behind it, which rises from zero there, leads motions nearby below it, where they
// have its event at once; unless all of them land on it, as those that bounce do, or it is one of guards that reach
// zero together.
void RolloutRun::RemarkOnRisingGuard(int guard) {
  const HybridEvent& event = events_.back();
  if (functions_.CreatesModes() || event.is_switch || (event.mode == at_.mode && event.guard == guard)) return;
  if (IsWithinTie()) return;
  if (!AllLandOn(guard)) Remark("the reset", " leads onto guard '" + system_.GuardName(at_.mode, guard) + "'");
}

// A motion that stays on a switch from an event on leaves other switches on which it stays as well, zero at the rate
// zero, at the side that they had before: if the flow jumps there, the conditions are two for one surface, and the
// motion may be another one.
void RolloutRun::RemarkOnSharedSurfaces(const FlowStep& here) {
  if (events_.empty() || !events_.back().is_switch || events_.back().time != at_.t) return;
  const std::string name = system_.GuardName(events_.back().mode, events_.back().guard);
  const int count = system_.num_guards(at_.mode), mode = at_.mode;
  const std::vector<double> slope = at_.slope;
  for (int guard = count - functions_.num_switches(mode); guard < count; ++guard) {
    const GuardValue& value = at_.guards[guard];
    if (functions_.IsOn(mode, guard) || value.rate != 0 || system_.GuardName(mode, guard) == name ||
        search_.Classify(here, slope.data(), guard, value, Elapsed(at_.t)) == EventSearch::GuardStatus::kArmed) {
      continue;
    }
    const int beside = functions_.AdjacentPiece(here, guard, HybridFunctions::Side::kOther);
    if (beside < 0) continue;
    at_.mode = beside;
    functions_.Flow(StepFrom(0), at_.slope.data());
    const bool jumps = JumpsFrom(slope);
    at_.mode = mode;
    at_.slope = slope;
    if (!jumps) continue;
    Remark("the motion stays on switch '" + name + "'",
           ", where switch '" + system_.GuardName(mode, guard) +
               "' is zero as well but keeps its side: the motion may be wrong; write both conditions alike");
  }
}

// On entry into a mode, at the start or after a reset: arms guards and takes events that are due at once. Transitions
// of guards that are behind belong to the event before and come first; then the earliest event of guards at zero, and
// of those that rounding does not separate that of the smallest number. Where only the control jumps, guards at zero
// are looked at, and those that read the control, whose event is there if it takes them below zero.
bool RolloutRun::EnterMode(Entry entry) {
  using GuardStatus = EventSearch::GuardStatus;
  const bool starts = entry == Entry::kStart;
  for (;;) {
    const int mode = at_.mode;
    const bool switches = functions_.num_switches(mode) > 0;
    if (switches ? !ChooseSwitchSides(entry) : !UpdateSlope()) return false;
    if (at_.mode != mode && entry == Entry::kControlJump) entry = Entry::kAfterReset;  // with other guards
    if (entry == Entry::kStart) Remark(functions_.ReasonNoDerivative(StepFrom(0), -1));
    const FlowStep ahead = StepFrom(tape_.step);
    const double elapsed = entry == Entry::kStart ? ahead.h : Elapsed(at_.t);
    int due = -1;
    std::vector<int> immediate;
    GuardStatus of_due = GuardStatus::kFalling;
    double time = 0, rounding = 0;  // of the event that is due
    UpdateGuards();
    search_.EnterMode(ahead);
    const bool is_reset = !events_.empty() && tape_.entries.back().kind == TapeEntry::Kind::kReset;
    if (switches && (entry == Entry::kStart || (is_reset && !events_.back().is_switch))) RemarkOnSwitches(entry);
    if (switches) RemarkOnSharedSurfaces(ahead);
    if (entry != Entry::kControlJump) std::fill(at_.at_zero.begin(), at_.at_zero.end(), 0);
    for (int guard = 0; guard < system_.num_guards(at_.mode); ++guard) {
      const bool jumps = entry == Entry::kControlJump && JumpsWithControl(guard);
      const bool was_armed = at_.armed[guard] != 0;
      if (entry == Entry::kControlJump && at_.at_zero[guard] == 0 && !jumps) continue;
      const GuardValue& value = at_.guards[guard];
      if (!std::isfinite(value.value)) {
        return Refuse(QualifiedGuardName(at_.mode, guard) + " is not a finite number in " + DescribeTime());
      }
      const GuardStatus standing = search_.Classify(ahead, at_.slope.data(), guard, value, elapsed);
      at_.armed[guard] = standing == GuardStatus::kArmed;
      at_.at_zero[guard] = standing == GuardStatus::kRising;
      if (switches && functions_.IsSwitch(at_.mode, guard)) {
        if (standing == GuardStatus::kFalling) at_.armed[guard] = true;  // its event is in the step behind
        if (!functions_.IsOn(at_.mode, guard)) continue;
        at_.armed[guard] = kHeld;
        at_.at_zero[guard] = 0;
        continue;
      }
      if (standing == GuardStatus::kRising && entry == Entry::kAfterReset && is_reset && !starts)
        RemarkOnRisingGuard(guard);
      if (standing == GuardStatus::kArmed || standing == GuardStatus::kRising) continue;
      if (standing == GuardStatus::kBehind) {
        if (entry == Entry::kStart) {
          if (!options_.wait_behind_guards) {
            return Refuse("guard '" + system_.GuardName(at_.mode, guard) + "' is below zero (" + Text(value.value) +
                          ") at the start, in " + DescribeTime());
          }
          // A motion that goes on from interval to interval begins with jumps of the control.
          if (!JumpsWithControl(guard)) continue;
        }
        if (jumps && !was_armed) continue;
        if (value.rate >= 0 && functions_.RearmsAboveZero(at_.mode, guard)) continue;
      }
      if (starts) immediate.push_back(guard);
      if (due >= 0 && (of_due == GuardStatus::kBehind || standing == GuardStatus::kSinking)) continue;
      double then = 0, error = 0;
      if (standing == GuardStatus::kFalling) {
        then = std::max(value.value, 0.0) / -value.rate;
        error = search_.WindowOf(ahead, guard, value.rate, elapsed).rounding / -value.rate;
        if (due >= 0 && of_due == GuardStatus::kFalling && then >= time - rounding - error) continue;
      }
      due = guard;
      of_due = standing;
      time = then;
      rounding = error;
    }
    if (due < 0) return true;
    due = functions_.CauseOf(StepFrom(0), due);
    const std::string name = "guard '" + system_.GuardName(at_.mode, due) + "'";
    if (starts) RemarkOnStart(immediate, entry == Entry::kStart);
    if (entry == Entry::kControlJump && of_due != GuardStatus::kBehind)
      Remark(name + " has an event", ", where the control jumps");
    if (const std::string why = ReasonRepeatedEvent(due, of_due); !why.empty()) {
      return ContinueAfterAccumulation(at_.t, at_.mode, due, why);
    }
    if (of_due == GuardStatus::kSinking) Remark(name + kSinks, kAtRateZero);
    if (!ApplyReset(due, of_due == GuardStatus::kFalling, entry != Entry::kStart)) return false;
    entry = Entry::kAfterReset;
  }
}

// Says why the events of this time go on without end: the guard has had one with the state that is reached again, or,
// if the system names a mode to go on in, one after which it is left at zero with a rate of zero; or it has had too
// many. Empty if they may end.
std::string RolloutRun::ReasonRepeatedEvent(int guard, EventSearch::GuardStatus standing) const {
  int count = 0;
  for (std::size_t i = events_.size(); i-- > 0 && events_[i].time == at_.t;) {
    if (events_[i].mode != at_.mode || events_[i].guard != guard) continue;
    ++count;
    const bool named = functions_.OnAccumulation(at_.mode, guard) >= 0;
    const double* before = &tape_.numbers[befores_[i]];
    if ((named && standing == EventSearch::GuardStatus::kSinking) ||
        std::equal(before, before + system_.state_size(at_.mode), at_.x.begin())) {
      return "events without time passing (Zeno behaviour) in " + DescribeTime() + ": guard '" +
             system_.GuardName(at_.mode, guard) + "' has an event at once after its own";
    }
  }
  if (count < std::max(options_.most_repeats, 1)) return "";
  if (events_.back().mode == at_.mode && events_.back().guard == guard &&
      standing == EventSearch::GuardStatus::kFalling) {
    return "events without time passing (Zeno behaviour) in " + DescribeTime() + ": the reset of guard '" +
           system_.GuardName(at_.mode, guard) +
           "' leaves it at zero and falling. Let the reset lead to a mode without this guard, or move the state off it";
  }
  return "more than " + std::to_string(options_.most_repeats) + " events without time passing (Zeno behaviour) in " +
         DescribeTime() + ", of guard '" + system_.GuardName(at_.mode, guard) + "': raise most_repeats if they end";
}

// The reset of a guard, where at_ is. `with_step`: this is where the guard is zero, which a step of no length to the
// event notes for the derivatives; otherwise such a step is on the tape, or the reset is part of the one before.
bool RolloutRun::ApplyReset(int guard, bool with_step, bool immediate) {
  if (static_cast<int>(events_.size()) >= options_.most_events) {
    return Refuse("more than " + std::to_string(options_.most_events) + " events, in " + DescribeTime() + ", of " +
                  QualifiedGuardName(at_.mode, guard) + ": raise most_events if the motion has as many" +
                  DescribeContinuations(at_.mode, guard));
  }
  const int mode = at_.mode;
  const auto what = [&] {
    return "the reset of guard '" + system_.GuardName(mode, guard) + "' in " + DescribeTime() + " ";
  };
  const FlowStep here = StepFrom(0);
  const double rate = search_.GuardAt(here, at_.slope.data(), guard).rate;
  Remark(functions_.ReasonNoDerivative(here, guard));
  if (with_step) Record(TapeEntry::Kind::kToEvent, 0).guard = guard;
  TapeEntry& reset = Record(TapeEntry::Kind::kReset, 0);
  reset.guard = guard;
  reset.event = static_cast<int>(events_.size());
  befores_.push_back(reset.x);
  std::fill(next_state_.begin(), next_state_.end(), std::numeric_limits<double>::quiet_NaN());
  const int next = functions_.Reset(here, guard, next_state_.data());
  if (next < 0 || next >= system_.num_modes()) {
    befores_.pop_back();
    if (functions_.IsSwitch(mode, guard)) {
      return Refuse("the motion meets " + QualifiedGuardName(mode, guard) + " in " + DescribeTime() +
                    " while it slides along another switch, on whose sides other conditions decide: Filippov's "
                    "convention does not determine how it goes on");
    }
    if (const std::string why = functions_.ReasonNoMode(here, guard); !why.empty()) {
      Refuse(what() + "leads to no mode: " + why);
      if (next < -1 && tape_.num_nodes < kShortSteps) end_ = RolloutEnd::kNotFinite;
      return false;
    }
    return Refuse(what() + "leads to mode " + std::to_string(next) + ", expected 0 to " +
                  std::to_string(system_.num_modes() - 1));
  }
  for (int i = 0; i < system_.state_size(next); ++i) {
    if (std::isfinite(next_state_[i])) continue;
    befores_.pop_back();
    return Refuse(what() + "gives no finite " + system_.StateName(next, i) + " in mode '" + system_.ModeName(next) +
                  "'");
  }
  afters_.push_back(tape_.Keep(next_state_.data(), system_.state_size(next)));
  events_.push_back({at_.t, mode, guard, next, rate, {}, {}, immediate, functions_.IsSwitch(mode, guard)});
  std::copy_n(next_state_.begin(), system_.state_size(next), at_.x.begin());
  at_.mode = next;
  return true;
}

// Moves from at_ to a time of the grid, through all events in between.
bool RolloutRun::StepTo(int node) {
  const double target = input_->begin + input_->duration * tape_.Fraction(node);
  for (;;) {
    if (InterruptGuard::GraceIsOver() || (options_.stop && options_.stop()))
      return Refuse("interrupted in " + DescribeTime());
    const int n = system_.state_size(at_.mode), num_guards = system_.num_guards(at_.mode);
    const FlowStep step = StepFrom(std::max(target - at_.t, 0.0));
    search_.integrator().Step(step, at_.slope.data(), next_state_.data(), next_slope_.data());
    const FlowStep end{{step.mode, target, next_state_.data(), step.u, step.p}, 0};
    double zero = 0;  // unless a number is not finite
    for (int i = 0; i < n; ++i) zero += 0 * next_state_[i] + 0 * next_slope_[i];
    if (zero != 0) return FailAt(step);
    functions_.GuardRates(end, next_slope_.data(), next_guards_.data());
    for (int guard = 0; guard < num_guards; ++guard) {
      if (std::isfinite(next_guards_[guard].value)) continue;
      Refuse(QualifiedGuardName(at_.mode, guard) + " is not a finite number in " + DescribeTime());
      if (functions_.Projects(at_.mode)) failure_time_ = target;  // to which a step that is too long may lead
      return false;
    }
    if (compare_guards_) CompareGuards(step);
    PendingEvent due = EarliestEvent(step, next_guards_);
    if (due.guard < 0 && node == tape_.num_nodes) {
      // An event so shortly after the end that rounding decides is one at the end.
      for (int guard = 0; guard < num_guards && due.guard < 0; ++guard) {
        const GuardValue& last = next_guards_[guard];
        if (at_.armed[guard] == 0 || at_.armed[guard] == kHeld || last.value > kNear * -last.rate * input_->duration)
          continue;
        const double window = search_.WindowOf(end, guard, last.rate, Elapsed(target)).integrated;
        if (last.rate < 0 && last.value <= window) due = {guard, step.h};
      }
    }
    if (due.guard >= 0) {
      if (!TakeEvent(due, step)) return false;
      continue;
    }
    Record(TapeEntry::Kind::kToNode, step.h).node = node;
    if (functions_.Projects(at_.mode)) {
      if (!SatisfiesEquations()) return false;
      at_.t = target;
      std::swap(at_.x, state_within_);
      if (!UpdateSlope()) return false;
    } else {
      at_.t = target;
      std::swap(at_.x, next_state_);
      std::swap(at_.slope, next_slope_);
    }
    bool leaves = false;  // a switch on whose zero it was
    for (int guard = 0; guard < num_guards; ++guard) {
      if (at_.armed[guard] == kHeld) {
        leaves = leaves || next_guards_[guard].value != at_.guards[guard].value;
      } else {
        at_.armed[guard] = at_.armed[guard] || next_guards_[guard].value > 0;
      }
      at_.at_zero[guard] = at_.at_zero[guard] && !at_.armed[guard];
      at_.guards[guard] = next_guards_[guard];
    }
    return !leaves || EnterMode(Entry::kAfterReset);
  }
}

// Projects next_state_, at the end of a step from at_, onto the equations of a mode with closed contacts:
// state_within_. A step that ends far off them is too long for the flow.
bool RolloutRun::SatisfiesEquations() {
  functions_.Project(at_.mode, next_state_.data(), input_->parameters.data(), state_within_.data());
  double change = 0, off = 0;
  for (int i = 0; i < system_.state_size(at_.mode); ++i) {
    change = std::max(change, std::abs(next_state_[i] - at_.x[i]));
    off = std::max(off, std::abs(state_within_[i] - next_state_[i]));
    largest_ = std::max(largest_, std::abs(at_.x[i]));
  }
  if (off <= kOffEquations * change || off <= kOnEquations * largest_) return true;
  Refuse("the steps of the integration are too long in " + DescribeTime() + ": one ends " + ToText(off, 2) +
         " off the equations of its closed contacts. Take more steps per interval, or let their number be chosen");
  end_ = RolloutEnd::kNotFinite;
  return false;
}

// The point within a step is at another part of each, as a guard may have the period of the steps. The state there is
// the cubic through states and slopes at the ends, as accurate as the guard's own.
void RolloutRun::CompareGuards(const FlowStep& step) {
  // The guards of closed contacts are as smooth as their flow, except for the split of forces that are not unique,
  // which may jump.
  if (!(step.h > 0) || functions_.Projects(step.mode)) return;
  constexpr double kGolden = 0.6180339887498949;
  double whole = 0;
  const double a = 0.1 + 0.8 * std::modf(kGolden * static_cast<double>(tape_.entries.size()), &whole), b = 1 - a;
  FlowStep within = step;
  within.h = a * step.h;
  if (functions_.Fly(within, state_within_.data(), nullptr)) {
    unresolved_.flies = true;
  } else {
    for (int i = 0; i < system_.state_size(step.mode); ++i) {
      state_within_[i] = b * b * (1 + 2 * a) * at_.x[i] + a * a * (1 + 2 * b) * next_state_[i] +
                         a * b * step.h * (b * at_.slope[i] - a * next_slope_[i]);
    }
  }
  within.x = state_within_.data();
  within.t += within.h;
  for (int guard = 0; guard < system_.num_guards(step.mode); ++guard) {
    const GuardValue &begin = at_.guards[guard], &end = next_guards_[guard];
    const double third = step.h / 3;
    const double size =
        std::abs(begin.value) + std::abs(end.value) + step.h * (std::abs(begin.rate) + std::abs(end.rate));
    const double off = std::abs(functions_.Guard(within, guard) - Hermite(begin, end, step.h)(within.h));
    if (off <= kResolved * size) continue;
    // The cubic lies between the smallest and the largest of its Bezier coefficients.
    const auto [least, most] =
        std::minmax({begin.value, begin.value + third * begin.rate, end.value - third * end.rate, end.value});
    if (least > kHides * off || most < -kHides * off || off <= kRoundingOfGuard * search_.Scale(within, guard))
      continue;
    if (unresolved_.steps++ > 0) return;
    unresolved_.what = QualifiedGuardName(step.mode, guard) + " changes faster than the steps resolve, in " +
                       DescribeTime() + ": its events may be missed";
    return;
  }
}

bool RolloutRun::ResolvesGuards() const {
  const int most = unresolved_.flies ? kFlownSteps : kResolvedSteps;
  return unresolved_.steps == 0 || (tape_.num_nodes >= most && unresolved_.steps * kPlaces <= tape_.num_nodes);
}

// Whether the last grazing that was noted is that of this guard, about this time.
bool RolloutRun::IsLastGrazing(int mode, int guard, double time) const {
  return !grazings_.empty() && grazings_.back().guard == guard && grazings_.back().mode == mode &&
         time - grazings_.back().time <= 1e-6 * input_->duration;
}

// Whether the flows on both sides of a switch differ at a point.
bool RolloutRun::FlowJumpsAt(const ModePoint& at, int guard) const {
  ModePoint behind = at;
  behind.mode = functions_.AdjacentPiece(at, guard, HybridFunctions::Side::kOther);
  if (behind.mode < 0) return true;
  Eigen::VectorXd slope(system_.state_size(at.mode)), other = slope;
  functions_.Flow(at, slope.data());
  functions_.Flow(behind, other.data());
  const double largest = std::max(slope.lpNorm<Eigen::Infinity>(), other.lpNorm<Eigen::Infinity>());
  return (slope - other).lpNorm<Eigen::Infinity>() > kSameSlope * largest;
}

// Whether a switch at which the flow jumps, and that a step meets where the control jumps, rises under the next
// control, on both of its sides: the motion touches the switch and returns.
bool RolloutRun::TurnsBackWithControl(const FlowStep& step, int guard, double s) {
  if (!functions_.IsSwitch(step.mode, guard)) return false;
  const int next = ControlJumpNear(*input_, system_.num_controls(), step.t + s, kAtJump);
  if (next != interval_ + 1) return false;
  FlowStep point = search_.PointAfter(step, at_.slope.data(), s);
  point.u = input_->control.data() + static_cast<std::ptrdiff_t>(next) * system_.num_controls();
  const FlowStep here = point;
  if (!FlowJumpsAt(here, guard)) return false;
  for (const int mode : {step.mode, functions_.AdjacentPiece(here, guard, HybridFunctions::Side::kOther)}) {
    if (mode < 0) return false;
    point.mode = mode;
    std::vector<double> slope(system_.state_size(mode));
    functions_.Flow(point, slope.data());
    if (!(search_.GuardAt(here, slope.data(), guard).rate > 0)) return false;
  }
  return true;
}

// Returns the earliest event of the armed guards in a step; guards that graze are noted, and disarmed if they end at 0.
RolloutRun::PendingEvent RolloutRun::EarliestEvent(const FlowStep& step, const std::vector<GuardValue>& end) {
  PendingEvent earliest;
  for (int guard = 0; guard < system_.num_guards(step.mode); ++guard) {
    const GuardValue& begin = at_.guards[guard];
    if (at_.armed[guard] == kHeld) continue;
    if (at_.armed[guard] && end[guard].value > 0 && !(begin.rate <= 0 && end[guard].rate >= 0) &&
        !search_.MayReturn(step, guard, begin, end[guard])) {
      continue;
    }
    bool sinks = false;
    EventSearch::GuardCrossing found = search_.Find(step, at_.slope.data(), guard, at_.armed[guard], begin, end[guard]);
    if (found.kind == EventSearch::GuardCrossing::Kind::kNothing && at_.at_zero[guard]) {
      found = search_.FindSinking(step, at_.slope.data(), guard, begin, end[guard], Elapsed(step.t));
      sinks = found.kind == EventSearch::GuardCrossing::Kind::kEvent;
    }
    const bool turns_back =
        found.kind == EventSearch::GuardCrossing::Kind::kEvent && TurnsBackWithControl(step, guard, found.s);
    if (found.kind == EventSearch::GuardCrossing::Kind::kEvent && !turns_back) {
      if (earliest.guard < 0 || found.s < earliest.s) earliest = {guard, found.s, sinks};
    } else if (found.kind == EventSearch::GuardCrossing::Kind::kGrazing || turns_back) {
      if (end[guard].value <= 0) {  // the next step tells whether it returns
        at_.armed[guard] = false;
        at_.at_zero[guard] = true;
      }
      const double time = step.t + found.s;
      if (!IsLastGrazing(step.mode, guard, time)) grazings_.push_back({time, step.mode, guard});
    }
  }
  // A guard with a kink, or behind a change of mode, may fall below zero and return: where it is below at the event of
  // another, its own comes first.
  for (bool found = earliest.guard >= 0; found;) {
    found = false;
    FlowStep part = step;
    part.h = earliest.s;
    for (int guard = 0; guard < system_.num_guards(step.mode) && !found; ++guard) {
      if (guard == earliest.guard || at_.armed[guard] == kHeld) continue;
      if (at_.armed[guard] && !(at_.guards[guard].value > 0)) continue;
      const GuardValue then = search_.GuardAfter(step, at_.slope.data(), guard, part.h);
      if (then.value >= 0) continue;
      const FlowStep point = search_.PointAfter(step, at_.slope.data(), part.h);
      if (then.value >= -search_.WindowOf(point, guard, then.rate, Elapsed(point.t)).integrated) continue;
      const EventSearch::GuardCrossing before =
          search_.Find(part, at_.slope.data(), guard, at_.armed[guard], at_.guards[guard], then);
      found = before.kind == EventSearch::GuardCrossing::Kind::kEvent && before.s < earliest.s;
      if (found) earliest = {guard, before.s};
    }
  }
  return earliest;
}

// Whether a guard is itself a switch where both are at zero: in all motions nearby they reach zero together, to first
// order; and the guard goes on falling on the other side of the switch, unlike |x|, which only touches zero.
bool RolloutRun::IsItsSwitch(int guard, int its_switch) const {
  FlowStep here = StepFrom(0);
  if (!AreParallel(here, guard, here, its_switch)) return false;
  here.mode = functions_.AdjacentPiece(here, its_switch, HybridFunctions::Side::kOther);
  if (here.mode < 0) return false;
  std::vector<double> slope(system_.state_size(here.mode));
  functions_.Flow(here, slope.data());
  return search_.GuardAt(here, slope.data(), guard).rate < 0;
}

// The guards that reach zero with the one that is due, where at_ is: within the errors of the integration. `first` is
// the guard that comes first, of those that rounding does not separate from the one that is due: a switch if there is
// one, as guards are then what they are on its other side, and else that of the smallest number. A guard that is itself
// the switch comes before it: its reset leads to the mode where the motion has passed the switch.
std::vector<int> RolloutRun::TiedGuards(const PendingEvent& due, int* first) {
  const FlowStep here = StepFrom(0);
  const double elapsed = Elapsed(at_.t);
  std::vector<int> tied;
  *first = due.guard;
  double rounding_of_due = -1;  // in time
  std::vector<GuardValue> all(system_.num_guards(at_.mode));
  functions_.GuardRates(here, at_.slope.data(), all.data());
  for (int guard = 0; guard < system_.num_guards(at_.mode); ++guard) {
    if (guard == due.guard) tied.push_back(guard);
    if (guard == due.guard || at_.armed[guard] == 0 || at_.armed[guard] == kHeld) continue;
    const GuardValue& value = all[guard];
    if (!(value.rate < 0) || std::abs(value.value) > kNear * -value.rate * input_->duration) continue;
    const EventSearch::Window error = search_.WindowOf(here, guard, value.rate, elapsed);
    if (std::abs(value.value) > 2 * error.integrated) continue;
    tied.push_back(guard);
    if (rounding_of_due < 0) {
      const double rate = all[due.guard].rate;
      rounding_of_due = rate < 0 ? search_.WindowOf(here, due.guard, rate, elapsed).rounding / -rate : 0;
    }
    if (std::abs(value.value) > error.rounding - value.rate * rounding_of_due) continue;
    const bool turns = functions_.IsSwitch(at_.mode, guard), other_turns = functions_.IsSwitch(at_.mode, *first);
    const bool precedes = turns == other_turns ? guard < *first
                          : turns              ? !IsItsSwitch(*first, guard)
                                               : IsItsSwitch(guard, *first);
    if (precedes) *first = guard;
  }
  return tied;
}

// Whether these are one guard and switches that reach zero with it in all motions nearby, to first order, so that their
// order is no question.
bool RolloutRun::AreGuardAndItsSwitches(const std::vector<int>& guards) const {
  const FlowStep here = StepFrom(0);
  const auto turns = [&](int guard) { return functions_.IsSwitch(at_.mode, guard); };
  return std::ranges::count_if(guards, turns) + 1 == std::ssize(guards) &&
         std::ranges::all_of(guards, [&](int guard) { return AreParallel(here, guards.front(), here, guard); });
}

bool RolloutRun::TakeEvent(const PendingEvent& due, const FlowStep& step) {
  FlowStep part = step;
  part.h = due.s;
  Coincidence coincidence;
  coincidence.begin = tape_.entries.size();
  Record(TapeEntry::Kind::kToEvent, due.s);
  search_.integrator().Step(part, at_.slope.data(), next_state_.data(), next_slope_.data());
  if (functions_.Projects(at_.mode) && !SatisfiesEquations()) return false;
  std::copy_n(next_state_.begin(), system_.state_size(at_.mode), at_.x.begin());
  at_.t = std::min(step.t + due.s, step.t + step.h);
  if (!UpdateSlope()) return false;
  int first = due.guard;
  coincidence.guards = TiedGuards(due, &first);
  first = functions_.CauseOf(StepFrom(0), first);
  tape_.entries.back().guard = first;
  const std::string name = QualifiedGuardName(at_.mode, first);
  if (coincidence.guards.size() > 1) {
    coincidence.tie = static_cast<int>(ties_.size());
    const HybridTie& tie = ties_.emplace_back(HybridTie{.time = at_.t, .mode = at_.mode, .guards = coincidence.guards});
    coincidence.remark = RemarkOnTie(system_,
                                     tie,
                                     ControlJumpNear(*input_, system_.num_controls(), at_.t, kAtJump) > 0
                                         ? "the control jumps: the derivatives depend on the order of all these"
                                         : "the derivatives depend on the order of their events");
  }
  if (due.sinks) {
    Remark(name + kSinks, kAtRateZero);
    if (IsLastGrazing(step.mode, due.guard, at_.t)) grazings_.pop_back();
  }
  const double remaining = input_->begin + input_->duration - at_.t;
  coincidence.jump = ControlJumpNear(*input_, system_.num_controls(), at_.t, kAtJump);
  const bool control_jumps = coincidence.jump > 0;
  if (!control_jumps && std::ranges::count(DependenceOf(first).control, 1) > 0)
    coincidence.jump = IntervalBeginNear(*input_, at_.t, kAtJump);
  const GuardValue at_event = search_.GuardAt(StepFrom(0), at_.slope.data(), first);
  const bool turns = functions_.IsSwitch(at_.mode, first);
  const bool at_end = remaining <= kNear * input_->duration &&
                      remaining * std::abs(at_event.rate) <=
                          search_.WindowOf(StepFrom(0), first, at_event.rate, Elapsed(at_.t)).integrated;
  if (at_end) {
    for (const int guard : coincidence.guards) {
      const std::string its_name = QualifiedGuardName(at_.mode, guard);
      if (!functions_.IsSwitch(at_.mode, guard)) {
        Remark(its_name + " has an event at the final time");
      } else if (FlowJumpsAt(StepFrom(0), guard)) {
        Remark(its_name + ", at which the flow jumps, is zero at the final time");
      }
    }
    coincidence.jump = -1;
  } else if (coincidence.jump > 0 && (coincidence.remark.empty() || AreGuardAndItsSwitches(coincidence.guards))) {
    coincidence.tie = -1;
    coincidence.remark = {name + " has an event",
                          at_.t,
                          control_jumps ? ", where the control jumps"
                                        : ", where the next interval of the control begins, which it reads"};
  }
  const std::size_t begin = coincidence.begin, events = events_.size(), number = tape_.coincidences.size();
  const std::optional<double> accumulation = accumulation_;
  tape_.coincidences.push_back(std::move(coincidence));
  const int mode = at_.mode, first_switch = system_.num_guards(mode) - functions_.num_switches(mode);
  const std::vector<char> were_armed = turns ? at_.armed : std::vector<char>();
  if (!ApplyReset(first, false, false) || !EnterMode(Entry::kAfterReset)) return false;
  if (turns && events_.size() == events + 1) {
    // Guards that a switch leaves at zero: they touch it, and do not fall through.
    for (int guard = 0; guard < first_switch; ++guard) {
      if (were_armed[guard] && !at_.armed[guard]) grazings_.push_back({at_.t, mode, guard});
    }
  }
  const bool accumulates = accumulation_ != accumulation;
  TimedRemark& remark = tape_.coincidences[number].remark;
  if (remark.empty() && accumulates) {
    remark = {name + " has events without time passing", at_.t, ", of which the derivative is one-sided"};
  } else if (remark.empty() && events_.size() > events + 1 && !events_[events + 1].is_switch &&
             tape_.entries[begin + 2].kind == TapeEntry::Kind::kToEvent) {
    const HybridEvent& onto = events_[events + 1];
    remark = {"the reset", at_.t, " leads onto guard '" + system_.GuardName(onto.mode, onto.guard) + "'"};
  }
  if (remark.empty()) {
    tape_.coincidences.pop_back();
  } else {
    tape_.coincidences[number].end = tape_.entries.size();
  }
  return accumulates || !Accumulates(step.t + step.h);
}

// Goes on in the mode that the system names where the events of a guard accumulate; refuses without one.
bool RolloutRun::ContinueAfterAccumulation(double time, int mode, int guard, const std::string& why) {
  accumulations_at_once_ = accumulation_ == time ? accumulations_at_once_ + 1 : 0;
  accumulation_ = time;
  const int next = functions_.OnAccumulation(mode, guard);
  if (next < 0) return Refuse(why + DescribeContinuations(mode, guard));
  if (accumulations_at_once_ > system_.num_modes()) {
    return Refuse(why + "; the modes that OnAccumulation names lead to such events again. Name a mode without them");
  }
  if (next >= system_.num_modes() || system_.state_size(next) != system_.state_size(at_.mode)) {
    return Refuse(why + "; OnAccumulation names mode " + std::to_string(next) +
                  ", expected one with states of the same size");
  }
  at_.mode = events_.back().next_mode = next;
  return EnterMode(Entry::kAfterReset);
}

// Moves from the last event to where events accumulate: components of the state that converge go on to their limit.
void RolloutRun::MoveToAccumulation(int period, double time) {
  const int last = static_cast<int>(events_.size()) - 1;
  const auto after = [&](int back) { return &tape_.numbers[afters_[last - back * period]]; };
  const auto mode_after = [&](int back) { return events_[last - back * period].next_mode; };
  if (mode_after(1) != mode_after(0) || mode_after(2) != mode_after(0)) return;
  for (int i = 0; i < system_.state_size(at_.mode); ++i) {
    const double change = after(0)[i] - after(1)[i], before = after(1)[i] - after(2)[i];
    if (std::abs(change) < kShrinks * std::abs(before)) at_.x[i] -= change * change / (change - before);
  }
  at_.t = std::max(at_.t, time);
}

// Whether the motion ends because events accumulate at a point before its end: the intervals between them, or those
// over two, have become tiny and shrink geometrically. The point is Aitken's extrapolation, exact for a geometric
// sequence. The motion goes on from there, at `until` at the latest, where the step that has these events ends.
bool RolloutRun::Accumulates(double until) {
  if (functions_.EndsAccumulations()) return false;
  const auto count = static_cast<int>(events_.size());
  for (int period = 1; period <= 2; ++period) {
    if (count < (kShrinking + 2) * period) continue;
    const auto interval = [&](int back) {
      const int last = count - 1 - back * period;
      return events_[last].time - events_[last - period].time;
    };
    if (!(interval(0) <= kAccumulated * input_->duration)) continue;
    bool shrinks = true;
    for (int back = 0; back < kShrinking && shrinks; ++back) shrinks = interval(back) < kShrinks * interval(back + 1);
    if (!shrinks) continue;
    const double ratio = interval(0) / interval(1);
    const double point = at_.t + interval(0) * ratio / (1 - ratio);
    if (!(point < input_->begin + input_->duration)) continue;
    MoveToAccumulation(period, std::min(point, until));
    const HybridEvent& last = events_.back();
    return !ContinueAfterAccumulation(point,
                                      last.mode,
                                      last.guard,
                                      "events accumulate (Zeno behaviour) at about t = " + ToText(point, 16) + ", of " +
                                          QualifiedGuardName(last.mode, last.guard) + " in mode '" +
                                          system_.ModeName(last.mode) + "'");
  }
  return false;
}

}  // namespace saltus
