// Laws of impact that have parameters: restitution, and friction if the law says so, as functions of the speeds at an
// impact. A small network, or any function of a user's own; Identify() finds the parameters from recordings.
//
//   struct Softening {  // e = a / (1 + b v)
//     template <typename T>
//     bool operator()(const T* speeds, const T* parameters, T* restitution) const {
//       restitution[0] = parameters[0] / (1.0 + parameters[1] * speeds[0]);
//       return true;
//     }
//   };
//   ImpactLaw law{.name = "softening", .parameters = {0.9, 0.1}};
//   law.function = std::make_shared<ceres::AutoDiffCostFunction<Softening, 1, 2, 2>>(new Softening);
//   MakeSimulator(LearnedContact(law), scene, Precision::kDouble);     // saltus/simulate/learned_contact.h
//
// An impact has the impulse of contact/law/impact.h with these two numbers: p_n = -(1 + e) m v_n, and p_t slips with mu
// p_n or sticks. Every impulse that parts the discs and works against their sliding is of that kind.
#pragma once

#include <memory>
#include <string>
#include <vector>

namespace ceres {
class CostFunction;
}

namespace saltus {

struct ImpactLaw {
  std::string name = "own law";  // for messages
  // Parameter blocks: the speeds of approach and of sliding before the impact (m/s, both >= 0), then all parameters.
  // One residual, the restitution in [0, 1]; of two, the second is the coefficient of friction, >= 0, in the place of
  // the scene's. The law at the speeds 0 is that of contacts that last. Must not keep state.
  std::shared_ptr<const ceres::CostFunction> function = nullptr;
  std::vector<double> parameters;
  // Where it is learned: each parameter has a normal prior of this standard deviation around its start, so that what
  // the data leave open stays where it was. > 0.
  double spread = 10;
  // The first so many of the parameters are learned after the others, from their start: those of which the law is no
  // linear function, such as the bends of a network.
  int learned_last = 0;

  bool HasFriction() const;
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string WhatIsWrongWith(const ImpactLaw& law);

// The values of a law. Precondition: nothing is wrong with it.
struct ImpactLawAt {
  double restitution = 0;                                 // not a number where the law has no value
  double friction = 0;                                    // 0 if the law says nothing of it
  std::vector<double> restitution_slope, friction_slope;  // by the parameters
};
ImpactLawAt EvaluateLaw(const ImpactLaw& law, double speed, double sliding);

// A network with one hidden layer of `width` tanh units, whose output is made a restitution by the logistic function:
//   e = 1 / (1 + exp(-(a + sum of c_i tanh(w_i v / speed + b_i))))          v: speed of approach
// It begins as the constant `restitution`. Preconditions: width >= 1, speed > 0 (m/s, a large one of the impacts at
// hand), restitution in (0, 1).
ImpactLaw RestitutionNetwork(int width, double speed, double restitution);

// A network with both speeds for inputs, and a second output that the exponential makes a coefficient of friction.
// Precondition: friction > 0.
ImpactLaw ImpulseNetwork(int width, double speed, double restitution, double friction);

}  // namespace saltus
