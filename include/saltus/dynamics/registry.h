// From the name of a contact model to a simulator.
//
// Wherever a contact model is named, options of its own may follow, in any order: "ncp:kappa=1e-6:kappa_grad=1e-4".
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/dynamics/simulator.h"

namespace saltus {

// Traits of all models, in the order of src/contact/models.cmake.
const std::vector<ModelTraits>& AllContactModels();

// The traits of the model of that name, or null. Its options are not looked at.
const ModelTraits* FindContactModel(std::string_view name);

struct ListedOption : ModelOption {
  double initial;  // its value unless it is set
  bool whole;      // only whole numbers make sense
};
// The options of a model. Precondition: the name is known.
const std::vector<ListedOption>& OptionsOf(std::string_view model);

// What is wrong with a contact model's name and options, as "found 'x', expected y"; empty if nothing is.
std::string WhatIsWrongWith(std::string_view model);

// Whether options are set that bias the derivative. Precondition: nothing is wrong with the name.
bool HasBiasedDerivative(std::string_view model);

// Why `model` cannot simulate `scene`: there is no such model (WhatIsWrongWith), the scene is wrong
// (ValidateStructure), or the model's own reason. Empty if it can.
std::string WhyNotApplicable(std::string_view model, const Scene& scene);

// Takes and gives numbers in the scene's units, whatever those the model works in (physics/units.h).
// Precondition: WhyNotApplicable is empty.
std::unique_ptr<Simulator> MakeSimulator(std::string_view model, const Scene& scene, Precision precision);

}  // namespace saltus
