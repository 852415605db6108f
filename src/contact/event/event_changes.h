// The changes that an event of the event-driven model (event.h) makes to its discs: they are moved to the time of the
// event, released from contacts, stopped, taken out of play, or given an impulse.
#pragma once

#include <algorithm>
#include <string_view>
#include <type_traits>

#include "contact/event/event_queue.h"
#include "contact/law/impact.h"

namespace saltus::internal {

// The impact law with the restitution and friction that the scene gives the pair, independent of velocity and normal.
template <typename T>
struct SceneLaw {
  const StepInput<T>& in;
  const PairConstants<T>& LawAt(const Candidate& c, const Vec2<T>& /*normal*/, const Vec2<T>& /*w*/) const {
    return in.ContactOf(c);
  }
};

// Law::LawAt(c, normal, w) returns restitution and friction of an impact of a candidate.
template <typename T, int kRotation, typename Law>
class EventChanges {
 public:
  using Disc = EventDisc<T, kRotation>;

  // Keeps references to all arguments but the law: these must outlive this object.
  EventChanges(const StepInput<T>& in, const Law& law, EventMotion<T, kRotation>& motion,
               EventQueue<T, kRotation>& queue)
      : in_(in), law_(law), motion_(motion), queue_(queue) {}

  // Whether a step of many discs that fails is taken by time-stepping instead (event_fallback.h). The fallback knows
  // neither rotation nor laws other than the scene's.
  static constexpr bool kMayFallBack = kRotation == 0 && std::is_same_v<Law, SceneLaw<T>>;
  bool MayFallBack() const {
    return kMayFallBack && motion_.num_discs() >= kFewestFallbackDiscs && in_.table < 0 && in_.num_pockets == 0;
  }
  // Ends the step without a result, for the reason `why`, or marks it for the time-stepping fallback.
  void Fail(std::string_view why) {
    failed_ = true;
    if (MayFallBack()) {
      falls_back_ = true;
    } else {
      in_.Fail(why);
    }
  }
  bool failed() const { return failed_; }
  bool falls_back() const { return falls_back_; }
  // The kinetic energy that discs had when they fell into pockets, J, which the check of the energy must not miss.
  double pocketed_energy() const { return pocketed_energy_; }

  void Report(const Candidate& c, ContactMode mode, const T& time, ContactKind kind) {
    in_.Report(c, mode, std::clamp(Value(time), 0.0, in_.h), kind);
    motion_.disc(c.a).reported = true;
    if (!c.plane) motion_.disc(c.b).reported = true;
  }

  SALTUS_FLATTEN void MoveTo(int i, const Instant<T>& at) {
    if (!motion_.IsMovable(i)) return;
    Disc& disc = motion_.disc(i);
    const Vec2<T> p = disc.PositionAt(at.time), v = disc.VelocityAt(at.time);
    if constexpr (kRotation == kSpin) {
      const T s = at.time - disc.t;
      disc.turn = {disc.turn.AngleAfter(s), disc.turn.SpeedAfter(s), disc.turn.acceleration};
    }
    if (Value(at.time) - Value(disc.t) > kNodeMargin * in_.h) disc.kick = 0;
    disc.p = p;
    disc.v = v;
    disc.t = at.time;
    disc.moved = disc.dirty = true;
    disc.event = at.event;
    disc.sub_step_end = kNever;
    disc.curve = nullptr;
  }

  // Moves disc i to an instant, with all discs that it is in closed contact with, and ends these contacts.
  void Release(int i, const Instant<T>& at) {
    if (!motion_.IsMovable(i)) return;
    MoveTo(i, at);
    motion_.disc(i).a = in_.Acceleration(i);
    if constexpr (kRotation == kSpin) motion_.disc(i).turn.acceleration = in_.AngularAcceleration(i);
    Slide(i);
    motion_.ForEachPairOf(i, [&](int q) {
      EventPair& pair = queue_.pair(q);
      if (!pair.closed()) return;
      pair.Change(PairChange::kReleased, PairState::kFree);
      pair.released = at.event;
      ReleaseBoth(motion_.CandidateOf(q), at);
    });
  }
  void ReleaseBoth(const Candidate& c, const Instant<T>& at) {
    Release(c.a, at);
    if (!c.plane) Release(c.b, at);
  }

  // Sets the deceleration of disc i on a table, against its present velocity. A disc that would stop within kNodeMargin
  // rests: rounding may have reversed its velocity at a grid node, and the deceleration would have the wrong sign.
  void Slide(int i) {
    if (in_.table < 0 || !motion_.IsMovable(i) || motion_.disc(i).out) return;
    Disc& disc = motion_.disc(i);
    const T speed = Length(disc.v);
    const bool slides = Value(speed) > 2 * kNodeMargin * in_.h * in_.slowing;
    // A disc this slow would stop after a distance of second order in its speed.
    if (!slides) disc.v = Vec2<T>(T(0.0), T(0.0));
    disc.a = slides ? Scale(-in_.slowing, Quotient(disc.v, speed)) : Vec2<T>(T(0.0), T(0.0));
    disc.moved = true;
    ReportOnTable(i, slides ? ContactMode::kSlip : ContactMode::kStick);
  }
  // Brings disc i to rest on the table, at the time at which its speed reaches zero.
  void Stop(int i, int event) {
    const T time = motion_.disc(i).t + Divide(Length(motion_.disc(i).v), in_.slowing);
    MoveTo(i, {time, event});
    motion_.disc(i).v = Vec2<T>(T(0.0), T(0.0));
    Slide(i);
  }

  // Takes the disc of pair q out of play in its pocket: its contacts end, and it rests where it is.
  void PocketDisc(int q, const Instant<T>& at) {
    const Candidate& c = motion_.CandidateOf(q);
    const T none(0.0);
    Disc& disc = motion_.disc(c.a);
    disc.out = true;
    Release(c.a, at);
    const BodyConstants<T>& body = in_.bodies[c.a];
    pocketed_energy_ += 0.5 * Value(body.mass) * Value(T(Dot(disc.v, disc.v)));
    disc.v = disc.a = Vec2<T>(none, none);
    if constexpr (kRotation == kSpin) {
      const double speed = Value(disc.turn.speed), inverse = Value(body.inverse_inertia);
      if (inverse > 0) pocketed_energy_ += 0.5 * speed * speed / inverse;
      disc.turn.speed = disc.turn.acceleration = none;
    }
    Report(c, ContactMode::kPocketed, at.time, ContactKind::kSustained);
  }

  // Applies the impulse of an impact. `pressed`: the accelerations close the contact, and the two touch nothing else.
  void Impact(int q, const Instant<T>& at, bool pressed) {
    const Candidate& c = motion_.CandidateOf(q);
    ReleaseBoth(c, at);
    const bool again = motion_.disc(c.a).kick > 0 || (!c.plane && motion_.disc(c.b).kick > 0);
    const ContactMode mode = ApplyImpact(c, pressed);
    if (again) RemoveRounding(c, Value(at.time));
    queue_.pair(q).met = Value(at.time);
    SlideBoth(c);
    CountImpact(q);
    Report(c, mode, at.time, ContactKind::kImpact);
  }

  // Sets the closing speed of a pair that touches slowly, without being accelerated into each other, to zero.
  void StopClosing(int q, const Instant<T>& at) {
    const Candidate& c = motion_.CandidateOf(q);
    ReleaseBoth(c, at);
    const Vec2<T> normal = motion_.LastSeparation(c).normal;
    const Vec2<T> impulse = Scale(T(-in_.EffectiveMass(c) * Dot(normal, motion_.LastRelativeVelocity(c))), normal);
    ApplyImpulse(in_, c, impulse, [&](int i, const Vec2<T>& dv) { motion_.disc(i).v += dv; });
    SlideBoth(c);
    queue_.pair(q).passed = at.event;
  }

  // Numbers of events and impacts since the start of the step.
  struct Counts {
    int events = 0, impacts = 0;
  };
  const Counts& counts() const { return counts_; }
  void set_counts(const Counts& counts) { counts_ = counts; }
  // Returns the number of a new event.
  int NewEvent() { return ++counts_.events; }

 private:
  void SlideBoth(const Candidate& c) {
    Slide(c.a);
    if (!c.plane) Slide(c.b);
  }
  void ReportOnTable(int i, ContactMode mode) {
    for (int q = 0; q < motion_.num_pairs(); ++q) {
      const Candidate& c = motion_.CandidateOf(q);
      int& reported = queue_.pair(q).reported_mode;
      if (c.a != i || !motion_.IsTable(c) || reported == static_cast<int>(mode)) continue;
      reported = static_cast<int>(mode);
      Report(c, mode, motion_.disc(i).t, ContactKind::kSustained);
    }
  }

  // Applies the impulse of one impact. If a pair with closing accelerations would separate slowly, its further bounces
  // are applied too: beyond the impulse of a resting contact, friction included, they sum up to a plastic impact.
  SALTUS_FLATTEN ContactMode ApplyImpact(const Candidate& c, bool pressed) {
    const Separation<T> at = motion_.LastSeparation(c);
    const Vec2<T> w = motion_.LastRelativeVelocity(c);
    const PairConstants<T> law = law_.LawAt(c, at.normal, w);
    const bool last = pressed && -Value(law.restitution) * Value(Dot(at.normal, w)) <= kSlowSpeed;
    const T bounce = last ? T(1.0) : T(law.restitution + 1.0);
    const auto impact = MakeImpactOf(c, at.normal, w, bounce, law.friction);
    ApplyImpulse(in_, c, impact.impulse, [&](int i, const Vec2<T>& dv) {
      motion_.disc(i).v += dv;
      motion_.disc(i).kick += ValueOf(dv).norm();
    });
    if constexpr (kRotation == kSpin) {
      ApplyAngularImpulse(
          in_, c, impact.tangential, [&](int i, const T& change) { motion_.disc(i).turn.speed += change; });
    }
    return impact.mode;
  }
  // Removes, after an impact that shares a disc of c with impacts at the same time, the closing speeds that only come
  // from rounding of the positions, which turns the normals. They would cause a second impact of the same pair, whose
  // derivatives belong to no order of the impacts. Only values change.
  void RemoveRounding(const Candidate& c, double time) {
    motion_.ForEachPairBeside(c, [&](int q) {
      if (time - queue_.pair(q).met > kNodeMargin * in_.h) return;
      const Candidate& d = motion_.CandidateOf(q);
      const double turning = std::abs(Value(CurvatureRadius(in_, d, T(in_.ContactDistance(d)))));
      const double kick = motion_.disc(d.a).kick + (d.plane ? 0.0 : motion_.disc(d.b).kick);
      const Approach approach = motion_.ApproachAt(d, time);
      const double rounding = kRoundingOfSteps * (1 + motion_.SizeAt(d, time)) / turning * kick;
      if (turning == 0 || !approach.Touching() || approach.speed >= -kStillSpeed || approach.speed < -rounding) return;
      const Vec2d impulse =
          -Value(in_.EffectiveMass(d)) * approach.speed * ValueOf(motion_.SeparationAtTime(d, T(time)).normal);
      ApplyImpulse(in_, d, Vec2<T>(T(impulse[0]), T(impulse[1])), [&](int i, const Vec2<T>& dv) {
        motion_.disc(i).v += Vec2<T>(T(Value(dv[0])), T(Value(dv[1])));
      });
    });
  }
  void CountImpact(int q) {
    const Candidate& c = motion_.CandidateOf(q);
    if (++queue_.pair(q).meetings > kRepeatedImpacts && MayFallBack()) {
      const bool many =
          motion_.num_discs() >= kManyDiscs || (counts_.impacts > kManyImpacts && Value(in_.ContactOf(c).friction) > 0);
      if (many && !motion_.TouchesAlone(q, Value(motion_.disc(c.a).t))) return Fail("impacts without end");
    }
    if (++counts_.impacts <= kManyImpacts) return;
    ++queue_.pair(q).impacts;
    ++motion_.disc(c.a).impacts;
    if (!c.plane) ++motion_.disc(c.b).impacts;
  }

  auto MakeImpactOf(const Candidate& c, const Vec2<T>& normal, const Vec2<T>& w, const T& bounce,
                    const T& friction) const {
    if constexpr (kRotation == kSpin) {
      const T sliding = AlongSurface<kRotation>(
          in_, c, T(Dot(Perpendicular(normal), w)), [&](auto i) { return motion_.disc(i).turn.speed; });
      return MakeImpact<T>(
          normal, T(Dot(normal, w)), sliding, in_.EffectiveMass(c), in_.TangentialMass(c), bounce, friction, kHeadOn);
    } else {
      return MakeImpact<T>(normal, w, in_.EffectiveMass(c), bounce, friction, kHeadOn);
    }
  }

  const StepInput<T>& in_;
  const Law law_;
  EventMotion<T, kRotation>& motion_;
  EventQueue<T, kRotation>& queue_;
  Counts counts_;
  bool failed_ = false;
  bool falls_back_ = false;
  double pocketed_energy_ = 0;
};

}  // namespace saltus::internal
