// Audit of a time-stepping scheme for a hybrid system: the gradient of its steps is compared with the exact one.
//
// A scheme computes the state after a step of a given length, by any method. Its gradient is composed by the chain rule
// from the Jacobians of its steps, which come from automatic differentiation or from differences. The exact gradient is
// the adjoint of the hybrid system with located events. Loss, initial state, control and parameters are those of a
// problem, whose costs are at control intervals or at the end.
#pragma once

#include <ceres/jet.h>

#include <algorithm>
#include <array>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "saltus/audit/audit.h"
#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// The beginning of a step: mode, time, length, state x (of the size of the mode), control u and parameters p.
struct SchemeStep {
  int mode = 0;
  double t = 0, h = 0;
  const double *x = nullptr, *u = nullptr, *p = nullptr;
};

// A time-stepping scheme. A step depends on its arguments only. Schemes are called from one thread.
class HybridScheme {
 public:
  virtual ~HybridScheme() = default;
  virtual std::string name() const = 0;
  // Returns the mode after the step, and its state in `next`, which has room for the largest of any mode. A `jacobian`
  // that is not null becomes the derivative by [x u p]: row-major, (size of the next mode's state) x (n + m + P).
  // Returns -1 and the reason in `error` if there is no such state.
  virtual int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) = 0;
  // Returns whether Jacobians are the scheme's own, and not differences of its steps.
  virtual bool HasJacobian() const { return true; }
};

// A step without a Jacobian: returns the next mode, or -1 and the reason, as HybridScheme::Step does.
using StepFunction = std::function<int(const SchemeStep&, double* next, std::string* error)>;
// Computes a step of `function` and, unless `jacobian` is null, its Jacobian by central differences, or by one-sided
// differences beside a jump of the state. `precision` is the relative precision of the new state. Returns what
// HybridScheme::Step returns.
int DifferenceStep(const HybridSystem& system, const SchemeStep& step, const StepFunction& function, double* next,
                   double* jacobian, std::string* error, double precision = std::numeric_limits<double>::epsilon());

// Makes a scheme of a struct that describes a hybrid system (hybrid_system.h) and has
//
//   template <typename T>
//   int Step(int mode, const T& t, const T* x, const T* u, const T* p, const T& h, T* next) const;
//
// which returns the mode after the step. It is differentiated by Jets.
template <typename S>
class HybridSchemeOf final : public HybridScheme {
 public:
  explicit HybridSchemeOf(S system, std::string name = "step") : system_(std::move(system)), name_(std::move(name)) {}

  std::string name() const override { return name_; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string*) override {
    if (jacobian == nullptr) return system_.Step(step.mode, step.t, step.x, step.u, step.p, step.h, next);
    const int states = S::kStateSizes[step.mode], columns = states + S::kNumControls + S::kNumParameters;
    std::array<Jet, kMostStates> x, out;
    std::array<Jet, S::kNumControls> u;
    std::array<Jet, S::kNumParameters> p;
    int column = 0;
    for (int i = 0; i < states; ++i) x[i] = Jet(step.x[i], column++);
    for (int i = 0; i < S::kNumControls; ++i) u[i] = Jet(step.u[i], column++);
    for (int i = 0; i < S::kNumParameters; ++i) p[i] = Jet(step.p[i], column++);
    const int mode = system_.Step(step.mode, Jet(step.t), x.data(), u.data(), p.data(), Jet(step.h), out.data());
    if (mode < 0 || mode >= static_cast<int>(S::kStateSizes.size())) return mode;
    for (int i = 0; i < S::kStateSizes[mode]; ++i) {
      next[i] = out[i].a;
      std::copy_n(out[i].v.data(), columns, jacobian + i * columns);
    }
    return mode;
  }

 private:
  static constexpr int kMostStates = *std::max_element(S::kStateSizes.begin(), S::kStateSizes.end());
  using Jet = ceres::Jet<double, kMostStates + S::kNumControls + S::kNumParameters>;
  const S system_;
  const std::string name_;
};

struct HybridAuditOptions {
  int steps = 100;                    // least number of steps; rounded up to a multiple of the control intervals
  RefinementOptions refinement = {};  // on one thread
  bool width_sweep = false;           // whether widths are swept even if the exact gradient exists
  // The loss jumps where an event moves to another step: differences over a few steps scatter more than those of discs.
  WidthSweepOptions widths = {.per_decade = 4, .largest = 400, .wide_from = 20, .wide_to = 200};
  StopRequest stop = nullptr;
};

// The part of the motion around one event, or several that are closer than two steps.
struct SegmentError {
  double time = 0;          // of the first event, s
  std::string mode, guard;  // of the first event
  int step = 0;             // the step in which it happens, from 0
  // The relative error of the costate at the beginning of the part, where the scheme starts from the exact state;
  // infinite if the scheme ends in another mode.
  double error = 0;
  bool stays = false;  // whether more than a quarter of the error is left with eight times the steps
};

struct HybridAudit {
  std::string scheme;
  std::string reason;  // why there is no verdict: the problem, the exact motion or the scheme fails, and where
  Verdict verdict = Verdict::kUnknown;
  int steps = 0;  // number of steps of `loss` and `gradient`
  double loss = 0, exact_loss = 0;
  HybridGradient gradient, exact;
  double order = 0;                           // observed order of the error in the step: the least of all quantities
  std::optional<RefinementStudy> refinement;  // of initial state, control and parameters; if there is an exact gradient
  std::optional<GradientCheck> gradient_check;  // of a scheme with Jacobians of its own
  std::vector<SegmentError> segments;           // of a wrong gradient
  int first_wrong = -1;                         // index of the first segment whose error is not small and stays
  std::optional<WidthSweepStudy> widths;
  bool interrupted = false;  // whether HybridAuditOptions::stop ended it

  bool ok() const { return reason.empty(); }
  // Returns the reason of the verdict in one sentence; empty for a right or a consistent gradient that agrees with
  // differences of its own loss.
  std::string VerdictReason() const;
};

// Audits the scheme at the problem's guess. `reason` of the result states what is wrong with the problem, if anything
// is.
HybridAudit AuditScheme(const HybridProblem& problem, HybridScheme* scheme, const HybridAuditOptions& options = {});

}  // namespace saltus
