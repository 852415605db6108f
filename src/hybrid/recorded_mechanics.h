// Mechanical systems whose functions were recorded once as expression graphs, by a language that is not C++.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hybrid/recorded_functions.h"
#include "saltus/internal/mechanical_functions.h"

namespace saltus {

// The functions of saltus/hybrid/mechanical_system.h. The inputs of the force are [q v t p u], of restitution and
// friction p, and of all others [q p].
struct MechanicalRecording {
  struct Contact {
    ExpressionGraph gap, restitution, friction;
    // A tangential coordinate or the row itself, at most one of them; without both there is no friction.
    std::optional<ExpressionGraph> slide, slide_row;
    std::optional<ExpressionGraph> reach, distance;
  };
  ExpressionGraph mass, force;
  std::vector<Contact> contacts;
};

// Checks a recording: "mass: found x, expected y", empty if it is valid. A mass or a force that decides by a number
// that depends on q, v or t is refused: where it is not smooth, the simulation locates no event.
std::string Validate(const MechanicalLayout& layout, const MechanicalRecording& recording);

// Precondition: Validate() returns an empty text. Which contacts have friction and a reach is read from the recording.
std::shared_ptr<const MechanicalFunctions> MakeMechanicalFunctions(MechanicalLayout layout,
                                                                   const MechanicalRecording& recording);

}  // namespace saltus
