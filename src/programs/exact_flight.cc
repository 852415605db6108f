#include "programs/exact_flight.h"

#include <glog/logging.h>

#include <algorithm>
#include <memory>

namespace saltus {
namespace {

// The scene with the discs at hand only: what touches, and nothing to optimise.
Scene PartOf(const Scene& scene, const std::vector<int>& discs) {
  Scene part = scene;
  part.bodies.clear();
  part.control = {};
  part.objective = {};
  part.optimize = Optimize::kNone;
  part.free.clear();
  part.free_spin.clear();
  part.no_contact.clear();
  part.steps = 1;
  std::vector<int> place(scene.bodies.size(), -1);
  for (const int disc : discs) {
    place[disc] = part.num_bodies();
    part.bodies.push_back(scene.bodies[disc]);
  }
  for (const NoContact& pair : scene.no_contact) {
    const int a = place[pair.a], b = pair.plane ? pair.b : place[pair.b];
    if (a >= 0 && b >= 0) part.no_contact.push_back({a, b, pair.plane});
  }
  return part;
}

}  // namespace

ExactFlight::ExactFlight(const Contact& model, const Scene& scene) : model_(model), scene_(scene) {}

void ExactFlight::SetTouching(const std::vector<char>& touches) {
  CHECK_EQ(touches.size(), scene_.bodies.size());
  discs_.clear();
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (touches[i]) discs_.push_back(i);
  }
  part_ = PartOf(scene_, discs_);
}

std::vector<double> ExactFlight::Fly(std::span<const double> x, std::span<const double> force, double time) const {
  Scene part = part_;
  part.duration = time;
  std::vector<double> next(x.begin(), x.end());
  if (!WhyNotApplicable(model_, part).empty()) return next;
  const std::unique_ptr<Simulator> simulator = MakeSimulator(model_, part, Precision::kDouble);
  const std::size_t size = simulator->body_size();
  std::vector<double> from, pushes;
  for (const int disc : discs_) {
    from.insert(from.end(), &x[disc * size], &x[disc * size] + size);
    pushes.insert(pushes.end(), &force[2 * disc], &force[2 * disc] + 2);
  }
  std::vector<double> to(from.size());
  simulator->Step(from, pushes, to);
  for (int i = 0, flown = 0; i < scene_.num_bodies(); ++i) {
    const std::span<double> state = std::span(next).subspan(i * size, size);
    if (flown < part.num_bodies() && discs_[flown] == i) {
      std::ranges::copy(std::span(to).subspan(flown++ * size, size), state.begin());
    } else {
      FlyFreely(i, force, time, state);
    }
  }
  return next;
}

void ExactFlight::FlyFreely(int disc, std::span<const double> force, double time, std::span<double> state) const {
  const Body& body = scene_.bodies[disc];
  if (body.fixed) return;
  for (int j = 0; j < 2; ++j) {
    const double acceleration = force[2 * disc + j] * (1 / body.mass) + scene_.gravity[j];
    state[j] += time * (state[2 + j] + (0.5 * time) * acceleration);
    state[2 + j] += time * acceleration;
  }
  if (state.size() > 4) state[4] += time * state[5];
}

}  // namespace saltus
