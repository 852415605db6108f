// saltus_sweep as a user runs it, and as the world treats it: killed, interrupted, in parts, on several ranks.
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

#include "programs/run_program.h"
#include "saltus/io/file.h"
#include "saltus/io/npz.h"
#include "saltus/io/table.h"

namespace saltus {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int kPoints = 10'000;
const char kCheapSweep[] =
    " --contact=direct_toi --solver=none --steps=6 --sweep='stiffness=1:10000:lin:10000' --progress=none --threads=2";

// A program of its own process group, started by a shell.
class Background {
 public:
  explicit Background(const std::string& command) {
    process_ = fork();
    if (process_ != 0) return;
    const std::string silent = "exec " + command + " >/dev/null 2>&1";
    execl("/bin/sh", "sh", "-c", silent.c_str(), nullptr);
    _exit(127);
  }

  // Sends the signal, waits for the end, and returns the exit code, or minus the signal that killed it.
  int End(int signal) {
    kill(process_, signal);
    return Wait();
  }

  int Wait() {
    int status = 0;
    waitpid(process_, &status, 0);
    return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
  }

 private:
  pid_t process_;
};

template <typename Condition>
bool WaitUntil(const Condition& condition, std::chrono::milliseconds limit = 20s) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

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
  // What a sweep that nothing disturbed prints. Computed once.
  static void SetUpTestSuite() {
    const Outcome outcome = RunProgram("saltus_sweep" + Scene("two_balls") + kCheapSweep);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    undisturbed_ = outcome.output;
    ASSERT_EQ(std::count(undisturbed_.begin(), undisturbed_.end(), '\n'), kPoints + 1);
  }

  void SetUp() override { std::filesystem::remove_all(directory_); }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  std::string Command(const std::string& more) const {
    return SALTUS_BINARY_DIR "/problems/saltus_sweep" + Scene("two_balls") + more + " --output_dir=" + directory_;
  }
  std::string Cheap(const std::string& more = "") const { return Command(kCheapSweep + (" " + more)); }
  std::string Store() const { return directory_ + "/sweep.sqlite"; }

  // When the store was last written to.
  std::filesystem::file_time_type LastWrite() const {
    std::error_code none_yet;
    return std::filesystem::last_write_time(Store() + "-wal", none_yet);
  }

  // Starts the program, waits until it has written to the store and then for a random time, and kills it. What was
  // stored before must still be there. Returns what is stored then.
  std::map<int64_t, int64_t> RunAndKill(const std::string& command, const std::map<int64_t, int64_t>& before,
                                        const std::function<void(Background*)>& end) {
    const std::filesystem::file_time_type last_write = LastWrite();
    Background program(command);
    EXPECT_TRUE(WaitUntil([&] { return LastWrite() != last_write; }));
    std::this_thread::sleep_for(std::chrono::microseconds(std::uniform_int_distribution(0, 80'000)(random_)));
    end(&program);
    std::map<int64_t, int64_t> after = StoredPoints(Store());
    EXPECT_TRUE(Contains(after, before)) << "a finished point was lost or computed again";
    return after;
  }

  static std::string undisturbed_;
  std::string directory_ = testing::TempDir() + "/sweep_runs_" + std::to_string(getpid());
  std::mt19937 random_{20'230'305};
};

std::string SweepRunsTest::undisturbed_;

TEST_F(SweepRunsTest, KilledAtTenMomentsItLosesNothingAndComputesNothingTwice) {
  std::map<int64_t, int64_t> points;
  int interrupted = 0;
  for (int i = 0; i < 10; ++i) {
    points = RunAndKill(Cheap(), points, [](Background* program) { program->End(SIGKILL); });
    interrupted += !points.empty() && points.size() < kPoints;
  }
  EXPECT_GT(interrupted, 0);
  const Outcome outcome = RunCommand(Cheap());
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::map<int64_t, int64_t> all = StoredPoints(Store());
  EXPECT_EQ(all.size(), static_cast<size_t>(kPoints));
  EXPECT_TRUE(Contains(all, points));
  EXPECT_TRUE(outcome.output == undisturbed_);
  // And once more: nothing is left to compute.
  EXPECT_TRUE(RunCommand(Cheap()).output == undisturbed_);
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
  EXPECT_THAT(incomplete.errors, HasSubstr("3333 points are missing"));
  const Outcome shard = RunCommand(Cheap("--shard=2/3"));
  EXPECT_EQ(std::count(shard.output.begin(), shard.output.end(), '\n'), 3334);
  const Outcome outcome = RunCommand(Cheap("--merge"));
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
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
  const std::string command =
      Command(" --contact=direct_toi --solver=gd --sweep='stiffness=1:10000:lin:10000' --progress=none --threads=2");
  Background program(command);
  ASSERT_TRUE(WaitUntil([&] { return std::filesystem::exists(Store()); }));
  std::this_thread::sleep_for(400ms);
  EXPECT_EQ(program.End(SIGINT), 1);
  const StatusOr<CsvDocument> csv = ReadCsv(directory_ + "/sweep.csv");
  ASSERT_TRUE(csv.ok()) << csv.status().message();
  EXPECT_GT(csv->rows.size(), 0u);
  EXPECT_LT(csv->rows.size(), static_cast<size_t>(kPoints));
  EXPECT_EQ(csv->rows.size(), StoredPoints(Store()).size());
  for (const std::vector<std::string>& row : csv->rows) EXPECT_EQ(row[*csv->Find("termination")], "iteration_limit");
}

TEST_F(SweepRunsTest, AFailedPointIsARowAndCanBeTriedAgain) {
  const std::string sweep =
      " --contact=direct_toi --solver=gd --iterations=1000000000 --sweep='friction=0,0.1' --progress=none";
  const Outcome outcome = RunCommand(Command(sweep + " --point_seconds=0.1"));
  EXPECT_EQ(outcome.exit_code, 1);  // nothing came of any point
  EXPECT_THAT(outcome.errors, HasSubstr("2 points: 0 done, 1 not applicable, 1 failed"));
  EXPECT_THAT(outcome.errors, HasSubstr("1 x stopped at the time limit of 0.1 s; first at point 0 (friction=0"));
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 2u);
  EXPECT_EQ(csv->rows[0][*csv->Find("termination")], "failed");
  EXPECT_THAT(csv->rows[0][*csv->Find("reason")], HasSubstr("time limit"));
  EXPECT_LT(std::stod(csv->rows[0][*csv->Find("final_loss")]), std::stod(csv->rows[0][*csv->Find("initial_loss")]));
  EXPECT_EQ(csv->rows[1][*csv->Find("termination")], "not_applicable");
  const Outcome again = RunCommand(Command(sweep + " --point_seconds=0.2 --retry_failed"));
  EXPECT_THAT(again.errors, HasSubstr("time limit of 0.2 s"));
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

TEST_F(SweepRunsTest, WrongUseIsExitCodeTwo) {
  const std::string base = SALTUS_BINARY_DIR "/problems/saltus_sweep" + Scene("two_balls") + "--sweep=stiffness=1,2 ";
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

pid_t ReadProcessId(const std::string& file) {
  pid_t process = 0;
  EXPECT_TRUE(WaitUntil([&] { return static_cast<bool>(std::ifstream(file) >> process); })) << file;
  return process;
}

class SweepOnRanksTest : public SweepRunsTest {};

TEST_F(SweepOnRanksTest, TheNumberOfRanksChangesNothing) {
  for (const int ranks : {1, 2, 4}) {
    const Outcome outcome = RunCommand(OnRanks(ranks, Cheap("--threads=1")));
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    EXPECT_TRUE(outcome.output == undisturbed_) << ranks << " ranks";
    EXPECT_EQ(StoredPoints(Store()).size(), static_cast<size_t>(kPoints));
    std::filesystem::remove_all(directory_);
  }
}

TEST_F(SweepOnRanksTest, KilledOnAnyNumberOfRanksItGoesOnWithAnother) {
  const std::string ids = testing::TempDir() + "/sweep_rank_" + std::to_string(getpid());
  std::map<int64_t, int64_t> points;
  for (const int ranks : {4, 2, 1}) {
    std::filesystem::remove(ids + ".0");
    // Of rank 0, which has the store; mpirun then ends the others.
    points = RunAndKill(OnRanks(ranks, WithProcessIds(Cheap("--threads=1"), ids)), points, [&](Background* program) {
      kill(ReadProcessId(ids + ".0"), SIGKILL);
      program->Wait();
    });
  }
  const Outcome outcome = RunCommand(OnRanks(2, Cheap("--threads=1")));
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_TRUE(outcome.output == undisturbed_);
  EXPECT_TRUE(Contains(StoredPoints(Store()), points));
}

TEST_F(SweepOnRanksTest, ARankThatDiesLosesOnlyItsCurrentPoint) {
  const std::string ids = testing::TempDir() + "/sweep_dying_rank_" + std::to_string(getpid());
  const std::string sweep =
      " --contact=direct_toi --solver=gd --iterations=100 --sweep='stiffness=1:300:lin:300' --progress=none "
      "--threads=1";
  Background program(OnRanks(3, WithProcessIds(Command(sweep), ids), "OMPI_MCA_orte_enable_recovery=1"));
  ASSERT_TRUE(WaitUntil([&] { return std::filesystem::exists(Store()); }));
  const pid_t rank = ReadProcessId(ids + ".2");
  std::this_thread::sleep_for(200ms);
  EXPECT_EQ(kill(rank, SIGKILL), 0) << "it was over too soon";
  EXPECT_EQ(program.Wait(), 0);  // and does end
  EXPECT_EQ(StoredPoints(Store()).size(), 300u);
  const StatusOr<CsvDocument> csv = ReadCsv(directory_ + "/sweep.csv");
  ASSERT_TRUE(csv.ok());
  for (const std::vector<std::string>& row : csv->rows) EXPECT_EQ(row[*csv->Find("termination")], "iteration_limit");
}

TEST_F(SweepOnRanksTest, WrongInputIsSaidOnceAndEndsAllRanks) {
  const Outcome outcome = RunCommand(OnRanks(3, Command(" --sweep=colour=1")));
  EXPECT_NE(outcome.exit_code, 0);
  const size_t first = outcome.errors.find("colour");
  ASSERT_NE(first, std::string::npos);
  EXPECT_EQ(outcome.errors.find("found 'colour'", first + 1), std::string::npos);
}

TEST_F(SweepOnRanksTest, WithoutRankZeroTheOthersEnd) {
  const std::string ids = testing::TempDir() + "/sweep_orphan_" + std::to_string(getpid());
  for (const char* rank : {".0", ".1", ".2"}) std::filesystem::remove(ids + rank);
  // Weeks of work.
  const std::string sweep =
      " --contact=direct_toi --solver=gd --iterations=1000000000 --sweep='stiffness=1:300:lin:300' --progress=none "
      "--threads=1";
  Background program(OnRanks(3, WithProcessIds(Command(sweep), ids), "OMPI_MCA_orte_enable_recovery=1"));
  ASSERT_TRUE(WaitUntil([&] { return std::filesystem::exists(Store()); }));
  const pid_t others[] = {ReadProcessId(ids + ".1"), ReadProcessId(ids + ".2")};
  std::this_thread::sleep_for(1s);  // ranks that have not heard of it wait longer for it
  EXPECT_EQ(kill(ReadProcessId(ids + ".0"), SIGKILL), 0);
  for (const pid_t rank : others) {
    EXPECT_TRUE(WaitUntil([&] { return kill(rank, 0) != 0; }, 100s)) << "spins on";
    kill(rank, SIGKILL);
  }
  program.Wait();  // mpirun has no opinion on ranks that it was told to do without
}

#endif

}  // namespace
}  // namespace saltus
