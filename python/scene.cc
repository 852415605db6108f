// Scenes as Python sees them: made of the text of a scene file, and read only.
#include <pybind11/stl.h>
#include <yaml-cpp/yaml.h>

#include "arrays.h"
#include "convert.h"
#include "saltus/dynamics/simulator.h"
#include "saltus/io/scene_file.h"

namespace saltus::python {
namespace {

Scene ParseOrThrow(const std::string& text, const std::string& name) {
  std::variant<Scene, SceneFileError> parsed = ParseScene(text, name);
  const auto* error = std::get_if<SceneFileError>(&parsed);
  if (error == nullptr) {
    if (std::get<Scene>(parsed).Spins()) {
      throw py::value_error(name + ": discs that spin (inertia), which the programs take and this module does not");
    }
    return std::get<Scene>(std::move(parsed));
  }
  const py::object type = py::module_::import("saltus._scene").attr("SceneError");
  const py::object raised = type(error->file, error->line, error->key, error->message);
  PyErr_SetObject(type.ptr(), raised.ptr());
  throw py::error_already_set();
}

// Of what WriteScene() has written: quoted scalars are text; others a number or a truth value, if they read as one.
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
  if (bool truth; !quoted && YAML::convert<bool>::decode(node, truth)) return py::bool_(truth);
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

// The same scene from another start: positions and velocities (B x 2), or those it has if None. With `by_control` its
// decision variables are the control, whatever they were.
Scene StartingAt(Scene scene, const py::object& position, const py::object& velocity, bool by_control) {
  if (by_control) scene.optimize = Optimize::kControl;
  const Shape shape = {scene.num_bodies(), 2};
  const auto set = [&](const py::object& given, const char* name, Vec2d Body::*member) {
    if (given.is_none()) return;
    const Array read = ReadArray(given, name, shape);
    for (int i = 0; i < scene.num_bodies(); ++i) scene.bodies[i].*member = {read.data()[2 * i], read.data()[2 * i + 1]};
  };
  set(position, "position", &Body::position);
  set(velocity, "velocity", &Body::velocity);
  if (const std::optional<SceneError> error = Validate(scene)) throw py::value_error(error->ToString());
  return scene;
}

Array PositionsOf(const Scene& scene, int offset) {
  const std::vector<double> initial = InitialState(scene);
  Array array(Shape{scene.num_bodies(), 2});
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = 0; j < 2; ++j) array.mutable_data()[2 * i + j] = initial[4 * i + offset + j];
  }
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
      .def_property_readonly("position", [](const Scene& scene) { return PositionsOf(scene, 0); })
      .def_property_readonly("velocity", [](const Scene& scene) { return PositionsOf(scene, 2); });
  module->def(
      "starting_at", &StartingAt, py::arg("scene"), py::arg("position"), py::arg("velocity"), py::arg("by_control"));
}

}  // namespace saltus::python
