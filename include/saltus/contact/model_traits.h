// Traits and options of contact models.
#pragma once

#include <string_view>

namespace saltus {

// The speed at which bodies separate after an impact.
enum class Rebound {
  kRestitution,  // closing speed * restitution^restitution_power
  kElasticOnly,  // closing speed if the restitution is 1; otherwise less than restitution times closing speed
  kEmergent,     // as follows from the force law or from the correction of overlaps
  kPlastic,      // they do not separate; the restitution is not read
};

// Traits of a model. Tests, the audit and the programs read these and never depend on the name of a model.
struct ModelTraits {
  std::string_view name;            // the value of --contact
  std::string_view summary;         // one line
  std::string_view source;          // paper or package, and section
  int grid_steps = 1;               // steps of the scene's time grid that one step of the model covers
  bool friction = true;             // supports friction; otherwise scenes with friction > 0 are not applicable
  bool compliant = false;           // bodies overlap while in contact; reads stiffness and damping
  bool double_engine = false;       // computes in double even when single precision is asked for
  bool published_jacobian = false;  // its linearization is defined by its source and is not the derivative of its step
  bool chains = false;              // one step can pass an impact on to a disc that the hit disc hits
  bool event_driven = false;        // free flight and impact times are exact, whatever the step
  Rebound rebound = Rebound::kRestitution;
  double restitution_power = 1;  // separates with restitution^power (2 if a package multiplies those of both bodies)
  bool projects = false;         // moves bodies apart that overlap, within a step
  bool averages = false;         // momentum is not conserved when a disc touches several things at once
  bool sequential = false;       // takes the contacts of a step one after the other, so their order matters
  bool compared = false;         // a model of the published comparisons of 2022 and 2023
  double push_gap = 0;           // m, gap > 0 below which bodies repel each other already; 0: at contact only
  bool allocates = false;        // solves with matrices of its own on the heap in steps with contact
  double accuracy = 0;           // relative error that the iterations of a step leave; 0: rounding
  // Whether forces between discs depend on their relative motion only and momentum is conserved, so that derivatives
  // need one pass less. A model that sets this wrongly has a wrong gradient.
  bool relative = false;
  bool spins = false;  // discs without inertia in the scene rotate too, as in the source of the model
  // Whether it reads restitution and friction of each candidate from StepInput::ContactOf(); otherwise it does not
  // support scenes with materials.
  bool by_pair = false;
};

// An option of a model, which users set as in --contact=ncp:kappa=1e-6.
struct ModelOption {
  std::string_view name;
  std::string_view meaning;  // with its unit
  double low, high;          // least and largest value
  bool biases = false;       // with another value than the default, the derivative is a surrogate
};

}  // namespace saltus
