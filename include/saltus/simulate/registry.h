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
  double initial;  // the default
  bool whole;      // whether it must be a whole number
};
// A value that is set for an option. `name` must outlive it.
struct OptionValue {
  std::string_view name;
  double value;
};

// A contact model with its traits.
struct ContactEntry {
  ModelTraits traits;
  std::vector<ListedOption> options;
  std::function<std::string(const Scene&)> reason_not_applicable;  // returns "" if the model supports the scene
  // Makes a simulator. Preconditions: the model supports the scene, and it has these options.
  std::function<std::unique_ptr<Simulator>(const Scene&, Precision, std::span<const OptionValue>)> make;
};

// A contact model with its options. It is made from a name, such as "event", with options in any order:
// "ncp:kappa=1e-6:kappa_grad=1e-4". UserContact() (user_contact.h) makes one of a model that is not in the registry.
class Contact {
 public:
  Contact() = default;  // has no name and no model: ReasonNotApplicable() reports it
  // Takes a name with options, which is copied and not checked: Validate() does that.
  template <std::convertible_to<std::string_view> Name>
  Contact(const Name& name) : name_(std::string_view(name)) {}
  explicit Contact(std::shared_ptr<const ContactEntry> own) : own_(std::move(own)), name_(own_->traits.name) {}

  // Returns the name of the model with the options that were set.
  const std::string& name() const { return name_; }
  // Returns this contact model with one more option, such as "kappa=1e-6".
  Contact WithOption(std::string_view option) const;
  // Returns the model; null if the registry has none of that name. An own model lives as long as a copy of the Contact.
  const ContactEntry* entry() const;

 private:
  std::shared_ptr<const ContactEntry> own_;  // null: the model is in the registry
  std::string name_;
};

// Returns the traits of all models of the registry, in the order of src/contact/models.cmake.
const std::vector<ModelTraits>& AllContactModels();

// Returns the traits of a model, or null if there is none; valid as Contact::entry() is. Options are not checked.
const ModelTraits* FindContactModel(const Contact& contact);

// Returns the options of a model. Precondition: the model exists.
const std::vector<ListedOption>& OptionsOf(const Contact& contact);

// Returns the error in a contact model's name or options, as "found 'x', expected y"; empty if there is none.
std::string Validate(const Contact& contact);

// Returns whether an option that biases the derivative has another value than its default. Precondition:
// Validate(contact) is empty.
bool HasBiasedDerivative(const Contact& contact);

// Returns why a model cannot simulate `scene`: there is no such model (Validate), the scene is wrong
// (ValidateStructure), or the model's own reason. Empty if it can.
std::string ReasonNotApplicable(const Contact& contact, const Scene& scene);

// Makes a simulator, which copies the scene. Its numbers are in the scene's units, whatever units the model computes in
// (scene/units.h). Precondition: ReasonNotApplicable(contact, scene) is empty.
std::unique_ptr<Simulator> MakeSimulator(const Contact& contact, const Scene& scene, Precision precision);

}  // namespace saltus
