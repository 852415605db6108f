// Every program with every kind of input and every output that it has: that it ends as it should, with an answer, and
// that what it writes can be read. 84 inputs; with their outputs 349 runs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "base/file.h"
#include "folders.h"
#include "output/npz.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;

// Features that the scenes of the problems do not have.
constexpr char kSpin[] = R"(
name: spin
duration: 0.8
steps: 24
gravity: [0, -9.81]
bodies:
  - {name: ball, radius: 0.1, mass: 1, inertia: solid, position: [0, 0.5], velocity: [1, 0], angular_velocity: 5}
planes: [{name: ground, point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.6, friction: 0.3}
control: {bodies: [ball], torque: [ball], initial: [[0.5, 0.1, 0.02]]}
objective: {terminal: [{body: ball, quantity: position, target: [0.4, 0.3], weight: 1.0}], effort: 0.1}
optimize: control
)";
constexpr char kEdges[] = R"(
name: edges
duration: 0.6
steps: 24
gravity: [0, -9.81]
bodies: [{name: ball, radius: 0.1, mass: 1, position: [0, 1], velocity: [0.7, 0]}]
segments: [{name: gate, from: [-1, 0], to: [2, 0.1]}]
arcs: [{name: bowl, center: [0, 3], radius: 3.5, from: 3.5, to: 5.9}]
polygons: [{name: box, points: [[1, 0.3], [1.4, 0.3], [1.4, 0.7], [1, 0.7]], solid: inside}]
contact: {restitution: 0.5}
objective: {terminal: [{body: ball, quantity: velocity, target: [0, 0], weight: 1.0}]}
optimize: velocity
)";
constexpr char kTable[] = R"(
name: table
duration: 2.0
steps: 24
table: {friction: 0.1, gravity: 9.81}
bodies:
  - {name: cue, radius: 0.03, mass: 0.2, position: [0, 0], velocity: [1.5, 0.05]}
  - {name: coin, radius: 0.03, mass: 0.2, position: [0.4, 0.02]}
pockets: [{name: hole, position: [0.8, 0.2], radius: 0.05}]
contact: {restitution: 0.9}
objective: {terminal: [{body: coin, quantity: position, target: [0.8, 0.2], weight: 1.0}]}
optimize: velocity
)";
constexpr char kAtOnce[] = R"(
name: at_once
duration: 1.0
steps: 16
bodies:
  - {name: left, radius: 0.25, mass: 1, position: [-1, 0], velocity: [2, 0]}
  - {name: middle, radius: 0.25, mass: 1, position: [0, 0]}
  - {name: right, radius: 0.25, mass: 1, position: [1, 0], velocity: [-2, 0]}
contact: {restitution: 1.0}
objective: {terminal: [{body: middle, quantity: position, target: [0.1, 0], weight: 1.0}]}
optimize: velocity
)";
// Two balls with bounds on the force; the target is to reach its place.
std::string Bounded(const std::string& name, const std::string& how) {
  return "name: " + name + R"(
duration: 1.0
steps: 24
bodies:
  - {name: striker, radius: 0.2, mass: 1.0, position: [-2, -2]}
  - {name: target, radius: 0.2, mass: 1.0, position: [-1, -1]}
contact: {restitution: 1.0}
control: {bodies: [striker], initial: [[3, 3]], max: 8}
objective: {terminal: [{body: target, quantity: position, target: [0, 0], )" +
         how + R"(}], effort: 0.1}
optimize: control
)";
}
constexpr char kStates[] = R"({"bodies": [{"name": "ball", "radius": 0.2}],
 "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
 "times": [0, 0.1], "states": [[[0, 1, 2, 0]], [[0.2, 1, 2, 0]]],
 "touches": [{"a": "ball", "b": "ground", "begin": 0.1}]})";
constexpr char kGiven[] = R"({"name": "given", "position": [[-0.4, -0.4], [-0.3, -0.3]],
 "velocity": [[-0.5, -0.5], [-0.3, -0.3]]})";

struct Output {
  bool json = false, files = false, states = false;
};
const std::vector<Output> kUsual = {{}, {.json = true}, {.files = true}, {.json = true, .files = true}};
const std::vector<Output> kWithStates = {{},
                                         {.json = true},
                                         {.files = true},
                                         {.json = true, .files = true},
                                         {.json = true, .states = true},
                                         {.json = true, .files = true, .states = true}};

struct Input {
  std::string name;
  std::string command;  // with {folder}, {problems}, {bin} for these
  int exit_code = 0;
  std::string says = "";  // on standard error, if it is not 0
};

// Two balls in few steps.
const std::string kBalls = " --scene={problems}/two_balls.yaml --steps=24 ";
const std::string kNone = "no answer from 1 of 1 runs";

std::string Box(const std::string& name, const std::string& contact, const std::string& offer) {
  return " --simulate=\"" + name + "={bin}/saltus_simulate --contact=" + contact + " --offer=" + offer + "\" ";
}
const std::string kMine = " --simulate=\"mine=python3 {folder}/mine.py\" ";

const std::vector<Input> kAudits = {
    {"event", kBalls + "--contact=event"},
    {"wrong_model", kBalls + "--contact=direct"},
    {"models", kBalls + "--contact=event,direct,toi_velocity,compliant_brax"},
    {"options", kBalls + "--contact=ncp:kappa=1e-6,xpbd:substeps=5"},
    {"float", kBalls + "--contact=direct --precision=float"},
    {"widths", kBalls + "--contact=direct --width_sweep"},
    {"simulator_of_the_readme", kBalls + kMine},
    {"box_that_offers_all", kBalls + Box("box", "direct", "gradient,step,states")},
    {"box_that_offers_a_gradient", kBalls + Box("box", "direct_toi", "gradient") + "--contact=event"},
    {"box_called_as_a_model", kBalls + Box("direct", "direct", "gradient,step,states")},
    {"box_called_as_the_exact_model", kBalls + Box("event", "direct_toi", "none") + "--contact=direct"},
    {"box_that_is_wide", kBalls + Box("box", "direct", "step") + "--width_sweep"},
    {"box_that_ends", kBalls + "--simulate=broken=false", 1, "'false': the greeting: ended with exit code 1"},
    {"box_beside_models_that_ends", kBalls + "--simulate=broken=false --contact=event", 1, "no gradient of 1 of 2"},
    {"box_that_refuses", "--scene={folder}/edges.yaml" + Box("box", "direct", "none"), 2, "walls that end"},
    {"two_boxes", kBalls + Box("one", "direct", "none") + Box("two", "event", "none")},
    {"given", kBalls + "--contact=event --given={folder}/given.json"},
    {"given_of_a_disc_that_spins",
     "--scene={problems}/back_spin.yaml --steps=24 --contact=event --given={folder}/spin.json"},
    {"wrong_model_that_fails",
     kBalls + "--contact=event,direct --fail_on_wrong",
     1,
     "wrong gradients of 1 of 2 (direct: "},
    {"right_model_that_may_fail", kBalls + "--contact=event --fail_on_wrong"},
    {"wrong_given_that_fails", kBalls + "--contact=event --given={folder}/given.json --fail_on_wrong", 1},
    {"zeroth_surrogate", kBalls + "--contact=direct --surrogate=smoothed_zeroth --surrogate_samples=8"},
    {"surrogate_of_lcp", kBalls + "--contact=lcp --surrogate=complementarity_aware"},
    {"spin", "--scene={folder}/spin.yaml --contact=event,direct,pbd_brax"},
    {"edges", "--scene={folder}/edges.yaml --contact=event,direct"},
    {"table", "--scene={folder}/table.yaml --contact=event"},
    {"model_that_refuses", "--scene={folder}/table.yaml --contact=direct", 2, "error: direct: "},
    {"at_once", "--scene={folder}/at_once.yaml --contact=event,direct"},
    {"constrained", "--scene={folder}/constrained.yaml --contact=event", 1, "no gradient of 1 of 1 (event: "},
    {"rollout_that_fails",
     "--scene={problems}/two_balls.yaml --steps=24 --contact=primal_descent --stiffness=1e15",
     1,
     "no gradient of 1 of 1 (primal_descent: "},
};

const std::vector<Input> kSolves = {
    {"gd", kBalls + "--contact=direct --solver=gd --iterations=5", 1, kNone + " (direct gd: iteration_limit)"},
    {"ceres_lbfgs", kBalls + "--contact=event --solver=ceres_lbfgs --iterations=5", 1, kNone},
    {"ceres_lm", kBalls + "--contact=direct_toi --solver=ceres_lm --iterations=50"},
    {"ceres_shooting", kBalls + "--contact=event --solver=ceres_shooting --iterations=5", 1, kNone},
    {"ceres_lagrangian", kBalls + "--contact=direct_toi --solver=ceres_lagrangian --iterations=5", 1, kNone},
    {"ceres_event", kBalls + "--contact=event --solver=ceres_event"},
    {"ceres_phases", kBalls + "--contact=event --solver=ceres_phases"},
    {"hmp", kBalls + "--contact=event --solver=hmp"},
    {"mode_search", kBalls + "--contact=event --solver=mode_search --search_seconds=0 --search_starts=1"},
    {"grid_optimum", kBalls + "--contact=event --solver=grid_optimum --steps=48"},
    {"several",
     kBalls + "--contact=event,direct --solver=ceres_event,gd --iterations=5",
     1,
     "no answer from 2 of 3 runs"},
    {"none", kBalls + "--contact=event,direct,compliant_brax --solver=none"},
    {"surrogate",
     kBalls + "--contact=direct --solver=gd --iterations=3 --surrogate=smoothed_first --surrogate_samples=4",
     1,
     kNone},
    {"start", kBalls + "--contact=event --solver=none --control={folder}/start.json"},
    {"spin", "--scene={folder}/spin.yaml --contact=event --solver=ceres_lm --iterations=3", 1, kNone},
    {"edges", "--scene={folder}/edges.yaml --contact=event --solver=gd --iterations=3", 1, kNone},
    {"table", "--scene={folder}/table.yaml --contact=event --solver=none"},
    {"bounded", "--scene={folder}/bounded.yaml --contact=event --solver=ceres_phases"},
    {"float", kBalls + "--contact=direct --solver=gd --precision=float --iterations=3", 1, kNone},
    {"rollout_that_fails",
     "--scene={problems}/two_balls.yaml --steps=24 --contact=primal_descent --stiffness=1e15 --solver=none",
     1,
     kNone},
};

const std::vector<Input> kSweeps = {
    {"models", kBalls + "--contact=event,direct --solver=none --sweep=steps=8,16,24"},
    {"solver", kBalls + "--contact=event --solver=gd --iterations=3 --sweep=restitution=0.5,1"},
    {"map", kBalls + "--contact=direct --solver=none --sweep=\"steps=8,16;restitution=0.5,1\""},
    {"simulator_of_the_readme", kBalls + "--solver=none --sweep=steps=8,16" + kMine},
    {"box_beside_a_model", kBalls + "--contact=event --solver=none --sweep=steps=8" + Box("box", "direct", "gradient")},
    {"box_that_ends", kBalls + "--solver=none --sweep=steps=8 --simulate=broken=false", 1, "ended with exit code 1"},
    {"seeds", "--sweep=seed=0,1 --contact=event --solver=gd --iterations=3"},
    {"surrogate",
     kBalls + "--contact=direct --solver=none --sweep=steps=8 --surrogate=smoothed_first --surrogate_samples=4"},
    {"precision", kBalls + "--contact=direct --solver=none --sweep=precision=float,double"},
    {"spin", "--scene={folder}/spin.yaml --contact=event --solver=none --sweep=friction=0,0.3"},
    {"a_bad_point", kBalls + "--contact=event --solver=none --sweep=steps=0,8", 0, "1 failed"},
    {"no_good_point", kBalls + "--contact=event --solver=none --sweep=steps=0", 1, "1 failed"},
};

const std::string kDrops = " --scene={problems}/drops/drops.yaml --recording={problems}/drops/drop_1.csv ";
const std::vector<Input> kIdentifications = {
    {"contradicted", kDrops + "--starts=2", 1, "event: contradicted"},
    {"bounce", "--scene={folder}/bounce.yaml --recording={folder}/bounce.csv"},
    {"bounce_under_models", "--scene={folder}/bounce.yaml --recording={folder}/bounce.csv --contact=event,direct_toi"},
    {"not_determined",
     "--scene={folder}/bounce.yaml --recording={folder}/bounce.csv --restitution=0.8 --unknown=mass.ball",
     1,
     "event: not determined"},
    {"law", kDrops + "--law=network:1 --starts=2"},
    {"events", kDrops + "--events=affine --starts=2"},
};

const std::vector<Input> kProblems = {
    {"bounce_once", "bounce_once --steps=24 --contact=event,direct --solver=none"},
    {"ground_wall", "ground_wall --steps=24 --contact=event,direct --solver=none"},
    {"two_balls", "two_balls --steps=24 --contact=event,direct --solver=ceres_event"},
    {"single_collision",
     "single_collision --steps=24 --contact=event,direct --solver=gd --iterations=3",
     1,
     "no answer from 2 of 2"},
    {"multiple_collisions", "multiple_collisions --steps=24 --contact=event --solver=ceres_event"},
    {"back_spin", "back_spin --steps=24 --contact=event,direct --solver=none"},
    {"bank_shot", "bank_shot --steps=24 --contact=event --solver=none"},
    {"carrom_gate", "carrom_gate --steps=24 --contact=event --solver=none"},
    {"carrom_pot", "carrom_pot --steps=24 --contact=event --solver=none"},
};

// NaN or infinity, as printf writes them.
std::string NoNumberIn(const std::string& text) {
  static const std::regex pattern("(^|[^A-Za-z0-9_./'-])[-+]?(nan|inf|infinity)($|[^A-Za-z0-9_./'-])",
                                  std::regex::icase);
  std::smatch found;
  // Lines, as std::regex takes stack for every character.
  std::stringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.size() < 10000 && std::regex_search(line, found, pattern)) return line;
  }
  return "";
}

// A page's scripts speak of infinity.
std::string WithoutScripts(std::string page) {
  for (std::size_t begin; (begin = page.find("<script")) != std::string::npos;) {
    const std::size_t end = page.find("</script>", begin);
    page.erase(begin, end == std::string::npos ? end : end - begin + 9);
  }
  return page;
}

void CheckNpz(const std::string& path) {
  const StatusOr<NpzArrays> arrays = ReadNpz(path);
  ASSERT_TRUE(arrays.ok()) << arrays.status().message();
  EXPECT_FALSE(arrays->empty()) << path;
  if (fs::path(path).filename().string().starts_with("sweep")) return;  // NaN is where a row has no value
  for (const auto& [key, array] : *arrays) {
    const auto* numbers = std::get_if<std::vector<double>>(&array.data);
    if (numbers == nullptr) continue;
    EXPECT_TRUE(std::all_of(numbers->begin(), numbers->end(), [](double x) { return std::isfinite(x); }))
        << path << " " << key;
  }
}

// Every row has as many cells as the header.
void CheckCsv(const std::string& path, const std::string& text) {
  std::size_t width = 0, rows = 0;
  bool quoted = false;
  std::size_t cells = 1;
  for (const char c : text) {
    if (c == '"') quoted = !quoted;
    if (c == ',' && !quoted) ++cells;
    if (c != '\n' || quoted) continue;
    if (rows++ == 0) width = cells;
    EXPECT_EQ(cells, width) << path << ", row " << rows;
    cells = 1;
  }
  EXPECT_GT(rows, 0u) << path;
  EXPECT_EQ(NoNumberIn(text), "") << path;
}

void CheckFile(const std::string& path) {
  const StatusOr<std::string> read = ReadFile(path);
  ASSERT_TRUE(read.ok()) << read.status().message();
  const std::string& text = *read;
  const std::string kind = fs::path(path).extension();
  if (kind == ".npz") return CheckNpz(path);
  if (kind == ".csv") return CheckCsv(path, text);
  if (kind == ".html") {
    EXPECT_THAT(text, HasSubstr("</html>")) << path;
    EXPECT_EQ(NoNumberIn(WithoutScripts(text)), "") << path;
  } else if (kind == ".json") {
    EXPECT_TRUE(json::accept(text)) << path;
  } else if (kind == ".md") {
    EXPECT_FALSE(text.empty()) << path;
    EXPECT_EQ(NoNumberIn(text), "") << path;
  } else {
    ADD_FAILURE() << path << ": what is this?";
  }
}

// Checks that every number of a document is finite: JSON has no others, and null stands where one is missing.
void CheckJson(const std::string& text) {
  const json document = json::parse(text, nullptr, /*allow_exceptions=*/false);
  ASSERT_FALSE(document.is_discarded()) << text.substr(0, 300);
  EXPECT_FALSE(document.empty());
}

class Combinations : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = TempFile("combinations");
    fs::create_directories(folder_);
    const auto write = [&](const std::string& name, const std::string& text) {
      std::ofstream(folder_ + "/" + name) << text;
    };
    write("spin.yaml", kSpin);
    write("edges.yaml", kEdges);
    write("table.yaml", kTable);
    write("at_once.yaml", kAtOnce);
    write("constrained.yaml", Bounded("constrained", "hard: true"));
    write("bounded.yaml", Bounded("bounded", "weight: 1.0"));
    write("given.json", kGiven);
    write("spin.json", R"({"name": "given", "angular_velocity": [0.1], "angle": [null]})");
    write("states.json", kStates);
    json start;
    for (int k = 0; k < 24; ++k) start["control"].push_back({{2.0, 2.5}});
    write("start.json", start.dump());
    // The simulator of the documentation, as it stands there.
    const std::string page = *ReadFile(SourceFolder() + "/docs/how-to/audit-a-simulator.md"),
                      first = "import json\nimport math\n";
    const std::size_t begin = page.find(first);
    ASSERT_NE(begin, std::string::npos);
    write("mine.py", page.substr(begin, page.find("```", begin) - begin));
    // A ball that is dropped with restitution 0.8, in closed form, with errors of a millimetre.
    write("bounce.yaml",
          "name: bounce\nduration: 0.9\nsteps: 60\ngravity: [0, -10]\n"
          "bodies: [{name: ball, radius: 0.1, mass: 0.3, position: [0, 1.35]}]\n"
          "planes: [{name: floor, point: [0, 0], normal: [0, 1]}]\ncontact: {restitution: 0.5}\n"
          "objective: {terminal: [{body: ball, quantity: position, target: [0, 0], weight: 1.0}]}\noptimize: none\n");
    std::ostringstream recording;
    recording << "time,body,x,y,sigma\n";
    for (int k = 0; k <= 27; ++k) {
      const double t = k / 30.0, after = t - 0.5;  // it falls 1.25 m in 0.5 s
      const double height = t <= 0.5 ? 1.25 - 5 * t * t : 0.8 * 5 * after - 5 * after * after;
      recording << t << ",ball," << (k % 3 - 1) * 1e-3 << "," << 0.1 + height + ((k * 7) % 5 - 2) * 5e-4 << ",0.001\n";
    }
    write("bounce.csv", recording.str());
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static std::string Filled(std::string command) {
    const std::pair<std::string, std::string> places[] = {
        {"{folder}", folder_}, {"{problems}", SourceFolder() + "/problems"}, {"{bin}", BuildFolder() + "/bin"}};
    for (const auto& [place, text] : places) {
      for (std::size_t at; (at = command.find(place)) != std::string::npos;) command.replace(at, place.size(), text);
    }
    return command;
  }

  // Runs a program with an input and each output, and checks all that comes out.
  static void Run(const std::string& program, const Input& input, const std::vector<Output>& outputs) {
    for (const Output output : outputs) {
      const std::string directory = folder_ + "/out";
      fs::remove_all(directory);
      std::string command = program + " " + Filled(input.command) + " --progress=none --threads=2";
      if (output.json) command += " --json";
      if (output.states) command += " --states";
      if (output.files) command += " --output_dir=" + directory;
      SCOPED_TRACE(command);
      const Outcome outcome = RunProgram(command);
      EXPECT_EQ(outcome.exit_code, input.exit_code) << outcome.errors << outcome.output.substr(0, 2000);
      EXPECT_THAT(outcome.errors, HasSubstr(input.says));
      // A sweep of seeds has a table of what each solver solves there, and reports are named there beside data.
      if (input.exit_code == 0 && input.says.empty() && !output.files && input.name != "seeds") {
        EXPECT_EQ(outcome.errors, "");
      }
      EXPECT_FALSE(outcome.output.empty());
      EXPECT_EQ(NoNumberIn(outcome.output), "");
      EXPECT_EQ(NoNumberIn(outcome.errors), "");
      if (output.json) CheckJson(outcome.output);
      if (!output.files) continue;
      std::set<std::string> kinds;
      for (const auto& entry : fs::directory_iterator(directory)) {
        CheckFile(entry.path());
        kinds.insert(entry.path().extension());
      }
      EXPECT_TRUE(kinds.contains(".html")) << "no report";
      if (program == "saltus_sweep") continue;  // says nothing without progress
      EXPECT_THAT(output.json ? outcome.errors : outcome.output, HasSubstr(directory + "/report.html"));
    }
  }

  static std::string folder_;
};
std::string Combinations::folder_;

TEST_F(Combinations, Audits) {
  for (const Input& input : kAudits) Run("saltus_audit", input, kUsual);
}

TEST_F(Combinations, Solves) {
  for (const Input& input : kSolves) Run("saltus_solve", input, kWithStates);
}

TEST_F(Combinations, Sweeps) {
  for (const Input& input : kSweeps) Run("saltus_sweep", input, kUsual);
}

TEST_F(Combinations, Identifications) {
  for (const Input& input : kIdentifications) Run("saltus_identify", input, kUsual);
}

TEST_F(Combinations, Problems) {
  for (Input input : kProblems) {
    const std::string program = input.name;
    input.command = input.command.substr(program.size());
    Run(program, input, kUsual);
  }
}

// Replays every kind of file that has motions, and several of them.
TEST_F(Combinations, Replays) {
  const std::string directory = folder_ + "/solved", page = folder_ + "/page.html";
  const std::string solve = Filled("saltus_solve" + kBalls + "--contact=event,direct --solver=none --progress=none ");
  ASSERT_EQ(RunProgram(solve + "--output_dir=" + directory).exit_code, 0);
  ASSERT_EQ(RunProgram(solve + "--json --states >" + folder_ + "/solved.json").exit_code, 0);
  const std::string npz = directory + "/two_balls_event_none.npz", other = directory + "/two_balls_direct_none.npz";
  const std::string files[] = {npz,
                               other,
                               folder_ + "/solved.json",
                               folder_ + "/states.json",
                               npz + " " + other,
                               npz + " " + folder_ + "/solved.json"};
  for (const std::string& file : files) {
    for (const std::string scene : {"", "--scene={problems}/two_balls.yaml"}) {
      if (!scene.empty() && file.find("states.json") != std::string::npos) continue;  // is of another scene
      fs::remove(page);
      const Outcome outcome = RunProgram(Filled("saltus_replay " + file + " " + scene + " --output=" + page));
      EXPECT_EQ(outcome.exit_code, 0) << file << "\n" << outcome.errors;
      EXPECT_EQ(outcome.output, page + "\n");
      CheckFile(page);
    }
  }
}

// saltus_simulate around every contact model, with what it may offer in turns.
TEST_F(Combinations, Simulators) {
  const std::string offers[] = {"none", "gradient", "step", "gradient,step,states"};
  std::stringstream lines(RunProgram("saltus_audit --contact=list").output);
  std::size_t models = 0;
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with(" ")) continue;  // an option
    const std::string box = Box("box", line.substr(0, line.find(' ')), offers[models++ % 4]);
    const Outcome audit = RunProgram(Filled(
        "saltus_audit --scene={problems}/two_balls.yaml --steps=12 --progress=none --json --attribution_seconds=1" +
        box));
    const json document = json::parse(audit.output, nullptr, /*allow_exceptions=*/false);
    ASSERT_FALSE(document.is_discarded()) << box << audit.output.substr(0, 300);
    EXPECT_EQ(audit.exit_code, 0) << box << audit.errors;
    EXPECT_TRUE(document["audits"][0].contains("verdict")) << box;
  }
  EXPECT_GE(models, 25u);
}

}  // namespace
}  // namespace saltus
