// saltus_identify as a user runs it: recordings of a ball that falls, bounces and falls, by the formulas of free fall.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "folders.h"
#include "output/npz.h"
#include "parameter_name.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

constexpr double kRadius = 0.05, kGravity = 9.81, kRestitution = 0.8;

// The height of the centre, dropped from 1 m.
double HeightAt(double time) {
  const double impact = std::sqrt(2 * (1 - kRadius) / kGravity);
  if (time < impact) return 1 - 0.5 * kGravity * time * time;
  const double after = time - impact;
  return kRadius + kRestitution * kGravity * impact * after - 0.5 * kGravity * after * after;
}

std::string DropScene() {
  const std::string text =
      "name: drop\nduration: 1.0\nsteps: 60\ngravity: [0, -9.81]\n"
      "bodies:\n  - {name: ball, radius: 0.05, mass: 0.2, position: [0, 1]}\n"
      "planes:\n  - {name: floor, point: [0, 0], normal: [0, 1]}\n"
      "contact: {restitution: 0.5}\nobjective: {terminal: []}\noptimize: none\n";
  return " --scene=" + TempFileWith("drop.yaml", text) + " --progress=none ";
}

std::string DropRecording() {
  const std::string path = TempFile("drop.csv");
  std::ofstream csv(path);
  csv.precision(17);
  csv << "time,body,x,y,sigma\n";
  for (int i = 0; i < 40; ++i) {
    const double time = 0.02 * i + 0.007, slip = i % 2 == 0 ? 1e-4 : -1e-4;
    csv << time << ",ball," << slip << "," << HeightAt(time) + slip + (i == 30 ? 0.02 : 0) << ",1e-4\n";
  }
  return path;
}

TEST(IdentifyProgram, FindsTheRestitutionOfABall) {
  const Outcome outcome = RunProgram("saltus_identify --json --unknown=restitution,mass.ball" + DropScene() +
                                     "--recording=" + DropRecording());
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json fit = json::parse(outcome.output)["fits"][0];
  EXPECT_EQ(fit["contact"], "event");
  EXPECT_EQ(fit["verdict"], "fits");
  EXPECT_NEAR(fit["parameters"][0]["value"].get<double>(), kRestitution, 1e-3);
  EXPECT_EQ(fit["parameters"][1]["determination"], "not determined");
  EXPECT_TRUE(fit["parameters"][1]["value"].is_null());
  ASSERT_EQ(fit["outliers"].size(), 1u);
  EXPECT_EQ(fit["outliers"][0]["line"], 32);
}

TEST(IdentifyProgram, TablesAndFilesSayTheSame) {
  const Outcome outcome = RunProgram("saltus_identify" + DropScene() + "--recording=" + DropRecording() +
                                     " --output_dir=" + TempFile("out"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_THAT(outcome.output, HasSubstr("restitution"));
  EXPECT_THAT(outcome.output, HasSubstr("Outliers"));
  const std::string text = ContentsOf(TempFile("out") + "/drop_parameters.csv");
  const std::string residuals = ContentsOf(TempFile("out") + "/drop_residuals.csv");
  const std::string row = "event,restitution,0.5,";
  ASSERT_THAT(text, HasSubstr(row));
  EXPECT_NEAR(std::stod(text.substr(text.find(row) + row.size())), kRestitution, 1e-4);
  EXPECT_EQ(std::count(residuals.begin(), residuals.end(), '\n'), 41);
}

// Fits the data under models whose gradient is right, wrong, and without restitution.
// The scene has the floor too low and tilted; the recording is of a floor at height 0. Its angle is fitted first, or
// second, and a wall is always turned before it is moved.
TEST(IdentifyProgram, ThePageDrawsWallsWhereTheFitPutsThem) {
  const std::string text =
      "name: low\nduration: 1.0\nsteps: 60\ngravity: [0, -9.81]\n"
      "bodies:\n  - {name: ball, radius: 0.05, mass: 0.2, position: [0, 1]}\n"
      "planes:\n  - {name: floor, point: [0, -0.1], normal: [0.1, 1]}\n"
      "contact: {restitution: 0.8}\nobjective: {terminal: []}\noptimize: none\n";
  for (const std::string unknown : {"offset.floor,angle.floor", "angle.floor,offset.floor"}) {
    const Outcome outcome =
        RunProgram("saltus_identify --progress=none --scene=" + TempFileWith("low.yaml", text) +
                   " --unknown=" + unknown + " --recording=" + DropRecording() + " --output_dir=" + TempFile("low"));
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    const std::string page = ContentsOf(TempFile("low") + "/report.html");
    const std::size_t begin = page.find("{\"title\":"), end = page.find("</script>", begin);
    const json document = json::parse(page.substr(begin, end - begin));
    const json drawn = [&] {
      for (const json& part : document["parts"]) {
        if (part["kind"] == "figure" && !part["figure"]["panels"][0]["half_planes"].empty()) return part["figure"];
      }
      return json();
    }();
    ASSERT_FALSE(drawn.is_null());
    const json floor = drawn["panels"][0]["half_planes"][0];
    const double nx = floor["normal"][0], ny = floor["normal"][1], x = floor["point"][0], y = floor["point"][1];
    EXPECT_NEAR(nx / std::hypot(nx, ny), 0, 2e-3);
    EXPECT_NEAR((nx * x + ny * y) / std::hypot(nx, ny), 0, 1e-3) << "distance of the floor from (0, 0)";
  }
}

TEST(IdentifyProgram, ComparesContactModelsWithTheExactOne) {
  const Outcome outcome = RunProgram("saltus_identify --json --contact=event,toi_velocity,position_qp" + DropScene() +
                                     "--recording=" + DropRecording());
  EXPECT_EQ(outcome.exit_code, 1);  // one of them cannot explain the data
  const json fits = json::parse(outcome.output)["fits"];
  ASSERT_EQ(fits.size(), 3u);
  EXPECT_FALSE(fits[0]["parameters"][0].contains("bias"));
  const json parameter = fits[1]["parameters"][0];
  EXPECT_EQ(parameter["bias"].get<double>(),
            parameter["value"].get<double>() - fits[0]["parameters"][0]["value"].get<double>());
  EXPECT_EQ(fits[2]["parameters"][0]["determination"], "not determined");
  EXPECT_FALSE(fits[2]["parameters"][0].contains("bias"));
  const Outcome table =
      RunProgram("saltus_identify --contact=event,toi_velocity" + DropScene() + "--recording=" + DropRecording());
  EXPECT_THAT(table.output, HasSubstr("Beside event"));
}

// One impact, so one point of the law.
TEST(IdentifyProgram, LearnsTheLawOfImpact) {
  const Outcome outcome = RunProgram("saltus_identify --json --law=network:2" + DropScene() +
                                     "--recording=" + DropRecording() + " --output_dir=" + TempFile("law"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json law = json::parse(outcome.output)["fits"][0]["law"];
  EXPECT_EQ(law["impacts"], 1);
  EXPECT_EQ(law["parameters"].size(), 7u);
  EXPECT_NEAR(law["curve"][0]["speed"].get<double>(), std::sqrt(2 * kGravity * (1 - kRadius)), 0.01);
  EXPECT_NEAR(law["curve"][0]["restitution"].get<double>(), kRestitution, 1e-3);
  EXPECT_TRUE(std::ifstream(TempFile("law") + "/drop_law.csv").good());
}

const std::string kDrops = SourceFolder() + "/problems/drops/";

// The problem that comes with saltus: what a network has learned, beside the law that made the recordings. The more
// units, the longer are the valleys in which a fit creeps.
class ShippedDrops : public testing::TestWithParam<std::string> {};
TEST_P(ShippedDrops, TeachTheirLaw) {
  const std::string folder = kDrops;
  std::string recordings;
  for (const char* number : {"1", "2", "3", "4"}) {
    recordings += (recordings.empty() ? "" : ",") + folder + "drop_" + number + ".csv";
  }
  const Outcome outcome = RunProgram("saltus_identify --progress=none --law=" + GetParam() + " --scene=" + folder +
                                     "drops.yaml --law_beside=" + folder + "law.csv --recording=" + recordings +
                                     " --output_dir=" + TempFile("drops"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  std::istringstream law(ContentsOf(TempFile("drops") + "/drops_law.csv"));
  std::string line;
  ASSERT_TRUE(std::getline(law, line));
  EXPECT_EQ(line, "speed,sliding,restitution,standard error,friction,standard error of friction,known restitution");
  int compared = 0;
  for (double speed, sliding, restitution, error; std::getline(law, line); ++compared) {
    ASSERT_EQ(std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,", &speed, &sliding, &restitution, &error), 4) << line;
    const double truth = 0.9 / (1 + 0.12 * speed);
    EXPECT_NEAR(restitution, truth, 4 * error + 2e-3) << speed;
    EXPECT_NEAR(std::stod(line.substr(line.rfind(',') + 1)), truth, 2e-4);  // of straight lines between its points
  }
  EXPECT_GT(compared, 15);
}
INSTANTIATE_TEST_SUITE_P(IdentifyProgram, ShippedDrops, testing::Values("network:3", "network:4", "network:6"),
                         ParameterName());

TEST(IdentifyProgram, TheDropsAreWhatTheirProgramWrites) {
  const std::string written = TempFile("written");
  ASSERT_EQ(RunProgram("record_drops " + written).exit_code, 0);
  for (const char* name : {"drop_1.csv", "drop_2.csv", "drop_3.csv", "drop_4.csv", "law.csv"}) {
    EXPECT_EQ(ContentsOf(written + "/" + name), ContentsOf(kDrops + name)) << name;
  }
}

TEST(IdentifyProgram, AKnownLawThatIsWrongIsRefusedWithItsLine) {
  const std::string path = TempFile("known.csv");
  const auto errors = [&](const std::string& text) {
    std::ofstream(path) << text;
    const Outcome outcome = RunProgram("saltus_identify --law=network --law_beside=" + path + DropScene() +
                                       "--recording=" + DropRecording());
    EXPECT_EQ(outcome.exit_code, 2);
    return outcome.errors;
  };
  EXPECT_THAT(errors("speed,e\n1,0.5\n"), HasSubstr("expected the columns speed and restitution"));
  EXPECT_THAT(errors("speed,restitution\n1,0.5\n1,0.4\n"), HasSubstr("known.csv:3: speed: expected speeds"));
  EXPECT_THAT(errors("speed,restitution\n1,0.5\n2,1.4\n"), HasSubstr("known.csv:3: restitution: expected a number"));
  EXPECT_THAT(errors("speed,restitution\n1,x\n"), HasSubstr("known.csv:2: restitution: found 'x'"));
  EXPECT_THAT(errors("speed,restitution\n1,0.5\n"), HasSubstr("fewer than two rows"));
}

// Where the floor is, and what it does to the ball, from a scene that has it 1 cm too low.
TEST(IdentifyProgram, LearnsEventFunctions) {
  DropScene();
  std::string scene = ContentsOf(TempFile("drop.yaml"));
  const std::string path =
      TempFileWith("low.yaml", scene.replace(scene.find("point: [0, 0]"), 13, "point: [0, -0.01]"));
  const std::string arguments =
      " --scene=" + path + " --progress=none --recording=" + DropRecording() + " --output_dir=" + TempFile("events");
  for (const std::string kind : {"affine", "profile:2"}) {
    const Outcome outcome = RunProgram("saltus_identify --json --events=" + kind + arguments);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    const json events = json::parse(outcome.output)["fits"][0]["events"];
    EXPECT_EQ(events["parameters"].size(), kind == "affine" ? 7u : 8u);
    ASSERT_EQ(events["impacts"].size(), 1u);
    const json impact = events["impacts"][0];
    EXPECT_EQ(impact["plane"], "floor");
    EXPECT_NEAR(impact["beyond_plane"].get<double>(), 0.01, 1e-3) << kind;
    EXPECT_NEAR(-impact["after"][1].get<double>() / impact["before"][1].get<double>(), kRestitution, 1e-2) << kind;
  }
  EXPECT_THAT(ContentsOf(TempFile("events") + "/drop_events.csv"), HasSubstr("floor,"));
  const Outcome table = RunProgram("saltus_identify --events=affine" + arguments);
  EXPECT_THAT(table.output, HasSubstr("drop: event functions"));
  EXPECT_THAT(table.output, HasSubstr("Impacts by the learned event functions"));
}

// A ball and a table that are real, and what the rules of the game ask of them: to rise from 30 cm to 23 cm or more.
TEST(IdentifyProgram, FitsARealRecording) {
  const std::string folder = SourceFolder() + "/data/recordings/table_tennis/";
  for (const char* name : {"serve_1.csv", "serve_5.csv"}) {
    const Outcome outcome =
        RunProgram("saltus_identify --json --progress=none --unknown=restitution,friction,gravity --scene=" + folder +
                   "serve.yaml --recording=" + folder + name);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    const json fit = json::parse(outcome.output)["fits"][0];
    EXPECT_NEAR(fit["parameters"][0]["value"].get<double>(), std::sqrt(23.0 / 30), 0.06) << name;
    EXPECT_LT(fit["sigma"].get<double>(), 0.01) << name;
    EXPECT_EQ(fit["impacts"], 1) << name;
  }
}

TEST(IdentifyProgram, ReadsArchivesToo) {
  std::vector<double> time, position;
  for (int i = 0; i < 40; ++i) {
    time.push_back(0.02 * i);
    position.insert(position.end(), {0, HeightAt(time.back())});
  }
  const std::string path = TempFile("drop.npz");
  ASSERT_TRUE(WriteNpz(path,
                       {{"time", {{40}, time}},
                        {"body", {{40}, std::vector<std::string>(40, "ball")}},
                        {"position", {{40, 2}, position}},
                        {"sigma", {{}, std::vector<double>{1e-4}}}})
                  .ok());
  const Outcome outcome = RunProgram("saltus_identify --json" + DropScene() + "--recording=" + path);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_NEAR(json::parse(outcome.output)["fits"][0]["parameters"][0]["value"].get<double>(), kRestitution, 1e-6);
}

TEST(IdentifyProgram, WrongInputIsRefusedWithItsPlace) {
  const std::string recording = " --recording=" + DropRecording(), wrong = TempFile("wrong.csv");
  const std::string scalar = TempFile("scalar.npz");
  ASSERT_TRUE(WriteNpz(scalar,
                       {{"time", {{2}, std::vector<double>{0.1, 0.2}}},
                        {"body", {{2}, std::vector<std::string>(2, "ball")}},
                        {"position", {{}, std::vector<double>{1}}}})
                  .ok());
  std::ofstream(wrong) << "time,body,x,y\n0.1,ball,0,1\n0.2,bal,0,1\n";
  const std::pair<std::string, std::string> cases[] = {
      {"", "--recording=FILE is needed"},
      {" --recording=" + wrong, "wrong.csv:3: body: found 'bal', expected one of ball"},
      {" --recording=" + scalar, "scalar.npz: position: expected 2 x 2 numbers"},
      {" --recording=/no/such/file.csv", "error: /no/such/file.csv: cannot read: No such file or directory"},
      {recording + " --unknown=bounce", "--unknown: found 'bounce', expected some of restitution"},
      {recording + " --law=network:x", "--law=network:x; expected network or impulse"},
      {recording + " --law=network --unknown=restitution", "'restitution' beside a law of impact"},
      {recording + " --loss=tukey", "--loss=tukey; expected none, huber or cauchy"},
      {recording + " --segment=-1", "--segment must not be negative"},
      {recording + " --solver=gd", "--solver is not a flag of saltus_identify"}};
  for (const auto& [flags, message] : cases) {
    const Outcome outcome = RunProgram("saltus_identify" + DropScene() + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << flags;
  }
}

}  // namespace
}  // namespace saltus
