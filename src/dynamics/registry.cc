#include "saltus/dynamics/registry.h"

#include <glog/logging.h>

#include "dynamics/registry_shard.h"
#include "saltus/contact/models.h"

namespace saltus {
namespace {

using WhyNotFunction = std::string (*)(const Scene&);

template <ContactModel M>
std::string WhyNot(const Scene& scene) {
  if (!M::kTraits.friction && scene.contact.friction > 0) return "this model knows no friction";
  if (scene.steps % M::kTraits.grid_steps != 0) {
    return "this model needs a number of steps divisible by " + std::to_string(M::kTraits.grid_steps);
  }
  if constexpr (requires { M::WhyNot(scene); }) return M::WhyNot(scene);
  return "";
}

template <typename... M>
std::vector<ModelTraits> TraitsOf(const std::tuple<M...>*) {
  return {M::kTraits...};
}
template <typename... M>
std::vector<WhyNotFunction> WhyNotsOf(const std::tuple<M...>*) {
  return {&WhyNot<M>...};
}

int IndexOf(std::string_view name) {
  const ModelTraits* traits = FindContactModel(name);
  CHECK(traits != nullptr) << "unknown contact model " << name;
  return static_cast<int>(traits - AllContactModels().data());
}

template <int kShard = 0>
std::unique_ptr<Simulator> Make(int index, const Scene& scene, Precision precision) {
  if constexpr (kShard + 1 < kNumShards) {
    if (index % kNumShards != kShard) return Make<kShard + 1>(index, scene, precision);
  }
  return MakeInShard<kShard>(index, scene, precision);
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

std::string WhyNotApplicable(std::string_view model, const Scene& scene) {
  static const std::vector<WhyNotFunction>& why_nots =
      *new std::vector<WhyNotFunction>(WhyNotsOf(static_cast<const ContactModels*>(nullptr)));
  return why_nots[IndexOf(model)](scene);
}

std::unique_ptr<Simulator> MakeSimulator(std::string_view model, const Scene& scene, Precision precision) {
  CHECK(WhyNotApplicable(model, scene).empty()) << WhyNotApplicable(model, scene);
  return Make(IndexOf(model), scene, precision);
}

}  // namespace saltus
