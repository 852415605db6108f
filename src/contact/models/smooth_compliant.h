// Springs whose force sets in with two derivatives, and smoothed Coulomb friction, in substeps.
//
// The elastic force is damped in proportion to itself (Hunt, Crossley 1975; as documented by Drake), so it neither
// jumps when a contact begins nor pulls when it ends; friction is mollified as in the IPC toolkit (Li et al. 2020).
// With the gap g, n and the relative velocity w = w_n n + w_t t (of discs that spin, that of the points of contact,
// where F acts) at the start of a substep of h_s = h / substeps there is a contact iff g < 0. Then
//
//   f_n = k (-g)^exponent max(0, 1 - d w_n)                  N, on a along n
//   f_t = -mu f_n y (2 - y) sgn(w_t), y = min(|w_t| / slip_speed, 1)
//   v <- v + h_s (F/m + u/m + g),   p <- p + h_s v
//
// k is such that the elastic force at reference_depth is stiffness * reference_depth. d, s/m, gives the scene's
// restitution at reference_speed: in an impact with speed s it is s' for d (s + s') = ln((1 + d s) / (1 - d s')),
// whatever k and exponent. At other speeds restitution differs; it is taken as at least 0.01. Damping is not read.
//
// Everything is differentiated; the derivative is continuous but at 1 = d w_n. As the step goes to zero and then the
// stiffness to infinity, both the motion and its derivatives go to those of exact impacts. Momentum is conserved.
#pragma once

#include <algorithm>
#include <memory_resource>
#include <vector>

#include "base/power.h"
#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

struct HuntCrossley {
  static constexpr double kLeastRestitution = 0.01;

  // Returns d * reference_speed for a restitution: dimensionless, positive, and negative above restitution 1.
  static double ScaledDissipation(double restitution);
};

template <int kTurn>
struct SmoothCompliantOf : HuntCrossley, SubstepFlight<kTurn, 4> {
  using Flight = SubstepFlight<kTurn, 4>;
  using Flight::substeps, Flight::SubstepLength;
  static constexpr ModelTraits kTraits = {.name = "smooth_compliant",
                                          .summary = "smooth spring with Hunt-Crossley dissipation, in substeps",
                                          .source = "Hunt, Crossley 1975; Drake; IPC toolkit (Li et al. 2020)",
                                          .compliant = true,
                                          .chains = true,
                                          .rebound = Rebound::kEmergent,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;

  double exponent = 3;            // of the overlap; 1.5 is Hertz's
  double reference_depth = 0.01;  // m
  double reference_speed = 5;     // m/s
  double slip_speed = 1e-2;       // m/s
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"exponent", "exponent of the overlap; 1.5 is Hertz's", 1, 10}, exponent);
    visit(ModelOption{"reference_depth", "overlap at which the force is that of a linear spring, m", 1e-6, 1},
          reference_depth);
    visit(ModelOption{"reference_speed", "impact speed at which the restitution is that of the scene, m/s", 1e-3, 1e3},
          reference_speed);
    visit(
        ModelOption{
            "slip_speed", "sliding speed below which friction is less than mu times the normal force, m/s", 1e-6, 1},
        slip_speed);
    visit(ModelOption{"substeps", "substeps of a step", 1, 1e4}, substeps);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    std::copy(x.begin(), x.end(), next.begin());
    const Base<T> h = SubstepLength(in);
    std::pmr::vector<Law<T>> laws(in.scratch);  // by pairs of materials
    for (int pair = 0; pair < in.num_pairs(); ++pair) laws.push_back(LawOf(in, pair));
    std::pmr::vector<char> reported(in.candidates.size(), 0, in.scratch);
    std::pmr::vector<Twist<T, kTurn>> acceleration(x.size(), in.scratch);
    for (int substep = 0; substep < substeps; ++substep) {
      for (std::size_t i = 0; i < x.size(); ++i) {
        acceleration[i] = AccelerationOf<kTurn>(in, static_cast<int>(i));
      }
      for (std::size_t i = 0; i < in.candidates.size(); ++i) {
        const Candidate& c = in.candidates[i];
        ContactMode mode;
        Vec2<T> force, normal;
        if (!Force<T>(in, laws[in.PairOf(c)], c, next, &force, &normal, &mode)) continue;
        if (!reported[i]) in.Report(c, mode);
        reported[i] = 1;
        PushContact<kTurn>(in, c, normal, force, [&](int disc, const auto& change) { acceleration[disc] += change; });
      }
      for (std::size_t i = 0; i < x.size(); ++i) next[i] = SemiImplicitEuler(h, acceleration[i], next[i]);
    }
  }

 private:
  template <typename T>
  struct Law {
    T stiffness;    // N / m^exponent
    T dissipation;  // s/m
  };

  template <typename T>
  Law<T> LawOf(const StepInput<T>& in, int pair) const {
    using S = Base<T>;
    const T& restitution = in.ContactOfPair(pair).restitution;
    const double e = Value(restitution);
    const double x = ScaledDissipation(e);
    // dx/de from the condition that defines x; its limit at x = 0.
    const double slope = x == 0 ? -1.5 : -e * x * (1 + x) / ((1 + e) * (e * x - 1 + e));
    const T change = restitution - Value(restitution);
    return {in.contact.stiffness * S(std::pow(reference_depth, 1 - exponent)),
            (change * S(e > kLeastRestitution ? slope : 0) + S(x)) * S(1 / reference_speed)};
  }

  // Sets the force on a at the point of contact, N. Returns false if the two do not touch.
  template <typename T>
  bool Force(const StepInput<T>& in, const Law<T>& law, const Candidate& c, std::span<const State<T>> x, Vec2<T>* force,
             Vec2<T>* normal, ContactMode* mode) const {
    using S = Base<T>;
    const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; });
    const T depth = in.ContactDistance(c) - at.distance;
    if (!(depth > S(0))) return false;
    *normal = at.normal;
    const Vec2<T> w = ContactVelocity<kTurn>(in, c, at.normal, [&](int i) { return TwistOf(x[i]); });
    const T normal_force =
        law.stiffness * Power(depth, S(exponent)) * MaxOf(T(S(0)), T(S(1) - law.dissipation * Dot(at.normal, w)));
    const Vec2<T> tangent = Perpendicular(at.normal);
    const T sliding = Dot(tangent, w);
    const T y = MinOf(Divide(SafeAbs(sliding), S(slip_speed)), T(S(1)));
    const T friction = in.ContactOf(c).friction * normal_force * y * (S(2) - y) * SignOf(sliding);
    *force = Scale(normal_force, at.normal) - Scale(friction, tangent);
    *mode = ModeOf(in.ContactOf(c).friction > S(0), y < S(1));
    return true;
  }
};

struct SmoothCompliant : SmoothCompliantOf<0> {
  using Spinning = SmoothCompliantOf<kSpin>;
};

}  // namespace saltus
