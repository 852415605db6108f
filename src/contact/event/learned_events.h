// Impacts with planes by event functions and updates that have parameters (saltus/contact/event_functions.h); impacts
// between discs as in event.h. Free flight is exact. An event function is evaluated kLooks times within a step, and
// where it has fallen below zero its zero is found to rounding: a function that falls and rises again in between is
// missed.
//
// Derivatives by the functions' parameters: as in neural_event.h, restitution, stiffness and damping stand for the
// parameters `first`, first + 1 and first + 2. There is none by the restitution of impacts between discs.
#pragma once

#include <ceres/cost_function.h>

#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "contact/event/event.h"
#include "saltus/contact/event_functions.h"

namespace saltus {

struct LearnedEvents {
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
  static constexpr int kRotation = 0;
  static constexpr int kLooks = 8;         // at an event function, in a step
  static constexpr int kMostEvents = 100;  // in a step
  template <typename T>
  using State = BodyState<T, kRotation>;

  LearnedEvents(EventFunctions learned, int first_parameter, const Units& units)
      : events(std::make_shared<const EventFunctions>(std::move(learned))),
        first(first_parameter),
        unit(units),
        slot_units{1, units.force() / units.length, units.force() / units.speed()} {}

  static std::string WhyNot(const Scene& scene) {
    if (scene.table || scene.HasEdges() || !scene.pockets.empty()) {
      return "walls that end, pockets, or a table: event functions are those of planes";
    }
    return "";
  }

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    return EventDriven().Free(in, i, x);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if (in.candidates.empty()) return FreeFlight(*this, in, x, next);
    Run<T>(*this, in, x).Into(next);
  }

  std::shared_ptr<const EventFunctions> events;
  int first;
  Units unit;            // of the step's numbers
  double slot_units[3];  // in SI, of restitution, stiffness and damping

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

    void Into(std::span<State<T>> next) {
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

    double Since(const Candidate& c) const {
      return c.plane ? Value(discs_[c.a].t) : std::max(Value(discs_[c.a].t), Value(discs_[c.b].t));
    }

    // Returns when the event function falls to zero for the first time, kNever if it does not.
    double TimeOf(const Candidate& c) const {
      const double since = Since(c);
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
          const T* const slots[3] = {&in_.contact.restitution, &in_.contact.stiffness, &in_.contact.damping};
          for (std::size_t k = 0; k < 3 && model_.first + k < count; ++k) {
            number += by_parameters[r * count + model_.first + k] * model_.slot_units[k] / out *
                      (*slots[k] - Value(*slots[k]));
          }
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
