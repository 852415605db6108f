// saltus_sweep as a user runs it, and as the world treats it: killed, interrupted, in parts.
//
// Where something happens to a sweep in its midst, some of its points wait at gates (gate_model.h) until they are let
// on: no sweep is over before a test has done to it what it wants.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <map>
#include <random>
#include <set>
#include <sstream>
#include <thread>

#include "base/csv.h"
#include "base/file.h"
#include "folders.h"
#include "output/npz.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int kManyPoints = 2'000;
constexpr int kGates = 20;
constexpr int kPointsPerGate = kManyPoints / kGates;  // of which one waits
const char kCheapSweep[] =
    " --contact=direct_toi --solver=none --steps=6 --sweep='stiffness=1:2000:lin:2000' --progress=none --threads=2";

// A program of its own process group, started by a shell.
class Background {
 public:
  explicit Background(const std::string& command) {
    process_ = fork();
    if (process_ != 0) return;
    std::signal(SIGINT, SIG_DFL);  // a shell makes what it runs in the background ignore interrupts
    const std::string silent = "exec " + command + " >/dev/null 2>&1";
    execl("/bin/sh", "sh", "-c", silent.c_str(), nullptr);
    _exit(127);
  }

  // Sends the signal, waits for the end, and returns the exit code, or minus the signal that killed it.
  int End(int signal) {
    kill(process_, signal);
    return Wait();
  }

  // Waits until the condition holds, for as long as that takes. False if the program has ended before.
  template <typename Condition>
  bool WaitUntil(const Condition& condition) const {
    while (!condition()) {
      siginfo_t end = {};
      waitid(P_PID, static_cast<id_t>(process_), &end, WEXITED | WNOHANG | WNOWAIT);
      if (end.si_pid == process_) return condition();
      std::this_thread::sleep_for(1ms);
    }
    return true;
  }

  int Wait() {
    int status = 0;
    waitpid(process_, &status, 0);
    return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
  }

 private:
  pid_t process_;
};

// The complete lines of a file of rows but its header, each once.
std::set<std::string> StoredRows(const std::string& file) {
  std::istringstream text(ContentsOf(file));
  std::set<std::string> rows;
  std::set<std::string> points;
  std::string line;
  std::getline(text, line);
  while (std::getline(text, line) && !text.eof()) {
    rows.insert(line);
    EXPECT_TRUE(points.insert(line.substr(0, line.find(','))).second) << "stored twice: " << line;
  }
  return rows;
}

bool Contains(const std::set<std::string>& all, const std::set<std::string>& some) {
  return std::includes(all.begin(), all.end(), some.begin(), some.end());
}

class SweepRunsTest : public testing::Test {
 protected:
  // The output of an undisturbed sweep, computed once.
  static void SetUpTestSuite() {
    const Outcome outcome = RunProgram("saltus_sweep" + SceneFlag("two_balls") + kCheapSweep);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    undisturbed_ = outcome.output;
    ASSERT_EQ(std::count(undisturbed_.begin(), undisturbed_.end(), '\n'), kManyPoints + 1);
  }

  void SetUp() override {
    std::filesystem::remove_all(directory_);
    std::filesystem::remove_all(scratch_);
  }
  void TearDown() override {
    std::filesystem::remove_all(directory_);
    std::filesystem::remove_all(scratch_);
  }

  std::string Command(const std::string& more) const {
    return BuildFolder() + "/bin/saltus_sweep" + SceneFlag("two_balls") + more + " --output_dir=" + directory_;
  }
  std::string Cheap(const std::string& more = "") const { return Command(kCheapSweep + (" " + more)); }
  std::string Store() const { return directory_ + "/sweep.csv"; }

  // A sweep of as many points, of which one in the middle of each kPointsPerGate waits at a gate of its own. The gates
  // are new (a process that is dying may still leave its mark at others) and closed.
  std::string Gated(const std::string& more = "") {
    gates_ = scratch_ + "/gates_" + std::to_string(num_commands_++);
    std::filesystem::create_directories(gates_);
    const std::string file = gates_ + "/points.csv";
    std::ofstream points(file);
    points << "contact,stiffness\n";
    for (int i = 0; i < kManyPoints; ++i) {
      const bool waits = i % kPointsPerGate == kPointsPerGate / 2;
      points << (waits ? "gate:number=" + std::to_string(i / kPointsPerGate) : "direct_toi") << "," << i + 1 << "\n";
    }
    return "env SALTUS_GATES=" + gates_ + " " SALTUS_GATED_SWEEP + SceneFlag("two_balls") + " --sweep=@" + file +
           " --solver=none --steps=6 --progress=none --threads=2 --output_dir=" + directory_ + " " + more;
  }
  // At how many gates from `first` on a point is or was.
  int GatesReached(int first = 0) const {
    int reached = 0;
    for (int k = first; k < kGates; ++k) reached += std::filesystem::exists(gates_ + "/reached_" + std::to_string(k));
    return reached;
  }
  void OpenGates(int count) const {
    for (int k = 0; k < count; ++k) std::ofstream(gates_ + "/open_" + std::to_string(k));
  }
  Outcome RunWithOpenGates(const std::string& command) const {
    OpenGates(kGates);
    return RunCommand(command);
  }

  // Starts a gated sweep with the first gates open, waits until a point waits at another and then for a random time, in
  // which others are computed, and kills it. What was stored before must still be there. Returns what is stored then.
  std::set<std::string> RunAndKill(const std::string& command, int open, const std::set<std::string>& before,
                                   const std::function<void(Background*)>& end) {
    OpenGates(open);
    Background program(command);
    EXPECT_TRUE(program.WaitUntil([&] { return GatesReached(open) > 0; }));
    std::this_thread::sleep_for(std::chrono::microseconds(std::uniform_int_distribution(0, 8'000)(random_)));
    end(&program);
    std::set<std::string> after = StoredRows(Store());
    EXPECT_TRUE(Contains(after, before)) << "a finished point was lost or computed again";
    EXPECT_GE(after.size(), static_cast<size_t>(open * kPointsPerGate));
    EXPECT_LT(after.size(), static_cast<size_t>(kManyPoints));
    return after;
  }

  // Returns the output of an undisturbed gated sweep.
  std::string UndisturbedGated() {
    const Outcome outcome = RunWithOpenGates(Gated("--output_dir=" + scratch_ + "/undisturbed"));
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    EXPECT_EQ(std::count(outcome.output.begin(), outcome.output.end(), '\n'), kManyPoints + 1);
    return outcome.output;
  }

  static std::string undisturbed_;
  std::string directory_ = TempFile("sweep_runs");
  std::string scratch_ = directory_ + "_scratch", gates_;
  int num_commands_ = 0;
  std::mt19937 random_{20'230'305};
};

std::string SweepRunsTest::undisturbed_;

TEST_F(SweepRunsTest, KilledAtManyMomentsItLosesNothingAndComputesNothingTwice) {
  std::set<std::string> rows;
  for (int i = 0; i < kGates; ++i) {
    rows = RunAndKill(Gated(), i, rows, [](Background* program) { program->End(SIGKILL); });
  }
  const std::string undisturbed = UndisturbedGated();
  const Outcome outcome = RunWithOpenGates(Gated());
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::set<std::string> all = StoredRows(Store());
  EXPECT_EQ(all.size(), static_cast<size_t>(kManyPoints));
  EXPECT_TRUE(Contains(all, rows));
  EXPECT_TRUE(outcome.output == undisturbed);
  EXPECT_TRUE(ContentsOf(Store()) == undisturbed);
  // And once more: nothing is left to compute.
  const std::string again = Gated();
  EXPECT_TRUE(RunCommand(again).output == undisturbed);
  EXPECT_EQ(GatesReached(), 0);
}

TEST_F(SweepRunsTest, TheNumberOfThreadsChangesNothing) {
  EXPECT_TRUE(RunCommand(Cheap("--threads=5")).output == undisturbed_);
}

TEST_F(SweepRunsTest, FourShardsWithOneHeaderAreTheWhole) {
  for (const char* shard : {"4/4", "1/4", "3/4"}) {
    EXPECT_EQ(RunCommand(Cheap(std::string("--shard=") + shard)).exit_code, 0);
  }
  // Joins the files by the command on the page on sweeps.
  const std::string join =
      "awk 'FNR > 1 || NR == 1' " + directory_ + "/sweep.shard-*-of-4.csv >" + directory_ + "/sweep.csv";
  ASSERT_EQ(RunCommand(join).exit_code, 0);
  const std::string files = ContentsOf(Store());
  EXPECT_EQ(std::count(files.begin(), files.end(), '\n'), 1 + 3 * kManyPoints / 4);
  const Outcome shard = RunCommand(Cheap("--shard=2/4"));
  EXPECT_EQ(std::count(shard.output.begin(), shard.output.end(), '\n'), 1 + kManyPoints / 4);
  ASSERT_EQ(RunCommand(join).exit_code, 0);
  EXPECT_TRUE(ContentsOf(Store()) == undisturbed_);
  const Outcome outcome = RunCommand(Cheap());
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.errors, IsEmpty()) << "--progress=none";
  EXPECT_TRUE(outcome.output == undisturbed_);
  EXPECT_TRUE(std::filesystem::exists(directory_ + "/report.html"));
}

TEST_F(SweepRunsTest, AShardOfAnotherStudyIsRefused) {
  const std::string small = " --contact=direct --solver=none --steps=6 --progress=none --sweep=stiffness=";
  ASSERT_EQ(RunCommand(Command(small + "1,2,3 --shard=1/2")).exit_code, 0);
  const Outcome outcome = RunCommand(Command(small + "1,2,4 --shard=2/2"));
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.errors, AllOf(HasSubstr("sweep.study.json"), HasSubstr("another study")));
}

TEST_F(SweepRunsTest, AnotherStudyIsRefused) {
  const std::string small = " --contact=direct --solver=none --progress=none --sweep=stiffness=1,2,3 --steps=";
  ASSERT_EQ(RunCommand(Command(small + "6")).exit_code, 0);
  const Outcome outcome = RunCommand(Command(small + "7"));
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.errors, AllOf(HasSubstr("sweep.study.json"), HasSubstr("steps: 6"), HasSubstr("steps: 7")));
  EXPECT_THAT(outcome.output, IsEmpty());
}

TEST_F(SweepRunsTest, AnInterruptStopsItCleanly) {
  Background program(Gated());
  ASSERT_TRUE(program.WaitUntil([&] { return GatesReached() > 0; }));
  EXPECT_EQ(program.End(SIGINT), 1);
  const StatusOr<CsvDocument> csv = ReadCsv(directory_ + "/sweep.csv");
  ASSERT_TRUE(csv.ok()) << csv.status().message();
  EXPECT_GT(csv->rows.size(), 0u);
  EXPECT_LT(csv->rows.size(), static_cast<size_t>(kManyPoints));
  EXPECT_EQ(csv->rows.size(), StoredRows(Store()).size());
  for (const std::vector<std::string>& row : csv->rows) {
    EXPECT_EQ(row[*csv->Find("reason")], "");
    EXPECT_NE(row[*csv->Find("loss")], "");
  }
}

TEST_F(SweepRunsTest, AFailedPointIsARowAndCanBeTriedAgain) {
  // It never ends by itself.
  const std::string sweep = " --contact=direct_toi --solver=gd --sweep='iterations=1000000000' --progress=none";
  const Outcome outcome = RunCommand(Command(sweep + " --point_seconds=0.1"));
  EXPECT_EQ(outcome.exit_code, 1);  // nothing came of any point
  EXPECT_THAT(outcome.errors, HasSubstr("1 points: 0 done, 0 not applicable, 1 failed"));
  EXPECT_THAT(outcome.errors, HasSubstr("1 x stopped at the time limit of 0.1 s; first at point 0 (iterations=1"));
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 1u);
  EXPECT_EQ(csv->rows[0][*csv->Find("termination")], "failed");
  EXPECT_THAT(csv->rows[0][*csv->Find("reason")], HasSubstr("time limit"));
  const Outcome again = RunCommand(Command(sweep + " --point_seconds=0.2 --retry_failed"));
  EXPECT_THAT(again.errors, HasSubstr("time limit of 0.2 s"));
}

TEST_F(SweepRunsTest, APointThatIsNotApplicableIsARow) {
  const Outcome outcome =
      RunCommand(Command(" --contact=direct_toi --solver=gd --iterations=3 --sweep='friction=0.1,0' --progress=none"));
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_THAT(outcome.errors, HasSubstr("2 points: 1 done, 1 not applicable, 0 failed"));
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 2u);
  EXPECT_EQ(csv->rows[0][*csv->Find("termination")], "not_applicable");
}

TEST_F(SweepRunsTest, WritesArraysAndAReport) {
  const Outcome outcome =
      RunCommand(Command(" --contact=direct,direct_toi --solver=none --sweep='steps=60:480:log:4;restitution=0.5,0.9' "
                         "--progress=none"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<NpzArrays> arrays = ReadNpz(directory_ + "/sweep.npz");
  ASSERT_TRUE(arrays.ok()) << arrays.status().message();
  EXPECT_EQ(arrays->at("steps").shape, std::vector<int64_t>{16});
  EXPECT_EQ(arrays->at("status"), (NpyArray{{16}, std::vector<std::string>(16, "done")}));
  EXPECT_THAT(ContentsOf(directory_ + "/report.html"), HasSubstr("16 points: 16 done"));
}

// The part of problems that each solver solves, from the rows of the sweep.
std::map<std::string, double> SolvedParts(const CsvDocument& csv) {
  std::map<std::string, double> best, parts;
  const auto number = [&](const auto& row, const char* name) { return std::stod(row[*csv.Find(name)]); };
  for (const auto& row : csv.rows) {
    const double loss = number(row, "exact_loss");
    const auto [at, is_new] = best.emplace(row[*csv.Find("seed")], loss);
    if (!is_new) at->second = std::min(at->second, loss);
  }
  for (const auto& row : csv.rows) {
    const bool solved = number(row, "exact_loss") <= (1 + 1e-6) * best[row[*csv.Find("seed")]];
    parts[row[*csv.Find("solver")]] += solved ? 1.0 / best.size() : 0.0;
  }
  return parts;
}

TEST_F(SweepRunsTest, ControlProblemsBySeedComeWithATableOfWhatIsSolved) {
  const Outcome outcome = RunCommand(BuildFolder() +
                                     "/bin/saltus_sweep --contact=event --solver=gd,ceres_lm --sweep='seed=0,1,10' "
                                     "--iterations=5 --steps=20 --progress=none --threads=1 --output_dir=" +
                                     directory_);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 6u);
  for (const auto& row : csv->rows) EXPECT_GT(std::stod(row[*csv->Find("memory_mib")]), 1);
  const StatusOr<std::string> text = ReadFile(directory_ + "/sweep.solved.csv", 1 << 20);
  ASSERT_TRUE(text.ok());
  const StatusOr<CsvDocument> solved = ParseCsv(*text);
  ASSERT_TRUE(solved.ok());
  ASSERT_EQ(solved->rows.size(), 6u);
  const std::map<std::string, double> parts = SolvedParts(*csv);
  for (const auto& row : solved->rows) {
    const std::string& kind = row[*solved->Find("kind")];
    EXPECT_EQ(row[*solved->Find("problems")], kind == "all" ? "3" : kind == "pair" ? "2" : "1");
    if (kind == "all") {
      EXPECT_NEAR(std::stod(row[*solved->Find("solved")]), parts.at(row[*solved->Find("solver")]), 1e-9);
    }
  }
  EXPECT_EQ(solved->rows.back()[*solved->Find("kind")], "all");
  const Outcome both = RunCommand(BuildFolder() + "/bin/saltus_sweep --sweep=seed=1,2 " + SceneFlag("two_balls"));
  EXPECT_EQ(both.exit_code, 2);
  EXPECT_THAT(both.errors, HasSubstr("--scene"));
}

// Monte Carlo: each point has the runs of a seed, whichever process computes it.
TEST_F(SweepRunsTest, FeedbackHasColumnsThatThreadsDoNotChange) {
  const std::string sweep = "saltus_sweep" + SceneFlag("two_balls") +
                            "--contact=event --steps=60 --progress=none --feedback --feedback_samples=60 "
                            "--sweep='feedback_scale=0.1,1; feedback_seed=1,2' ";
  const Outcome one = RunProgram(sweep + "--solver=none --threads=1");
  ASSERT_EQ(one.exit_code, 0) << one.errors;
  EXPECT_TRUE(RunProgram(sweep + "--solver=none --threads=3").output == one.output);
  const StatusOr<CsvDocument> csv = ParseCsv(one.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 4u);
  const auto number = [&](size_t row, const char* name) { return std::stod(csv->rows[row][*csv->Find(name)]); };
  for (size_t row : {0, 1}) {
    EXPECT_NEAR(
        number(row, "closed_error"), number(row, "closed_error_first_order"), 0.2 * number(row, "closed_error"));
    EXPECT_NEAR(number(row + 2, "open_error_first_order"), 10 * number(row, "open_error_first_order"), 1e-12);
    EXPECT_EQ(number(row, "closed_otherwise"), 0);
  }
  EXPECT_NE(number(0, "open_loss"), number(1, "open_loss"));
  EXPECT_GT(number(0, "closed_loss_error"), 0);
  const Outcome solved = RunProgram(sweep + "--solver=ceres_lm --iterations=5");
  ASSERT_EQ(solved.exit_code, 0) << solved.errors;
  EXPECT_THAT(solved.output, HasSubstr("closed_loss_first_order"));
  const Outcome program = RunProgram("saltus_sweep --program='" + BuildFolder() +
                                     "/bin/bouncing_ball --feedback --feedback_samples=20' --solver=none "
                                     "--sweep='feedback_scale=1,2' --progress=none");
  ASSERT_EQ(program.exit_code, 0) << program.errors;
  EXPECT_THAT(program.output, HasSubstr("open_error_first_order"));
}

TEST_F(SweepRunsTest, OptimizedParametersHaveColumns) {
  const Outcome outcome = RunProgram("saltus_sweep" + SceneFlag("post_shot") +
                                     " --contact=event --solver=ceres_event --sweep=steps=24,48 --progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 2u);
  for (const char* name : {"position.post.x", "position.post.y", "mass.target"}) ASSERT_TRUE(csv->Find(name)) << name;
  EXPECT_EQ(csv->rows[1][*csv->Find("position.post.y")], "-0.3");
  EXPECT_EQ(csv->rows[1][*csv->Find("mass.target")], "0.5");
}

TEST_F(SweepRunsTest, WrongUseIsExitCodeTwo) {
  const std::string base = BuildFolder() + "/bin/saltus_sweep" + SceneFlag("two_balls") + "--sweep=stiffness=1,2 ";
  const struct {
    std::string flags, message;
  } cases[] = {{"--shard=0/3 --output_dir=" + directory_, "--shard=0/3"},
               {"--shard=4/3 --output_dir=" + directory_, "1..n"},
               {"--shard=1of3 --output_dir=" + directory_, "--shard=1of3"},
               {"--shard=1/3", "--output_dir"},
               {"--retry_failed", "--output_dir"},
               {"--point_seconds=-1", "--point_seconds"}};
  for (const auto& [flags, message] : cases) {
    const Outcome outcome = RunCommand(base + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << flags;
  }
}

}  // namespace
}  // namespace saltus
