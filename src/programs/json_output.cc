#include "programs/json_output.h"

#include <glog/logging.h>

#include <cmath>
#include <iostream>

#include "saltus/io/json_number.h"

namespace saltus {

Json NumberToJson(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json VectorsToJson(const std::vector<double>& initial, int offset) {
  Json vectors = Json::array();
  for (size_t i = 0; i < initial.size(); i += 4) {
    vectors.push_back({NumberToJson(initial[i + offset]), NumberToJson(initial[i + offset + 1])});
  }
  return vectors;
}

Json ControlToJson(const Scene& scene, const std::vector<double>& control) {
  Json intervals = Json::array();
  const size_t width = 2 * scene.num_controlled();
  for (size_t begin = 0; width > 0 && begin < control.size(); begin += width) {
    Json forces = Json::array();
    for (size_t i = begin; i < begin + width; i += 2) {
      forces.push_back({NumberToJson(control[i]), NumberToJson(control[i + 1])});
    }
    intervals.push_back(std::move(forces));
  }
  return intervals;
}

Json EventsToJson(const std::vector<Event>& events) {
  Json list = Json::array();
  for (const Event& event : events) {
    list.push_back({{"time", event.time}, {"a", event.a}, {"b", event.b}, {"mode", ContactModeToString(event.mode)}});
  }
  return list;
}

Json GradientToJson(const Scene& scene, const Sensitivity& gradient) {
  const ParameterGradient& p = gradient.parameters;
  Json mass = Json::array(), force = Json::array();
  for (double value : p.mass) mass.push_back(NumberToJson(value));
  for (const Vec2d& value : p.force) force.push_back({NumberToJson(value[0]), NumberToJson(value[1])});
  return {{"position", VectorsToJson(gradient.initial, 0)},
          {"velocity", VectorsToJson(gradient.initial, 2)},
          {"control", ControlToJson(scene, gradient.control)},
          {"parameters",
           {{"restitution", NumberToJson(p.restitution)},
            {"friction", NumberToJson(p.friction)},
            {"stiffness", NumberToJson(p.stiffness)},
            {"damping", NumberToJson(p.damping)},
            {"gravity", {NumberToJson(p.gravity[0]), NumberToJson(p.gravity[1])}},
            {"mass", mass},
            {"force", force}}}};
}

void PrintJson(const Json& document, Precision precision) {
  const StatusOr<std::string> text = DumpJson(document, precision == Precision::kFloat ? kFloatDigits : kDoubleDigits);
  CHECK(text.ok()) << text.status().message();
  std::cout << *text << std::endl;
}

}  // namespace saltus
