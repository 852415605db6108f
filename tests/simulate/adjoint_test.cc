// The adjoint on the published tasks: against the gradients that data/published.csv expects of every model, against
// forward sensitivities through the steps' linearizations, and against differences of the loss.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "base/csv.h"
#include "folders.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

struct Entry {
  std::string quantity;  // such as dloss/dv_y, dloss/dp2_x, dloss/du1_0_x
  double expected = 0, tolerance = 0;

  bool of_control() const { return kind() == 'u'; }
  // In the initial state (B x 4), or in the control, of which only the first force is listed.
  int index() const {
    const int axis = quantity.back() == 'y' ? 1 : 0, body = quantity.at(std::string("dloss/dp").size()) == '2' ? 1 : 0;
    return of_control() ? axis : 4 * body + (kind() == 'v' ? 2 : 0) + axis;
  }

 private:
  char kind() const { return quantity.at(std::string("dloss/d").size()); }
};

// One task under one model, with the rows of its table.
struct Case {
  std::string table, problem, contact;
  double friction = 0;
  Precision precision = Precision::kDouble;
  std::vector<Entry> entries = {};

  bool IsOf(const Case& other) const {
    return table == other.table && contact == other.contact && precision == other.precision;
  }
  Scene MakeScene() const {
    Scene scene = ProblemScene(problem);
    scene.contact.friction = friction;
    return scene;
  }
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.contact << " on " << c.problem; }
std::string NameOf(const testing::TestParamInfo<Case>& info) {
  const char* precision = info.param.precision == Precision::kFloat ? "_float" : "";
  return info.param.table + "_" + info.param.problem + "_" + info.param.contact + precision;
}

std::vector<Case> PublishedGradients() {
  const StatusOr<CsvDocument> csv = ReadCsv(SourceFolder() + "/data/published.csv");
  const auto column = [&](const char* name) { return csv->Find(name).value(); };
  std::vector<Case> cases;
  for (const std::vector<std::string>& row : csv->rows) {
    const std::string& quantity = row[column("quantity")];
    if (!quantity.starts_with("dloss/") || row[column("contact")] == "analytic") continue;
    Case at{row[column("table")], row[column("problem")], row[column("contact")], std::stod(row[column("friction")])};
    if (row[column("precision")] == "float") at.precision = Precision::kFloat;
    if (cases.empty() || !cases.back().IsOf(at)) cases.push_back(at);
    cases.back().entries.push_back({quantity, std::stod(row[column("expected")]), std::stod(row[column("tolerance")])});
  }
  return cases;
}

class AdjointOf : public testing::TestWithParam<Case> {
 protected:
  AdjointOf() : scene_(GetParam().MakeScene()) {
    simulator_ = MakeSimulator(GetParam().contact, scene_, GetParam().precision);
    initial_ = InitialState(scene_);
    control_ = InitialControl(scene_, simulator_->num_steps());
    x_.resize(simulator_->state_size());
    LossAt(initial_, control_);
    touches_ = simulator_->touches();
    cotangent_.resize(x_.size());
    TerminalGradient(scene_.objective, x_, simulator_->body_size(), cotangent_);
    simulator_->Adjoint(cotangent_, /*with_parameters=*/false, &gradient_);
    // The gradient is that of the terminal loss; the effort's is known and does not depend on the dynamics.
    effort_ = EffortWeight(scene_.objective, simulator_->step());
  }

  double Terminal(const Entry& entry) const {
    return entry.of_control() ? gradient_.control[entry.index()] : gradient_.initial[entry.index()];
  }
  double Effort(const Entry& entry) const { return entry.of_control() ? effort_ * control_[entry.index()] : 0.0; }

  // The terminal loss; leaves the end in x_.
  double LossAt(const std::vector<double>& initial, const std::vector<double>& control) {
    EXPECT_TRUE(simulator_->Rollout(initial, control));
    simulator_->GetState(simulator_->num_steps(), x_);
    return TerminalLoss(scene_.objective, x_, simulator_->body_size());
  }

  bool TouchesAsBefore() const {
    return std::ranges::equal(touches_, simulator_->touches(), [](const StepTouch& l, const StepTouch& r) {
      return l.step == r.step && l.touch.candidate == r.touch.candidate && l.touch.mode == r.touch.mode;
    });
  }

  Scene scene_;
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> initial_, control_, x_, cotangent_;
  std::vector<StepTouch> touches_;
  Sensitivity gradient_;
  double effort_ = 0;
};

TEST_P(AdjointOf, IsThePublishedGradient) {
  for (const Entry& entry : GetParam().entries) {
    EXPECT_NEAR(Terminal(entry) + Effort(entry), entry.expected, entry.tolerance) << entry.quantity;
  }
}

TEST_P(AdjointOf, EqualsForwardSensitivity) {
  // In single precision both are rounded in every step.
  const double rounding = GetParam().precision == Precision::kFloat ? 1e-4 : 1e-12;
  for (const Entry& entry : GetParam().entries) {
    std::vector<double> dx(x_.size()), next(x_.size()), du(control_.size());
    if (entry.of_control()) {
      du[entry.index()] = 1;
    } else {
      dx[entry.index() / 4 * simulator_->body_size() + entry.index() % 4] = 1;
    }
    std::vector<double> x(x_.size()), force(2 * simulator_->num_bodies());
    StepLinearization linearization;
    for (int k = 0; k < simulator_->num_steps(); ++k) {
      simulator_->GetState(k, x);
      simulator_->ExpandForce(control_, k, force);
      simulator_->Linearize(x, force, /*with_parameters=*/false, &linearization);
      simulator_->ExpandForce(du, k, force);
      linearization.Apply(dx, force, next);
      dx.swap(next);
    }
    double forward = 0, magnitude = 0;
    for (size_t i = 0; i < dx.size(); ++i) {
      forward += cotangent_[i] * dx[i];
      magnitude += std::abs(cotangent_[i] * dx[i]);
    }
    EXPECT_NEAR(Terminal(entry), forward, rounding * magnitude) << entry.quantity;
  }
}

INSTANTIATE_TEST_SUITE_P(Published, AdjointOf, testing::ValuesIn(PublishedGradients()), NameOf);

// Where the loss has differences: an impact of task 1 is on a node of the grid, and some Jacobians are by their source
// not those of the step.
std::vector<Case> CasesWithDifferences() {
  std::vector<Case> cases = PublishedGradients();
  std::erase_if(cases, [](const Case& c) {
    return c.problem == "bounce_once" || c.precision == Precision::kFloat ||
           FindContactModel(c.contact)->published_jacobian;
  });
  return cases;
}

class DerivativeOf : public AdjointOf {};

TEST_P(DerivativeOf, EqualsDifferencesOfTheLoss) {
  double largest = 0;
  for (const Entry& entry : GetParam().entries) largest = std::max(largest, std::abs(Terminal(entry)));
  int compared = 0;
  for (const Entry& entry : GetParam().entries) {
    constexpr double kWidth = 1e-6;
    double loss[2];
    bool same = true;
    for (const int side : {0, 1}) {
      std::vector<double> initial = initial_, control = control_;
      (entry.of_control() ? control : initial)[entry.index()] += side == 0 ? -kWidth : kWidth;
      loss[side] = LossAt(initial, control);
      same = same && TouchesAsBefore();
    }
    if (!same) continue;
    ++compared;
    // The rounding of a loss of order one after hundreds of steps, over the width.
    EXPECT_NEAR(Terminal(entry), (loss[1] - loss[0]) / (2 * kWidth), 1e-6 * largest + 1e-7) << entry.quantity;
  }
  EXPECT_EQ(compared, static_cast<int>(GetParam().entries.size()));
}

INSTANTIATE_TEST_SUITE_P(Published, DerivativeOf, testing::ValuesIn(CasesWithDifferences()), NameOf);

}  // namespace
}  // namespace saltus
