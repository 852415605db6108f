// Implicit springs, by descent in velocities (Macklin et al. 2020). The equations r(z) = 0 of a substep stand in
// spring_step.h; each iteration moves every disc at once,
//
//   z := z - alpha P^-1 m r(z),    P = m I + sum over its contacts of (h_s^2 k_n n n^T + h_s k_t t t^T)
//
// with k_n the slope of the normal force and k_t = min(k_f, mu f_n / |w_t|) the secant of friction; of a disc that
// spins P has a third row, in which t goes on with -r and m is its inertia. With alpha 1 stiff and crowded contacts may
// cycle, with 0.5 they converge. With newton=1 there are no iterations: Newton's method starts at v_f. This and
// exponent 2 are the penalty contact of ADD (Geilinger et al. 2020) with substeps=1.
//
// With implicit=0 the last iterate is the result and derivatives pass through the iterations, as published. Momentum is
// conserved at convergence.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "contact/models/spring_step.h"

namespace saltus {

template <int kTurn>
struct PrimalDescentOf : SpringDescent<kTurn> {
  using Shared = SpringDescent<kTurn>;
  using Shared::alpha, Shared::implicit, Shared::iterations;
  template <typename T>
  using State = typename Shared::template State<T>;
  template <typename T>
  using Problem = SpringStep<T, kTurn>;
  static constexpr ModelTraits kTraits = {.name = "primal_descent",
                                          .summary = "implicit springs by block descent in velocities",
                                          .source = "Macklin et al. 2020; ADD (Geilinger et al. 2020)",
                                          .compliant = true,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kEmergent,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};

  double exponent = 2;
  bool newton = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    this->VisitSharedOptions(visit);
    visit(ModelOption{"exponent", "exponent of the energy of a spring; above 2 its force begins smoothly", 2, 10},
          exponent);
    visit(ModelOption{"newton", "1: Newton's method instead of descent", 0, 1}, newton);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const bool through = !implicit && !newton;
    this->template StepBy<T>(
        in, exponent, through, x, next, [&]<typename U>(const Problem<U>& problem, auto z, auto touched) {
          if (!newton) Descend<U>(problem, z, touched);
        });
  }

 private:
  // The block of one disc in P, and the sum of its contact forces.
  template <typename T>
  struct Block {
    T xx, xy, yy;  // kg
    Vec2<T> force = Vec2<T>(T(0.0), T(0.0));
    bool pressed = false;
    Vec2<T> x_turn = Vec2<T>(T(0.0), T(0.0));  // the row of turning, kg m
    T turn = T(0.0), torque = T(0.0);          // kg m^2, N m

    void Add(const T& weight, const Vec2<T>& direction) {
      xx += weight * direction[0] * direction[0];
      xy += weight * direction[0] * direction[1];
      yy += weight * direction[1] * direction[1];
    }
    void AddTurning(const T& weight, const Vec2<T>& tangent, double radius) {
      x_turn += Scale(T(-weight * radius), tangent);
      turn += weight * radius * radius;
    }
    // Eliminates the rotation from the first two rows, for Solve(b - x_turn * result); its right-hand side is `b`.
    T Eliminate(const T& b) {
      xx -= Divide(T(x_turn[0] * x_turn[0]), turn);
      xy -= Divide(T(x_turn[0] * x_turn[1]), turn);
      yy -= Divide(T(x_turn[1] * x_turn[1]), turn);
      return Divide(b, turn);
    }
    Vec2<T> Solve(const Vec2<T>& b) const {
      const T determinant = xx * yy - xy * xy;
      return Quotient(Vec2<T>(yy * b[0] - xy * b[1], xx * b[1] - xy * b[0]), determinant);
    }
  };

  template <typename T>
  void Descend(const Problem<T>& problem, std::span<T> z, std::span<char> touched) const {
    std::vector<Block<T>> blocks(problem.discs.size());
    std::vector<T> before(z.begin(), z.end());
    for (int iteration = 0; iteration < iterations; ++iteration) {
      for (std::size_t i = 0; i < blocks.size(); ++i) {
        blocks[i] = {};
        blocks[i].xx = blocks[i].yy = problem.discs[i].mass;
        blocks[i].xy = T(0.0);
        if constexpr (kTurn == kSpin) {
          const T& inverse = problem.discs[i].inverse_inertia;
          blocks[i].turn = inverse > 0.0 ? Divide(1.0, inverse) : T(1.0);
        }
      }
      AddContacts<T>(problem, z, &blocks, touched);
      if (std::find(touched.begin(), touched.end(), 1) == touched.end()) return;
      for (std::size_t i = 0; i < blocks.size(); ++i) {
        if (!problem.discs[i].fixed) MoveDisc(problem, blocks[i], static_cast<int>(i), z);
      }
      // An iteration that changes nothing is a fixed point: all further ones would change nothing either.
      if (SameNumbers<T>(z, before)) return;
      std::copy(z.begin(), z.end(), before.begin());
    }
  }

  template <typename T>
  static void AddContacts(const Problem<T>& problem, std::span<const T> z, std::vector<Block<T>>* blocks,
                          std::span<char> touched) {
    for (std::size_t c = 0; c < problem.contacts.size(); ++c) {
      const auto& side = problem.contacts[c];
      const auto at = problem.EvaluateContact(z, side);
      if (!at.pressed) continue;
      touched[c] = 1;
      const T slope = problem.stiffness * (problem.exponent - 1) * Power(at.depth, problem.exponent - 2);
      const T normal = problem.h * problem.h * slope, tangential = problem.h * Secant(problem, side, at);
      const Vec2<T> push = Scale(at.force, at.normal) - Scale(at.friction, at.tangent);
      for (const int disc : {side.a, side.b}) {
        if (disc < 0) continue;
        Block<T>& block = (*blocks)[disc];
        block.pressed = true;
        block.force += disc == side.a ? push : Vec2<T>(-push);
        block.Add(normal, at.normal);
        block.Add(tangential, at.tangent);
        if constexpr (kTurn == kSpin) {
          const auto& body = problem.discs[disc];
          if (!(body.inverse_inertia > 0.0)) continue;
          // The tangent is a's; b's rim moves along it as a's does.
          block.AddTurning(tangential, disc == side.a ? at.tangent : Vec2<T>(-at.tangent), body.radius);
          block.torque += at.friction * body.radius;
        }
      }
    }
  }

  template <typename T>
  static T Secant(const Problem<T>& problem, const typename Problem<T>::Side& side,
                  const typename Problem<T>::ContactPoint& at) {
    if (!(side.friction > 0.0)) return T(0.0);
    if (at.sticks || at.sliding == 0.0) return T(problem.drag);
    return Divide(T(side.friction * at.force), SafeAbs(at.sliding));
  }

  template <typename T>
  void MoveDisc(const Problem<T>& problem, const Block<T>& block, int i, std::span<T> z) const {
    const auto& disc = problem.discs[i];
    Vec2<T> step = problem.VelocityOf(z, i) - disc.free_velocity;
    if constexpr (kTurn == kSpin) {
      MoveSpinning(problem, block, i, step, z);
    } else {
      if (block.pressed) step = block.Solve(Scale(disc.mass, step) - Scale(problem.h, block.force));
      for (int j = 0; j < 2; ++j) z[2 * i + j] -= alpha * step[j];
    }
  }

  // Moves a disc that may spin. `step`: its velocity less the one without contact, which is the step without springs.
  template <typename T>
  void MoveSpinning(const Problem<T>& problem, Block<T> block, int i, Vec2<T> step, std::span<T> z) const {
    const auto& disc = problem.discs[i];
    T* at = &z[Problem<T>::kUnknowns * i];
    T turn = at[2] - disc.free_spin;
    if (block.pressed) {
      const bool spins = disc.inverse_inertia > 0.0;
      Vec2<T> right = Scale(disc.mass, step) - Scale(problem.h, block.force);
      if (spins) {
        const T inertia = Divide(1.0, disc.inverse_inertia);
        const T torque = inertia * turn - problem.h * block.torque, alone = block.Eliminate(torque);
        step = block.Solve(right - Scale(alone, block.x_turn));
        turn = Divide(T(torque - Dot(block.x_turn, step)), block.turn);
      } else {
        step = block.Solve(right);
      }
    }
    for (int j = 0; j < 2; ++j) at[j] -= alpha * step[j];
    at[2] -= alpha * turn;
  }
};

struct PrimalDescent : PrimalDescentOf<0> {
  using Spinning = PrimalDescentOf<kSpin>;
};

}  // namespace saltus
