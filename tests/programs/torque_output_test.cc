// Torques in the files and documents of saltus_solve: a third column, and solutions that come back as they went.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "output/npz.h"
#include "programs/input_files.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

// The second disc is pushed and turned, the first one pushed only.
std::string SceneFile() {
  return TempFileWith("turned.yaml",
                      "name: turned\nduration: 1\nsteps: 8\nbodies:\n"
                      "  - {name: a, radius: 0.3, mass: 1, position: [0, 0]}\n"
                      "  - {name: b, radius: 0.3, mass: 2, position: [2, 0], inertia: solid}\n"
                      "control: {bodies: [a, b], torque: [b], initial: [[0, 0], [0, 0, 0.02]]}\n"
                      "objective:\n  terminal:\n    - {body: b, quantity: angle, target: 1}\n"
                      "    - {body: a, quantity: position, target: [0.5, 0]}\n  effort: 0.1\noptimize: control\n");
}

json JsonOf(const std::string& program, const std::string& flags) {
  const Outcome outcome = RunProgram(program + " --progress=none --json --scene=" + SceneFile() + " " + flags);
  EXPECT_LE(outcome.exit_code, 1) << outcome.errors;
  return json::parse(outcome.output);
}

// In free flight the gradient of the exact model is the exact one, whatever the steps.
TEST(TorqueOutput, WidthSweepsHaveItsExactDerivative) {
  const json audit = JsonOf("saltus_audit", "--contact=event --width_sweep")["audits"][0];
  int found = 0;
  for (const json& sweep : audit["width_sweep"]["sweeps"]) {
    if (sweep["entry"] != "torque/radius b") continue;
    ++found;
    ASSERT_TRUE(sweep["exact"].is_number());
    EXPECT_NE(sweep["exact"], 0);
    EXPECT_NEAR(sweep["gradient"].get<double>(), sweep["exact"].get<double>(), 1e-9);
  }
  EXPECT_EQ(found, 1);
}

TEST(TorqueOutput, ComesBackAsItWent) {
  const std::string directory = TempFile("torque_solutions");
  const json run = JsonOf("saltus_solve", "--solver=ceres_lm --contact=event --output_dir=" + directory)["runs"][0];
  ASSERT_EQ(run["control"].size(), 8u);
  ASSERT_EQ(run["control"][0][0].size(), 2u);
  ASSERT_EQ(run["control"][0][1].size(), 3u);
  EXPECT_GT(run["control"][0][1][2].get<double>(), 0.01);
  const std::string file = directory + "/turned_event_ceres_lm.npz";
  const auto arrays = ReadNpz(file);
  ASSERT_TRUE(arrays.ok()) << arrays.status().message();
  const NpyArray& control = arrays->at("control");
  EXPECT_EQ(control.shape, (std::vector<int64_t>{8, 2, 3}));
  const auto& numbers = std::get<std::vector<double>>(control.data);
  EXPECT_EQ(numbers[2], 0);
  EXPECT_EQ(numbers[5], run["control"][0][1][2].get<double>());

  // From either file it is the same motion.
  const std::string saved = TempFileWith("solution.json", json{{"control", run["control"]}}.dump());
  for (const std::string& from : {saved, file}) {
    const json again = JsonOf("saltus_solve", "--solver=none --contact=event --control=" + from)["runs"][0];
    EXPECT_NEAR(again["exact_loss"], run["exact_loss"].get<double>(), 1e-14);
    EXPECT_NEAR(again["final_state"][1][4], run["final_state"][1][4].get<double>(), 1e-14);
  }
  const std::string page = TempFile("torque.html");
  EXPECT_EQ(RunProgram("saltus_replay " + file + " --output=" + page).exit_code, 0);
  EXPECT_THAT(ContentsOf(page), HasSubstr("\"torques\":"));
  const Motion drawn = ReadReplayFile(file, std::nullopt).motions[0].motion;
  ASSERT_EQ(drawn.rotations.size(), 4 * drawn.times.size());  // angle and angular velocity of two discs
  EXPECT_NEAR(drawn.rotations[drawn.rotations.size() - 2], run["exact_final_state"][1][4].get<double>(), 1e-12);
}

TEST(TorqueOutput, GradientsAreByTheTorque) {
  const json audit = JsonOf("saltus_audit", "--contact=direct");
  const json& reference = audit["reference"]["gradient"]["control"];
  ASSERT_EQ(reference[0][1].size(), 3u);
  // angle(1) = (T - h / 2) h torque / I of the first torque, and the loss is (angle - 1)^2 with effort.
  const double inertia = 0.5 * 2 * 0.09, h = 0.125, angle = 0.5 * 0.02 / inertia;
  const double expected = 2 * (angle - 1) * (1 - h / 2) * h / inertia + 2 * 0.1 * h * 0.02 / 0.09;
  EXPECT_NEAR(reference[0][1][2], expected, 1e-12);
  EXPECT_EQ(audit["audits"][0]["gradient"]["control"][0][1].size(), 3u);
}

TEST(TorqueOutput, SaysWhatIsWrongWithAControl) {
  const auto errors = [](const json& row) {
    const std::string file = TempFileWith("wrong.json", json{{"control", json::array({row})}}.dump());
    const Outcome outcome = RunProgram("saltus_solve --solver=none --scene=" + SceneFile() + " --control=" + file);
    EXPECT_EQ(outcome.exit_code, 2);
    return outcome.errors;
  };
  EXPECT_THAT(errors({{0, 0}, {0, 0}}), HasSubstr("control[0][1]: expected [x, y, torque] of finite numbers"));
  EXPECT_THAT(errors({{0, 0, 0}, {0, 0, 0}}), HasSubstr("control[0][0]: expected [x, y] of finite numbers"));
  EXPECT_THAT(errors({{0, 0}}), HasSubstr("control[0]: expected a list of 2 times"));
}

}  // namespace
}  // namespace saltus
