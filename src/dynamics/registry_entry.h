// What the registry knows of one contact model. Every model is instantiated in a translation unit of its own, generated
// from registry_entry.cc.in for each line of contact/models.cmake.
#pragma once

#include <memory>
#include <string>

#include "saltus/dynamics/model_simulator.h"

namespace saltus {

struct RegistryEntry {
  ModelTraits traits;
  std::string (*why_not_applicable)(const Scene&);
  std::unique_ptr<Simulator> (*make)(const Scene&, Precision);
};

// The entry of line kIndex of contact/models.cmake.
template <int kIndex>
RegistryEntry EntryOf();

template <ContactModel M>
std::string WhyModelNotApplicable(const Scene& scene) {
  if (!M::kTraits.friction && scene.contact.friction > 0) return "this model knows no friction";
  if (scene.steps % M::kTraits.grid_steps != 0) {
    return "this model needs a number of steps divisible by " + std::to_string(M::kTraits.grid_steps);
  }
  if constexpr (requires { M::WhyNot(scene); }) return M::WhyNot(scene);
  return "";
}

template <ContactModel M>
std::unique_ptr<Simulator> MakeModelSimulator(const Scene& scene, Precision precision) {
  if constexpr (!M::kTraits.double_engine) {
    if (precision == Precision::kFloat) return std::make_unique<ModelSimulator<M, float>>(scene, precision);
  }
  return std::make_unique<ModelSimulator<M, double>>(scene, precision);
}

template <ContactModel M>
RegistryEntry MakeEntry() {
  return {M::kTraits, &WhyModelNotApplicable<M>, &MakeModelSimulator<M>};
}

}  // namespace saltus
