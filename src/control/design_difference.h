// Finite differences by the design parameters of a scene.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// A vector as a function of the values of Scene::design; empty where it is not defined.
using FunctionOfDesign = std::function<std::vector<double>(const std::vector<double>& values)>;
// Returns its derivative by the i-th value at `values`, by differences of fourth order: central, or one-sided where it
// has no value on one side; empty if it has none on either. Precondition: the scene is in natural units.
std::vector<double> DifferenceByDesign(const Scene& scene, std::vector<double> values, std::size_t i,
                                       const FunctionOfDesign& function);

}  // namespace saltus
