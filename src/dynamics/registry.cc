#include "saltus/dynamics/registry.h"

#include <glog/logging.h>

#include <utility>

#include "dynamics/registry_entry.h"

namespace saltus {
namespace {

template <int... kIndex>
std::vector<RegistryEntry> CollectEntries(std::integer_sequence<int, kIndex...>) {
  return {EntryOf<kIndex>()...};
}

const std::vector<RegistryEntry>& Entries() {
  static const std::vector<RegistryEntry>& entries =
      *new std::vector<RegistryEntry>(CollectEntries(std::make_integer_sequence<int, SALTUS_NUM_MODELS>()));
  return entries;
}

const RegistryEntry& Entry(std::string_view name) {
  for (const RegistryEntry& entry : Entries()) {
    if (entry.traits.name == name) return entry;
  }
  LOG(FATAL) << "unknown contact model " << name;
}

std::vector<ModelTraits> CollectTraits() {
  std::vector<ModelTraits> traits;
  for (const RegistryEntry& entry : Entries()) traits.push_back(entry.traits);
  return traits;
}

}  // namespace

const std::vector<ModelTraits>& AllContactModels() {
  static const std::vector<ModelTraits>& traits = *new std::vector<ModelTraits>(CollectTraits());
  return traits;
}

const ModelTraits* FindContactModel(std::string_view name) {
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.name == name) return &traits;
  }
  return nullptr;
}

std::string WhyNotApplicable(std::string_view model, const Scene& scene) {
  return Entry(model).why_not_applicable(scene);
}

std::unique_ptr<Simulator> MakeSimulator(std::string_view model, const Scene& scene, Precision precision) {
  const RegistryEntry& entry = Entry(model);
  CHECK(entry.why_not_applicable(scene).empty()) << entry.why_not_applicable(scene);
  return entry.make(scene, precision);
}

}  // namespace saltus
