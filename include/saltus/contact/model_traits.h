// Traits of a contact model, and the numbers of its own that users may set.
#pragma once

#include <string_view>

namespace saltus {

// How fast bodies separate after an impact.
enum class Rebound {
  kRestitution,  // closing speed * restitution^restitution_power
  kElasticOnly,  // so with restitution 1; more slowly than stated with less
  kEmergent,     // what the law of force or the correction of overlaps makes of it
  kPlastic,      // not at all: restitution is not read
};

// Traits of a model. Tests, the audit and the programs take their exceptions from here, never from its name.
struct ModelTraits {
  std::string_view name;            // the value of --contact
  std::string_view summary;         // one line
  std::string_view source;          // paper or package, and section
  int grid_steps = 1;               // steps of the scene's time grid that one step of the model covers
  bool friction = true;             // knows friction; without, a scene with friction > 0 is not applicable
  bool compliant = false;           // bodies overlap while in contact; reads stiffness and damping
  bool double_engine = false;       // computes in double even when single precision is asked for
  bool published_jacobian = false;  // its linearization is defined by its source and is not the derivative of its step
  bool chains = false;              // one step can pass an impact on to a disc that the hit disc hits
  bool event_driven = false;        // free flight and impact times are exact, whatever the step
  Rebound rebound = Rebound::kRestitution;
  double restitution_power = 1;  // separates with restitution^power (2 where a package multiplies both bodies')
  bool projects = false;         // moves bodies apart that overlap, within a step
  bool averages = false;         // momentum is not conserved when a disc touches several things at once
  bool sequential = false;       // takes the contacts of a step one after the other, so their order matters
  bool compared = false;         // one of those that the published comparisons (2022, 2023) report
  double push_gap = 0;           // m, gap from which on bodies push each other
  bool allocates = false;        // solves with matrices of its own on the heap in steps with contact
  double accuracy = 0;           // relative error that the iterations of a step leave; 0: rounding
  // Forces between discs depend on their relative motion only, and momentum is conserved: spares their
  // derivatives a pass. A model that claims it and is not so gets a wrong gradient.
  bool relative = false;
  bool spins = false;  // discs turn by its source, whatever the scene says of their inertia, and friction turns them
  // Takes restitution and friction of each candidate from StepInput::ContactOf(); without, a scene with materials is
  // not applicable.
  bool by_pair = false;
};

// A number of a model's own that users may set, as in --contact=ncp:kappa=1e-6.
struct ModelOption {
  std::string_view name;
  std::string_view meaning;  // with its unit
  double low, high;          // least and largest value
  bool biases = false;       // if set to another than its default, the derivative is not meant to be that of the step
};

}  // namespace saltus
