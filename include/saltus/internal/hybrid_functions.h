// A hybrid system as the engine sees it: an interface of doubles, and the adapter that puts a user's struct behind it.
//
// The engine (integration, location of events, adjoint) is compiled once, in hybrid/; it depends on HybridFunctions
// only. A user's struct contributes HybridFunctionsOf<S>, which instantiates the struct's own functions in double and
// in Jets, and nothing else. The arrangement is that of ceres::CostFunction and ceres::AutoDiffCostFunction.
#pragma once

#include <ceres/jet.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "saltus/internal/complete_jets.h"
#include "saltus/internal/runge_kutta_step.h"

namespace saltus {

// Sizes and names of a hybrid system. Names are empty, or one for each of what they name; those of guards and states go
// through all modes, one after the other.
struct HybridLayout {
  int num_controls = 0;
  int num_parameters = 0;
  std::vector<int> state_sizes = {};  // of each mode
  std::vector<int> num_guards = {};   // of each mode
  std::vector<std::string> mode_names = {}, guard_names = {}, state_names = {}, control_names = {},
                           parameter_names = {};
};

// A guard, and its derivative by time along the motion.
struct GuardValue {
  double value = 0, rate = 0;
};

// A derivative of a guard by one of [x t p u] that is not zero: few are, in systems of many parts.
struct GuardTerm {
  int input;
  double derivative;
};
// Appends the derivatives of a row by [x t ...], with n states, that are not zero: first that by t.
inline void AppendTerms(const double* row, int n, int columns, std::vector<GuardTerm>* terms) {
  if (row[n] != 0) terms->push_back({n, row[n]});
  for (int i = 0; i < columns; ++i) {
    if (row[i] != 0 && i != n) terms->push_back({i, row[i]});
  }
}

struct Bounds {
  double low = 0, high = 0;
};
// Points with times and states within bounds.
struct ModeBox {
  int mode;
  Bounds t;
  const Bounds* x;
  const double *u, *p;
};

// A block of the state of a mode whose motion between events depends on no other state, with the components of the
// control that it reads.
struct StatePart {
  enum class Motion {
    kSteps,   // a step for each of the integration
    kCoasts,  // without a control, in one step of any length
    kRests,   // not at all, and no event changes it
  };
  std::vector<int> states, controls;
  Motion motion = Motion::kSteps;
  bool always_moves_by_part = false;  // by HybridFunctions::MovePart, where it is the only part too
};

// Values and derivatives of flow, guards and resets. x has the size of the mode's state (n), u of the control (m), p of
// the parameters (P). Derivatives are row-major, with respect to [x t p u] (n + 1 + P + m columns) or [x t p].
//
// Modes may be created as a motion meets them: such functions override what is said of modes here, and their layout has
// one mode, with the size of all states and the largest number of guards.
class HybridFunctions {
 public:
  virtual ~HybridFunctions() = default;
  const HybridLayout& layout() const { return layout_; }

  // The number of modes. A mode that a reset has returned exists from then on. Precondition: 0 <= mode < num_modes().
  virtual int num_modes() const { return static_cast<int>(layout_.state_sizes.size()); }
  virtual int state_size(int mode) const { return layout_.state_sizes[mode]; }
  virtual int num_guards(int mode) const { return layout_.num_guards[mode]; }
  virtual std::string ModeName(int mode) const;
  virtual std::string GuardName(int mode, int guard) const;
  virtual std::string StateName(int mode, int component) const;
  // Returns the largest number of states of any mode.
  int most_states() const { return *std::max_element(layout_.state_sizes.begin(), layout_.state_sizes.end()); }

  virtual void Flow(const ModePoint& at, double* xdot) const = 0;
  // Computes x' and its derivative by [x t p u]: n x (n + 1 + P + m).
  virtual void FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const = 0;

  // A step of the integration in one call, with the flow in its loop (runge_kutta_step.h): x' and the slope there,
  // given the slope at the beginning; the slopes of all stages and their Jacobians, each one after the other. `scratch`
  // has room for as many slopes and a state.
  virtual void Step(const FlowStep& step, const double* slope, double* scratch, double* after,
                    double* slope_after) const;
  virtual void LinearizeStep(const FlowStep& step, double* scratch, double* slopes, double* jacobians) const;
  // Computes the vector-Jacobian product of a cotangent of x'; returns false if the step has to be linearized first.
  virtual bool PullBackStep(const FlowStep& /*step*/, const double* /*after*/, StepCotangent* /*out*/) const {
    return false;
  }

  // A step by a closed form of the flow; false if the mode has none. Unless `jacobian` is null, also by [x t p u]: n x
  // (n + 1 + P + m). By h its derivative is the flow after it.
  virtual bool Fly(const FlowStep& /*step*/, double* /*after*/, double* /*jacobian*/) const { return false; }
  // Whether the flow of a mode is affine in [x t p u] with constant coefficients, so that the second derivatives of a
  // step by these vanish.
  virtual bool IsLinear(int /*mode*/) const { return false; }

  // Returns the parts of a mode, in which each state and each component of the control is once; one, of all, if the
  // system is not known to have several.
  virtual std::vector<StatePart> Parts(int mode) const;
  // Moves one of several parts, or one that always moves so, by a closed form: x, u and `after` are those of the part.
  // Unless `jacobian` is null, it is set to the derivative by [x t p u h]. Precondition: the part does not rest.
  virtual void MovePart(int /*part*/, const FlowStep& /*step*/, double* /*after*/, double* /*jacobian*/) const {}
  // Returns the parts whose states a guard reads, or its reset reads or changes.
  virtual std::vector<int> PartsOf(int mode, int guard) const;

  virtual double Guard(const ModePoint& at, int guard) const = 0;
  // Returns a guard, and sets its derivative by time along xdot, under a control that is held.
  virtual double GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const = 0;
  // Sets value and rate of all guards of a mode.
  virtual void GuardRates(const ModePoint& at, const double* xdot, GuardValue* all) const {
    for (int guard = 0; guard < num_guards(at.mode); ++guard) {
      all[guard].value = GuardRate(at, guard, xdot, &all[guard].rate);
    }
  }
  // Returns a guard, and sets its derivative by [x t p u]: n + 1 + P + m numbers.
  virtual double GuardGradient(const ModePoint& at, int guard, double* gradient) const = 0;
  // Computes the values and gradients of all guards of a mode, a row each.
  virtual void GuardGradients(const ModePoint& at, double* values, double* gradients) const {
    const int columns = state_size(at.mode) + 1 + layout().num_parameters + layout().num_controls;
    for (int guard = 0; guard < num_guards(at.mode); ++guard) {
      values[guard] = GuardGradient(at, guard, gradients + guard * columns);
    }
  }

  // Finds the least value of a guard within a step, its ends included, and sets its derivative by [x t p u h] unless
  // `gradient` is null. Where the system has several parts, only those that the guard reads are set in the state; the
  // others are zero. Returns false if no finite value is found.
  virtual bool LeastGuard(const FlowStep& step, int guard, double* value, double* gradient) const;

  // Returns the number of inequalities, rows <= 0, that hold at an event in addition to its guard being zero. An impact
  // of discs has one: they do not separate.
  virtual int num_event_rows(int /*mode*/, int /*guard*/) const { return 0; }
  // Computes these rows before the reset and, unless `jacobian` is null, their derivatives by [x t p], a row each.
  virtual void EventRows(const ModePoint& /*at*/, int /*guard*/, double* /*rows*/, double* /*jacobian*/) const {}
  // Returns a system with the same modes whose events are all in one regime, which one more row of each event states as
  // an inequality. Regimes of discs are those of ContactMode, slip and stick. Null if the system has no regimes.
  virtual std::shared_ptr<const HybridFunctions> RegimeOf(int /*regime*/) const { return nullptr; }

  // Whether bounds of the functions are known.
  virtual bool HasBounds() const { return false; }
  // Sets bounds of x' and of all guards of a mode, which may be wide. Precondition: HasBounds().
  virtual void Bound(const ModeBox& /*box*/, Bounds* /*slopes*/, Bounds* /*guards*/) const {}
  // Returns bounds of the derivative of a guard by time, given those of x'. Precondition: HasBounds().
  virtual Bounds BoundGuardRate(const ModeBox& /*box*/, int /*guard*/, const Bounds* /*slopes*/) const { return {}; }
  // Whether a mode has functions that may change within any time and be flat beside it.
  virtual bool MayHideChanges(int /*mode*/) const { return false; }

  // Returns the next mode, which may depend on the control; the state after the reset does not. Below zero: there is
  // none, and ReasonNoMode returns the reason; below -1 there may be with shorter steps. x_plus has room for the
  // largest state of any mode; what a reset into a mode with a smaller state leaves is not read.
  virtual int Reset(const ModePoint& at, int guard, double* x_plus) const = 0;
  // Resets, and sets the derivative by [x t p]: (size of the next mode's state) x (n + 1 + P), room for the largest.
  virtual int ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const = 0;
  // Whether a reset may have kinks or jumps.
  virtual bool ResetMayBreak(int /*mode*/, int /*guard*/) const { return !CreatesModes(); }
  // Returns why a reset returns a negative number; with guard -1, why ModeAfterControlJump does.
  virtual std::string ReasonNoMode(const ModePoint& /*at*/, int /*guard*/) const { return ""; }
  // Returns why a reset (-1: the mode in which a motion goes on) has no derivative or one-sided ones; empty if it has.
  virtual std::string ReasonNoDerivative(const ModePoint& /*at*/, int /*guard*/) const { return ""; }

  // Returns the mode in which a motion goes on from the state x when its control jumps to u, which the point has; a
  // negative number if there is none.
  virtual int ModeAfterControlJump(const ModePoint& at) const { return at.mode; }

  // Whether the states of a mode satisfy equations (as those of closed contacts), from which errors of the integration
  // lead away. The engine then projects the state onto them after each step.
  virtual bool Projects(int /*mode*/) const { return false; }
  virtual void Project(int /*mode*/, const double* /*x*/, const double* /*p*/, double* /*x_plus*/) const {}
  // Projects, and sets the derivative by [x t p]: n x (n + 1 + P).
  virtual void ProjectJacobian(const ModePoint& /*at*/, double* /*x_plus*/, double* /*jacobian*/) const {}

  // Whether a guard that a reset leaves below zero, and that rises, waits until it is above zero in the place of an
  // event.
  virtual bool RearmsAboveZero(int /*mode*/, int /*guard*/) const { return false; }

  // Whether modes are created as a motion meets them. Their states are all of one size, and which of them a reset leads
  // to does not change the state after it, which is finite, even if there is no next mode, where it is known.
  virtual bool CreatesModes() const { return false; }
  // Returns the modes that a guard's reset may lead to, or with guard -1 a jump of the control.
  virtual std::vector<int> NextModes(int /*mode*/, int /*guard*/, const double* /*p*/) const { return {}; }

  // Returns a system with the same motions but without the events that change nothing while all parameters but those in
  // `free` are p, such as reversals of contacts without friction; null if there are none. Derivatives by p are lost.
  virtual std::shared_ptr<const HybridFunctions> RemoveIdleEvents(const double* /*p*/,
                                                                  std::span<const int> /*free*/) const {
    return nullptr;
  }
  // Returns the mode with the flow of the mode of that name of a system without idle events, or of one with them.
  virtual int EquivalentMode(const std::string& /*name*/) const { return -1; }

  // Whether a guard depends on the control.
  virtual bool ReadsControl(int /*mode*/, int /*guard*/) const { return false; }

  // Returns the mode in which a motion goes on where events of a guard accumulate (Zeno behaviour), with states of the
  // same size; a negative number if there is none.
  virtual int OnAccumulation(int /*mode*/, int /*guard*/) const { return -1; }
  // Whether the resets themselves end an accumulation.
  virtual bool EndsAccumulations() const { return false; }

  // Switches: guards, the last ones of a mode, at whose zeros the flow jumps or has a kink. The state stays what it is,
  // and the motion goes on in another piece of what is one mode to the user, its base mode. The pieces are modes here.
  virtual int num_switches(int /*mode*/) const { return 0; }
  bool IsSwitch(int mode, int guard) const { return guard >= num_guards(mode) - num_switches(mode); }
  virtual int BaseMode(int mode) const { return mode; }
  virtual int num_base_modes() const { return num_modes(); }
  // Returns the piece of the point's base mode that the values of the switches name.
  virtual int PieceAt(const ModePoint& at) const { return at.mode; }
  // The piece that differs from the point's in the side of one switch: above zero, below, on zero, where the function
  // of the user may have a value of its own (as the sign of zero), sliding along it (Filippov's convention: the average
  // of the flows on both sides that keeps the switch at zero), or the other side than the point's. -1: there is none.
  enum class Side { kBelow = -1, kOn = 0, kAbove = 1, kSliding, kOther };
  virtual int AdjacentPiece(const ModePoint& /*at*/, int /*guard*/, Side /*side*/) const { return -1; }
  // Whether a mode is the piece on zero of a switch, whose value stays zero there.
  virtual bool IsOn(int /*mode*/, int /*guard*/) const { return false; }
  // Returns the numbers, as text, that conditions of a mode's functions compare with zero and that are zero at a point,
  // if they depend on the parameters and the control alone, so that no motion changes them: the functions may have
  // kinks or jumps there.
  virtual std::vector<std::string> UndecidedConditions(const ModePoint& /*at*/) const { return {}; }
  // Returns the largest number of guards of any mode.
  virtual int most_guards() const { return *std::max_element(layout_.num_guards.begin(), layout_.num_guards.end()); }

  // Returns the guard that an event of `guard` is one of, if several reach zero at once: of these, the one that tells
  // what the reset changes.
  virtual int CauseOf(const ModePoint& /*at*/, int guard) const { return guard; }

  // Appends the derivatives of a guard that are not zero, that by t before those by x, p and u.
  virtual void AppendGuardTerms(const ModePoint& at, int guard, std::vector<GuardTerm>* terms) const;
  // Appends those of all guards of a mode, one after the other, and to `ends` where those of each guard end.
  virtual void AppendAllGuardTerms(const ModePoint& at, std::vector<GuardTerm>* terms,
                                   std::vector<std::size_t>* ends) const {
    for (int guard = 0; guard < num_guards(at.mode); ++guard) {
      AppendGuardTerms(at, guard, terms);
      ends->push_back(terms->size());
    }
  }

 protected:
  explicit HybridFunctions(HybridLayout layout) : layout_(std::move(layout)) {}

 private:
  const HybridLayout layout_;
};

template <typename S>
class HybridFunctionsOf final : public HybridFunctions {
 public:
  static constexpr int kNumModes = static_cast<int>(S::kStateSizes.size());
  static_assert(kNumModes > 0, "kStateSizes: a system has at least one mode");
  static_assert(S::kNumGuards.size() == S::kStateSizes.size(), "kNumGuards has one number for each mode");
  static_assert(S::kNumControls >= 0 && S::kNumParameters >= 0);
  static_assert(*std::min_element(S::kStateSizes.begin(), S::kStateSizes.end()) > 0, "every mode has a state");
  static_assert(*std::min_element(S::kNumGuards.begin(), S::kNumGuards.end()) >= 0);

  explicit HybridFunctionsOf(S system) : HybridFunctions(LayoutOf<Described>()), system_(std::move(system)) {}

  int num_modes() const override { return kNumModes; }
  int state_size(int mode) const override { return S::kStateSizes[mode]; }
  int num_guards(int mode) const override { return S::kNumGuards[mode]; }
  int most_guards() const override { return *std::max_element(S::kNumGuards.begin(), S::kNumGuards.end()); }
  int num_base_modes() const override { return static_cast<int>(Described::kStateSizes.size()); }
  int BaseMode(int mode) const override { return mode % num_base_modes(); }
  std::string ModeName(int mode) const override { return HybridFunctions::ModeName(BaseMode(mode)); }
  std::string StateName(int mode, int component) const override {
    return HybridFunctions::StateName(BaseMode(mode), component);
  }
  std::string GuardName(int mode, int guard) const override {
    if constexpr (kHasPieces) {
      if (IsSwitch(mode, guard)) return S::SwitchName(mode, guard);
    }
    return HybridFunctions::GuardName(BaseMode(mode), guard);
  }
  int num_switches(int mode) const override {
    if constexpr (kHasPieces) return S::NumSwitches(mode);
    return 0;
  }
  int PieceAt(const ModePoint& at) const override {
    if constexpr (kHasPieces) return system_.PieceAt(BaseMode(at.mode), at.t, at.x, at.p);
    return at.mode;
  }
  int AdjacentPiece(const ModePoint& at, int guard, Side side) const override {
    if constexpr (kHasPieces) {
      if (side == Side::kOther) return S::AdjacentPiece(at.mode, guard);
    }
    return -1;
  }

  void Flow(const ModePoint& at, double* xdot) const override { system_.Flow(at.mode, at.t, at.x, at.u, at.p, xdot); }
  void FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const override {
    const int rows = S::kStateSizes[at.mode];
    ForEachJetPass(at, S::kNumControls, [&](Variables& v, int first, int width, int columns) {
      std::array<Jet, kMostStates> out;
      const auto flow = [&] { system_.Flow(at.mode, v.t, v.x.data(), v.u.data(), v.p.data(), out.data()); };
      flow();
      Complete(&v, rows, &out, flow);
      Unpack(out, rows, first, width, columns, xdot, jacobian);
    });
  }

  void Step(const FlowStep& step, const double* slope, double* /*scratch*/, double* after,
            double* slope_after) const override {
    if (kFlies && Fly(step, after, nullptr)) {
      return system_.Flow(step.mode, step.t + step.h, after, step.u, step.p, slope_after);
    }
    DispatchMode(step.mode, [&](auto mode) {
      const auto flow = [&](double t, const double* x, double* xdot) {
        system_.Flow(mode, t, x, step.u, step.p, xdot);
      };
      EvaluateStep<S::kStateSizes[mode]>(step, flow, slope, after, slope_after);
    });
  }
  void LinearizeStep(const FlowStep& step, double* /*scratch*/, double* slopes, double* jacobians) const override {
    DispatchMode(step.mode, [&](auto mode) {
      constexpr int kSize = S::kStateSizes[mode], kColumns = kSize + 1 + S::kNumParameters + S::kNumControls;
      if constexpr (kColumns <= kStride) {
        std::array<Jet, cooper_verner::kStages * kSize> stages;
        LinearizeAllColumns<mode>(step, slopes, stages.data());
        if (!HasDerivatives<Jet>(stages)) LinearizeAllColumns<mode, /*kComplete=*/true>(step, slopes, stages.data());
        for (const Jet& row : stages) jacobians = std::copy_n(row.v.data(), kColumns, jacobians);
      } else {
        const auto flow = [&](double t, const double* x, double* slope, double* jacobian) {
          HybridFunctionsOf::FlowJacobian({mode, t, x, step.u, step.p}, slope, jacobian);
        };
        saltus::LinearizeStep<kSize>(step, kSize * kColumns, flow, slopes, jacobians);
      }
    });
  }
  bool PullBackStep(const FlowStep& step, const double* after, StepCotangent* out) const override {
    if (kFlies) return false;
    bool in_one_pass = false;
    DispatchMode(step.mode, [&](auto mode) {
      constexpr int kSize = S::kStateSizes[mode], kStages = cooper_verner::kStages;
      if constexpr (kSize + 1 + S::kNumParameters + S::kNumControls <= kStride) {
        in_one_pass = true;
        std::array<double, kStages * kSize> slopes;
        union Stages {  // not constructed, which takes time: all are written before they are read
          Stages() {}
          Jet jets[kStages * kSize];
        } stages;
        LinearizeAllColumns<mode>(step, slopes.data(), stages.jets);
        std::array<double, kSize + S::kNumParameters + S::kNumControls> before;
        double* next = std::copy_n(after, kSize, before.data());
        next = std::copy_n(out->p, S::kNumParameters, next);
        std::copy_n(out->u, S::kNumControls, next);
        PullBackStages<kSize, S::kNumParameters, S::kNumControls>(step.h, stages.jets, after, out);
        double zero = 0 * out->t + 0 * out->h;  // unless a derivative is not finite
        for (int i = 0; i < kSize; ++i) zero += 0 * out->x[i];
        for (int i = 0; i < S::kNumParameters; ++i) zero += 0 * out->p[i];
        for (int i = 0; i < S::kNumControls; ++i) zero += 0 * out->u[i];
        if (zero == 0) return;
        std::copy_n(before.data() + kSize, S::kNumParameters, out->p);
        std::copy_n(before.data() + kSize + S::kNumParameters, S::kNumControls, out->u);
        LinearizeAllColumns<mode, /*kComplete=*/true>(step, slopes.data(), stages.jets);
        PullBackStages<kSize, S::kNumParameters, S::kNumControls>(step.h, stages.jets, before.data(), out);
      }
    });
    return in_one_pass;
  }
  bool Fly(const FlowStep& step, double* after, double* jacobian) const override {
    bool flies = false;
    if constexpr (kFlies) {
      if (jacobian == nullptr) return system_.Fly(step.mode, step.t, step.h, step.x, step.u, step.p, after);
      ForEachJetPass(step, S::kNumControls, [&](Variables& v, int first, int width, int columns) {
        std::array<Jet, kMostStates> out;
        const auto fly = [&] {
          flies = system_.Fly(step.mode, v.t, Jet(step.h), v.x.data(), v.u.data(), v.p.data(), out.data());
        };
        fly();
        if (flies) Complete(&v, S::kStateSizes[step.mode], &out, fly);
        if (flies) Unpack(out, S::kStateSizes[step.mode], first, width, columns, after, jacobian);
      });
    }
    return flies;
  }

  double Guard(const ModePoint& at, int guard) const override {
    return system_.Guard(at.mode, guard, at.t, at.x, at.p);
  }
  double GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const override {
    using Rate = ceres::Jet<double, 1>;
    std::array<Rate, kMostStates> state;
    for (int i = 0; i < S::kStateSizes[at.mode]; ++i) {
      state[i].a = at.x[i];
      state[i].v[0] = xdot[i];
    }
    std::array<Rate, S::kNumParameters> parameters;
    for (int i = 0; i < S::kNumParameters; ++i) parameters[i] = Rate(at.p[i]);
    Rate time(at.t);
    time.v[0] = 1;
    Rate value;
    const auto evaluate = [&] { value = system_.Guard(at.mode, guard, time, state.data(), parameters.data()); };
    evaluate();
    CompleteJets<Rate>({state, {&time, 1}, parameters}, {&value, 1}, evaluate);
    *rate = value.v[0];
    return value.a;
  }
  double GuardGradient(const ModePoint& at, int guard, double* gradient) const override {
    double value = 0;
    std::fill_n(gradient + S::kStateSizes[at.mode] + 1 + S::kNumParameters, S::kNumControls, 0.0);
    ForEachJetPass(at, 0, [&](Variables& v, int first, int width, int columns) {
      std::array<Jet, 1> out;
      const auto guard_at = [&] { out[0] = system_.Guard(at.mode, guard, v.t, v.x.data(), v.p.data()); };
      guard_at();
      Complete(&v, 1, &out, guard_at);
      Unpack(out, 1, first, width, columns, &value, gradient);
    });
    return value;
  }

  int OnAccumulation(int mode, int guard) const override {
    if constexpr (requires(const S& system) { system.OnAccumulation(0, 0); }) {
      return system_.OnAccumulation(mode, guard);
    } else {
      return -1;
    }
  }

  int Reset(const ModePoint& at, int guard, double* x_plus) const override {
    return system_.Reset(at.mode, guard, at.t, at.x, at.p, x_plus);
  }
  int ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const override {
    int next = 0;
    ForEachJetPass(at, 0, [&](Variables& v, int first, int width, int columns) {
      std::array<Jet, kMostStates> out;
      const auto reset = [&] { return system_.Reset(at.mode, guard, v.t, v.x.data(), v.p.data(), out.data()); };
      next = reset();
      if (next < 0 || next >= kNumModes) return;
      Complete(&v, S::kStateSizes[next], &out, reset);
      Unpack(out, S::kStateSizes[next], first, width, columns, x_plus, jacobian);
    });
    return next;
  }

 private:
  // The pieces of a struct with switches (switched_pieces.h), and the struct that has sizes and names.
  static constexpr bool kHasPieces = requires { typename S::Base; };
  template <typename Struct>
  static Struct BaseOf(...);
  template <typename Struct>
  static typename Struct::Base BaseOf(typename Struct::Base*);
  using Described = decltype(BaseOf<S>(nullptr));

  static constexpr bool kFlies = requires(const S& system, double t, const double* x, double* after) {
    system.Fly(0, t, t, x, x, x, after);
  };
  static constexpr int kMostStates = *std::max_element(S::kStateSizes.begin(), S::kStateSizes.end());
  static constexpr int kMostVariables = kMostStates + 1 + S::kNumParameters + S::kNumControls;
  // Derivatives in one pass: all, unless they are many.
  static constexpr int kMostInOnePass = 12;
  static constexpr int kStride = kMostVariables <= kMostInOnePass ? kMostVariables : 8;
  using Jet = ceres::Jet<double, kStride>;

  // Calls function(mode) with the mode as a constant.
  template <int kMode = 0, typename Function>
  static void DispatchMode(int mode, const Function& function) {
    if constexpr (kMode + 1 < kNumModes) {
      if (mode != kMode) return DispatchMode<kMode + 1>(mode, function);
    }
    function(std::integral_constant<int, kMode>());
  }

  struct Variables {
    std::array<Jet, kMostStates> x;
    Jet t;
    std::array<Jet, S::kNumParameters> p;
    std::array<Jet, S::kNumControls> u;
  };

  // Completes the derivatives of the first `rows` of `out`, which `function()` computes.
  template <std::size_t kSize, typename Function>
  static void Complete(Variables* v, int rows, std::array<Jet, kSize>* out, const Function& function) {
    CompleteJets<Jet>({v->x, {&v->t, 1}, v->p, v->u}, std::span(*out).first(rows), function);
  }

  // Sets Jets with the derivatives by columns first to first + kStride of [x t p u], `controls` columns of them of u.
  static void Seed(const ModePoint& at, int states, int controls, int first, Variables* v) {
    int column = 0;
    const auto seed = [&](double value, Jet* jet) {
      *jet = Jet(value);
      if (column >= first && column < first + kStride) jet->v[column - first] = 1;
      ++column;
    };
    for (int i = 0; i < states; ++i) seed(at.x[i], &v->x[i]);
    seed(at.t, &v->t);
    for (int i = 0; i < S::kNumParameters; ++i) seed(at.p[i], &v->p[i]);
    for (int i = 0; i < controls; ++i) seed(at.u[i], &v->u[i]);
  }

  // Calls function(variables, first, width, columns) until all columns of [x t p u] have been seen.
  template <typename Function>
  static void ForEachJetPass(const ModePoint& at, int controls, const Function& function) {
    const int states = S::kStateSizes[at.mode], columns = states + 1 + S::kNumParameters + controls;
    for (int first = 0; first < columns; first += kStride) {
      Variables v;
      Seed(at, states, controls, first, &v);
      function(v, first, std::min(kStride, columns - first), columns);
    }
  }

  // Computes the slopes of all stages of a step, and their Jets. All stages have the same variables of differentiation,
  // with other values. `kComplete`: Complete, which takes time, is called.
  template <int kMode, bool kComplete = false>
  void LinearizeAllColumns(const FlowStep& step, double* slopes, Jet* stages) const {
    constexpr int kSize = S::kStateSizes[kMode];
    Variables v;
    Seed(step, kSize, S::kNumControls, 0, &v);
    // With the flow inlined, the compiler sees that what it reads and what it writes are apart.
    const auto flow = [&](double t, const double* x, double* slope, Jet* stage) __attribute__((flatten, noinline)) {
      for (int i = 0; i < kSize; ++i) v.x[i].a = x[i];
      v.t.a = t;
      std::array<Jet, kMostStates> out;
      const auto evaluate = [&] { system_.Flow(kMode, v.t, v.x.data(), v.u.data(), v.p.data(), out.data()); };
      evaluate();
      if constexpr (kComplete) Complete(&v, kSize, &out, evaluate);
      for (int i = 0; i < kSize; ++i) {
        stage[i] = out[i];
        slope[i] = out[i].a;
      }
    };
    saltus::LinearizeStep<kSize>(step, kSize, flow, slopes, stages);
  }

  template <std::size_t kSize>
  static void Unpack(const std::array<Jet, kSize>& out, int rows, int first, int width, int columns, double* values,
                     double* jacobian) {
    for (int i = 0; i < rows; ++i) {
      values[i] = out[i].a;
      for (int j = 0; j < width; ++j) jacobian[i * columns + first + j] = out[i].v[j];
    }
  }

  template <typename D>
  static HybridLayout LayoutOf() {
    constexpr int kModes = static_cast<int>(D::kStateSizes.size());
    HybridLayout layout{.num_controls = D::kNumControls, .num_parameters = D::kNumParameters};
    layout.state_sizes.assign(D::kStateSizes.begin(), D::kStateSizes.end());
    layout.num_guards.assign(D::kNumGuards.begin(), D::kNumGuards.end());
    if constexpr (requires { D::kModeNames; }) {
      static_assert(D::kModeNames.size() == kModes, "kModeNames has one name for each mode");
      layout.mode_names.assign(D::kModeNames.begin(), D::kModeNames.end());
    }
    if constexpr (requires { D::kGuardNames; }) {
      static_assert(D::kGuardNames.size() == Sum(D::kNumGuards),
                    "kGuardNames has one name for each guard of each mode");
      layout.guard_names.assign(D::kGuardNames.begin(), D::kGuardNames.end());
    }
    if constexpr (requires { D::kStateNames; }) {
      constexpr bool kOfAllModes = D::kStateNames.size() == Sum(D::kStateSizes);
      static_assert(kOfAllModes || D::kStateNames.size() * kModes == Sum(D::kStateSizes),
                    "kStateNames has one name for each component of each mode, or of one mode if all have equal sizes");
      for (int mode = 0; mode < (kOfAllModes ? 1 : kModes); ++mode) {
        layout.state_names.insert(layout.state_names.end(), D::kStateNames.begin(), D::kStateNames.end());
      }
    }
    if constexpr (requires { D::kControlNames; }) {
      static_assert(D::kControlNames.size() == D::kNumControls, "kControlNames has one name for each control");
      layout.control_names.assign(D::kControlNames.begin(), D::kControlNames.end());
    }
    if constexpr (requires { D::kParameterNames; }) {
      static_assert(D::kParameterNames.size() == D::kNumParameters, "kParameterNames has one name for each parameter");
      layout.parameter_names.assign(D::kParameterNames.begin(), D::kParameterNames.end());
    }
    return layout;
  }

  template <std::size_t kSize>
  static constexpr std::size_t Sum(const std::array<int, kSize>& numbers) {
    std::size_t sum = 0;
    for (int number : numbers) sum += number;
    return sum;
  }

  const S system_;
};

}  // namespace saltus
