// Differences by the geometry of a scene: radii, and offsets and angles of walls.
//
// A contact model's step takes these as plain numbers, without Jets. With f_i the value at the node i, a parameter that
// differs by i widths w, the derivative is the difference of fourth order
//
//   (f_-2 - 8 f_-1 + 8 f_1 - f_2) / (12 w),   or on one side   (4 f_1 - 3 f_2 + 4/3 f_3 - 1/4 f_4 - 25/12 f_0) / w
//
// where the contacts on the other side are not the same, as where an impact leaves the step. The step in which a
// contact takes effect is smooth on either side, so that the error is that of rounding, about 1e-10.
#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/scene/scene_parameter.h"

namespace saltus {

// Nodes are numbered from -kGeometryNodes to kGeometryNodes.
inline constexpr int kGeometryNodes = 4;

inline bool IsOfGeometry(SceneParameter::Kind kind) {
  return kind == SceneParameter::Kind::kRadius || kind >= SceneParameter::Kind::kPlaneOffset;
}

// Returns the distance of two nodes, a small fraction of the smallest radius; for an angle the one that moves points of
// the wall near discs by that length.
inline double GeometryWidth(const SceneParameter& parameter, const Scene& scene) {
  using Kind = SceneParameter::Kind;
  constexpr double kWidth = 1e-4;
  double radius = std::numeric_limits<double>::infinity(), lever = 0;
  const bool angle = IsAngle(parameter.kind);
  for (const Body& body : scene.bodies) {
    radius = std::min(radius, body.radius);
    if (!angle) continue;
    const Vec2d about = parameter.kind == Kind::kPlaneAngle
                            ? scene.planes[parameter.body].point
                            : Vec2d(0.5 * (scene.segments[parameter.body].from + scene.segments[parameter.body].to));
    lever = std::max(lever, (body.position - about).norm() + body.radius);
  }
  return kWidth * radius / (angle ? lever : 1.0);
}

// Returns whether the same contacts take effect in two steps.
inline bool HasSameTouches(const std::vector<Touch>& one, const std::vector<Touch>& other) {
  return std::equal(one.begin(), one.end(), other.begin(), other.end(), [](const Touch& a, const Touch& b) {
    return a.candidate == b.candidate && a.mode == b.mode && a.kind == b.kind;
  });
}

// Returns the derivative; std::nullopt if no rule has all of its nodes. `change_at(node)` returns an optional value
// less that at node 0, without a value where the step has other contacts than there.
template <typename ChangeAt>
auto GeometryDifference(double width, const ChangeAt& change_at) -> decltype(change_at(0)) {
  struct Rule {
    std::array<std::pair<int, double>, 4> weights;  // of nodes; 0 for none
  };
  static constexpr Rule kRules[] = {{{{{-2, 1. / 12}, {-1, -8. / 12}, {1, 8. / 12}, {2, -1. / 12}}}},
                                    {{{{1, 4}, {2, -3}, {3, 4. / 3}, {4, -1. / 4}}}},
                                    {{{{-1, -4}, {-2, 3}, {-3, -4. / 3}, {-4, 1. / 4}}}},
                                    {{{{-1, -0.5}, {1, 0.5}, {1, 0}, {1, 0}}}}};
  std::array<std::optional<decltype(change_at(0))>, 2 * kGeometryNodes + 1> found;
  for (const Rule& rule : kRules) {
    decltype(change_at(0)) sum;
    const bool applies = std::all_of(rule.weights.begin(), rule.weights.end(), [&](const auto& weight) {
      auto& change = found[weight.first + kGeometryNodes];
      if (!change) change = change_at(weight.first);
      if (!*change) return false;
      if (sum) {
        *sum += weight.second * **change;
      } else {
        sum = weight.second * **change;
      }
      return true;
    });
    if (!applies) continue;
    *sum *= 1 / width;
    return sum;
  }
  return std::nullopt;
}

}  // namespace saltus
