// The flags that ask for a surrogate of the gradient, and how every output names one.
#pragma once

#include <optional>
#include <string>

#include "programs/json_output.h"
#include "saltus/control/surrogate.h"

namespace saltus {

// --surrogate and the flags of smoothing; nothing if the model's own gradient is wanted. Throws InputError for an
// unknown name, impossible numbers, and numbers without the surrogate that they are for.
std::optional<Surrogate> SurrogateFromFlags();

// Whether --surrogate=list was given.
bool WantsListOfSurrogates();

// "smoothed_zeroth, biased".
std::string BiasedName(const Surrogate& surrogate);
// "direct", "direct (smoothed_zeroth, biased)", or "ncp:kappa_grad=1e-4 (biased)", whose options bias the derivative.
std::string LabelOf(const std::string& contact, const std::optional<Surrogate>& surrogate);

// What a file of a surrogate's results has in its name: "", or "_smoothed_zeroth_biased".
std::string FileSuffix(const std::optional<Surrogate>& surrogate);

// Adds the keys surrogate, biased and, of a smoothed one, smoothing; none without a surrogate.
void AddSurrogate(const std::optional<Surrogate>& surrogate, Json* item);
// The same, and the key biased of a model whose options bias the derivative.
void AddBias(const std::string& contact, const std::optional<Surrogate>& surrogate, Json* item);

}  // namespace saltus
