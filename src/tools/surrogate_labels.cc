// How every output names a surrogate: apart from the flags, which the Python module has not.
#include "saltus/dynamics/registry.h"
#include "tools/surrogate_flags.h"

namespace saltus {

std::string BiasedName(const Surrogate& surrogate) {
  return std::string(SurrogateToString(surrogate.kind)) + ", biased";
}

std::string LabelOf(const std::string& contact, const std::optional<Surrogate>& surrogate) {
  if (surrogate) return contact + " (" + BiasedName(*surrogate) + ")";
  return contact + (HasBiasedDerivative(contact) ? " (biased)" : "");
}

std::string FileSuffix(const std::optional<Surrogate>& surrogate) {
  return surrogate ? "_" + std::string(SurrogateToString(surrogate->kind)) + "_biased" : "";
}

void AddSurrogate(const std::optional<Surrogate>& surrogate, Json* item) {
  if (!surrogate) return;
  (*item)["surrogate"] = SurrogateToString(surrogate->kind);
  (*item)["biased"] = true;
  if (!surrogate->smooths()) return;
  (*item)["smoothing"] = {{"sigma", surrogate->sigma},
                          {"samples", surrogate->samples},
                          {"seed", surrogate->seed},
                          {"segments", surrogate->segments}};
}

void AddBias(const std::string& contact, const std::optional<Surrogate>& surrogate, Json* item) {
  AddSurrogate(surrogate, item);
  if (HasBiasedDerivative(contact)) (*item)["biased"] = true;
}

}  // namespace saltus
