// User-defined contact models, for every function that takes a Contact.
//
//   #include "my_model.h"
//   saltus::Solve("gd", {.scene = scene, .contact = saltus::UserContact<MyModel>()}, {});
//
// contact/contact_model.h lists the members of a model.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "saltus/internal/contact_step.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace internal {

template <ContactModel M>
std::string ReasonModelNotApplicable(const Scene& scene) {
  if (!M::kTraits.friction && HasFriction(scene)) return "this model knows no friction";
  if (!M::kTraits.by_pair && !scene.materials.empty()) {
    return "the scene has materials: this model has one restitution and one friction for all contacts";
  }
  if (scene.steps % M::kTraits.grid_steps != 0) {
    return "this model needs a number of steps divisible by " + std::to_string(M::kTraits.grid_steps);
  }
  if (!M::kTraits.event_driven && scene.table) {
    return "discs slide on a table: this model has no friction with what they lie on";
  }
  if (!M::kTraits.event_driven && !scene.pockets.empty()) {
    return "discs fall into pockets: this model has no time at which they do";
  }
  if (scene.Spins()) {
    if constexpr (requires { typename M::Spinning; }) return ReasonModelNotApplicable<typename M::Spinning>(scene);
    if constexpr (M::kRotation != kSpin) return "discs that spin: this model does not turn them";
  }
  if constexpr (requires { M::ReasonNotApplicable(scene); }) return M::ReasonNotApplicable(scene);
  return "";
}

// Calls visit(option, member) for each option of the model, if it has any.
template <ContactModel M, typename Visit>
void VisitOptionsOf(M* model, const Visit& visit) {
  if constexpr (requires { model->VisitOptions(visit); }) model->VisitOptions(visit);
}

template <ContactModel M>
std::vector<ListedOption> ListOptions() {
  std::vector<ListedOption> options;
  M model;
  VisitOptionsOf(&model, [&](const ModelOption& option, const auto& member) {
    options.push_back({option, static_cast<double>(member), !std::is_floating_point_v<std::decay_t<decltype(member)>>});
  });
  return options;
}

template <ContactModel M>
M WithOptions(M model, std::span<const OptionValue> values) {
  VisitOptionsOf(&model, [&](const ModelOption& option, auto& member) {
    for (const OptionValue& set : values) {
      if (set.name == option.name) member = static_cast<std::decay_t<decltype(member)>>(set.value);
    }
  });
  return model;
}

template <ContactModel M>
std::unique_ptr<Simulator> MakeSimulatorWithOptions(const Scene& scene, Precision precision,
                                                    std::span<const OptionValue> options, const M& without = {}) {
  if constexpr (requires { typename M::Spinning; }) {
    if (scene.Spins()) return MakeSimulatorWithOptions<typename M::Spinning>(scene, precision, options);
  }
  const M model = WithOptions(without, options);
  if constexpr (!M::kTraits.double_engine) {
    if (precision == Precision::kFloat) return MakeModelSimulator<M, float>(scene, precision, model);
  }
  return MakeModelSimulator<M, double>(scene, precision, model);
}

}  // namespace internal

template <ContactModel M>
ContactEntry MakeContactEntry() {
  return {M::kTraits,
          internal::ListOptions<M>(),
          &internal::ReasonModelNotApplicable<M>,
          [](const Scene& scene, Precision precision, std::span<const OptionValue> options) {
            return internal::MakeSimulatorWithOptions<M>(scene, precision, options);
          }};
}

// Makes a contact of a model with the defaults of its options; Contact::WithOption() sets them. The registry may have
// another model of the same name.
template <ContactModel M>
Contact UserContact() {
  static const auto entry = std::make_shared<const ContactEntry>(MakeContactEntry<M>());
  return Contact(entry);
}
// Makes a contact of a model with the current values of its members. In scenes with discs that spin, M::Spinning is
// used with the defaults of its members.
template <ContactModel M>
Contact UserContact(M model) {
  ContactEntry entry = MakeContactEntry<M>();
  entry.make = [model = std::move(model)](
                   const Scene& scene, Precision precision, std::span<const OptionValue> options) {
    return internal::MakeSimulatorWithOptions<M>(scene, precision, options, model);
  };
  return Contact(std::make_shared<const ContactEntry>(std::move(entry)));
}

}  // namespace saltus
