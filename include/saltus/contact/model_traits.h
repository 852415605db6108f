// Traits and options of contact models.
#pragma once

#include <string_view>

namespace saltus {

// How fast bodies separate after an impact.
enum class Rebound {
  kRestitution,  // closing speed * restitution^restitution_power
  kElasticOnly,  // closing speed with restitution 1; with less, more slowly than the restitution states
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
  bool compared = false;         // the published comparisons (2022, 2023) report it
  double push_gap = 0;           // m, gap below which bodies repel each other
  bool allocates = false;        // solves with matrices of its own on the heap in steps with contact
  double accuracy = 0;           // relative error that the iterations of a step leave; 0: rounding
  // Forces between discs depend on their relative motion only, and momentum is conserved, so that derivatives need a
  // pass less. A model that sets this wrongly has a wrong gradient.
  bool relative = false;
  bool spins = false;  // discs rotate, as in the source of the model, without inertia in the scene too
  // Reads restitution and friction of each candidate from StepInput::ContactOf(); otherwise scenes with materials are
  // not applicable.
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
