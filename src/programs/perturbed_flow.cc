#include "programs/perturbed_flow.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "base/interrupt.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr int kStepsAround = 6;  // shown before and after a contact, and half as many again as it lasts

// The pair of a contact, and its normal at some state.
struct Place {
  int a = -1, b = -1;  // b: -1 for a wall
  Vec2d normal = Vec2d::Zero();
};

template <typename List>
int IndexOf(const List& list, const std::string& name) {
  for (size_t i = 0; i < list.size(); ++i) {
    if (list[i].name == name) return static_cast<int>(i);
  }
  return -1;
}

Place PlaceOf(const Scene& scene, const ContactError& error, const std::vector<double>& x, int body_size) {
  const auto position = [&](int i) { return Vec2d(x[i * body_size], x[i * body_size + 1]); };
  Place place{.a = IndexOf(scene.bodies, error.a), .b = IndexOf(scene.bodies, error.b)};
  if (place.a < 0) return place;
  if (place.b >= 0) {
    place.normal = Separate<double>(position(place.a), position(place.b)).normal;
    return place;
  }
  const std::vector<WallPart> walls = WallPartsOf(scene);
  const int wall = IndexOf(walls, error.b);
  if (wall >= 0) place.normal = Separate(position(place.a), walls[wall].wall).normal;
  return place;
}

// From state x at step `begin` to step `end`.
PerturbedFlow Follow(const Simulator& simulator, std::vector<double> x, const Place& place, int begin, int end) {
  const int size = simulator.body_size();
  std::vector<double> tangent(x.size(), 0.0), next(x.size()), force(simulator.force_size()), none(force.size(), 0.0);
  for (int j = 0; j < 2; ++j) tangent[place.a * size + j] = place.normal[j];
  const auto along = [&](int i) {
    return place.normal[0] * tangent[i * size] + place.normal[1] * tangent[i * size + 1];
  };
  const std::vector<double> control = InitialControl(simulator.scene(), simulator.num_steps());
  PerturbedFlow flow;
  StepLinearization linear;
  for (int k = begin;; ++k) {
    flow.times.push_back(k * simulator.step());
    flow.first.push_back(along(place.a));
    if (place.b >= 0) flow.second.push_back(along(place.b));
    if (k == end) return flow;
    simulator.ExpandForce(control, k, force);
    simulator.Linearize(x, force, /*with_parameters=*/false, &linear);
    linear.Apply(tangent, none, next);
    tangent.swap(next);
    simulator.Step(x, force, next);
    if (simulator.stopped()) return {};
    if (!std::all_of(next.begin(), next.end(), [](double value) { return std::isfinite(value); })) return {};
    x.swap(next);
  }
}

Series Line(const PerturbedFlow& flow, const std::vector<double>& values, const std::string& colour, Dash dash,
            double width) {
  return {.label = "", .x = flow.times, .y = values, .colour = colour, .dash = dash, .width = width};
}

}  // namespace

PerturbedFlows PerturbAtContact(const Scene& scene, const Contact& contact, const ContactError& error) {
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  if (simulator == nullptr) return {};
  const int steps = simulator->num_steps(), size = simulator->body_size();
  simulator->set_stop(InterruptGuard::GraceIsOver);
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, steps))) return {};
  const int around = kStepsAround + (error.last_step - error.first_step) / 2;
  const int begin = std::max(0, error.first_step - around), end = std::min(steps, error.last_step + 1 + around);
  std::vector<double> x(simulator->state_size());
  simulator->GetState(error.first_step, x);
  const Place place = PlaceOf(scene, error, x, size);
  if (place.a < 0) return {};
  simulator->GetState(begin, x);
  Scene same_steps = scene;
  same_steps.steps = steps;
  const auto exact = MakeSimulator("event", same_steps, Precision::kDouble);
  if (exact == nullptr) return {};
  const int exact_size = exact->body_size();
  std::vector<double> y(exact->state_size());
  for (int i = 0; i < scene.num_bodies(); ++i)
    std::copy_n(&x[i * size], std::min(size, exact_size), &y[i * exact_size]);
  PerturbedFlows flows{Follow(*simulator, x, place, begin, end), Follow(*exact, y, place, begin, end)};
  return flows.model.times.empty() || flows.exact.times.empty() ? PerturbedFlows() : flows;
}

Panel PerturbedFlowPanel(const Scene& scene, const Contact& contact, const ContactError& error) {
  const PerturbedFlows flows = PerturbAtContact(scene, contact, error);
  Panel panel;
  panel.title = contact.name() + ": " + error.a + " displaced, at " + error.b;
  panel.x.label = "time (s)";
  panel.y.label = "displacement along the normal";
  const std::string colour = ColourOf(contact.name());
  for (const auto& [flow, ink, dash] : {std::tuple(&flows.exact, std::string("#000000"), Dash::kDashed),
                                        std::tuple(&flows.model, colour, Dash::kSolid)}) {
    panel.series.push_back(Line(*flow, flow->first, ink, dash, 2.5));
    if (!flow->second.empty()) panel.series.push_back(Line(*flow, flow->second, ink, dash, 1));
  }
  return panel;
}

}  // namespace saltus
