// From the name of a contact model to a simulator.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/dynamics/simulator.h"

namespace saltus {

// Traits of all models, in the order of src/contact/models.cmake.
const std::vector<ModelTraits>& AllContactModels();

// The traits of the model of that name, or null.
const ModelTraits* FindContactModel(std::string_view name);

// Why `model` cannot simulate `scene`; empty if it can. Precondition: the name is known.
std::string WhyNotApplicable(std::string_view model, const Scene& scene);

// Preconditions: the name is known, the scene is valid, and WhyNotApplicable is empty.
std::unique_ptr<Simulator> MakeSimulator(std::string_view model, const Scene& scene, Precision precision);

}  // namespace saltus
