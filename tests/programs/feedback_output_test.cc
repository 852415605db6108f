// --feedback of saltus_solve and of the programs of hybrid systems: tables and documents.
#include <gmock/gmock.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "programs/run_program.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

std::string Solve(const std::string& problem) {
  return "saltus_solve" + SceneFlag(problem) + "--contact=event --progress=none ";
}
const std::string kTwoBalls = Solve("two_balls") + "--steps=60 ";

json FeedbackOf(const std::string& command) {
  const Outcome outcome = RunProgram(command + " --json --feedback");
  EXPECT_LE(outcome.exit_code, 1) << outcome.errors;
  const json document = json::parse(outcome.output);
  return document["runs"].empty() ? document["feedback"] : document["runs"][0]["feedback"];
}

TEST(FeedbackOutput, RunsAgreeWithFirstOrderAtSmallNoise) {
  const json feedback =
      FeedbackOf(kTwoBalls + "--solver=none --states --feedback_samples=1000 --feedback_noise=state=1e-4,force=0.01");
  ASSERT_EQ(feedback["gains"].size(), 60u);
  EXPECT_EQ(feedback["gains"][0].size(), 2u);
  EXPECT_EQ(feedback["gains"][0][0].size(), 8u);
  EXPECT_EQ(feedback["cost_to_go"].size(), 61u);
  EXPECT_NEAR(feedback["times"].back().get<double>(), 1, 1e-12);
  for (const char* loop : {"open", "closed"}) {
    const json& of = feedback[loop];
    ASSERT_EQ(of["covariances"].size(), 61u);
    double trace = 0;
    for (int i = 0; i < 8; ++i) {
      trace += of["covariance"][i][i].get<double>();
      const double P = of["covariance"][i][i], found = of["runs"]["covariance"][i][i];
      EXPECT_NEAR(found, P, 4.5 * std::sqrt(2.0 / 1000) * P) << loop << " " << i;
    }
    EXPECT_NEAR(of["final_error"].get<double>(), std::sqrt(trace), 1e-12);
    const json& runs = of["runs"];
    EXPECT_NEAR(runs["loss"].get<double>(), of["expected_loss"].get<double>(), 4.5 * runs["loss_error"].get<double>());
    EXPECT_EQ(runs["otherwise"], 0);
    EXPECT_EQ(runs["failed"], 0);
  }
  EXPECT_LT(feedback["closed"]["final_error"].get<double>(), 0.3 * feedback["open"]["final_error"].get<double>());
  // The expected effort of noise alone, in open loop: 0.1 (u^2 + 2 variances) over 1 s, beside the terminal cost.
  const double of_target =
      feedback["open"]["covariance"][4][4].get<double>() + feedback["open"]["covariance"][5][5].get<double>();
  EXPECT_NEAR(feedback["open"]["expected_loss"].get<double>(),
              feedback["loss"].get<double>() + of_target + 0.1 * 2 * 1e-4,
              1e-12);
}

TEST(FeedbackOutput, ASolutionWithOtherIntervalsAndAnotherPlant) {
  const json exact = FeedbackOf(kTwoBalls + "--solver=ceres_phases --feedback_samples=50");
  EXPECT_EQ(exact["gains"].size(), 60u);
  EXPECT_EQ(exact["plant"], "event");
  EXPECT_NEAR(exact["loss"].get<double>(), 1.397, 2e-3);
  const json other = FeedbackOf(kTwoBalls + "--solver=ceres_phases --feedback_samples=50 --feedback_plant=pbd_brax");
  EXPECT_EQ(other["plant"], "pbd_brax");
  EXPECT_EQ(other["gains"], exact["gains"]);
  EXPECT_NE(other["open"]["runs"]["loss"], exact["open"]["runs"]["loss"]);
}

// A shot has no control, and thus no closed loop.
TEST(FeedbackOutput, AShotHasErrorsInOpenLoop) {
  const json feedback =
      FeedbackOf(Solve("ground_wall") + "--solver=none --feedback_samples=500 --feedback_noise=velocity=0.001");
  EXPECT_FALSE(feedback.contains("closed"));
  EXPECT_FALSE(feedback.contains("gains"));
  const json& open = feedback["open"];
  EXPECT_NEAR(open["runs"]["final_error"].get<double>(),
              open["final_error"].get<double>(),
              0.2 * open["final_error"].get<double>());
}

TEST(FeedbackOutput, OfAHybridSystem) {
  const json feedback = FeedbackOf(
      "bouncing_ball --solver=none --progress=none --set=y=4,v=0,g=9.8,e=0.7,duration=1 "
      "--feedback_noise=y=0.01,v=0.01 --feedback_samples=200");
  // The covariance of the exact transition, [-0.518 -0.536; 1.882 1].
  EXPECT_NEAR(feedback["open"]["covariance"][0][0].get<double>(), 0.0000556041806150642, 1e-12);
  EXPECT_NEAR(feedback["open"]["covariance"][0][1].get<double>(), -0.000151144593365937, 1e-12);
  EXPECT_NEAR(feedback["open"]["covariance"][1][1].get<double>(), 0.000454025, 1e-12);
}

TEST(FeedbackOutput, TableAndWarning) {
  const Outcome outcome = RunProgram(kTwoBalls + "--solver=none --feedback --feedback_samples=20 --feedback_scale=100");
  EXPECT_THAT(outcome.output, HasSubstr("noisy runs"));
  EXPECT_THAT(outcome.output, HasSubstr("closed"));
  EXPECT_THAT(outcome.output, HasSubstr("open loop: the sequence of events changes with a probability of up to"));
}

TEST(FeedbackOutput, WrongFlags) {
  for (const auto& [flags, message] : std::vector<std::pair<std::string, std::string>>{
           {"--feedback_samples=5", "--feedback_samples needs --feedback"},
           {"--feedback --feedback_noise=speed=1", "'speed' is unknown"},
           {"--feedback --feedback_noise=velocity=-1", "velocity must not be negative"},
           {"--feedback --feedback_weights=control=0", "control must be positive"},
           {"--feedback --feedback_plant=nothing", "--feedback_plant=nothing"},
           {"--feedback --feedback_samples=-1", "--feedback_samples must not be negative"}}) {
    const Outcome outcome = RunProgram(kTwoBalls + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(message));
  }
}

}  // namespace
}  // namespace saltus
