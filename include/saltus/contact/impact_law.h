// Laws of impact with parameters: restitution, and optionally friction, as functions of the speeds at an impact. A law
// is a small network or any function of the user. Identify() fits the parameters to recordings.
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
// p_n or sticks.
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
  // The function, which must not keep state. Parameter blocks: the speeds of approach and of sliding before the impact
  // (m/s, both >= 0), and all parameters. Residuals: the restitution in [0, 1] and, optionally, the coefficient of
  // friction,
  // >= 0, which replaces that of the scene. Sustained contacts have the values at the speeds 0.
  std::shared_ptr<const ceres::CostFunction> function = nullptr;
  std::vector<double> parameters;
  // Standard deviation of the normal prior of each parameter around its start, in a fit; > 0. Parameters that the data
  // do not determine remain near their start.
  double spread = 10;
  // Number of the first parameters that are fitted after the others: those on which the law depends nonlinearly, such
  // as the inner weights of a network.
  int learned_last = 0;

  bool HasFriction() const;
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string WhatIsWrongWith(const ImpactLaw& law);

// The values of a law. Precondition: WhatIsWrongWith is empty.
struct ImpactLawAt {
  double restitution = 0;                                 // NaN where the law has no value
  double friction = 0;                                    // 0 if the law has no friction
  std::vector<double> restitution_slope, friction_slope;  // by the parameters
};
ImpactLawAt EvaluateLaw(const ImpactLaw& law, double speed, double sliding);

// Returns a network with one hidden layer of `width` tanh units and the logistic function at its output:
//   e = 1 / (1 + exp(-(a + sum of c_i tanh(w_i v / speed + b_i))))          v: speed of approach
// Its start is the constant `restitution`. Preconditions: width >= 1, speed > 0 (m/s, that of a fast impact),
// restitution in (0, 1).
ImpactLaw RestitutionNetwork(int width, double speed, double restitution);

// Returns a network of both speeds, with a second output whose exponential is the coefficient of friction.
// Precondition: friction > 0.
ImpactLaw ImpulseNetwork(int width, double speed, double restitution, double friction);

}  // namespace saltus
