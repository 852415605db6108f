#include "saltus/dynamics/registry.h"

#include <glog/logging.h>

#include "saltus/contact/models.h"
#include "saltus/dynamics/model_simulator.h"

namespace saltus {
namespace {

struct Entry {
  std::string (*why_not)(const Scene&);
  std::unique_ptr<Simulator> (*make)(const Scene&, Precision);
};

template <ContactModel M>
std::string WhyNot(const Scene& scene) {
  if (!M::kTraits.friction && scene.contact.friction > 0) return "this model knows no friction";
  if (scene.steps % M::kTraits.grid_steps != 0) {
    return "this model needs a number of steps divisible by " + std::to_string(M::kTraits.grid_steps);
  }
  if constexpr (requires { M::WhyNot(scene); }) return M::WhyNot(scene);
  return "";
}

template <ContactModel M>
std::unique_ptr<Simulator> Make(const Scene& scene, Precision precision) {
  if (precision == Precision::kDouble || M::kTraits.double_engine) {
    return std::make_unique<ModelSimulator<M, double>>(scene, precision);
  }
  if constexpr (!M::kTraits.double_engine) return std::make_unique<ModelSimulator<M, float>>(scene, precision);
  return nullptr;
}

template <typename... M>
std::vector<ModelTraits> TraitsOf(const std::tuple<M...>*) {
  return {M::kTraits...};
}
template <typename... M>
std::vector<Entry> EntriesOf(const std::tuple<M...>*) {
  return {{&WhyNot<M>, &Make<M>}...};
}

const Entry& EntryOf(std::string_view name) {
  static const std::vector<Entry>& entries =
      *new std::vector<Entry>(EntriesOf(static_cast<const ContactModels*>(nullptr)));
  const ModelTraits* traits = FindContactModel(name);
  CHECK(traits != nullptr) << "unknown contact model " << name;
  return entries[traits - AllContactModels().data()];
}

}  // namespace

const std::vector<ModelTraits>& AllContactModels() {
  static const std::vector<ModelTraits>& traits =
      *new std::vector<ModelTraits>(TraitsOf(static_cast<const ContactModels*>(nullptr)));
  return traits;
}

const ModelTraits* FindContactModel(std::string_view name) {
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.name == name) return &traits;
  }
  return nullptr;
}

std::string WhyNotApplicable(std::string_view model, const Scene& scene) { return EntryOf(model).why_not(scene); }

std::unique_ptr<Simulator> MakeSimulator(std::string_view model, const Scene& scene, Precision precision) {
  CHECK(WhyNotApplicable(model, scene).empty()) << WhyNotApplicable(model, scene);
  return EntryOf(model).make(scene, precision);
}

}  // namespace saltus
