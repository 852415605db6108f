// How every output names a surrogate: apart from the flags, which the Python module has not.
#include "programs/surrogate_flags.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

// Of a black box nothing is known.
bool IsBiased(const std::string& contact) {
  return FindContactModel(contact) != nullptr && HasBiasedDerivative(contact);
}

}  // namespace

std::string BiasedName(const Surrogate& surrogate) {
  return std::string(SurrogateToString(surrogate.kind)) + ", biased";
}

std::string LabelOf(const std::string& contact, const std::optional<Surrogate>& surrogate) {
  if (surrogate) return contact + " (" + BiasedName(*surrogate) + ")";
  return contact + (IsBiased(contact) ? " (biased)" : "");
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
  if (IsBiased(contact)) (*item)["biased"] = true;
}

}  // namespace saltus
