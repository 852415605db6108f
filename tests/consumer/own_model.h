// A contact model of a user's own, written against what saltus installs: springs that resist overlap, stiffer on the
// way in than on the way out, and friction that sets in smoothly.
#pragma once

#include <memory_resource>
#include <vector>

#include "saltus/contact/contact_model.h"

struct OwnModel {
  static constexpr saltus::ModelTraits kTraits = {.name = "own_model",
                                                  .summary = "springs with losses, smooth friction",
                                                  .source = "a user",
                                                  .compliant = true,
                                                  .rebound = saltus::Rebound::kEmergent,
                                                  .relative = true};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = saltus::BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const saltus::StepInput<T>& in, int i, const State<T>& x) const {
    return saltus::SemiImplicitEuler(in, i, x);
  }

  template <typename T>
  void Step(const saltus::StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using saltus::Dot;
    using saltus::Scale;
    using Vector = saltus::Vec2<T>;
    using S = saltus::Base<T>;
    std::pmr::vector<Vector> acceleration(in.scratch);
    for (int i = 0; i < static_cast<int>(x.size()); ++i) acceleration.push_back(in.Acceleration(i));
    for (const saltus::Candidate& c : in.candidates) {
      const auto at = saltus::SeparationAt(in, c, [&](int i) -> const Vector& { return x[i].p; });
      const T depth = in.ContactDistance(c) - at.distance;
      if (!(depth > S(0))) continue;
      const Vector w = saltus::RelativeVelocity<T>(c, [&](int i) -> Vector { return x[i].v; });
      const T speed = Dot(at.normal, w);
      const T loss = in.contact.damping * depth * speed;
      const T push = saltus::MaxOf(T(S(0)), T(in.contact.stiffness * depth - loss));
      const Vector sliding = w - Scale(speed, at.normal);
      const T slip = saltus::SafeSqrt(T(Dot(sliding, sliding) + S(1e-4)));
      const T drag = saltus::Divide(T(-in.contact.friction * push), slip);
      in.Report(c);
      saltus::ApplyImpulse(
          in, c, Vector(Scale(push, at.normal) + Scale(drag, sliding)), [&](int i, const Vector& change) {
            acceleration[i] += change;
          });
    }
    for (std::size_t i = 0; i < x.size(); ++i) next[i] = saltus::SemiImplicitEuler<T>(in.h, acceleration[i], x[i]);
  }
};
