// Derivatives of the step of one island by the geometry of the scene: radii, and offsets and angles of walls.
//
// A contact model's step takes these as plain numbers, without Jets. Its derivative by them is a difference of fourth
// order over the steps of the same island in scenes in which one of them is a little different: central, or one-sided
// where the contacts on the other side are not the same, as where an impact leaves the step. The step in which a
// contact takes effect is smooth on either side, so that the error is that of rounding, about 1e-10.
#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "saltus/internal/contact_step.h"
#include "saltus/scene/scene_parameter.h"
#include "simulate/stepper.h"
#include "simulate/typed_scene.h"

namespace saltus {

template <typename S, int kRotation>
class GeometryDerivative {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;

  // Keeps references to `model` and `scene`, which must outlive this object.
  GeometryDerivative(const Model& model, const Scene& given, const TypedScene<S>& scene)
      : model_(model), scene_(scene), gradient_(given.design.size()) {
    for (std::size_t i = 0; i < given.design.size(); ++i) {
      const SceneParameter& parameter = given.design[i].parameter;
      if (!IsOfGeometry(parameter.kind)) continue;
      Varied varied{i, parameter, WidthOf(parameter, given), {}};
      const double value = ValueOf(parameter, given);
      for (int node = -kNodes; node <= kNodes; ++node) {
        Scene near = given;
        SetValue(parameter, value + node * varied.width, &near);
        varied.scenes.push_back(std::make_unique<TypedScene<S>>(near, double(scene.h)));
      }
      all_.push_back(std::move(varied));
    }
  }

  void Clear() { std::fill(gradient_.begin(), gradient_.end(), 0.0); }

  // Adds what the step of the stepper's local scene, the discs `island`, contributes; `after` are the cotangents of
  // their next states.
  void Add(std::span<const int> island, std::span<const S> after, Stepper<S, kRotation>* stepper) {
    if (all_.empty()) return;
    const std::optional<double> here = StepIn(scene_, island, after, stepper, &touches_);
    for (const Varied& varied : all_) {
      if (!Concerns(varied, island, stepper->LocalInput().candidates)) continue;
      gradient_[varied.index] += here ? Difference(varied, *here, island, after, stepper) : kNotANumber;
    }
  }

  // Returns the derivative by Scene::design[i]; NaN if no difference can be taken in some step.
  double By(std::size_t i) const { return gradient_[i]; }

 private:
  // The number of nodes on either side, and their distance as a fraction of the smallest radius.
  static constexpr int kNodes = 4;
  static constexpr double kWidth = 1e-4;
  static constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

  struct Varied {
    std::size_t index;
    SceneParameter parameter;
    double width;
    std::vector<std::unique_ptr<TypedScene<S>>> scenes;  // of nodes -kNodes to kNodes
  };

  static bool IsOfGeometry(SceneParameter::Kind kind) {
    using Kind = SceneParameter::Kind;
    return kind == Kind::kRadius || kind >= Kind::kPlaneOffset;
  }

  // Returns the step of the difference; for an angle the one that moves points of the wall near discs by that length.
  static double WidthOf(const SceneParameter& parameter, const Scene& scene) {
    using Kind = SceneParameter::Kind;
    double radius = std::numeric_limits<double>::infinity(), lever = 0;
    const bool plane = parameter.kind == Kind::kPlaneAngle;
    const bool angle = plane || parameter.kind == Kind::kSegmentAngle;
    for (const Body& body : scene.bodies) {
      radius = std::min(radius, body.radius);
      if (!angle) continue;
      const Vec2d about = plane
                              ? scene.planes[parameter.body].point
                              : Vec2d(0.5 * (scene.segments[parameter.body].from + scene.segments[parameter.body].to));
      lever = std::max(lever, (body.position - about).norm() + body.radius);
    }
    return kWidth * radius / (angle ? lever : 1.0);
  }

  static bool IsSame(const Wall<S>& a, const Wall<S>& b) {
    return a.normal == b.normal && a.offset == b.offset && a.center == b.center && a.radius == b.radius;
  }

  // Whether the step of the island depends on the parameter.
  bool Concerns(const Varied& varied, std::span<const int> island, std::span<const Candidate> candidates) const {
    if (varied.parameter.kind == SceneParameter::Kind::kRadius) {
      return std::find(island.begin(), island.end(), varied.parameter.body) != island.end();
    }
    const std::vector<Wall<S>>& near = varied.scenes.back()->planes;
    return std::ranges::any_of(candidates,
                               [&](const Candidate& c) { return c.plane && !IsSame(near[c.b], scene_.planes[c.b]); });
  }

  // The product of `after` and the next states in a scene that differs in its geometry, with the contacts that took
  // effect; nothing if the step has no result.
  std::optional<double> StepIn(const TypedScene<S>& scene, std::span<const int> island, std::span<const S> after,
                               Stepper<S, kRotation>* stepper, std::vector<Touch>* touches) {
    StepInput<S> in = stepper->LocalInput();
    bodies_.clear();
    for (const int i : island) bodies_.push_back(scene.bodies[i]);
    in.bodies = bodies_;
    in.planes = scene.planes;
    in.extents = scene.extents;
    in.solved = nullptr;
    touches->clear();
    in.touches = touches;
    std::string_view failure;
    in.failure = &failure;
    next_.resize(island.size());
    model_.Step(in, stepper->local_states(), next_);
    stepper->ReleaseScratch();
    if (!failure.empty()) return std::nullopt;
    const S* next = reinterpret_cast<const S*>(next_.data());
    double product = 0;
    for (std::size_t i = 0; i < after.size(); ++i) product += double(after[i]) * double(next[i]);
    return product;
  }

  bool HasSameTouches() const {
    return std::equal(near_.begin(), near_.end(), touches_.begin(), touches_.end(), [](const Touch& a, const Touch& b) {
      return a.candidate == b.candidate && a.mode == b.mode && a.kind == b.kind;
    });
  }

  double Difference(const Varied& varied, double here, std::span<const int> island, std::span<const S> after,
                    Stepper<S, kRotation>* stepper) {
    // Values are relative to `here`, so that what does not change is not rounded; nullopt where contacts differ.
    std::array<std::optional<std::optional<double>>, 2 * kNodes + 1> found;
    const auto change = [&](int node) -> std::optional<double> {
      auto& value = found[node + kNodes];
      if (!value) {
        value = StepIn(*varied.scenes[node + kNodes], island, after, stepper, &near_);
        if (*value) **value -= here;
        if (!HasSameTouches()) value->reset();
      }
      return *value;
    };
    struct Rule {
      std::array<std::pair<int, double>, 4> weights;  // of nodes; 0 for none
    };
    static constexpr Rule kRules[] = {{{{{-2, 1. / 12}, {-1, -8. / 12}, {1, 8. / 12}, {2, -1. / 12}}}},
                                      {{{{1, 4}, {2, -3}, {3, 4. / 3}, {4, -1. / 4}}}},
                                      {{{{-1, -4}, {-2, 3}, {-3, -4. / 3}, {-4, 1. / 4}}}},
                                      {{{{-1, -0.5}, {1, 0.5}, {1, 0}, {1, 0}}}}};
    for (const Rule& rule : kRules) {
      double sum = 0;
      const bool applies = std::all_of(rule.weights.begin(), rule.weights.end(), [&](const auto& weight) {
        const std::optional<double> value = change(weight.first);
        if (value) sum += weight.second * *value;
        return value.has_value();
      });
      if (applies) return sum / varied.width;
    }
    return kNotANumber;
  }

  const Model& model_;
  const TypedScene<S>& scene_;
  std::vector<Varied> all_;
  std::vector<double> gradient_;  // of the parameters of geometry; 0 for the others
  std::vector<BodyConstants<S>> bodies_;
  std::vector<State> next_;
  std::vector<Touch> touches_, near_;
};

}  // namespace saltus
