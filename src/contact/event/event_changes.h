// What an event of the event-driven model (event.h) does to its discs: they are moved to its instant, let go, stopped,
// or given an impulse.
#pragma once

#include <span>
#include <string_view>

#include "contact/event/event_queue.h"
#include "contact/law/impact.h"

namespace saltus::internal {

template <typename T>
struct ImpactNumbers {
  T restitution, friction;
};

// Those of the scene, whatever the relative velocity w and the normal of the impact.
template <typename T>
struct SceneLaw {
  const StepInput<T>& in;
  ImpactNumbers<T> At(const Vec2<T>& /*normal*/, const Vec2<T>& /*w*/) const {
    return {in.contact.restitution, in.contact.friction};
  }
};

// `Law` says which restitution and friction an impact has.
template <typename T, int kRotation, typename Law>
class EventChanges : protected EventQueue<T, kRotation> {
 protected:
  using Discs = EventQueue<T, kRotation>;
  using Discs::in_, Discs::discs_, Discs::pairs_, Discs::ForEachPairOf, Discs::Moves, Discs::CandidateOf,
      Discs::LastRelativeVelocity, Discs::LastSeparation, Discs::Report, Discs::Slide, Discs::SlideOn, Discs::impacts_,
      Discs::pocketed_energy_, Discs::TouchesAlone;
  using typename Discs::State, typename Discs::Disc;

  EventChanges(const StepInput<T>& in, const Law& law, std::span<const State> x) : Discs(in, x), law_(law) {}

  // A step of many discs that fails is taken at once instead, if contacts are the scene's own.
  static constexpr bool kMayCrowd = kRotation == 0 && std::is_same_v<Law, SceneLaw<T>>;
  bool MayCrowd() const { return kMayCrowd && discs_.size() >= kFewestCrowd && in_.table < 0 && in_.num_pockets == 0; }

  void Fail(std::string_view why) {
    failed_ = true;
    if (MayCrowd()) {
      crowded_ = true;
    } else {
      in_.Fail(why);
    }
  }

  SALTUS_FLATTEN void MoveTo(int i, const T& time) {
    if (!Moves(i)) return;
    Disc& disc = discs_[i];
    const Vec2<T> p = disc.PositionAt(time), v = disc.VelocityAt(time);
    if constexpr (kRotation == kSpin) {
      const T s = time - disc.t;
      disc.turn = {disc.turn.AngleAfter(s), disc.turn.SpeedAfter(s), disc.turn.acceleration};
    }
    disc.p = p;
    disc.v = v;
    disc.t = time;
    disc.moved = disc.dirty = true;
    disc.order = order_;
    disc.arc_end = kNever;
  }

  // Moves disc i to `time`, with all discs that it presses against, and lets them fly.
  void Release(int i, const T& time) {
    if (!Moves(i)) return;
    MoveTo(i, time);
    discs_[i].a = in_.Acceleration(i);
    if constexpr (kRotation == kSpin) discs_[i].turn.acceleration = in_.AngularAcceleration(i);
    Slide(i);
    ForEachPairOf(i, [&](int q) {
      const Candidate& c = CandidateOf(q);
      if (!pairs_[q].held) return;
      pairs_[q].held = false;
      pairs_[q].released = order_;
      Release(c.a, time);
      if (!c.plane) Release(c.b, time);
    });
  }

  void Stop(int i) {
    const T time = discs_[i].t + Divide(Length(discs_[i].v), in_.slowing);
    MoveTo(i, time);
    discs_[i].v = Vec2<T>(T(0.0), T(0.0));
    Slide(i);
  }

  // The disc of pair q falls into its pocket: what it pressed against is let go, and it rests where it is.
  void TakeOut(int q, const T& time) {
    const Candidate& c = CandidateOf(q);
    const T none(0.0);
    Disc& disc = discs_[c.a];
    disc.out = true;
    Release(c.a, time);
    const BodyConstants<T>& body = in_.bodies[c.a];
    pocketed_energy_ += 0.5 * Value(body.mass) * Value(T(Dot(disc.v, disc.v)));
    disc.v = disc.a = Vec2<T>(none, none);
    if constexpr (kRotation == kSpin) {
      const double speed = Value(disc.turn.speed), inverse = Value(body.inverse_inertia);
      if (inverse > 0) pocketed_energy_ += 0.5 * speed * speed / inverse;
      disc.turn.speed = disc.turn.acceleration = none;
    }
    Report(c, ContactMode::kPocketed, time, ContactKind::kSustained);
  }

  void Impact(int q, const T& time, bool pressed) {
    const Candidate& c = CandidateOf(q);
    Release(c.a, time);
    if (!c.plane) Release(c.b, time);
    const ContactMode mode = ApplyImpact(c, pressed);
    SlideOn(c);
    CountImpact(q);
    Report(c, mode, time, ContactKind::kImpact);
  }

  int order_ = 0;           // number of the event
  bool inelastic_ = false;  // impacts have no restitution
  bool failed_ = false;
  bool crowded_ = false;

 private:
  // Where the two are pressed together and would part slowly, all further bounces at once: their impulses beyond those
  // of a contact at rest, friction included, sum up to that of a plastic impact.
  SALTUS_FLATTEN ContactMode ApplyImpact(const Candidate& c, bool pressed) {
    const Separation<T> at = LastSeparation(c);
    const Vec2<T> w = LastRelativeVelocity(c);
    const ImpactNumbers<T> law = law_.At(at.normal, w);
    const bool last = pressed && -Value(law.restitution) * Value(Dot(at.normal, w)) <= kSlowSpeed;
    const T bounce = inelastic_ || last ? T(1.0) : T(law.restitution + 1.0);
    const auto impact = MakeImpactOf(c, at.normal, w, bounce, law.friction);
    ApplyImpulse(in_, c, impact.impulse, [&](int i, const Vec2<T>& dv) { discs_[i].v += dv; });
    if constexpr (kRotation == kSpin) {
      ApplyTurn(in_, c, impact.tangential, [&](int i, const T& change) { discs_[i].turn.speed += change; });
    }
    return impact.mode;
  }
  void CountImpact(int q) {
    if (++pairs_[q].meetings > kCrowdedImpacts && MayCrowd()) {
      const bool many = discs_.size() >= kCrowd || (impacts_ > kManyImpacts && Value(in_.contact.friction) > 0);
      if (many && !TouchesAlone(q, Value(discs_[CandidateOf(q).a].t))) return Fail("a crowd");
    }
    if (++impacts_ <= kManyImpacts) return;
    const Candidate& c = CandidateOf(q);
    ++pairs_[q].impacts;
    ++discs_[c.a].impacts;
    if (!c.plane) ++discs_[c.b].impacts;
  }

  auto MakeImpactOf(const Candidate& c, const Vec2<T>& normal, const Vec2<T>& w, const T& bounce,
                    const T& friction) const {
    if constexpr (kRotation == kSpin) {
      const T sliding = AlongSurface<kRotation>(
          in_, c, T(Dot(Perpendicular(normal), w)), [&](auto i) { return discs_[i].turn.speed; });
      return MakeImpact<T>(
          normal, T(Dot(normal, w)), sliding, in_.EffectiveMass(c), in_.TangentialMass(c), bounce, friction, kHeadOn);
    } else {
      return MakeImpact<T>(normal, w, in_.EffectiveMass(c), bounce, friction, kHeadOn);
    }
  }

  const Law law_;
};

}  // namespace saltus::internal
