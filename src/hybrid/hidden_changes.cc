#include "hybrid/hidden_changes.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/number_text.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

constexpr int kMostParts = 256;              // of a step that are looked at
constexpr double kShortestPart = 1e-12;      // of the duration: of shorter parts quotients may have no digits
constexpr double kWide = 3;                  // of the slopes at the ends of a part: bounds that are looked into
constexpr double kSeen = 0.5;                // likewise, a difference from the slope that the ends of a part lead to
constexpr double kRoundingOfChange = 1e-13;  // of the largest number of a motion: what such a difference changes
constexpr double kAtEnd = 1e-9;              // of a step: an event so near to its end is the one with which it ends
constexpr double kBelow = 1e-12;             // of the width of its bounds: how far a guard is below zero

// A part of a step between two states of the motion and the slopes there.
struct Part {
  double from = 0, to = 0;
  std::vector<double> begin, end, slope, slope_after;
};

class Search {
 public:
  Search(const HybridSystem& system, const HybridInput& input, const MotionTape& tape, double tolerance, Changes which)
      : system_(system),
        functions_(system.functions()),
        input_(input),
        tape_(tape),
        all_(which != Changes::kHidden),
        first_(which == Changes::kFirst),
        integrator_(functions_) {
    double largest = 0;
    for (const double number : tape.numbers) largest = std::max(largest, std::abs(number));
    negligible_.assign(functions_.most_states(), kRoundingOfChange * largest);
    for (const TapeEntry& entry : tape.entries) {
      for (int i = 0; i < system.state_size(entry.mode); ++i) {
        negligible_[i] = std::max(negligible_[i], tolerance * std::abs(tape.numbers[entry.x + i]));
      }
    }
  }

  HiddenChanges Run() {
    for (std::size_t i = 0; i < tape_.entries.size() && !(first_ && found_.steps > 0); ++i) {
      const TapeEntry& entry = tape_.entries[i];
      if (entry.kind == TapeEntry::Kind::kReset || !(entry.h > 0)) continue;
      if (!all_ && !(functions_.HasBounds() && functions_.MayHideChanges(entry.mode))) continue;
      SearchHiddenChange(entry, i + 1 < tape_.entries.size() ? tape_.entries[i + 1].x : tape_.final_state);
    }
    std::ranges::sort(found_.ends);
    return std::move(found_);
  }

 private:
  // Returns the step of an entry without its length.
  FlowStep StepOf(const TapeEntry& entry) const {
    const double* u = input_.control.data() + static_cast<std::ptrdiff_t>(entry.interval) * system_.num_controls();
    return {{entry.mode, entry.t, &tape_.numbers[entry.x], u, input_.parameters.data()}, 0};
  }

  void SearchHiddenChange(const TapeEntry& entry, std::size_t end) {
    const int n = system_.state_size(entry.mode), num_guards = system_.num_guards(entry.mode);
    const FlowStep step = StepOf(entry);
    parts_.assign(1, {0, entry.h, {step.x, step.x + n}, {&tape_.numbers[end], &tape_.numbers[end] + n}, {}, {}});
    Part& whole = parts_[0];
    whole.slope.resize(n);
    whole.slope_after.resize(n);
    functions_.Flow(step, whole.slope.data());
    functions_.Flow({step.mode, step.t + entry.h, whole.end.data(), step.u, step.p}, whole.slope_after.data());
    is_above_.assign(num_guards, -1);
    next_.resize(n);
    flies_ = functions_.Fly({step, entry.h}, next_.data(), nullptr);  // a closed form is right for any step
    has_bounds_ = functions_.HasBounds() && (functions_.MayHideChanges(entry.mode) || num_guards > 0);
    bool found = false;
    for (std::size_t looked = 0; looked < parts_.size() && looked < kMostParts; ++looked) {
      if (parts_[looked].to - parts_[looked].from <= kShortestPart * input_.duration) continue;
      std::vector<int> falling;
      bool wide = false;
      if (has_bounds_) {
        BoundIn(parts_[looked], step);
        for (int guard = 0; guard < num_guards; ++guard) {
          if (MayFall(step, guard)) falling.push_back(guard);
        }
        for (int i = 0; i < n && !wide; ++i) wide = IsWide(parts_[looked], i);
      }
      if (!wide && falling.empty() && !all_) continue;
      Part first = parts_[looked], second = first;
      first.to = second.from = 0.5 * (first.from + first.to);
      FlowStep half = step;
      half.t += first.from;
      half.x = first.begin.data();
      half.h = first.to - first.from;
      next_.resize(n);
      integrator_.Step(half, first.slope.data(), next_.data(), first.slope_after.data());
      first.end = second.begin = next_;
      second.slope = first.slope_after;
      const bool changes = HasChange(parts_[looked], first, step);
      found = found || changes;
      for (const int guard : falling) found = FallsAt(first, step, guard, entry.h) || found;
      if (!wide && falling.empty() && !changes) continue;
      parts_.push_back(std::move(first));
      parts_.push_back(std::move(second));
    }
    if (!found) return;
    if (found_.steps++ == 0) found_.first = step.t;
    const double begin = step.t - input_.begin;
    const auto add = [&](double time) {
      if (time > 0 && time < input_.duration) found_.ends.push_back(time / input_.duration);
    };
    for (std::size_t i = 1; i < parts_.size(); i += 2) add(begin + parts_[i].to);
    for (double apart = 0; apart < input_.duration; apart += apart + entry.h) {
      add(begin - apart);
      add(begin + entry.h + apart);
    }
  }

  // Bounds the flow and the guards over a part.
  void BoundIn(const Part& part, const FlowStep& step) {
    const std::size_t n = part.begin.size();
    const double third = (part.to - part.from) / 3;
    x_.resize(n);
    slopes_.resize(n);
    guards_.resize(system_.num_guards(step.mode));
    for (std::size_t i = 0; i < n; ++i) {
      // The cubic through the ends lies between the smallest and the largest of its Bezier coefficients.
      const auto [least, most] = std::minmax({part.begin[i],
                                              part.begin[i] + third * part.slope[i],
                                              part.end[i] - third * part.slope_after[i],
                                              part.end[i]});
      x_[i] = {least, most};
    }
    box_ = {step.mode, {step.t + part.from, step.t + part.to}, x_.data(), step.u, step.p};
    functions_.Bound(box_, slopes_.data(), guards_.data());
  }

  static double SlopeAtEnds(const Part& part, int i) {
    return std::max(std::abs(part.slope[i]), std::abs(part.slope_after[i]));
  }

  // Whether a slope may be much larger within a part than at its ends, or much smaller: a motion that nearly stops,
  // where its own state decides, takes longer by the quotient of the slopes.
  bool IsWide(const Part& part, int i) const {
    if (flies_) return false;
    const Bounds& slope = slopes_[i];
    const double width = slope.high - slope.low, moves = width * (part.to - part.from);
    if (width > kWide * SlopeAtEnds(part, i)) return moves > negligible_[i];
    const double least = std::min(std::abs(part.slope[i]), std::abs(part.slope_after[i]));
    if (!(part.slope[i] * part.slope_after[i] > 0)) return false;
    const double slowest = std::max(part.slope[i] > 0 ? slope.low : -slope.high, 0.0);
    return kWide * slowest < least && moves * least > negligible_[i] * slowest;
  }

  // Whether a guard above zero at the beginning of a step may fall below within the part, and return.
  bool MayFall(const FlowStep& step, int guard) {
    if (!(guards_[guard].low < 0)) return false;
    if (is_above_[guard] < 0) is_above_[guard] = functions_.Guard(step, guard) > 0 ? 1 : 0;
    if (is_above_[guard] == 0) return false;
    const Bounds rate = functions_.BoundGuardRate(box_, guard, slopes_.data());
    return rate.low < 0 && rate.high > 0;
  }

  // Whether the flow in the middle of a part, to which its first half leads, differs from what the ends of the part
  // lead to.
  bool HasChange(const Part& part, const Part& first, const FlowStep& step) {
    const double length = part.to - part.from;
    for (int i = 0; i < std::ssize(part.begin); ++i) {
      if (flies_ || !(all_ || IsWide(part, i))) continue;
      const double mean = (part.end[i] - part.begin[i]) / length;
      const double expected = 1.5 * mean - 0.25 * (part.slope[i] + part.slope_after[i]);
      const double off = std::abs(first.slope_after[i] - expected);
      if (!std::isfinite(off) || off <= kSeen * SlopeAtEnds(part, i) || off * length <= negligible_[i]) continue;
      const bool is_shortest = !(found_.length > 0 && found_.length <= length);
      Keep("the derivative of " + system_.StateName(step.mode, i), step, first.to, length, "what it adds is missed");
      if (is_shortest) found_.unbounded = has_bounds_ && !std::isfinite(slopes_[i].high - slopes_[i].low);
      return true;
    }
    return false;
  }

  // Whether a guard is below zero at the end of a half of a part. At the end of a step with an event it is zero, up to
  // rounding.
  bool FallsAt(const Part& first, const FlowStep& step, int guard, double h) {
    const double value = functions_.Guard({step.mode, step.t + first.to, first.end.data(), step.u, step.p}, guard);
    const double width = guards_[guard].high - guards_[guard].low;
    if (value >= -kBelow * width || first.to >= (1 - kAtEnd) * h) return false;
    const std::string kind = functions_.IsSwitch(step.mode, guard) ? "switch '" : "guard '";
    Keep(kind + system_.GuardName(step.mode, guard) + "'",
         step,
         first.to,
         2 * (first.to - first.from),
         "its events may be missed");
    return true;
  }

  void Keep(const std::string& what, const FlowStep& step, double s, double length, const char* missed) {
    if (found_.length > 0 && !(length < found_.length)) return;
    found_.length = length;
    found_.what = what + " changes faster than the steps resolve, in mode '" + system_.ModeName(step.mode) +
                  "' at t = " + ToText(step.t + s, 10) + ": " + missed;
  }

  const HybridSystem& system_;
  const HybridFunctions& functions_;
  const HybridInput& input_;
  const MotionTape& tape_;
  const bool all_, first_;
  RungeKutta integrator_;
  std::vector<double> negligible_;  // changes of each component
  // The step, and the part of it, that are looked at.
  std::vector<Part> parts_;  // the first is all of it
  std::vector<char> is_above_;
  bool flies_ = false, has_bounds_ = false;
  std::vector<double> next_;
  ModeBox box_{};
  std::vector<Bounds> x_, slopes_, guards_;
  HiddenChanges found_;
};

}  // namespace

HiddenChanges FindHiddenChanges(const HybridSystem& system, const HybridInput& input, const MotionTape& tape,
                                double tolerance, Changes which) {
  return Search(system, input, tape, tolerance, which).Run();
}

}  // namespace saltus
