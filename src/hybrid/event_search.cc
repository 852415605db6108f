#include "hybrid/event_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace saltus {
namespace {

constexpr double kAtZero = 1e-11;      // of a guard, relative to the size of its terms
constexpr double kShortest = 1e-9;     // of a step: how far ahead is looked at least
constexpr double kNoRate = 1e-9;       // of its rate, likewise: higher derivatives decide
constexpr double kIntegrated = 1e-12;  // error of states that are integrated, relative
constexpr double kGrazes = 1e-12;      // depth of a minimum that counts as zero, relative
constexpr double kNearZero = 0.5;      // minimum of the cubic, of the smaller value at the ends, that is looked at
constexpr double kSettles = 1e-9;      // last steps of an iteration, of the length of the step
constexpr double kNoise = 4 * std::numeric_limits<double>::epsilon();
constexpr double kNoiseOfForces = 4e-12;  // of the flow of closed contacts, whose forces may be past a limit by 1e-12
constexpr double kStateRounding = 64 * std::numeric_limits<double>::epsilon();  // of states, after many steps
constexpr double kTimeRounding = 8 * std::numeric_limits<double>::epsilon();    // of time, parameters and controls
constexpr double kSoon = 1.0 / 64;                                              // of a step
constexpr double kBehind[] = {1.5, 1.1, 1.01};  // of the time in which a guard returns: it may have a kink soon behind
constexpr double kInside = 0.3819660112501051;  // of a step, not a rational part
constexpr int kMostIterations = 100;

// The size of the term of a derivative: an infinite derivative by what is zero, or none, tells of no rounding.
double SizeOf(double derivative, double value) {
  const double size = std::abs(derivative * value);
  return std::isfinite(size) ? size : 0.0;
}

// Where a cubic has its minimum in (0, h), if it falls at 0 and rises at h.
double MinimumOf(const GapPolynomial& g, double h) {
  const double a = 3 * g.c[3], b = g.c[2], c = g.c[1];  // g' = a s^2 + 2 b s + c, c <= 0
  const double root = std::sqrt(std::max(b * b - a * c, 0.0));
  const double s = b + root > 0 ? -c / (b + root) : 0.5 * h;
  return std::clamp(s, 0.0, h);
}

}  // namespace

GapPolynomial Hermite(const GuardValue& begin, const GuardValue& end, double h) {
  const double slope = (end.value - begin.value) / h;
  GapPolynomial g;
  g.c = {begin.value,
         begin.rate,
         (3 * slope - 2 * begin.rate - end.rate) / h,
         (begin.rate + end.rate - 2 * slope) / (h * h),
         0};
  return g;
}

EventSearch::EventSearch(const HybridFunctions& functions) : functions_(functions), integrator_(functions) {}

GuardValue EventSearch::GuardAt(const FlowStep& step, const double* slope, int guard) const {
  GuardValue at;
  at.value = functions_.GuardRate(step, guard, slope, &at.rate);
  return at;
}

const double* EventSearch::StateAfter(const FlowStep& step, const double* slope, double s) {
  const int n = functions_.state_size(step.mode);
  const auto size = static_cast<std::size_t>(n);
  const bool same = !kept_.empty() && step.mode == kept_step_.mode && step.t == kept_step_.t &&
                    step.u == kept_step_.u && std::equal(step.x, step.x + n, numbers_.data()) &&
                    std::equal(slope, slope + n, numbers_.data() + n);
  if (!same) {
    kept_.clear();
    kept_step_ = step;
    numbers_.assign(step.x, step.x + n);
    numbers_.insert(numbers_.end(), slope, slope + n);
  }
  const auto known = std::ranges::find(kept_, s, &Kept::s);
  if (known != kept_.end()) return &numbers_[known->state];
  const std::size_t state = numbers_.size();
  numbers_.resize(state + 2 * size);
  kept_.push_back({.s = s, .state = state, .guards = {}});
  FlowStep part = step;
  part.h = s;
  integrator_.Step(part, slope, &numbers_[state], &numbers_[state + size]);
  return &numbers_[state];
}

FlowStep EventSearch::PointAfter(const FlowStep& step, const double* slope, double s) {
  FlowStep part = step;
  part.h = s;
  part.t += s;
  part.x = StateAfter(step, slope, s);
  return part;
}

GuardValue EventSearch::GuardAfter(const FlowStep& step, const double* slope, int guard, double s) {
  const FlowStep then = PointAfter(step, slope, s);
  const double* slope_then = then.x + functions_.state_size(step.mode);
  Kept& kept = *std::ranges::find(kept_, s, &Kept::s);
  // The forces of closed contacts are one problem for all guards: the second guard that asks finds those of all.
  if (!functions_.Projects(step.mode) || !std::exchange(kept.asked, true)) return GuardAt(then, slope_then, guard);
  if (kept.guards.empty()) {
    kept.guards.resize(functions_.num_guards(step.mode));
    functions_.GuardRates(then, slope_then, kept.guards.data());
  }
  return kept.guards[guard];
}

double EventSearch::Scale(const FlowStep& step, int guard) { return ScaleBy(step, TermsOf(step, guard)); }

EventSearch::Terms EventSearch::TermsOf(const FlowStep& step, int guard) {
  of_one_.clear();
  functions_.AppendGuardTerms(step, guard, &of_one_);
  return of_one_;
}

double EventSearch::ScaleBy(const FlowStep& step, Terms terms) const {
  const int n = functions_.state_size(step.mode), controls = n + 1 + functions_.layout().num_parameters;
  double scale = 0;
  for (const auto& [input, derivative] : terms) {
    const double value = input < n          ? step.x[input]
                         : input == n       ? step.t
                         : input < controls ? step.p[input - n - 1]
                                            : step.u[input - controls];
    scale += SizeOf(derivative, value);
  }
  return scale;
}

double EventSearch::ErrorBy(const FlowStep& step, Terms terms, double rate, double elapsed, double of_states) const {
  const int n = functions_.state_size(step.mode);
  const double by_time = !terms.empty() && terms[0].input == n ? terms[0].derivative : 0;
  double states = SizeOf(rate - by_time, elapsed);
  for (const auto& [input, derivative] : terms) {
    if (input < n) states += SizeOf(derivative, step.x[input]);
  }
  return of_states * states + kTimeRounding * (ScaleBy(step, terms) + std::abs(rate * step.t));
}

EventSearch::Window EventSearch::WindowOf(const FlowStep& step, int guard, double rate, double elapsed) {
  const Terms terms = TermsOf(step, guard);
  return {ErrorBy(step, terms, rate, elapsed, kStateRounding), ErrorBy(step, terms, rate, elapsed, kIntegrated)};
}

void EventSearch::EnterMode(const FlowStep& step) {
  flow_scales_.clear();
  terms_.clear();
  begins_.assign(1, 0);
  functions_.AppendAllGuardTerms(step, &terms_, &begins_);
}

// Whether a guard is zero up to s, as the force of bodies that touch in free flight, whose rate may be rounding. A
// guard with zeros at round parts of a step is not zero in between, at a part that is not rational.
bool EventSearch::StaysAtZero(const FlowStep& step, const double* slope, int guard, const GuardValue& begin,
                              const GuardValue& end, double s) {
  if (begin.value != 0 || end.value != 0) return false;
  return (begin.rate == 0 && end.rate == 0) || GuardAfter(step, slope, guard, kInside * s).value == 0;
}

EventSearch::GuardStatus EventSearch::Classify(const FlowStep& step, const double* slope, int guard,
                                               const GuardValue& now, double elapsed) {
  const int n = functions_.state_size(step.mode);
  const int columns = n + 1 + functions_.layout().num_parameters + functions_.layout().num_controls;
  const Terms terms = Terms(terms_).subspan(begins_[guard], begins_[guard + 1] - begins_[guard]);
  elapsed = std::min(elapsed, step.h);
  double at_zero = ErrorBy(step, terms, now.rate, elapsed, kAtZero);
  if (now.value > at_zero) return GuardStatus::kArmed;
  double ahead = 0.5 * step.h;
  GuardValue later = GuardAfter(step, slope, guard, ahead);
  // Steps that are too long for the flow lead to no numbers.
  while (!std::isfinite(later.value + later.rate) && ahead > kShortest * step.h) {
    ahead *= 0.0625;
    later = GuardAfter(step, slope, guard, ahead);
  }
  at_zero += kAtZero * std::abs(later.value - now.value) * (elapsed / step.h);
  if (now.value < -at_zero) return GuardStatus::kBehind;
  if (StaysAtZero(step, slope, guard, now, later, ahead)) return GuardStatus::kRising;
  if (flow_scales_.empty()) {
    flow_scales_.resize(n);
    jacobian_.resize(static_cast<std::size_t>(n) * columns);
    functions_.FlowJacobian(step, flow_scales_.data(), jacobian_.data());
    for (int i = 0; i < n; ++i) {
      of_one_.clear();
      AppendTerms(&jacobian_[i * columns], n, columns, &of_one_);
      flow_scales_[i] = ScaleBy(step, of_one_);
    }
  }
  const double of_flow = functions_.Projects(step.mode) ? kNoiseOfForces : kNoise;
  double rate_scale = 0, noise = 0;
  for (const auto& [input, derivative] : terms) {
    if (input > n) continue;
    rate_scale += std::abs(derivative * (input < n ? slope[input] : 1.0));
    if (input < n) noise += of_flow * std::abs(derivative) * flow_scales_[input];
  }
  if (std::abs(now.rate) > std::max(noise, kNoRate * std::max(rate_scale, std::abs(later.rate)))) {
    return now.rate > 0 ? GuardStatus::kRising : GuardStatus::kFalling;
  }
  // The first derivative that is not zero has the sign of the guard a little later: from where it exceeds rounding.
  int last = 0;
  for (double s = std::ldexp(step.h, -34); s <= step.h; s *= 4) {
    const FlowStep then = PointAfter(step, slope, s);
    const double value = GuardAt(then, then.x + n, guard).value;
    const double noise_then = value == 0 ? 0 : kNoise * Scale(then, guard) + std::abs(now.value);
    const int sign = value > noise_then ? 1 : value < -noise_then ? -1 : 0;
    if (sign != 0 && sign == last) return sign > 0 ? GuardStatus::kRising : GuardStatus::kSinking;
    last = sign;
  }
  return GuardStatus::kRising;
}

bool EventSearch::FindAbove(const FlowStep& step, const double* slope, int guard, double before, double* above) {
  double s = before;
  for (int i = 0; i < 48; ++i) {
    s *= 0.5;
    if (GuardAfter(step, slope, guard, s).value > 0) {
      *above = s;
      return true;
    }
  }
  return false;
}

EventSearch::GuardCrossing EventSearch::Locate(const FlowStep& step, const double* slope, int guard, double above,
                                               double below, double guess, double curvature) {
  double s = guess > above && guess <= below ? guess : 0.5 * (above + below);
  double best = s, least = std::numeric_limits<double>::infinity(), moved = step.h;
  bool newton = false;  // s is from a Newton step
  GuardValue at, at_best;
  for (int i = 0; i < kMostIterations; ++i) {
    at = GuardAfter(step, slope, guard, s);
    const bool stalls = newton && moved < kSettles * step.h && std::abs(at.value) >= 0.5 * least;
    if (std::abs(at.value) < least) {
      least = std::abs(at.value);
      best = s;
      at_best = at;
    }
    if (at.value == 0 || stalls) break;
    (at.value > 0 ? above : below) = s;
    double next = s - at.value / at.rate;
    newton = next > above && next <= below;
    if (!newton) next = 0.5 * (above + below);
    moved = std::abs(next - s);
    if (moved == 0 || next == above) break;
    s = next;
  }
  s = best;
  at = at_best;
  // A minimum that is below zero by rounding alone.
  const double depth = curvature > 0 ? 0.5 * at.rate * at.rate / curvature : std::numeric_limits<double>::infinity();
  if (depth <= kGrazes * (Scale(step, guard) + curvature * step.h * step.h)) {
    return {GuardCrossing::Kind::kGrazing, s};
  }
  return {GuardCrossing::Kind::kEvent, s};
}

// Where a guard that ends a step below -noise is so after `above`, where it is not.
double EventSearch::FirstBelow(const FlowStep& step, const double* slope, int guard, double above, double noise) {
  double below = step.h;
  for (int i = 0; i < kMostIterations && below - above > kSettles * step.h; ++i) {
    const double s = 0.5 * (above + below);
    (GuardAfter(step, slope, guard, s).value < -noise ? below : above) = s;
  }
  return below;
}

EventSearch::GuardCrossing EventSearch::FindSinking(const FlowStep& step, const double* slope, int guard,
                                                    const GuardValue& begin, const GuardValue& end, double elapsed) {
  if (!(end.value < 0)) return {};
  const Terms terms = TermsOf(step, guard);
  if (!(end.value < -ErrorBy(step, terms, end.rate, std::min(elapsed, step.h), kAtZero))) return {};
  const double noise = 2 * std::abs(begin.value) + kNoise * ScaleBy(step, terms);
  return {GuardCrossing::Kind::kEvent, FirstBelow(step, slope, guard, 0, noise)};
}

bool EventSearch::MayReturn(const FlowStep& step, int guard, const GuardValue& begin, const GuardValue& end) const {
  return begin.rate > 0 && end.value > 0 && begin.value <= begin.rate * step.h &&
         functions_.RearmsAboveZero(step.mode, guard);
}

// Finds where a guard that falls at the beginning of a step and rises at its end, but not smoothly, falls below zero. A
// guard with a kink is lowest where the lines along both ends meet, as that of a corner that passes a corner. Where
// these meet near an end, the guard is curved at the other end, which a point nearer to the first one replaces.
EventSearch::GuardCrossing EventSearch::FindBelowKink(const FlowStep& step, const double* slope, int guard,
                                                      const GuardValue& begin, const GuardValue& end) {
  constexpr double kBeside = 0.1;  // of the length between the ends
  constexpr int kMostPoints = 20;
  double from = 0, to = step.h;
  GuardValue falls = begin, rises = end;
  for (int i = 0; i < kMostPoints && rises.rate > falls.rate; ++i) {
    const double length = to - from;
    const double lower = std::min(falls.value, rises.value);
    if (lower > std::max(-falls.rate, rises.rate) * length) break;  // with these rates it cannot reach zero
    const double kink = (falls.value - rises.value + rises.rate * length) / (rises.rate - falls.rate);
    const double s = std::clamp(kink, kBeside * length, (1 - kBeside) * length);
    const bool near_zero = falls.value + falls.rate * kink <= kNearZero * lower;
    if (s == kink && !near_zero) break;
    const GuardValue there = GuardAfter(step, slope, guard, from + s);
    if (there.value < 0) {
      return Locate(step, slope, guard, from, from + s, from - falls.value / falls.rate, /*curvature=*/-1);
    }
    (there.rate < 0 ? from : to) = from + s;
    (there.rate < 0 ? falls : rises) = there;
  }
  return {};
}

EventSearch::GuardCrossing EventSearch::Find(const FlowStep& step, const double* slope, int guard, bool armed,
                                             const GuardValue& begin, const GuardValue& end) {
  const double h = step.h;
  if (!(h > 0) || StaysAtZero(step, slope, guard, begin, end, h)) return {};
  const double curvature = (end.rate - begin.rate) / h;
  if (MayReturn(step, guard, begin, end)) {
    // Where it would be back at zero if its second derivative stayed what it is.
    const GuardValue soon = GuardAfter(step, slope, guard, kSoon * h);
    const double second = (soon.rate - begin.rate) / (kSoon * h);
    const double back = second < 0 ? -2 * begin.rate / second : h;
    for (const double part : kBehind) {
      double below = kSoon * h;
      if (soon.value > 0 && part * back < h) below = std::max(below, part * back);
      double above = 0;
      if (GuardAfter(step, slope, guard, below).value < 0 && FindAbove(step, slope, guard, below, &above)) {
        return Locate(step, slope, guard, above, below, back, /*curvature=*/-1);
      }
    }
  }
  if (armed && end.value > 0) {
    // A minimum in between.
    if (!(begin.rate <= 0 && end.rate >= 0) || begin.rate == end.rate) return {};
    const GapPolynomial cubic = Hermite(begin, end, h);
    double s = MinimumOf(cubic, h);
    if (cubic(s) > kNearZero * std::min(begin.value, end.value)) {
      return FindBelowKink(step, slope, guard, begin, end);
    }
    const double noise = kGrazes * (Scale(step, guard) + std::abs(curvature) * h * h);
    double low = 0, high = h;  // the rate is negative at low, positive at high
    GuardValue at;
    for (int i = 0; i < kMostIterations; ++i) {
      at = GuardAfter(step, slope, guard, s);
      if (at.value < -noise) break;
      (at.rate < 0 ? low : high) = s;
      double next = s - at.rate / curvature;  // the rate is nearly linear in between
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      if (std::abs(next - s) <= kSettles * h) break;
      s = next;
    }
    if (at.value - std::abs(at.rate) * (high - low) > noise) return {};  // it may have a kink in between
    if (at.value >= -noise) return {GuardCrossing::Kind::kGrazing, s};
    return Locate(step, slope, guard, 0, s, FirstClosing(cubic, h), curvature);
  }
  const GapPolynomial cubic = Hermite(begin, end, h);
  if (armed) {
    const GuardCrossing found = Locate(step, slope, guard, 0, h, FirstClosing(cubic, h), curvature);
    if (found.kind != GuardCrossing::Kind::kGrazing) return found;
    const double noise = kGrazes * (Scale(step, guard) + std::abs(curvature) * h * h);
    if (!(end.value < -noise)) return found;
    // A guard with a kink, behind which it is below zero: where it falls, or is by more than rounding.
    if (GuardAfter(step, slope, guard, found.s).rate < 0) return {GuardCrossing::Kind::kEvent, found.s};
    return {GuardCrossing::Kind::kEvent, FirstBelow(step, slope, guard, found.s, noise)};
  }
  // The guard must rise above zero first.
  const double closing = FirstClosing(cubic, h, /*ignore_start=*/true);
  if (end.value > 0) {
    if (closing == kNever || closing <= 0) return {};
    const double s = closing + 0.5 * (h - closing);
    double above = 0;
    if (GuardAfter(step, slope, guard, s).value > 0 || !FindAbove(step, slope, guard, closing, &above)) return {};
    return Locate(step, slope, guard, above, s, closing, curvature);
  }
  if (begin.rate < 0 && begin.value < 0) return {};
  const bool closes = closing != kNever && closing > 0;
  double above = 0;
  if (FindAbove(step, slope, guard, closes ? closing : h, &above)) {
    return Locate(step, slope, guard, above, h, closing, /*curvature=*/-1);
  }
  // The guard rises by less than rounding.
  if (closes && begin.rate > 0 && step.t + closing > step.t && GuardAfter(step, slope, guard, closing).rate < 0) {
    return {GuardCrossing::Kind::kEvent, closing};
  }
  // The guard does not reach zero, as it began below by rounding.
  if (!(begin.rate > 0) || !(end.value < 0) || !functions_.RearmsAboveZero(step.mode, guard)) return {};
  const double noise = 2 * std::abs(begin.value) + kGrazes * (Scale(step, guard) + std::abs(curvature) * h * h);
  if (!(end.value < -noise)) return {};
  return {GuardCrossing::Kind::kEvent, FirstBelow(step, slope, guard, 0, noise)};
}

}  // namespace saltus
