// The quantities by which gradients are compared: their names, units and entries (refinement.h).
#include <glog/logging.h>

#include "saltus/audit/audit.h"
#include "saltus/audit/refinement.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/units.h"

namespace saltus {

namespace {

// Whether a design parameter belongs to the quantity: kGeometry or kWallAngle.
bool IsOf(Quantity quantity, const SceneParameter& parameter) {
  using Kind = SceneParameter::Kind;
  const Kind kind = parameter.kind;
  if (quantity == Quantity::kWallAngle) return kind == Kind::kPlaneAngle || kind == Kind::kSegmentAngle;
  return kind == Kind::kRadius || kind == Kind::kPosition || kind == Kind::kPlaneOffset || kind == Kind::kSegmentOffset;
}

// Returns the restitutions, or the frictions above zero, of the pairs of materials that may touch; those of the scene
// if it has no materials.
std::vector<SceneParameter> OfPairs(Quantity quantity, const Scene& scene) {
  using Kind = SceneParameter::Kind;
  std::vector<SceneParameter> parameters;
  for (const int pair : PairsInUse(scene)) {
    const SceneParameter parameter{quantity == Quantity::kRestitution ? Kind::kRestitution : Kind::kFriction, -1, pair};
    const bool one_sided = parameter.kind == Kind::kFriction && !(ValueOf(parameter, scene) > 0);
    if (!one_sided || scene.materials.empty()) parameters.push_back(parameter);
  }
  return parameters;
}

}  // namespace

const char* QuantityToString(Quantity quantity) {
  constexpr const char* kNames[] = {"position",
                                    "velocity",
                                    "control",
                                    "restitution",
                                    "friction",
                                    "mass",
                                    "gravity",
                                    "geometry",
                                    "wall_angle",
                                    "initial",
                                    "control",
                                    "parameters"};
  return kNames[static_cast<int>(quantity)];
}

double GradientFactor(Quantity quantity, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  const double factors[] = {by.loss / by.length,
                            by.loss / by.speed,
                            by.loss / by.force,
                            by.loss,
                            by.loss,
                            by.loss / by.mass,
                            by.loss / by.acceleration,
                            by.loss / by.length,
                            by.loss};  // in the order of the enum
  return factors[static_cast<int>(quantity)];
}

std::vector<std::string> EntryNames(const Scene& scene, Quantity quantity, int intervals) {
  std::vector<std::string> names;
  const auto add_vector = [&](const std::string& prefix, const std::string& suffix) {
    names.push_back(prefix + "x" + suffix);
    names.push_back(prefix + "y" + suffix);
  };
  switch (quantity) {
    case Quantity::kPosition:
    case Quantity::kVelocity:
      for (const Body& body : scene.bodies) {
        if (!body.fixed) add_vector(quantity == Quantity::kPosition ? "p" : "v", " " + body.name);
      }
      break;
    case Quantity::kControl:
      for (int k = 0; k < intervals; ++k) {
        for (int body : scene.control.bodies) {
          add_vector("u", "[" + std::to_string(k) + "] " + scene.bodies[body].name);
        }
        for (int body : scene.control.turned) {
          names.push_back("torque/radius[" + std::to_string(k) + "] " + scene.bodies[body].name);
        }
      }
      break;
    case Quantity::kMass:
      for (const Body& body : scene.bodies) {
        if (!body.fixed) names.push_back("mass " + body.name);
      }
      break;
    case Quantity::kGravity:
      add_vector("g", "");
      break;
    case Quantity::kRestitution:
    case Quantity::kFriction:
      for (const SceneParameter& parameter : OfPairs(quantity, scene)) names.push_back(NameOf(parameter, scene));
      break;
    case Quantity::kGeometry:
    case Quantity::kWallAngle:
      for (const DesignParameter& design : scene.design) {
        if (IsOf(quantity, design.parameter)) names.push_back(NameOf(design.parameter, scene));
      }
      break;
    default:
      LOG(FATAL) << "a scene has no " << QuantityToString(quantity);
  }
  return names;
}

std::vector<double> EntriesOf(const Scene& scene, const ModelGradient& gradient, Quantity quantity, int intervals) {
  const Sensitivity& g = gradient.gradient;
  std::vector<double> entries;
  switch (quantity) {
    case Quantity::kPosition:
    case Quantity::kVelocity:
      for (int i = 0; i < scene.num_bodies(); ++i) {
        const int at = 4 * i + (quantity == Quantity::kVelocity ? 2 : 0);
        if (!scene.bodies[i].fixed) entries.insert(entries.end(), {g.initial[at], g.initial[at + 1]});
      }
      break;
    case Quantity::kControl:
      entries = CoarsenControl(g.control, gradient.num_steps, intervals);
      break;
    case Quantity::kRestitution:
    case Quantity::kFriction:
      for (const SceneParameter& parameter : OfPairs(quantity, scene)) {
        entries.push_back(ByContact(parameter, g.parameters));
      }
      break;
    case Quantity::kMass:
      for (int i = 0; i < scene.num_bodies(); ++i) {
        if (!scene.bodies[i].fixed) entries.push_back(i < int(g.parameters.mass.size()) ? g.parameters.mass[i] : 0.0);
      }
      break;
    case Quantity::kGravity:
      entries = {g.parameters.gravity[0], g.parameters.gravity[1]};
      break;
    case Quantity::kGeometry:
    case Quantity::kWallAngle:
      for (std::size_t i = 0; i < scene.design.size(); ++i) {
        if (!IsOf(quantity, scene.design[i].parameter)) continue;
        entries.push_back(i < g.parameters.design.size() ? g.parameters.design[i] : 0.0);
      }
      break;
    default:
      LOG(FATAL) << "a scene has no " << QuantityToString(quantity);
  }
  return entries;
}

}  // namespace saltus
