#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>

#include "folders.h"
#include "programs/run_program.h"
#include "sweep/results.h"

namespace saltus {
namespace {

using testing::AllOf;
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

  std::string Path(const std::string& name = "sweep.csv") const { return directory_ + "/" + name; }

  // A row whose numbers any rounding would change.
  static PointResult Row(const SweepStudy& study, int64_t point) {
    PointResult result{PointStatus::kComputed, study.Values(point)};
    for (const SweepValue& value : {SweepValue(1.0 / 3),
                                    SweepValue(-0.0),
                                    SweepValue(5e-324),
                                    SweepValue(2.0),
                                    SweepValue(),
                                    SweepValue("it's \"ü\",\non two lines")}) {
      result.row.push_back(value);
    }
    CHECK_EQ(result.row.size(), study.columns().size());
    return result;
  }

  // The error of opening the store.
  std::string ErrorOf(const SweepStudy& study) const {
    try {
      const SweepStore store(directory_, "sweep", study);
    } catch (const InputError& error) {
      return error.what();
    }
    return "none";
  }

  std::string directory_ = TempFile("sweep_store");
};

TEST_F(SweepStoreTest, GivesBackWhatItWasGivenAfterReopening) {
  const SweepStudy study = Study();
  for (const int64_t point : {7, 2}) {
    SweepStore store(directory_, "sweep", study);
    EXPECT_EQ(store.Find(point), nullptr);
    store.Add(point, Row(study, point));
    EXPECT_EQ(*store.Find(point), Row(study, point));
  }
  const SweepStore store(directory_, "sweep", study);
  for (int64_t point = 0; point < study.size(); ++point) {
    EXPECT_EQ(store.Find(point) != nullptr, point == 7 || point == 2);
  }
  EXPECT_EQ(*store.Find(7), Row(study, 7));
  EXPECT_EQ(store.Find(7)->row[2].type(), Json::value_t::number_float);
  EXPECT_TRUE(std::signbit(store.Find(7)->row[3].get<double>()));
  EXPECT_EQ(StoredPoints(store, {3, 10}).size(), 1u);
}

// Wherever a process was killed that wrote a row, the rows before it are there and the store goes on.
TEST_F(SweepStoreTest, IsWholeWhereverItIsCut) {
  const SweepStudy study = Study();
  constexpr int kPoints = 3;
  std::vector<size_t> ends;
  {
    SweepStore store(directory_, "sweep", study);
    ends.push_back(std::filesystem::file_size(Path()));
    for (int point = 0; point < kPoints; ++point) {
      store.Add(point, Row(study, point));
      ends.push_back(std::filesystem::file_size(Path()));
    }
  }
  const std::string whole = ContentsOf(Path());
  for (size_t length = 0; length <= whole.size(); ++length) {
    std::ofstream(Path(), std::ios::binary) << whole.substr(0, length);
    SweepStore store(directory_, "sweep", study);
    int complete = 0;
    while (complete < kPoints && ends[complete + 1] <= length) ++complete;
    for (int point = 0; point < kPoints; ++point) {
      const PointResult* found = store.Find(point);
      ASSERT_EQ(found != nullptr, point < complete) << "cut at " << length;
      if (found != nullptr) {
        ASSERT_EQ(*found, Row(study, point));
      }
    }
    for (int point = complete; point < kPoints; ++point) store.Add(point, Row(study, point));
    ASSERT_TRUE(ContentsOf(Path()) == whole) << "cut at " << length;
  }
}

TEST_F(SweepStoreTest, RowsAreFoundInAnyOrderAndByNumbersHoweverWritten) {
  const SweepStudy study = Study("stiffness=1,2;damping=10,20,30");
  {
    SweepStore store(directory_, "sweep", study);
    PointResult row = Row(study, 4);
    row.row.back() = "plain";
    store.Add(4, row);
  }
  std::string text = ContentsOf(Path());
  const size_t at = text.find("\n2,20,event,");
  ASSERT_NE(at, std::string::npos) << text;
  text.replace(at, 5, "\n2.0,2e1");
  std::ofstream(Path()) << text;
  const SweepStore store(directory_, "sweep", study);
  ASSERT_NE(store.Find(4), nullptr);
  EXPECT_EQ(store.Find(4)->row[1], SweepValue(20.0));
  EXPECT_EQ(store.Find(3), nullptr);
}

TEST_F(SweepStoreTest, ValuesThatAreListedTwiceAreOnePoint) {
  const SweepStudy study = Study("stiffness=1,2,1.0;damping=5,5");
  ASSERT_EQ(study.size(), 2);
  EXPECT_EQ(study.Values(0)[0], SweepValue(1.0));
  EXPECT_EQ(study.Values(1)[0], SweepValue(2.0));
  EXPECT_EQ(study.FindPoint({"2", "5.0", "event"}), 1);
}

TEST_F(SweepStoreTest, RefusesAnotherStudyAndSaysWhatDiffers) {
  const SweepStudy study = Study(), other = Study("stiffness=1:10:lin:10", 240);
  EXPECT_EQ(ErrorOf(study), "none");
  EXPECT_THAT(ErrorOf(other),
              AllOf(HasSubstr("sweep.study.json"),
                    HasSubstr("another study"),
                    HasSubstr("steps: 240"),
                    HasSubstr("--output_dir")));
  EXPECT_EQ(ErrorOf(study), "none");
  std::filesystem::remove(Path("sweep.study.json"));
  EXPECT_THAT(ErrorOf(study), AllOf(HasSubstr("sweep.csv has rows"), HasSubstr("not known of which study")));
}

TEST_F(SweepStoreTest, RefusesRowsThatAreNoneOfTheStudy) {
  const SweepStudy study = Study();
  const std::string header = SweepHeader(study);
  const std::string row = SweepLine(Row(study, 1));
  const auto error_of = [&](const std::string& text) {
    std::ofstream(Path()) << text;
    return ErrorOf(study);
  };
  EXPECT_EQ(error_of(""), "none");
  EXPECT_EQ(error_of(header + row), "none");
  EXPECT_THAT(error_of("name,minutes\nsoup,20\n"), HasSubstr("the columns are none of this sweep"));
  EXPECT_THAT(error_of(header + "2.5" + row.substr(1)), HasSubstr("line 2: no row of this sweep"));
  EXPECT_THAT(error_of(header + row.substr(0, row.size() - 5) + "finished\n"),
              HasSubstr("line 2: no row of this sweep"));
  EXPECT_THAT(error_of(header + "2,event\n"), HasSubstr("line 2: 2 fields"));
  EXPECT_THAT(error_of(std::string("\0\0\n", 3)), HasSubstr("the columns are none of this sweep"));
  std::filesystem::remove(Path());
  std::filesystem::create_directories(Path());
  EXPECT_THAT(ErrorOf(study), HasSubstr("it is a directory, expected a regular file or none"));
}

TEST_F(SweepStoreTest, HasOneUserAtATime) {
  const SweepStudy study = Study();
  const SweepStore store(directory_, "sweep", study);
  EXPECT_THAT(ErrorOf(study), HasSubstr("in use by another process"));
}

// A full disk: the row is not there, the rows before it are, and the store goes on once there is room.
TEST_F(SweepStoreTest, ARowThatDoesNotFitLeavesTheFileAsItWas) {
  const SweepStudy study = Study();
  SweepStore store(directory_, "sweep", study);
  store.Add(3, Row(study, 3));
  const std::string before = ContentsOf(Path());
  const auto previous = std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &limit), 0);
  const rlimit small = {before.size() + 10, limit.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  EXPECT_THROW(store.Add(4, Row(study, 4)), OutputError);
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  std::signal(SIGXFSZ, previous);
  EXPECT_EQ(store.Find(4), nullptr);
  EXPECT_TRUE(ContentsOf(Path()) == before);
  store.Add(4, Row(study, 4));
  EXPECT_TRUE(ContentsOf(Path()) == before + SweepLine(Row(study, 4)));
}

TEST_F(SweepStoreTest, ForgetsFailedPointsOnly) {
  const SweepStudy study = Study();
  {
    SweepStore store(directory_, "sweep", study);
    store.Add(0, Row(study, 0));
    store.Add(1, FailedPoint(study, 1, "why"));
    store.ForgetFailed();
    EXPECT_NE(store.Find(0), nullptr);
    EXPECT_EQ(store.Find(1), nullptr);
    store.Add(1, Row(study, 1));
  }
  const SweepStore store(directory_, "sweep", study);
  EXPECT_EQ(*store.Find(1), Row(study, 1)) << "the last row of a point counts";
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
  EXPECT_EQ(arrays.size(), study.columns().size() + 2);
  EXPECT_EQ(arrays.at("point"), (NpyArray{{2}, std::vector<int64_t>{0, 4}}));
  EXPECT_EQ(arrays.at("stiffness"), (NpyArray{{2}, std::vector<double>{1, 5}}));
  EXPECT_EQ(arrays.at("contact"), (NpyArray{{2}, std::vector<std::string>{"event", "event"}}));
  const auto& losses = std::get<std::vector<double>>(arrays.at("loss").data);
  EXPECT_NEAR(losses[0], 2.0591435061, 1e-9);  // the exact loss of the initial guess
  EXPECT_TRUE(std::isnan(losses[1]));
}

// A limit that is over at once stops a solver where it first looks at the clock: in its first rollout.
TEST(SweepPoint, IsStoppedAtItsTimeLimit) {
  Request request = Study().request();
  request.contacts = {"direct_toi"};
  request.solvers = {"gd"};
  request.options.descent.learning_rate = 10;
  request.options.limits.iterations = 1'000'000'000;
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
