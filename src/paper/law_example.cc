#include "paper/law_example.h"

#include <ceres/autodiff_cost_function.h>

#include <cmath>

#include "output/interrupt.h"
#include "output/table.h"
#include "physics/random.h"
#include "saltus/dynamics/learned_contact.h"
#include "saltus/identify/identify.h"
#include "tools/parallel.h"

namespace saltus {
namespace {

constexpr double kNoise = 1e-3;  // m
constexpr double kHeights[] = {0.4, 1.0, 2.0, 3.5};
constexpr int kUnits = 3;           // of the network
constexpr double kFastest = 8;      // m/s, about
constexpr double kGuess = 0.5;      // the restitution with which it begins
constexpr int kNodesPerSample = 2;  // 60 samples a second

// e = a / (1 + b v).
struct Softening {
  template <typename T>
  bool operator()(const T* speeds, const T* parameters, T* restitution) const {
    restitution[0] = parameters[0] / (1.0 + parameters[1] * speeds[0]);
    return true;
  }
};

ImpactLaw TrueLaw() {
  ImpactLaw law{.name = "softening", .parameters = {0.9, 0.12}};
  law.function = std::make_shared<ceres::AutoDiffCostFunction<Softening, 1, 2, 2>>(new Softening);
  return law;
}

Scene DropScene(double height) {
  Scene scene;
  scene.name = "drops";
  scene.duration = 1.6;
  scene.steps = 192;
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.05, .mass = 0.3, .position = {0, height}, .velocity = {0.2, 0}}};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  scene.contact.restitution = kGuess;
  return scene;
}

Recording Record(double height, Random* random) {
  const Scene scene = DropScene(height);
  const auto simulator = MakeSimulator(LearnedContact(TrueLaw()), scene, Precision::kDouble);
  Recording recording{Format("dropped from %g m", height), {}};
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()))) return recording;
  std::vector<double> x(simulator->state_size());
  for (int k = kNodesPerSample; k <= simulator->num_steps(); k += kNodesPerSample) {
    simulator->GetState(k, x);
    recording.samples.push_back({.time = std::min(k * simulator->step(), scene.duration),
                                 .position = Vec2d(x[0], x[1]) + kNoise * random->Normal(),
                                 .sigma = kNoise});
  }
  return recording;
}

Figure Draw(const LearnedLaw& learned) {
  Panel panel;
  panel.x.label = "speed of approach (m/s)";
  panel.y.label = "restitution";
  Series law{.label = "learned", .x = {}, .y = {}, .colour = "#D55E00", .width = 3};
  Series truth{.label = "the law that made the recordings", .x = {}, .y = {}, .dash = Dash::kDashed};
  Series low{.label = "95 % confidence", .x = {}, .y = {}, .colour = "#999999"}, high = low;
  for (const LawPoint& at : learned.curve) {
    for (Series* series : {&law, &truth, &low, &high}) series->x.push_back(at.speed);
    law.y.push_back(at.restitution);
    truth.y.push_back(EvaluateLaw(TrueLaw(), at.speed, 0).restitution);
    low.y.push_back(at.restitution - 1.96 * at.restitution_error);
    high.y.push_back(at.restitution + 1.96 * at.restitution_error);
  }
  panel.series = {low, high, law, truth};
  panel.reference_lines.push_back({.value = kGuess, .label = "the start", .colour = "#999999", .dash = Dash::kDotted});
  Figure figure;
  figure.panels = {panel};
  figure.legend = Legend::kBelow;
  return figure;
}

}  // namespace

std::optional<PaperFigure> LearnALaw() {
  Random random(5);
  std::vector<Recording> recordings;
  for (const double height : kHeights) recordings.push_back(Record(height, &random));
  IdentifyOptions options;
  options.law = RestitutionNetwork(kUnits, kFastest, kGuess);
  options.stop = AskedToStop;
  const IdentifyReport report = Identify("event", DropScene(1), recordings, {}, options);
  if (!report.law || report.law->curve.empty()) return std::nullopt;
  double largest = 0;
  for (const LawPoint& at : report.law->curve) {
    largest = std::max(largest, std::abs(at.restitution - EvaluateLaw(TrueLaw(), at.speed, 0).restitution));
  }
  return PaperFigure{
      "learned_law",
      "Restitution by the speed of approach, learned by a network of " + std::to_string(kUnits) + " tanh units from " +
          std::to_string(report.law->impacts) +
          " impacts of a ball that was dropped from four heights and seen 60 times a second with 1 mm of "
          "noise. It " +
          FitVerdictToString(report.verdict) + "; between the slowest and the fastest impact it is off by " +
          Format("%.2g", largest) + " at most.",
      Draw(*report.law)};
}

}  // namespace saltus
