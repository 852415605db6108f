// Surrogate gradients: biased estimates that replace the derivative of the loss. Results that were computed with one
// are reported as biased.
//
//   complementarity_aware   the reverse sweep through each contact group takes, instead of the derivative, that for the
//                           contact modes which the loss would rather have, if it is larger (Werling et al. 2021, as in
//                           NimblePhysics 0.7.2; contact/models/lcp.h). Of models that have it as an option.
//   smoothed_zeroth         an estimate of the gradient of the smoothed loss, from losses alone
//   smoothed_first          the same from the model's own gradients (smoothed_gradient.h)
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {

enum class SurrogateKind { kComplementarityAware, kSmoothedZeroth, kSmoothedFirst };

struct Surrogate {
  SurrogateKind kind = SurrogateKind::kSmoothedZeroth;

  // The members below are options of smoothing, and not used otherwise.
  double sigma = 0.01;     // standard deviation of samples about the point, in the variables' units: m, m/s, N; > 0
  int samples = 2000;      // even, at least 4
  std::uint64_t seed = 1;  // of the first estimate of a run; the k-th after it takes seed + k
  int segments = 0;        // a control is perturbed alike within each of so many parts of the horizon; 0: in each step

  bool smooths() const { return kind != SurrogateKind::kComplementarityAware; }
};

struct SurrogateEntry {
  SurrogateKind kind;
  std::string_view name;     // the value of --surrogate
  std::string_view summary;  // one line
};

const std::vector<SurrogateEntry>& AllSurrogates();
std::string_view SurrogateToString(SurrogateKind kind);

// Returns the error in the numbers of `surrogate` and what was expected; empty if there is none.
std::string Validate(const Surrogate& surrogate);

// Returns why there is no such surrogate of the model's gradient, or no such model; empty if there is.
std::string ReasonNotApplicable(const Surrogate& surrogate, const Contact& contact, const Scene& scene);

// Returns the contact model whose adjoint is the surrogate (kComplementarityAware sets its option), or is smoothed;
// `contact` itself without a surrogate.
Contact ApplySurrogate(const std::optional<Surrogate>& surrogate, const Contact& contact);

}  // namespace saltus
