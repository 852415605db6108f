#include "saltus/contact/event_functions.h"

#include <ceres/cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>

#include <algorithm>
#include <cmath>

#include "saltus/scene/geometry.h"
#include "scene/units.h"

namespace saltus {
namespace {

constexpr int kOfDisc = 5;        // position, velocity, radius
constexpr int kAffine = 7;        // parameters of a plane
constexpr double kInside = 1e-3;  // how near to its bounds a restitution may begin
constexpr double kLeastFriction = 1e-3;

template <typename Function>
std::shared_ptr<const ceres::CostFunction> Differentiable(const Function& function, int residuals, int parameters) {
  auto cost = std::make_shared<ceres::DynamicAutoDiffCostFunction<Function, 6>>(new Function(function));
  cost->AddParameterBlock(kOfDisc);
  cost->AddParameterBlock(parameters);
  cost->SetNumResiduals(residuals);
  return cost;
}

struct AffineGap {
  int first;  // of the plane's parameters
  template <typename T>
  bool operator()(T const* const* blocks, T* gap) const {
    const T *disc = blocks[0], *w = blocks[1] + first;
    gap[0] = (w[0] * disc[0] + w[1] * disc[1]) / sqrt(w[0] * w[0] + w[1] * w[1]) - w[2] - disc[4];
    return true;
  }
};

struct LinearUpdate {
  int first;
  template <typename T>
  bool operator()(T const* const* blocks, T* after) const {
    const T *v = blocks[0] + 2, *a = blocks[1] + first + 3;
    after[0] = a[0] * v[0] + a[1] * v[1];
    after[1] = a[2] * v[0] + a[3] * v[1];
    return true;
  }
};

// The height of a plane's surface over the plane, and its slope.
struct Profile {
  Vec2d normal, point;
  double length;
  int first, width;

  template <typename T>
  void ProfileAt(const T* disc, const T* parameters, T* height, T* slope) const {
    const T* w = parameters + first;
    const Vec2d along = Perpendicular(normal);
    const T s = ((disc[0] - point[0]) * along[0] + (disc[1] - point[1]) * along[1]) / length;
    *height = w[3 * width];
    *slope = T(0.0);
    for (int i = 0; i < width; ++i) {
      const T unit = tanh(w[2 * i] * s + w[2 * i + 1]);
      *height += w[2 * width + i] * unit;
      *slope += w[2 * width + i] * (1.0 - unit * unit) * w[2 * i] / length;
    }
  }
};

struct ProfileGap {
  Profile profile;
  template <typename T>
  bool operator()(T const* const* blocks, T* gap) const {
    const T* disc = blocks[0];
    T height, slope;
    profile.ProfileAt(disc, blocks[1], &height, &slope);
    const Vec2d& n = profile.normal;
    gap[0] = n[0] * (disc[0] - profile.point[0]) + n[1] * (disc[1] - profile.point[1]) - disc[4] - height;
    return true;
  }
};

struct ProfileUpdate {
  Profile profile;
  bool friction;
  template <typename T>
  bool operator()(T const* const* blocks, T* after) const {
    const T *disc = blocks[0], *rest = blocks[1] + profile.first + 3 * profile.width + 1;
    T height, slope;
    profile.ProfileAt(disc, blocks[1], &height, &slope);
    const Vec2d& n = profile.normal;
    const Vec2d along = Perpendicular(n);
    const T length = sqrt(1.0 + slope * slope);
    const T nx = (n[0] - slope * along[0]) / length, ny = (n[1] - slope * along[1]) / length;
    const T closing = nx * disc[2] + ny * disc[3], sliding = nx * disc[3] - ny * disc[2];
    const T restitution = 1.0 / (1.0 + exp(-rest[0]));
    const T normal = -(1.0 + restitution) * closing;
    T tangential = T(0.0);
    if (friction) {
      const T most = exp(rest[1]) * normal;
      tangential = sliding > most ? T(-most) : sliding < -most ? most : T(-sliding);
    }
    after[0] = disc[2] + normal * nx - tangential * ny;
    after[1] = disc[3] + normal * ny + tangential * nx;
    return true;
  }
};

}  // namespace

std::string Validate(const EventFunctions& events, const Scene& scene) {
  const auto wrong = [&](const std::string& what) { return events.name + ": " + what; };
  if (events.planes.size() != scene.planes.size()) {
    return wrong("found functions of " + std::to_string(events.planes.size()) + " planes, expected of " +
                 std::to_string(scene.planes.size()));
  }
  if (!(events.spread > 0)) return wrong("expected a spread above zero");
  const int count = static_cast<int>(events.parameters.size());
  for (const EventFunctions::Plane& plane : events.planes) {
    for (const auto& [function, residuals] : {std::pair(plane.event, 1), std::pair(plane.update, 2)}) {
      if (function == nullptr) return wrong("found no function of a plane");
      const std::vector<int>& blocks = function->parameter_block_sizes();
      if (blocks.size() != 2 || blocks[0] != kOfDisc || blocks[1] != count) {
        return wrong("found a function of other parameter blocks, expected 5 of a disc and " + std::to_string(count) +
                     " parameters");
      }
      if (function->num_residuals() != residuals) {
        return wrong("found " + std::to_string(function->num_residuals()) +
                     " residuals, expected 1 of an event, 2 of an "
                     "update");
      }
    }
  }
  return "";
}

EventFunctions AffineEvents(const Scene& scene) {
  EventFunctions events{.name = "affine events", .planes = {}, .parameters = {}};
  const double bounce = 1 + scene.contact.restitution;
  const int count = kAffine * static_cast<int>(scene.planes.size());
  for (const Plane& plane : scene.planes) {
    const Vec2d n = plane.normal.normalized();
    const int first = static_cast<int>(events.parameters.size());
    events.parameters.insert(events.parameters.end(),
                             {n[0],
                              n[1],
                              n.dot(plane.point),
                              1 - bounce * n[0] * n[0],
                              -bounce * n[0] * n[1],
                              -bounce * n[0] * n[1],
                              1 - bounce * n[1] * n[1]});
    events.planes.push_back(
        {Differentiable(AffineGap{first}, 1, count), Differentiable(LinearUpdate{first}, 2, count)});
  }
  return events;
}

EventFunctions ProfileEvents(const Scene& scene, int width) {
  EventFunctions events{.name = "profile events", .planes = {}, .parameters = {}, .spread = 3};
  const bool friction = scene.contact.friction > 0;
  const int of_plane = 3 * width + 2 + (friction ? 1 : 0);
  const int count = of_plane * static_cast<int>(scene.planes.size());
  const double restitution = std::clamp(scene.contact.restitution, kInside, 1 - kInside);
  for (const Plane& plane : scene.planes) {
    const Profile profile{plane.normal.normalized(),
                          plane.point,
                          NaturalUnits(scene).length,
                          static_cast<int>(events.parameters.size()),
                          width};
    // The biases of the units differ from the start on, because equal units would have equal gradients and stay equal.
    for (int i = 0; i < width; ++i) {
      events.parameters.insert(events.parameters.end(), {2.0, -2 * ((2 * i + 1.0) / width - 1)});
    }
    events.parameters.insert(events.parameters.end(), width + 1, 0.0);
    events.parameters.push_back(std::log(restitution / (1 - restitution)));
    if (friction) events.parameters.push_back(std::log(std::max(scene.contact.friction, kLeastFriction)));
    events.planes.push_back(
        {Differentiable(ProfileGap{profile}, 1, count), Differentiable(ProfileUpdate{profile, friction}, 2, count)});
  }
  return events;
}

EventValues EvaluateEvents(const EventFunctions& events, int plane, const Vec2d& position, const Vec2d& velocity,
                           double radius) {
  const double disc[kOfDisc] = {position[0], position[1], velocity[0], velocity[1], radius};
  const double* blocks[2] = {disc, events.parameters.data()};
  double by_disc[kOfDisc];
  double* jacobians[2] = {by_disc, nullptr};
  EventValues at;
  const EventFunctions::Plane& of = events.planes[plane];
  if (!of.event->Evaluate(blocks, &at.value, jacobians) || !of.update->Evaluate(blocks, at.after.data(), nullptr)) {
    at.value = std::nan("");
    return at;
  }
  at.normal = Vec2d(by_disc[0], by_disc[1]).normalized();
  return at;
}

}  // namespace saltus
