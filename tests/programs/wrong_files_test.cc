// Files that users hand to the programs beside scenes: what is wrong with them is said in words of the file, with its
// key or line. And the table of runs, whose refusals are said once.
#include <gmock/gmock.h>

#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "folders.h"
#include "output/npz.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "programs/solve.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class WrongFiles : public testing::Test {
 protected:
  // Returns the message of `read` for a file with this text.
  std::string ErrorOf(const std::string& text, const std::function<void(const std::string&)>& read) const {
    std::ofstream(path_) << text;
    try {
      read(path_);
    } catch (const InputError& error) {
      return error.what();
    }
    return "none";
  }
  std::string ErrorOfGiven(const std::string& text) const {
    return ErrorOf(text, [&](const std::string& path) { (void)ReadExternalGradient(path, scene_); });
  }
  std::string ErrorOfReplay(const std::string& text) const {
    return ErrorOf(text, [](const std::string& path) { (void)ReadReplayFile(path, std::nullopt); });
  }
  std::string ErrorOfControl(const std::string& text) const {
    return ErrorOf(text, [&](const std::string& path) { (void)ReadSolution("--control", path, scene_); });
  }

  std::vector<std::function<std::string(const std::string&)>> Readers() const {
    return {[this](const std::string& text) { return ErrorOfGiven(text); },
            [this](const std::string& text) { return ErrorOfReplay(text); },
            [this](const std::string& text) { return ErrorOfControl(text); }};
  }

  const Scene scene_ = ProblemScene("two_balls");
  const std::string path_ = TempFile("wrong");
};

TEST_F(WrongFiles, EmptyOnesAndThoseThatAreNoJsonAreSaidToBe) {
  for (const auto& error : Readers()) {
    for (const char* empty : {"", " \n\t\r\n"}) {
      EXPECT_THAT(error(empty), AllOf(HasSubstr(path_ + ": the file is empty, expected "), HasSubstr("JSON object")));
    }
    EXPECT_THAT(error("{\n  \"position\": [1,,2]\n}"), HasSubstr("line 2, column 18: found text that is not JSON"));
    EXPECT_THAT(error("x"), HasSubstr("line 1, column 1: found text that is not JSON"));
    EXPECT_THAT(error("{\"position\":\n"), HasSubstr(": found the end of the file, expected "));
    EXPECT_THAT(error("{\"tolerance\": 1e999}"), HasSubstr("expected "));
    EXPECT_THAT(error("[]"), HasSubstr("object"));
    for (const char* text : {"", "x", "{", "[1", "\"\x80\"", "1e999", "nul"}) {
      EXPECT_THAT(error(text), AllOf(Not(HasSubstr("json.exception")), testing::Ne("none"))) << text;
    }
  }
}

TEST_F(WrongFiles, AGradientWithoutNumbersJudgesNothing) {
  for (const char* text : {"{}",
                           R"({"name": "a", "tolerance": 1})",
                           R"({"position": []})",
                           R"({"position": [null, null], "velocity": [null]})",
                           R"({"control": [[], [null]]})",
                           R"({"gradient": {}})",
                           R"({"parameters": {"stiffness": 1}})"}) {
    EXPECT_THAT(ErrorOfGiven(text), HasSubstr("expected some in position, velocity or control")) << text;
  }
  EXPECT_EQ(ErrorOfGiven(R"({"position": [null, [1, 2]]})"), "none");
  EXPECT_EQ(ErrorOfGiven(R"({"control": [[], [[1, 2]]]})"), "none");
}

TEST_F(WrongFiles, AGradientOfFixedDiscsOnlyJudgesNothing) {
  Scene scene = scene_;
  scene.bodies[1].fixed = true;
  const auto read = [&](const std::string& path) { (void)ReadExternalGradient(path, scene); };
  EXPECT_THAT(ErrorOf(R"({"position": [null, [1, 2]]})", read), HasSubstr("no number of a disc that moves"));
  EXPECT_EQ(ErrorOf(R"({"position": [[1, 2], [1, 2]]})", read), "none");
}

TEST_F(WrongFiles, AGradientHasRotationsOfDiscsThatSpinOnly) {
  const char* spin = R"({"angle": [null], "angular_velocity": [0.5]})";
  EXPECT_THAT(ErrorOfGiven(spin), HasSubstr("and of scenes with discs that spin angle and angular_velocity"));
  const Scene scene = ProblemScene("back_spin");
  const auto read = [&](const std::string& path) { (void)ReadExternalGradient(path, scene); };
  EXPECT_EQ(ErrorOf(spin, read), "none");
  EXPECT_THAT(ErrorOf(R"({"angle": [null]})", read), HasSubstr("no number of a disc that moves"));
  EXPECT_THAT(ErrorOf(R"({"angle": [0.5, 0.5]})", read),
              HasSubstr("angle: expected a list of at most 1 finite numbers"));
  EXPECT_THAT(ErrorOf(R"({"angle": [[0.5]]})", read), HasSubstr("angle: expected a list of at most 1 finite numbers"));
}

TEST_F(WrongFiles, ATouchEndsAfterItBegins) {
  const auto with = [](const std::string& touch) {
    return R"({"bodies": [{"name": "ball", "radius": 0.1}], "planes": [{"name": "ground", "point": [0, 0],
        "normal": [0, 1]}], "times": [0, 1], "states": [[[0, 1]], [[0, 0.1]]],
        "touches": [{"a": "ball", "b": "ground", )" +
           touch + "}]}";
  };
  EXPECT_EQ(ErrorOfReplay(with(R"("begin": 0.5)")), "none");
  EXPECT_EQ(ErrorOfReplay(with(R"("begin": 0.5, "end": 0.5)")), "none");
  EXPECT_THAT(ErrorOfReplay(with(R"("begin": 0.5, "end": 0.25)")),
              HasSubstr("touches[0].end: expected a time from its begin on, 0.5, found 0.25"));
}

// Arrays are refused where their shapes do not fit, as lists are in JSON.
TEST_F(WrongFiles, ArraysHaveTheShapesOfARun) {
  const auto error = [&](const NpzArrays& arrays) {
    EXPECT_TRUE(WriteNpz(path_, arrays).ok());
    try {
      (void)ReadSolution("--control", path_, scene_);
      (void)ReadReplayFile(path_, scene_);
    } catch (const InputError& wrong) {
      return std::string(wrong.what());
    }
    return std::string("none");
  };
  const auto zeros = [](std::vector<int64_t> shape) {
    int64_t size = 1;
    for (const int64_t length : shape) size *= length;
    return NpyArray{shape, std::vector<double>(static_cast<size_t>(size))};
  };
  const NpzArrays motion = {{"times", {{2}, std::vector<double>{0, 1}}}, {"states", zeros({2, 2, 4})}};
  const auto with = [&](const std::string& key, const NpyArray& array) {
    NpzArrays arrays = motion;
    arrays[key] = array;
    return arrays;
  };
  EXPECT_EQ(error(motion), "none");
  EXPECT_EQ(error(with("control", zeros({3, 1, 2}))), "none");
  EXPECT_EQ(error(with("control", zeros({3, 2}))), "none");
  EXPECT_THAT(error(with("control", zeros({3, 2, 2}))), HasSubstr("control: expected a shape of (K, 1, 2)"));
  EXPECT_THAT(error(with("initial_state", zeros({2, 3}))), HasSubstr("initial_state: expected a shape of (B, 4)"));
  EXPECT_THAT(error(with("initial_state", zeros({1, 4}))), HasSubstr("position: expected a list of 2 times"));
  EXPECT_THAT(error(with("states", zeros({2, 1, 4}))), HasSubstr("states[0]: expected one list for each of 2 discs"));
  EXPECT_THAT(error(with("rotations", zeros({1, 2, 2}))), HasSubstr("rotations: expected a shape of (n, 2, 2)"));
  NpzArrays touched = with("touch_pairs", {{1, 3}, std::vector<int64_t>{0, 1, 1}});
  EXPECT_THAT(error(touched), HasSubstr("touch_times: expected shapes of (M, 3), (M, 2) and (M, 2)"));
  touched["touch_times"] = zeros({1, 2});
  EXPECT_THAT(error(touched), HasSubstr("touches[0].b: expected the number of a disc or of a wall"));  // there is none
  NpzArrays named = with("parameters", zeros({1}));
  named["parameter_names"] = zeros({1});
  EXPECT_THAT(error(named), HasSubstr("parameter_names: expected one name for each parameter"));
}

// A duration that was found stands in the table; without one there is no column.
TEST(RunTable, ShowsDurationsThatWereFree) {
  SolvedRuns solved;
  SolveReport& report = solved.runs.emplace_back().report;
  report.contact = "event";
  report.solver = "ceres_phases";
  report.termination = Termination::kConverged;
  const std::size_t columns = RunTable(solved).ColumnsWithContent().size();
  solved.runs.back().duration = 0.488;
  const Table table = RunTable(solved);
  EXPECT_EQ(table.ColumnsWithContent().size(), columns + 1);
  EXPECT_EQ(table.columns()[5].header, "duration (s)");
  EXPECT_EQ(table.rows()[0][5].Exact(), "0.488");
}

// A heading of curvatures stands only above curvatures.
TEST(CertificateTable, KnowsWhetherItHasCurvatures) {
  SolvedRuns solved;
  Certificate& certificate = solved.runs.emplace_back().certificate.emplace();
  certificate.verdict = Certificate::Verdict::kStationary;
  EXPECT_FALSE(HasCurvatures(solved));
  certificate.curvature.emplace();
  EXPECT_TRUE(HasCurvatures(solved));
}

// Every contact model with solvers that all refuse for one reason: two rows, not one for each of them.
TEST(RunTable, SaysEachReasonOnce) {
  SolvedRuns solved;
  const auto add =
      [&](const std::string& contact, const std::string& solver, Termination termination, const std::string& reason) {
        SolvedRun run;
        run.report.contact = contact;
        run.report.solver = solver;
        run.report.termination = termination;
        run.report.reason = reason;
        solved.runs.push_back(run);
      };
  const char* contacts[] = {"lcp", "convex", "direct", "direct_toi", "ncp", "xpbd", "qcqp", "event"};
  for (const char* contact : contacts) {
    for (const char* solver : {"gd", "ceres_lm"}) add(contact, solver, Termination::kNotApplicable, "no control");
    if (contact != std::string("event")) continue;
    add(contact, "hmp", Termination::kNotApplicable, "another");
    add(contact, "ceres_event", Termination::kFailed, "no control");
  }
  const Table table = RunTable(solved);
  std::vector<std::string> rows;
  for (const std::vector<Cell>& row : table.rows()) {
    rows.push_back(row[0].Exact() + "|" + row[1].Exact() + "|" + row[9].Exact() + "|" + row[10].Exact());
  }
  EXPECT_THAT(rows,
              testing::ElementsAre("event|ceres_event|failed|no control",
                                   "lcp, convex, direct, direct_toi, ncp, xpbd and 2 more|gd, ceres_lm|not_applicable|"
                                   "no control",
                                   "event|hmp|not_applicable|another"));
}

}  // namespace
}  // namespace saltus
