// A bag of discs, some of whose steps are not resolved into impacts, as a user sees it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "programs/run_program.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

constexpr double kRadius = 0.1;

// A scene file with 36 discs that fall into the gaps of those below.
std::string BagFile() {
  const std::string path = TempFile("bag.yaml");
  std::ostringstream discs;
  for (int i = 0; i < 36; ++i) {
    const double x = kRadius * (1 + 2.05 * (i % 6) + i / 6 % 2), y = kRadius * (1 + 2.05 * (i / 6));
    discs << "  - {name: d" << i << ", radius: " << kRadius << ", mass: 1, position: [" << x << ", " << y << "]}\n";
  }
  std::ofstream(path) << "name: bag\n"
                         "duration: 0.2\n"
                         "steps: 40\n"
                         "gravity: [0, -9.8]\n"
                         "bodies:\n"
                      << discs.str()
                      << "planes:\n"
                         "  - {name: ground, point: [0, 0], normal: [0, 1]}\n"
                         "  - {name: left, point: [0, 0], normal: [1, 0]}\n"
                         "  - {name: right, point: [1.4, 0], normal: [-1, 0]}\n"
                         "contact: {restitution: 0.3, friction: 0.3, stiffness: 3.0e+4}\n"
                         "objective: {terminal: [{body: d0, quantity: position, target: [0, 0]}]}\n"
                         "optimize: velocity\n"
                         "free: [d0]\n";
  return path;
}

std::string Bag() { return " --scene=" + BagFile() + " --progress=none --json "; }

// The motion is there, and that it is not exact is said.
TEST(CrowdOutput, HasAMotionAndNoExactLoss) {
  const Outcome outcome = RunProgram("saltus_solve" + Bag() + "--contact=event,compliant_warp --solver=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json runs = json::parse(outcome.output)["runs"];
  ASSERT_EQ(runs.size(), 2u);
  for (const json& run : runs) {
    EXPECT_EQ(run["termination"], "converged");
    EXPECT_TRUE(run.contains("loss"));
    EXPECT_FALSE(run.contains("exact_loss"));
    EXPECT_FALSE(run.contains("exact_final_state"));
    ASSERT_EQ(run["final_state"].size(), 36u);
    for (const json& disc : run["final_state"]) EXPECT_GT(disc[1].get<double>(), 0.9 * kRadius);
    if (run["contact"] != "event") continue;
    EXPECT_THAT(run["reason"].get<std::string>(), HasSubstr("time-stepping fallback"));
  }
}

// The exact run has the end of its motion with fallback steps, which the program reports without another rollout.
TEST(CrowdOutput, EndsAsTheRolloutOfTheExactModel) {
  const Scene scene = std::get<Scene>(LoadSceneFile(BagFile()));
  const auto simulator = MakeSimulator("event", scene, Precision::kDouble);
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), {}));
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);

  const ExactRun exact = SimulateExactly(scene, InitialState(scene), {});
  EXPECT_FALSE(exact.ok);
  EXPECT_EQ(exact.end, ToInitial(end, scene.num_bodies()));

  const Outcome outcome = RunProgram("saltus_solve" + Bag() + "--contact=event --solver=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json run = json::parse(outcome.output)["runs"][0];
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = 0; j < 4; ++j) EXPECT_EQ(run["final_state"][i][j], end[4 * i + j]) << i;
  }
  EXPECT_EQ(run["loss"], end[0] * end[0] + end[1] * end[1]);

  // Without a motion there is no end.
  EXPECT_TRUE(SimulateExactly(scene, InitialState(scene), {}, {}, [] { return true; }).end.empty());
}

}  // namespace
}  // namespace saltus
