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
std::vector<SceneParameter> PairParameters(Quantity quantity, const Scene& scene) {
  using Kind = SceneParameter::Kind;
  std::vector<SceneParameter> parameters;
  for (const int pair : PairsInUse(scene)) {
    const SceneParameter parameter{quantity == Quantity::kRestitution ? Kind::kRestitution : Kind::kFriction, -1, pair};
    const bool one_sided = parameter.kind == Kind::kFriction && !(ValueOf(parameter, scene) > 0);
    if (!one_sided || scene.materials.empty()) parameters.push_back(parameter);
  }
  return parameters;
}

struct Entry {
  std::string name;
  double value;
};

// Returns the entries of a quantity. Without a gradient, and of the control, values have no meaning.
std::vector<Entry> EntriesIn(const Scene& scene, const Sensitivity* gradient, Quantity quantity, int intervals) {
  std::vector<Entry> entries;
  const auto add = [&](const std::string& name, auto&& value_in) {
    entries.push_back({name, gradient == nullptr ? 0.0 : value_in(*gradient)});
  };
  switch (quantity) {
    case Quantity::kPosition:
    case Quantity::kVelocity:
      for (int i = 0; i < scene.num_bodies(); ++i) {
        const bool position = quantity == Quantity::kPosition;
        for (int j = 0; j < 2 && !scene.bodies[i].fixed; ++j) {
          add((position ? "p" : "v") + std::string(j == 0 ? "x " : "y ") + scene.bodies[i].name,
              [&](const Sensitivity& g) { return g.initial[4 * i + (position ? 0 : 2) + j]; });
        }
      }
      break;
    case Quantity::kControl:
      for (int k = 0; k < intervals; ++k) {
        const std::string in = "[" + std::to_string(k) + "] ";
        for (const int body : scene.control.bodies) {
          for (const char* force : {"ux", "uy"}) entries.push_back({force + in + scene.bodies[body].name, 0});
        }
        for (const int body : scene.control.torque_bodies) {
          entries.push_back({"torque/radius" + in + scene.bodies[body].name, 0});
        }
      }
      break;
    case Quantity::kMass:
      for (int i = 0; i < scene.num_bodies(); ++i) {
        if (scene.bodies[i].fixed) continue;
        add("mass " + scene.bodies[i].name,
            [&](const Sensitivity& g) { return i < int(g.parameters.mass.size()) ? g.parameters.mass[i] : 0.0; });
      }
      break;
    case Quantity::kGravity:
      for (const int j : {0, 1})
        add(j == 0 ? "gx" : "gy", [&](const Sensitivity& g) { return g.parameters.gravity[j]; });
      break;
    case Quantity::kRestitution:
    case Quantity::kFriction:
      for (const SceneParameter& parameter : PairParameters(quantity, scene)) {
        add(NameOf(parameter, scene), [&](const Sensitivity& g) { return ContactDerivative(parameter, g.parameters); });
      }
      break;
    case Quantity::kGeometry:
    case Quantity::kWallAngle:
      for (std::size_t i = 0; i < scene.design.size(); ++i) {
        if (!IsOf(quantity, scene.design[i].parameter)) continue;
        add(NameOf(scene.design[i].parameter, scene),
            [&](const Sensitivity& g) { return i < g.parameters.design.size() ? g.parameters.design[i] : 0.0; });
      }
      break;
    default:
      LOG(FATAL) << "a scene has no " << QuantityToString(quantity);
  }
  return entries;
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
  for (Entry& entry : EntriesIn(scene, nullptr, quantity, intervals)) names.push_back(std::move(entry.name));
  return names;
}

std::vector<double> EntriesOf(const Scene& scene, const ModelGradient& gradient, Quantity quantity, int intervals) {
  if (quantity == Quantity::kControl) return CoarsenControl(gradient.gradient.control, gradient.num_steps, intervals);
  std::vector<double> values;
  for (const Entry& entry : EntriesIn(scene, &gradient.gradient, quantity, intervals)) values.push_back(entry.value);
  return values;
}

}  // namespace saltus
