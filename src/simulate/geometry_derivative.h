// Derivatives of the step of one island by the geometry of the scene, by differences over the steps of the same island
// in scenes in which one parameter is a little different (geometry_difference.h).
#pragma once

#include <algorithm>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "saltus/internal/contact_step.h"
#include "saltus/scene/scene_parameter.h"
#include "simulate/geometry_difference.h"
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
      Varied varied{i, parameter, GeometryWidth(parameter, given), {}};
      const double value = ValueOf(parameter, given);
      for (int node = -kGeometryNodes; node <= kGeometryNodes; ++node) {
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
  double DesignDerivative(std::size_t i) const { return gradient_[i]; }

 private:
  static constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

  struct Varied {
    std::size_t index;
    SceneParameter parameter;
    double width;
    std::vector<std::unique_ptr<TypedScene<S>>> scenes;  // of nodes -kGeometryNodes to kGeometryNodes
  };

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

  double Difference(const Varied& varied, double here, std::span<const int> island, std::span<const S> after,
                    Stepper<S, kRotation>* stepper) {
    // Values are relative to `here`, so that what does not change is not rounded.
    const auto change_at = [&](int node) {
      std::optional<double> value = StepIn(*varied.scenes[node + kGeometryNodes], island, after, stepper, &near_);
      if (value) *value -= here;
      if (!HasSameTouches(near_, touches_)) value.reset();
      return value;
    };
    return GeometryDifference(varied.width, change_at).value_or(kNotANumber);
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
