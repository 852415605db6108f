// Feedback about a motion, of a problem of a hybrid system or of a scene.
#pragma once

#include <pybind11/pybind11.h>

#include <functional>
#include <memory>
#include <string>

#include "saltus/feedback/closed_loop.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus::python {

// The data of a motion that feedback needs.
struct PlannedMotion {
  Plan plan;
  LinearMotion linear;
  std::function<std::string(const TrackingCost&)> what_is_wrong_with;
  std::function<std::unique_ptr<Plant>()> make_plant;
  std::string remark = {};  // why there is no derivative, or only a one-sided one
};

// Returns why a mechanical system has no motion from an input, empty if it has one. Sets the mode of the input if it is
// -1.
std::string ReasonNoStart(const MechanicalSystem& system, HybridInput* input);

// Gains, costs to go and closed loops of the intervals; the events of a regulator in continuous time; the remark.
pybind11::tuple RegulatorToPython(const Regulator& regulator, const std::string& remark);

}  // namespace saltus::python
