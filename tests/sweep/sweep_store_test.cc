#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>

#include "folders.h"
#include "sweep/executor.h"
#include "sweep/output.h"
#include "sweep/point.h"
#include "sweep/store.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

SweepStudy Study(const std::string& sweep = "stiffness=1:10:lin:10", int steps = 480) {
  Request request;
  request.scene = LoadScene(SourceFolder() + "/problems/two_balls.yaml");
  request.scene.steps = steps;
  request.contacts = {"event"};
  return SweepStudy(request, ParseSweep(sweep, request.scene));
}

class SweepStoreTest : public testing::Test {
 protected:
  void SetUp() override { std::filesystem::remove_all(directory_), std::filesystem::create_directories(directory_); }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  std::string Path(const std::string& name = "sweep.sqlite") const { return directory_ + "/" + name; }

  // A row whose numbers any rounding would change.
  static PointResult Row(const SweepStudy& study, int64_t point) {
    PointResult result{PointStatus::kComputed, study.Values(point)};
    for (const SweepValue& value : {SweepValue(1.0 / 3),
                                    SweepValue(-0.0),
                                    SweepValue(5e-324),
                                    SweepValue(2.0),
                                    SweepValue(),
                                    SweepValue("it's \"ü\"")}) {
      result.row.push_back(value);
    }
    CHECK_EQ(result.row.size(), study.columns().size());
    return result;
  }

  static std::map<int64_t, PointResult> Contents(const SweepStore& store) {
    std::map<int64_t, PointResult> rows;
    store.ForEach([&](int64_t point, PointResult result) { rows[point] = std::move(result); });
    return rows;
  }

  std::string directory_ = testing::TempDir() + "/sweep_store_" + std::to_string(getpid());
};

// A database that something else has written to, or that is damaged: the error is said, and nothing is aborted.
TEST_F(SweepStoreTest, OthersMayNotHaveWrittenToIt) {
  const SweepStudy study = Study();
  const auto error_after = [&](const std::string& sql) -> std::string {
    std::filesystem::remove(Path());
    {
      StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
      EXPECT_TRUE(store->Add(2, Row(study, 2)).ok());
    }
    sqlite3* database = nullptr;
    EXPECT_EQ(sqlite3_open(Path().c_str(), &database), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
    sqlite3_close(database);
    StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
    if (!store.ok()) return store.status().message();
    try {
      (void)store->size();
      (void)store->Has(2);
      (void)Contents(*store);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "none";
  };
  EXPECT_EQ(error_after("SELECT 1"), "none");
  EXPECT_THAT(error_after("DROP TABLE points"), HasSubstr("no such table: points"));
  EXPECT_THAT(error_after("UPDATE points SET status = 'finished'"), HasSubstr("a point that no sweep has stored"));
  EXPECT_THAT(error_after("ALTER TABLE points ADD COLUMN more"), HasSubstr("columns"));
  EXPECT_THAT(error_after("UPDATE study SET value = 'words'"), HasSubstr("not one that a sweep writes"));
  EXPECT_THAT(error_after("UPDATE study SET value = ' ' || value"), HasSubstr("written in another way"));

  // Pages of points overwritten by zeros.
  EXPECT_EQ(error_after("VACUUM"), "none");
  const std::uintmax_t size = std::filesystem::file_size(Path());
  std::fstream file(Path(), std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(4096);
  for (std::uintmax_t i = 4096; i < size; ++i) file.put('\0');
  file.close();
  const StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
  if (store.ok()) {
    EXPECT_THROW((void)Contents(*store), std::runtime_error);
  }
}

TEST_F(SweepStoreTest, GivesBackWhatItWasGivenAfterReopening) {
  const SweepStudy study = Study();
  for (const int64_t point : {7, 2}) {
    StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
    ASSERT_TRUE(store.ok()) << store.status().message();
    EXPECT_FALSE(store->Has(point));
    EXPECT_TRUE(store->Add(point, Row(study, point)).ok());
    EXPECT_TRUE(store->Has(point));
  }
  const StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
  ASSERT_TRUE(store.ok()) << store.status().message();
  const std::map<int64_t, PointResult> rows = Contents(*store);
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows.at(7), Row(study, 7));
  EXPECT_TRUE(std::signbit(rows.at(7).row[3].get<double>()));
  EXPECT_EQ(PendingPoints(study, {}, *store), (std::vector<int64_t>{0, 1, 3, 4, 5, 6, 8, 9}));
  EXPECT_EQ(PendingPoints(study, {2, 3}, *store), (std::vector<int64_t>{1, 4}));
}

TEST_F(SweepStoreTest, RefusesAPointThatItHas) {
  const SweepStudy study = Study();
  StatusOr<SweepStore> store = SweepStore::Open(":memory:", study);
  ASSERT_TRUE(store.ok()) << store.status().message();
  PointResult second = Row(study, 3);
  second.row[1] = "other";
  ASSERT_TRUE(store->Add(3, Row(study, 3)).ok());
  EXPECT_FALSE(store->Add(3, second).ok());
  EXPECT_EQ(Contents(*store).at(3), Row(study, 3));
  EXPECT_TRUE(store->Add(4, Row(study, 4)).ok());
}

#if SQLITE_VERSION_NUMBER >= 3031000  // sqlite3_hard_heap_limit64
TEST_F(SweepStoreTest, MemoryThatRunsOutIsAnErrorAndLeavesTheStoreAsItWas) {
  const SweepStudy study = Study();
  StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
  ASSERT_TRUE(store.ok()) << store.status().message();
  ASSERT_TRUE(store->Add(3, Row(study, 3)).ok());
  PointResult large = Row(study, 4);
  large.row.back() = std::string(1 << 20, 'x');
  // SQLite may take no more memory than it has taken already and a little.
  sqlite3_hard_heap_limit64(sqlite3_memory_used() + (1 << 16));
  const Status full = store->Add(4, large);
  sqlite3_hard_heap_limit64(0);
  EXPECT_THAT(full.message(), AllOf(HasSubstr(Path()), HasSubstr("out of memory")));
  EXPECT_FALSE(store->Has(4));
  EXPECT_EQ(Contents(*store).at(3), Row(study, 3));
  EXPECT_TRUE(store->Add(4, large).ok());
  EXPECT_EQ(Contents(*store).at(4), large);
}
#endif

TEST_F(SweepStoreTest, RefusesAnotherStudyAndSaysWhatDiffers) {
  const SweepStudy study = Study(), other = Study("stiffness=1:10:lin:10", 240);
  ASSERT_TRUE(SweepStore::Open(Path(), study).ok());
  EXPECT_THAT(SweepStore::Open(Path(), other).status().message(),
              AllOf(HasSubstr(Path()), HasSubstr("another study"), HasSubstr("steps: 240"), HasSubstr("--output_dir")));
  EXPECT_TRUE(SweepStore::Open(Path(), study).ok());
}

TEST_F(SweepStoreTest, RefusesWhatIsNoStore) {
  const SweepStudy study = Study();
  std::ofstream(Path("text")) << std::string(5000, 'x');
  EXPECT_THAT(SweepStore::Open(Path("text"), study).status().message(), HasSubstr("not a database"));
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(Path("other").c_str(), &database), SQLITE_OK);
  sqlite3_exec(database, "CREATE TABLE recipes (name)", nullptr, nullptr, nullptr);
  sqlite3_close(database);
  EXPECT_THAT(SweepStore::Open(Path("other"), study).status().message(), HasSubstr("not one of sweeps"));
  EXPECT_THAT(SweepStore::Open("/nonexistent/sweep.sqlite", study).status().message(), HasSubstr("/nonexistent"));
}

TEST_F(SweepStoreTest, AnEmptyFileIsANewStore) {
  const SweepStudy study = Study();
  std::ofstream(Path()).flush();  // what a sweep leaves that is killed while it makes the store
  EXPECT_TRUE(SweepStore::Open(Path(), study).ok());
}

TEST_F(SweepStoreTest, IsWholeWhereverItsLogIsCut) {
  const SweepStudy study = Study();
  constexpr int kPoints = 3;
  const pid_t child = fork();
  if (child == 0) {
    StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
    bool ok = store.ok();
    for (int point = 0; ok && point < kPoints; ++point) ok = store->Add(point, Row(study, point)).ok();
    _exit(ok ? 0 : 1);  // as if killed: nothing is closed
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_EQ(status, 0);
  std::ostringstream log;
  log << std::ifstream(Path() + "-wal", std::ios::binary).rdbuf();
  const size_t size = log.str().size();
  constexpr size_t kStride = 1030;  // a quarter of a page in the log
  ASSERT_GT(size, kPoints * 4 * kStride);

  int64_t last = 0;
  for (size_t length = 0; length < size + kStride; length += kStride) {
    const std::string cut = Path("cut" + std::to_string(length));
    std::filesystem::copy_file(Path(), cut);
    std::ofstream(cut + "-wal", std::ios::binary) << log.str().substr(0, length);
    const StatusOr<SweepStore> store = SweepStore::Open(cut, study);
    ASSERT_TRUE(store.ok()) << length << " of " << size << ": " << store.status().message();
    EXPECT_GE(store->size(), last);
    last = store->size();
    for (const auto& [point, row] : Contents(*store)) EXPECT_EQ(row, Row(study, point));
  }
  EXPECT_EQ(last, kPoints);
}

TEST_F(SweepStoreTest, HasOneUserAtATime) {
  const SweepStudy study = Study();
  StatusOr<SweepStore> store = SweepStore::Open(Path(), study);
  ASSERT_TRUE(store.ok()) << store.status().message();
  EXPECT_THAT(SweepStore::Open(Path(), study).status().message(), HasSubstr("in use by another process"));
}

TEST_F(SweepStoreTest, MergesWhatIsMissing) {
  const SweepStudy study = Study();
  StatusOr<SweepStore> a = SweepStore::Open(Path("a"), study), b = SweepStore::Open(Path("b"), study);
  ASSERT_TRUE(a.ok() && b.ok());
  for (const int64_t point : {0, 3}) ASSERT_TRUE(a->Add(point, Row(study, point)).ok());
  for (const int64_t point : {3, 5, 6}) ASSERT_TRUE(b->Add(point, Row(study, point)).ok());
  const StatusOr<int64_t> added = a->Merge(*b);
  ASSERT_TRUE(added.ok()) << added.status().message();
  EXPECT_EQ(*added, 2);
  EXPECT_EQ(a->size(), 4);
  EXPECT_EQ(Contents(*a).at(6), Row(study, 6));
}

TEST_F(SweepStoreTest, ForgetsFailedPointsOnly) {
  const SweepStudy study = Study();
  StatusOr<SweepStore> store = SweepStore::Open(":memory:", study);
  ASSERT_TRUE(store.ok());
  ASSERT_TRUE(store->Add(0, Row(study, 0)).ok());
  ASSERT_TRUE(store->Add(1, FailedPoint(study, 1, "why")).ok());
  EXPECT_EQ(*store->ForgetFailed(), 1);
  EXPECT_TRUE(store->Has(0));
  EXPECT_FALSE(store->Has(1));
}

TEST(SweepOutput, SummaryGroupsReasons) {
  const SweepStudy study = Study();
  std::vector<StoredPoint> points;
  points.push_back({0, ComputePoint(study, 0, 0)});
  for (const int64_t point : {2, 5}) points.push_back({point, FailedPoint(study, point, "too hot")});
  points.push_back({7, FailedPoint(study, 7, "too cold")});
  const std::string summary = Summary(study, points);
  EXPECT_THAT(summary, HasSubstr("4 points: 1 done, 0 not applicable, 3 failed"));
  EXPECT_THAT(summary, HasSubstr("2 x too hot; first at point 2 (stiffness=3, contact=event)"));
  EXPECT_LT(summary.find("too hot"), summary.find("too cold"));
}

TEST(SweepOutput, ArraysHoldEveryColumn) {
  const SweepStudy study = Study();
  const std::vector<StoredPoint> points = {{0, ComputePoint(study, 0, 0)}, {4, FailedPoint(study, 4, "why")}};
  const NpzArrays arrays = SweepArrays(study, points);
  EXPECT_EQ(arrays.size(), study.columns().size() + 1);
  EXPECT_EQ(arrays.at("point"), (NpyArray{{2}, std::vector<int64_t>{0, 4}}));
  EXPECT_EQ(arrays.at("stiffness"), (NpyArray{{2}, std::vector<double>{1, 5}}));
  EXPECT_EQ(arrays.at("contact"), (NpyArray{{2}, std::vector<std::string>{"event", "event"}}));
  const auto& losses = std::get<std::vector<double>>(arrays.at("loss").data);
  EXPECT_NEAR(losses[0], 2.0591435061, 1e-9);  // the exact loss of the initial guess
  EXPECT_TRUE(std::isnan(losses[1]));
}

TEST(SweepPoint, TravelsAsBytesWithoutLosingBits) {
  const PointResult result{
      PointStatus::kNotApplicable,
      {0.1, -0.0, 1e-320, 3.0, int64_t{1} << 60, {}, std::string("ü"), std::numeric_limits<double>::max()}};
  EXPECT_EQ(DecodePointResult(Encode(result)), result);
  EXPECT_TRUE(std::signbit(DecodePointResult(Encode(result)).row[1].get<double>()));
}

// A limit that is over at once stops a solver where it first looks at the clock: in its first rollout.
TEST(SweepPoint, IsStoppedAtItsTimeLimit) {
  Request request = Study().request();
  request.contacts = {"direct_toi"};
  request.solvers = {"gd"};
  request.options.learning_rate = 10;
  request.options.iterations = 1'000'000'000;
  const SweepStudy study(request, ParseSweep("friction=0", request.scene));
  const PointResult result = ComputePoint(study, 0, 1e-9);
  EXPECT_EQ(result.status, PointStatus::kFailed);
  const auto column = [&](const std::string& name) {
    return result.row.at(std::find(study.columns().begin(), study.columns().end(), name) - study.columns().begin());
  };
  EXPECT_EQ(column("termination"), SweepValue("failed"));
  EXPECT_EQ(column("reason"), SweepValue("stopped at the time limit of 1e-09 s"));
  EXPECT_EQ(column("final_loss"), SweepValue());
}

TEST(SweepPoint, AnImpossiblePointFailsWithKeyAndReason) {
  const SweepStudy study = Study("restitution=0.5,1.5");
  const PointResult result = ComputePoint(study, 1, 0);
  EXPECT_EQ(result.status, PointStatus::kFailed);
  EXPECT_THAT(result.row.back().get<std::string>(), HasSubstr("restitution"));
}

}  // namespace
}  // namespace saltus
