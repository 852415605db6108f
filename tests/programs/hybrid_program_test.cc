// The programs of hybrid systems, and sweeps over their parameters, as a user runs them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "programs/run_command.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

std::string ReadAll(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

json RunHybrid(const std::string& command, int exit_code = 0) {
  const Outcome outcome = RunProgram(command + " --json");
  EXPECT_EQ(outcome.exit_code, exit_code) << outcome.errors;
  const json document = json::parse(outcome.output, nullptr, /*allow_exceptions=*/false);
  EXPECT_TRUE(document.is_object()) << outcome.output << outcome.errors;
  return document;
}

TEST(HybridProgram, PrintsOneDocument) {
  const json document = RunHybrid("bouncing_ball --solver=none --set=y=1.3,v=0.4,g=9.81,e=0.8,duration=2");
  EXPECT_EQ(document["program"], "bouncing_ball");
  EXPECT_EQ(document["system"]["modes"][0]["guards"], json({"ground"}));
  EXPECT_EQ(document["system"]["parameters"], json({"g", "e"}));
  EXPECT_EQ(document["guess"]["initial"], json({1.3, 0.4}));
  const json& motion = document["motion"];
  EXPECT_NEAR(motion["final"][0], 0.13461823752513323273, 1e-13);  // closed form
  ASSERT_EQ(motion["events"].size(), 2u);
  EXPECT_NEAR(motion["events"][1]["time"], 1.3834884673336435927, 1e-13);
  EXPECT_EQ(motion["events"][1]["guard"], "ground");
  EXPECT_EQ(document["runs"], json::array());
  const double miss = 0.13461823752513323273 - 20;
  EXPECT_NEAR(document["loss"], miss * miss, 1e-9);
  EXPECT_NEAR(document["gradient"]["parameters"][1], 2 * miss * 7.8951741884835833065, 1e-8);
  EXPECT_NEAR(document["gradient"]["duration"], 2 * miss * -2.8056342918771302282, 1e-9);
  EXPECT_FALSE(motion.contains("states"));
}

TEST(HybridProgram, StatesHaveBothSidesOfAnEvent) {
  const json motion =
      RunHybrid("bouncing_ball --solver=none --states --set=y=1.3,v=0.4,g=9.81,e=0.8,duration=2")["motion"];
  const std::vector<double> times = motion["times"];
  EXPECT_TRUE(std::is_sorted(times.begin(), times.end()));
  EXPECT_EQ(times.back(), 2.0);
  ASSERT_EQ(motion["states"].size(), times.size());
  ASSERT_EQ(motion["guards"].size(), times.size());
  for (const json& event : motion["events"]) {
    const auto at = std::find(times.begin(), times.end(), event["time"].get<double>()) - times.begin();
    ASSERT_LT(at + 1, static_cast<std::ptrdiff_t>(times.size()));
    EXPECT_EQ(times[at + 1], times[at]);
    EXPECT_NEAR(motion["states"][at + 1][1].get<double>(), -0.8 * motion["states"][at][1].get<double>(), 1e-12);
  }
}

// Of each problem the loss at its optimum, by the reference.
TEST(HybridProgram, EveryProblemIsSolved) {
  const struct {
    const char *program, *flags;
    double loss, within;
  } kPrograms[] = {
      {"boost_converter", "--iterations=200", 0, 1e-12},
      {"bouncing_ball", "--solver=ceres_lm", 0, 1e-18},
      {"cart_pole_walls", "", 0, 1e-15},
      {"juggled_ball", "--iterations=200", 0, 1e-15},
      {"rimless_wheel", "--iterations=200", 0, 1e-15},
      {"rocking_block", "--iterations=200", 0, 1e-15},
      {"simplest_walker", "--iterations=200", 0, 1e-15},
      {"slip_hopper", "--iterations=200", 0, 1e-15},
      {"switched_line", "--solver=ceres_lm --iterations=100", 1.52377277537495711456, 1e-8},
      {"switched_oscillator", "--iterations=200", 0, 1e-15},
      {"thermostat", "--iterations=200", 0, 1e-15},
      {"tossed_box", "--solver=ceres_lm --iterations=100", 0, 1e-15},
      {"turbo_car", "", 40.0 / 3, 1e-8},
      {"two_mass_hopper", "--solver=ceres_lm --iterations=200", 0.0184634928516979, 1e-9},
  };
  for (const auto& problem : kPrograms) {
    SCOPED_TRACE(problem.program);
    const json document = RunHybrid(std::string(problem.program) + " " + problem.flags);
    ASSERT_EQ(document["runs"].size(), 1u);
    EXPECT_NEAR(document["runs"][0]["final_loss"], problem.loss, problem.within) << document["runs"][0]["reason"];
  }
}

TEST(HybridProgram, AuditsTheSchemeOfTheSystem) {
  const json document = RunHybrid(
      "bouncing_ball --audit --width_sweep --solver=none --steps=40 --set=y=1.3,v=0.4,g=9.81,e=0.8,duration=2", 1);
  const json& audit = document["audits"][0];
  EXPECT_THAT(audit["verdict"].get<std::string>(), HasSubstr("wrong"));
  EXPECT_EQ(audit["first_wrong"]["step"], 11);
  EXPECT_NEAR(audit["first_wrong"]["time"], 0.55720308415835660801, 1e-12);
  EXPECT_TRUE(audit["width_sweep"].contains("summary"));
  EXPECT_NEAR(
      audit["exact_gradient"]["parameters"][1], 2 * (0.13461823752513323273 - 20) * 7.8951741884835833065, 1e-8);
}

// A simulator of others that speaks the line protocol, with states of any size.
constexpr const char* kBlackBox = R"(
import json, sys
hello = json.loads(sys.stdin.readline())
assert hello["hybrid"]["modes"] == [{"name": "flight", "states": ["y", "v"]}], hello
print(json.dumps({"name": "mine"}), flush=True)
for line in sys.stdin:
    q = json.loads(line)
    s = q["step"]
    (y, v), (f,), (g, e), h = s["state"], s["control"], s["parameters"], s["h"]
    v += h * (f - g)
    y += h * v
    if y < 0 and v < 0:
        y, v = 0.0, -e * v
    print(json.dumps({"id": q["id"], "mode": s["mode"], "state": [y, v]}), flush=True)
)";

TEST(HybridProgram, AuditsABlackBox) {
  const std::string script = testing::TempDir() + "/hybrid_box_" + std::to_string(getpid()) + ".py";
  std::ofstream(script) << kBlackBox;
  const std::string set = " --solver=none --steps=10 --set=y=1.3,v=0.4,g=9.81,e=0.8,duration=0.8";
  const json by_steps = RunHybrid("bouncing_ball --audit" + set, 1)["audits"][0];
  const json by_lines = RunHybrid("bouncing_ball --simulate=\"box=python3 " + script + "\"" + set, 1)["audits"][0];
  EXPECT_EQ(by_lines["scheme"], "box");
  EXPECT_EQ(by_lines["verdict"], by_steps["verdict"]);
  EXPECT_EQ(by_lines["first_wrong"]["step"], by_steps["first_wrong"]["step"]);
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(by_lines["gradient"]["initial"][i], by_steps["gradient"]["initial"][i], 1e-4);
  }
  const Outcome broken = RunProgram("bouncing_ball --simulate=\"box=echo nonsense\"" + set);
  EXPECT_EQ(broken.exit_code, 1);
  EXPECT_THAT(broken.errors, HasSubstr("audit of box: found 'nonsense', expected an object"));
}

TEST(HybridProgram, WritesAPageWithTheDocument) {
  const std::string folder = testing::TempDir() + "/hybrid_page_" + std::to_string(getpid());
  const Outcome outcome = RunProgram("slip_hopper --solver=none --output_dir=" + folder);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::string page = ReadAll(folder + "/report.html");
  const std::string begin = "<script type=\"application/json\" id=\"document\">";
  const std::size_t at = page.find(begin);
  ASSERT_NE(at, std::string::npos);
  const std::string text = page.substr(at + begin.size(), page.find("</script>", at) - at - begin.size());
  const json document = json::parse(text);
  const json& motion = document["motion"];
  EXPECT_GT(motion["times"].size(), 400u);
  EXPECT_EQ(motion["frames"].size(), motion["times"].size());
  EXPECT_EQ(motion["frames"][0]["circles"].size(), 1u);
  EXPECT_EQ(json::parse(ReadAll(folder + "/result.json"))["program"], "slip_hopper");
  std::filesystem::remove_all(folder);
}

TEST(HybridProgram, WrongInputIsNamed) {
  const struct {
    const char *flags, *message;
  } kWrong[] = {
      {"--set=x=1", "--set=x=1: 'x' is unknown; expected some of g, e, y, v, duration, tolerance"},
      {"--set=y", "--set=y: expected name=value"},
      {"--set=y=a", "--set=y=a: found 'a', expected a finite number"},
      {"--set=duration=-1", "duration"},
      {"--solver=lm", "'lm' is unknown; expected 'all', 'none' or some of"},
      {"--solver=none --states", "--states: expected --json with it"},
      {"--contact=event", "--contact is not a flag of bouncing_ball, but of"},
      {"--iterations=-1", "--iterations must not be negative"},
  };
  for (const auto& wrong : kWrong) {
    const Outcome outcome = RunProgram(std::string("bouncing_ball ") + wrong.flags);
    EXPECT_EQ(outcome.exit_code, 2) << wrong.flags;
    EXPECT_THAT(outcome.errors, HasSubstr(wrong.message));
  }
  EXPECT_EQ(RunProgram("rimless_wheel --audit").exit_code, 2);
  // Not an input that is wrong, but a motion that has no end.
  const Outcome zeno = RunProgram("bouncing_ball --solver=none --set=y=1,v=0,e=0.5,g=9.8");
  EXPECT_EQ(zeno.exit_code, 1);
  EXPECT_THAT(zeno.output, HasSubstr("at about t = 1.35526"));
}

TEST(HybridProgram, HelpListsItsOwnFlags) {
  const Outcome help = RunProgram("bouncing_ball -h");
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_THAT(help.output, HasSubstr("--set=LIST"));
  EXPECT_THAT(help.output, testing::Not(HasSubstr("--contact")));
}

TEST(HybridSweep, SweepsParametersStatesAndSteps) {
  const std::string program = "saltus_sweep --progress=none --program=" + BuildFolder() + "/bin/";
  const Outcome gradients =
      RunCommand(BuildFolder() + "/bin/" + program +
                 "bouncing_ball --solver=none --sweep=\"e=0.5,0.8 & g=9.81,9.81; y=1.3; duration=2,3\"");
  EXPECT_EQ(gradients.exit_code, 0) << gradients.errors;
  EXPECT_THAT(
      gradients.output,
      HasSubstr("e,g,y,duration,loss,norm_dinitial,norm_dcontrol,norm_dparameters,relative_error,events,reason\n"));
  EXPECT_THAT(gradients.output, HasSubstr("accumulate"));  // with e = 0.5
  const Outcome solves =
      RunCommand(BuildFolder() + "/bin/" + program + "bouncing_ball --solver=ceres_lm --sweep=\"e=0.97,0.98\"");
  EXPECT_EQ(solves.exit_code, 0) << solves.errors;
  EXPECT_THAT(solves.output, HasSubstr("e,solver,initial_loss,loss_before_last,final_loss,exact_loss,iterations"));
  EXPECT_THAT(solves.output, HasSubstr("converged"));
  const Outcome wrong = RunCommand(BuildFolder() + "/bin/" + program + "bouncing_ball --sweep=\"stiffness=1\"");
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_THAT(wrong.errors, HasSubstr("stiffness"));
  const Outcome other = RunCommand(BuildFolder() + "/bin/saltus_sweep --program=/bin/true --sweep=e=1");
  EXPECT_EQ(other.exit_code, 2);
}

}  // namespace
}  // namespace saltus
