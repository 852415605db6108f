// Gradients of the event-driven model with respect to everything, against differences of its own loss, and its energy,
// on random scenes.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <optional>

#include "contact/event/event_run.h"
#include "contact/random_scene.h"
#include "exact/exact_scenes.h"

namespace saltus {
namespace {

using testing::RandomScenes;

constexpr int kScenes = 500;
constexpr double kTolerance = 1e-7;  // of the norm of a block of the gradient
constexpr double kRounding = 1e-9;

// A scene, what it is run from and under, and a loss: slope.x + bend.x^2 / 2 of the final state x.
struct Experiment {
  Scene scene;
  std::vector<double> initial, control;
  std::vector<double> slope, bend;
};

Experiment RandomExperiment(RandomScenes* random) {
  Experiment e;
  Scene& scene = e.scene;
  const int steps[] = {1, 4, 15};
  scene.duration = random->Uniform(0.8, 1.6);
  scene.steps = steps[random->Integer(0, 2)];
  random->AddDiscs(random->Integer(1, 4), 0.2, &scene);
  for (int count = random->Integer(0, 3); count > 0; --count) random->AddPlane(random->Direction(), &scene);
  if (random->Chance(0.7)) scene.gravity = random->InSquare(7);
  if (!scene.planes.empty() && random->Chance(0.3)) scene.gravity = -9.8 * scene.planes[0].normal;
  scene.contact.restitution = random->Chance(0.2) ? 1 : random->Uniform(0.3, 1);
  scene.contact.friction = random->Chance(0.3) ? 0 : random->Uniform(0.01, 0.5);
  e.initial = testing::StartOf(scene);
  e.control = testing::HeldControl(scene);
  for (double& u : e.control) u += random->Uniform(-1, 1);
  for (std::size_t i = 0; i < e.initial.size(); ++i) {
    e.slope.push_back(random->Uniform(-1, 1));
    e.bend.push_back(random->Uniform(0, 1));
  }
  return e;
}

struct Result {
  std::unique_ptr<Simulator> owned;
  Simulator& simulator;
  std::vector<double> end;
  double loss = 0;

  explicit Result(const Experiment& e)
      : owned(testing::MakeEventSimulator(e.scene)), simulator(*owned), end(e.initial.size()) {
    EXPECT_TRUE(simulator.Rollout(e.initial, e.control)) << simulator.FailureReason();
    simulator.GetState(e.scene.steps, end);
    for (std::size_t i = 0; i < end.size(); ++i) loss += end[i] * (e.slope[i] + 0.5 * e.bend[i] * end[i]);
  }
  Sensitivity Gradient(const Experiment& e) {
    std::vector<double> cotangent(end.size());
    for (std::size_t i = 0; i < end.size(); ++i) cotangent[i] = e.slope[i] + e.bend[i] * end[i];
    Sensitivity gradient;
    simulator.Adjoint(cotangent, true, &gradient);
    return gradient;
  }
};

bool SameContacts(const std::vector<StepTouch>& a, const std::vector<StepTouch>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const StepTouch& l, const StepTouch& r) {
    return l.step == r.step && l.touch.candidate == r.touch.candidate && l.touch.mode == r.touch.mode &&
           l.touch.kind == r.touch.kind;
  });
}

// Derivatives that are compared along one random direction.
struct Block {
  std::string name;
  std::vector<double> gradient;
  std::function<void(Experiment*, int i, double change)> move;
};

std::vector<Block> Blocks(const Experiment& e, const Sensitivity& gradient) {
  std::vector<Block> blocks;
  std::vector<double> halves[2];
  std::vector<int> entries[2], moving;
  for (int i = 0; i < e.scene.num_bodies(); ++i) {
    if (!e.scene.bodies[i].fixed) moving.push_back(i);
    for (int j = 0; j < 4 && !e.scene.bodies[i].fixed; ++j) {
      halves[j / 2].push_back(gradient.initial[4 * i + j]);
      entries[j / 2].push_back(4 * i + j);
    }
  }
  for (int half : {0, 1}) {
    blocks.push_back({half == 0 ? "position" : "velocity",
                      halves[half],
                      [index = entries[half]](Experiment* at, int i, double d) { at->initial[index[i]] += d; }});
  }
  const ParameterGradient& p = gradient.parameters;
  blocks.push_back({"control", gradient.control, [](Experiment* at, int i, double d) { at->control[i] += d; }});
  blocks.push_back(
      {"restitution", {p.restitution}, [](Experiment* at, int, double d) { at->scene.contact.restitution += d; }});
  if (e.scene.contact.friction > 0) {
    blocks.push_back(
        {"friction", {p.friction}, [](Experiment* at, int, double d) { at->scene.contact.friction += d; }});
  }
  blocks.push_back(
      {"gravity", {p.gravity[0], p.gravity[1]}, [](Experiment* at, int i, double d) { at->scene.gravity[i] += d; }});
  Block mass{"mass", {}, [moving](Experiment* at, int i, double d) { at->scene.bodies[moving[i]].mass += d; }};
  Block force{"force", {}, [](Experiment* at, int i, double d) {
                for (std::size_t k = i; k < at->control.size(); k += 2 * at->scene.num_controlled())
                  at->control[k] += d;
              }};
  for (int i : moving) {
    mass.gradient.push_back(p.mass[i]);
    force.gradient.insert(force.gradient.end(), {p.force[i][0], p.force[i][1]});
  }
  blocks.push_back(mass);
  blocks.push_back(force);
  return blocks;
}

// A derivative by differences, and how well it is known.
struct Numeric {
  double value, error;
};

// The derivative along `direction` by Richardson's extrapolation, over the width that changes it least when made ten
// times larger or smaller; nothing if small changes change which contacts there are.
std::optional<Numeric> Difference(const Experiment& e, const std::vector<StepTouch>& touches, const Block& block,
                                  const std::vector<double>& direction) {
  std::vector<double> values;
  std::optional<Numeric> best;
  for (double width = 1e-2; width > 0.5e-6; width /= 10) {
    bool same = true;
    const auto loss = [&](double s) {
      if (!same) return 0.0;
      Experiment moved = e;
      for (std::size_t i = 0; i < direction.size(); ++i) block.move(&moved, i, s * direction[i]);
      const Result result(moved);
      same = SameContacts(result.simulator.touches(), touches);
      return result.loss;
    };
    const double value = exact_test::Richardson(loss, width);
    if (!same) continue;
    values.push_back(value);
    const std::size_t n = values.size();
    if (n < 3) continue;
    const double error = std::max(std::abs(values[n - 1] - values[n - 2]), std::abs(values[n - 2] - values[n - 3]));
    if (!best || error < best->error) best = {values[n - 2], error};
    if (best->error <= 1e-9 * std::abs(value)) break;
  }
  return best;
}

struct Counts {
  int compared = 0, left_out = 0, impacts = 0, sustained = 0, sticking = 0;
};

void CompareWithDifferences(int index, const Experiment& e, RandomScenes* random, Counts* counts) {
  Result here(e);
  const std::vector<StepTouch> touches = here.simulator.touches();
  for (const StepTouch& touch : touches) {
    (touch.touch.kind == ContactKind::kImpact ? counts->impacts : counts->sustained) += 1;
    counts->sticking += touch.touch.mode == ContactMode::kStick;
  }
  for (const Block& block : Blocks(e, here.Gradient(e))) {
    std::vector<double> direction;
    double norm = 0, derivative = 0;
    for (double entry : block.gradient) {
      ASSERT_TRUE(std::isfinite(entry)) << block.name << " of scene " << index;
      direction.push_back(random->Sign());
      norm += std::abs(entry);
      derivative += direction.back() * entry;
    }
    const std::optional<Numeric> difference = Difference(e, touches, block, direction);
    const bool sharp = difference && difference->error <= kTolerance * norm + kRounding;
    ++(sharp ? counts->compared : counts->left_out);
    if (!sharp) continue;
    EXPECT_NEAR(derivative, difference->value, kTolerance * norm + kRounding) << block.name << " of scene " << index;
  }
}

TEST(EventGradient, EqualsDifferencesOnRandomScenes) {
  RandomScenes random(1);
  Counts counts;
  for (int i = 0; i < kScenes; ++i) CompareWithDifferences(i, RandomExperiment(&random), &random, &counts);
  EXPECT_LT(counts.left_out, 0.1 * counts.compared);
  EXPECT_GT(counts.impacts, 3 * kScenes);
  EXPECT_GT(counts.sustained, kScenes / 5);
  EXPECT_GT(counts.sticking, kScenes / 5);
}

// Returns the energy that a step adds beyond the work of the forces, J, and the kinetic energy, J.
std::pair<double, double> Gain(const Experiment& e, std::span<const double> force, const std::vector<double>& x,
                               const std::vector<double>& next) {
  double gained = 0, kinetic = 0;
  for (int i = 0; i < e.scene.num_bodies(); ++i) {
    const Body& body = e.scene.bodies[i];
    for (int j = 0; j < 2 && !body.fixed; ++j) {
      const double v = x[4 * i + 2 + j], v_next = next[4 * i + 2 + j];
      gained += 0.5 * body.mass * (v_next * v_next - v * v);
      gained -= (force[2 * i + j] + body.mass * e.scene.gravity[j]) * (next[4 * i + j] - x[4 * i + j]);
      kinetic += 0.5 * body.mass * v_next * v_next;
    }
  }
  return {gained, kinetic};
}

// In every step; where two discs slide along each other, to the accuracy of their arcs.
TEST(EventEnergy, NeverGrowsBeyondTheWorkDone) {
  RandomScenes random(2);
  for (int scene = 0; scene < kScenes; ++scene) {
    const Experiment e = RandomExperiment(&random);
    const Result result(e);
    std::vector<char> arcs(e.scene.steps, 0);
    for (const StepTouch& at : result.simulator.touches()) {
      if (at.touch.kind == ContactKind::kSustained && !at.touch.candidate.plane) arcs[at.step] = 1;
    }
    std::vector<double> x = e.initial, next(x.size()), force(2 * e.scene.num_bodies());
    for (int k = 0; k < e.scene.steps; ++k) {
      result.simulator.GetState(k + 1, next);
      result.simulator.ExpandForce(e.control, k, force);
      const auto [gained, kinetic] = Gain(e, force, x, next);
      ASSERT_LE(gained, (arcs[k] ? 1e-6 : 1e-12) * (1 + kinetic)) << "step " << k << " of scene " << scene;
      x = next;
    }
  }
}

}  // namespace
}  // namespace saltus
