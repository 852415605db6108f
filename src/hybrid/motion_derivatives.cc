#include "hybrid/motion_derivatives.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/number_text.h"
#include "base/random.h"

namespace saltus {
namespace {

void AddTo(std::vector<double>* sum, const std::vector<double>& addend) {
  CHECK_EQ(addend.size(), sum->size()) << "a cotangent of another size than what it is of";
  for (std::size_t i = 0; i < addend.size(); ++i) (*sum)[i] += addend[i];
}

}  // namespace

MotionDerivatives::MotionDerivatives(const HybridSystem& system) : system_(system), integrator_(system.functions()) {
  const int most = system.functions().most_states();
  state_.resize(most);
  by_length_.resize(most);
  guard_.resize(most + 1 + system.num_parameters() + system.num_controls());
  reset_.resize(most * (most + 1 + system.num_parameters()));
}

FlowStep MotionDerivatives::StepOf(const HybridInput& input, const MotionTape& tape, const TapeEntry& entry) const {
  const double* u = input.control.data() + entry.interval * system_.num_controls();
  const bool projects = entry.kind == TapeEntry::Kind::kToNode && system_.functions().Projects(entry.mode);
  return {{entry.mode, entry.t, &tape.numbers[entry.x], u, input.parameters.data()}, entry.h, projects};
}

HybridGradient MotionDerivatives::Adjoint(const HybridInput& input, const MotionTape& tape,
                                          const std::vector<HybridEvent>& events, const HybridCotangent& cotangent) {
  const HybridFunctions& f = system_.functions();
  const int num_parameters = system_.num_parameters(), num_controls = system_.num_controls();
  HybridGradient gradient;
  gradient.control.assign(static_cast<std::size_t>(input.num_intervals) * num_controls, 0.0);
  gradient.parameters.assign(num_parameters, 0.0);
  // Cotangents of state and time at the end of the entry at hand.
  std::vector<double> x(system_.state_size(tape.final_mode));
  if (!cotangent.final_state.empty()) AddTo(&x, cotangent.final_state);
  double t = 0;
  int interval = input.num_intervals;
  for (std::size_t i = tape.entries.size(); i-- > 0;) {
    const TapeEntry& entry = tape.entries[i];
    FlowStep step = StepOf(input, tape, entry);
    step.by_parameters = cotangent.by_parameters;
    const int n = system_.state_size(entry.mode);
    if (entry.kind == TapeEntry::Kind::kReset) {
      if (!cotangent.after.empty() && !cotangent.after[entry.event].empty()) {
        AddTo(&x, cotangent.after[entry.event]);
      }
      if (!cotangent.event_times.empty()) t += cotangent.event_times[entry.event];
      const int columns = n + 1 + num_parameters;
      f.ResetJacobian(step, entry.guard, state_.data(), reset_.data());
      std::vector<double> before(n);
      for (std::size_t row = 0; row < x.size(); ++row) {
        const double* jacobian = &reset_[row * columns];
        for (int j = 0; j < n; ++j) before[j] += x[row] * jacobian[j];
        t += x[row] * jacobian[n];
        for (int j = 0; j < num_parameters; ++j) gradient.parameters[j] += x[row] * jacobian[n + 1 + j];
      }
      x = std::move(before);
      if (!cotangent.before.empty() && !cotangent.before[entry.event].empty()) {
        AddTo(&x, cotangent.before[entry.event]);
      }
    } else {
      StepCotangent back{x.data(),
                         0,
                         0,
                         gradient.parameters.data(),
                         gradient.control.data() + static_cast<std::ptrdiff_t>(entry.interval) * num_controls};
      if (entry.kind == TapeEntry::Kind::kToEvent) {
        // The next entry is its reset, at the state and time where the guard is zero.
        const TapeEntry& at = tape.entries[i + 1];
        f.GuardGradient({entry.mode, at.t, &tape.numbers[at.x], step.u, step.p}, entry.guard, guard_.data());
        integrator_.Linearize(step);
        integrator_.LengthDerivative(by_length_.data());
        double along = t, rate = guard_[n];
        for (int j = 0; j < n; ++j) {
          along += x[j] * by_length_[j];
          rate += guard_[j] * by_length_[j];
        }
        const double multiplier = -along / rate;
        for (int j = 0; j < n; ++j) x[j] += multiplier * guard_[j];
        t += multiplier * guard_[n];
        for (int j = 0; j < num_parameters; ++j) back.p[j] += multiplier * guard_[n + 1 + j];
        for (int j = 0; j < num_controls; ++j) back.u[j] += multiplier * guard_[n + 1 + num_parameters + j];
        integrator_.PullBack(step, x.data(), &back);
        t += back.t;
      } else {
        integrator_.PullBack(step, x.data(), &back);
        gradient.duration += (t + back.h) * tape.Fraction(entry.node);
        t = back.t - back.h;
      }
    }
    while (interval > 0 && tape.intervals[interval - 1] == i) {
      --interval;
      if (!cotangent.nodes.empty() && !cotangent.nodes[interval].empty()) AddTo(&x, cotangent.nodes[interval]);
    }
  }
  CHECK_EQ(events.size(), cotangent.event_times.empty() ? events.size() : cotangent.event_times.size());
  gradient.initial = std::move(x);
  if (!cotangent.by_parameters) std::ranges::fill(gradient.parameters, 0.0);
  return gradient;
}

// Takes the tangent of state and time at the beginning of an entry to its end, given that of the duration.
void MotionDerivatives::PushForward(const HybridInput& input, const MotionTape& tape, const TapeEntry& entry,
                                    const Eigen::RowVectorXd& of_duration, RungeKutta::Tangent* at) {
  using Matrix = RungeKutta::Matrix;
  const HybridFunctions& f = system_.functions();
  const int num_parameters = system_.num_parameters(), num_controls = system_.num_controls();
  FlowStep step = StepOf(input, tape, entry);
  step.by_parameters = !at->p.isZero(0);
  const int n = system_.state_size(entry.mode);
  const Eigen::Index columns = at->x.cols();
  if (entry.kind == TapeEntry::Kind::kReset) {
    const int next = f.ResetJacobian(step, entry.guard, state_.data(), reset_.data());
    const int rows = system_.state_size(next);
    const Eigen::Map<const Matrix> jacobian(reset_.data(), rows, n + 1 + num_parameters);
    Matrix after = jacobian.leftCols(n) * at->x + jacobian.col(n) * at->t + jacobian.rightCols(num_parameters) * at->p;
    at->x = std::move(after);
    return;
  }
  integrator_.Linearize(step);
  const Eigen::RowVectorXd from = at->t;
  if (entry.kind == TapeEntry::Kind::kToNode) {
    const Eigen::RowVectorXd of_end = tape.Fraction(entry.node) * of_duration;
    at->h = of_end - at->t;
    at->x = integrator_.PushForward(*at);
    at->t = of_end;
    return;
  }
  const TapeEntry& reset = (&entry)[1];
  f.GuardGradient({entry.mode, reset.t, &tape.numbers[reset.x], step.u, step.p}, entry.guard, guard_.data());
  const Eigen::Map<const Eigen::RowVectorXd> guard(guard_.data(), n + 1 + num_parameters + num_controls);
  integrator_.LengthDerivative(by_length_.data());
  const Eigen::Map<const Eigen::VectorXd> by_length(by_length_.data(), n);
  at->h = Eigen::RowVectorXd::Zero(columns);
  const Matrix fixed = integrator_.PushForward(*at);  // for a fixed length
  const double rate = guard.head(n) * by_length + guard[n];
  at->h = -(guard.head(n) * fixed + guard[n] * at->t + guard.segment(n + 1, num_parameters) * at->p +
            guard.tail(num_controls) * at->u) /
          rate;
  at->x = fixed + by_length * at->h;
  at->t = from + at->h;
}

HybridSensitivity MotionDerivatives::Sensitivity(const HybridInput& input, const MotionTape& tape,
                                                 const std::vector<HybridEvent>& events, bool by_parameters) {
  using Matrix = RungeKutta::Matrix;
  const int num_parameters = system_.num_parameters(), num_controls = system_.num_controls();
  const int n0 = system_.state_size(input.mode), all_controls = input.num_intervals * num_controls;
  const int columns = n0 + all_controls + num_parameters + 1;
  HybridSensitivity out;
  out.columns = columns;
  out.after.resize(events.size());
  out.times.resize(events.size());
  RungeKutta::Tangent at;
  at.x = Matrix::Zero(n0, columns);
  at.x.leftCols(n0).setIdentity();
  at.t = Eigen::RowVectorXd::Zero(columns);
  at.p = Matrix::Zero(num_parameters, columns);
  if (by_parameters) at.p.middleCols(n0 + all_controls, num_parameters).setIdentity();
  const Eigen::RowVectorXd of_duration = Eigen::RowVectorXd::Unit(columns, columns - 1);
  for (const TapeEntry& entry : tape.entries) {
    if (out.nodes.size() < tape.intervals.size() &&
        &entry - tape.entries.data() == static_cast<std::ptrdiff_t>(tape.intervals[out.nodes.size()])) {
      out.nodes.emplace_back(at.x.data(), at.x.data() + at.x.size());
    }
    at.u = Matrix::Zero(num_controls, columns);
    at.u.middleCols(n0 + entry.interval * num_controls, num_controls).setIdentity();
    PushForward(input, tape, entry, of_duration, &at);
    if (entry.kind != TapeEntry::Kind::kReset) continue;
    out.after[entry.event].assign(at.x.data(), at.x.data() + at.x.size());
    out.times[entry.event].assign(at.t.data(), at.t.data() + columns);
  }
  out.final_state.assign(at.x.data(), at.x.data() + at.x.size());
  return out;
}

// The state after two halves of a step, less that after the whole; zero where it is rounding. Raises *relative to it.
Eigen::VectorXd MotionDerivatives::CompareWithHalfSteps(const FlowStep& step, const double* after, double* relative) {
  constexpr double kRounding = 4e-15;  // of the largest of both states
  using Vector = Eigen::VectorXd;
  const int n = system_.state_size(step.mode);
  const Eigen::Map<const Vector> whole(after, n);
  Vector middle(n), end(n);
  FlowStep half = step;
  half.h = 0.5 * step.h;
  half.projects = false;
  integrator_.Step(half, middle.data());
  half.t += half.h;
  half.x = middle.data();
  half.projects = step.projects;
  integrator_.Step(half, end.data());
  const Eigen::Map<const Vector> before(step.x, n);
  const double size = std::max(whole.lpNorm<Eigen::Infinity>(), before.lpNorm<Eigen::Infinity>());
  Vector change = end - whole;
  for (double& number : change) {
    if (std::abs(number) <= kRounding * size) number = 0;
    const double part = number == 0 ? 0 : std::abs(number) / size;
    *relative = std::max(*relative, std::isfinite(part) ? part : std::numeric_limits<double>::infinity());
  }
  return change;
}

// The change of the state is carried on by differences: a step costs another step, where its Jacobian costs several.
MotionDerivatives::Change MotionDerivatives::CompareWithHalvedCutSteps(const HybridInput& input, const MotionTape& tape,
                                                                       std::size_t num_events) {
  constexpr double kPart = 1e-7;  // of the size of the state: a change of it by which differences are taken
  using Vector = Eigen::VectorXd;
  const HybridFunctions& f = system_.functions();
  Change out{.final_state = Vector::Zero(system_.state_size(input.mode)), .times = std::vector<double>(num_events)};
  Vector& x = out.final_state;
  double t = 0;
  for (std::size_t i = 0; i < tape.entries.size(); ++i) {
    const TapeEntry& entry = tape.entries[i];
    const bool is_last = i + 1 == tape.entries.size(),
               begins = i > 0 && tape.entries[i - 1].kind == TapeEntry::Kind::kReset;
    FlowStep step = StepOf(input, tape, entry);
    const double* after = &tape.numbers[is_last ? tape.final_state : tape.entries[i + 1].x];
    const int n = system_.state_size(entry.mode);
    const bool changes = !x.isZero(0) || t != 0;
    if (entry.kind == TapeEntry::Kind::kReset) {
      Vector next = Vector::Zero(system_.state_size(is_last ? tape.final_mode : tape.entries[i + 1].mode));
      if (changes) {
        out.times[entry.event] = t;
        f.ResetJacobian(step, entry.guard, state_.data(), reset_.data());
        const Eigen::Map<const RungeKutta::Matrix> jacobian(
            reset_.data(), next.size(), n + 1 + system_.num_parameters());
        next = jacobian.leftCols(n) * x + jacobian.col(n) * t;
      }
      x = std::move(next);
      continue;
    }
    Vector change = Vector::Zero(n);
    if (entry.h > 0 && (begins || entry.kind == TapeEntry::Kind::kToEvent))
      change = CompareWithHalfSteps(step, after, &out.of_steps);
    const bool ends = entry.kind == TapeEntry::Kind::kToEvent;
    if (changes) {
      const Eigen::Map<const Vector> before(step.x, n), whole(after, n);
      const double size = std::max(before.norm(), whole.norm()),
                   moved = std::max(x.norm(), std::abs(t) * size / input.duration);
      const double part = size > 0 ? kPart * size / moved : 1;
      const Vector beside = before + part * x;
      step.x = beside.data();
      step.t += part * t;
      if (!ends) step.h -= part * t;
      integrator_.Step(step, state_.data());
      change += (Eigen::Map<const Vector>(state_.data(), n) - whole) / part;
    }
    x = std::move(change);
    if (!ends) t = 0;
    if (!ends || (x.isZero(0) && t == 0)) continue;
    const TapeEntry& at = tape.entries[i + 1];
    const ModePoint event{at.mode, at.t, &tape.numbers[at.x], step.u, step.p};
    f.GuardGradient(event, entry.guard, guard_.data());
    f.Flow(event, by_length_.data());
    const Eigen::Map<const Vector> slope(by_length_.data(), n), gradient(guard_.data(), n);
    const double later = -(gradient.dot(x) + guard_[n] * t) / (gradient.dot(slope) + guard_[n]);
    x += slope * later;
    t += later;
  }
  return out;
}

MotionDerivatives::Directions MotionDerivatives::MakeDirections(const HybridInput& input) const {
  const int n0 = system_.state_size(input.mode), num_parameters = system_.num_parameters();
  // Directions: two of all inputs, one in their own units; and of each kind of input alone.
  constexpr int kDirections = 5;
  NormalStream random(1);
  const auto directions = [&](const std::vector<double>& values, int size, int kind) {
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(size, kDirections);
    for (int i = 0; i < size; ++i) {
      for (const int column : {0, 1, kind}) out(i, column) = random.Next();
      if (values[i] != 0) out(i, 1) *= std::abs(values[i]);
    }
    return out;
  };
  Directions out;
  out.controls = directions(input.control, input.num_intervals * system_.num_controls(), 2);
  out.begin.x = directions(input.initial, n0, 3);
  out.begin.p = directions(input.parameters, num_parameters, 4);
  out.begin.t = Eigen::RowVectorXd::Zero(kDirections);
  out.duration = directions({input.duration}, 1, 2);
  return out;
}

std::vector<char> MotionDerivatives::FindOneSided(const HybridInput& input, const MotionTape& tape, TiedEvents* tied) {
  const int num_controls = system_.num_controls();
  const Directions directions = MakeDirections(input);
  RungeKutta::Tangent at = directions.begin, before;
  std::vector<char> one_sided;
  for (std::size_t i = 0; i < tape.entries.size() && one_sided.size() < tape.coincidences.size(); ++i) {
    const Coincidence& coincidence = tape.coincidences[one_sided.size()];
    at.u = directions.controls.middleRows(tape.entries[i].interval * num_controls, num_controls);
    PushForward(input, tape, tape.entries[i], directions.duration, &at);
    if (i == coincidence.begin) before = at;
    if (i + 1 == coincidence.end) {
      one_sided.push_back(
          IsOneSided(input, tape, coincidence, before, at, directions.controls, directions.duration, tied));
    }
  }
  return one_sided;
}

// The numbers that decide about the functions at a point, and are zero though the motion goes on: switches on whose
// zero it stays, and conditions on parameters and the control.
std::vector<std::string> MotionDerivatives::UndecidedAt(const ModePoint& at) const {
  const HybridFunctions& f = system_.functions();
  std::vector<std::string> names = f.UndecidedConditions(at);
  if (f.num_switches(at.mode) == 0) return names;
  std::vector<double> slope(system_.state_size(at.mode));
  f.Flow(at, slope.data());
  for (int guard = 0; guard < system_.num_guards(at.mode); ++guard) {
    if (StaysAtZero(at, guard, slope)) names.push_back(system_.GuardName(at.mode, guard));
  }
  return names;
}

bool MotionDerivatives::StaysAtZero(const ModePoint& at, int guard, const std::vector<double>& slope) const {
  const HybridFunctions& f = system_.functions();
  if (!f.IsSwitch(at.mode, guard) || f.IsOn(at.mode, guard)) return f.IsOn(at.mode, guard);
  double rate = 0;
  return f.GuardRate(at, guard, slope.data(), &rate) == 0 && rate == 0;
}

std::vector<MotionDerivatives::Kink> MotionDerivatives::FindKinks(const HybridInput& input, const MotionTape& tape) {
  const HybridFunctions& f = system_.functions();
  std::vector<std::vector<std::string>> undecided(tape.entries.size());
  bool any = false;
  for (std::size_t i = 0; i < tape.entries.size(); ++i) {
    const TapeEntry& entry = tape.entries[i];
    if (entry.kind == TapeEntry::Kind::kReset) {
      any = any || f.ResetMayBreak(entry.mode, entry.guard);
    } else if (entry.h > 0) {
      undecided[i] = UndecidedAt(StepOf(input, tape, entry));
      any = any || !undecided[i].empty();
    }
  }
  std::vector<Kink> kinks;
  if (!any) return kinks;
  const Directions directions = MakeDirections(input);
  RungeKutta::Tangent at = directions.begin;
  for (std::size_t i = 0; i < tape.entries.size() && at.x.allFinite(); ++i) {
    const TapeEntry& entry = tape.entries[i];
    const FlowStep step = StepOf(input, tape, entry);
    at.u = directions.controls.middleRows(entry.interval * system_.num_controls(), system_.num_controls());
    if (entry.kind == TapeEntry::Kind::kReset && f.ResetMayBreak(entry.mode, entry.guard)) {
      const auto reset = [&](const ModePoint& point) {
        Value after{0, Eigen::VectorXd::Zero(f.most_states())};
        after.mode = f.Reset(point, entry.guard, after.numbers.data());
        if (after.mode >= 0) after.numbers.conservativeResize(system_.state_size(after.mode));
        if (after.mode >= 0) after.mode = f.BaseMode(after.mode);
        return after;
      };
      f.ResetJacobian(step, entry.guard, state_.data(), reset_.data());
      if (HasKink(step, at, reset_.data(), false, reset)) kinks.push_back({i, Kink::kReset, {}});
    }
    const bool is_known = i > 0 && !kinks.empty() && kinks.back().names == undecided[i];
    if (!undecided[i].empty() && !is_known) {
      const auto flow = [&](const ModePoint& point) {
        Value slope{0, Eigen::VectorXd::Zero(system_.state_size(point.mode))};
        f.Flow(point, slope.numbers.data());
        return slope;
      };
      const auto n = static_cast<std::size_t>(system_.state_size(entry.mode));
      std::vector<double> slope(n), jacobian(n * guard_.size());
      f.FlowJacobian(step, slope.data(), jacobian.data());
      if (HasKink(step, at, jacobian.data(), true, flow)) kinks.push_back({i, Kink::kFlow, undecided[i]});
    }
    PushForward(input, tape, entry, directions.duration, &at);
    if (entry.kind != TapeEntry::Kind::kToEvent || f.IsSwitch(entry.mode, entry.guard)) continue;
    const ModePoint event = StepOf(input, tape, tape.entries[i + 1]);
    const std::vector<std::string> names = UndecidedAt(event);
    const auto guard = [&](const ModePoint& point) {
      return Value{0, Eigen::VectorXd::Constant(1, f.Guard(point, entry.guard))};
    };
    if (names.empty()) continue;
    f.GuardGradient(event, entry.guard, guard_.data());
    if (HasKink(event, at, guard_.data(), true, guard)) kinks.push_back({i, Kink::kGuard, names});
  }
  return kinks;
}

// The piece in which a motion is that is moved along a direction from one on whose switches it stays.
int MotionDerivatives::PieceBeside(ModePoint at, const RungeKutta::Tangent& directions, Eigen::Index column,
                                   double sign) {
  constexpr double kSame = 1e-9;  // of the terms of a change of a switch: no change
  const HybridFunctions& f = system_.functions();
  const Eigen::Index n = directions.x.rows(), num_parameters = directions.p.rows(), num_controls = directions.u.rows();
  Eigen::VectorXd along(n + 1 + num_parameters + num_controls), gradient(along.size());
  along << directions.x.col(column), directions.t[column], directions.p.col(column), directions.u.col(column);
  std::vector<double> slope(n);
  for (int turns = 0, guard = 0; turns < system_.num_guards(at.mode) && guard < system_.num_guards(at.mode); ++guard) {
    f.Flow(at, slope.data());
    if (!StaysAtZero(at, guard, slope)) continue;
    f.GuardGradient(at, guard, gradient.data());
    const double change = sign * gradient.dot(along);
    if (std::abs(change) <= kSame * gradient.cwiseAbs().dot(along.cwiseAbs())) continue;
    using Side = HybridFunctions::Side;
    const bool on = f.IsOn(at.mode, guard);
    if (!on && change > 0) continue;
    const int beside = f.AdjacentPiece(at, guard, !on ? Side::kOther : change > 0 ? Side::kAbove : Side::kBelow);
    if (beside < 0) return -1;
    at.mode = beside;
    guard = -1;  // the piece has its own switches
    ++turns;
  }
  return at.mode;
}

bool HasKinkAlong(const Eigen::VectorXd& here, const Eigen::VectorXd& slope, double size,
                  const std::function<std::optional<Eigen::VectorXd>(double)>& value) {
  constexpr double kBeside = 1e-6, kNearer = 1e-7;  // of the size
  constexpr double kChange = 1e-5, kRemains = 0.5;  // of the slopes, and of their difference at kBeside
  constexpr double kRounding = 1e-14;               // of the value
  double difference[2] = {}, known = 0;
  for (const int i : {0, 1}) {
    const double part = (i == 0 ? kBeside : kNearer) * size;
    std::vector<Eigen::VectorXd> slopes = {slope};
    for (const double moved : {-part, part}) {
      const std::optional<Eigen::VectorXd> there = value(moved);
      if (!there) return true;
      slopes.emplace_back((*there - here) / moved);
    }
    known = kRounding * here.lpNorm<Eigen::Infinity>() / part;
    for (const Eigen::VectorXd& one : slopes) {
      difference[i] = std::max(difference[i], (one - slope).lpNorm<Eigen::Infinity>());
      known = std::max(known, kChange * one.lpNorm<Eigen::Infinity>());
    }
  }
  return difference[0] > known && difference[1] > known && difference[1] >= kRemains * difference[0];
}

// Whether the slopes of a function along one of the directions differ from one side of a point to the other, or from
// its derivative there, and do not approach each other nearer to it. `jacobian`: by [x t p] or [x t p u], row by row.
// Functions that jump on a switch, as where it stops a motion, are compared on it alone.
bool MotionDerivatives::HasKink(const ModePoint& at, const RungeKutta::Tangent& directions, const double* jacobian,
                                bool reads_control, const std::function<Value(const ModePoint&)>& value) {
  constexpr double kSameValue = 1e-9;  // of the value, on both sides of a switch where it does not jump
  using Vector = Eigen::VectorXd;
  const Eigen::Map<const Vector> x(at.x, directions.x.rows()), p(at.p, directions.p.rows()),
      u(at.u, directions.u.rows());
  const Value here = value(at);
  if (here.mode < 0) return false;
  const Eigen::Index n = x.size(), columns = n + 1 + p.size() + (reads_control ? u.size() : 0);
  const Eigen::Map<const RungeKutta::Matrix> by(jacobian, here.numbers.size(), columns);
  Eigen::MatrixXd by_directions =
      by.leftCols(n) * directions.x + by.col(n) * directions.t + by.middleCols(n + 1, p.size()) * directions.p;
  if (reads_control) by_directions += by.rightCols(u.size()) * directions.u;
  if (!by_directions.allFinite()) return false;  // which is told as such
  for (Eigen::Index column = 0; column < directions.t.size(); ++column) {
    const double size =
        (1 + x.norm() + p.norm() + u.norm()) / (1 + directions.x.col(column).norm() + directions.p.col(column).norm() +
                                                directions.u.col(column).norm() + std::abs(directions.t[column]));
    const auto value_at = [&](int mode, double part) {
      const Vector moved = x + part * directions.x.col(column), moved_p = p + part * directions.p.col(column),
                   moved_u = u + part * directions.u.col(column);
      return value({mode, at.t + part * directions.t[column], moved.data(), moved_u.data(), moved_p.data()});
    };
    const int sides[] = {PieceBeside(at, directions, column, -1), PieceBeside(at, directions, column, 1)};
    const auto jumps = [&](int side) {
      if (side < 0) return true;
      const Value there = value_at(side, 0);
      return there.numbers.size() != here.numbers.size() ||
             (there.numbers - here.numbers).lpNorm<Eigen::Infinity>() >
                 kSameValue * (there.numbers.lpNorm<Eigen::Infinity>() + here.numbers.lpNorm<Eigen::Infinity>());
    };
    const bool moves = (sides[0] != at.mode || sides[1] != at.mode) && !std::ranges::any_of(sides, jumps);
    const auto beside = [&](double part) -> std::optional<Vector> {
      Value there = value_at(moves ? sides[part > 0 ? 1 : 0] : at.mode, part);
      if (there.mode != here.mode || there.numbers.size() != here.numbers.size()) return std::nullopt;
      return std::move(there.numbers);
    };
    if (HasKinkAlong(here.numbers, by_directions.col(column), size, beside)) return true;
  }
  return false;
}

void MotionDerivatives::Compare(const HybridInput& input, const MotionTape& tape, const Coincidence& coincidence,
                                TiedEvents* tied, HybridTie* tie) const {
  FlowStep at = StepOf(input, tape, tape.entries[coincidence.begin + 1]);
  at.h = tape.step;
  tied->Compare({at, at.t - input.begin, coincidence.guards}, tie);
}

bool MotionDerivatives::IsOneSided(const HybridInput& input, const MotionTape& tape, const Coincidence& coincidence,
                                   const RungeKutta::Tangent& before, const RungeKutta::Tangent& after,
                                   const Eigen::MatrixXd& controls, const Eigen::RowVectorXd& of_duration,
                                   TiedEvents* tied) {
  constexpr double kSame = 1e-7;          // of a change, relative to the terms that it is the sum of
  constexpr double kRounding = 1e-6;      // of the largest change of any direction
  constexpr std::size_t kManyGuards = 8;  // in two directions only
  const HybridFunctions& f = system_.functions();
  const int num_controls = system_.num_controls();
  const TapeEntry& first = tape.entries[coincidence.begin + 1];
  const bool ends = coincidence.end == tape.entries.size();
  const int end_mode = ends ? tape.final_mode : tape.entries[coincidence.end].mode;
  const double* end_state = &tape.numbers[ends ? tape.final_state : tape.entries[coincidence.end].x];
  const int end_size = system_.state_size(end_mode);
  // The changes compared are those at one time, of a motion continued under the control before a jump, or after it.
  const double* u = input.control.data() + static_cast<std::ptrdiff_t>(first.interval) * num_controls;
  const bool jumps = coincidence.jump > 0, jumped = jumps && first.interval == coincidence.jump;
  const double* const before_jump = jumped ? u - num_controls : u;
  const double* const after_jump = jumps && !jumped ? u + num_controls : u;
  const auto slope_of = [&](int mode, const double* x, const double* control) {
    Eigen::VectorXd slope(system_.state_size(mode));
    f.Flow({mode, first.t, x, control, input.parameters.data()}, slope.data());
    return slope;
  };
  const double* x = &tape.numbers[first.x];
  const Eigen::VectorXd slope = slope_of(first.mode, x, u), end_slope = slope_of(end_mode, end_state, u);
  const Eigen::VectorXd slope_before = slope_of(first.mode, x, before_jump);
  const Eigen::VectorXd end_slope_after = slope_of(end_mode, end_state, after_jump);
  const double fraction = jumps ? tape.Fraction(tape.begins[coincidence.jump]) : 0;
  const TiedEvents::Start start{{{first.mode, first.t, x, before_jump, input.parameters.data()}, tape.step},
                                first.t - input.begin,
                                coincidence.guards};
  Eigen::VectorXd largest = Eigen::VectorXd::Zero(end_size);  // changes that are rounding
  const Eigen::Index directions = coincidence.guards.size() > kManyGuards ? 2 : of_duration.size();
  for (Eigen::Index column = 0; column < directions; ++column) {
    const double jump = fraction * of_duration[column];
    const Eigen::VectorXd change = before.x.col(column) - slope * before.t[column] + (slope - slope_before) * jump;
    const Eigen::VectorXd expected =
        after.x.col(column) - end_slope * after.t[column] + (end_slope - end_slope_after) * jump;
    const Eigen::VectorXd size = before.x.col(column).cwiseAbs() + slope.cwiseAbs() * std::abs(before.t[column]) +
                                 (slope - slope_before).cwiseAbs() * std::abs(jump);
    const auto change_of = [&](int interval) {
      return controls.col(column).segment(static_cast<Eigen::Index>(interval) * num_controls, num_controls);
    };
    for (const double sign : {1.0, -1.0}) {
      TiedEvents::Direction direction;
      direction.x = sign * change;
      direction.size = size;
      direction.p = sign * before.p.col(column);
      direction.u = sign * change_of(jumped ? coincidence.jump - 1 : first.interval);
      if (jumps) {
        direction.next_control = after_jump;
        direction.next_u = sign * change_of(coincidence.jump);
        direction.jump = sign * jump;
      }
      const std::optional<TiedEvents::Outcome> found = tied->Follow(start, std::move(direction));
      if (!found || found->mode != end_mode || !TiedEvents::SameStates(found->x.data(), end_state, end_size)) {
        return true;
      }
      for (int i = 0; i < end_size; ++i) {
        largest[i] = std::max(largest[i], kRounding * found->size[i]);
        const double difference = std::abs(found->change[i] - sign * expected[i]);
        if (!(difference <= kSame * std::max(found->size[i], largest[i]))) return true;
      }
    }
  }
  return false;
}

std::vector<HybridSensitivity> MotionDerivatives::Intervals(const HybridInput& input, const MotionTape& tape) {
  using Matrix = RungeKutta::Matrix;
  const int num_controls = system_.num_controls();
  std::vector<HybridSensitivity> out(tape.intervals.size());
  for (std::size_t k = 0; k < out.size(); ++k) {
    const std::size_t first = k == 0 ? 0 : tape.intervals[k];
    const std::size_t end = k + 1 < out.size() ? tape.intervals[k + 1] : tape.entries.size();
    const int n = system_.state_size(tape.entries[first].mode), columns = out[k].columns = n + num_controls;
    RungeKutta::Tangent at;
    at.x = Matrix::Identity(n, columns);
    at.t = Eigen::RowVectorXd::Zero(columns);
    at.p = Matrix::Zero(system_.num_parameters(), columns);
    at.u = Matrix::Zero(num_controls, columns);
    at.u.rightCols(num_controls).setIdentity();
    for (std::size_t i = first; i < end; ++i) {
      PushForward(input, tape, tape.entries[i], Eigen::RowVectorXd::Zero(columns), &at);
      if (tape.entries[i].kind != TapeEntry::Kind::kReset) continue;
      out[k].after.emplace_back(at.x.data(), at.x.data() + at.x.size());
      out[k].times.emplace_back(at.t.data(), at.t.data() + columns);
    }
    out[k].final_state.assign(at.x.data(), at.x.data() + at.x.size());
  }
  return out;
}

// The name of a column of [x t p u].
std::string MotionDerivatives::VariableName(int mode, int column) const {
  const int n = system_.state_size(mode), num_parameters = system_.num_parameters();
  if (column < n) return system_.StateName(mode, column);
  if (column == n) return "t";
  column -= n + 1;
  return column < num_parameters ? system_.ParameterName(column) : system_.ControlName(column - num_parameters);
}

std::string MotionDerivatives::ReasonNotFinite(const HybridInput& input, const MotionTape& tape) {
  const HybridFunctions& f = system_.functions();
  const auto at = [&](int mode, double t) {
    return " in mode '" + system_.ModeName(mode) + "' at t = " + ToText(t, 10) + " has no finite derivative ";
  };
  // The first of the numbers that is not finite, or -1; beside an infinite one in its row Jets have none by others.
  const auto not_finite = [](const std::vector<double>& numbers, int count, int width) {
    for (int i = 0; i < count; ++i) {
      if (std::isfinite(numbers[i])) continue;
      for (int j = i - i % width; j < i - i % width + width; ++j) {
        if (std::isinf(numbers[j])) return j;
      }
      return i;
    }
    return -1;
  };
  for (const TapeEntry& entry : tape.entries) {
    const FlowStep step = StepOf(input, tape, entry);
    const int n = system_.state_size(entry.mode), columns = n + 1 + system_.num_parameters();
    const auto guard = [&] { return " '" + system_.GuardName(entry.mode, entry.guard) + "'"; };
    if (entry.kind == TapeEntry::Kind::kReset) {
      const int next = f.ResetJacobian(step, entry.guard, state_.data(), reset_.data());
      const int place = not_finite(reset_, system_.state_size(next) * columns, columns);
      if (place < 0) continue;
      return "the reset of guard" + guard() + at(entry.mode, entry.t) + "of " +
             system_.StateName(next, place / columns) + " by " + VariableName(entry.mode, place % columns);
    }
    integrator_.Linearize(step);
    int stage = 0, component = 0, column = 0;
    if (!integrator_.IsFinite(&stage, &component, &column)) {
      if (component < 0) return "the projection of the state" + at(entry.mode, entry.t) + "by it";
      return "the flow" + at(entry.mode, entry.t + cooper_verner::kC[stage] * entry.h) + "of " +
             system_.StateName(entry.mode, component) + " by " + VariableName(entry.mode, column);
    }
    if (entry.kind != TapeEntry::Kind::kToEvent) continue;
    const TapeEntry& event = (&entry)[1];
    f.GuardGradient({event.mode, event.t, &tape.numbers[event.x], step.u, step.p}, entry.guard, guard_.data());
    const int place = not_finite(guard_, columns + system_.num_controls(), columns + system_.num_controls());
    if (place >= 0) return "the guard" + guard() + at(entry.mode, event.t) + "by " + VariableName(entry.mode, place);
    integrator_.LengthDerivative(by_length_.data());
    double rate = guard_[n];
    for (int j = 0; j < n; ++j) rate += guard_[j] * by_length_[j];
    if (rate == 0) {
      return "the guard" + guard() + " in mode '" + system_.ModeName(entry.mode) +
             "' is zero at t = " + ToText(event.t, 10) +
             " without a rate: the time of its event has no finite derivative";
    }
  }
  return "the derivatives of the motion overflow";
}

}  // namespace saltus
