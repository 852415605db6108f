#include "programs/scene_panel.h"

#include <algorithm>

#include "programs/outlines.h"

namespace saltus {
namespace {

constexpr int kMostPaths = 40;
constexpr size_t kMostPoints = 2000;  // of a path

}  // namespace

Panel ScenePanel(const Scene& scene, const std::string& title) {
  Panel panel;
  panel.title = title;
  panel.x.label = "x (m)";
  panel.y.label = "y (m)";
  panel.equal_aspect = true;
  for (const Body& body : scene.bodies) {
    panel.circles.push_back({{body.position[0], body.position[1]}, body.radius, "#555555", 0.25});
  }
  for (const Plane& plane : scene.planes) {
    panel.half_planes.push_back({{plane.point[0], plane.point[1]}, {plane.normal[0], plane.normal[1]}});
  }
  panel.outlines = OutlinesOf(scene);
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.component || term.quantity != TerminalTerm::Quantity::kPosition) continue;
    panel.circles.push_back({{term.target[0], term.target[1]}, 0.03, "#000000", 1.0});
  }
  return panel;
}

void AddPaths(const Scene& scene, const Motion& motion, const std::string& label, const std::string& colour, Dash dash,
              Panel* panel) {
  const size_t width = 4 * scene.bodies.size(), stride = motion.times.size() / kMostPoints + 1;
  int drawn = 0;
  for (size_t i = 0; i < scene.bodies.size() && drawn < kMostPaths; ++i) {
    if (scene.bodies[i].fixed) continue;
    ++drawn;
    Series path{.label = label, .x = {}, .y = {}, .colour = colour, .dash = dash};
    for (size_t k = 0; k < motion.times.size(); ++k) {
      if (k % stride != 0 && k + 1 != motion.times.size()) continue;
      path.x.push_back(motion.states[k * width + 4 * i]);
      path.y.push_back(motion.states[k * width + 4 * i + 1]);
    }
    panel->series.push_back(std::move(path));
  }
}

}  // namespace saltus
