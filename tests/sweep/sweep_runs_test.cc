// saltus_sweep as a user runs it, and as the world treats it: killed, interrupted, in parts, on several ranks.
//
// Where something happens to a sweep in its midst, some of its points wait at gates (gate_model.h) until they are let
// on: no sweep is over before a test has done to it what it wants.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <map>
#include <random>
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

constexpr int kManyPoints = 1'000;
constexpr int kGates = 10;
constexpr int kPointsPerGate = kManyPoints / kGates;  // of which one waits
const char kCheapSweep[] =
    " --contact=direct_toi --solver=none --steps=6 --sweep='stiffness=1:1000:lin:1000' --progress=none --threads=2";

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

// In which run of the program each point was stored.
std::map<int64_t, int64_t> StoredPoints(const std::string& store) {
  std::map<int64_t, int64_t> points;
  sqlite3* database = nullptr;
  sqlite3_stmt* query = nullptr;
  EXPECT_EQ(sqlite3_open(store.c_str(), &database), SQLITE_OK);
  // A program that was killed a moment ago may not be gone yet.
  sqlite3_busy_timeout(database, 10'000);
  if (sqlite3_prepare_v2(database, "SELECT point, run FROM points", -1, &query, nullptr) == SQLITE_OK) {
    while (sqlite3_step(query) == SQLITE_ROW) {
      const bool once = points.emplace(sqlite3_column_int64(query, 0), sqlite3_column_int64(query, 1)).second;
      EXPECT_TRUE(once) << "stored twice";
    }
  }
  sqlite3_finalize(query);
  sqlite3_close(database);
  return points;
}

bool Contains(const std::map<int64_t, int64_t>& all, const std::map<int64_t, int64_t>& some) {
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
  std::string Store() const { return directory_ + "/sweep.sqlite"; }

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
  std::map<int64_t, int64_t> RunAndKill(const std::string& command, int open, const std::map<int64_t, int64_t>& before,
                                        const std::function<void(Background*)>& end) {
    OpenGates(open);
    Background program(command);
    EXPECT_TRUE(program.WaitUntil([&] { return GatesReached(open) > 0; }));
    std::this_thread::sleep_for(std::chrono::microseconds(std::uniform_int_distribution(0, 8'000)(random_)));
    end(&program);
    std::map<int64_t, int64_t> after = StoredPoints(Store());
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
  std::string directory_ = testing::TempDir() + "/sweep_runs_" + std::to_string(getpid());
  std::string scratch_ = directory_ + "_scratch", gates_;
  int num_commands_ = 0;
  std::mt19937 random_{20'230'305};
};

std::string SweepRunsTest::undisturbed_;

TEST_F(SweepRunsTest, KilledAtManyMomentsItLosesNothingAndComputesNothingTwice) {
  std::map<int64_t, int64_t> points;
  for (int i = 0; i < kGates - 1; ++i) {
    points = RunAndKill(Gated(), i, points, [](Background* program) { program->End(SIGKILL); });
  }
  const std::string undisturbed = UndisturbedGated();
  const Outcome outcome = RunWithOpenGates(Gated());
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::map<int64_t, int64_t> all = StoredPoints(Store());
  EXPECT_EQ(all.size(), static_cast<size_t>(kManyPoints));
  EXPECT_TRUE(Contains(all, points));
  EXPECT_TRUE(outcome.output == undisturbed);
  // And once more: nothing is left to compute.
  EXPECT_TRUE(RunWithOpenGates(Gated()).output == undisturbed);
  EXPECT_EQ(StoredPoints(Store()), all);
}

TEST_F(SweepRunsTest, TheNumberOfThreadsChangesNothing) {
  EXPECT_TRUE(RunCommand(Cheap("--threads=5")).output == undisturbed_);
}

TEST_F(SweepRunsTest, ThreeShardsMergedAreTheWhole) {
  for (const char* shard : {"1/3", "3/3"}) {
    EXPECT_EQ(RunCommand(Cheap(std::string("--shard=") + shard)).exit_code, 0);
  }
  const Outcome incomplete = RunCommand(Cheap("--merge"));
  EXPECT_EQ(incomplete.exit_code, 1);
  EXPECT_THAT(incomplete.errors, HasSubstr("333 points are missing"));
  const Outcome shard = RunCommand(Cheap("--shard=2/3"));
  EXPECT_EQ(std::count(shard.output.begin(), shard.output.end(), '\n'), 334);
  const Outcome outcome = RunCommand(Cheap("--merge"));
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.errors, IsEmpty()) << "--progress=none";
  EXPECT_TRUE(outcome.output == undisturbed_);
  EXPECT_TRUE(ReadFile(directory_ + "/sweep.csv").value() == undisturbed_);
}

TEST_F(SweepRunsTest, AShardOfAnotherStudyIsNotMerged) {
  const std::string small = " --contact=direct --solver=none --steps=6 --progress=none --sweep=stiffness=";
  ASSERT_EQ(RunCommand(Command(small + "1,2,3 --shard=1/2")).exit_code, 0);
  const Outcome outcome = RunCommand(Command(small + "1,2,4 --merge"));
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.errors, AllOf(HasSubstr("sweep.shard-1-of-2.sqlite"), HasSubstr("another study")));
}

TEST_F(SweepRunsTest, AnotherStudyIsRefused) {
  const std::string small = " --contact=direct --solver=none --progress=none --sweep=stiffness=1,2,3 --steps=";
  ASSERT_EQ(RunCommand(Command(small + "6")).exit_code, 0);
  const Outcome outcome = RunCommand(Command(small + "7"));
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.errors, AllOf(HasSubstr("sweep.sqlite"), HasSubstr("steps: 6"), HasSubstr("steps: 7")));
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
  EXPECT_EQ(csv->rows.size(), StoredPoints(Store()).size());
  for (const std::vector<std::string>& row : csv->rows) {
    EXPECT_EQ(row[*csv->Find("reason")], "");
    EXPECT_NE(row[*csv->Find("loss")], "");
  }
}

TEST_F(SweepRunsTest, AFailedPointIsARowAndCanBeTriedAgain) {
  // It never ends by itself. Whether its worker heeds the limit or is stopped for it is the machine's choice.
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

TEST_F(SweepRunsTest, WritesTableArraysAndFigures) {
  const Outcome outcome =
      RunCommand(Command(" --contact=direct,direct_toi --solver=none --sweep='steps=60:480:log:4;restitution=0.5,0.9' "
                         "--progress=none"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<NpzArrays> arrays = ReadNpz(directory_ + "/sweep.npz");
  ASSERT_TRUE(arrays.ok()) << arrays.status().message();
  EXPECT_EQ(arrays->at("steps").shape, std::vector<int64_t>{16});
  for (const std::string name :
       {"loss_against_steps", "loss_against_restitution", "gradient_error_against_dt", "loss_map_steps_restitution"}) {
    EXPECT_TRUE(std::filesystem::exists(directory_ + "/sweep." + name + ".png")) << name;
    EXPECT_TRUE(std::filesystem::exists(directory_ + "/sweep." + name + ".svg")) << name;
  }
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
                                     "--iterations=5 --steps=20 --progress=none --output_dir=" +
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
               {"--merge", "--output_dir"},
               {"--merge --output_dir=" + directory_, "no shards"},
               {"--merge --shard=1/2 --output_dir=" + directory_, "--merge takes all shards"},
               {"--point_seconds=-1", "--point_seconds"}};
  for (const auto& [flags, message] : cases) {
    const Outcome outcome = RunCommand(base + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << flags;
  }
}

#ifdef SALTUS_MPIEXEC

// More ranks than cores, by whom it may be; leaks are MPI's own.
std::string OnRanks(int ranks, const std::string& command, const std::string& settings = "") {
  return "env OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1 "
         "ASAN_OPTIONS=detect_leaks=0 " +
         settings + " " SALTUS_MPIEXEC " -n " + std::to_string(ranks) + " " + command;
}

// A command for OnRanks that leaves the id of every rank's process in a file.
std::string WithProcessIds(const std::string& command, const std::string& file) {
  return "sh -c 'echo $$ >" + file + ".$OMPI_COMM_WORLD_RANK; exec \"$@\"' sh " + command;
}

// Precondition: that rank is at work.
pid_t ReadProcessId(const std::string& file) {
  pid_t process = 0;
  EXPECT_TRUE(std::ifstream(file) >> process) << file;
  return process;
}

class SweepOnRanksTest : public SweepRunsTest {};

TEST_F(SweepOnRanksTest, TheNumberOfRanksChangesNothing) {
  for (const int ranks : {1, 2, 4}) {
    const Outcome outcome = RunCommand(OnRanks(ranks, Cheap("--threads=1")));
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    EXPECT_TRUE(outcome.output == undisturbed_) << ranks << " ranks";
    EXPECT_EQ(StoredPoints(Store()).size(), static_cast<size_t>(kManyPoints));
    std::filesystem::remove_all(directory_);
  }
}

TEST_F(SweepOnRanksTest, KilledOnAnyNumberOfRanksItGoesOnWithAnother) {
  const std::string ids = scratch_ + "/rank";
  std::map<int64_t, int64_t> points;
  int open = 0;
  for (const int ranks : {4, 2, 1}) {
    // Rank 0 is killed, which has the store; mpirun then ends the others.
    const std::string command = OnRanks(ranks, WithProcessIds(Gated("--threads=1"), ids));
    points = RunAndKill(command, open++, points, [&](Background* program) {
      kill(ReadProcessId(ids + ".0"), SIGKILL);
      program->Wait();
    });
  }
  const std::string undisturbed = UndisturbedGated();
  const Outcome outcome = RunWithOpenGates(OnRanks(2, Gated("--threads=1")));
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_TRUE(outcome.output == undisturbed);
  EXPECT_TRUE(Contains(StoredPoints(Store()), points));
}

TEST_F(SweepOnRanksTest, ARankThatDiesLosesOnlyItsCurrentPoint) {
  constexpr int kRanks = 3;
  const std::string ids = scratch_ + "/rank";
  Background program(OnRanks(kRanks, WithProcessIds(Gated("--threads=1"), ids), "OMPI_MCA_orte_enable_recovery=1"));
  // Each rank computes a point at a time, so that now each has one that waits.
  ASSERT_TRUE(program.WaitUntil([&] { return GatesReached() == kRanks; }));
  EXPECT_EQ(kill(ReadProcessId(ids + ".2"), SIGKILL), 0);
  OpenGates(kGates);
  EXPECT_EQ(program.Wait(), 0);  // and does end
  EXPECT_EQ(StoredPoints(Store()).size(), static_cast<size_t>(kManyPoints));
  EXPECT_TRUE(ReadFile(directory_ + "/sweep.csv").value() == UndisturbedGated());
}

TEST_F(SweepOnRanksTest, WrongInputIsSaidOnceAndEndsAllRanks) {
  const Outcome outcome = RunCommand(OnRanks(3, Command(" --sweep=colour=1")));
  EXPECT_NE(outcome.exit_code, 0);
  const size_t first = outcome.errors.find("colour");
  ASSERT_NE(first, std::string::npos);
  EXPECT_EQ(outcome.errors.find("found 'colour'", first + 1), std::string::npos);
}

TEST_F(SweepOnRanksTest, WithoutRankZeroTheOthersEnd) {
  constexpr int kRanks = 3;
  const std::string ids = scratch_ + "/rank";
  Background program(OnRanks(kRanks, WithProcessIds(Gated("--threads=1"), ids), "OMPI_MCA_orte_enable_recovery=1"));
  ASSERT_TRUE(program.WaitUntil([&] { return GatesReached() == kRanks; }));
  const pid_t others[] = {ReadProcessId(ids + ".1"), ReadProcessId(ids + ".2")};
  EXPECT_EQ(kill(ReadProcessId(ids + ".0"), SIGKILL), 0);
  // Though their points never end. One that spins on hangs here.
  for (const pid_t rank : others) {
    while (kill(rank, 0) == 0) std::this_thread::sleep_for(10ms);
  }
  program.Wait();  // mpirun has no opinion on ranks that it was told to do without
}

#endif

}  // namespace
}  // namespace saltus
