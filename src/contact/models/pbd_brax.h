// Position-based dynamics, as Brax's mode `pbd` (Brax 0.0.13).
//
// A step is two integrator steps of h = in.h / 2 under the same force, each
//
//   kick     v <- v + h (u/m + g)
//   drift    p <- p + h v, rounded once;  q <- q + (0, h w / 2) q, normalised
//   project  v <- (p - p_o) / h;  w <- 2 s(q q_o*) / h, negated if c(q q_o*) < 0; o: the state before
//
// Contacts are looked for in the second only, after its drift, at depth > 0, all from the same state.
//
//   position pass, before the projection:
//     lambda   = depth / (1/m_a + 1/m_b + eps),  dp = lambda n / m
//     D_t      = tangential part of the displacement of a's point of contact relative to b's since o
//     lambda_t = |D_t| / W(t)            static friction -lambda_t t moves and turns the discs
//                                        iff lambda_t < mu lambda (planes), < lambda (discs)
//   velocity pass, after it, at the old points and normals:
//     friction P_t = -t min(mu lambda / (2h), |v_t|) / (W(t) + eps)
//     restitution, iff vn0 <= 0, vn0 the normal velocity before the projection:
//              s = -vn - min(e vn0, 0),  d = s n / (|s| + eps),  P_n = |s| / (W(d) + eps) d
//
//   W(d) = sum over both of 1/m + (arm x d)^2: the change of velocity of the point of contact by a unit impulse along
//   d. Contributions to a disc are averaged: sum / (number of contacts + 1e-6). eps = 1e-6.
//
// e and mu are the squares of the scene's values; two discs have static friction whatever mu is, as in the source. In
// the velocity pass the source divides the impulse on disc b by the mass of a, which violates momentum; here by b's
// own. Three numbers of rotation: spin w, and the orientation q = (c, s), cosine and sine of half the angle. Everything
// is differentiated, eps terms included (their derivatives are multiplied by 1/h); ties of min count half. Not
// differentiable where a contact appears, where static friction sets in, and at vn0 = 0. Momentum is conserved up to
// rounding unless a disc touches several things at once.
#pragma once

#include <memory_resource>
#include <vector>

#include "contact/models/brax_common.h"

namespace saltus {

template <bool kSpins>
struct PbdBraxIn {
  static constexpr ModelTraits kTraits = {.name = "pbd_brax",
                                          .summary = "position-based dynamics, contacts in every second step",
                                          .source = "Brax 0.0.13, pbd",
                                          .grid_steps = 2,
                                          .restitution_power = 2,
                                          .projects = true,
                                          .averages = true,
                                          .compared = true,
                                          .relative = true,
                                          .spins = true,
                                          .by_pair = true};
  static constexpr int kRotation = 3;
  template <typename T>
  using State = BodyState<T, kRotation>;

  static void InitialRotation(double* rotation) {
    rotation[0] = 0;
    rotation[1] = 1;
    rotation[2] = 0;
  }

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    State<T> middle = KickAndDrift(in, i, x);
    Project(in, x, &middle);
    State<T> next = KickAndDrift(in, i, middle);
    Project(in, middle, &next);
    return next;
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const int n = static_cast<int>(x.size());
    std::pmr::vector<State<T>> old(n, in.scratch);
    for (int i = 0; i < n; ++i) {
      old[i] = KickAndDrift(in, i, x[i]);
      Project(in, x[i], &old[i]);
      next[i] = KickAndDrift(in, i, old[i]);
    }
    std::pmr::vector<Touching<T>> contacts = FindContacts<T>(in, next);
    CorrectPositions<T>(in, old, contacts, next);
    const std::pmr::vector<State<T>> unprojected(next.begin(), next.end(), in.scratch);
    for (int i = 0; i < n; ++i) Project(in, old[i], &next[i]);
    CorrectVelocities<T>(in, unprojected, contacts, next);
  }

 private:
  template <typename T>
  struct Touching {
    brax::Contact<T> contact;
    T lambda;  // kg m, of the position pass
    ContactMode mode;
  };

  template <typename T, typename H>
  static H SubStep(const StepInput<T, H>& in) {
    return in.h / Base<T>(2);
  }

  template <typename T>
  static void Normalise(State<T>* x) {
    const Vec2<T> q(x->rotation[1], x->rotation[2]);
    const Vec2<T> unit = Quotient(q, Length(q));
    x->rotation[1] = unit[0];
    x->rotation[2] = unit[1];
  }

  template <typename T, typename H>
  static State<T> KickAndDrift(const StepInput<T, H>& in, int i, const State<T>& x) {
    using S = Base<T>;
    const H h = SubStep(in);
    State<T> next = x;
    next.v += Scale(h, in.Acceleration(i));
    for (int j = 0; j < 2; ++j) next.p[j] = FusedMultiplyAdd(h, next.v[j], x.p[j]);
    T spin = x.rotation[0];
    if constexpr (kSpins) spin -= h * in.AngularAcceleration(i);
    const T half_turn = (h / S(2)) * spin;
    next.rotation[1] -= half_turn * x.rotation[2];
    next.rotation[2] += half_turn * x.rotation[1];
    Normalise(&next);
    return next;
  }

  // Sets velocity and spin from the change of pose since `old`. The source divides by the constant h, which its
  // compiler turns into a product.
  template <typename T, typename H>
  static void Project(const StepInput<T, H>& in, const State<T>& old, State<T>* x) {
    using S = Base<T>;
    const H rate = S(1) / SubStep(in);
    Normalise(x);
    x->v = Scale(rate, Vec2<T>(x->p - old.p));
    const T cosine = x->rotation[1] * old.rotation[1] + x->rotation[2] * old.rotation[2];
    const T sine = x->rotation[2] * old.rotation[1] - x->rotation[1] * old.rotation[2];
    const T spin = (S(2) * sine) * rate;
    x->rotation[0] = cosine < S(0) ? T(-spin) : spin;
  }

  // Returns `arm` turned by the orientation of x, or back.
  template <typename T>
  static Vec2<T> Rotate(const Vec2<T>& arm, const State<T>& x, bool back) {
    using S = Base<T>;
    const T c = x.rotation[1];
    const T s = back ? T(-x.rotation[2]) : x.rotation[2];
    return Scale(T(c * c - s * s), arm) + Scale(T(S(2) * c), brax::SpinVelocity(s, arm));
  }

  template <typename T>
  static Vec2<T> Tangential(const Vec2<T>& vector, const Vec2<T>& normal) {
    return vector - Scale(Dot(vector, normal), normal);
  }

  // Returns W of one disc: 1/m + (arm x direction)^2 / I.
  template <typename T>
  static T PointMobility(const StepInput<T>& in, int disc, const Vec2<T>& arm, const Vec2<T>& direction) {
    const T lever = brax::Torque(arm, direction);
    return in.bodies[disc].inverse_mass + brax::InverseInertia<kSpins>(in.bodies[disc]) * (lever * lever);
  }
  // Returns W of both sides at the point of contact.
  template <typename T>
  static T PointMobility(const StepInput<T>& in, const brax::Contact<T>& contact, std::span<const State<T>> x,
                         const Vec2<T>& direction) {
    const Candidate& c = contact.candidate;
    const T a = PointMobility(in, c.a, Vec2<T>(contact.point - x[c.a].p), direction);
    if (c.plane) return a;
    return a + PointMobility(in, c.b, Vec2<T>(contact.point - x[c.b].p), direction);
  }

  template <typename T>
  static std::pmr::vector<Touching<T>> FindContacts(const StepInput<T>& in, std::span<const State<T>> x) {
    using S = Base<T>;
    std::pmr::vector<Touching<T>> contacts(in.scratch);
    for (const Candidate& c : in.candidates) {
      brax::Contact<T> contact = brax::ContactAt(in, c, [&](int i) -> Vec2<T> { return x[i].p; });
      if (!(contact.depth > S(0))) continue;
      if (c.plane) {  // the source measures the depth once more, which rounds
        const Vec2<T> surface = contact.point + Scale(contact.depth, contact.normal);
        contact.depth = -Dot(Vec2<T>(contact.point - surface), contact.normal);
      }
      const T lambda = Divide(contact.depth, T(in.InverseMassA(c) + in.InverseMassB(c) + S(brax::kEpsilon)));
      contacts.push_back({contact, lambda, ContactMode::kFrictionless});
    }
    return contacts;
  }

  // Returns the displacement since `old` of the material point of disc i at the point of contact, m.
  template <typename T>
  static Vec2<T> PointDisplacement(const brax::Contact<T>& contact, int i, std::span<const State<T>> old,
                                   std::span<const State<T>> x) {
    const Vec2<T> arm = Rotate(Vec2<T>(contact.point - x[i].p), x[i], true);
    return contact.point - (old[i].p + Rotate(arm, old[i], false));
  }

  template <typename T>
  static void CorrectPositions(const StepInput<T>& in, std::span<const State<T>> old, std::span<Touching<T>> contacts,
                               std::span<State<T>> x) {
    using S = Base<T>;
    brax::Averages<T> moves(static_cast<int>(x.size()), in.scratch);
    for (Touching<T>& touching : contacts) {
      const brax::Contact<T>& contact = touching.contact;
      const Candidate& c = contact.candidate;
      const T friction = in.ContactOf(c).friction * in.ContactOf(c).friction;
      Vec2<T> push = Scale(touching.lambda, contact.normal);

      const Vec2<T> way = RelativeVelocity<T>(c, [&](int i) { return PointDisplacement<T>(contact, i, old, x); });
      const Vec2<T> slide = Tangential(way, contact.normal);
      const T length = brax::Norm(slide);
      const Vec2<T> tangent = brax::Direction(slide, length);
      const T hold = Divide(length, PointMobility<T>(in, contact, x, tangent));
      const T limit = SafeAbs(touching.lambda);
      const bool holds = c.plane ? hold < friction * limit : hold < limit;
      Vec2<T> grip = Vec2<T>::Zero();
      if (holds) grip = Scale(T(-hold), tangent);
      push += grip;
      if (friction > S(0)) touching.mode = holds ? ContactMode::kStick : ContactMode::kSlip;
      brax::AddPush<kSpins>(in, contact, x, push, grip, &moves);
    }
    moves.ForEach(S(brax::kEpsilon), [&](int disc, const Vec2<T>& dp, const T& turn) {
      State<T>& body = x[disc];
      body.p += dp;
      const T c = body.rotation[1];
      body.rotation[1] -= S(0.5) * (turn * body.rotation[2]);
      body.rotation[2] += S(0.5) * (turn * c);
    });
  }

  // Applies friction and restitution; `unprojected` has the positions of x and the velocities before projection.
  template <typename T>
  static void CorrectVelocities(const StepInput<T>& in, std::span<const State<T>> unprojected,
                                std::span<Touching<T>> contacts, std::span<State<T>> x) {
    using S = Base<T>;
    brax::Averages<T> changes(static_cast<int>(x.size()), in.scratch);
    for (Touching<T>& touching : contacts) {
      const brax::Contact<T>& contact = touching.contact;
      const Candidate& c = contact.candidate;
      const auto velocity_in = [&](std::span<const State<T>> states) {
        return RelativeVelocity<T>(c, [&](int i) -> Vec2<T> {
          return states[i].v + brax::SpinVelocity(states[i].rotation[0], Vec2<T>(contact.point - states[i].p));
        });
      };
      const Vec2<T> velocity = velocity_in(x);
      const T before = Dot(contact.normal, velocity_in(unprojected));
      const Vec2<T> impulse = Restitution<T>(in, x, contact, Dot(contact.normal, velocity), before) -
                              Friction<T>(in, x, Tangential(velocity, contact.normal), &touching);
      brax::AddPush<kSpins>(in, contact, x, impulse, impulse, &changes);
      in.Report(c, touching.mode);
    }
    changes.ForEach(S(brax::kEpsilon), [&](int disc, const Vec2<T>& dv, const T& dw) {
      x[disc].v += dv;
      x[disc].rotation[0] += dw;
    });
  }

  template <typename T>
  static Vec2<T> Restitution(const StepInput<T>& in, std::span<const State<T>> x, const brax::Contact<T>& contact,
                             const T& after, const T& before) {
    using S = Base<T>;
    if (!(before <= S(0))) return Vec2<T>::Zero();
    const PairConstants<T>& pair = in.ContactOf(contact.candidate);
    const T restitution = pair.restitution * pair.restitution;
    const T missing = -after - brax::HalfTieMin(T(restitution * before), T(S(0)));
    const Vec2<T> change = Scale(missing, contact.normal);
    const T size = brax::Norm(change);
    const Vec2<T> direction = brax::Direction(change, size);
    const T mobility = PointMobility(in, contact, x, direction) + S(brax::kEpsilon);
    return Scale(Divide(size, mobility), direction);
  }

  // Returns the impulse against the tangential velocity `tangential`, and sets the mode in `touching`.
  template <typename T>
  static Vec2<T> Friction(const StepInput<T>& in, std::span<const State<T>> x, const Vec2<T>& tangential,
                          Touching<T>* touching) {
    using S = Base<T>;
    const PairConstants<T>& pair = in.ContactOf(touching->contact.candidate);
    const T friction = pair.friction * pair.friction;
    const T speed = brax::Norm(tangential);
    const Vec2<T> direction = brax::Direction(tangential, speed);
    const T limit = Divide(T(friction * SafeAbs(touching->lambda)), S(S(2) * SubStep(in)));
    if (touching->mode == ContactMode::kSlip && speed <= limit) touching->mode = ContactMode::kStick;
    const T mobility = PointMobility(in, touching->contact, x, direction) + S(brax::kEpsilon);
    return Scale(Divide(brax::HalfTieMin(limit, speed), mobility), direction);
  }
};

// In scenes with discs that spin: the same step on angles and angular velocities, from which its rotation is made.
struct PbdBraxSpinning {
  using Source = PbdBraxIn<true>;
  static constexpr ModelTraits kTraits = Source::kTraits;
  static constexpr int kRotation = kSpin;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    const Source::State<T> from = ToSource(x);
    return FromSource<T>(x, from, Source().Free(in, i, from));
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    std::pmr::vector<Source::State<T>> from(in.scratch), to(x.size(), in.scratch);
    for (const State<T>& state : x) from.push_back(ToSource(state));
    Source().Step(in, std::span<const Source::State<T>>(from), std::span<Source::State<T>>(to));
    for (std::size_t i = 0; i < x.size(); ++i) next[i] = FromSource<T>(x[i], from[i], to[i]);
  }

 private:
  // Converts a state to the source's convention, in which rotation is positive clockwise.
  template <typename T>
  static Source::State<T> ToSource(const State<T>& x) {
    using std::cos, std::sin;
    const T half = Base<T>(-0.5) * x.rotation[0];
    return {x.p, x.v, {-x.rotation[1], cos(half), sin(half)}};
  }
  // Converts back. The angle continues from that before the step, so that full turns are counted.
  template <typename T>
  static State<T> FromSource(const State<T>& before, const Source::State<T>& from, const Source::State<T>& to) {
    using std::atan2;
    const T cosine = to.rotation[1] * from.rotation[1] + to.rotation[2] * from.rotation[2];
    const T sine = to.rotation[2] * from.rotation[1] - to.rotation[1] * from.rotation[2];
    return {to.p, to.v, {before.rotation[0] - Base<T>(2) * atan2(sine, cosine), -to.rotation[0]}};
  }
};

struct PbdBrax : PbdBraxIn<false> {
  using Spinning = PbdBraxSpinning;
};

}  // namespace saltus
