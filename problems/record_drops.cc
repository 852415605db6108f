// Writes the recordings of problems/drops: a ball dropped from four heights on a floor whose restitution falls with the
// speed, seen 60 times a second with 1 mm of noise; and the law that made them.
#include <ceres/autodiff_cost_function.h>

#include <cmath>
#include <iostream>

#include "base/random.h"
#include "base/table.h"
#include "programs/program.h"
#include "saltus/simulate/learned_contact.h"

namespace saltus {
namespace {

constexpr double kNoise = 1e-3;  // m
constexpr double kHeights[] = {0.4, 1.0, 2.0, 3.5};
constexpr int kNodesPerSample = 2;
constexpr double kFastest = 9, kSpeedStep = 0.25;  // m/s, of the law that is written

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

// To a micrometre, as a file need not say more.
double Rounded(double length) { return std::round(1e6 * length) / 1e6; }

Table Record(const Scene& scene, Random* random) {
  Table recording({{"time"}, {"body"}, {"x"}, {"y"}, {"sigma"}});
  const auto simulator = MakeSimulator(LearnedContact(TrueLaw()), scene, Precision::kDouble);
  if (!simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()))) {
    throw OutputError("no motion: " + simulator->FailureReason());
  }
  std::vector<double> x(simulator->state_size());
  for (int k = kNodesPerSample; k <= simulator->num_steps(); k += kNodesPerSample) {
    simulator->GetState(k, x);
    const Vec2d seen = Vec2d(x[0], x[1]) + kNoise * random->Normal();
    recording.AddRow({Rounded(k * simulator->step()), "ball", Rounded(seen[0]), Rounded(seen[1]), kNoise});
  }
  return recording;
}

Table LawByEvaluation() {
  Table law({{"speed"}, {"restitution"}});
  for (double speed = 0; speed <= kFastest; speed += kSpeedStep) {
    law.AddRow({speed, EvaluateLaw(TrueLaw(), speed, 0).restitution});
  }
  return law;
}

int Write(const std::string& folder) {
  Scene scene = LoadScene(ShippedFile("problems/drops/drops.yaml"));
  MakeDirectory(folder);
  Random random(5);
  int number = 0;
  for (const double height : kHeights) {
    scene.bodies[0].position = {0, height};
    WriteTextFile(folder + "/drop_" + std::to_string(++number) + ".csv", Record(scene, &random).ToCsv());
  }
  WriteTextFile(folder + "/law.csv", LawByEvaluation().ToCsv());
  return kDone;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: record_drops DIR" << std::endl;
    return saltus::kWrongInput;
  }
  try {
    return saltus::Write(argv[1]);
  } catch (const std::exception& error) {
    std::cerr << "record_drops: " << error.what() << std::endl;
    return saltus::kAnswerFailed;
  }
}
