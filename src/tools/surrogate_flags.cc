#include "tools/surrogate_flags.h"

#include <gflags/gflags.h>

#include "saltus/dynamics/registry.h"
#include "tools/program.h"

DEFINE_string(surrogate, "",
              "what stands in for the gradient, biased, or 'list' to print what there is (default: the model's own "
              "gradient)");
DEFINE_double(surrogate_sigma, 0.01, "standard deviation of the samples of a smoothed gradient, m, m/s or N");
DEFINE_int32(surrogate_samples, 2000, "of a smoothed gradient, an even number");
DEFINE_uint64(surrogate_seed, 1, "of a smoothed gradient; iteration k takes the k-th after it");
DEFINE_int32(surrogate_segments, 0,
             "equal parts of the horizon in which the samples hold their change of the control (default: every step "
             "has its own)");

namespace saltus {
namespace {

constexpr const char* kSmoothingFlags[] = {
    "surrogate_sigma", "surrogate_samples", "surrogate_seed", "surrogate_segments"};

std::string Names() {
  std::string names;
  for (const SurrogateEntry& entry : AllSurrogates()) names += (names.empty() ? "" : ", ") + std::string(entry.name);
  return names;
}

SurrogateKind KindFromFlag() {
  for (const SurrogateEntry& entry : AllSurrogates()) {
    if (entry.name == FLAGS_surrogate) return entry.kind;
  }
  throw InputError("--surrogate=" + FLAGS_surrogate + " is unknown; expected one of " + Names());
}

void RefuseSmoothingFlags() {
  for (const char* flag : kSmoothingFlags) {
    if (gflags::GetCommandLineFlagInfoOrDie(flag).is_default) continue;
    throw InputError("--" + std::string(flag) + " needs --surrogate=smoothed_zeroth or --surrogate=smoothed_first");
  }
}

}  // namespace

std::optional<Surrogate> SurrogateFromFlags() {
  if (FLAGS_surrogate.empty()) {
    RefuseSmoothingFlags();
    return std::nullopt;
  }
  Surrogate surrogate{.kind = KindFromFlag()};
  if (!surrogate.smooths()) {
    RefuseSmoothingFlags();
    return surrogate;
  }
  surrogate.sigma = FLAGS_surrogate_sigma;
  surrogate.samples = FLAGS_surrogate_samples;
  surrogate.seed = FLAGS_surrogate_seed;
  surrogate.segments = FLAGS_surrogate_segments;
  if (const std::string why = WhyNotValid(surrogate); !why.empty()) throw InputError("--surrogate_" + why);
  return surrogate;
}

bool WantsListOfSurrogates() { return FLAGS_surrogate == "list"; }

std::string BiasedName(const Surrogate& surrogate) {
  return std::string(SurrogateToString(surrogate.kind)) + ", biased";
}

// Of a black box nothing is known.
static bool IsBiased(const std::string& contact) {
  return FindContactModel(contact) != nullptr && HasBiasedDerivative(contact);
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
