// The registry of contact models: makes a simulator from a model's name, or from a user's own model.
#pragma once

#include <concepts>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

struct ListedOption : ModelOption {
  double initial;  // its value unless it is set
  bool whole;      // only whole numbers make sense
};
struct OptionValue {
  std::string_view name;
  double value;
};

// A contact model with its traits.
struct ContactEntry {
  ModelTraits traits;
  std::vector<ListedOption> options;
  std::function<std::string(const Scene&)> why_not_applicable;  // empty if it can take the scene
  // Precondition: it can take the scene, and the options are known.
  std::function<std::unique_ptr<Simulator>(const Scene&, Precision, std::span<const OptionValue>)> make;
};

// Which contact model, with which options: wherever one is asked for, its name will do. Options of its own may follow,
// in any order: "ncp:kappa=1e-6:kappa_grad=1e-4". One that no registry lists is made by OwnContact() (own_contact.h).
class Contact {
 public:
  Contact() = default;  // of no name
  template <std::convertible_to<std::string_view> Name>
  Contact(const Name& name) : name_(std::string_view(name)) {}
  explicit Contact(std::shared_ptr<const ContactEntry> own) : own_(std::move(own)), name_(own_->traits.name) {}

  // The name of the model, and the options that were set.
  const std::string& name() const { return name_; }
  // Returns this contact model with one more option, such as "kappa=1e-6".
  Contact With(std::string_view option) const;
  // Null if there is no model of that name.
  const ContactEntry* entry() const;

 private:
  std::shared_ptr<const ContactEntry> own_;  // null: that of the registry
  std::string name_;
};

// Traits of all models of the registry, in the order of src/contact/models.cmake.
const std::vector<ModelTraits>& AllContactModels();

// The traits of a model, or null if there is none. Its options are not looked at.
const ModelTraits* FindContactModel(const Contact& contact);

// The options of a model. Precondition: there is one.
const std::vector<ListedOption>& OptionsOf(const Contact& contact);

// Returns the error in a contact model's name or options, as "found 'x', expected y"; empty if there is none.
std::string WhatIsWrongWith(const Contact& contact);

// Whether options are set that bias the derivative. Precondition: nothing is wrong with the name.
bool HasBiasedDerivative(const Contact& contact);

// Why a model cannot simulate `scene`: there is no such model (WhatIsWrongWith), the scene is wrong
// (ValidateStructure), or the model's own reason. Empty if it can.
std::string WhyNotApplicable(const Contact& contact, const Scene& scene);

// Takes and gives numbers in the scene's units, whatever those the model works in (scene/units.h).
// Precondition: WhyNotApplicable is empty.
std::unique_ptr<Simulator> MakeSimulator(const Contact& contact, const Scene& scene, Precision precision);

}  // namespace saltus
