// The interface of a contact model: its functions, the data of one step, and what it guarantees.
//
// A contact model is a small class with one templated function, its step
//
//   x' = f(x, u)        x: positions and velocities of some discs,  u: the force on each, constant over the step.
//
// A model does not depend on trajectories, problems or solvers, nor on which part of a scene it is given: the same
// function steps a whole scene in double and, with T a Jet, the discs of one contact to differentiate it. Branches
// depend on values. Contributions of all contacts are computed from the state at the start of the step and added in the
// order of the candidates, unless a model's header states otherwise. A model computes in SI units, or in
// natural ones if it is event-driven (scene/units.h); the simulator converts.
//
// CONTRIBUTING.md states how to add a model.
#pragma once

#include <concepts>
#include <span>

#include "saltus/contact/integrators.h"
#include "saltus/contact/model_traits.h"
#include "saltus/contact/step_input.h"
#include "saltus/scene/scene.h"

namespace saltus {

// A contact model M has
//   static constexpr ModelTraits kTraits;
//   static constexpr int kRotation;                       numbers of rotation state per disc
//   template <typename T> BodyState<T, kRotation> Free(const StepInput<T>&, int i, const BodyState<T, kRotation>&)
//   const;
//       the step of disc i when it touches nothing. (p, v) -> (p', v') is affine and isotropic, with the same Jacobian
//       in every step, and force enters through Acceleration(i) only; the rotation depends on the rotation only.
//       Checked once, by derivatives at two states. T may be Lanes (internal/lanes.h): Free compares no values.
//   template <typename T> void Step(const StepInput<T>&, std::span<const BodyState<T, kRotation>> x,
//                                   std::span<BodyState<T, kRotation>> next) const;
//       the step of all discs. Contacts that take effect are reported (StepInput::Report): derivatives are taken of
//       the reported contacts, and all other discs are in free flight. Therefore
//         - a disc without a reported candidate moves as by Free, bit by bit. This is checked in every step of every
//           rollout, which otherwise fails, and in Simulator::Step, whose result is then not a number;
//         - candidates that are not reported have no effect on discs of reported ones. The audit finds a violation by
//           differences;
//         - every value has its derivatives. The audit finds a wrong gradient by differences.
//       Iterations end, and a step whose iterations do not converge reports it (StepInput::Fail).
// and may have kTapedFrom (internal/island_derivative.h), and
//   using Spinning = ...                                  the model for scenes with discs that spin, with the kRotation
//       kSpin. Without it the model does not support such scenes.
//   static constexpr bool kLinearRotation = true          in free flight the rotation has the same Jacobian everywhere
//   static std::string ReasonNotApplicable(const Scene&)  why it does not support a scene; else empty
//   static void InitialRotation(double* rotation)         kRotation numbers; zero by default
//   template <typename Visit> void VisitOptions(const Visit& visit)
//       calls visit(ModelOption, member) for each of its options; members are double, int or bool
//   void Linearize(const StepInput<double>&, std::span<const BodyState<double, kRotation>> x,
//                  Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B) const
//       if kTraits.published_jacobian: dense over the given discs, columns as in StepLinearization::Island, but without
//       those of torques, which act as changes of the velocities at the start of the step. A and B are overwritten
//   bool complementarity_aware, an option, and
//   void PullBack(const StepInput<double>&, std::span<const BodyState<double, kRotation>> x,
//                 std::span<const double> after, std::span<double> before) const
//       with Linearize: if the option is set, PullBack takes the place of the transposed A and B in reverse sweeps, and
//       every contact that it looks at is reported as a touch (control/surrogate.h). From `after`, the cotangents of
//       the discs' next states, to `before`, those of their states and then of the forces on them.
template <typename M>
concept ContactModel = requires(const M& m, const StepInput<double>& in,
                                std::span<const BodyState<double, M::kRotation>> x,
                                std::span<BodyState<double, M::kRotation>> next) {
  { M::kTraits } -> std::convertible_to<ModelTraits>;
  { m.Free(in, 0, x[0]) } -> std::same_as<BodyState<double, M::kRotation>>;
  m.Step(in, x, next);
};

}  // namespace saltus
