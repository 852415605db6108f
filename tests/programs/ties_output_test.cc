// A scene in which the order of impacts at the same time decides, as a user sees it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "programs/run_program.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using testing::Not;
using testing::UnorderedElementsAre;

constexpr const char* kLeft = "  - {name: left, radius: 0.1, mass: 1, position: [0, 0.11]}\n";
constexpr const char* kRight = "  - {name: right, radius: 0.1, mass: 1, position: [0, -0.11]}\n";

// --scene=FILE with the two targets in this order.
std::string SceneWith(const std::string& first, const std::string& second) {
  const std::string path = TempFile("ties.yaml");
  std::ofstream(path) << "name: strikes_two\n"
                         "duration: 1.0\n"
                         "steps: 100\n"
                         "bodies:\n"
                         "  - {name: striker, radius: 0.1, mass: 1, position: [-0.6, 0], velocity: [1.5, 0]}\n"
                      << first << second
                      << "contact: {restitution: 1}\n"
                         "control: {bodies: [striker], initial: [[0.3, 0]]}\n"
                         "objective:\n"
                         "  terminal:\n"
                         "    - {body: left, quantity: position, target: [0.5, 0.5]}\n"
                         "  effort: 0.01\n"
                         "optimize: control\n";
  return " --scene=" + path + " --progress=none ";
}

void ExpectTie(const json& item) {
  ASSERT_EQ(item["ambiguous"].size(), 1u);
  EXPECT_NEAR(item["ambiguous"][0]["time"], 0.28, 0.02);
  EXPECT_THAT(item["ambiguous"][0]["bodies"].get<std::vector<std::string>>(),
              UnorderedElementsAre("striker", "left", "right"));
}

TEST(TiesOutput, Audit) {
  json spread;
  for (const bool swapped : {false, true}) {
    const std::string scene = swapped ? SceneWith(kRight, kLeft) : SceneWith(kLeft, kRight);
    const Outcome outcome = RunProgram("saltus_audit" + scene + "--contact=event,direct_toi --json");
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    const json document = json::parse(outcome.output);
    ExpectTie(document["reference"]);
    ASSERT_EQ(document["audits"].size(), 2u);
    for (const json& audit : document["audits"]) {
      EXPECT_EQ(audit["verdict"], "ambiguous");
      EXPECT_FALSE(audit.contains("relative_error"));
      ExpectTie(audit);
      if (spread.is_null()) spread = audit["loss_spread"];
      for (int i = 0; i < 2; ++i) EXPECT_NEAR(audit["loss_spread"][i], spread[i], 1e-12);
    }
  }
  EXPECT_GT(spread[1].get<double>() - spread[0].get<double>(), 0.05);
  const Outcome table = RunProgram("saltus_audit" + SceneWith(kLeft, kRight) + "--contact=event,direct_toi");
  EXPECT_THAT(table.output, HasSubstr("the order of the impacts of striker, left and right at 0.2"));
  EXPECT_THAT(table.output, HasSubstr("in one order (event)"));
  EXPECT_THAT(table.output, Not(HasSubstr("exact (")));
}

// Under a model that takes both impacts at once, no step leaves the tie.
TEST(TiesOutput, Solve) {
  const std::string command = "saltus_solve" + SceneWith(kLeft, kRight) +
                              "--contact=direct_toi --solver=gd --iterations=1 --learning_rate=1e-9 ";
  const Outcome outcome = RunProgram(command + "--json");
  ASSERT_EQ(outcome.exit_code, 1) << outcome.errors;  // one iteration is no answer
  const json document = json::parse(outcome.output), run = document["runs"][0];
  ExpectTie(run);
  EXPECT_LE(run["loss_spread"][0].get<double>(), run["exact_loss"].get<double>());
  EXPECT_GE(run["loss_spread"][1].get<double>(), run["exact_loss"].get<double>());
  EXPECT_EQ(run["certificate"]["verdict"], "ambiguous");
  ExpectTie(run["certificate"]);
  EXPECT_THAT(RunProgram(command).output, HasSubstr("ambiguous: the order of the impacts of striker, left and right"));
}

TEST(TiesOutput, Sweep) {
  const std::string scene = SceneWith(kLeft, kRight);
  const Outcome gradients =
      RunProgram("saltus_sweep" + scene + "--contact=event --solver=none --sweep='right.position_x=0,0.01' --json");
  ASSERT_EQ(gradients.exit_code, 0) << gradients.errors;
  json points = json::parse(gradients.output)["points"];
  ASSERT_EQ(points.size(), 2u);
  EXPECT_THAT(points[0]["reason"].get<std::string>(), HasSubstr("ambiguous: the order of the impacts of striker"));
  EXPECT_TRUE(points[0]["relative_error"].is_null());
  EXPECT_EQ(points[1]["reason"], "");
  EXPECT_EQ(points[1]["relative_error"], 0);

  const Outcome solves = RunProgram(
      "saltus_sweep" + scene + "--contact=direct_toi --solver=gd --iterations=1 --sweep='learning_rate=1e-9' --json");
  ASSERT_EQ(solves.exit_code, 0) << solves.errors;
  points = json::parse(solves.output)["points"];
  EXPECT_THAT(points[0]["reason"].get<std::string>(), HasSubstr("ambiguous: the order of the impacts of striker"));
}

TEST(TiesOutput, NothingWithoutTies) {
  const Outcome outcome = RunProgram("two_balls --contact=event --solver=hmp --json --progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_THAT(outcome.output, Not(HasSubstr("ambiguous")));
  EXPECT_THAT(outcome.output, Not(HasSubstr("loss_spread")));
}

}  // namespace
}  // namespace saltus
