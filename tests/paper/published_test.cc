// Every number that the paper prints, at its precision and within its tolerance, from what saltus_reproduce runs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "folders.h"
#include "output/npz.h"
#include "paper/experiments.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
using testing::Pair;

class Published : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    experiments_ = new Experiments(SourceFolder() + "/problems");
    ASSERT_TRUE(experiments_->Run(2, ProgressMode::kNone));
    rows_ = new std::vector<PublishedRow>(ReadPublished(SourceFolder() + "/data/published.csv"));
    CompareWithPublished(*experiments_, rows_);
  }

  static Experiments* experiments_;
  static std::vector<PublishedRow>* rows_;
};

Experiments* Published::experiments_ = nullptr;
std::vector<PublishedRow>* Published::rows_ = nullptr;

TEST_F(Published, EveryNumber) {
  std::map<std::string, int> rows_of_table;
  for (const PublishedRow& row : *rows_) {
    ++rows_of_table[row.table];
    const std::string name = row.table + " " + row.problem + " " + row.contact + " " + row.quantity;
    ASSERT_TRUE(row.ours) << name << " is not computed";
    if (!row.IsJudged()) continue;
    EXPECT_NEAR(*row.ours, row.expected, row.tolerance) << name;
  }
  EXPECT_THAT(
      rows_of_table,
      ElementsAre(Pair("F5", 8), Pair("L4DC", 2), Pair("T1", 27), Pair("T2", 36), Pair("T3", 60), Pair("T4", 28)));
}

TEST_F(Published, ARowOutsideItsToleranceDoesNotMatch) {
  PublishedRow row = rows_->front();
  ASSERT_TRUE(row.Matches());
  row.ours = row.expected + 2 * row.tolerance;
  EXPECT_FALSE(row.Matches());
  row.ours.reset();
  EXPECT_FALSE(row.Matches());
}

TEST_F(Published, ResultsDoNotDependOnTheNumberOfThreads) {
  Experiments alone(SourceFolder() + "/problems");
  ASSERT_TRUE(alone.Run(1, ProgressMode::kNone));
  ASSERT_EQ(alone.all().size(), experiments_->all().size());
  for (size_t i = 0; i < alone.all().size(); ++i) {
    const Experiment& one = alone.all()[i];
    const Experiment& two = experiments_->all()[i];
    EXPECT_EQ(one.gradient.gradient.initial, two.gradient.gradient.initial);
    for (size_t r = 0; r < one.runs.size(); ++r) {
      EXPECT_EQ(one.runs[r].report.history.losses, two.runs[r].report.history.losses);
    }
  }
}

// Whoever reads a row has the paper and this project, and nothing else.
TEST_F(Published, VerdictsAreWordsThatDoNotContradictEachOther) {
  std::map<std::string, std::string> words;
  for (PublishedRow row : *rows_) {
    EXPECT_THAT(row.note, Not(HasSubstr(".md"))) << row.table << " " << row.contact << " " << row.quantity;
    row.ours = row.expected;
    words[row.verdict] = VerdictInWords(row);
  }
  EXPECT_THAT(words,
              ElementsAre(Pair("", "as expected; none is printed"),
                          Pair("approximate", "as expected; the published number is approximate"),
                          Pair("chaotic", "not judged: rounding decides it"),
                          Pair("grid", "as expected; the published number is the lowest of a grid of points"),
                          Pair("match", "reproduced"),
                          Pair("published_error", "as expected; the published number is that of another quantity"),
                          Pair("published_misprint", "as expected; the published number is a misprint"),
                          Pair("published_unreproducible", "as expected; the released code gives another number"),
                          Pair("solver_error", "as expected; the published number has the error of its solver")));
  PublishedRow row = rows_->front();
  row.ours = row.expected + 2 * row.tolerance;
  EXPECT_EQ(VerdictInWords(row), "NOT reproduced");
  row.verdict = "published_misprint";
  EXPECT_EQ(VerdictInWords(row), "NOT as expected; the published number is a misprint");
  row.verdict = "chaotic";
  EXPECT_EQ(VerdictInWords(row), "not judged: rounding decides it");
}

// A cell whose numbers differ, or are not judged, ends in the number of its note.
TEST_F(Published, NotesOfTablesAreNumbered) {
  for (const std::string name : {"T1", "T2", "T3", "T4", "F5", "L4DC"}) {
    std::vector<std::string> notes;
    const Table table = PaperTable(*rows_, name, &notes);
    std::set<int> numbers;
    for (const std::vector<Cell>& row : table.rows()) {
      for (const Cell& cell : row) {
        const std::string text = cell.Exact();
        if (text.ends_with("]")) numbers.insert(std::stoi(text.substr(text.rfind('[') + 1)));
      }
    }
    ASSERT_EQ(numbers.size(), notes.size()) << name;
    if (notes.empty()) continue;
    EXPECT_EQ(*numbers.begin(), 1) << name;
    EXPECT_EQ(*numbers.rbegin(), std::ssize(notes)) << name;
  }
}

// The names that the authors' notebooks open.
TEST_F(Published, NotebooksFindTheirFiles) {
  const std::string directory = TempFile("notebooks");
  WriteNotebookFiles(*experiments_, directory);
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(directory + "/results")) {
    names.push_back(entry.path().filename());
  }
  for (const char* name : {"two_balls_1_soft_warp_kn_100.npz",
                           "two_balls_1_soft_warp_kn_1000.0.npz",
                           "two_balls_1_soft_warp_kn_10000.0.npz",
                           "two_balls_1_soft_warp_kn_100000.0.npz",
                           "two_balls_1_specialized_difftaichi_w_toi.npz",
                           "ground_wall_pbd_brax.npz",
                           "ground_wall_convexopt_diffcosim_symplectic_euler_wo_toi_mu_0.1.npz"}) {
    EXPECT_THAT(names, Contains(name));
  }
  EXPECT_THAT(names, Not(Contains("two_balls_1_soft_warp_kn_100.0.npz")));
  const StatusOr<NpzArrays> arrays = ReadNpz(directory + "/results/two_balls_1_soft_warp_kn_100.npz");
  ASSERT_TRUE(arrays.ok()) << arrays.status().message();
  EXPECT_THAT(arrays->at("loss").shape, ElementsAre(1000));
  EXPECT_THAT(arrays->at("ctrls").shape, ElementsAre(480, 2));
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace saltus
