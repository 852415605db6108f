// Scenes as the text of scene files.
#include <glog/logging.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <string>
#include <variant>
#include <vector>

#include "base/number_text.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/scene_rules.h"

namespace saltus {
namespace {

YAML::Emitter& operator<<(YAML::Emitter& out, const Vec2d& vector) {
  return out << YAML::Flow << YAML::BeginSeq << ToText(vector[0]) << ToText(vector[1]) << YAML::EndSeq;
}

template <typename T>
void WriteField(YAML::Emitter* out, const char* key, const T& value) {
  *out << YAML::Key << key << YAML::Value << value;
}

void WriteField(YAML::Emitter* out, const char* key, double value) { WriteField(out, key, ToText(value)); }

// Writes a name, in quotes if another reader could take it for a number or a truth value.
YAML::Emitter& WriteName(YAML::Emitter* out, const std::string& name) {
  const char first = name.empty() ? ' ' : name[0];
  const bool plain = (std::isalpha(static_cast<unsigned char>(first)) || first == '_') && name != "true" &&
                     name != "false" && name != "null";
  if (!plain) *out << YAML::DoubleQuoted;
  return *out << name;
}

void WriteName(YAML::Emitter* out, const char* key, const std::string& name) {
  *out << YAML::Key << key << YAML::Value;
  WriteName(out, name);
}

// Writes the names of the bodies with these indices.
void WriteNames(YAML::Emitter* out, const char* key, const Scene& scene, const std::vector<int>& bodies) {
  *out << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const int body : bodies) WriteName(out, scene.bodies[body].name);
  *out << YAML::EndSeq;
}

void WriteSpin(YAML::Emitter* out, const Body& body) {
  if (body.inertia.kind == Inertia::Kind::kSolid) {
    WriteField(out, "inertia", "solid");
  } else {
    WriteField(out, "inertia", body.inertia.moment);
  }
  WriteField(out, "angle", body.angle);
  WriteField(out, "angular_velocity", body.angular_velocity);
}

void WriteMaterial(YAML::Emitter* out, const Scene& scene, int material) {
  if (material >= 0) WriteName(out, "material", scene.materials[material].name);
}

void WritePath(YAML::Emitter* out, const char* key, const PrescribedMotion& path) {
  *out << YAML::Key << key << YAML::Value << YAML::BeginMap << YAML::Key << "times" << YAML::Value << YAML::BeginSeq;
  for (const double time : path.times) *out << ToText(time);
  *out << YAML::EndSeq << YAML::Key << "positions" << YAML::Value << YAML::BeginSeq;
  for (const Vec2d& position : path.positions) *out << position;
  *out << YAML::EndSeq << YAML::EndMap;
}

void WriteBody(YAML::Emitter* out, const Scene& scene, const Body& body) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", body.name);
  WriteField(out, "radius", body.radius);
  if (body.path) {
    WritePath(out, "path", *body.path);
  } else if (body.fixed) {
    WriteField(out, "fixed", true);
  } else {
    WriteField(out, "mass", body.mass);
  }
  if (!body.path) WriteField(out, "position", body.position);
  if (!body.fixed) WriteField(out, "velocity", body.velocity);
  if (body.Spins()) WriteSpin(out, body);
  WriteMaterial(out, scene, body.material);
  *out << YAML::EndMap;
}

void WritePlane(YAML::Emitter* out, const Scene& scene, const Plane& plane) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", plane.name);
  if (plane.motion) {
    WritePath(out, "motion", *plane.motion);
  } else {
    WriteField(out, "point", plane.point);
  }
  WriteField(out, "normal", plane.normal);
  WriteMaterial(out, scene, plane.material);
  *out << YAML::EndMap;
}

void WriteSegment(YAML::Emitter* out, const Scene& scene, const EdgeSegment& segment) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", segment.name);
  WriteField(out, "from", segment.from);
  WriteField(out, "to", segment.to);
  WriteMaterial(out, scene, segment.material);
  *out << YAML::EndMap;
}

void WritePolygon(YAML::Emitter* out, const Scene& scene, const EdgePolygon& polygon) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", polygon.name);
  *out << YAML::Key << "points" << YAML::Value << YAML::BeginSeq;
  for (const Vec2d& point : polygon.points) *out << point;
  *out << YAML::EndSeq;
  WriteField(out, "solid", polygon.solid == EdgePolygon::Solid::kOutside ? "outside" : "inside");
  WriteMaterial(out, scene, polygon.material);
  *out << YAML::EndMap;
}

void WriteArc(YAML::Emitter* out, const Scene& scene, const EdgeArc& arc) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", arc.name);
  WriteField(out, "center", arc.center);
  WriteField(out, "radius", arc.radius);
  WriteField(out, "from", arc.from);
  WriteField(out, "to", arc.to);
  WriteMaterial(out, scene, arc.material);
  *out << YAML::EndMap;
}

void WritePocket(YAML::Emitter* out, const Scene&, const Pocket& pocket) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "name", pocket.name);
  WriteField(out, "position", pocket.position);
  WriteField(out, "radius", pocket.radius);
  *out << YAML::EndMap;
}

void WriteTable(YAML::Emitter* out, const TableFriction& table) {
  *out << YAML::Key << "table" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "friction", table.friction);
  WriteField(out, "gravity", table.gravity);
  *out << YAML::EndMap;
}

void WriteForce(YAML::Emitter* out, const Scene& scene, const StateForce& force) {
  const auto begin = [&](const char* kind, int body) {
    *out << YAML::Flow << YAML::BeginMap << YAML::Key << kind << YAML::Value << YAML::BeginMap;
    WriteName(out, "body", scene.bodies[body].name);
  };
  if (const auto* drag = std::get_if<Drag>(&force)) {
    begin("drag", drag->body);
    WriteField(out, "linear", drag->linear);
  } else {
    const auto& spring = std::get<Spring>(force);
    begin("spring", spring.body);
    if (spring.to >= 0) {
      WriteName(out, "to", scene.bodies[spring.to].name);
    } else {
      WriteField(out, "to", spring.point);
    }
    WriteField(out, "stiffness", spring.stiffness);
    WriteField(out, "length", spring.length);
    WriteField(out, "damping", spring.damping);
  }
  *out << YAML::EndMap << YAML::EndMap;
}

void WriteContact(YAML::Emitter* out, const ContactParameters& contact) {
  *out << YAML::Key << "contact" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "restitution", contact.restitution);
  WriteField(out, "friction", contact.friction);
  WriteField(out, "stiffness", contact.stiffness);
  WriteField(out, "damping", contact.damping);
  *out << YAML::EndMap;
}

void WriteMaterials(YAML::Emitter* out, const Scene& scene) {
  if (scene.materials.empty()) return;
  *out << YAML::Key << "materials" << YAML::Value << YAML::BeginMap;
  for (const Material& material : scene.materials) {
    *out << YAML::Key;
    WriteName(out, material.name);
    *out << YAML::Value << YAML::Flow << YAML::BeginMap;
    WriteField(out, "restitution", material.contact.restitution);
    WriteField(out, "friction", material.contact.friction);
    *out << YAML::EndMap;
  }
  *out << YAML::EndMap;
  if (!scene.pairs.empty()) *out << YAML::Key << "pairs" << YAML::Value << YAML::BeginSeq;
  for (const MaterialPair& pair : scene.pairs) {
    *out << YAML::Flow << YAML::BeginMap << YAML::Key << "between" << YAML::Value << YAML::BeginSeq;
    for (const int one : {pair.a, pair.b}) WriteName(out, one < 0 ? kNoMaterial : scene.materials[one].name);
    *out << YAML::EndSeq;
    if (pair.restitution) WriteField(out, "restitution", *pair.restitution);
    if (pair.friction) WriteField(out, "friction", *pair.friction);
    *out << YAML::EndMap;
  }
  if (!scene.pairs.empty()) *out << YAML::EndSeq;
  WriteField(out, "combine", kCombines[static_cast<size_t>(scene.combine)]);
}

void WriteBounds(YAML::Emitter* out, const char* key, const std::vector<double>& bounds) {
  if (bounds.empty()) return;
  *out << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const double bound : bounds) *out << ToText(bound);
  *out << YAML::EndSeq;
}

void WriteControl(YAML::Emitter* out, const Scene& scene) {
  *out << YAML::Key << "control" << YAML::Value << YAML::BeginMap;
  WriteNames(out, "bodies", scene, scene.control.bodies);
  if (scene.num_torques() > 0) WriteNames(out, "torque", scene, scene.control.torque_bodies);
  *out << YAML::Key << "initial" << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (std::size_t c = 0; c < scene.control.initial.size(); ++c) {
    const Vec2d& force = scene.control.initial[c];
    const std::vector<int>& turned = scene.control.torque_bodies;
    const auto at = std::find(turned.begin(), turned.end(), scene.control.bodies[c]);
    if (at == turned.end()) {
      *out << force;
      continue;
    }
    *out << YAML::Flow << YAML::BeginSeq << ToText(force[0]) << ToText(force[1])
         << ToText(scene.control.initial_torque[at - turned.begin()]) << YAML::EndSeq;
  }
  *out << YAML::EndSeq;
  WriteBounds(out, "max", scene.control.max);
  WriteBounds(out, "max_norm", scene.control.max_norm);
  WriteBounds(out, "max_torque", scene.control.max_torque);
  *out << YAML::EndMap;
}

void WriteQuantity(YAML::Emitter* out, TerminalTerm::Quantity quantity) {
  WriteField(out, "quantity", kQuantities[static_cast<size_t>(quantity)]);
}

// Writes the weight of a term that may be a constraint instead.
void WriteWeight(YAML::Emitter* out, double weight, bool hard) {
  if (hard) {
    WriteField(out, "hard", true);
  } else {
    WriteField(out, "weight", weight);
  }
}

// Writes the bounds of the components of a quantity; null where there is none.
void WriteBoundsOf(YAML::Emitter* out, const char* key, const TerminalTerm& term, const Vec2d& bounds) {
  if (!std::isfinite(bounds[0]) && !std::isfinite(bounds[1])) return;
  if (term.IsRotational()) return WriteField(out, key, bounds[0]);
  *out << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const double bound : bounds) {
    if (std::isfinite(bound)) {
      *out << ToText(bound);
    } else {
      *out << YAML::Null;
    }
  }
  *out << YAML::EndSeq;
}

void WriteTerm(YAML::Emitter* out, const Scene& scene, const TerminalTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "body", scene.bodies[term.body].name);
  WriteQuantity(out, term.quantity);
  if (term.region) {
    WriteBoundsOf(out, "min", term, term.region->min);
    WriteBoundsOf(out, "max", term, term.region->max);
  } else if (term.component) {
    WriteField(out, "component", *term.component == 0 ? "x" : "y");
  } else if (term.IsRotational()) {
    WriteField(out, "target", term.target[0]);
  } else {
    WriteField(out, "target", term.target);
  }
  WriteWeight(out, term.weight, term.hard);
  *out << YAML::EndMap;
}

void WriteRunning(YAML::Emitter* out, const Scene& scene, const RunningTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "body", scene.bodies[term.body].name);
  WriteQuantity(out, term.quantity);
  *out << YAML::Key << "target" << YAML::Value << YAML::BeginSeq;
  for (size_t i = 0; i < term.times.size(); ++i) {
    *out << YAML::BeginSeq << ToText(term.times[i]) << ToText(term.targets[i][0]) << ToText(term.targets[i][1])
         << YAML::EndSeq;
  }
  *out << YAML::EndSeq;
  WriteField(out, "weight", term.weight);
  *out << YAML::EndMap;
}

void WriteVia(YAML::Emitter* out, const Scene& scene, const ViaTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "body", scene.bodies[term.body].name);
  WriteField(out, "time", term.time);
  WriteQuantity(out, term.quantity);
  WriteField(out, "target", term.target);
  WriteWeight(out, term.weight, term.hard);
  *out << YAML::EndMap;
}

void WriteLimit(YAML::Emitter* out, const Scene& scene, const SpeedLimit& limit) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteName(out, "body", scene.bodies[limit.body].name);
  *out << YAML::Key << "speed" << YAML::Value << YAML::BeginMap;
  WriteField(out, "max", limit.max);
  *out << YAML::EndMap;
  WriteField(out, "at", limit.at == SpeedLimit::Timing::kEnd ? "end" : "always");
  *out << YAML::EndMap;
}

void WriteFreeDuration(YAML::Emitter* out, const FreeDuration& duration) {
  *out << YAML::Key << "duration" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "free", true);
  WriteField(out, "min", duration.min);
  WriteField(out, "max", duration.max);
  WriteField(out, "weight", duration.weight);
  *out << YAML::EndMap;
}

void WriteOptimize(YAML::Emitter* out, const Scene& scene) {
  if (scene.design.empty()) return WriteField(out, "optimize", OptimizeToString(scene.optimize));
  *out << YAML::Key << "optimize" << YAML::Value << YAML::BeginSeq;
  if (scene.optimize != Optimize::kNone) *out << OptimizeToString(scene.optimize);
  for (const DesignParameter& design : scene.design) {
    *out << YAML::Flow << YAML::BeginMap;
    WriteField(out, "parameter", NameOf(design.parameter, scene));
    if (design.min) WriteField(out, "min", *design.min - design.moved);
    if (design.max) WriteField(out, "max", *design.max - design.moved);
    *out << YAML::EndMap;
  }
  *out << YAML::EndSeq;
}

// Writes a list of terms or edges under a key, unless it is empty.
template <typename Term>
void WriteTerms(YAML::Emitter* out, const char* key, const Scene& scene, const std::vector<Term>& terms,
                void (*write)(YAML::Emitter*, const Scene&, const Term&)) {
  if (terms.empty()) return;
  *out << YAML::Key << key << YAML::Value << YAML::BeginSeq;
  for (const Term& term : terms) write(out, scene, term);
  *out << YAML::EndSeq;
}

void WriteObjective(YAML::Emitter* out, const Scene& scene) {
  *out << YAML::Key << "objective" << YAML::Value << YAML::BeginMap << YAML::Key << "terminal" << YAML::Value
       << YAML::BeginSeq;
  for (const TerminalTerm& term : scene.objective.terminal) WriteTerm(out, scene, term);
  *out << YAML::EndSeq;
  WriteField(out, "effort", scene.objective.effort);
  WriteTerms(out, "running", scene, scene.objective.running, WriteRunning);
  WriteTerms(out, "via", scene, scene.objective.via, WriteVia);
  WriteTerms(out, "limits", scene, scene.objective.limits, WriteLimit);
  if (scene.objective.duration) WriteFreeDuration(out, *scene.objective.duration);
  *out << YAML::EndMap;
}

void WriteNoContact(YAML::Emitter* out, const Scene& scene, const NoContact& pair) {
  *out << YAML::Flow << YAML::BeginSeq;
  WriteName(out, scene.bodies[pair.a].name);
  WriteName(out, pair.plane ? scene.planes[pair.b].name : scene.bodies[pair.b].name);
  *out << YAML::EndSeq;
}

}  // namespace

std::string WriteScene(const Scene& scene) {
  const auto error = Validate(scene);
  CHECK(!error) << error->key << ": " << error->message;
  YAML::Emitter out;
  out << YAML::BeginMap;
  WriteName(&out, "name", scene.name);
  WriteField(&out, "duration", scene.duration);
  WriteField(&out, "steps", scene.steps);
  WriteField(&out, "gravity", scene.gravity);
  out << YAML::Key << "bodies" << YAML::Value << YAML::BeginSeq;
  for (const Body& body : scene.bodies) WriteBody(&out, scene, body);
  out << YAML::EndSeq << YAML::Key << "planes" << YAML::Value << YAML::BeginSeq;
  for (const Plane& plane : scene.planes) WritePlane(&out, scene, plane);
  out << YAML::EndSeq;
  WriteTerms(&out, "segments", scene, scene.segments, WriteSegment);
  WriteTerms(&out, "polygons", scene, scene.polygons, WritePolygon);
  WriteTerms(&out, "arcs", scene, scene.arcs, WriteArc);
  WriteTerms(&out, "pockets", scene, scene.pockets, WritePocket);
  if (scene.table) WriteTable(&out, *scene.table);
  WriteTerms(&out, "forces", scene, scene.forces, WriteForce);
  WriteContact(&out, scene.contact);
  WriteMaterials(&out, scene);
  if (scene.num_controlled() > 0) WriteControl(&out, scene);
  WriteObjective(&out, scene);
  WriteTerms(&out, "no_contact", scene, scene.no_contact, WriteNoContact);
  WriteOptimize(&out, scene);
  const bool starts = scene.optimize == Optimize::kVelocity || scene.optimize == Optimize::kPosition;
  if (starts && !scene.free.empty()) WriteNames(&out, "free", scene, scene.free);
  if (!scene.free_spin.empty()) WriteNames(&out, "free_spin", scene, scene.free_spin);
  out << YAML::EndMap;
  return std::string(out.c_str()) + '\n';
}

}  // namespace saltus
