#include "identify/unknowns.h"

#include <algorithm>
#include <cmath>

#include "scene/units.h"

namespace saltus {
namespace {

using Kind = Unknown::Kind;

// The least distance of a start from 0 or 1 for restitution; the least value of a positive parameter.
constexpr double kInside = 1e-3;

bool IsPositive(Kind kind) {
  return kind == Kind::kFriction || kind == Kind::kStiffness || kind == Kind::kDamping || kind == Kind::kMass;
}

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

}  // namespace

std::variant<std::vector<Unknown>, std::string> ParseUnknowns(std::string_view names, const Scene& scene) {
  std::vector<Unknown> all;
  for (const std::string& name : Split(names, ',')) {
    const std::vector<Unknown> found = ParametersNamed(name, scene);
    // Recordings cannot determine the others, which are of the scene's geometry.
    if (found.empty() || found.front().kind > Kind::kForce) {
      return "found '" + name + "', expected some of " + ContactParametersOf(scene) +
             ", gravity, gravity.x, gravity.y, mass.BODY, force.BODY, force.BODY.x, force.BODY.y, with a BODY that "
             "moves";
    }
    all.insert(all.end(), found.begin(), found.end());
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (std::find(all.begin(), all.begin() + i, all[i]) != all.begin() + i) {
      return "found '" + NameOf(all[i], scene) + "' again, expected it once";
    }
  }
  return all;
}

bool HasBounds(const Unknown& unknown) { return unknown.kind == Kind::kRestitution || IsPositive(unknown.kind); }

double FromCoordinate(const Unknown& unknown, double coordinate) {
  if (unknown.kind == Kind::kRestitution) return 1 / (1 + std::exp(-coordinate));
  return IsPositive(unknown.kind) ? std::exp(coordinate) : coordinate;
}

double BoundNear(const Unknown& unknown, double value) {
  return unknown.kind == Kind::kRestitution && value > 0.5 ? 1 : 0;
}

void MoveToBound(const Unknown& unknown, double* coordinate) {
  constexpr double kFar = 23;  // where restitution and friction are 1e-10 from their bounds
  if (unknown.kind == Kind::kRestitution) *coordinate = std::copysign(kFar, *coordinate);
  if (unknown.kind == Kind::kFriction) *coordinate = -kFar;
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
