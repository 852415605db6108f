// States of solutions, in JSON and NPZ, and controls that come from elsewhere.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "output/npz.h"
#include "programs/run_program.h"
#include "saltus/scene/geometry.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

json Solve(const std::string& flags) {
  const Outcome outcome = RunProgram("saltus_solve --progress=none --json " + flags);
  EXPECT_LE(outcome.exit_code, 1) << outcome.errors;
  return json::parse(outcome.output);
}

std::string Write(const std::string& name, const json& document) { return TempFileWith(name, document.dump()); }

const std::vector<double>& Doubles(const NpyArray& array) { return std::get<std::vector<double>>(array.data); }

TEST(SolutionStates, EveryRunHasItsFinalStates) {
  const json run = Solve("--contact=direct_toi --solver=gd --iterations=3" + SceneFlag("two_balls"))["runs"][0];
  ASSERT_EQ(run["final_state"].size(), 2u);
  ASSERT_EQ(run["exact_final_state"].size(), 2u);
  // The loss is |target ball|^2 + 0.1 * integral |u|^2.
  double effort = 0;
  for (const json& row : run["control"]) {
    for (int j = 0; j < 2; ++j) effort += 0.1 / 480 * row[0][j].get<double>() * row[0][j].get<double>();
  }
  const auto loss = [&](const json& state) {
    return effort + std::pow(state[1][0].get<double>(), 2) + std::pow(state[1][1].get<double>(), 2);
  };
  EXPECT_NEAR(loss(run["final_state"]), run["final_loss"], 1e-12);
  EXPECT_NEAR(loss(run["exact_final_state"]), run["exact_loss"], 1e-12);
  EXPECT_FALSE(run.contains("states"));
}

TEST(SolutionStates, StatesAreThoseOfTheRollout) {
  const json document =
      Solve("--contact=direct_toi,event --solver=gd --iterations=2 --states" + SceneFlag("two_balls"));
  EXPECT_EQ(document["bodies"][1]["name"], "target");
  for (const json& run : document["runs"]) {
    ASSERT_EQ(run["times"].size(), 481u);
    ASSERT_EQ(run["states"].size(), 481u);
    EXPECT_EQ(run["states"][480], run["final_state"]);
    EXPECT_NEAR(run["times"][240].get<double>(), 0.5, 1e-12);
    const size_t rows = run["exact_times"].size();
    EXPECT_EQ(rows, run["exact_states"].size());
    EXPECT_EQ(rows, 481 + 2 * run["events"].size());
    for (int j = 0; j < 4; ++j) {
      const double found = run["exact_states"][rows - 1][1][j], expected = run["exact_final_state"][1][j];
      EXPECT_NEAR(found, expected, 1e-12);
    }
  }
}

// Angle and angular velocity come after position and velocity, and a solution's spin is where another run begins.
TEST(SolutionStates, DiscsThatSpinHaveSixNumbers) {
  const std::string spin = "--solver=ceres_lm --iterations=60" + SceneFlag("back_spin");
  const json document = Solve("--contact=event,compliant_brax --states " + spin);
  for (const json& run : document["runs"]) {
    const json &states = run["states"], &last = run["final_state"];
    ASSERT_EQ(last[0].size(), 6u);
    ASSERT_EQ(run["exact_final_state"][0].size(), 6u);
    EXPECT_EQ(states.back(), last);
    EXPECT_EQ(states[0][0][5], run["angular_velocity"][0]);
    const json& exact = run["exact_states"];
    for (int j = 0; j < 6; ++j) {
      EXPECT_NEAR(exact.back()[0][j].get<double>(), run["exact_final_state"][0][j].get<double>(), 1e-9) << j;
    }
  }
  const json& found = document["runs"][0];
  const double spun = found["angular_velocity"][0], end = found["final_state"][0][5];
  const Vec2d miss(found["final_state"][0][0], found["final_state"][0][1].get<double>() - 1);
  const Vec2d slow(found["final_state"][0][2].get<double>() + 1.5, found["final_state"][0][3].get<double>() - 1);
  EXPECT_NEAR(found["final_loss"], miss.squaredNorm() + 0.1 * slow.squaredNorm() + 1e-5 * end * end, 1e-12);
  const std::string from = " --warm_start=" + Write("spin.json", found);
  const json again = Solve("--contact=event " + spin + from)["runs"][0];
  EXPECT_EQ(again["initial_loss"], found["final_loss"]);
  EXPECT_EQ(again["iterations"], 0);
  EXPECT_NEAR(again["angular_velocity"][0], spun, 1e-12);
}

TEST(SolutionStates, WithoutASolverTheStartIsSimulated) {
  const json document = Solve("--contact=direct,event --solver=none" + SceneFlag("two_balls"));
  ASSERT_EQ(document["runs"].size(), 2u);
  for (const json& run : document["runs"]) {
    EXPECT_EQ(run["termination"], "converged");
    EXPECT_FALSE(run.contains("losses"));
    EXPECT_FALSE(run.contains("initial_loss"));
    EXPECT_NEAR(run["exact_loss"].get<double>(), 2.05914350610858, 1e-12);  // in closed form
    EXPECT_EQ(run["certificate"]["verdict"], "not_stationary");
  }
  EXPECT_EQ(document["runs"][1]["loss"], document["runs"][1]["exact_loss"]);
  const json launch = Solve("--contact=event --solver=none" + SceneFlag("ground_wall"))["runs"][0];
  EXPECT_EQ(launch["termination"], "converged");
  EXPECT_FALSE(launch.contains("certificate"));
}

// One program confirms the result of the other: loss, certificate and intervals of other lengths included.
TEST(SolutionStates, AControlFromAFileIsCheckedAndSolvedFrom) {
  const std::string directory = TempFile("solutions");
  const std::string scene = SceneFlag("two_balls");
  const json best = Solve("--contact=event --solver=ceres_event --output_dir=" + directory + scene)["runs"][0];
  ASSERT_EQ(best["termination"], "converged");
  const std::string json_file = Write("best.json", best);
  const std::string npz_file = directory + "/two_balls_event_ceres_event.npz";
  for (const std::string& file : {json_file, npz_file}) {
    const json checked = Solve("--contact=event,direct_toi --solver=none --control=" + file + scene)["runs"];
    EXPECT_EQ(checked[0]["exact_loss"], best["exact_loss"]);
    EXPECT_EQ(checked[0]["certificate"]["verdict"], "stationary");
    EXPECT_EQ(checked[0]["exact_final_state"], best["exact_final_state"]);
    EXPECT_NEAR(checked[1]["loss"].get<double>(), best["exact_loss"].get<double>(), 0.05);
  }
  for (const std::string& flag : {"--control=" + json_file, "--warm_start=" + npz_file}) {
    const json again = Solve("--contact=event --solver=ceres_event,hmp,gd --iterations=20 " + flag + scene)["runs"];
    EXPECT_NEAR(again[0]["initial_loss"].get<double>(), best["exact_loss"].get<double>(), 1e-12);
    EXPECT_LE(again[0]["iterations"], 3);
    EXPECT_NEAR(again[1]["initial_loss"].get<double>(), best["exact_loss"].get<double>(), 1e-12);
    EXPECT_NEAR(again[2]["initial_loss"].get<double>(), best["exact_loss"].get<double>(), 1e-4);
  }
  const StatusOr<NpzArrays> arrays = ReadNpz(npz_file);
  ASSERT_TRUE(arrays.ok());
  EXPECT_EQ(arrays->at("times").shape, (std::vector<int64_t>{481}));
  EXPECT_EQ(arrays->at("states").shape, (std::vector<int64_t>{481, 2, 4}));
  EXPECT_EQ(arrays->at("exact_states").shape[2], 4);
  EXPECT_EQ(Doubles(arrays->at("states")).back(), best["final_state"][1][3].get<double>());
  EXPECT_THAT(std::get<std::vector<std::string>>(arrays->at("scene").data)[0], HasSubstr("name: two_balls"));
  std::filesystem::remove_all(directory);
}

TEST(SolutionStates, EveryRunHasAFileOfItsOwn) {
  const std::string folder = TempFile("files_of_runs");
  const auto files = [&](const std::string& solvers) {
    std::filesystem::remove_all(folder);
    Solve("--contact=event --iterations=5 --solver=" + solvers + " --output_dir=" + folder + SceneFlag("two_balls"));
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      if (entry.path().extension() == ".npz") names.push_back(entry.path().filename());
    }
    std::ranges::sort(names);
    return names;
  };
  using testing::ElementsAre;
  const std::string own = "two_balls_event_ceres_phases.npz";  // by the solver that auto takes
  EXPECT_THAT(files("auto"), ElementsAre(own));
  EXPECT_THAT(files("auto,ceres_phases"), ElementsAre("two_balls_event_auto.npz", own));
  EXPECT_THAT(files("gd,auto"), ElementsAre(own, "two_balls_event_gd.npz"));
  std::filesystem::remove_all(folder);
}

TEST(SolutionStates, WallsThatEndAreNamedAndDrawn) {
  const json scene = {{"name", "edge"},
                      {"duration", 1.0},
                      {"steps", 60},
                      {"gravity", {0, -9.8}},
                      {"bodies", {{{"name", "ball"}, {"radius", 0.1}, {"mass", 1}, {"position", {0, 1}}}}},
                      {"segments", {{{"name", "gate"}, {"from", {-1, 0}}, {"to", {1, 0}}}}},
                      {"objective", {{"terminal", {{{"body", "ball"}, {"quantity", "position"}, {"target", {0, 0}}}}}}},
                      {"optimize", "none"}};
  const std::string file = Write("edge.yaml", scene), folder = TempFile("edge");
  const json run =
      Solve("--solver=none --contact=event --states --scene=" + file + " --output_dir=" + folder)["runs"][0];
  ASSERT_FALSE(run["exact_touches"].empty()) << run.dump().substr(0, 500);
  EXPECT_EQ(run["exact_touches"][0]["b"], "gate");
  EXPECT_NEAR(run["exact_touches"][0]["begin"].get<double>(), std::sqrt(2 * 0.9 / 9.8), 1e-9);
  EXPECT_THAT(ContentsOf(folder + "/report.html"),
              HasSubstr(R"("outlines":[{"name":"gate","points":[[-1.0,0.0],[1.0,0.0]],"solid":"neither"}])"));
}

TEST(SolutionStates, AVelocityIsAWarmStartToo) {
  const std::string scene = SceneFlag("ground_wall");
  const json first = Solve("--contact=direct_toi --solver=gd --iterations=20" + scene)["runs"][0];
  const std::string file = Write("launch.json", {{"velocity", first["velocity"]}});
  const json second = Solve("--contact=direct_toi --solver=gd --iterations=10 --warm_start=" + file + scene)["runs"][0];
  EXPECT_EQ(second["initial_loss"], first["final_loss"]);
  const json whole = Solve("--contact=direct_toi --solver=gd --iterations=30" + scene)["runs"][0];
  EXPECT_EQ(second["final_loss"], whole["final_loss"]);
}

// The parameters that a run has found are a part of its solution.
TEST(SolutionStates, ParametersAreAWarmStartToo) {
  const std::string path = TempFileWith("thrown.yaml", R"(name: thrown
duration: 1
steps: 4
bodies: [{name: ball, radius: 0.1, mass: 1, position: [-1, 0], velocity: [3, 0]}]
planes: [{name: wall, point: [0.5, 0], normal: [-1, 0]}]
contact: {restitution: 0.9}
control: {bodies: [ball], initial: [[0, 0]]}
objective: {terminal: [{body: ball, quantity: position, target: [-0.9, 0.2], weight: 30}], effort: 0.02}
optimize: [control, {parameter: offset.wall, min: -0.2, max: 0.3}, {parameter: restitution, min: 0.5, max: 0.95}]
)");
  const std::string flags = "--contact=event --scene=" + path, folder = TempFile("thrown");
  const json found = Solve(flags + " --solver=ceres_phases --output_dir=" + folder)["runs"][0];
  ASSERT_GT(std::abs(found["parameters"]["offset.wall"].get<double>()), 1e-3) << found["parameters"];
  const std::string json_file = Write("thrown.json", found), npz_file = folder + "/thrown_event_ceres_phases.npz";
  for (const std::string& start : {"--control=" + json_file, "--warm_start=" + json_file, "--warm_start=" + npz_file}) {
    const json simulated = Solve(flags + " --solver=none " + start)["runs"][0];
    EXPECT_NEAR(simulated["exact_loss"].get<double>(), found["exact_loss"].get<double>(), 1e-9) << start;
    EXPECT_EQ(simulated["parameters"], found["parameters"]) << start;
  }
  // The wall is drawn where it was found.
  const json drawn = Solve(flags + " --solver=none --states --control=" + json_file);
  const double at = 0.5 - found["parameters"]["offset.wall"].get<double>();  // along [-1, 0]
  const json moved = drawn["runs"][0]["planes"][0]["point"];
  EXPECT_NEAR(moved[0].get<double>(), at, 1e-12);
  const std::string drawn_file = Write("drawn.json", drawn);
  for (const std::string& file : {drawn_file, drawn_file + " --scene=" + path, npz_file + " --scene=" + path}) {
    const Outcome page = RunProgram("saltus_replay " + file + " --output=" + folder + "/replay.html");
    ASSERT_EQ(page.exit_code, 0) << page.errors;
    EXPECT_THAT(ContentsOf(folder + "/replay.html"), HasSubstr(moved.dump())) << file;
  }
  // Each of several runs is drawn with its own wall.
  json two = drawn;
  two["runs"].push_back(drawn["runs"][0]);
  two["runs"][1]["parameters"]["offset.wall"] = 0.25;
  two["runs"][1]["planes"][0]["point"] = {0.25, 0};
  const std::string both = Write("two.json", two), of_scene = both + " --scene=" + path;
  for (const std::string& files : {both, of_scene, drawn_file + " " + both}) {
    const Outcome page = RunProgram("saltus_replay " + files + " --output=" + folder + "/two.html");
    ASSERT_EQ(page.exit_code, 0) << page.errors;
    EXPECT_THAT(ContentsOf(folder + "/two.html"), AllOf(HasSubstr(moved.dump()), HasSubstr("[0.25,0.0]"))) << files;
  }
  const json again = Solve(flags + " --solver=ceres_phases --warm_start=" + npz_file)["runs"][0];
  EXPECT_NEAR(again["initial_loss"].get<double>(), found["final_loss"].get<double>(), 1e-9);
  const double offset = found["parameters"]["offset.wall"];
  EXPECT_NEAR(again["parameters"]["offset.wall"].get<double>(), offset, 1e-5);  // from the wall of the scene
  const std::string beyond = Write("beyond.json", {{"parameters", {{"restitution", 0.96}}}});
  const Outcome refused = RunProgram("saltus_solve --progress=none --solver=gd --warm_start=" + beyond + " " + flags);
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.errors, HasSubstr("parameters.restitution: found 0.96, expected a value from 0.5 to 0.95"));
  std::filesystem::remove_all(folder);
}

// The position of a fixed disc is not the scene's, where it is a parameter that was found.
TEST(SolutionStates, AFoundPositionIsAWarmStartToo) {
  const std::string flags = "--contact=event" + SceneFlag("post_shot"), folder = TempFile("post");
  const json found = Solve("--solver=ceres_phases --output_dir=" + folder + " " + flags)["runs"][0];
  ASSERT_NE(found["parameters"]["position.post.y"], 0);
  for (const std::string& file : {Write("post.json", found), folder + "/post_shot_event_ceres_phases.npz"}) {
    const json again = Solve("--solver=none --warm_start=" + file + " " + flags)["runs"][0];
    EXPECT_NEAR(again["exact_loss"].get<double>(), found["exact_loss"].get<double>(), 1e-9) << file;
    EXPECT_EQ(again["parameters"], found["parameters"]) << file;
  }
  std::filesystem::remove_all(folder);
}

// A disc strikes a peg head-on. By symmetry the derivative by the height of the peg vanishes, and the loss is largest
// there: a peg that is higher or lower takes less of the speed that the disc should have at the end.
TEST(SolutionStates, AMaximumAlongAParameterIsNoMinimum) {
  const std::string path = TempFileWith("head_on.yaml", R"(name: head_on
duration: 1
steps: 8
bodies:
  - {name: ball, radius: 0.1, mass: 1, position: [-0.5, 0], velocity: [2, 0]}
  - {name: peg, radius: 0.2, fixed: true, position: [0.5, 0]}
contact: {restitution: 0.9}
control: {bodies: [ball], initial: [[0, 0]]}
objective: {terminal: [{body: ball, quantity: velocity, target: [1, 0]}], effort: 50}
optimize: [control, {parameter: position.peg.y, min: -0.25, max: 0.25}]
)");
  for (const std::string solver : {"ceres_phases", "ceres_event", "ceres_lm"}) {
    const json run = Solve("--contact=event --solver=" + solver + " --scene=" + path)["runs"][0];
    if (std::abs(run["parameters"]["position.peg.y"].get<double>()) > 0.1) continue;  // it has left the maximum
    EXPECT_THAT(run["certificate"]["in_words"].get<std::string>(), testing::StartsWith("saddle")) << solver;
    EXPECT_EQ(run["termination"], "no_progress") << solver;
  }
}

// The loss of a motion that touches nothing does not depend on where the post is.
TEST(SolutionStates, ParametersWithoutMeaningAreNamed) {
  const json run = Solve("--contact=event --solver=ceres_lm" + SceneFlag("post_shot"))["runs"][0];
  ASSERT_TRUE(run["events"].empty()) << run["events"];
  EXPECT_THAT(run["reason"].get<std::string>(), HasSubstr("the loss does not depend on position.post.x"));
}

TEST(SolutionStates, ParametersAloneBesideAFreeDurationAreRefused) {
  const std::string path = TempFileWith("launched.yaml", R"(name: launched
duration: 1
steps: 16
bodies:
  - {name: a, radius: 0.1, mass: 1, position: [-1, 0], velocity: [1, 0]}
  - {name: b, radius: 0.15, mass: 0.8, position: [-0.3, 0.05]}
free: [a]
objective:
  terminal: [{body: b, quantity: position, target: [0.15, 0.25]}]
  duration: {free: true, min: 0.5, max: 2}
optimize: [velocity, mass.b]
)");
  const Outcome refused = RunProgram("saltus_solve --progress=none --contact=event --solver=auto --scene=" + path);
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.errors, HasSubstr("the duration is free: no solver takes both"));
}

TEST(SolutionStates, WrongFilesAreRefusedByPlace) {
  const std::string scene = SceneFlag("two_balls");
  const json row = json::array({json::array({1, 2})});
  const struct {
    std::string flags, message;
  } cases[] = {
      {"--control=/nonexistent.json" + scene, "nonexistent"},
      {"--control=" + Write("text.json", "text") + scene, "expected an object"},
      {"--control=" + Write("none.json", {{"velocity", {{0, 0}, {0, 0}}}}) + scene, "expected a control"},
      {"--control=" + Write("short.json", {{"control", {row, {{1}}}}}) + scene, "control[1][0]"},
      {"--control=" + Write("wide.json", {{"control", {{{1, 2}, {3, 4}}}}}) + scene, "a list of 1 times"},
      {"--control=" + Write("long.json", {{"control", {row, row}}, {"durations", {0.5, 0.6}}}) + scene, "1.1 s"},
      {"--control=" + Write("odd.json", {{"control", {row, row}}, {"durations", json::array({1.0})}}) + scene,
       "durations"},
      {"--control=" + Write("runs.json", {{"runs", {1, 2}}}) + scene, "one run, found 2"},
      {"--warm_start=" + Write("other.json", {{"control", json::array({row})}, {"velocity", {{0, 0}, {1, 0}}}}) + scene,
       "target"},
      {"--states" + scene + "--json=false", "--json"},
  };
  for (const auto& [flags, message] : cases) {
    const Outcome outcome = RunProgram("saltus_solve --contact=event --solver=gd --progress=none --json " + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << flags;
  }
}

}  // namespace
}  // namespace saltus
