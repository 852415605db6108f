#include "control/design_difference.h"

#include <array>
#include <optional>

#include "saltus/scene/scene_parameter.h"

namespace saltus {

std::vector<double> DifferenceByDesign(const Scene& scene, std::vector<double> values, std::size_t i,
                                       const FunctionOfDesign& function) {
  struct Rule {
    std::array<int, 5> nodes;
    std::array<double, 5> weights;
  };
  static constexpr Rule kRules[] = {
      {{-2, -1, 1, 2, 2}, {1. / 12, -8. / 12, 8. / 12, -1. / 12, 0}},
      {{0, 1, 2, 3, 4}, {-25. / 12, 4, -3, 4. / 3, -1. / 4}},
      {{0, -1, -2, -3, -4}, {25. / 12, -4, 3, -4. / 3, 1. / 4}},
  };
  constexpr double kWidth = 3e-4;
  DesignParameter natural = scene.design[i];  // its own bounds do not matter here
  natural.min = natural.max = std::nullopt;
  const ParameterRange range = RangeOf(natural);
  const double at = values[i], width = natural.parameter.kind == SceneParameter::Kind::kMass ? kWidth * at : kWidth;
  for (const Rule& rule : kRules) {
    std::vector<double> sum;
    bool applies = true;
    for (std::size_t j = 0; j < rule.nodes.size() && applies; ++j) {
      if (rule.weights[j] == 0) continue;
      values[i] = at + rule.nodes[j] * width;
      const bool within = values[i] >= range.min && values[i] <= range.max;
      const std::vector<double> value = within ? function(values) : std::vector<double>();
      applies = !value.empty();
      sum.resize(value.size());
      for (std::size_t k = 0; k < value.size(); ++k) sum[k] += rule.weights[j] * value[k];
    }
    for (double& derivative : sum) derivative /= width;
    if (applies) return sum;
  }
  return {};
}

}  // namespace saltus
