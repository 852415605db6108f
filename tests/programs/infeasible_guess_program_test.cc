// Output of saltus_solve for a run from a guess that does not meet the constraints.
#include <gmock/gmock.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "programs/run_program.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using testing::Not;

constexpr char kHardFromRest[] = R"(name: hard_from_rest
duration: 1
steps: 50
gravity: [0, -1]
bodies:
  - {name: a, radius: 0.1, mass: 1, position: [0, 1], velocity: [1, 0]}
  - {name: b, radius: 0.1, mass: 1, position: [0.5, 1]}
planes: [{name: ground, point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.9}
control: {bodies: [a], initial: [[0, 0]]}
objective:
  terminal: [{body: b, quantity: position, target: [1, 0.6], hard: true}]
  effort: 0.1
optimize: control
)";

TEST(InfeasibleGuessProgram, AnAnswerThatMeetsTheConstraintsIsExitCodeZero) {
  const std::string file = TempFileWith("hard_from_rest.yaml", kHardFromRest);
  const std::string command =
      "saltus_solve --progress=none --contact=event --solver=ceres_phases,mode_search --scene=" + file;
  const Outcome text = RunProgramIn(300, command);
  EXPECT_EQ(text.exit_code, 0) << text.errors;
  EXPECT_THAT(text.output, Not(HasSubstr("worse")));
  EXPECT_THAT(text.output, HasSubstr("the initial guess does not meet the constraints"));
  const Outcome outcome = RunProgram(command + " --json");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  for (const json& run : json::parse(outcome.output)["runs"]) {
    EXPECT_EQ(run["termination"], "converged");
    EXPECT_EQ(run["initial_loss"].get<double>(), 0);
    EXPECT_NEAR(run["exact_final_state"][1][0].get<double>(), 1, 1e-7);
    EXPECT_NEAR(run["exact_final_state"][1][1].get<double>(), 0.6, 1e-7);
  }
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace saltus
