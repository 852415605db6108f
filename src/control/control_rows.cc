#include "saltus/control/control_rows.h"

#include <algorithm>

namespace saltus {
namespace {

// Calls visit(index in rows, index in the control, radius of the disc for a torque, else 1) for each number of one
// interval.
template <typename Visit>
void ForEachNumber(const Scene& scene, const Visit& visit) {
  const std::vector<int>&bodies = scene.control.bodies, &turned = scene.control.torque_bodies;
  const int columns = ControlColumns(scene);
  for (int c = 0; c < scene.num_controlled(); ++c) {
    for (int j = 0; j < 2; ++j) visit(c * columns + j, 2 * c + j, 1.0);
  }
  for (int t = 0; t < scene.num_torques(); ++t) {
    const auto c = std::find(bodies.begin(), bodies.end(), turned[t]) - bodies.begin();
    visit(static_cast<int>(c) * columns + 2, static_cast<int>(scene.TorqueIndex(0, t)), scene.bodies[turned[t]].radius);
  }
}

std::vector<double> ToRows(const Scene& scene, std::span<const double> control, bool gradient) {
  const std::size_t width = scene.control_width(), size = ControlColumns(scene) * scene.num_controlled();
  if (width == 0) return {};
  std::vector<double> rows(control.size() / width * size, 0.0);
  for (std::size_t k = 0; k < control.size() / width; ++k) {
    ForEachNumber(scene, [&](int row, int entry, double radius) {
      const double number = control[k * width + entry];
      rows[k * size + row] = gradient ? number / radius : radius * number;
    });
  }
  return rows;
}

}  // namespace

int ControlColumns(const Scene& scene) { return scene.num_torques() > 0 ? 3 : 2; }

std::string ValidateControlRows(const Scene& scene, std::span<const double> rows) {
  const std::size_t size = ControlColumns(scene) * static_cast<std::size_t>(scene.num_controlled());
  if (size == 0 ? !rows.empty() : rows.size() % size != 0) {
    return "found " + std::to_string(rows.size()) + " numbers, expected a multiple of " + std::to_string(size);
  }
  const std::vector<int>& turned = scene.control.torque_bodies;
  for (std::size_t i = 2; scene.num_torques() > 0 && i < rows.size(); i += 3) {
    const int body = scene.control.bodies[i / 3 % scene.num_controlled()];
    if (rows[i] == 0 || std::find(turned.begin(), turned.end(), body) != turned.end()) continue;
    return "found a torque on " + scene.bodies[body].name + " in interval " + std::to_string(i / size) +
           ", expected 0: it is not turned";
  }
  return "";
}

std::vector<double> RowsOfControl(const Scene& scene, std::span<const double> control) {
  return ToRows(scene, control, /*gradient=*/false);
}

std::vector<double> RowsOfGradient(const Scene& scene, std::span<const double> gradient) {
  return ToRows(scene, gradient, /*gradient=*/true);
}

std::vector<double> ControlOfRows(const Scene& scene, std::span<const double> rows) {
  const std::size_t width = scene.control_width(), size = ControlColumns(scene) * scene.num_controlled();
  if (size == 0) return {};
  std::vector<double> control(rows.size() / size * width);
  for (std::size_t k = 0; k < rows.size() / size; ++k) {
    ForEachNumber(
        scene, [&](int row, int entry, double radius) { control[k * width + entry] = rows[k * size + row] / radius; });
  }
  return control;
}

}  // namespace saltus
