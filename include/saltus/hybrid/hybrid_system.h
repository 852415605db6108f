// Hybrid systems: a state follows a differential equation until a guard falls through zero, and is then reset.
//
// A system is a struct with constants and three templates on the scalar T, which is double or a ceres::Jet:
//
//   struct BouncingBall {  // SI units; members are constants of the system
//     static constexpr int kNumControls = 1;                // f: force per mass, m/s^2
//     static constexpr int kNumParameters = 2;              // g: gravity, m/s^2; e: restitution
//     static constexpr std::array kStateSizes = {2};        // of each mode; here [y v]
//     static constexpr std::array kNumGuards = {1};         // of each mode
//
//     template <typename T>
//     void Flow(int mode, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
//       xdot[0] = x[1];
//       xdot[1] = u[0] - p[0];
//     }
//     template <typename T>
//     T Guard(int mode, int guard, const T& t, const T* x, const T* p) const {
//       return x[0];                                        // an event where it falls through zero
//     }
//     template <typename T>
//     int Reset(int mode, int guard, const T& t, const T* x, const T* p, T* x_plus) const {
//       x_plus[0] = x[0];
//       x_plus[1] = -p[1] * x[1];
//       return 0;                                           // the next mode
//     }
//   };
//   HybridSystem system{BouncingBall()};
//
// Optional: int OnAccumulation(int mode, int guard) const returns the mode in which a motion goes on where events of
// the guard accumulate (Zeno behaviour), or -1. Its states have the size of those of the last event's mode. The motion
// goes on from the state after that event, within 1e-9 of the duration of the accumulation from its limit.
//
// Optional: a closed form of the flow of some modes, which replaces the integration:
//
//     template <typename T>   // sets the state at t + s, of the state x at t; false in a mode that has none
//     bool Fly(int mode, const T& t, const T& s, const T* x, const T* u, const T* p, T* after) const;
//
// Flow must exist nevertheless. Steps must be so short that no guard crosses zero twice in one.
//
// Optional: switches, where the flow jumps or has a kink. A flow must not branch on the state or the time itself,
// because the derivative by the time of the change would be missing. It gets the side of each switch on which the
// motion is:
//
//     static constexpr std::array kNumSwitches = {1};       // of each mode, at most 6
//     template <typename T>   // its zeros are located as those of guards
//     T Switch(int mode, int number, const T& t, const T* x, const T* p) const { return x[1]; }
//     template <typename T>   // above[i]: switch i of the mode is above zero; the flow is smooth on either side
//     void Flow(int mode, const T& t, const T* x, const T* u, const T* p, const bool* above, T* xdot) const {
//       xdot[0] = x[1];
//       xdot[1] = -p[0] + (above[0] ? -0.1 : 0.1) * x[1] * x[1];
//     }
//
// A Fly gets `above` before `after`, too. A motion that the flows on both sides of a switch drive towards it ends
// there, and the reason states this.
//
// Names are optional and appear in messages and outputs: static constexpr std::array<const char*, n> kModeNames,
// kControlNames and kParameterNames; kGuardNames, those of all modes one after the other; kStateNames, those of all
// modes one after the other, or those of one mode if all modes have states of the same size; kSwitchNames, those of all
// modes one after the other.
//
// The functions must not keep state: they are called from several threads, and for times in any order.
#pragma once

#include <concepts>
#include <memory>
#include <string>
#include <utility>

#include "saltus/internal/hybrid_functions.h"
#include "saltus/internal/switched_pieces.h"

namespace saltus {

// A hybrid system of any type, so that simulation, differentiation and optimisation are compiled once. Copies share the
// functions.
class HybridSystem {
 public:
  template <typename S>
  requires(!std::derived_from<std::remove_cvref_t<S>, HybridSystem> &&
           requires { S::kStateSizes; }) explicit HybridSystem(S system) {
    if constexpr (requires { S::kNumSwitches; }) {
      functions_ = std::make_shared<HybridFunctionsOf<SwitchedPieces<S>>>(SwitchedPieces<S>{std::move(system)});
    } else {
      functions_ = std::make_shared<HybridFunctionsOf<S>>(std::move(system));
    }
  }
  // Makes a system from an implementation of the interface of functions. Precondition: not null.
  explicit HybridSystem(std::shared_ptr<const HybridFunctions> functions) : functions_(std::move(functions)) {}

  const HybridFunctions& functions() const { return *functions_; }
  const HybridLayout& layout() const { return functions_->layout(); }

  // Returns the number of modes; if motions create modes, the number of those created so far. Pieces of modes with
  // switches are modes (HybridFunctions::BaseMode), after those of the user.
  int num_modes() const { return functions_->num_modes(); }
  int num_controls() const { return layout().num_controls; }
  int num_parameters() const { return layout().num_parameters; }
  // Return the sizes of a mode. Precondition: 0 <= mode < num_modes().
  int state_size(int mode) const { return functions_->state_size(mode); }
  int num_guards(int mode) const { return functions_->num_guards(mode); }

  // Return names, or "mode 0", "guard 0", "x[0]", "u[0]" and "p[0]" if the system has none.
  std::string ModeName(int mode) const { return functions_->ModeName(mode); }
  std::string GuardName(int mode, int guard) const { return functions_->GuardName(mode, guard); }
  std::string StateName(int mode, int component) const { return functions_->StateName(mode, component); }
  std::string ControlName(int component) const;
  std::string ParameterName(int component) const;

 private:
  std::shared_ptr<const HybridFunctions> functions_;
};

}  // namespace saltus
