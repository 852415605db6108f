// saltus_simulate: the protocol of black boxes around the library's own models.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "blackbox/protocol.h"
#include "blackbox/protocol_server.h"
#include "lines.h"
#include "programs/run_program.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Json = ProtocolJson;

BlackBoxRequest AtTheGuess(const Scene& scene, BlackBoxRequest::Kind kind) {
  BlackBoxRequest question{
      kind, scene.steps, scene.duration, InitialState(scene), InitialControl(scene, scene.steps), {}};
  if (kind == BlackBoxRequest::Kind::kGradient) question.final_cotangent.assign(question.initial.size(), 0.0);
  return question;
}

// The lines that a program prints in answer to lines.
std::vector<Json> AnswersOf(const std::string& program, const std::vector<std::string>& lines) {
  std::string questions;
  for (const std::string& line : lines) questions += line + "\n";
  const Outcome outcome = RunProgram(program + " <" + TempFileWith("questions", questions));
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  std::vector<Json> answers;
  std::stringstream text(outcome.output);
  for (std::string line; std::getline(text, line);) answers.push_back(Json::parse(line));
  return answers;
}

// Loss and gradient of the task of two balls, from published exact values: 2.0591, and to four digits.
TEST(Simulate, GivesTheExactLossAndGradientOfTwoBalls) {
  const Scene scene = ProblemScene("two_balls");
  BlackBoxRequest gradient = AtTheGuess(scene, BlackBoxRequest::Kind::kGradient);
  const std::vector<Json> first =
      AnswersOf("saltus_simulate --contact=event",
                {HelloLine(scene), QuestionLine(scene, AtTheGuess(scene, BlackBoxRequest::Kind::kSimulate), 1)});
  ASSERT_EQ(first.size(), 2u);
  EXPECT_EQ(first[0]["can"], Json::parse(R"(["gradient", "step", "states"])"));
  const Json& final = first[1]["final"];
  const double x = final[1][0], y = final[1][1];
  EXPECT_NEAR(x * x + y * y + 0.1 * 18, 2.0591, 5e-5);
  EXPECT_EQ(first[1]["states"].size(), 481u);
  EXPECT_EQ(first[1]["states"].back(), final);

  gradient.final_cotangent[4] = 2 * x;
  gradient.final_cotangent[5] = 2 * y;
  const std::vector<Json> second =
      AnswersOf("saltus_simulate --contact=event", {HelloLine(scene), QuestionLine(scene, gradient, 2)});
  ASSERT_EQ(second.size(), 2u);
  EXPECT_EQ(second[1]["id"], 2);
  const double expected[] = {-0.3987, -0.3987, -0.4978, -0.4978};
  for (int j = 0; j < 4; ++j) EXPECT_NEAR(second[1]["initial"][0][j].get<double>(), expected[j], 5e-5);
  const double of_target[] = {-0.3213, -0.3213, -0.2221, -0.2221};
  for (int j = 0; j < 4; ++j) EXPECT_NEAR(second[1]["initial"][1][j].get<double>(), of_target[j], 5e-5);
  EXPECT_EQ(second[1]["control"].size(), 480u);
}

// Free flight and one impact on the ground, in closed form: task 1 ends at the height 1.1 - 2 t below the top.
TEST(Simulate, StepsOneStep) {
  const Scene scene = ProblemScene("bounce_once");
  BlackBoxRequest step{BlackBoxRequest::Kind::kStep, 1, 0.5, InitialState(scene), {0, 0}, {}};
  const std::vector<Json> answers =
      AnswersOf("saltus_simulate --contact=event", {HelloLine(scene), QuestionLine(scene, step, 1)});
  ASSERT_EQ(answers.size(), 2u);
  // From 1 at -2 m/s it is at 0.1, its radius, after 0.45 s.
  EXPECT_NEAR(answers[1]["state"][0][0].get<double>(), 0, 1e-15);
  EXPECT_NEAR(answers[1]["state"][0][1].get<double>(), 0.2, 1e-15);
  EXPECT_NEAR(answers[1]["state"][0][3].get<double>(), 2, 1e-15);
}

// The models of Brax take two steps of the grid at a time, under the mean of their forces.
TEST(Simulate, ForcesOfAModelWithLongStepsAreTheirMean) {
  Scene scene = ProblemScene("two_balls");
  ProtocolServer speaker("compliant_brax", Precision::kDouble, {});
  EXPECT_EQ(Json::parse(speaker.ComputeAnswer(HelloLine(scene)))["grid_steps"], 2);
  BlackBoxRequest question = AtTheGuess(scene, BlackBoxRequest::Kind::kGradient);
  question.steps = 4;
  question.duration = 4.0 / 480;
  question.control = {1, 0, 3, 0, 2, 0, 2, 0};
  question.final_cotangent[2] = 1;  // velocity along x
  const Json answer = Json::parse(speaker.ComputeAnswer(QuestionLine(scene, question, 1)));
  EXPECT_NEAR(answer["final"][0][2].get<double>(), 8.0 / 480, 1e-15);
  for (int k = 0; k < 4; ++k) EXPECT_NEAR(answer["control"][k][0][0].get<double>(), 1.0 / 480, 1e-12) << k;
  question.steps = 3;
  question.control.resize(6);
  EXPECT_THAT(speaker.ComputeAnswer(QuestionLine(scene, question, 2)), HasSubstr("divisible by 2"));
}

TEST(Simulate, OneRowOfControlStandsForAll) {
  const Scene scene = ProblemScene("two_balls");
  BlackBoxRequest question = AtTheGuess(scene, BlackBoxRequest::Kind::kSimulate);
  const std::string constant = QuestionLine(scene, question, 1);
  EXPECT_LT(constant.size(), 200u);
  question.control[100] = std::nextafter(3.0, 4.0);
  EXPECT_GT(QuestionLine(scene, question, 1).size(), 480u * 5);
}

TEST(Simulate, WhatIsWrongWithALineIsItsAnswer) {
  const Scene scene = ProblemScene("two_balls");
  ProtocolServer speaker("direct", Precision::kDouble, {.gradient = true, .step = false, .states = false});
  EXPECT_THAT(speaker.ComputeAnswer(R"({"id": 1, "simulate": {}})"), HasSubstr("\"scene\\\" before"));
  EXPECT_THAT(speaker.ComputeAnswer("{\"id\": 1"), HasSubstr("expected a JSON object"));
  EXPECT_THAT(speaker.ComputeAnswer(R"({"saltus": 1, "scene": {"name": "x"}})"), HasSubstr("scene"));
  EXPECT_THAT(speaker.ComputeAnswer(HelloLine(scene)), HasSubstr(R"("can":["gradient"])"));
  const auto answer = [&](const std::string& rest) { return speaker.ComputeAnswer("{\"id\": 5, " + rest + "}"); };
  EXPECT_THAT(answer(R"("step": {"h": 1, "state": [], "force": []})"), HasSubstr("what was offered"));
  EXPECT_THAT(answer(R"("simulate": {"steps": 1.5, "duration": 1})"), HasSubstr("whole number"));
  EXPECT_THAT(answer(R"("simulate": {"steps": 2, "duration": 1})"), HasSubstr("expected \\\"initial\\\""));
  EXPECT_THAT(answer(R"("simulate": {"steps": 2, "duration": 1, "initial": [[0, 0, 0, 0]]})"),
              HasSubstr("a list of 1 in place of a list of 2"));
  EXPECT_THAT(answer(R"("simulate": {"steps": 2, "duration": 1, "initial": [[0, 0, 0, "1"], [9, 0, 0, 0]]})"),
              HasSubstr("among them"));
}

TEST(Simulate, SaysWhatItCannotTake) {
  Scene scene = ProblemScene("two_balls");
  scene.contact.friction = 0.1;
  ProtocolServer speaker("direct", Precision::kDouble, {});
  EXPECT_THAT(speaker.ComputeAnswer(HelloLine(scene)), HasSubstr(R"("not_applicable":"this model knows no friction")"));
}

TEST(Simulate, RefusesWrongFlags) {
  const struct {
    std::string flags, why;
  } cases[] = {{"", "--contact=NAME is needed"},
               {"--contact=evnt", "expected a contact model"},
               {"--contact=event --offer=loss", "found 'loss', expected gradient, step, states or none"},
               {"--contact=event --precision=half", "expected double or float"},
               {"--contact=event --steps=3", "--steps is not a flag of saltus_simulate"}};
  for (const auto& [flags, why] : cases) {
    const Outcome outcome = RunProgram("saltus_simulate " + flags + " </dev/null");
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(why));
  }
}

}  // namespace
}  // namespace saltus
