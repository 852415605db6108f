// Further formulations of contact on the published tasks: loss and gradient at the initial guess, what gradient descent
// makes of them, and what that is worth under exact dynamics: data/formulations.csv. Its column `source` says whose
// formulation a value is of, and how it was computed, by an implementation in double precision that shares no code with
// this one; the packages themselves were not run. Values have the digits that it prints.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "base/csv.h"
#include "folders.h"
#include "saltus/audit/gradients.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

struct Number {
  double value, tolerance;
};

struct Formulation {
  std::string problem, contact;
  double friction = 0, stiffness = 0;  // 0: that of the problem
  std::map<std::string, Number> expected;
  std::vector<std::string> without_source;

  Scene MakeScene() const {
    Scene scene = ProblemScene(problem);
    scene.contact.friction = friction;
    if (stiffness > 0) scene.contact.stiffness = stiffness;
    return scene;
  }
  bool HasDescent() const { return expected.count("gd/loss") > 0; }
};
void PrintTo(const Formulation& at, std::ostream* out) { *out << at.contact; }
std::string NameOf(const testing::TestParamInfo<Formulation>& info) {
  std::string name = info.param.problem + (info.param.friction > 0 ? "_mu_" : "_") + info.param.contact;
  std::replace_if(
      name.begin(), name.end(), [](char c) { return std::isalnum(c) == 0; }, '_');
  return name;
}

std::vector<Formulation> All() {
  const StatusOr<CsvDocument> csv = ReadCsv(SourceFolder() + "/data/formulations.csv");
  const auto column = [&](const char* name) { return csv->Find(name).value(); };
  const size_t problem = column("problem"), friction = column("friction"), contact = column("contact"),
               stiffness = column("stiffness"), quantity = column("quantity"), value = column("value"),
               tolerance = column("tolerance"), source = column("source");
  std::vector<Formulation> all;
  for (const std::vector<std::string>& row : csv->rows) {
    Formulation at{row[problem],
                   row[contact],
                   std::stod(row[friction]),
                   row[stiffness].empty() ? 0 : std::stod(row[stiffness]),
                   {},
                   {}};
    const bool same = !all.empty() && std::tie(all.back().problem, all.back().contact, all.back().friction) ==
                                          std::tie(at.problem, at.contact, at.friction);
    if (!same) all.push_back(at);
    all.back().expected[row[quantity]] = {std::stod(row[value]), std::stod(row[tolerance])};
    if (row[source].empty()) all.back().without_source.push_back(row[quantity]);
  }
  return all;
}

// Compares with what is expected of `quantity`, if anything is.
void Compare(const Formulation& at, const std::string& quantity, double value) {
  const auto found = at.expected.find(quantity);
  if (found == at.expected.end()) return;
  EXPECT_NEAR(value, found->second.value, found->second.tolerance) << quantity;
}

class FormulationOf : public testing::TestWithParam<Formulation> {};

TEST_P(FormulationOf, HasSources) { EXPECT_THAT(GetParam().without_source, testing::IsEmpty()); }

TEST_P(FormulationOf, HasTheLossAndGradient) {
  const Scene scene = GetParam().MakeScene();
  const ModelGradient result = ComputeGradient(GetParam().contact, scene, Precision::kDouble);
  ASSERT_TRUE(result.ok()) << result.reason;
  Compare(GetParam(), "loss", result.loss);
  const std::string axes = "xy";
  for (int body = 0; body < scene.num_bodies(); ++body) {
    const std::string number = scene.num_bodies() > 1 ? std::to_string(body + 1) : "";
    for (int j = 0; j < 2; ++j) {
      Compare(GetParam(), "dloss/dp" + number + "_" + axes[j], result.gradient.initial[4 * body + j]);
      Compare(GetParam(), "dloss/dv" + number + "_" + axes[j], result.gradient.initial[4 * body + 2 + j]);
    }
  }
  if (result.gradient.control.empty()) return;
  Compare(GetParam(), "dloss/du0_y", result.gradient.control[1]);
  Compare(GetParam(), "dloss/du1_0_x", result.gradient.control[0]);
}

INSTANTIATE_TEST_SUITE_P(All, FormulationOf, testing::ValuesIn(All()), NameOf);

class DescentUnder : public testing::TestWithParam<Formulation> {};

// Right trajectories with gradients of the wrong sign end at no effort and no hit (loss 2 in two_balls); laws of force
// and projections learn.
TEST_P(DescentUnder, EndsAtTheLossAndExactLoss) {
  const Scene scene = GetParam().MakeScene();
  const double rate = scene.optimize == Optimize::kControl ? 10 : 0.01;
  const SolveReport report = Solve("gd", {scene, GetParam().contact}, {.descent = {.learning_rate = rate}});
  Compare(GetParam(), "gd/loss", report.solution.loss);
  Compare(GetParam(), "gd/v_x", report.solution.initial_state[2]);
  Compare(GetParam(), "gd/v_y", report.solution.initial_state[3]);
  const ExactRun exact = SimulateExactly(scene, report.solution.initial_state, report.solution.control);
  ASSERT_TRUE(exact.ok) << exact.reason;
  Compare(GetParam(), "gd/exact_loss", exact.loss);
}

// Without those under ncp, whose thousand gradients take half a minute and more.
std::vector<Formulation> Descents() {
  std::vector<Formulation> descents;
  for (const Formulation& at : All()) {
    if (at.HasDescent() && std::isfinite(FindContactModel(at.contact)->push_gap)) descents.push_back(at);
  }
  return descents;
}

INSTANTIATE_TEST_SUITE_P(All, DescentUnder, testing::ValuesIn(Descents()), NameOf);

}  // namespace
}  // namespace saltus
