#include "identify/unknowns.h"

#include <algorithm>
#include <cmath>

#include "scene/units.h"

namespace saltus {
namespace {

using Kind = Unknown::Kind;

// Of restitution: how near a start may be to 0 or 1. Of what is positive: how small it may be.
constexpr double kInside = 1e-3;

bool IsPositive(Kind kind) {
  return kind == Kind::kFriction || kind == Kind::kStiffness || kind == Kind::kDamping || kind == Kind::kMass;
}

struct NamedKind {
  const char* name;
  Kind kind;
};
constexpr NamedKind kContactKinds[] = {{"restitution", Kind::kRestitution},
                                       {"friction", Kind::kFriction},
                                       {"stiffness", Kind::kStiffness},
                                       {"damping", Kind::kDamping}};

std::vector<std::string> Split(std::string_view text, char separator) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == separator) {
      parts.emplace_back();
    } else if (c != ' ') {
      parts.back() += c;
    }
  }
  return parts;
}

// Both components, or the one that is named: "x" or "y".
bool AddComponents(Unknown unknown, const std::optional<std::string>& component, std::vector<Unknown>* all) {
  if (component && *component != "x" && *component != "y") return false;
  for (int j = 0; j < 2; ++j) {
    if (component && (*component == "y") != (j == 1)) continue;
    unknown.component = j;
    all->push_back(unknown);
  }
  return true;
}

// A disc's name may have dots, so it is looked for from the longest on.
std::optional<int> FindBody(const std::string& name, const Scene& scene) {
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].name == name && !scene.bodies[i].fixed) return i;
  }
  return std::nullopt;
}

bool Add(const std::string& name, const Scene& scene, std::vector<Unknown>* all) {
  for (const NamedKind& kind : kContactKinds) {
    if (name != kind.name) continue;
    all->push_back({kind.kind});
    return true;
  }
  if (name == "gravity") return AddComponents({Kind::kGravity}, std::nullopt, all);
  if (name == "gravity.x" || name == "gravity.y") return AddComponents({Kind::kGravity}, name.substr(8), all);
  if (name.starts_with("mass.")) {
    const std::optional<int> body = FindBody(name.substr(5), scene);
    if (body) all->push_back({Kind::kMass, *body});
    return body.has_value();
  }
  if (!name.starts_with("force.")) return false;
  const std::string rest = name.substr(6);
  if (const std::optional<int> body = FindBody(rest, scene)) return AddComponents({Kind::kForce, *body}, {}, all);
  const std::size_t dot = rest.rfind('.');
  if (dot == std::string::npos) return false;
  const std::optional<int> body = FindBody(rest.substr(0, dot), scene);
  return body && AddComponents({Kind::kForce, *body}, rest.substr(dot + 1), all);
}

// The index of a disc among the controlled ones; their number if it is not controlled.
int PlaceInControl(const Scene& scene, int body) {
  const auto& bodies = scene.control.bodies;
  return static_cast<int>(std::find(bodies.begin(), bodies.end(), body) - bodies.begin());
}

// Where an unknown stands in a scene, which may be const; null for parameters of a law, and for the force on a disc
// that is not controlled.
template <typename SomeScene>
auto EntryOf(const Unknown& unknown, SomeScene* scene) -> decltype(&scene->contact.friction) {
  switch (unknown.kind) {
    case Kind::kRestitution:
      return &scene->contact.restitution;
    case Kind::kFriction:
      return &scene->contact.friction;
    case Kind::kStiffness:
      return &scene->contact.stiffness;
    case Kind::kDamping:
      return &scene->contact.damping;
    case Kind::kMass:
      return &scene->bodies[unknown.body].mass;
    case Kind::kGravity:
      return &scene->gravity[unknown.component];
    case Kind::kLaw:
      return nullptr;
    case Kind::kForce:
      break;
  }
  const int place = PlaceInControl(*scene, unknown.body);
  return place < scene->num_controlled() ? &scene->control.initial[place][unknown.component] : nullptr;
}

}  // namespace

std::string NameOf(const Unknown& unknown, const Scene& scene) {
  for (const NamedKind& kind : kContactKinds) {
    if (unknown.kind == kind.kind) return kind.name;
  }
  if (unknown.kind == Kind::kLaw) return "law." + std::to_string(unknown.component);
  const std::string component = unknown.component == 0 ? ".x" : ".y";
  if (unknown.kind == Kind::kGravity) return "gravity" + component;
  const std::string& body = scene.bodies[unknown.body].name;
  return unknown.kind == Kind::kMass ? "mass." + body : "force." + body + component;
}

std::variant<std::vector<Unknown>, std::string> ParseUnknowns(std::string_view names, const Scene& scene) {
  std::vector<Unknown> all;
  for (const std::string& name : Split(names, ',')) {
    if (!Add(name, scene, &all)) {
      return "found '" + name +
             "', expected some of restitution, friction, stiffness, damping, gravity, gravity.x, gravity.y, mass.BODY, "
             "force.BODY, force.BODY.x, force.BODY.y, with a BODY that moves";
    }
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (std::find(all.begin(), all.begin() + i, all[i]) != all.begin() + i) {
      return "found '" + NameOf(all[i], scene) + "' again, expected it once";
    }
  }
  return all;
}

double ValueOf(const Unknown& unknown, const Scene& scene) {
  const double* entry = EntryOf(unknown, &scene);
  return entry == nullptr ? 0 : *entry;
}

void SetValue(const Unknown& unknown, double value, Scene* scene) {
  if (unknown.kind == Kind::kForce && PlaceInControl(*scene, unknown.body) == scene->num_controlled()) {
    scene->control.bodies.push_back(unknown.body);
    scene->control.initial.push_back({0, 0});
  }
  if (double* entry = EntryOf(unknown, scene)) *entry = value;
}

bool HasBounds(const Unknown& unknown) { return unknown.kind == Kind::kRestitution || IsPositive(unknown.kind); }

double FromCoordinate(const Unknown& unknown, double coordinate) {
  if (unknown.kind == Kind::kRestitution) return 1 / (1 + std::exp(-coordinate));
  return IsPositive(unknown.kind) ? std::exp(coordinate) : coordinate;
}

double SlopeAt(const Unknown& unknown, double coordinate) {
  const double value = FromCoordinate(unknown, coordinate);
  if (unknown.kind == Kind::kRestitution) return value * (1 - value);
  return IsPositive(unknown.kind) ? value : 1;
}

double ToCoordinate(const Unknown& unknown, double value) {
  if (unknown.kind == Kind::kRestitution) {
    const double inside = std::clamp(value, kInside, 1 - kInside);
    return std::log(inside / (1 - inside));
  }
  return IsPositive(unknown.kind) ? std::log(std::max(value, kInside)) : value;
}

double ScaleOf(const Unknown& unknown, const Scene& scene) {
  if (unknown.kind == Kind::kRestitution || unknown.kind == Kind::kFriction || unknown.kind == Kind::kLaw) return 1;
  if (IsPositive(unknown.kind)) return std::max(ValueOf(unknown, scene), kInside);
  const Units units = NaturalUnits(scene);
  return unknown.kind == Kind::kGravity ? units.acceleration() : scene.bodies[unknown.body].mass * units.acceleration();
}

}  // namespace saltus
