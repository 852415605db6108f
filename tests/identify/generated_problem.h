// Recordings whose parameters are known: discs in a box, with 2 to 10 impacts, noise and outliers.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "saltus/identify/identify.h"
#include "saltus/simulate/registry.h"

namespace saltus {

class GeneratedRandom {
 public:
  explicit GeneratedRandom(uint64_t seed) : engine_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) / 9007199254740992.0);
  }
  double Normal() {
    const double radius = std::sqrt(-2 * std::log(Uniform(1e-300, 1)));
    return radius * std::cos(Uniform(0, 6.283185307179586));
  }
  int Integer(int low, int high) { return static_cast<int>(Uniform(low, high + 1)); }

 private:
  std::mt19937_64 engine_;
};

struct GeneratedProblem {
  Scene truth;                    // its initial state too
  Scene guess;                    // parameters 30 % off
  std::vector<Unknown> unknowns;  // restitution, friction if there is any, masses but the first
  Recording recording;
  std::vector<bool> outlier;  // of each sample
  int impacts = 0;
};

inline Scene DiscsInABox(GeneratedRandom* random) {
  Scene scene;
  scene.name = "discs_in_a_box";
  scene.duration = 4;
  scene.steps = 400;
  if (random->Uniform(0, 1) < 0.5) scene.gravity = {0, -random->Uniform(1, 9.8)};
  scene.planes = {
      {"left", {-1, 0}, {1, 0}}, {"right", {1, 0}, {-1, 0}}, {"floor", {0, -1}, {0, 1}}, {"ceiling", {0, 1}, {0, -1}}};
  const int count = random->Integer(1, 4);
  while (scene.num_bodies() < count) {
    Body body{.name = "disc" + std::to_string(scene.num_bodies() + 1), .radius = random->Uniform(0.06, 0.15)};
    body.mass = random->Uniform(0.5, 2);
    body.position = {random->Uniform(-0.8, 0.8), random->Uniform(-0.8, 0.8)};
    const double angle = random->Uniform(0, 6.28), speed = random->Uniform(1, 3);
    body.velocity = {speed * std::cos(angle), speed * std::sin(angle)};
    const bool free = std::all_of(scene.bodies.begin(), scene.bodies.end(), [&](const Body& other) {
      return (other.position - body.position).norm() > other.radius + body.radius + 0.1;
    });
    if (free) scene.bodies.push_back(body);
  }
  scene.contact.restitution = random->Uniform(0.5, 0.95);
  if (random->Uniform(0, 1) < 0.5) scene.contact.friction = random->Uniform(0.05, 0.3);
  return scene;
}

// The impacts of a scene's exact motion, s; empty if a contact lasts, as only impacts are wanted.
inline std::vector<double> ImpactTimes(const Scene& scene) {
  const auto simulator = MakeSimulator("event", scene, Precision::kDouble);
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()))) return {};
  std::vector<double> times;
  for (const StepTouch& at : simulator->touches()) {
    if (at.touch.kind != ContactKind::kImpact) break;
    times.push_back(at.step * simulator->step() + at.touch.time);
  }
  return times;
}

// Measures every disc about 60 times a second, at times that the time grid does not know.
inline void Measure(double noise, double outliers, GeneratedRandom* random, GeneratedProblem* problem) {
  const Scene& scene = problem->truth;
  Scene fine = scene;
  const int count = std::max(12, static_cast<int>(60 * scene.duration));
  fine.steps = 7 * count;
  const auto simulator = MakeSimulator("event", fine, Precision::kDouble);
  simulator->Rollout(InitialState(fine), InitialControl(fine, fine.steps));
  std::vector<double> x(simulator->state_size());
  for (int i = 0; i < count; ++i) {
    const int k = 7 * i + 3;
    simulator->GetState(k, x);
    for (int body = 0; body < scene.num_bodies(); ++body) {
      Sample sample{.time = k * simulator->step(), .body = body, .sigma = noise};
      const bool wrong = random->Uniform(0, 1) < outliers;
      const double spread = wrong ? 30 * noise : noise;
      sample.position = {x[4 * body] + spread * random->Normal(), x[4 * body + 1] + spread * random->Normal()};
      problem->recording.samples.push_back(sample);
      problem->outlier.push_back(wrong);
    }
  }
}

inline GeneratedProblem GenerateProblem(uint64_t seed, double noise = 2e-3, double outliers = 0.05) {
  GeneratedRandom random(seed);
  GeneratedProblem problem;
  problem.recording.name = "generated";
  while (true) {
    problem.truth = DiscsInABox(&random);
    const std::vector<double> times = ImpactTimes(problem.truth);
    const int wanted = random.Integer(2, 10);
    if (static_cast<int>(times.size()) <= wanted) continue;
    problem.impacts = wanted;
    // Not so near an impact that it could be missed.
    problem.truth.duration = 0.5 * (times[wanted - 1] + times[wanted]);
    if (times[wanted] - times[wanted - 1] < 0.02 || problem.truth.duration < 0.4) continue;
    problem.truth.steps = std::max(40, static_cast<int>(100 * problem.truth.duration));
    break;
  }
  Measure(noise, outliers, &random, &problem);
  problem.unknowns = {{Unknown::Kind::kRestitution}};
  if (problem.truth.contact.friction > 0) problem.unknowns.push_back({Unknown::Kind::kFriction});
  for (int i = 1; i < problem.truth.num_bodies(); ++i) problem.unknowns.push_back({Unknown::Kind::kMass, i});
  problem.guess = problem.truth;
  const auto off = [&] { return random.Uniform(0, 1) < 0.5 ? 0.7 : 1.3; };
  problem.guess.contact.restitution = std::min(0.99, off() * problem.truth.contact.restitution);
  problem.guess.contact.friction *= off();
  for (int i = 1; i < problem.guess.num_bodies(); ++i) problem.guess.bodies[i].mass *= off();
  for (Body& body : problem.guess.bodies) body.velocity = {0, 0};
  return problem;
}

// The position of a ball that falls from rest at `height` and moves on sideways at `speed`, by the formulas of free
// fall.
inline Vec2d BouncingBallAt(double time, const Scene& scene) {
  const Body& ball = scene.bodies[0];
  const double g = -scene.gravity[1], e = scene.contact.restitution;
  double y = ball.position[1], v = 0, rest = time;
  while (true) {
    const double fall = (v + std::sqrt(v * v + 2 * g * (y - ball.radius))) / g;
    if (fall > rest) return {ball.position[0] + ball.velocity[0] * time, y + v * rest - g * rest * rest / 2};
    rest -= fall;
    v = -e * (v - g * fall);
    y = ball.radius;
  }
}

// A ball that bounces on a floor, measured at so many random times, perhaps once within a flight. Restitution and
// gravity are unknown. Samples that are wrong miss the ball by 30 times as much as the others.
inline GeneratedProblem FewSamples(uint64_t seed, int samples, double outliers, bool states_sigma) {
  GeneratedRandom random(seed);
  GeneratedProblem problem;
  Scene& scene = problem.truth;
  scene.name = "few_samples";
  scene.duration = 1.5;
  scene.steps = 100;
  scene.gravity = {0, -random.Uniform(8, 12)};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, random.Uniform(0.8, 1.2)}}};
  scene.bodies[0].velocity = {0.5, 0};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  scene.contact.restitution = random.Uniform(0.6, 0.85);
  problem.recording.name = "few";
  std::vector<double> times(samples);
  for (double& time : times) time = random.Uniform(0, scene.duration);
  std::sort(times.begin(), times.end());
  constexpr double kNoise = 2e-3;
  for (const double time : times) {
    const bool wrong = random.Uniform(0, 1) < outliers;
    const double spread = wrong ? 30 * kNoise : kNoise, x = random.Normal(), y = random.Normal();
    problem.recording.samples.push_back({.time = time,
                                         .body = 0,
                                         .position = BouncingBallAt(time, scene) + spread * Vec2d(x, y),
                                         .sigma = states_sigma ? kNoise : 0});
    problem.outlier.push_back(wrong);
  }
  problem.unknowns = {{Unknown::Kind::kRestitution}, {Unknown::Kind::kGravity, -1, 1}};
  problem.guess = scene;
  problem.guess.contact.restitution = 0.8;
  problem.guess.gravity = {0, -9};
  problem.guess.bodies[0].position = {0, 1};
  problem.guess.bodies[0].velocity = {0.4, 0.2};
  return problem;
}

// A disc that is fast in a box without gravity, about five impacts a second for so many seconds, restitution 1 but for
// a little; two of a hundred samples are wrong.
inline GeneratedProblem LongProblem(double seconds) {
  GeneratedProblem problem;
  Scene& scene = problem.truth;
  scene.name = "long";
  scene.duration = seconds;
  scene.steps = static_cast<int>(60 * seconds);
  scene.bodies = {{.name = "ball", .radius = 0.05, .mass = 0.3, .velocity = {8, 5}}};
  scene.planes = {
      {"left", {-1, 0}, {1, 0}}, {"right", {1, 0}, {-1, 0}}, {"floor", {0, -1}, {0, 1}}, {"ceiling", {0, 1}, {0, -1}}};
  scene.contact.restitution = 1 - 0.02 * 60 / std::max(60.0, seconds);
  GeneratedRandom random(7);
  problem.recording.name = "long";
  Measure(1e-3, 0.02, &random, &problem);
  problem.unknowns = {{Unknown::Kind::kRestitution}};
  problem.guess = scene;
  problem.guess.contact.restitution = 0.9;
  return problem;
}

inline double TrueValue(const GeneratedProblem& problem, const Unknown& unknown) {
  if (unknown.kind == Unknown::Kind::kRestitution) return problem.truth.contact.restitution;
  if (unknown.kind == Unknown::Kind::kFriction) return problem.truth.contact.friction;
  if (unknown.kind == Unknown::Kind::kGravity) return problem.truth.gravity[unknown.component];
  return problem.truth.bodies[unknown.body].mass;
}

}  // namespace saltus
