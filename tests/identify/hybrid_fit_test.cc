// Parameters and initial states of hybrid systems from measurements, beside closed forms of a bouncing ball.
#include "saltus/identify/hybrid_fit.h"

#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "identify/generated_problem.h"

namespace saltus {
namespace {

using testing::HasSubstr;

struct Ball {
  static constexpr int kNumControls = 0, kNumParameters = 2;  // g; restitution
  static constexpr std::array kStateSizes = {2}, kNumGuards = {1};
  static constexpr std::array<const char*, 1> kGuardNames = {"ground"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -p[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* after) const {
    after[0] = x[0];
    after[1] = -p[1] * x[1];
    return 0;
  }
};

// The first number of what a term reads, less a value, over its sigma.
struct Miss {
  double value, sigma;
  template <typename T>
  bool operator()(const T* read, T* residual) const {
    residual[0] = (read[0] - value) / sigma;
    return true;
  }
};

constexpr double kGravity = 9.6, kRestitution = 0.72, kSigma = 2e-3, kDuration = 1.5;
constexpr int kIntervals = 30;

double HeightAt(double time, double height) {
  Scene scene;
  scene.gravity = {0, -kGravity};
  scene.contact.restitution = kRestitution;
  scene.bodies = {{.name = "ball", .radius = 0, .position = {0, height}}};
  return BouncingBallAt(time, scene)[1];
}

// A ball that falls from rest, measured at the beginnings of 30 intervals but the first.
HybridExperiment Experiment(double height, int seed) {
  GeneratedRandom random(seed);
  HybridProblem problem{
      .system = HybridSystem(Ball()),
      .guess = {.initial = {1.1, 0}, .parameters = {9, 0.8}, .duration = kDuration, .num_intervals = kIntervals}};
  HybridExperiment experiment{.name = "ball " + std::to_string(seed), .problem = problem, .data = {}};
  for (int k = 1; k < kIntervals; ++k) {
    const double time = k * kDuration / kIntervals, value = HeightAt(time, height) + kSigma * random.Normal();
    HybridTerm term{.name = "height", .at = HybridTerm::Timing::kEachInterval, .interval = k, .with_state = true};
    term.function = std::make_shared<ceres::AutoDiffCostFunction<Miss, 1, 2>>(new Miss{value, kSigma});
    experiment.problem.terms.push_back(term);
    experiment.data.push_back({"y", time, value, kSigma});
  }
  return experiment;
}

const HybridUnknown kG{.name = "g", .index = 0, .min = 0}, kE{.name = "e", .index = 1, .min = 0, .max = 1};

void ExpectNear(const Estimate& estimate, double truth) {
  EXPECT_EQ(estimate.determination, Determination::kDetermined) << estimate.name;
  EXPECT_GT(estimate.standard_error, 0) << estimate.name;
  EXPECT_LT(estimate.standard_error, 0.01 * truth) << estimate.name;
  EXPECT_NEAR(estimate.value, truth, 4 * estimate.standard_error) << estimate.name;
}

TEST(HybridFit, FindsCommonAndOwnNumbers) {
  const std::vector<HybridExperiment> experiments = {Experiment(1, 1), Experiment(1.3, 2)};
  const HybridUnknown first{.name = "first", .is_initial = true, .experiment = 0};
  const HybridUnknown second{.name = "second", .is_initial = true, .experiment = 1};
  const IdentifyReport report = Identify(experiments, {kG, first, kE, second});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  const double truths[] = {kGravity, 1, kRestitution, 1.3};
  ASSERT_EQ(report.estimates.size(), 4u);
  for (std::size_t u = 0; u < 4; ++u) ExpectNear(report.estimates[u], truths[u]);
  EXPECT_EQ(report.residuals.size(), 58u);
  EXPECT_THAT(report.recordings, testing::ElementsAre("ball 1", "ball 2"));
  EXPECT_THAT(report.quantities, testing::ElementsAre("y"));
  EXPECT_THAT(report.sigmas, testing::IsEmpty());
}

// The two intervals of a fit hold together; so the share of 50 fits has a standard deviation of 3 %.
TEST(HybridFit, IntervalsHold) {
  int held = 0, intervals = 0;
  for (int seed = 1; seed <= 50; ++seed) {
    const IdentifyReport report = Identify({Experiment(1.1, seed)}, {kG, kE});
    for (const auto& [u, truth] : {std::pair{0, kGravity}, {1, kRestitution}}) {
      const Estimate& estimate = report.estimates[u];
      ++intervals;
      held += estimate.low <= truth && truth <= estimate.high;
    }
  }
  EXPECT_GE(held, 0.85 * intervals);
  EXPECT_LT(held, intervals);
}

TEST(HybridFit, EstimatesTheScatterOfEachQuantity) {
  HybridExperiment experiment = Experiment(1.1, 3);
  const double far = 1e3;  // of another unit, in which sigma is larger
  for (int k = 1; k < kIntervals; k += 2) {
    HybridDatum& datum = experiment.data[k - 1];
    datum.quantity = "y, mm";
    datum.value *= far;
    datum.sigma *= far;
  }
  for (HybridDatum& datum : experiment.data) datum.states_sigma = false;
  const IdentifyReport report = Identify({experiment}, {kG, kE});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_THAT(report.quantities, testing::ElementsAre("y, mm", "y"));
  ASSERT_EQ(report.sigmas.size(), 2u);
  EXPECT_NEAR(report.sigmas[0], far * kSigma, 0.4 * far * kSigma);
  EXPECT_NEAR(report.sigmas[1], kSigma, 0.4 * kSigma);
  ExpectNear(report.estimates[0], kGravity);
  ExpectNear(report.estimates[1], kRestitution);
}

// The mode is asked for anew with every input.
TEST(HybridFit, BeginsInTheModeOfTheInput) {
  HybridExperiment experiment = Experiment(1.1, 4);
  experiment.begin = [](HybridInput* input) {
    input->mode = 0;
    return input->parameters[1] > 0.9 ? "too elastic" : "";
  };
  experiment.problem.guess.parameters[1] = 0.95;
  const IdentifyReport report = Identify({experiment}, {kG, kE});
  EXPECT_EQ(report.verdict, FitVerdict::kFits) << report.reason;  // from another start
  ExpectNear(report.estimates[1], kRestitution);
}

TEST(HybridFit, WhatMakesNoSenseIsRefused) {
  const auto reason = [](const std::vector<HybridExperiment>& experiments, const std::vector<HybridUnknown>& unknowns) {
    const IdentifyReport report = Identify(experiments, unknowns);
    EXPECT_EQ(report.verdict, FitVerdict::kNotApplicable);
    return report.reason;
  };
  const HybridExperiment good = Experiment(1.1, 5);
  const auto changed = [&](const auto& change) {
    HybridExperiment bad = good;
    change(&bad);
    return std::vector{bad};
  };
  EXPECT_THAT(reason({}, {kE}), HasSubstr("found no experiments"));
  EXPECT_THAT(reason({good}, {}), HasSubstr("found nothing that is unknown"));
  EXPECT_THAT(reason({good}, {kE, kE}), HasSubstr("ball 5: found number 1 of the parameters twice"));
  HybridUnknown wrong = kE;
  wrong.index = 2;
  EXPECT_THAT(reason({good}, {wrong}), HasSubstr("ball 5: found number 2 of the parameters, expected 0 to 1"));
  wrong = kE;
  wrong.experiment = 1;
  EXPECT_THAT(reason({good}, {wrong}), HasSubstr("e: found experiment 1, expected one of 1"));
  wrong = kE;
  wrong.min = 0.9;
  EXPECT_THAT(reason({good}, {wrong}), HasSubstr("e: found the start 0.8 with the bounds 0.9 and 1"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->data.pop_back(); }), {kE}),
              HasSubstr("ball 5: found 28 numbers, expected 29"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->data.clear(); }), {kE}), HasSubstr("found no data"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->data[3].states_sigma = false; }), {kE}),
              HasSubstr("found sigma of some numbers only"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->data[3].sigma = 0; }), {kE}),
              HasSubstr("y: found a number that is not finite or a sigma that is not positive"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->problem.terms[0].interval = -1; }), {kE}),
              HasSubstr("height: found a term that is a constraint or counts at several places"));
  EXPECT_THAT(reason(changed([](HybridExperiment* bad) { bad->problem.terms[0].mode = 0; }), {kE}),
              HasSubstr("height: found a term that counts in some modes only"));
}

}  // namespace
}  // namespace saltus
