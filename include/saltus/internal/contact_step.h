// A contact model as the engine sees it: an interface of a few scalar types, and the adapter that puts a model behind
// it.
//
// The engine (rollout, islands, adjoint, linearization) is compiled once per scalar and size of the rotation state, in
// simulate/step_simulator.cc; it depends on ContactStep only. A model contributes ContactStepOf<M, S>, which
// instantiates the model's own functions and nothing else, so a further model costs the compiler its step in values and
// in Jets. The arrangement is that of ceres::CostFunction and ceres::AutoDiffCostFunction.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>

#include "saltus/contact/contact_model.h"
#include "saltus/internal/flight_lanes.h"
#include "saltus/internal/taped.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// The engine is compiled for models with 0 to this many numbers of rotation state per disc.
inline constexpr int kMostRotation = 3;

// A step of one disc under a force and, unless it is null, a torque. The input refers to its arguments.
template <typename T, typename H>
StepInput<T, H> LoneDisc(const H& h, const BodyConstants<T>& body, const Vec2<T>& force, const T* torque = nullptr,
                         const Vec2<Base<T>>& gravity = Vec2<Base<T>>::Zero()) {
  StepInput<T, H> in{};
  in.h = h;
  in.gravity = gravity;
  in.bodies = {&body, 1};
  in.force = {&force, 1};
  if (torque != nullptr) in.torque = {torque, 1};
  return in;
}

// Free flight of all discs over a number of steps, under the forces and torques of each.
template <typename S>
struct FlightInput {
  // The force and torque on a disc in the first step.
  struct Control {
    const S* force = nullptr;  // [u_x u_y], N; null: no force
    const S* turn = nullptr;   // torque / radius, N; null: no torque
  };
  StepInput<S> step;  // the flight sets `force` and `torque`
  int steps = 0;
  std::span<const Control> control;  // of each disc
  std::ptrdiff_t stride = 0;         // numbers from one step's control to the next
};

// The interface of one step of a contact model with values in S (double or float).
template <typename S, int kRotation>
class ContactStep {
 public:
  template <typename T>
  using StateOf = BodyState<T, kRotation>;
  using State = StateOf<S>;
  using Jet = StepJet<S>;
  using JetState = StateOf<Jet>;
  using TapedState = StateOf<Taped>;

  virtual ~ContactStep() = default;

  // Properties by contact_model.h: M::kTraits, M::kLinearRotation, M::kTapedFrom (none: no number of discs is that
  // large), M::Linearize and M::InitialRotation (for a disc at the origin and at rest).
  struct Properties {
    const ModelTraits* traits = nullptr;
    bool linear_rotation = false;
    int taped_from = std::numeric_limits<int>::max();
    bool published_jacobian = false;
    State at_rest{};
  };
  const ModelTraits& traits() const { return *properties_.traits; }
  const Properties& properties() const { return properties_; }

  // The step of all discs, M::Step, in values, in Jets and on the tape of the thread. The last is for models with
  // kTapedFrom and S = double only.
  virtual void Step(const StepInput<S>& in, std::span<const State> x, std::span<State> next) const = 0;
  virtual void Step(const StepInput<Jet>& in, std::span<const JetState> x, std::span<JetState> next) const = 0;
  virtual void Step(const StepInput<Taped>& in, std::span<const TapedState> x, std::span<TapedState> next) const = 0;

  // Moves all discs in free flight by one step.
  virtual void FreeFlight(const StepInput<S>& in, std::span<const State> x, std::span<State> next) const = 0;
  // Moves all discs in free flight by many steps. `first` points to the states of the first step, behind which those of
  // the others are stored.
  virtual void Fly(const FlightInput<S>& in, State* first) const = 0;
  // Free flight of one disc in several motions, each from *at[lane] to the state after its steps, with the same bits.
  // Discs without steps need not be there. Precondition: kInLanes.
  static constexpr bool kInLanes = kRotation == 0 && std::is_same_v<S, double>;
  virtual void FlyTogether(const FlightsInput& in, const std::array<State*, kLanes>& at) const = 0;
  // Free flight of disc 0 in Jets; the second also over a length that is a Jet: false for models that do not have it.
  virtual JetState Free(const StepInput<Jet>& in, const JetState& x) const = 0;
  virtual bool Free(const StepInput<Jet, Jet>& in, const JetState& x, JetState* next) const = 0;

  // Calls M::Linearize. Precondition: properties().published_jacobian.
  virtual void Linearize(const StepInput<double>& in, std::span<const StateOf<double>> x, Eigen::Ref<Eigen::MatrixXd> A,
                         Eigen::Ref<Eigen::MatrixXd> B) const = 0;
  // Calls M::PullBack, if the model has it and its option complementarity_aware is set; otherwise returns false.
  virtual bool PullBack(const StepInput<double>& in, std::span<const StateOf<double>> x, std::span<const double> after,
                        std::span<double> before) const = 0;

 protected:
  explicit ContactStep(const Properties& properties) : properties_(properties) {}

 private:
  const Properties properties_;
};

template <ContactModel M, typename S>
class ContactStepOf final : public ContactStep<S, M::kRotation> {
 public:
  static constexpr int kRotation = M::kRotation;
  static_assert(kRotation <= kMostRotation, "the engine is compiled for 0 to 3 numbers of rotation state per disc");
  static_assert(M::kTraits.spins == (kRotation > 0) || kRotation == kSpin,
                "a model has the trait `spins` if discs have a rotation of its own");
  using Base = ContactStep<S, kRotation>;
  using typename Base::Jet, typename Base::JetState, typename Base::State, typename Base::TapedState;
  static_assert(sizeof(State) == State::kSize * sizeof(S));

  explicit ContactStepOf(M model) : Base(PropertiesOf()), model_(std::move(model)) {}

  void Step(const StepInput<S>& in, std::span<const State> x, std::span<State> next) const override {
    model_.Step(in, x, next);
  }
  void Step(const StepInput<Jet>& in, std::span<const JetState> x, std::span<JetState> next) const override {
    if constexpr (std::is_same_v<S, double>) {
      FlatStep(in, x, next);
    } else {
      model_.Step(in, x, next);
    }
  }
  void Step([[maybe_unused]] const StepInput<Taped>& in, [[maybe_unused]] std::span<const TapedState> x,
            [[maybe_unused]] std::span<TapedState> next) const override {
    if constexpr (kTapes) model_.Step(in, x, next);
  }

  void FreeFlight(const StepInput<S>& in, std::span<const State> x, std::span<State> next) const override {
    saltus::FreeFlight(model_, in, x, next);
  }
  void Fly(const FlightInput<S>& flight, State* first) const override {
    // These are copies, as the compiler must assume that writing a state changes what the spans refer to. The loop is
    // over discs first, so that a state stays in registers.
    const std::size_t num_bodies = flight.step.bodies.size();
    const std::ptrdiff_t stride = flight.stride;
    const int steps = flight.steps;
    BodyConstants<S> body;
    Vec2<S> force;
    S torque;
    StepInput<S> in{};
    in.h = flight.step.h;
    in.gravity = flight.step.gravity;
    in.bodies = {&body, 1};
    in.force = {&force, 1};
    for (std::size_t i = 0; i < num_bodies; ++i) {
      body = flight.step.bodies[i];
      force = Vec2<S>::Zero();
      const auto [forces, turn] = flight.control[i];
      const S* u = forces;
      in.torque = {&torque, turn != nullptr ? 1U : 0U};
      State* at = first + i;
      State x = *at;
      for (int j = 0; j < steps; ++j) {
        if (u != nullptr) {
          force = Vec2<S>(u[0], u[1]);
          u += stride;
        }
        if (turn != nullptr) torque = body.radius * turn[j * stride];
        x = model_.Free(in, 0, x);
        at += num_bodies;
        *at = x;
      }
    }
  }
  void FlyTogether([[maybe_unused]] const FlightsInput& in,
                   [[maybe_unused]] const std::array<State*, kLanes>& at) const override {
    if constexpr (Base::kInLanes) internal::FlyTogether(model_, in, at);
  }
  JetState Free(const StepInput<Jet>& in, const JetState& x) const override { return model_.Free(in, 0, x); }
  bool Free([[maybe_unused]] const StepInput<Jet, Jet>& in, [[maybe_unused]] const JetState& x,
            [[maybe_unused]] JetState* next) const override {
    if constexpr (requires { model_.Free(in, 0, x); }) {
      *next = model_.Free(in, 0, x);
      return true;
    }
    return false;
  }

  void Linearize([[maybe_unused]] const StepInput<double>& in,
                 [[maybe_unused]] std::span<const BodyState<double, kRotation>> x,
                 [[maybe_unused]] Eigen::Ref<Eigen::MatrixXd> A,
                 [[maybe_unused]] Eigen::Ref<Eigen::MatrixXd> B) const override {
    if constexpr (kLinearizes) model_.Linearize(in, x, A, B);
  }
  bool PullBack([[maybe_unused]] const StepInput<double>& in,
                [[maybe_unused]] std::span<const BodyState<double, kRotation>> x,
                [[maybe_unused]] std::span<const double> after,
                [[maybe_unused]] std::span<double> before) const override {
    if constexpr (requires { model_.complementarity_aware; }) {
      if (model_.complementarity_aware) {
        model_.PullBack(in, x, after, before);
        return true;
      }
    }
    return false;
  }

 private:
  // Only doubles are flattened: it takes long to compile, and floats serve published values, not speed.
  SALTUS_FLATTEN void FlatStep(const StepInput<Jet>& in, std::span<const JetState> x, std::span<JetState> next) const {
    model_.Step(in, x, next);
  }

  static constexpr bool kTapes = std::is_same_v<S, double> && requires { M::kTapedFrom; };
  static constexpr bool kLinearizes = requires { &M::Linearize; };

  static typename Base::Properties PropertiesOf() {
    static constexpr ModelTraits kTraits = M::kTraits;
    typename Base::Properties properties;
    properties.traits = &kTraits;
    if constexpr (requires { M::kLinearRotation; }) properties.linear_rotation = M::kLinearRotation;
    if constexpr (kTapes) properties.taped_from = M::kTapedFrom;
    properties.published_jacobian = kLinearizes;
    properties.at_rest.p = properties.at_rest.v = Vec2<S>::Zero();
    if constexpr (requires(double* rotation) { M::InitialRotation(rotation); }) {
      double rotation[kRotation] = {};
      M::InitialRotation(rotation);
      for (int j = 0; j < kRotation; ++j) properties.at_rest.rotation[j] = S(rotation[j]);
    }
    return properties;
  }

  const M model_;
};

// Makes the simulator of a step. Defined for S = double and float, and kRotation = 0 to kMostRotation. `precision` is
// the one that the simulator reports; models with the trait double_engine compute in double even for kFloat.
template <typename S, int kRotation>
std::unique_ptr<Simulator> MakeStepSimulator(const Scene& scene, Precision precision,
                                             std::unique_ptr<const ContactStep<S, kRotation>> step);

// Makes the simulator of a contact model.
template <ContactModel M, typename S = double>
std::unique_ptr<Simulator> MakeModelSimulator(const Scene& scene, Precision precision = Precision::kDouble,
                                              M model = {}) {
  return MakeStepSimulator<S, M::kRotation>(scene, precision, std::make_unique<ContactStepOf<M, S>>(std::move(model)));
}

}  // namespace saltus
