// Implicit springs, by descent in their forces (Macklin et al. 2020). The equations r(z) = 0 of a substep stand in
// spring_step.h, with exponent 2; each iteration moves the force of every contact that overlaps or pushes, at the
// velocities z of the iteration before,
//
//   l := max(0, l + alpha (-phi - l/k) / (1/k + h_s^2 / m_eff))                            along n
//   s := s + alpha (-w_t - s/k_f) / (1/k_f + h_s / m_eff), within +-mu l                   along t; m_eff with spin
//   z := v_f + h_s M^-1 sum over contacts of (l n + s t)
//
// from forces of zero; the limit is that of primal_descent. With gauss_seidel=1 z follows every contact at once. With
// incremental=1 only what changes of l and s is added, along n and t of its own iteration: with discs that meet
// obliquely that is another limit than r = 0, so the last iterate is the result, whatever implicit is. With stiff
// springs among many contacts alpha 1 may diverge; 1 over the contacts of a disc is safe.
//
// With implicit=0 the last iterate is the result and derivatives pass through the iterations, as published. Momentum is
// conserved.
#pragma once

#include <vector>

#include "contact/models/spring_step.h"

namespace saltus {

template <int kTurn>
struct DualDescentOf : SpringDescent<kTurn> {
  using Shared = SpringDescent<kTurn>;
  using Shared::alpha, Shared::implicit, Shared::iterations;
  template <typename T>
  using State = typename Shared::template State<T>;
  template <typename T>
  using Problem = SpringStep<T, kTurn>;
  static constexpr ModelTraits kTraits = {.name = "dual_descent",
                                          .summary = "implicit springs by descent in their forces",
                                          .source = "Macklin et al. 2020",
                                          .compliant = true,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kEmergent,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};

  bool gauss_seidel = false;
  bool incremental = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    this->VisitSharedOptions(visit);
    visit(ModelOption{"gauss_seidel", "1: updates contacts one after another; 0: all together", 0, 1}, gauss_seidel);
    visit(
        ModelOption{
            "incremental", "1: adds each change of the forces along the contact directions of its iteration", 0, 1},
        incremental);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const bool through = !implicit || incremental;
    this->template StepBy<T>(
        in, /*exponent=*/2, through, x, next, [&]<typename U>(const Problem<U>& problem, auto z, auto touched) {
          Descend<U>(problem, z, touched);
        });
  }

 private:
  template <typename T>
  struct Forces {
    T normal, tangential;                       // N
    Vec2<T> applied = Vec2<T>(T(0.0), T(0.0));  // l n + s t

    bool HasSameForces(const Forces& other) const {
      return SameNumbers(normal, other.normal) && SameNumbers(tangential, other.tangential) &&
             SameNumbers(applied[0], other.applied[0]) && SameNumbers(applied[1], other.applied[1]);
    }
  };

  template <typename T>
  void Descend(const Problem<T>& problem, std::span<T> z, std::span<char> touched) const {
    std::vector<Forces<T>> forces(problem.contacts.size(), Forces<T>{T(0.0), T(0.0)});
    std::vector<T> seen(z.begin(), z.end());
    for (int iteration = 0; iteration < iterations; ++iteration) {
      if (!gauss_seidel) std::copy(z.begin(), z.end(), seen.begin());
      bool any = false;
      for (std::size_t c = 0; c < forces.size(); ++c) {
        const auto& side = problem.contacts[c];
        const auto at = problem.Locate(gauss_seidel ? std::span<const T>(z) : std::span<const T>(seen), side);
        if (!at.pressed && !(forces[c].normal > 0.0)) continue;
        touched[c] = 1;
        const Forces<T> before = forces[c];
        const Vec2<T> change = Update(problem, side, at, &forces[c]);
        any = any || !before.HasSameForces(forces[c]);
        problem.Apply(side, change, [&](int disc, const Vec2<T>& by) {
          for (int j = 0; j < 2; ++j) z[Problem<T>::kUnknowns * disc + j] += by[j];
        });
        if constexpr (kTurn == kSpin) {
          problem.Turn(side, T(forces[c].tangential - before.tangential), [&](int disc, const T& by) {
            z[Problem<T>::kUnknowns * disc + 2] += by;
          });
        }
      }
      if (!any) return;
    }
  }

  // Updates the forces of a contact by one iteration; returns the change of the force on disc a, N.
  template <typename T>
  Vec2<T> Update(const Problem<T>& problem, const typename Problem<T>::Side& side,
                 const typename Problem<T>::ContactPoint& at, Forces<T>* forces) const {
    const Forces<T> before = *forces;
    T mobility = problem.discs[side.a].inverse_mass;
    if (side.b >= 0) mobility += problem.discs[side.b].inverse_mass;
    const T give = Divide(1.0, problem.stiffness);
    const T miss = at.depth - before.normal * give;
    forces->normal =
        MaxOf(T(0.0), T(before.normal + Divide(T(alpha * miss), T(give + problem.h * problem.h * mobility))));
    if (side.friction > 0.0) {
      const T slip = -at.sliding - before.tangential / problem.drag;
      if constexpr (kTurn == kSpin) {
        for (const int disc : {side.a, side.b}) {
          if (disc < 0) continue;
          const auto& body = problem.discs[disc];
          mobility += body.radius * body.radius * body.inverse_inertia;
        }
      }
      const T wanted = before.tangential + Divide(T(alpha * slip), T(1 / problem.drag + problem.h * mobility));
      const T bound = side.friction * forces->normal;
      forces->tangential = MaxOf(T(-bound), MinOf(wanted, bound));
    }
    if (incremental) {
      return Scale(T(forces->normal - before.normal), at.normal) +
             Scale(T(forces->tangential - before.tangential), at.tangent);
    }
    forces->applied = Scale(forces->normal, at.normal) + Scale(forces->tangential, at.tangent);
    return forces->applied - before.applied;
  }
};

struct DualDescent : DualDescentOf<0> {
  using Spinning = DualDescentOf<kSpin>;
};

}  // namespace saltus
