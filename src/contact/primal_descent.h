// Implicit springs, by descent in velocities (Macklin et al. 2020). The equations r(z) = 0 of a substep stand in
// spring_step.h; each iteration moves every disc at once,
//
//   z := z - alpha P^-1 m r(z),    P = m I + sum over its contacts of (h_s^2 k_n n n^T + h_s k_t t t^T)
//
// with k_n the slope of the normal force and k_t = min(k_f, mu f_n / |w_t|) the secant of friction. With alpha 1 stiff
// and crowded contacts may cycle, with 0.5 they converge. newton=1 is Newton's method on r instead, and what it and
// exponent 2 give is the penalty contact of ADD (Geilinger et al. 2020) with substeps=1.
//
// Derivatives pass through the iterations, or (implicit=1, and always with Newton's method) are those of r = 0, which
// without convergence are not those of the value. Momentum is conserved at convergence.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <vector>

#include "contact/spring_step.h"

namespace saltus {

struct PrimalDescent : SpringDescent {
  static constexpr ModelTraits kTraits = {.name = "primal_descent",
                                          .summary = "implicit springs by block descent in velocities",
                                          .source = "Macklin et al. 2020; ADD (Geilinger et al. 2020)",
                                          .compliant = true,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kEmergent,
                                          .allocates = true};

  double exponent = 2;
  bool newton = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    VisitSharedOptions(visit);
    visit(ModelOption{"exponent", "of a spring's energy; above 2 its force sets in smoothly", 2, 10}, exponent);
    visit(ModelOption{"newton", "1: Newton's method instead of descent", 0, 1}, newton);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const bool through = !implicit && !newton;
    StepBy<T>(in, exponent, through, x, next, [&]<typename U>(const SpringStep<U>& problem, auto z, auto touched) {
      if (!newton) {
        Descend<U>(problem, z, touched);
      } else if constexpr (std::is_same_v<U, double>) {
        SolveByNewton(problem, z, touched);
      }
    });
  }

 private:
  static constexpr int kMostNewtonSteps = 60;

  // Of one disc: P and the force of its contacts.
  template <typename T>
  struct Block {
    T xx, xy, yy;  // kg
    Vec2<T> force = Vec2<T>(T(0.0), T(0.0));
    bool pressed = false;

    void Add(const T& weight, const Vec2<T>& direction) {
      xx += weight * direction[0] * direction[0];
      xy += weight * direction[0] * direction[1];
      yy += weight * direction[1] * direction[1];
    }
    Vec2<T> Solve(const Vec2<T>& b) const {
      const T determinant = xx * yy - xy * xy;
      return Quotient(Vec2<T>(yy * b[0] - xy * b[1], xx * b[1] - xy * b[0]), determinant);
    }
  };

  template <typename T>
  void Descend(const SpringStep<T>& problem, std::span<T> z, std::span<char> touched) const {
    std::vector<Block<T>> blocks(problem.discs.size());
    for (int iteration = 0; iteration < iterations; ++iteration) {
      for (std::size_t i = 0; i < blocks.size(); ++i) {
        blocks[i] = {};
        blocks[i].xx = blocks[i].yy = problem.discs[i].mass;
        blocks[i].xy = T(0.0);
      }
      AddContacts<T>(problem, z, &blocks, touched);
      if (std::find(touched.begin(), touched.end(), 1) == touched.end()) return;
      bool moved = false;
      for (std::size_t i = 0; i < blocks.size(); ++i) {
        if (!problem.discs[i].fixed) moved |= MoveDisc(problem, blocks[i], static_cast<int>(i), z);
      }
      if (!moved) return;  // nor would any iteration that follows
    }
  }

  template <typename T>
  static void AddContacts(const SpringStep<T>& problem, std::span<const T> z, std::vector<Block<T>>* blocks,
                          std::span<char> touched) {
    for (std::size_t c = 0; c < problem.contacts.size(); ++c) {
      const auto& side = problem.contacts[c];
      const auto at = problem.Press(z, side);
      if (!at.pressed) continue;
      touched[c] = 1;
      const T slope = problem.stiffness * (problem.exponent - 1) * Power(at.depth, problem.exponent - 2);
      const T normal = problem.h * problem.h * slope, tangential = problem.h * Secant(problem, at);
      const Vec2<T> push = Scale(at.force, at.normal) - Scale(at.friction, at.tangent);
      for (const int disc : {side.a, side.b}) {
        if (disc < 0) continue;
        Block<T>& block = (*blocks)[disc];
        block.pressed = true;
        block.force += disc == side.a ? push : Vec2<T>(-push);
        block.Add(normal, at.normal);
        block.Add(tangential, at.tangent);
      }
    }
  }

  template <typename T>
  static T Secant(const SpringStep<T>& problem, const typename SpringStep<T>::At& at) {
    if (!(problem.friction > 0.0)) return T(0.0);
    if (at.sticks || at.sliding == 0.0) return T(problem.drag);
    return Divide(T(problem.friction * at.force), SafeAbs(at.sliding));
  }

  // False if nothing changes, the derivative included.
  template <typename T>
  bool MoveDisc(const SpringStep<T>& problem, const Block<T>& block, int i, std::span<T> z) const {
    const auto& disc = problem.discs[i];
    Vec2<T> step = problem.VelocityOf(z, i) - disc.free_velocity;
    if (block.pressed) step = block.Solve(Scale(disc.mass, step) - Scale(problem.h, block.force));
    const Vec2<T> before = problem.VelocityOf(z, i);
    for (int j = 0; j < 2; ++j) z[2 * i + j] -= alpha * step[j];
    return !Same(before, problem.VelocityOf(z, i));
  }

  // Steps are halved until the residual falls.
  static void SolveByNewton(const SpringStep<double>& problem, std::span<double> z, std::span<char> touched) {
    Eigen::Map<Eigen::VectorXd> at(z.data(), z.size());
    double error = Mark(problem, z, touched);
    for (int step = 0; step < kMostNewtonSteps && error > 0; ++step) {
      const Linearized linear = LinearizeByUnknowns(problem, at);
      const Eigen::VectorXd start = at, change = linear.jacobian.partialPivLu().solve(-linear.residual);
      double length = 1, reached = error;
      for (; length > 1e-10; length *= 0.5) {
        at = start + length * change;
        reached = Mark(problem, z, touched);
        if (reached < error) break;
      }
      if (!(reached < error)) {
        at = start;  // to rounding
        return;
      }
      error = reached;
    }
  }

  // |r(z)|; marks what presses there.
  static double Mark(const SpringStep<double>& problem, std::span<const double> z, std::span<char> touched) {
    for (std::size_t c = 0; c < touched.size(); ++c) {
      if (problem.Locate(z, problem.contacts[c]).pressed) touched[c] = 1;
    }
    std::vector<double> F(z.size());
    problem.Residual(z, F);
    return Eigen::Map<const Eigen::VectorXd>(F.data(), F.size()).norm();
  }
};

}  // namespace saltus
