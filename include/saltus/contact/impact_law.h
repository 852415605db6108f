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
// The impulse of an impact is that of src/contact/law/impact.h with these two numbers: with the normal n towards disc a
// and the effective mass m, the part along n on a is p_n = -(1 + e) m v_n, where v_n < 0, and the tangential part is
// -mu sign(v_t) p_n (slip) or what stops v_t (stick).
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
  // The function, which must not keep state. Parameter blocks: [speed of approach, speed of sliding] before the impact
  // (2 numbers, m/s, both >= 0), and all parameters. Residuals: the restitution in [0, 1] and, optionally, the
  // coefficient of friction, >= 0, which replaces that of the scene. Sustained contacts have the values at speeds 0.
  std::shared_ptr<const ceres::CostFunction> function = nullptr;
  std::vector<double> parameters;
  // Standard deviation of the normal prior of each parameter around its start, in a fit; > 0. Parameters that the data
  // do not determine remain near their start.
  double spread = 10;
  // Number of the first parameters that are fitted after the others: those on which the law depends nonlinearly, such
  // as the inner weights of a network.
  int learned_last = 0;

  // Returns whether the function has two residuals. Precondition: it is not null.
  bool HasFriction() const;
};

// Returns the first error as "found x, expected y"; empty if there is none.
std::string Validate(const ImpactLaw& law);

// The values of a law at the speeds of an impact, and their derivatives.
struct ImpactLawValues {
  double restitution = 0;                                 // NaN if the function fails or a value is out of its range
  double friction = 0;                                    // 0 if the law has no friction
  std::vector<double> restitution_slope, friction_slope;  // by the parameters, one for each; empty without a value
};
// Evaluates a law at speeds of approach and of sliding, m/s, >= 0. Precondition: Validate() returns an empty text.
ImpactLawValues EvaluateLaw(const ImpactLaw& law, double speed, double sliding);

// Returns a network with one hidden layer of `width` tanh units and the logistic function at its output:
//   e = 1 / (1 + exp(-(a + sum of c_i tanh(w_i v / speed + b_i))))          v: speed of approach
// Its parameters are w_0, b_0, w_1, b_1, ..., all c_i, and a. Its start is the constant `restitution`. Preconditions:
// width >= 1, speed > 0 (m/s, that of a fast impact), restitution in (0, 1).
ImpactLaw RestitutionNetwork(int width, double speed, double restitution);

// Returns a network of both speeds, with a second output whose exponential is the coefficient of friction. Each hidden
// unit has two weights and a bias; the weights and the bias of the second output follow those of the first.
// Preconditions: those of RestitutionNetwork, and friction > 0.
ImpactLaw ImpulseNetwork(int width, double speed, double restitution, double friction);

}  // namespace saltus
