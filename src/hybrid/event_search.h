// When a guard falls through zero: within a step of the integration, and on entry into a mode.
//
// Within a step of length h the state after a part s of it is that of a step of length s: no dense output is needed,
// and the state at an event is as accurate as any other. The search begins where the cubic through the guard's values
// and rates at the ends of the step has its first zero (contact/event/event_roots.h), and continues by Newton's method,
// safeguarded by bisection.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "contact/event/event_roots.h"
#include "hybrid/runge_kutta.h"

namespace saltus {

// The cubic with these values and rates at 0 and h > 0.
GapPolynomial Hermite(const GuardValue& begin, const GuardValue& end, double h);

class EventSearch {
 public:
  explicit EventSearch(const HybridFunctions& functions);

  // At the beginning of a step, whose slope is given.
  GuardValue GuardAt(const FlowStep& step, const double* slope, int guard) const;

  // How a guard, which is `now`, stands on entry into a mode at step.t, step.x; kSinking: at zero with a rate of zero,
  // from where it falls. The length of the step is one over which guards of interest change, and `elapsed` is the time
  // over which the motion has come there. Enter, before, finds the derivatives of all guards there.
  enum class GuardStatus { kArmed, kRising, kFalling, kSinking, kBehind };
  void EnterMode(const FlowStep& step);
  GuardStatus Classify(const FlowStep& step, const double* slope, int guard, const GuardValue& now, double elapsed);

  // The errors that the value of a guard with the rate `rate` may have: by rounding alone, and with the error of an
  // integration over the time `elapsed`. Neither depends on the duration of the motion.
  struct Window {
    double rounding = 0, integrated = 0;
  };
  Window WindowOf(const FlowStep& step, int guard, double rate, double elapsed);

  struct GuardCrossing {
    enum class Kind { kNothing, kEvent, kGrazing } kind = Kind::kNothing;
    double s = 0;  // since the beginning of the step
  };
  // The first event of a guard in a step, given where the guard stands at its ends. One that is not armed must rise
  // above zero before.
  GuardCrossing Find(const FlowStep& step, const double* slope, int guard, bool armed, const GuardValue& begin,
                     const GuardValue& end);
  // Whether a guard that rises at the beginning of a step and is above zero at its end is looked at in between as well:
  // it may have a kink, as the gap of a corner that moves on to another edge, and return before.
  bool MayReturn(const FlowStep& step, int guard, const GuardValue& begin, const GuardValue& end) const;

  // The size of a guard's terms, of which rounding errors are a part: sum |g_x x| + |g_t t| + sum |g_p p| + sum |g_u
  // u|.
  double Scale(const FlowStep& step, int guard);

  RungeKutta& integrator() { return integrator_; }

  GuardValue GuardAfter(const FlowStep& step, const double* slope, int guard, double s);
  bool StaysAtZero(const FlowStep& step, const double* slope, int guard, const GuardValue& begin, const GuardValue& end,
                   double s);
  // The point there.
  FlowStep PointAfter(const FlowStep& step, const double* slope, double s);

  // Where in a step a guard that is at zero, and neither armed nor behind, falls below zero without rising before;
  // kNothing if it does not.
  GuardCrossing FindSinking(const FlowStep& step, const double* slope, int guard, const GuardValue& begin,
                            const GuardValue& end, double elapsed);

  // Removes the derivatives kept, before a motion with other controls or parameters.
  void Forget() { kept_.clear(); }

 private:
  using Terms = std::span<const GuardTerm>;
  // Returns the terms of a guard at a point, until the next call.
  Terms TermsOf(const FlowStep& step, int guard);
  double ScaleBy(const FlowStep& step, Terms terms) const;
  // The error of a guard's value, relative to the terms that states contribute, and to those of which time, parameters
  // and controls are known to rounding.
  double ErrorBy(const FlowStep& step, Terms terms, double rate, double elapsed, double of_states) const;
  GuardCrossing Locate(const FlowStep& step, const double* slope, int guard, double above, double below, double guess,
                       double curvature);
  GuardCrossing FindBelowKink(const FlowStep& step, const double* slope, int guard, const GuardValue& begin,
                              const GuardValue& end);
  double FirstBelow(const FlowStep& step, const double* slope, int guard, double above, double noise);
  bool FindAbove(const FlowStep& step, const double* slope, int guard, double before, double* above);

  // The state and slope after a part s of a step. Several guards ask for the same: those of one step are kept.
  struct Kept {
    double s = 0;
    std::size_t state = 0;  // in numbers_; the slope follows
    bool asked = false;     // for a guard
    std::vector<GuardValue> guards;
  };
  const double* StateAfter(const FlowStep& step, const double* slope, double s);

  const HybridFunctions& functions_;
  RungeKutta integrator_;
  FlowStep kept_step_;
  std::vector<Kept> kept_;
  std::vector<double> numbers_;  // state and slope at the beginning of the step, then those that are kept
  std::vector<GuardTerm> of_one_;
  std::vector<GuardTerm> terms_;     // of all guards on entry into a mode,
  std::vector<std::size_t> begins_;  // and where those of each begin
  std::vector<double> flow_scales_;  // sizes of the terms of the flow there, once asked for: rounding is a part
  std::vector<double> jacobian_;
};

}  // namespace saltus
