// Event-driven simulation with functions that are learned from recordings: a law of impact, or event functions of
// planes and their updates.
#pragma once

#include <ceres/cost_function.h>

#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <span>
#include <utility>

#include "contact/event/event.h"
#include "saltus/contact/event_functions.h"
#include "saltus/contact/impact_law.h"

namespace saltus {

// The base of the models with functions that are learned. They fly as `event` does, and have derivatives by parameters
// of what is learned. A contact model is differentiated by restitution, stiffness and damping of the scene, which these
// do not read. They stand for the parameters `first`, first + 1 and first + 2.
struct LearnedModel {
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  LearnedModel(int first_parameter, const Units& units)
      : first(first_parameter),
        unit(units),
        slot_units{1, units.force() / units.length, units.force() / units.speed()} {}

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    return EventDriven().Free(in, i, x);
  }

  // Adds the derivatives of a number in the unit `out`, which are those in SI by all parameters.
  template <typename T>
  void AddByParameters(const StepInput<T>& in, std::span<const double> by_parameters, double out, T* number) const {
    const T* const slots[3] = {&in.contact.restitution, &in.contact.stiffness, &in.contact.damping};
    for (std::size_t k = 0; k < 3 && first + k < by_parameters.size(); ++k) {
      *number += by_parameters[first + k] * slot_units[k] / out * (*slots[k] - Value(*slots[k]));
    }
  }

  int first;
  Units unit;            // of the step's numbers
  double slot_units[3];  // in SI, of restitution, stiffness and damping
};

// Event-driven simulation with an impact law that is a function with parameters, such as a network: it gives
// restitution, and friction if the law has it, by the speeds at each impact (impact_law.h). All else is as in event.h.
// The parameters are learned from recordings by Ceres (Identify()), through the exact event times.
//
// Sustained contacts, and the last of the bounces that come to rest, have the restitution and the friction of the law
// at the speeds 0. With a constant law the model is `event`, bit by bit except for the rounding of its evaluation.
//
// After Chen, Amos, Nickel 2021, Learning neural event functions, whose updates at events are networks; here a network
// gives the two numbers that make an update an impulse. Event functions are the gaps.
struct NeuralEvent : LearnedModel {
  static constexpr ModelTraits kTraits = {.name = "neural_event",
                                          .summary = "exact events, with a law of impact that is learned",
                                          .source = "after Chen, Amos, Nickel 2021",
                                          .double_engine = true,
                                          .chains = true,
                                          .event_driven = true,
                                          .rebound = Rebound::kEmergent,
                                          .sequential = true,
                                          .relative = true};

  NeuralEvent(ImpactLaw learned, int first_parameter, const Units& units)
      : LearnedModel(first_parameter, units), law(std::make_shared<const ImpactLaw>(std::move(learned))) {}

  static std::string ReasonNotApplicable(const Scene& scene) { return EventDriven::ReasonNotApplicable(scene); }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if (in.candidates.empty()) return FreeFlight(*this, in, x, next);
    StepInput<T> at_rest = in;
    const PairConstants<T> numbers = LawAt(in, T(0.0), T(0.0));
    at_rest.contact.restitution = numbers.restitution;
    at_rest.contact.friction = numbers.friction;
    internal::TakeEventStep(*this, at_rest, SpeedLaw<T>{*this, in}, x, next);
  }

  std::shared_ptr<const ImpactLaw> law;

 private:
  template <typename T>
  struct SpeedLaw {
    const NeuralEvent& model;
    const StepInput<T>& in;
    PairConstants<T> LawAt(const Candidate& /*c*/, const Vec2<T>& normal, const Vec2<T>& w) const {
      const T sliding = Dot(Perpendicular(normal), w);
      return model.LawAt(in, T(-Dot(normal, w)), Value(sliding) < 0 ? T(-sliding) : sliding);
    }
  };

  // Returns restitution and friction at the given speeds, which are in the units of the step.
  template <typename T>
  PairConstants<T> LawAt(const StepInput<T>& in, const T& speed, const T& sliding) const {
    const std::size_t count = law->parameters.size();
    const double speed_unit = unit.speed();
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
        AddByParameters<T>(in, by_parameters.subspan(r * count, count), /*out=*/1, &number);
      }
      return number;
    };
    return {output(0), law->HasFriction() ? output(1) : in.contact.friction};
  }
};

// Impacts with planes by event functions and updates that have parameters (saltus/contact/event_functions.h); impacts
// between discs as in event.h. Free flight is exact. An event function is evaluated kLooks times within a step, and
// where it has fallen below zero its zero is found to rounding: a function that falls and rises again in between is
// missed. There is no derivative by the restitution of impacts between discs.
struct LearnedEvents : LearnedModel {
  static constexpr ModelTraits kTraits = {.name = "learned_events",
                                          .summary = "event functions of planes and updates that are learned",
                                          .source = "after Chen, Amos, Nickel 2021",
                                          .double_engine = true,
                                          .chains = true,
                                          .event_driven = true,
                                          .rebound = Rebound::kEmergent,
                                          .sequential = true,
                                          // Planes are at the zeros of their event functions.
                                          .push_gap = std::numeric_limits<double>::infinity()};
  static constexpr int kLooks = 8;         // at an event function, in a step
  static constexpr int kMostEvents = 100;  // in a step

  LearnedEvents(EventFunctions learned, int first_parameter, const Units& units)
      : LearnedModel(first_parameter, units), events(std::make_shared<const EventFunctions>(std::move(learned))) {}

  static std::string ReasonNotApplicable(const Scene& scene) {
    if (scene.table || scene.HasEdges() || !scene.pockets.empty()) {
      return "walls that end, pockets, or a table: event functions are those of planes";
    }
    return "";
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if (in.candidates.empty()) return FreeFlight(*this, in, x, next);
    Run<T>(*this, in, x).CopyStates(next);
  }

  std::shared_ptr<const EventFunctions> events;

 private:
  template <typename T>
  class Run {
   public:
    Run(const LearnedEvents& model, const StepInput<T>& in, std::span<const State<T>> x)
        : model_(model), in_(in), x_(x), discs_(in.scratch) {
      for (int i = 0; i < static_cast<int>(x.size()); ++i) {
        discs_.push_back({.t = T(0.0), .p = x[i].p, .v = x[i].v, .a = in.Acceleration(i)});
      }
    }

    void CopyStates(std::span<State<T>> next) {
      int count = 0;
      while (count <= kMostEvents && TakeNext()) ++count;
      if (count > kMostEvents) in_.Fail("impacts accumulate: learned events do not support sustained contacts");
      const T end(count > kMostEvents ? std::numeric_limits<double>::quiet_NaN() : in_.h);
      for (int i = 0; i < static_cast<int>(x_.size()); ++i) {
        const auto& disc = discs_[i];
        next[i] = disc.moved ? State<T>{disc.PositionAt(end), disc.VelocityAt(end)} : model_.Free(in_, i, x_[i]);
      }
    }

   private:
    using Disc = internal::EventDisc<T>;
    struct Rate {
      double value = 0, slope = 0;  // of an event function along the motion: by the time
    };

    // Resolves the next event. Returns false if there is none.
    bool TakeNext() {
      const Candidate* next = nullptr;
      double earliest = kNever;
      for (const Candidate& c : in_.candidates) {
        const double time = TimeOf(c);
        if (time < earliest) {
          earliest = time;
          next = &c;
        }
      }
      if (next == nullptr) return false;
      if (next->plane) {
        BounceOffPlane(*next, earliest);
      } else {
        BounceOffDisc(*next, earliest);
      }
      return true;
    }

    double PairTime(const Candidate& c) const {
      return c.plane ? Value(discs_[c.a].t) : std::max(Value(discs_[c.a].t), Value(discs_[c.b].t));
    }

    // Returns when the event function falls to zero for the first time, kNever if it does not.
    double TimeOf(const Candidate& c) const {
      const double since = PairTime(c);
      const Rate now = RateAt(c, since);
      if (now.value <= 0 && now.slope <= 0) return since;
      double low = since;
      bool above = now.value > 0;
      for (int look = 1; look <= kLooks; ++look) {
        const double high = look == kLooks ? in_.h : since + (in_.h - since) * look / kLooks;
        const bool below = RateAt(c, high).value <= 0;
        if (look == 1 && !above && below) {
          above = LeavesZero(c, high, &low);
          if (!above) return since;  // a bounce too small to be told from none
        }
        if (above && below) return Zero(c, low, high);
        above = !below;
        low = high;
      }
      return kNever;
    }

    // Moves `low` to where an event function that rises from zero, and is below it at `high`, is above zero.
    bool LeavesZero(const Candidate& c, double high, double* low) const {
      const double since = *low;
      for (double length = high - since; length > 1e-12 * in_.h; length /= 2) {
        if (RateAt(c, since + length).value <= 0) continue;
        *low = since + length;
        return true;
      }
      return false;
    }

    // Returns a zero between `low`, where the function is positive, and `high`, where it is not (Newton, bisection).
    double Zero(const Candidate& c, double low, double high) const {
      double time = high;
      for (int i = 0; i < 100 && low < high; ++i) {
        const Rate at = RateAt(c, time);
        (at.value > 0 ? low : high) = time;
        double step = at.slope < 0 ? time - at.value / at.slope : low;
        if (!(step > low && step < high)) step = 0.5 * (low + high);
        if (step == time || step <= low || step >= high) break;
        if (std::abs(step - time) <= 1e-16 * in_.h) return step;
        time = step;
      }
      return time;
    }

    Rate RateAt(const Candidate& c, double time) const {
      const auto position = [&](int i) { return PlainAt(discs_[i], time, 0); };
      const auto velocity = [&](int i) { return PlainAt(discs_[i], time, 1); };
      if (!c.plane) {
        const Vec2d apart = position(c.a) - position(c.b), w = velocity(c.a) - velocity(c.b);
        return {apart.norm() - in_.ContactDistance(c), apart.dot(w) / apart.norm()};
      }
      const Vec2d p = position(c.a), v = velocity(c.a), a = PlainAt(discs_[c.a], time, 2);
      double value, by_disc[5];
      Evaluate(model_.events->planes[c.b].event, DiscInSi(p, v, c.a), &value, by_disc, nullptr);
      const double slope = (by_disc[0] * v[0] + by_disc[1] * v[1]) * model_.unit.length +
                           (by_disc[2] * a[0] + by_disc[3] * a[1]) * model_.unit.speed();
      return {value / model_.unit.length, slope / model_.unit.length};
    }

    // Returns the position (derivative 0), velocity (1) or acceleration (2) at a time, as values.
    static Vec2d PlainAt(const Disc& disc, double time, int derivative) {
      const auto plain = [](const Vec2<T>& at) { return Vec2d(Value(at[0]), Value(at[1])); };
      const Vec2d v = plain(disc.v), a = plain(disc.a);
      const double s = time - Value(disc.t);
      if (derivative == 0) return plain(disc.p) + s * (v + 0.5 * s * a);
      return derivative == 1 ? Vec2d(v + s * a) : a;
    }

    std::array<double, 5> DiscInSi(const Vec2d& p, const Vec2d& v, int i) const {
      const Units& unit = model_.unit;
      return {unit.origin[0] + unit.length * p[0],
              unit.origin[1] + unit.length * p[1],
              unit.speed() * v[0],
              unit.speed() * v[1],
              unit.length * in_.bodies[i].radius};
    }

    void Evaluate(const std::shared_ptr<const ceres::CostFunction>& function, const std::array<double, 5>& disc,
                  double* value, double* by_disc, double* by_parameters) const {
      const double* blocks[2] = {disc.data(), model_.events->parameters.data()};
      double* jacobians[2] = {by_disc, by_parameters};
      const bool ok = function->Evaluate(blocks, value, jacobians);
      for (int r = 0; r < function->num_residuals(); ++r) {
        if (ok && std::isfinite(value[r])) continue;
        in_.Fail("an event function or its update has no value");
        value[r] = std::numeric_limits<double>::quiet_NaN();
      }
    }

    // Evaluates a function with derivatives. The outputs have the unit `out`.
    template <int kOutputs>
    std::array<T, kOutputs> Evaluate(const std::shared_ptr<const ceres::CostFunction>& function, const Vec2<T>& p,
                                     const Vec2<T>& v, int i, double out) const {
      const std::size_t count = model_.events->parameters.size();
      double value[kOutputs], by_disc[kOutputs * 5];
      constexpr bool kDerivatives = !std::is_same_v<T, double>;
      const std::span<double> by_parameters = in_.template Array<double>(kDerivatives ? kOutputs * count : 0);
      const Vec2d at(Value(p[0]), Value(p[1])), moving(Value(v[0]), Value(v[1]));
      Evaluate(function, DiscInSi(at, moving, i), value, by_disc, kDerivatives ? by_parameters.data() : nullptr);
      std::array<T, kOutputs> result;
      for (int r = 0; r < kOutputs; ++r) {
        T number(value[r] / out);
        if constexpr (kDerivatives) {
          for (int j = 0; j < 2; ++j) {
            number += by_disc[5 * r + j] * model_.unit.length / out * (p[j] - at[j]);
            number += by_disc[5 * r + 2 + j] * model_.unit.speed() / out * (v[j] - moving[j]);
          }
          model_.AddByParameters<T>(in_, by_parameters.subspan(r * count, count), out, &number);
        }
        result[r] = number;
      }
      return result;
    }

    void BounceOffPlane(const Candidate& c, double time) {
      Disc& disc = discs_[c.a];
      const EventFunctions::Plane& plane = model_.events->planes[c.b];
      const T at(time);
      const auto gap = Evaluate<1>(plane.event, disc.PositionAt(at), disc.VelocityAt(at), c.a, model_.unit.length);
      const T corrected = Corrected(c, time, gap[0]);
      MoveTo(&disc, corrected);
      const auto after = Evaluate<2>(plane.update, disc.p, disc.v, c.a, model_.unit.speed());
      disc.v = Vec2<T>(after[0], after[1]);
      in_.Report(c, ContactMode::kFrictionless, time);
    }

    void BounceOffDisc(const Candidate& c, double time) {
      const T at(time);
      const Vec2<T> between = discs_[c.a].PositionAt(at) - discs_[c.b].PositionAt(at);
      const T corrected = Corrected(c, time, T(Length(between) - in_.ContactDistance(c)));
      MoveTo(&discs_[c.a], corrected);
      MoveTo(&discs_[c.b], corrected);
      const auto position = [&](int i) { return discs_[i].p; };
      const Vec2<T> w = RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; });
      const T bounce(1 + Value(in_.contact.restitution));
      const auto impact = MakeImpact<T>(
          SeparationAt<T>(in_, c, position).normal, w, in_.EffectiveMass(c), bounce, in_.contact.friction);
      ApplyImpulse(in_, c, impact.impulse, [&](int i, const Vec2<T>& dv) { discs_[i].v += dv; });
      in_.Report(c, impact.mode, time);
    }

    // One Newton correction carries the derivative; it does not change the value by more than rounding.
    T Corrected(const Candidate& c, double time, const T& gap) const {
      return T(time) - (gap - Value(gap)) / RateAt(c, time).slope;
    }

    void MoveTo(Disc* disc, const T& time) const {
      const Vec2<T> p = disc->PositionAt(time), v = disc->VelocityAt(time);
      disc->p = p;
      disc->v = v;
      disc->t = time;
      disc->moved = true;
    }

    const LearnedEvents& model_;
    const StepInput<T>& in_;
    const std::span<const State<T>> x_;
    std::pmr::vector<Disc> discs_;
  };
};

}  // namespace saltus
