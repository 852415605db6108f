// Scenes as Python sees them: made of the text of a scene file, and read only.
#include <pybind11/stl.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <string>
#include <vector>

#include "arrays.h"
#include "base/number_text.h"
#include "convert.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "saltus/scene/scene_file.h"
#include "scene/path_motion.h"

namespace saltus::python {
namespace {

Scene ParseOrThrow(const std::string& text, const std::string& name) {
  std::variant<Scene, SceneFileError> parsed = ParseScene(text, name);
  if (const auto* error = std::get_if<SceneFileError>(&parsed)) Raise(*error);
  return std::get<Scene>(std::move(parsed));
}

// Converts text of WriteScene(): quoted scalars are text; others a number or a truth value, if they read as one.
py::object NodeToPython(const YAML::Node& node) {
  if (node.IsMap()) {
    py::dict dict;
    for (const auto& entry : node) dict[py::str(entry.first.Scalar())] = NodeToPython(entry.second);
    return dict;
  }
  if (node.IsSequence()) {
    py::list list;
    for (const YAML::Node& child : node) list.append(NodeToPython(child));
    return list;
  }
  if (node.IsNull()) return py::none();
  const bool quoted = node.Tag() == "!";
  if (int whole; !quoted && YAML::convert<int>::decode(node, whole)) return py::int_(whole);
  if (double number; !quoted && YAML::convert<double>::decode(node, number)) return py::float_(number);
  // Not of what older YAML takes for one: y is a component, and may be a name.
  if (!quoted && (node.Scalar() == "true" || node.Scalar() == "false")) return py::bool_(node.Scalar() == "true");
  return py::str(node.Scalar());
}

std::vector<std::string> NamesOf(const Scene& scene, const std::vector<int>& bodies) {
  std::vector<std::string> names;
  for (const int body : bodies) names.push_back(scene.bodies[body].name);
  return names;
}

std::vector<int> AllBodies(const Scene& scene) {
  std::vector<int> bodies(scene.bodies.size());
  for (size_t i = 0; i < bodies.size(); ++i) bodies[i] = static_cast<int>(i);
  return bodies;
}

// Checks the state of a body with a path, which starts where and as fast as that begins; a velocity of zero is that of
// fixed bodies in scene files.
void CheckOnPath(const Body& body, const Vec2d& found, const std::string& place, bool is_velocity) {
  constexpr double kSame = 1e-9;
  const PathMotion::Point start = PathMotion(*body.path).SampleAt(0);
  const Vec2d expected = is_velocity ? start.velocity : start.position;
  if ((found - expected).norm() <= kSame * std::max(1.0, expected.norm()) || (is_velocity && found.isZero(0))) return;
  const auto text = [](const Vec2d& of) { return "[" + ToText(of[0], 10) + ", " + ToText(of[1], 10) + "]"; };
  throw py::value_error(place + ": found " + text(found) + ", expected " + text(expected) +
                        ", with which the path of '" + body.name + "' begins");
}

// Returns the scene with another initial state: positions and velocities (B x 2), angles and angular velocities (B), or
// the present ones for None. With `by_control` its decision variables are the control, whatever they were.
Scene StartingAt(Scene scene, const py::object& position, const py::object& velocity, const py::object& angle,
                 const py::object& angular_velocity, bool by_control) {
  if (by_control) scene.optimize = Optimize::kControl;
  const int bodies = scene.num_bodies();
  const auto set = [&](const py::object& given, const char* name, Vec2d Body::*member) {
    if (given.is_none()) return;
    const Array read = ReadArray(given, name, {bodies, 2});
    for (int i = 0; i < bodies; ++i) {
      Body& body = scene.bodies[i];
      const Vec2d found(read.data()[2 * i], read.data()[2 * i + 1]);
      if (body.path) {
        CheckOnPath(body, found, std::string(name) + '[' + std::to_string(i) + ']', member == &Body::velocity);
      } else {
        body.*member = found;
      }
    }
  };
  const auto turn = [&](const py::object& given, const char* name, double Body::*member) {
    if (given.is_none()) return;
    const Array read = ReadArray(given, name, {bodies});
    for (int i = 0; i < bodies; ++i) scene.bodies[i].*member = read.data()[i];
  };
  set(position, "position", &Body::position);
  set(velocity, "velocity", &Body::velocity);
  turn(angle, "angle", &Body::angle);
  turn(angular_velocity, "angular_velocity", &Body::angular_velocity);
  if (const std::optional<SceneError> error = Validate(scene)) throw py::value_error(error->ToString());
  return scene;
}

// The scene with the parameters that a run has found, and the initial state, where that is free. `json` has keys of
// saltus_solve --json.
Scene StartingFromRun(Scene scene, const std::string& json) {
  try {
    StartFrom("run", SolutionOf("run", Json::parse(json), scene), &scene);
  } catch (const InputError& error) {
    throw py::value_error(error.what());
  }
  return scene;
}

Array VectorsOf(const Scene& scene, Vec2d Body::*member) {
  Array array(Shape{scene.num_bodies(), 2});
  for (int i = 0; i < scene.num_bodies(); ++i) {
    std::copy_n((scene.bodies[i].*member).data(), 2, array.mutable_data() + 2 * i);
  }
  return array;
}

Array NumbersOf(const Scene& scene, double Body::*member) {
  Array array(Shape{scene.num_bodies()});
  for (int i = 0; i < scene.num_bodies(); ++i) array.mutable_data()[i] = scene.bodies[i].*member;
  return array;
}

}  // namespace

void BindScene(py::module_* module) {
  py::class_<Scene>(*module, "Scene")
      .def(py::init(&ParseOrThrow), py::arg("text"), py::arg("name"))
      .def("_text", &WriteScene)
      .def("_to_dict", [](const Scene& scene) { return NodeToPython(YAML::Load(WriteScene(scene))); })
      .def(
          "__eq__", [](const Scene& a, const Scene& b) { return a == b; }, py::is_operator())
      .def_readonly("name", &Scene::name)
      .def_readonly("duration", &Scene::duration)
      .def_readonly("steps", &Scene::steps)
      .def_property_readonly("dt", &Scene::dt)
      .def_property_readonly("optimize", [](const Scene& scene) { return OptimizeToString(scene.optimize); })
      .def_property_readonly("bodies", [](const Scene& scene) { return NamesOf(scene, AllBodies(scene)); })
      .def_property_readonly("controlled", [](const Scene& scene) { return NamesOf(scene, scene.control.bodies); })
      .def_property_readonly("turned", [](const Scene& scene) { return NamesOf(scene, scene.control.torque_bodies); })
      .def_property_readonly("position", [](const Scene& scene) { return VectorsOf(scene, &Body::position); })
      .def_property_readonly("velocity", [](const Scene& scene) { return VectorsOf(scene, &Body::velocity); })
      .def_property_readonly("spins", &Scene::Spins)
      .def_property_readonly("angle", [](const Scene& scene) { return NumbersOf(scene, &Body::angle); })
      .def_property_readonly("angular_velocity",
                             [](const Scene& scene) { return NumbersOf(scene, &Body::angular_velocity); });
  module->def("starting_from_run", &StartingFromRun, py::arg("scene"), py::arg("json"));
  module->def("starting_at",
              &StartingAt,
              py::arg("scene"),
              py::arg("position"),
              py::arg("velocity"),
              py::arg("angle"),
              py::arg("angular_velocity"),
              py::arg("by_control"));
}

}  // namespace saltus::python
