// Event-driven simulation with an impact law that is a function with parameters, such as a network: it gives
// restitution, and friction if the law has it, by the speeds at each impact (impact_law.h). All else is as in event.h.
// The parameters are learned from recordings by Ceres (Identify()), through the exact event times.
//
// Sustained contacts, and the last of the bounces that come to rest, have the restitution and the friction of the law
// at the speeds 0. With a constant law the model is `event`, bit by bit except for the rounding of its evaluation.
//
// Derivatives by parameters of the law: a contact model is differentiated by restitution, stiffness and damping of the
// scene, which this one does not read. They stand for the law's parameters `first`, first + 1 and first + 2.
//
// After Chen, Amos, Nickel 2021, Learning neural event functions, whose updates at events are networks; here a network
// gives the two numbers that make an update an impulse. Event functions are the gaps.
#pragma once

#include <ceres/cost_function.h>

#include <limits>
#include <memory>
#include <utility>

#include "contact/event/event.h"
#include "saltus/contact/impact_law.h"

namespace saltus {

struct NeuralEvent {
  static constexpr ModelTraits kTraits = {.name = "neural_event",
                                          .summary = "exact events, with a law of impact that is learned",
                                          .source = "after Chen, Amos, Nickel 2021",
                                          .double_engine = true,
                                          .chains = true,
                                          .event_driven = true,
                                          .rebound = Rebound::kEmergent,
                                          .sequential = true,
                                          .relative = true};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  NeuralEvent(ImpactLaw learned, int first_parameter, const Units& units)
      : law(std::make_shared<const ImpactLaw>(std::move(learned))),
        first(first_parameter),
        speed_unit(units.speed()),
        slot_units{1, units.force() / units.length, units.force() / units.speed()} {}

  static std::string WhyNot(const Scene& scene) { return EventDriven::WhyNot(scene); }

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    return EventDriven().Free(in, i, x);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if (in.candidates.empty()) return FreeFlight(*this, in, x, next);
    StepInput<T> at_rest = in;
    const PairConstants<T> numbers = At(in, T(0.0), T(0.0));
    at_rest.contact.restitution = numbers.restitution;
    at_rest.contact.friction = numbers.friction;
    internal::TakeEventStep(*this, at_rest, SpeedLaw<T>{*this, in}, x, next);
  }

  std::shared_ptr<const ImpactLaw> law;
  int first;
  double speed_unit;     // m/s
  double slot_units[3];  // in SI, of restitution, stiffness and damping

 private:
  template <typename T>
  struct SpeedLaw {
    const NeuralEvent& model;
    const StepInput<T>& in;
    PairConstants<T> At(const Candidate& /*c*/, const Vec2<T>& normal, const Vec2<T>& w) const {
      const T sliding = Dot(Perpendicular(normal), w);
      return model.At(in, T(-Dot(normal, w)), Value(sliding) < 0 ? T(-sliding) : sliding);
    }
  };

  // Returns restitution and friction at the given speeds, which are in the units of the step.
  template <typename T>
  PairConstants<T> At(const StepInput<T>& in, const T& speed, const T& sliding) const {
    const std::size_t count = law->parameters.size();
    const double speeds[2] = {Value(speed) * speed_unit, Value(sliding) * speed_unit};
    const double* blocks[2] = {speeds, law->parameters.data()};
    constexpr bool kDerivatives = !std::is_same_v<T, double>;
    double value[2] = {0, 0}, by_speeds[4];
    const std::span<double> by_parameters = in.template Array<double>(kDerivatives ? 2 * count : 0);
    double* jacobians[2] = {by_speeds, by_parameters.data()};
    const bool has_value = law->function->Evaluate(blocks, value, kDerivatives ? jacobians : nullptr);
    const bool ok = has_value && value[0] >= 0 && value[0] <= 1 && value[1] >= 0;
    if (!ok) {
      in.Fail("the law of impact gives no restitution in [0, 1] and friction >= 0");
      value[0] = value[1] = std::numeric_limits<double>::quiet_NaN();
    }
    const auto output = [&](int r) {
      T number(value[r]);
      if constexpr (kDerivatives) {
        number += by_speeds[2 * r] * speed_unit * (speed - Value(speed));
        number += by_speeds[2 * r + 1] * speed_unit * (sliding - Value(sliding));
        const T* const slots[3] = {&in.contact.restitution, &in.contact.stiffness, &in.contact.damping};
        for (std::size_t k = 0; k < 3 && first + k < count; ++k) {
          number += by_parameters[r * count + first + k] * slot_units[k] * (*slots[k] - Value(*slots[k]));
        }
      }
      return number;
    };
    return {output(0), law->HasFriction() ? output(1) : in.contact.friction};
  }
};

}  // namespace saltus
