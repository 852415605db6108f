#include "hybrid/tied_events.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/statistics.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

constexpr double kSameState = 1e-9;   // relative: orders of tied events that do not differ
constexpr double kSameChange = 1e-9;  // of a guard, relative to its terms: zero to first order
constexpr std::size_t kMostTied = 4;  // guards of which all orders are tried
constexpr int kMostOrders = 24;
constexpr int kMostTransitions = 400;  // in the orders of more guards, on average one each

using RowMap = Eigen::Map<const Eigen::RowVectorXd>;

// Returns the change of a guard along a direction and a change of the time, given its gradient by [x t p u] with n
// states, and the sum of the absolute values of its terms.
std::pair<double, double> ChangeOf(const double* gradient, int n, const TiedEvents::Direction& direction, double time,
                                   double time_size) {
  const RowMap by_x(gradient, n), by_p(gradient + n + 1, direction.p.size()),
      by_u(gradient + n + 1 + direction.p.size(), direction.u.size());
  return {by_x.dot(direction.x) + gradient[n] * time + by_p.dot(direction.p) + by_u.dot(direction.u),
          by_x.cwiseAbs().dot(direction.size) + std::abs(gradient[n]) * time_size +
              by_p.cwiseAbs().dot(direction.p.cwiseAbs()) + by_u.cwiseAbs().dot(direction.u.cwiseAbs())};
}

}  // namespace

TiedEvents::TiedEvents(const HybridSystem& system, const HybridOptions& options)
    : system_(system), functions_(system.functions()), options_(options), search_(system.functions()) {
  const auto most = static_cast<std::size_t>(functions_.most_states());
  next_.resize(most);
  gradient_.resize(most + 1 + system.num_parameters() + system.num_controls());
  jacobian_.resize(most * (most + 1 + system.num_parameters()));
  values_.resize(functions_.most_guards());
}

bool TiedEvents::SameStates(const double* a, const double* b, int size) {
  double largest = 0, spread = 0;
  for (int i = 0; i < size; ++i) {
    largest = std::max(largest, std::abs(a[i]));
    spread = std::max(spread, std::abs(a[i] - b[i]));
  }
  return spread <= kSameState * largest;
}

bool TiedEvents::SlopeAt(const ModePoint& at, std::vector<double>* slope) const {
  const int n = system_.state_size(at.mode);
  slope->resize(n);
  functions_.Flow(at, slope->data());
  return AllFinite(*slope);
}

bool TiedEvents::LeaveSwitches(FlowStep* at, const std::function<double(int guard, double rate)>& value) {
  if (!SlopeAt(*at, &slope_)) return false;
  for (int guard = 0; guard < system_.num_guards(at->mode); ++guard) {
    if (!functions_.IsOn(at->mode, guard)) continue;
    const double side = value(guard, search_.GuardAt(*at, slope_.data(), guard).rate);
    if (side == 0) continue;
    using Side = HybridFunctions::Side;
    at->mode = functions_.AdjacentPiece(*at, guard, side > 0 ? Side::kAbove : Side::kBelow);
    if (at->mode < 0 || !SlopeAt(*at, &slope_)) return false;
    guard = -1;  // The piece has its own switches.
  }
  return true;
}

bool TiedEvents::FindCandidates(const FlowStep& at, const double* slope, double elapsed) {
  candidates_.clear();
  search_.Forget();
  search_.EnterMode(at);
  functions_.GuardRates(at, slope, values_.data());
  for (int guard = 0; guard < system_.num_guards(at.mode); ++guard) {
    const GuardValue& value = values_[guard];
    if (!std::isfinite(value.value)) return false;
    if (functions_.IsOn(at.mode, guard)) continue;
    const GuardStatus standing = search_.Classify(at, slope, guard, value, elapsed);
    if (standing == GuardStatus::kArmed) continue;
    const bool waits =
        standing == GuardStatus::kBehind && value.rate >= 0 && functions_.RearmsAboveZero(at.mode, guard);
    if (!waits) candidates_.push_back({guard, value.rate, standing});
  }
  return true;
}

int TiedEvents::ModeAtRest(const FlowStep& at, const Candidate& candidate) const {
  const int n = system_.state_size(at.mode);
  const int mode = functions_.IsSwitch(at.mode, candidate.guard)
                       ? functions_.AdjacentPiece(at, candidate.guard, HybridFunctions::Side::kOn)
                       : functions_.OnAccumulation(at.mode, candidate.guard);
  if (mode < 0 || mode >= system_.num_modes() || system_.state_size(mode) != n) return -1;
  const bool repeats = std::ranges::any_of(happened_, [&](const Event& event) {
    return event.mode == at.mode && event.guard == candidate.guard &&
           (candidate.standing == GuardStatus::kSinking || std::equal(event.x.begin(), event.x.end(), at.x));
  });
  return repeats ? mode : -1;
}

bool TiedEvents::Order(const Start& start, const std::function<int(int)>& choose, int* mode, std::vector<double>* x) {
  FlowStep at = start.at;
  x->assign(at.x, at.x + system_.state_size(at.mode));
  candidates_.clear();
  for (const int guard : start.guards) candidates_.push_back({guard});
  happened_.clear();
  const std::size_t limit = static_cast<std::size_t>(options_.most_repeats) * start.guards.size();
  for (std::size_t count = 0; count <= limit; ++count) {
    Candidate chosen;
    const auto behind = [](const Candidate& candidate) { return candidate.standing == GuardStatus::kBehind; };
    if (const auto found = std::ranges::find_if(candidates_, behind); found != candidates_.end()) {
      chosen = *found;
    } else {
      std::erase_if(candidates_, [](const Candidate& candidate) { return candidate.standing == GuardStatus::kRising; });
      if (candidates_.empty()) {
        *mode = at.mode;
        return true;
      }
      chosen = candidates_[choose(static_cast<int>(candidates_.size()))];
    }
    if (const int rest = ModeAtRest(at, chosen); rest >= 0) {
      at.mode = rest;
    } else {
      happened_.push_back({at.mode, chosen.guard, *x});
      std::fill(next_.begin(), next_.end(), std::numeric_limits<double>::quiet_NaN());
      const int next = functions_.Reset(at, chosen.guard, next_.data());
      if (next < 0 || next >= system_.num_modes() || !AllFinite(std::span(next_.data(), system_.state_size(next))))
        return false;
      x->assign(next_.begin(), next_.begin() + system_.state_size(next));
      at.mode = next;
      at.x = x->data();
    }
    const auto falls_or_rises = [](int, double rate) { return rate; };
    if (!LeaveSwitches(&at, falls_or_rises) || !FindCandidates(at, slope_.data(), start.elapsed)) return false;
  }
  return false;
}

void TiedEvents::Compare(const Start& start, HybridTie* tie) {
  int first_mode = 0, mode = 0;
  std::vector<double> first, x;
  const auto compare = [&](bool is_first, const std::function<int(int)>& choose) {
    const bool done = Order(start, choose, &mode, &x);
    if (is_first && done) {
      first_mode = mode;
      first = x;
    } else if (!done || first.empty() || mode != first_mode) {
      tie->spread = std::numeric_limits<double>::infinity();
      tie->ambiguous = true;
    } else {
      if (!SameStates(first.data(), x.data(), static_cast<int>(x.size()))) tie->ambiguous = true;
      for (std::size_t i = 0; i < x.size(); ++i) tie->spread = std::max(tie->spread, std::abs(first[i] - x[i]));
    }
  };
  const std::size_t count = start.guards.size();
  if (count > kMostTied) {
    const int orders = std::clamp(kMostTransitions / static_cast<int>(count), 2, kMostOrders);
    for (int order = 0; order < orders; ++order) {
      // Order 0 takes the first of those that are left, 1 the last; higher ones at first one that many places later.
      int shift = order > 1 ? order - 1 : 0;
      compare(order == 0, [&](int n) { return order == 1 ? n - 1 : std::exchange(shift, 0) % n; });
    }
    return;
  }
  // The choices count up in the order of an odometer.
  std::vector<int> choices, numbers;
  for (int order = 0; order < kMostOrders; ++order) {
    numbers.clear();
    compare(order == 0, [&](int n) {
      numbers.push_back(n);
      if (choices.size() < numbers.size()) choices.push_back(0);
      return std::min(choices[numbers.size() - 1], n - 1);
    });
    choices.resize(numbers.size());
    while (!choices.empty() && choices.back() + 1 >= numbers[choices.size() - 1]) choices.pop_back();
    if (choices.empty()) return;
    ++choices.back();
  }
}

// Whether a change along the direction lets a guard that is left at zero with a rate of zero rise first, so that the
// motion changes to first order by what happens until the guard is back at zero.
bool TiedEvents::Bounces(const FlowStep& at, int guard, const Direction& direction, double now, int rest) {
  constexpr double kPartOfStep = 1e-3, kPartOfState = 1e-7;  // of the differences
  constexpr double kSame = 1e-6;
  using Vector = Eigen::VectorXd;
  const int n = system_.state_size(at.mode);
  const Eigen::Map<const Vector> x(at.x, n), slope(slope_.data(), n), p(at.p, direction.p.size());
  const double rate = search_.GuardAt(at, slope_.data(), guard).rate;
  const double acceleration =
      (search_.GuardAfter(at, slope_.data(), guard, kPartOfStep * at.h).rate - rate) / (kPartOfStep * at.h);
  const Vector change = direction.x + slope * now;
  const double part = kPartOfState * (1 + x.norm() + p.norm()) / (1 + change.norm() + direction.p.norm());
  const Vector moved = x + part * change, moved_p = p + part * direction.p;
  FlowStep near = at;
  near.x = moved.data();
  near.p = moved_p.data();
  std::vector<double> of_near(n), of_rest;
  functions_.Flow(near, of_near.data());
  const double rises = (search_.GuardAt(near, of_near.data(), guard).rate - rate) / part;
  FlowStep resting = at;
  resting.mode = rest;
  if (!SlopeAt(resting, &of_rest)) return true;
  const Vector differs = (slope - Eigen::Map<const Vector>(of_rest.data(), n)) * (2 * rises / acceleration);
  for (int i = 0; i < n; ++i) {
    if (!(std::abs(differs[i]) <= kSame * direction.size[i] + kSame * direction.size.maxCoeff())) return true;
  }
  return false;
}

bool TiedEvents::JumpsAtItsEvent(const ModePoint& event, int guard, double duration) const {
  constexpr double kBeside = 1e-8, kNearer = 1e-9;   // of the duration
  constexpr double kChange = 1e-10, kRemains = 0.5;  // of the largest state, and of the difference at kBeside
  std::vector<double> slope, beside(event.x, event.x + system_.state_size(event.mode)), after(functions_.most_states());
  SlopeAt(event, &slope);
  const auto reset_at = [&](double later, int* mode) {
    for (std::size_t i = 0; i < beside.size(); ++i) beside[i] = event.x[i] + later * slope[i];
    const int next =
        functions_.Reset({event.mode, event.t + later, beside.data(), event.u, event.p}, guard, after.data());
    *mode = next < 0 || next >= system_.num_modes() ? -1 : functions_.BaseMode(next);
    return *mode < 0 ? std::vector<double>() : std::vector(after.data(), after.data() + system_.state_size(next));
  };
  double difference[2] = {}, largest = 0;
  for (const int i : {0, 1}) {
    const double later = (i == 0 ? kBeside : kNearer) * duration;
    int before = 0, behind = 0;
    const std::vector<double> a = reset_at(-later, &before), b = reset_at(later, &behind);
    if (before != behind) {
      difference[i] = std::numeric_limits<double>::infinity();
      continue;
    }
    for (std::size_t k = 0; k < a.size(); ++k) {
      difference[i] = std::max(difference[i], std::abs(b[k] - a[k]));
      largest = std::max(largest, std::abs(a[k]));
    }
  }
  return difference[0] > kChange * largest && difference[1] >= kRemains * difference[0];
}

std::optional<TiedEvents::Outcome> TiedEvents::Follow(const Start& start, Direction direction) {
  using Vector = Eigen::VectorXd;
  FlowStep at = start.at;
  std::vector<double> x(at.x, at.x + system_.state_size(at.mode));
  Vector &change = direction.x, &size = direction.size, &u = direction.u;
  const int num_parameters = system_.num_parameters();
  double now = 0, now_size = 0;  // of the last event, to first order
  happened_.clear();
  const std::size_t limit = 2 + static_cast<std::size_t>(options_.most_repeats) * start.guards.size();
  for (std::size_t count = 0; count <= limit; ++count) {
    at.x = x.data();
    const int n = system_.state_size(at.mode);
    if (!SlopeAt(at, &slope_)) return std::nullopt;
    if (!happened_.empty()) {
      if (!FindCandidates(at, slope_.data(), start.elapsed)) return std::nullopt;
    } else {
      candidates_.clear();
      for (const int guard : start.guards) candidates_.push_back({guard});
    }
    const Eigen::Map<const Vector> slope(slope_.data(), n);
    int guard = -1, rest = -1;
    bool immediate = false;
    double time = 0, time_size = 0;
    for (const Candidate& candidate : candidates_) {
      functions_.GuardGradient(at, candidate.guard, gradient_.data());
      const double rate = RowMap(gradient_.data(), n).dot(slope) + gradient_[n];
      const auto [value, value_size] = ChangeOf(gradient_.data(), n, direction, 0, 0);
      bool behind = candidate.standing == GuardStatus::kBehind;
      if (!behind && !happened_.empty()) {
        behind = value + rate * now < -kSameChange * (value_size + std::abs(rate) * now_size);
        if (behind && rate >= 0 && functions_.RearmsAboveZero(at.mode, candidate.guard)) behind = false;
      }
      if (!behind) {
        if (candidate.standing == GuardStatus::kRising) continue;
        if (const int mode = ModeAtRest(at, candidate); mode >= 0) {
          rest = mode;
          if (candidate.standing == GuardStatus::kSinking && Bounces(at, candidate.guard, direction, now, mode)) {
            return std::nullopt;
          }
          continue;
        }
        if (candidate.standing == GuardStatus::kSinking) return std::nullopt;
        if (!(rate < 0)) continue;  // under another control it does not fall
      }
      const double then = behind ? now : -value / rate;
      if (guard >= 0 && (immediate || (!behind && then >= time))) continue;
      guard = candidate.guard;
      immediate = behind;
      time = then;
      time_size = behind ? now_size : value_size / std::abs(rate);
    }
    // Where no time passes any more, the motion goes on at rest, before events of a later time.
    const bool rests = rest >= 0 && !immediate;
    if (!rests && direction.next_control != nullptr && (guard < 0 || (!immediate && direction.jump < time))) {
      const Vector before = slope;
      at.u = std::exchange(direction.next_control, nullptr);
      u = direction.next_u;
      if (functions_.ModeAfterControlJump(at) != at.mode || !SlopeAt(at, &slope_)) return std::nullopt;
      const Vector jumps = before - Eigen::Map<const Vector>(slope_.data(), n);
      change += jumps * direction.jump;
      size += jumps.cwiseAbs() * std::abs(direction.jump);
      continue;
    }
    if (rests) {
      const Vector before = slope;
      at.mode = rest;
      if (!SlopeAt(at, &slope_)) return std::nullopt;
      const Vector jumps = before - Eigen::Map<const Vector>(slope_.data(), n);
      change += jumps * now;
      size += jumps.cwiseAbs() * now_size;
      continue;
    }
    if (guard < 0) return Outcome{at.mode, std::move(x), std::move(change), std::move(size)};
    if (!happened_.empty() && time < now) time = now;
    happened_.push_back({at.mode, guard, x});
    change += slope * time;
    size += slope.cwiseAbs() * time_size;
    const int next = functions_.ResetJacobian(at, guard, next_.data(), jacobian_.data());
    if (next < 0 || next >= system_.num_modes()) return std::nullopt;
    const int rows = system_.state_size(next);
    const Eigen::Map<const RungeKutta::Matrix> reset(jacobian_.data(), rows, n + 1 + num_parameters);
    if (!AllFinite(std::span(next_.data(), rows)) || !reset.allFinite()) return std::nullopt;
    change = Vector(reset.leftCols(n) * change + reset.col(n) * time + reset.rightCols(num_parameters) * direction.p);
    size = Vector(reset.leftCols(n).cwiseAbs() * size + reset.col(n).cwiseAbs() * time_size +
                  reset.rightCols(num_parameters).cwiseAbs() * direction.p.cwiseAbs());
    x.assign(next_.begin(), next_.begin() + rows);
    at.mode = next;
    at.x = x.data();
    const auto side_of = [&](int on, double rate) {
      functions_.GuardGradient(at, on, gradient_.data());
      const auto [value, value_size] = ChangeOf(gradient_.data(), rows, direction, time, time_size);
      return std::abs(value) > kSameChange * value_size ? value : rate;
    };
    if (!LeaveSwitches(&at, side_of)) return std::nullopt;
    change -= Eigen::Map<const Vector>(slope_.data(), rows) * time;
    size += Eigen::Map<const Vector>(slope_.data(), rows).cwiseAbs() * time_size;
    now = time;
    now_size = time_size;
  }
  return std::nullopt;
}

}  // namespace saltus
