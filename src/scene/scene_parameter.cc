#include "saltus/scene/scene_parameter.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "saltus/scene/materials.h"

namespace saltus {
namespace {

using Kind = SceneParameter::Kind;

struct NamedKind {
  std::string_view name;
  Kind kind;
};
constexpr NamedKind kContactKinds[] = {{"restitution", Kind::kRestitution},
                                       {"friction", Kind::kFriction},
                                       {"stiffness", Kind::kStiffness},
                                       {"damping", Kind::kDamping}};

// Returns both components of a vector parameter, or the one that is named ("x" or "y").
std::vector<SceneParameter> Components(SceneParameter parameter, std::optional<std::string_view> component) {
  std::vector<SceneParameter> all;
  if (component && *component != "x" && *component != "y") return all;
  for (int j = 0; j < 2; ++j) {
    if (component && (*component == "y") != (j == 1)) continue;
    parameter.component = j;
    all.push_back(parameter);
  }
  return all;
}

template <typename Named>
int IndexOf(std::string_view name, const std::vector<Named>& all) {
  const auto found = std::find_if(all.begin(), all.end(), [&](const Named& one) { return one.name == name; });
  return found == all.end() ? -1 : static_cast<int>(found - all.begin());
}

// Returns the index of a disc with that name that is fixed or moves, as asked for; -1 if there is none.
int FindBody(std::string_view name, const Scene& scene, bool fixed) {
  const int body = IndexOf(name, scene.bodies);
  return body >= 0 && scene.bodies[body].fixed == fixed ? body : -1;
}

// Reads "BODY" or "BODY.x". A disc's name may have dots, so the whole text is looked for first.
std::vector<SceneParameter> ComponentsOfBody(Kind kind, std::string_view rest, const Scene& scene, bool fixed) {
  if (const int body = FindBody(rest, scene, fixed); body >= 0) return Components({kind, body}, std::nullopt);
  const std::size_t dot = rest.rfind('.');
  if (dot == std::string_view::npos) return {};
  const int body = FindBody(rest.substr(0, dot), scene, fixed);
  return body < 0 ? std::vector<SceneParameter>{} : Components({kind, body}, rest.substr(dot + 1));
}

// Returns the parameter of the object with that index; none if the index is negative.
std::vector<SceneParameter> ParametersOfObject(Kind kind, int index) {
  if (index < 0) return {};
  return {{kind, index}};
}

std::vector<SceneParameter> ParametersOfWall(Kind of_plane, Kind of_segment, std::string_view name,
                                             const Scene& scene) {
  if (const int plane = IndexOf(name, scene.planes); plane >= 0) return ParametersOfObject(of_plane, plane);
  return ParametersOfObject(of_segment, IndexOf(name, scene.segments));
}

// Returns the index of a disc among the controlled ones; their number if it is not controlled.
int PlaceInControl(const Scene& scene, int body) {
  const auto& bodies = scene.control.bodies;
  return static_cast<int>(std::find(bodies.begin(), bodies.end(), body) - bodies.begin());
}

// Returns a pointer to a parameter in a scene, which may be const; null if it is not stored as a number.
template <typename SomeScene>
auto MemberOf(const SceneParameter& parameter, SomeScene* scene) -> decltype(&scene->contact.friction) {
  switch (parameter.kind) {
    case Kind::kRestitution:
      return &scene->contact.restitution;
    case Kind::kFriction:
      return &scene->contact.friction;
    case Kind::kStiffness:
      return &scene->contact.stiffness;
    case Kind::kDamping:
      return &scene->contact.damping;
    case Kind::kMass:
      return &scene->bodies[parameter.body].mass;
    case Kind::kGravity:
      return &scene->gravity[parameter.component];
    case Kind::kRadius:
      return &scene->bodies[parameter.body].radius;
    case Kind::kPosition:
      return &scene->bodies[parameter.body].position[parameter.component];
    case Kind::kForce: {
      const int place = PlaceInControl(*scene, parameter.body);
      return place < scene->num_controlled() ? &scene->control.initial[place][parameter.component] : nullptr;
    }
    case Kind::kDrag:
      for (auto& force : scene->forces) {
        auto* drag = std::get_if<Drag>(&force);
        if (drag != nullptr && drag->body == parameter.body) return &drag->linear;
      }
      break;
    case Kind::kLaw:
    case Kind::kPlaneOffset:
    case Kind::kPlaneAngle:
    case Kind::kSegmentOffset:
    case Kind::kSegmentAngle:
      break;
  }
  return nullptr;
}

Vec2d Turned(const Vec2d& vector, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]};
}

// Moves or turns a wall; nothing moves by zero.
void MoveWall(const SceneParameter& parameter, double by, Scene* scene) {
  if (by == 0) return;
  if (parameter.kind == Kind::kPlaneOffset || parameter.kind == Kind::kPlaneAngle) {
    Plane& plane = scene->planes[parameter.body];
    if (IsAngle(parameter.kind)) {
      plane.normal = Turned(plane.normal, by);
    } else {
      plane.point += by * plane.normal.normalized();
    }
    return;
  }
  EdgeSegment& segment = scene->segments[parameter.body];
  const Vec2d half = 0.5 * (segment.to - segment.from), middle = segment.from + half;
  if (IsAngle(parameter.kind)) {
    const Vec2d turned = Turned(half, by);
    segment.from = middle - turned;
    segment.to = middle + turned;
  } else {
    const Vec2d shift = by * Perpendicular(half).normalized();
    segment.from += shift;
    segment.to += shift;
  }
}

bool IsOfWall(Kind kind) { return kind >= Kind::kPlaneOffset; }

// Whether it belongs to a pair of materials, whose MaterialPairIndex() is its component.
bool IsOfPair(Kind kind, const Scene& scene) {
  return !scene.materials.empty() && (kind == Kind::kRestitution || kind == Kind::kFriction);
}

// Returns the index of a material, -1 for the name of what has none.
std::optional<int> MaterialNamed(std::string_view name, const Scene& scene) {
  const int index = IndexOf(name, scene.materials);
  return index >= 0 || name == kNoMaterial ? std::optional(index) : std::nullopt;
}

// Returns what the scene gives for a pair of materials, to be set; it is added if there is nothing.
MaterialPair& PairOf(int index, Scene* scene) {
  const auto [a, b] = MaterialsOfPair(index);
  for (MaterialPair& pair : scene->pairs) {
    if (MaterialPairIndex(pair.a + 1, pair.b + 1) == index) return pair;
  }
  return scene->pairs.emplace_back(MaterialPair{a - 1, b - 1});
}

}  // namespace

std::vector<SceneParameter> ParametersNamed(std::string_view name, const Scene& scene) {
  for (const NamedKind& kind : kContactKinds) {
    if (name == kind.name && !IsOfPair(kind.kind, scene)) return {{kind.kind}};
    if (!IsOfPair(kind.kind, scene) || !name.starts_with(std::string(kind.name) + '.')) continue;
    const std::string_view pair = name.substr(kind.name.size() + 1);
    const std::size_t dash = pair.find('-');
    if (dash == std::string_view::npos) return {};
    const std::optional<int> a = MaterialNamed(pair.substr(0, dash), scene);
    const std::optional<int> b = MaterialNamed(pair.substr(dash + 1), scene);
    if (!a || !b) return {};
    return {{kind.kind, -1, MaterialPairIndex(*a + 1, *b + 1)}};
  }
  const auto rest = [&](std::string_view prefix) -> std::optional<std::string_view> {
    return name.starts_with(prefix) ? std::optional(name.substr(prefix.size())) : std::nullopt;
  };
  if (name == "gravity") return Components({Kind::kGravity}, std::nullopt);
  if (const auto component = rest("gravity.")) return Components({Kind::kGravity}, component);
  if (const auto body = rest("mass.")) return ParametersOfObject(Kind::kMass, FindBody(*body, scene, false));
  if (const auto body = rest("drag.")) {
    const SceneParameter drag{Kind::kDrag, FindBody(*body, scene, false)};
    return MemberOf(drag, &scene) == nullptr ? std::vector<SceneParameter>{} : std::vector{drag};
  }
  if (const auto body = rest("radius.")) return ParametersOfObject(Kind::kRadius, IndexOf(*body, scene.bodies));
  if (const auto body = rest("force.")) return ComponentsOfBody(Kind::kForce, *body, scene, false);
  if (const auto body = rest("position.")) return ComponentsOfBody(Kind::kPosition, *body, scene, true);
  if (const auto wall = rest("offset."))
    return ParametersOfWall(Kind::kPlaneOffset, Kind::kSegmentOffset, *wall, scene);
  if (const auto wall = rest("angle.")) return ParametersOfWall(Kind::kPlaneAngle, Kind::kSegmentAngle, *wall, scene);
  return {};
}

std::string NameOf(const SceneParameter& parameter, const Scene& scene) {
  const std::string component = parameter.component == 0 ? ".x" : ".y";
  const auto body = [&]() -> const std::string& { return scene.bodies[parameter.body].name; };
  switch (parameter.kind) {
    case Kind::kRestitution:
    case Kind::kFriction:
    case Kind::kStiffness:
    case Kind::kDamping:
      for (const NamedKind& kind : kContactKinds) {
        if (parameter.kind != kind.kind) continue;
        const std::string name(kind.name);
        return IsOfPair(kind.kind, scene) ? name + '.' + NameOfPair(parameter.component, scene) : name;
      }
      break;
    case Kind::kMass:
      return "mass." + body();
    case Kind::kGravity:
      return "gravity" + component;
    case Kind::kForce:
      return "force." + body() + component;
    case Kind::kLaw:
      return "law." + std::to_string(parameter.component);
    case Kind::kRadius:
      return "radius." + body();
    case Kind::kPosition:
      return "position." + body() + component;
    case Kind::kDrag:
      return "drag." + body();
    case Kind::kPlaneOffset:
      return "offset." + scene.planes[parameter.body].name;
    case Kind::kPlaneAngle:
      return "angle." + scene.planes[parameter.body].name;
    case Kind::kSegmentOffset:
      return "offset." + scene.segments[parameter.body].name;
    case Kind::kSegmentAngle:
      return "angle." + scene.segments[parameter.body].name;
  }
  LOG(FATAL) << "not a kind of parameter: " << static_cast<int>(parameter.kind);
}

bool IsAngle(Kind kind) { return kind == Kind::kPlaneAngle || kind == Kind::kSegmentAngle; }

std::string ContactParametersOf(const Scene& scene) {
  if (scene.materials.empty()) return "restitution, friction, stiffness, damping";
  std::string names;
  for (const Kind kind : {Kind::kRestitution, Kind::kFriction}) {
    for (const int pair : PairsInUse(scene)) names += NameOf({kind, -1, pair}, scene) + ", ";
  }
  return names + "stiffness, damping";
}

double ValueOf(const SceneParameter& parameter, const Scene& scene) {
  if (IsOfPair(parameter.kind, scene)) {
    const PairContact contact = PairContactsOf(scene)[parameter.component];
    return parameter.kind == Kind::kRestitution ? contact.restitution : contact.friction;
  }
  const double* entry = MemberOf(parameter, &scene);
  return entry == nullptr ? 0 : *entry;
}

void SetValue(const SceneParameter& parameter, double value, Scene* scene) {
  if (IsOfWall(parameter.kind)) return MoveWall(parameter, value, scene);
  if (IsOfPair(parameter.kind, *scene)) {
    MaterialPair& pair = PairOf(parameter.component, scene);
    (parameter.kind == Kind::kRestitution ? pair.restitution : pair.friction) = value;
    return;
  }
  if (parameter.kind == Kind::kForce && PlaceInControl(*scene, parameter.body) == scene->num_controlled()) {
    scene->control.bodies.push_back(parameter.body);
    scene->control.initial.push_back({0, 0});
  }
  if (double* entry = MemberOf(parameter, scene)) *entry = value;
}

void SetValues(std::span<const SceneParameter> parameters, std::span<const double> values, Scene* scene) {
  for (const bool angles : {true, false}) {
    for (std::size_t i = 0; i < parameters.size(); ++i) {
      if (IsAngle(parameters[i].kind) == angles) SetValue(parameters[i], values[i], scene);
    }
  }
}

ParameterRange RangeOf(const DesignParameter& design) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  ParameterRange range{-kInfinity, kInfinity};
  switch (design.parameter.kind) {
    case Kind::kRestitution:
      range = {0, 1};
      break;
    case Kind::kFriction:
    case Kind::kStiffness:
    case Kind::kDamping:
    case Kind::kDrag:
      range.min = 0;
      break;
    case Kind::kMass:
    case Kind::kRadius:
      range.min = kSmallestPositive;
      break;
    default:
      break;
  }
  if (design.min) range.min = std::max(range.min, *design.min);
  if (design.max) range.max = std::min(range.max, *design.max);
  return range;
}

double ValueOf(const DesignParameter& design, const Scene& scene) {
  return IsOfWall(design.parameter.kind) ? design.moved : ValueOf(design.parameter, scene);
}

std::vector<double> DesignOf(const Scene& scene) {
  std::vector<double> values;
  for (const DesignParameter& design : scene.design) values.push_back(ValueOf(design, scene));
  return values;
}

Scene WithDesign(const Scene& scene, std::span<const double> values) {
  if (values.empty()) return scene;
  CHECK_EQ(values.size(), scene.design.size());
  Scene designed = scene;
  std::vector<SceneParameter> parameters;
  std::vector<double> changed(values.begin(), values.end());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto& [parameter, min, max, moved] = scene.design[i];
    parameters.push_back(parameter);
    if (IsAngle(parameter.kind)) {
      changed[i] -= moved;
    } else {
      MoveWall(parameter, -moved, &designed);
    }
    if (IsOfWall(parameter.kind)) designed.design[i].moved = values[i];
  }
  SetValues(parameters, changed, &designed);
  return designed;
}

}  // namespace saltus
