#include "saltus/control/surrogate.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr std::string_view kOption = "complementarity_aware";  // of contact models

bool HasOption(const Contact& contact) {
  const std::vector<ListedOption>& options = OptionsOf(contact);
  return std::any_of(options.begin(), options.end(), [](const ListedOption& option) { return option.name == kOption; });
}

}  // namespace

const std::vector<SurrogateEntry>& AllSurrogates() {
  static const std::vector<SurrogateEntry>& surrogates = *new std::vector<SurrogateEntry>{
      {SurrogateKind::kComplementarityAware,
       "complementarity_aware",
       "adjoint with the contact modes that leave a larger gradient"},
      {SurrogateKind::kSmoothedZeroth, "smoothed_zeroth", "gradient of the randomly smoothed loss, from losses alone"},
      {SurrogateKind::kSmoothedFirst,
       "smoothed_first",
       "gradient of the randomly smoothed loss, from gradients of the model"},
  };
  return surrogates;
}

std::string_view SurrogateToString(SurrogateKind kind) {
  for (const SurrogateEntry& entry : AllSurrogates()) {
    if (entry.kind == kind) return entry.name;
  }
  LOG(FATAL) << "no such surrogate";
}

std::string Validate(const Surrogate& surrogate) {
  if (!(surrogate.sigma > 0) || !std::isfinite(surrogate.sigma)) return "sigma must be a positive number";
  if (surrogate.samples < 4 || surrogate.samples % 2 != 0) return "samples must be an even number of at least 4";
  if (surrogate.segments < 0) return "segments must not be negative";
  return "";
}

std::string ReasonNotApplicable(const Surrogate& surrogate, const Contact& contact, const Scene& scene) {
  if (std::string wrong = Validate(contact); !wrong.empty()) return wrong;
  if (!surrogate.smooths()) return HasOption(contact) ? "" : "this model has no complementarity-aware gradient";
  const int intervals = scene.steps / CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  if (!scene.control.bodies.empty() && surrogate.segments > intervals) {
    return "there are more segments than the " + std::to_string(intervals) + " intervals of the control";
  }
  return "";
}

Contact ApplySurrogate(const std::optional<Surrogate>& surrogate, const Contact& contact) {
  const bool needs_option = surrogate && !surrogate->smooths();
  return needs_option ? contact.WithOption(std::string(kOption) + "=1") : contact;
}

}  // namespace saltus
