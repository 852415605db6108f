#include "audit/attribution/perturbed_flow.h"

#include <algorithm>
#include <cmath>

#include "saltus/scene/walls.h"

namespace saltus {

namespace {

constexpr int kStepsAround = 6;  // shown before and after a contact, and half as many again as it lasts

// Returns the normal of a contact at a state.
Vec2d NormalOf(const Scene& scene, const Candidate& pair, const std::vector<double>& x, int body_size) {
  const auto position = [&](int i) { return Vec2d(x[i * body_size], x[i * body_size + 1]); };
  if (!pair.plane) return Separate<double>(position(pair.a), position(pair.b)).normal;
  return Separate(position(pair.a), WallPartsOf(scene)[pair.b].wall).normal;
}

// Simulates the perturbed flow from state x at step `begin` to step `end`.
PerturbedFlow Follow(const Simulator& simulator, std::vector<double> x, const Candidate& pair, const Vec2d& normal,
                     int begin, int end) {
  const int size = simulator.body_size();
  std::vector<double> tangent(x.size(), 0.0), next(x.size()), force(simulator.force_size()), none(force.size(), 0.0);
  for (int j = 0; j < 2; ++j) tangent[pair.a * size + j] = normal[j];
  const auto along = [&](int i) { return normal[0] * tangent[i * size] + normal[1] * tangent[i * size + 1]; };
  const std::vector<double> control = InitialControl(simulator.scene(), simulator.num_steps());
  PerturbedFlow flow;
  StepLinearization linear;
  for (int k = begin;; ++k) {
    flow.times.push_back(k * simulator.step());
    flow.first.push_back(along(pair.a));
    if (!pair.plane) flow.second.push_back(along(pair.b));
    if (k == end) return flow;
    simulator.ExpandForce(control, k, force);
    simulator.Linearize(x, force, /*with_parameters=*/false, &linear);
    linear.Apply(tangent, none, next);
    tangent.swap(next);
    simulator.Step(x, force, next);
    if (simulator.stopped()) return {};
    if (!std::ranges::all_of(next, [](double value) { return std::isfinite(value); })) return {};
    x.swap(next);
  }
}

}  // namespace

PerturbedFlows PerturbAtContact(const Scene& scene, const Contact& contact, const ContactError& error,
                                const StopRequest& stop) {
  const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
  if (simulator == nullptr) return {};
  const int steps = simulator->num_steps(), size = simulator->body_size();
  simulator->set_stop(stop);
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, steps))) return {};
  const int around = kStepsAround + (error.last_step - error.first_step) / 2;
  const int begin = std::max(0, error.first_step - around), end = std::min(steps, error.last_step + 1 + around);
  std::vector<double> x(simulator->state_size());
  simulator->GetState(error.first_step, x);
  const Candidate& pair = error.pair;
  const Vec2d normal = NormalOf(scene, pair, x, size);
  simulator->GetState(begin, x);
  Scene same_steps = scene;
  same_steps.steps = steps;
  const auto exact = MakeSimulator("event", same_steps, Precision::kDouble);
  if (exact == nullptr) return {};
  const int exact_size = exact->body_size();
  std::vector<double> y(exact->state_size());
  for (int i = 0; i < scene.num_bodies(); ++i)
    std::copy_n(&x[i * size], std::min(size, exact_size), &y[i * exact_size]);
  PerturbedFlows flows{Follow(*simulator, x, pair, normal, begin, end), Follow(*exact, y, pair, normal, begin, end)};
  return flows.model.times.empty() || flows.exact.times.empty() ? PerturbedFlows() : flows;
}

}  // namespace saltus
