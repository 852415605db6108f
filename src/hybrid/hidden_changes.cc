#include "hybrid/hidden_changes.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/number_text.h"
#include "base/statistics.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

constexpr int kMostParts = 96;           // of a step that are looked at
constexpr double kShortestPart = 1e-11;  // of the duration: of shorter parts quotients may have no digits
constexpr double kWide = 3;              // of a slope's size in a step: bounds that are looked into
constexpr double kSeen = 0.5;            // likewise, a difference from the slope that the ends of a part lead to
constexpr double kNegligible = 1e-9;     // of the largest number of a motion: what such a difference changes
constexpr double kBelow = 1e-12;         // of the width of its bounds: how far a guard is below zero

// A part of a step between two states of the motion and the slopes there.
struct Part {
  double from = 0, to = 0;
  std::vector<double> begin, end, slope, slope_after;
};

class Search {
 public:
  Search(const HybridSystem& system, const HybridInput& input, const MotionTape& tape)
      : system_(system), functions_(system.functions()), input_(input), tape_(tape), integrator_(functions_) {
    for (const double number : tape.numbers) negligible_ = std::max(negligible_, kNegligible * std::abs(number));
  }

  HiddenChange Run() {
    for (std::size_t i = 0; i < tape_.entries.size(); ++i) {
      const TapeEntry& entry = tape_.entries[i];
      if (entry.kind == TapeEntry::Kind::kReset || !(entry.h > 0) || !functions_.HasBounds(entry.mode)) continue;
      LookInto(entry, i + 1 < tape_.entries.size() ? tape_.entries[i + 1].x : tape_.final_state);
    }
    return found_;
  }

 private:
  void LookInto(const TapeEntry& entry, std::size_t end) {
    const int n = system_.state_size(entry.mode), num_guards = system_.num_guards(entry.mode);
    const double* u = input_.control.data() + static_cast<std::ptrdiff_t>(entry.interval) * system_.num_controls();
    const FlowStep step{{entry.mode, entry.t, &tape_.numbers[entry.x], u, input_.parameters.data()}, entry.h};
    Part& whole = parts_[0];
    whole.from = 0;
    whole.to = entry.h;
    whole.begin.assign(step.x, step.x + n);
    whole.end.assign(&tape_.numbers[end], &tape_.numbers[end] + n);
    whole.slope.resize(n);
    whole.slope_after.resize(n);
    functions_.Flow(step, whole.slope.data());
    functions_.Flow({step.mode, step.t + step.h, whole.end.data(), u, step.p}, whole.slope_after.data());
    sizes_.resize(n);
    for (int i = 0; i < n; ++i) {
      const double secant = (whole.end[i] - whole.begin[i]) / entry.h;
      sizes_[i] = std::max({std::abs(whole.slope[i]), std::abs(whole.slope_after[i]), std::abs(secant)});
    }
    x_.resize(n);
    slopes_.resize(n);
    guards_.resize(num_guards);
    std::size_t count = 1;
    for (std::size_t looked = 0; looked < count && looked < kMostParts; ++looked) {
      const Part& part = parts_[looked];
      const double length = part.to - part.from, middle = 0.5 * (part.from + part.to);
      if (length <= kShortestPart * input_.duration) continue;
      for (int i = 0; i < n; ++i) {
        // The cubic through the ends lies between the smallest and the largest of its Bezier coefficients.
        const double second = part.begin[i] + length / 3 * part.slope[i];
        const double third = part.end[i] - length / 3 * part.slope_after[i];
        const auto [least, most] = std::minmax({part.begin[i], second, third, part.end[i]});
        x_[i] = {least, most};
      }
      const Bounds times{step.t + part.from, step.t + part.to};
      functions_.Bound({step.mode, times, x_.data(), u, step.p}, slopes_.data(), guards_.data());
      const auto is_wide = [&](int i) {
        const double width = slopes_[i].high - slopes_[i].low;
        return width > kWide * sizes_[i] && width * length > negligible_;
      };
      // Events of guards above zero at the beginning are ahead.
      const auto may_fall = [&](int guard) { return guards_[guard].low < 0 && functions_.Guard(step, guard) > 0; };
      bool wide = false, falls = false;
      for (int i = 0; i < n && !wide; ++i) wide = is_wide(i);
      for (int guard = 0; guard < num_guards && !falls; ++guard) falls = may_fall(guard);
      next_.resize(n);
      if (wide) wide = !functions_.Fly(step, next_.data(), nullptr);  // a closed form is right for any step
      if (!wide && !falls) continue;
      Part first = part, second = part;
      first.to = second.from = middle;
      FlowStep half = step;
      half.h = middle;
      integrator_.Step(half, parts_[0].slope.data(), first.end.data(), first.slope_after.data());
      second.begin = first.end;
      second.slope = first.slope_after;
      for (int i = 0; i < n && wide; ++i) {
        const double mean = (part.end[i] - part.begin[i]) / length;
        const double expected = 1.5 * mean - 0.25 * (part.slope[i] + part.slope_after[i]);
        const double off = std::abs(first.slope_after[i] - expected);
        if (!is_wide(i) || !std::isfinite(off) || off <= kSeen * sizes_[i] || off * length <= negligible_) continue;
        const std::string what = "the derivative of " + system_.StateName(step.mode, i);
        return Keep(what, step, middle, length, "what it adds is missed");
      }
      for (int guard = 0; guard < num_guards; ++guard) {
        if (!may_fall(guard)) continue;
        const double value = functions_.Guard({step.mode, step.t + middle, first.end.data(), u, step.p}, guard);
        // Where the step ends at an event, the guard is zero there, up to rounding.
        const double width = guards_[guard].high - guards_[guard].low;
        if (value >= -kBelow * width || middle >= (1 - kNegligible) * step.h) continue;
        const std::string kind = functions_.IsSwitch(step.mode, guard) ? "switch '" : "guard '";
        return Keep(kind + system_.GuardName(step.mode, guard) + "'", step, middle, length, "its events may be missed");
      }
      if (count + 2 > parts_.size()) continue;
      parts_[count++] = std::move(first);
      parts_[count++] = std::move(second);
    }
  }

  void Keep(const std::string& what, const FlowStep& step, double s, double length, const char* missed) {
    if (found_.length > 0 && !(length < found_.length)) return;
    found_ = {what + " changes faster than the steps resolve, in mode '" + system_.ModeName(step.mode) +
                  "' at t = " + ToText(step.t + s, 10) + ": " + missed,
              length};
  }

  const HybridSystem& system_;
  const HybridFunctions& functions_;
  const HybridInput& input_;
  const MotionTape& tape_;
  RungeKutta integrator_;
  double negligible_ = 0;
  std::vector<Part> parts_ = std::vector<Part>(2 * kMostParts);  // of a step, the first of which is all of it
  std::vector<double> sizes_, next_;
  std::vector<Bounds> x_, slopes_, guards_;
  HiddenChange found_;
};

}  // namespace

HiddenChange FindHiddenChange(const HybridSystem& system, const HybridInput& input, const MotionTape& tape) {
  return Search(system, input, tape).Run();
}

}  // namespace saltus
