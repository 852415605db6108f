#include "programs/surrogate_flags.h"

#include <gflags/gflags.h>

#include "programs/program.h"

DEFINE_string(surrogate, "",
              "biased estimate that replaces the gradient, or 'list' to print the names (default: the model's own "
              "gradient)");
DEFINE_double(surrogate_sigma, 0.01, "standard deviation of the samples, m, m/s or N");
DEFINE_int32(surrogate_samples, 2000, "number of samples of a smoothed gradient, even");
DEFINE_uint64(surrogate_seed, 1, "seed of a smoothed gradient; iteration k uses the k-th seed after it");
DEFINE_int32(surrogate_segments, 0,
             "number of equal parts of the horizon over which a sample changes the control by a constant (default: "
             "steps)");

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

}  // namespace saltus
