// The programs of hybrid systems, and sweeps over their parameters, as a user runs them.
#include "programs/hybrid_program.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>
#include <vector>

#include "base/number_text.h"
#include "problems/hybrid_systems.h"
#include "programs/run_program.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::HasSubstr;

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

// The loss of each problem at its optimum, by the reference.
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
  const std::string script = TempFileWith("hybrid_box.py", kBlackBox);
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
  EXPECT_THAT(broken.errors,
              HasSubstr("audit of box: 'echo nonsense': the greeting: found 'nonsense', expected an object"));
}

TEST(HybridProgram, WritesAPageWithTheDocument) {
  const std::string folder = TempFile("hybrid_page");
  const Outcome outcome = RunProgram("slip_hopper --solver=none --output_dir=" + folder);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::string page = ContentsOf(folder + "/report.html");
  const std::string begin = "<script type=\"application/json\" id=\"document\">";
  const std::size_t at = page.find(begin);
  ASSERT_NE(at, std::string::npos);
  const std::string text = page.substr(at + begin.size(), page.find("</script>", at) - at - begin.size());
  const json document = json::parse(text);
  EXPECT_EQ(document["title"], "slip_hopper");
  const json& motion = document["results"]["motion"];
  EXPECT_GT(motion["times"].size(), 400u);
  EXPECT_EQ(motion["frames"].size(), motion["times"].size());
  EXPECT_EQ(motion["frames"][0]["circles"].size(), 1u);
  // The numbers of pictures have seven digits, the others all that they have.
  const json result = json::parse(ContentsOf(folder + "/result.json"));
  EXPECT_EQ(document["results"]["loss"], result["loss"]);
  for (const json& row : motion["states"]) {
    for (const double number : row) EXPECT_EQ(RoundedTo(7, number), number);
  }
  // A motion is a part of the page; terminal and page have the same tables.
  const auto tables = [&](const std::string& header) {
    return std::ranges::count_if(document["parts"], [&](const json& part) {
      return part.contains("table") && part["table"]["columns"][0]["header"] == header;
    });
  };
  EXPECT_EQ(tables("event"), 1);
  EXPECT_EQ(tables("variable"), 1);
  const auto is_motion = [](const json& part) { return part["kind"] == "motion"; };
  EXPECT_EQ(std::ranges::count_if(document["parts"], is_motion), 1);
  EXPECT_EQ(result["program"], "slip_hopper");
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

class BodiesProgram : public testing::Test {
 protected:
  ~BodiesProgram() override { std::filesystem::remove(path_); }

  // saltus_bodies on a file with this text.
  Outcome Run(const std::string& text, const std::string& flags) const {
    std::ofstream(path_) << text;
    return RunProgram("saltus_bodies --scene=" + path_ + " " + flags);
  }
  json Document(const std::string& text, const std::string& flags, int exit_code = 0) const {
    const Outcome outcome = Run(text, flags + " --json");
    EXPECT_EQ(outcome.exit_code, exit_code) << outcome.errors;
    return json::parse(outcome.output, nullptr, /*allow_exceptions=*/false);
  }

  const std::string path_ = TempFile("bodies.yaml");
};

TEST_F(BodiesProgram, AFileIsTheProgramOfTheSameProblem) {
  for (const std::string flags :
       {"--solver=none --states --json", "--iterations=3 --json", "--solver=none", "--solver=list"}) {
    const Outcome file = RunProgram("saltus_bodies --scene=" + SourceFolder() + "/problems/tossed_box.yaml " + flags);
    const Outcome program = RunProgram("tossed_box " + flags);
    EXPECT_EQ(file.exit_code, program.exit_code) << file.errors;
    // The time that solvers take is not a result.
    const std::regex seconds("\"seconds\": ?[-+.e0-9]+");
    EXPECT_EQ(std::regex_replace(file.output, seconds, ""), std::regex_replace(program.output, seconds, "")) << flags;
  }
}

// A force on a disc for T, to a place: with a = T^2 / 2m the loss is w (a u - x)^2 + c T u^2.
TEST_F(BodiesProgram, SolvesForAControl) {
  const json document = Document(R"(
name: pushed
duration: 2
steps: 1
bodies: [{name: disc, radius: 0.1, mass: 4, position: [0, 0], joint: translation}]
control: {bodies: [disc], initial: [[0, 0.5, 0]], max: 100}
objective: {terminal: [{body: disc, quantity: position, target: [3, 0], weight: 5}], effort: 0.25}
optimize: control
)",
                                 "--solver=ceres_phases");
  const double a = 0.5, u = 5 * a * 3 / (5 * a * a + 0.25 * 2);
  ASSERT_EQ(document["runs"].size(), 1u);
  EXPECT_NEAR(document["runs"][0]["solution"]["control"][0][0], u, 1e-8);  // the loss is flat there
  EXPECT_NEAR(document["runs"][0]["solution"]["control"][0][1], 0, 1e-8);
  EXPECT_NEAR(document["runs"][0]["final_loss"], 5 * (a * u - 3) * (a * u - 3) + 0.5 * u * u, 1e-9);
  // Though the terms of the condition for the force along y do not cancel, as that force is to be zero.
  EXPECT_EQ(document["runs"][0]["certificate"]["verdict"], "stationary");
  EXPECT_EQ(document["runs"][0]["termination"], "converged");
}

// A crate that slides all the time: with the friction mu, a force upwards counts mu times, as it takes from the normal
// force. At intervals of length h with middles before the end by s, c = h s, the position at the end is
// sum c (u_x + mu u_y) / m - mu g T^2 / 2, linear in the forces, and the least loss is d^2 / (1 + S / effort) with
// d = target + mu g T^2 / 2 and S = (1 + mu^2) sum c^2 / (m^2 h).
TEST_F(BodiesProgram, SlidesACrateWithTheLeastLoss) {
  const json document = Document(R"(
name: crate
duration: 1
steps: 10
gravity: [0, -9.81]
bodies: [{name: crate, box: [0.2, 0.2], mass: 2, position: [0, 0.2]}]
planes: [{point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0, friction: 0.4}
control: {bodies: [crate], initial: [[10, 0, 0]], max: 100}
objective: {terminal: [{body: crate, quantity: position, target: [0.8, 0.2]}], effort: 0.001}
optimize: control
)",
                                 "--solver=ceres_phases",
                                 0);
  double squares = 0;
  for (int i = 0; i < 10; ++i) squares += std::pow(0.1 * (0.95 - 0.1 * i), 2);
  const double distance = 0.8 + 0.5 * 0.4 * 9.81, sensitivity = (1 + 0.4 * 0.4) * squares / (2 * 2 * 0.1);
  const json& run = document["runs"][0];
  EXPECT_EQ(run["termination"], "converged");
  EXPECT_NEAR(run["final_loss"].get<double>(), distance * distance / (1 + sensitivity / 0.001), 1e-10);
  EXPECT_EQ(run["certificate"]["verdict"], "stationary");
  EXPECT_EQ(run["certificate"]["curvature"]["kind"], "minimum");
}

// A rod on a hinge swings from the horizontal onto a stop. Its energy at the stop is that which it has lost in height.
TEST_F(BodiesProgram, HasJointsPolygonsAndDiscs) {
  const json document = Document(R"(
name: hinge
duration: 0.6
gravity: [0, -10]
bodies:
  - {name: rod, polygon: [[-0.5, -0.01], [0.5, -0.01], [0.5, 0.01], [-0.5, 0.01]], mass: 3, inertia: 0.25,
     position: [0.5, 0], joint: {revolute: [0, 0]}}
  - {name: stop, radius: 0.05, position: [0.15, -0.75], joint: weld}
  - {name: slider, box: [0.1, 0.1], mass: 2, position: [5, 5], velocity: [3, 4], joint: {prismatic: [6, 8]}}
contact: {restitution: 1, friction: 0}
objective: {terminal: [{body: rod, quantity: angular_velocity, target: 0}]}
optimize: none
)",
                                 "--solver=none --states");
  const json& motion = document["motion"];
  EXPECT_EQ(document["system"]["modes"][0]["states"],
            json({"rod.angle", "slider.distance", "drod.angle", "dslider.distance"}));
  ASSERT_EQ(motion["events"].size(), 1u);
  EXPECT_THAT(motion["events"][0]["guard"].get<std::string>(), HasSubstr("stop-rod"));
  const double time = motion["events"][0]["time"];
  const auto at = std::find(motion["times"].begin(), motion["times"].end(), time) - motion["times"].begin();
  const double angle = motion["states"][at][0], rate = motion["states"][at][2];
  EXPECT_NEAR(0.5 * (0.25 + 3 * 0.25) * rate * rate, 3 * 10 * 0.5 * -std::sin(angle), 1e-9);
  EXPECT_NEAR(motion["states"][at + 1][2], -rate, 1e-12);
  // Along an axis that has been made one of length 1, against gravity.
  EXPECT_NEAR(motion["final"][1], 5 * 0.6 - 0.5 * 10 * 0.8 * 0.36, 1e-12);
}

TEST_F(BodiesProgram, RestsOnThePlaneFromTheStart) {
  const json document = Document(R"(
name: rest
duration: 1
gravity: [0, -9.81]
bodies: [{name: box, box: [0.5, 0.25], mass: 1, position: [0, 0.25]}]
planes: [{point: [0, 0], normal: [0, 2]}]
objective: {terminal: [{body: box, quantity: velocity, target: [0, 0]}]}
optimize: none
)",
                                 "--solver=none");
  EXPECT_NEAR(document["motion"]["final"][1], 0.25, 1e-12);
  EXPECT_EQ(document["motion"]["events"], json::array());
}

// A simulator that is told of the bodies, whose steps end with the impulse of a disc that has struck the ground.
constexpr const char* kDiscBox = R"(
import json, sys
scene = json.loads(sys.stdin.readline())["scene"]
disc, = scene["bodies"]
assert (disc["name"], disc["radius"], disc["mass"], round(disc["inertia"], 15)) == ("disc", 0.1, 2, 0.01), disc
assert scene["planes"] == [{"point": [0, 0], "normal": [0, 1]}] and scene["frictionless"], scene
print(json.dumps({"name": "mine"}), flush=True)
for line in sys.stdin:
    q = json.loads(line)
    s = q["step"]
    (x, y, angle, vx, vy, spin), (e, _, gx, gy), h = s["state"], s["parameters"], s["h"]
    vx, vy = vx + h * gx, vy + h * gy
    if y < disc["radius"] and vy < 0:
        vy *= -e
    state = [x + h * vx, y + h * vy, angle + h * spin, vx, vy, spin]
    print(json.dumps({"id": q["id"], "mode": s["mode"], "state": state}), flush=True)
)";

TEST_F(BodiesProgram, AuditsASimulator) {
  const std::string script = TempFileWith("disc_box.py", kDiscBox);
  const json document = Document(R"(
name: bounce
duration: 0.5
gravity: [0, -10]
bodies: [{name: disc, radius: 0.1, mass: 2, position: [0, 1.1], velocity: [1, -3]}]
planes: [{point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.5}
objective: {terminal: [{body: disc, quantity: position, target: [1, 1]}]}
optimize: velocity
)",
                                 "--solver=none --steps=5 --simulate=\"box=python3 " + script + "\"",
                                 1);
  const json& audit = document["audits"][0];
  EXPECT_EQ(audit["verdict"], "wrong sign");
  const double time = (-3 + std::sqrt(9 + 20.0)) / 10;  // of a fall through 1 m
  EXPECT_NEAR(audit["first_wrong"]["time"], time, 1e-12);
  EXPECT_EQ(audit["first_wrong"]["step"], static_cast<int>(time / (0.5 / 5)));
  const double left = 0.5 - time, height = 0.1 + 0.5 * (3 + 10 * time) * left - 5 * left * left;
  EXPECT_NEAR(audit["exact_loss"], (0.5 - 1) * (0.5 - 1) + (height - 1) * (height - 1), 1e-12);
  std::filesystem::remove(script);
}

TEST_F(BodiesProgram, AWrongFileIsNamedWithItsPlace) {
  const std::string good = R"(name: box
duration: 1
gravity: [0, -9.81]
bodies:
  - {name: box, box: [0.2, 0.1], mass: 1, position: [0, 1]}
  - {name: post, radius: 0.1, position: [2, 0], joint: weld}
planes:
  - {point: [0, 0], normal: [0, 1]}
contact: {restitution: 0.5, friction: 0.3}
objective: {terminal: [{body: box, quantity: position, target: [1, 0]}]}
optimize: velocity
)";
  EXPECT_EQ(Run(good, "--solver=none").exit_code, 0);
  Run(std::regex_replace(good, std::regex("gravity"), "steps: 1\ngravity"), "--solver=none");
  const std::string of_solve = RunProgram("saltus_solve --scene=" + path_).errors;
  EXPECT_THAT(of_solve, HasSubstr(":6: bodies[0].box: found an unknown key, expected one of name, radius"));
  EXPECT_THAT(of_solve, HasSubstr("; saltus_bodies reads files of boxes"));
  const struct {
    const char *from, *to, *message;
  } kWrong[] = {
      {"duration: 1", "duration: -1", ":2: duration: found -1, expected a duration above zero in s"},
      {"duration: 1", "durations: 1", ":2: durations: found an unknown key, expected one of name, duration"},
      {"box: [0.2, 0.1]", "box: [0.2, 0]", ":5: bodies[0].box: found a list of 2, expected half the width"},
      {"box: [0.2, 0.1]", "box: [0.2, 0.1], radius: 1", ":5: bodies[0]: expected one of the keys box, polygon"},
      {"box: [0.2, 0.1]", "polygon: [[0, 0], [0, 1], [1, 0]]", ":5: bodies[0]: the polygon is not convex"},
      {"mass: 1", "mass: inf", ":5: bodies[0].mass: found inf, expected a mass above zero in kg"},
      {"mass: 1, ", "", ":5: bodies[0].mass: found no such key, expected the mass in kg"},
      {"joint: weld", "joint: glue", ":6: bodies[1].joint: found glue, expected one of free, translation, weld"},
      {"joint: weld", "joint: {revolute: 1}", ":6: bodies[1].joint.revolute: found 1, expected a vector [x, y]"},
      {"joint: weld", "joint: weld, velocity: [1, 0]", ":6: bodies[1].velocity: expected no such key: the joint"},
      {"name: post", "name: box", ":6: bodies[1]: found the name box again"},
      {"name: post", "name: a=b", ":6: bodies[1]: expected a name without commas"},
      {"normal: [0, 1]", "normal: [0, 0]", ":8: planes[0].normal: found a list of 2, expected a vector of another"},
      {"restitution: 0.5", "restitution: 1.5", ":9: contact.restitution: found 1.5, expected a number from 0 to 1"},
      {"body: box", "body: bix", ":10: objective.terminal[0].body: found bix, expected the name of a body; did you"},
      {"body: box", "body: post", ":10: objective.terminal[0]: the joint of post leaves no such coordinate"},
      {"target: [1, 0]}]", "target: [1, 0]}], effort: 1", ":10: objective.effort: expected no such key: no body"},
      {"optimize: velocity",
       "optimize: [velocity, mass]",
       ":11: optimize[1]: found mass, expected one of none, contro"},
      {"optimize: velocity", "optimize: control", ":11: optimize: found control, but no body is controlled"},
      {"name: box\n", "name: [box\n", "found text that is not YAML"},
  };
  for (const auto& wrong : kWrong) {
    std::string text = good;
    text.replace(text.find(wrong.from), std::string(wrong.from).size(), wrong.to);
    const Outcome outcome = Run(text, "--solver=none");
    EXPECT_EQ(outcome.exit_code, 2) << wrong.to;
    EXPECT_THAT(outcome.errors, HasSubstr(path_));
    EXPECT_THAT(outcome.errors, HasSubstr(wrong.message));
  }
  EXPECT_EQ(RunProgram("saltus_bodies --solver=none").exit_code, 2);
  EXPECT_THAT(RunProgram("saltus_bodies --scene=/no/file").errors, HasSubstr("/no/file: cannot read: No such file"));
  const Outcome overlap =
      Run(std::regex_replace(good, std::regex("position: \\[2, 0\\]"), "position: [0, 1]"), "--solver=none");
  EXPECT_EQ(overlap.exit_code, 2) << overlap.output;
  EXPECT_THAT(overlap.errors, HasSubstr(":4: bodies: contact 'post-box' penetrates, its gap is -0."));
}

TEST(HybridSweep, SweepsParametersStatesAndSteps) {
  const std::string program = "saltus_sweep --progress=none --program=" + BuildFolder() + "/bin/";
  const Outcome gradients =
      RunCommand(BuildFolder() + "/bin/" + program +
                 "bouncing_ball --solver=none --sweep=\"e=0.5,0.8 & g=9.81,9.81; y=1.3; duration=2,3\"");
  EXPECT_EQ(gradients.exit_code, 0) << gradients.errors;
  EXPECT_THAT(
      gradients.output,
      HasSubstr(
          "e,g,y,duration,loss,norm_dinitial,norm_dcontrol,norm_dparameters,relative_error,events,reason,status\n"));
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

TEST(HybridDocument, GuardsAreThoseUnderTheControlOfTheirInterval) {
  const HybridProblem problem = LegHopperProblem();
  HybridInput input = problem.guess;
  for (int k = 0; k < input.num_intervals; ++k) input.lengths.push_back(1 + k);
  HybridSimulator simulator(problem.system, problem.integration);
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  const json motion = HybridMotionToJson(simulator, input, true, /*states=*/true);
  const std::vector<double> times = input.Times();
  int compared = 0;
  for (std::size_t i = 0; i < motion["times"].size(); ++i) {
    if (motion["modes"][i] != "s") continue;
    const double time = motion["times"][i];
    const std::vector<double> x = motion["states"][i];
    for (int k = 0; k < input.num_intervals; ++k) {
      if (!(time > times[k] + 1e-9 && time < times[k + 1] - 1e-9)) continue;
      const double off = problem.system.functions().Guard(
          {input.mode, time, x.data(), &input.control[2 * k], input.parameters.data()}, 0);
      EXPECT_DOUBLE_EQ(motion["guards"][i][0].get<double>(), off) << time;
      ++compared;
    }
  }
  EXPECT_GT(compared, 10);
}

}  // namespace
}  // namespace saltus
