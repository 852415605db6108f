// Laws of impact: in the limit of the true law the motion is that of `event`, derivatives are those of differences, and
// what is learned from recordings is the law that made them.
#include "saltus/contact/impact_law.h"

#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>

#include <cmath>

#include "identify/learned_contacts.h"
#include "saltus/simulate/learned_contact.h"
#include "saltus/solve/solver.h"
#include "simulate/conformance.h"
#include "simulate/conformance_derivatives.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Kind = Unknown::Kind;

struct Constant {
  template <typename T>
  bool operator()(const T* /*speeds*/, const T* parameters, T* restitution) const {
    restitution[0] = parameters[0];
    return true;
  }
};
ImpactLaw ConstantLaw(double restitution) {
  ImpactLaw law{.name = "constant", .parameters = {restitution}};
  law.function = std::make_shared<ceres::AutoDiffCostFunction<Constant, 1, 2, 1>>(new Constant);
  return law;
}

// e = a / (1 + b v).
struct Softening {
  template <typename T>
  bool operator()(const T* speeds, const T* parameters, T* restitution) const {
    restitution[0] = parameters[0] / (1.0 + parameters[1] * speeds[0]);
    return true;
  }
};
ImpactLaw SofteningLaw(double a, double b) {
  ImpactLaw law{.name = "softening", .parameters = {a, b}};
  law.function = std::make_shared<ceres::AutoDiffCostFunction<Softening, 1, 2, 2>>(new Softening);
  return law;
}
double TrueRestitution(double speed) { return 0.9 / (1 + 0.12 * speed); }

// A network in the middle of learning: no weight is zero.
ImpactLaw Bent(ImpactLaw law) {
  for (std::size_t i = 0; i < law.parameters.size(); ++i) law.parameters[i] += 0.3 * std::sin(1.7 * (i + 1.0));
  return law;
}

// The values of tasks 1 and 2, from closed forms.
TEST(NeuralEvent, WithTheTrueLawIsExact) {
  const LossAndGradient bounce = Evaluate(LearnedContact(ConstantLaw(1)), BounceOffTheGrid());
  EXPECT_NEAR(bounce.loss, 1.199, 1e-12);
  EXPECT_NEAR(bounce.gradient.initial[1], -1, 1e-12);
  EXPECT_NEAR(bounce.gradient.initial[3], -1, 1e-12);
  ExpectExactLaunches([](const Scene&) { return LearnedContact(ConstantLaw(0.92)); });
}

// Networks begin as the constant law: every state and derivative is that of `event` to rounding, resting discs too.
TEST(NeuralEvent, BeginsAsEvent) {
  Scene scene = ProblemScene("ground_wall");
  scene.duration = 3;
  scene.contact = {.restitution = 0.4, .friction = 0.15};
  const LossAndGradient exact = Evaluate("event", scene);
  for (const ImpactLaw& law : {RestitutionNetwork(3, 5, 0.4), ImpulseNetwork(3, 5, 0.4, 0.15)}) {
    const LossAndGradient learned = Evaluate(LearnedContact(law), scene);
    EXPECT_NEAR(learned.loss, exact.loss, 1e-9) << law.name;
    for (int i = 0; i < 4; ++i) EXPECT_NEAR(learned.gradient.initial[i], exact.gradient.initial[i], 1e-8) << law.name;
  }
}

// The model has the properties of every contact model, except for the restitution of the scene.
TEST(NeuralEvent, ConformsAsAContactModel) {
  using namespace conformance;  // NOLINT
  for (const ImpactLaw& law : {Bent(RestitutionNetwork(3, 4, 0.7)), Bent(ImpulseNetwork(3, 4, 0.7, 0.2))}) {
    const Contact contact = LearnedContact(law);
    const Model model{*FindContactModel(contact),
                      [&](const Scene& scene) { return MakeSimulator(contact, scene, Precision::kDouble); },
                      [&](const Scene& scene) { return ReasonNotApplicable(contact, scene); }};
    for (const auto& check : {&CheckFreeFlight,
                              &CheckNeighbours,
                              &CheckMomentum,
                              &CheckSeparation,
                              &CheckOverlap,
                              &CheckFixedDiscs,
                              &CheckDegenerateStates,
                              &CheckGroupsApart}) {
      EXPECT_EQ(check(model), "") << law.name;
    }
    // Whose friction is the scene's, and large enough to stick.
    if (!law.HasFriction()) {
      EXPECT_EQ(CheckSeveralAtOnce(model), "");
    }
    EXPECT_EQ(CheckDerivative(model, FourDiscs(0.3)), "") << law.name;
    EXPECT_EQ(CheckSymmetries(model, FourDiscs(0.3)), "") << law.name;
    EXPECT_EQ(CheckDeterminism(model, FourDiscs(0.3)), "") << law.name;
  }
}

TEST(ImpactLaw, NetworksAreDifferentiated) {
  for (const ImpactLaw& law : {Bent(RestitutionNetwork(4, 3, 0.8)), Bent(ImpulseNetwork(4, 3, 0.8, 0.2))}) {
    const ImpactLawValues at = EvaluateLaw(law, 2.2, 0.7);
    for (std::size_t i = 0; i < law.parameters.size(); ++i) {
      ImpactLaw up = law, down = law;
      up.parameters[i] += 1e-6;
      down.parameters[i] -= 1e-6;
      const ImpactLawValues above = EvaluateLaw(up, 2.2, 0.7), below = EvaluateLaw(down, 2.2, 0.7);
      EXPECT_NEAR(at.restitution_slope[i], (above.restitution - below.restitution) / 2e-6, 1e-9) << i;
      if (!law.HasFriction()) continue;
      EXPECT_NEAR(at.friction_slope[i], (above.friction - below.friction) / 2e-6, 1e-9) << i;
    }
  }
}

TEST(ImpactLaw, MotionIsDifferentiatedByItsParameters) {
  Scene scene = ThrowIntoACorner();
  scene.contact.friction = 0.1;
  Recording recording{"times", {}};
  for (double time = 0.03; time < 1.5; time += 0.047) {
    for (int body = 0; body < 2; ++body) recording.samples.push_back({.time = time, .body = body, .sigma = 1});
  }
  for (const ImpactLaw& law :
       {Bent(RestitutionNetwork(3, 4, 0.7)), Bent(ImpulseNetwork(2, 4, 0.7, 0.1)), SofteningLaw(0.9, 0.1)}) {
    const MotionAtSamples motion = MoveFromStart(scene, recording, law);
    ASSERT_TRUE(motion.ok) << motion.reason;
    ASSERT_GE(motion.touches.size(), 5u);
    bool two_in_a_step = false;
    for (std::size_t i = 1; i < motion.touches.size(); ++i) {
      two_in_a_step = two_in_a_step || motion.touches[i].step == motion.touches[i - 1].step;
    }
    EXPECT_TRUE(two_in_a_step);
    ExpectDerivativesByParameters(motion, scene, recording, law, 1e-5);
  }
}

// Drops of a ball from several heights, with noise of 1 mm, under the softening law.
std::vector<Recording> Drops(const Contact& contact, Scene scene, double noise = 1e-3) {
  std::vector<Recording> recordings;
  GeneratedRandom random(3);
  for (const double height : {0.4, 1.0, 2.0, 3.5}) {
    scene.bodies[0].position = {0, height};
    recordings.push_back(RecordDisc(contact, scene, 2, noise, &random));
  }
  return recordings;
}
Scene DropScene() {
  Scene scene = BallAboveAFloor(1.6, 160, {0.2, 0});
  scene.contact.restitution = 0.5;
  return scene;
}

TEST(Identify, LearnsALawOfImpactFromNoisyRecordings) {
  const std::vector<Recording> recordings = Drops(LearnedContact(SofteningLaw(0.9, 0.12)), DropScene());
  const IdentifyReport network = Identify("event", DropScene(), recordings, {}, {.law = RestitutionNetwork(3, 8, 0.5)});
  ASSERT_EQ(network.verdict, FitVerdict::kFits) << network.reason;
  ASSERT_TRUE(network.law.has_value());
  EXPECT_GE(network.law->impacts, 8);
  ASSERT_FALSE(network.law->curve.empty());
  EXPECT_GT(network.law->curve.back().speed, 2 * network.law->curve.front().speed);
  for (const LawPoint& at : network.law->curve) {
    EXPECT_NEAR(at.restitution, TrueRestitution(at.speed), 4 * at.restitution_error + 2e-3) << at.speed;
    EXPECT_LT(at.restitution_error, 0.05) << at.speed;
  }
  // No constant explains them.
  const IdentifyReport constant = Identify("event", DropScene(), recordings, {{Kind::kRestitution}});
  EXPECT_EQ(constant.verdict, FitVerdict::kContradicted);
}

// The more weights, the longer are the valleys in which they move: however many, the fit is as good as by the law that
// made the recordings.
TEST(Identify, WideNetworksAreLearnedToo) {
  const std::vector<Recording> recordings = Drops(LearnedContact(SofteningLaw(0.9, 0.12)), DropScene());
  const IdentifyReport best = Identify("event", DropScene(), recordings, {}, {.law = SofteningLaw(0.7, 0.02)});
  ASSERT_EQ(best.verdict, FitVerdict::kFits) << best.reason;
  for (const int width : {2, 4, 6}) {
    const IdentifyReport report =
        Identify("event", DropScene(), recordings, {}, {.law = RestitutionNetwork(width, 8, 0.5)});
    ASSERT_TRUE(report.law.has_value()) << report.reason;
    EXPECT_LT(report.cost, 1.04 * best.cost) << width;
    for (const LawPoint& at : report.law->curve) {
      EXPECT_NEAR(at.restitution, TrueRestitution(at.speed), 4 * at.restitution_error + 2e-3) << at.speed;
    }
  }
}

TEST(Identify, LearnsTheParametersOfAUsersLaw) {
  const std::vector<Recording> recordings = Drops(LearnedContact(SofteningLaw(0.9, 0.12)), DropScene(), 1e-4);
  const IdentifyReport report =
      Identify("event", DropScene(), recordings, {{Kind::kGravity, -1, 1}}, {.law = SofteningLaw(0.7, 0.02)});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_NEAR(report.law->law.parameters[0], 0.9, 3e-3);
  EXPECT_NEAR(report.law->law.parameters[1], 0.12, 2e-3);
  ASSERT_EQ(report.estimates.size(), 1u);
  EXPECT_NEAR(report.estimates[0].value, -9.81, 4 * report.estimates[0].standard_error);
}

// The whole impulse: a ball that is thrown along the floor slides at its impacts.
TEST(Identify, LearnsFrictionAndRestitutionTogether) {
  Scene truth = DropScene();
  truth.bodies[0].velocity = {3, 0};
  truth.contact = {.restitution = 0.8, .friction = 0.12};
  const std::vector<Recording> recordings = Drops("event", truth, 2e-4);
  truth.contact = {.restitution = 0.5, .friction = 0.3};
  const IdentifyReport report = Identify("event", truth, recordings, {}, {.law = ImpulseNetwork(2, 8, 0.5, 0.3)});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  for (const LawPoint& at : report.law->curve) {
    EXPECT_NEAR(at.restitution, 0.8, 4 * at.restitution_error + 2e-3) << at.speed;
    EXPECT_NEAR(at.friction, 0.12, 4 * at.friction_error + 2e-3) << at.speed;
  }
}

TEST(ImpactLaw, WhatMakesNoSenseIsRefused) {
  ImpactLaw law = ConstantLaw(0.5);
  law.parameters = {0.5, 0.1};
  EXPECT_THAT(Validate(law), HasSubstr("expected 2 speeds and 2 parameters"));
  EXPECT_THAT(Validate(ConstantLaw(1.5)), HasSubstr("found no restitution in [0, 1]"));
  EXPECT_THAT(Validate(ImpactLaw{}), HasSubstr("found no function"));
  law = ConstantLaw(0.5);
  law.learned_last = 2;
  EXPECT_THAT(Validate(law), HasSubstr("learned_last"));
  EXPECT_EQ(Validate(ConstantLaw(0.5)), "");
  const std::vector<Recording> recordings = Drops("event", DropScene());
  const auto reason = [&](const Contact& contact, const std::vector<Unknown>& unknowns) {
    const IdentifyReport report =
        Identify(contact, DropScene(), recordings, unknowns, {.law = RestitutionNetwork(2, 5, 0.5)});
    EXPECT_EQ(report.verdict, FitVerdict::kNotApplicable);
    return report.reason;
  };
  EXPECT_THAT(reason("direct", {}), HasSubstr("expected event"));
  EXPECT_THAT(reason("event", {{Kind::kRestitution}}), HasSubstr("'restitution' beside a law of impact"));
  EXPECT_THAT(reason("event", {{Kind::kStiffness}}), HasSubstr("does not read it"));
}

// Solvers along a sequence of impacts know Newton's restitution; those on rollouts take a law as any contact model.
TEST(NeuralEvent, GoesWhereRolloutsDo) {
  const Contact contact = LearnedContact(SofteningLaw(0.95, 0.02));
  const Scene scene = ProblemScene("ground_wall");
  const SolveReport report = Solve("ceres_lm", {.scene = scene, .contact = contact}, {});
  ASSERT_FALSE(report.history.losses.empty()) << report.reason;
  EXPECT_LT(report.history.losses.back(), 1e-6 * report.history.losses.front());
  const Scene strike = ProblemScene("two_balls");
  EXPECT_THAT(Solve("ceres_event", {.scene = strike, .contact = contact}, {}).reason,
              HasSubstr("requires exact impacts"));
}

// A law without a value at the speed of an impact fails the step, and says so.
TEST(NeuralEvent, FailsWhereTheLawHasNoValue) {
  const auto simulator = MakeSimulator(LearnedContact(SofteningLaw(0.9, -0.05)), DropScene(), Precision::kDouble);
  EXPECT_FALSE(simulator->Rollout(InitialState(DropScene()), InitialControl(DropScene(), 160)));
  EXPECT_THAT(simulator->FailureReason(), HasSubstr("the law of impact gives no restitution"));
}

}  // namespace
}  // namespace saltus
