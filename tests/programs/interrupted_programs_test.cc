// Every program is interrupted at random times in each of its phases. It ends by itself, and what it leaves is whole:
// what it prints can be read, and a file is complete or absent.
#include <gmock/gmock.h>

#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>
#include <set>
#include <sstream>

#include "base/interrupt.h"
#include "output/npz.h"
#include "programs/process_at_work.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using testing::HasSubstr;
namespace fs = std::filesystem;

// s, in which a program ends after an interrupt on the busiest machine. Without, each of those below works for minutes.
constexpr std::chrono::seconds kBound = 60s;

fs::path Folder(const std::string& name) {
  const fs::path folder = fs::path(TempFile(name));
  fs::remove_all(folder);
  fs::create_directories(folder / "files");
  return folder;
}

// The files that stand in a folder and below it.
std::vector<fs::path> FilesIn(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code gone;  // a file may be renamed meanwhile
  for (auto at = fs::recursive_directory_iterator(folder, gone); at != fs::recursive_directory_iterator();
       at.increment(gone)) {
    if (at->is_regular_file(gone)) files.push_back(at->path());
  }
  return files;
}

// Every row of a CSV has as many cells as the first one. No cell here has a line break.
void ExpectWholeCsv(const std::string& text, const std::string& name) {
  ASSERT_FALSE(text.empty()) << name;
  EXPECT_EQ(text.back(), '\n') << name;
  const auto cells = [](const std::string& line) {
    bool quoted = false;
    int count = 1;
    for (const char c : line) {
      quoted ^= c == '"';
      count += c == ',' && !quoted;
    }
    return count;
  };
  std::istringstream lines(text);
  std::string first, line;
  std::getline(lines, first);
  for (int row = 1; std::getline(lines, line); ++row) {
    ASSERT_EQ(cells(line), cells(first)) << name << ", row " << row << ": " << line;
  }
}

void ExpectWholeFile(const fs::path& path) {
  const std::string extension = path.extension(), name = path.filename();
  const std::string text = ContentsOf(path);
  if (extension == ".csv") {
    ExpectWholeCsv(text, name);
  } else if (extension == ".json") {
    EXPECT_TRUE(json::accept(text)) << name;
  } else if (extension == ".npz") {
    const auto arrays = ReadNpz(path);
    EXPECT_TRUE(arrays.ok()) << name << ": " << (arrays.ok() ? "" : arrays.status().message());
  } else if (extension == ".html") {
    EXPECT_THAT(text, HasSubstr("</html>")) << name;
  } else if (extension == ".md") {
    ASSERT_FALSE(text.empty()) << name;
    EXPECT_EQ(text.back(), '\n') << name;
  } else {
    ADD_FAILURE() << "a file that is none of the program's: " << name;
  }
}

enum class When { kAtWork, kWriting };

struct Phase {
  std::string name;
  std::string command;  // with FILES in the place of a folder to write to, CROWD in that of a scene of many discs
  When when = When::kAtWork;
  double longest = 4;  // s: the latest interrupt, after the program has begun, or after it has written its first file
  bool json = false;   // what it prints
};

std::string With(std::string command, const std::string& what, const std::string& by) {
  for (size_t at; (at = command.find(what)) != std::string::npos;) command.replace(at, what.size(), by);
  return command;
}

// A scene of many discs, of which an audit takes minutes.
std::string CrowdFile() {
  static const std::string& path = *new std::string([] {
    const Outcome outcome = RunProgram("saltus_scene --kind=gas --discs=120 --seed=2 --steps=400");
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    return TempFileWith("crowd.yaml", outcome.output);
  }());
  return path;
}

std::string Recording() {
  return " --scene=" + SourceFolder() + "/problems/drops/drops.yaml --recording=" + SourceFolder() +
         "/problems/drops/drop_1.csv," + SourceFolder() + "/problems/drops/drop_2.csv ";
}

std::vector<Phase> Phases() {
  const std::string two = SceneFlag("two_balls") + "--progress=none ";
  const std::string crowd = " --scene=CROWD --progress=none ";
  return {
      {"audit_of_a_crowd",
       "saltus_audit" + crowd + "--contact=event,direct_toi --output_dir=FILES --json",
       When::kAtWork,
       8,
       true},
      {"report_of_an_audit",
       "saltus_audit" + crowd + "--contact=event,direct,direct_toi --attribution_seconds=1 --output_dir=FILES --json",
       When::kWriting,
       3,
       true},
      {"audit_of_many_steps",
       "saltus_audit" + two + "--contact=event,direct_toi --steps=1000000 --json",
       When::kAtWork,
       6,
       true},
      {"files_of_many_steps",
       "saltus_audit" + two + "--contact=direct_toi --steps=50000 --output_dir=FILES --json",
       When::kWriting,
       3,
       true},
      {"differences_of_every_width",
       "saltus_audit" + two + "--contact=direct_toi --width_sweep --steps=200000 --json",
       When::kAtWork,
       6,
       true},
      {"descent_of_many_steps",
       "saltus_solve" + two +
           "--contact=direct_toi --solver=gd --iterations=1000000 --steps=1000000 --output_dir=FILES --json",
       When::kAtWork,
       6,
       true},
      {"motion_of_many_steps",
       "saltus_solve" + two + "--contact=direct_toi --solver=none --steps=10000000 --json",
       When::kAtWork,
       6,
       true},
      {"states_of_many_steps",
       "saltus_solve" + two + "--contact=event --solver=none --steps=100000 --states --output_dir=FILES --json",
       When::kWriting,
       3,
       true},
      {"descent",
       "saltus_solve" + two +
           "--contact=event,direct_toi --solver=gd,ceres_lbfgs --iterations=100000000 --output_dir=FILES --json",
       When::kAtWork,
       3,
       true},
      {"search",
       "saltus_solve --progress=none --contact=event --solver=mode_search --iterations=1000000 --search_work=0 "
       "--search_starts=100000 --output_dir=FILES --json" +
           SceneFlag("multiple_collisions"),
       When::kAtWork,
       5,
       true},
      {"search_with_constraints",
       "saltus_solve --progress=none --contact=event --solver=mode_search --iterations=1000000 --search_work=0 "
       "--search_starts=2000 --json" +
           SceneFlag("bank_shot"),
       When::kAtWork,
       5,
       true},
      {"problem",
       "two_balls --progress=none --contact=event,direct_toi --solver=gd --iterations=100000000 --output_dir=FILES "
       "--json",
       When::kAtWork,
       4,
       true},
      {"sweep",
       "saltus_sweep" + two +
           "--contact=direct_toi --solver=gd --iterations=100000 --sweep=effort=0.01:1:log:2000 --output_dir=FILES",
       When::kAtWork,
       4,
       false},
      {"fits",
       "saltus_identify --progress=none --contact=event,direct_toi --unknown=restitution --starts=1000 "
       "--output_dir=FILES --json" +
           Recording(),
       When::kAtWork,
       2,
       true},
      {"reproduction", "saltus_reproduce --progress=none --every_solver --output_dir=FILES", When::kAtWork, 8, false},
      {"files_of_a_reproduction",
       "saltus_reproduce --progress=none --every_solver --output_dir=FILES",
       When::kWriting,
       8,
       false},
  };
}

class InterruptedProgram : public testing::TestWithParam<Phase> {};

TEST_P(InterruptedProgram, EndsByItselfAndLeavesWholeFiles) {
  const Phase& phase = GetParam();
  std::mt19937 random(static_cast<unsigned>(std::hash<std::string>()(phase.name)));
  for (int round = 0; round < 3; ++round) {
    const fs::path folder = Folder(phase.name), files = folder / "files";
    std::string command = With(phase.command, "FILES", files);
    if (command.find("CROWD") != std::string::npos) command = With(command, "CROWD", CrowdFile());
    ProcessAtWork program(command, folder);
    if (phase.when == When::kWriting) {
      program.WaitUntil([&] { return !FilesIn(files).empty(); });
    }
    const double delay = std::uniform_real_distribution<double>(0.02, phase.longest)(random);
    const auto time = std::chrono::steady_clock::now() + std::chrono::duration<double>(delay);
    program.WaitUntil([&] { return std::chrono::steady_clock::now() > time; });
    program.Interrupt();
    const ProcessAtWork::End end = program.WaitForEnd(kBound);
    const std::string what = phase.name + ", interrupted after " + std::to_string(delay) + " s";
    ASSERT_TRUE(end.by_itself) << what << " goes on\n" << program.errors();
    // Before it has begun to compute a program has nothing to keep, and the signal ends it.
    const bool not_begun = end.signal == SIGINT && program.output().empty();
    EXPECT_TRUE(end.exit_code == 0 || end.exit_code == 1 || not_begun)
        << what << ": exit code " << end.exit_code << ", signal " << end.signal << "\n"
        << program.errors();
    if (phase.json && !not_begun) {
      EXPECT_TRUE(json::accept(program.output())) << what;
    }
    for (const fs::path& file : FilesIn(files)) ExpectWholeFile(file);
    fs::remove_all(folder);
  }
}

INSTANTIATE_TEST_SUITE_P(Phases, InterruptedProgram, testing::ValuesIn(Phases()),
                         [](const auto& phase) { return phase.param.name; });

// ---------------------------------------------------------------------------------------------------------------------
// Nothing that is done is lost.

TEST(Interrupted, AReproductionKeepsTheStagesThatAreDone) {
  const fs::path folder = Folder("stages"), files = folder / "files";
  ProcessAtWork program("saltus_reproduce --every_solver --threads=1 --progress=plain --output_dir=" + files.string(),
                        folder);
  // The line that a stage ends with.
  program.WaitUntil(
      [&] { return program.errors().find("comparison with the published values: 1/1") != std::string::npos; });
  program.Interrupt();
  const ProcessAtWork::End end = program.WaitForEnd(kBound);
  ASSERT_TRUE(end.by_itself);
  EXPECT_EQ(end.exit_code, 1);
  EXPECT_THAT(program.errors(), HasSubstr("interrupted"));
  std::set<std::string> names;
  for (const fs::path& file : FilesIn(files)) {
    names.insert(file.filename());
    ExpectWholeFile(file);
  }
  for (const char* table : {"table_T1.md", "table_T1.csv", "table_T2.csv", "table_T3.csv", "table_L4DC.csv"}) {
    EXPECT_EQ(names.count(table), 1u) << table;
  }
  EXPECT_EQ(names.count("report.html"), 0u);
  fs::remove_all(folder);
}

// The solution that was found is written, though its states would take long.
TEST(Interrupted, ASolutionIsWrittenThoughItsStatesAreLeftOut) {
  const fs::path folder = Folder("solution"), files = folder / "files";
  ProcessAtWork program(
      "saltus_solve --progress=plain --contact=event,direct_toi --solver=gd --iterations=1000000000 "
      "--threads=2 --output_dir=" +
          files.string() + " --json" + SceneFlag("two_balls"),
      folder);
  program.WaitUntil([&] { return program.errors().find("direct_toi gd for") != std::string::npos; });
  program.Interrupt();
  const ProcessAtWork::End end = program.WaitForEnd(kBound);
  ASSERT_TRUE(end.by_itself);
  EXPECT_EQ(end.exit_code, 1);
  const json document = json::parse(program.output());
  EXPECT_EQ(document["interrupted"], true);
  ASSERT_EQ(document["runs"].size(), 2u);
  for (const json& run : document["runs"]) {
    EXPECT_EQ(run["termination"], "interrupted");
    ASSERT_EQ(run["control"].size(), 480u);
    const std::string name = "two_balls_" + run["contact"].get<std::string>() + "_gd.npz";
    const auto arrays = ReadNpz((files / name).string());
    ASSERT_TRUE(arrays.ok()) << name;
    ASSERT_TRUE(arrays->count("control"));
    EXPECT_EQ(std::get<std::vector<double>>(arrays->at("control").data)[0], run["control"][0][0][0].get<double>());
  }
  EXPECT_THAT(ContentsOf(files / "report.html"), HasSubstr("</html>"));
  fs::remove_all(folder);
}

// The interval of grace begins with the signal, and not before.
TEST(Interrupted, GraceBeginsWithTheSignal) {
  std::signal(SIGINT, SIG_DFL);  // a shell makes what it runs in the background ignore interrupts
  const InterruptGuard guard;
  EXPECT_FALSE(InterruptGuard::GraceIsOver());
  raise(SIGINT);
  EXPECT_TRUE(InterruptGuard::Interrupted());
  while (!InterruptGuard::GraceIsOver()) std::this_thread::sleep_for(10ms);
  EXPECT_TRUE(InterruptGuard::Interrupted());
}

}  // namespace
}  // namespace saltus
