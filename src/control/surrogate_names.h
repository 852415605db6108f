// Names of contact models and surrogates in tables and files.
#pragma once

#include <optional>
#include <string>

#include "saltus/control/surrogate.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// Whether options of a contact model bias its derivative, which is not known for black boxes.
inline bool IsBiased(const std::string& contact) {
  return FindContactModel(contact) != nullptr && HasBiasedDerivative(contact);
}
// Returns a name such as "smoothed_zeroth, biased".
inline std::string BiasedName(const Surrogate& surrogate) {
  return std::string(SurrogateToString(surrogate.kind)) + ", biased";
}
// Returns "direct", "direct (smoothed_zeroth, biased)", or "ncp:kappa_grad=1e-4 (biased)", whose options bias the
// derivative.
inline std::string LabelOf(const std::string& contact, const std::optional<Surrogate>& surrogate) {
  if (surrogate) return contact + " (" + BiasedName(*surrogate) + ")";
  return contact + (IsBiased(contact) ? " (biased)" : "");
}

}  // namespace saltus
