// The comparison of solvers: nothing is missing, and nothing is better than possible.
#include <gmock/gmock.h>

#include <cstdlib>

#include "folders.h"
#include "paper/experiments.h"
#include "paper_tables.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using testing::HasSubstr;

class Comparison : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    Experiments experiments(SourceFolder() + "/problems");
    ASSERT_TRUE(experiments.Run(2, ProgressMode::kNone));
    const auto compared = CompareSolvers(experiments, OtherSolvers::kQuick, 2, ProgressMode::kNone);
    ASSERT_TRUE(compared.has_value());
    comparison_ = new ComparedSolvers(*compared);
  }

  static CsvDocument Find(const std::string& name) { return FindTable(comparison_->tables, name); }

  static ComparedSolvers* comparison_;
};

ComparedSolvers* Comparison::comparison_ = nullptr;

TEST_F(Comparison, HasEveryModelWithEveryGeneralSolver) {
  for (const char* name : {"comparison_ground_wall", "comparison_ground_wall_mu", "comparison_two_balls"}) {
    const CsvDocument csv = Find(name);
    for (const ModelTraits& model : AllContactModels()) {
      if (!model.compared && !model.event_driven) continue;
      if (std::string(name).ends_with("_mu") && !model.friction) continue;
      for (const char* solver : {"gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting"}) {
        EXPECT_NE(Get(csv, std::string(model.name), solver, "exact loss"), "") << name << model.name << solver;
      }
    }
  }
}

// 1.396542160123 is the optimum of task 3 over all controls, grid or not.
TEST_F(Comparison, NoExactLossIsBelowTheOptimum) {
  const CsvDocument csv = Find("comparison_two_balls");
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    const double exact = std::stod(Get(csv, row, "exact loss"));
    EXPECT_GE(exact, 1.396542160123 - 1e-9) << Get(csv, row, "contact") << Get(csv, row, "solver");
    EXPECT_NEAR(std::stod(Get(csv, row, "gap")), exact - 1.396542160123, 1e-9);
  }
}

TEST_F(Comparison, OnTheGridTheOrderOfSolversIsAsMeasured) {
  const CsvDocument csv = Find("comparison_two_balls");
  const auto exact = [&](const char* solver) { return std::stod(Get(csv, "event", solver, "exact loss")); };
  EXPECT_NEAR(exact("gd"), 1.399110059935, 1e-7);
  EXPECT_LT(exact("ceres_shooting"), 1.3970);
  EXPECT_LT(exact("ceres_lm"), 1.3970);
  EXPECT_NEAR(exact("grid_optimum"), 1.3965431005988, 1e-9);
  EXPECT_GT(exact("ceres_lagrangian"), 1.6);
  EXPECT_LT(std::stod(Get(Find("comparison_ground_wall"), "event", "ceres_lm", "exact loss")), 1e-20);
}

// Exact losses of gradient descent as computed for these formulations elsewhere; 2 is the loss of doing nothing.
TEST_F(Comparison, OtherFormulationsAreSolvedInTask3) {
  const CsvDocument csv = Find("comparison_formulations");
  const auto exact = [&](const char* contact, const char* solver) {
    const std::string loss = Get(csv, contact, solver, "exact loss");
    return loss.empty() ? std::nan("") : std::stod(loss);
  };
  for (const ModelTraits& model : AllContactModels()) {
    if (model.compared || model.event_driven) continue;
    const std::string name(model.name);
    EXPECT_GE(exact(name.c_str(), "ceres_lm"), 1.396542160123 - 1e-9) << name;
    EXPECT_GE(exact(name.c_str(), "ceres_lbfgs"), 1.396542160123 - 1e-9) << name;
  }
  EXPECT_NEAR(exact("smooth_compliant", "gd"), 1.400528, 1e-5);
  EXPECT_NEAR(exact("lcp_pgs", "gd"), 1.7528, 1e-4);
  EXPECT_NEAR(exact("qcqp", "gd"), 2.0014, 1e-4);
  EXPECT_NEAR(exact("xpbd", "gd"), 1.4308, 1e-4);
  EXPECT_LT(exact("smooth_compliant", "ceres_lm"), 1.4);
  EXPECT_GT(exact("qcqp", "ceres_lm"), 1.7);
  EXPECT_TRUE(Get(csv, "ncp", "gd", "exact loss").empty());  // too slow, unless asked for
}

TEST_F(Comparison, TheLagrangianNeverConverges) {
  const CsvDocument csv = Find("step_shooting");
  EXPECT_EQ(csv.rows.size(), 11u);
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    EXPECT_NE(Get(csv, row, "termination"), "converged") << Get(csv, row, "contact");
    EXPECT_FALSE(Get(csv, row, "feasible path, 480").empty());
    EXPECT_EQ(Get(csv, row, "feasible path, 1000").empty(), Get(csv, row, "contact") != "event");
  }
}

TEST_F(Comparison, FiguresHaveALineForEachSolver) {
  const std::vector<PaperFigure> figures = comparison_->figures;
  ASSERT_EQ(figures.size(), 2u);
  size_t exact_solvers = 0;
  for (const SolverEntry& solver : AllSolvers()) {
    const CsvDocument csv = Find("comparison_two_balls");
    exact_solvers += Get(csv, "event", std::string(solver.name), "exact loss").empty() ? 0 : 1;
  }
  EXPECT_GE(exact_solvers, 6u);
  EXPECT_EQ(figures[0].figure.panels[1].series.size(), exact_solvers);
  EXPECT_EQ(comparison_->controls.figure.panels[0].series.size(), exact_solvers + 1);
  EXPECT_GE(figures[1].figure.panels[0].series.size(), 3u);
}

TEST_F(Comparison, FindingsNameModelAndSolver) {
  const std::vector<std::string> findings = comparison_->findings;
  ASSERT_GE(findings.size(), 4u);
  EXPECT_THAT(findings[0], HasSubstr("`event`"));
  EXPECT_THAT(findings[1], HasSubstr("`ceres_lm`"));
  EXPECT_THAT(findings.back(), testing::ContainsRegex("with .*`smooth_compliant`.*not with .*`qcqp`"));
  for (const std::string& finding : findings) {
    EXPECT_THAT(finding, testing::Not(HasSubstr("no run"))) << finding;
    EXPECT_THAT(finding, testing::Not(HasSubstr("inf"))) << finding;
  }
}

}  // namespace
}  // namespace saltus
