// Event functions that are learned: with the true functions the motion and its gradients are those of `event`;
// derivatives by their parameters; what is learned from recordings, exact and noisy.
#include "saltus/contact/event_functions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "identify/learned_contacts.h"
#include "saltus/simulate/learned_contact.h"
#include "simulate/conformance.h"
#include "simulate/conformance_derivatives.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Kind = Unknown::Kind;

// The values of tasks 1 and 2, from closed forms.
TEST(EventFunctions, TrueOnesAreExact) {
  Scene bounce = BounceOffTheGrid();
  for (const EventFunctions& events : {AffineEvents(bounce), ProfileEvents(bounce, 3)}) {
    const LossAndGradient at = Evaluate(LearnedContact(events), bounce);
    // A profile begins with a restitution of 0.999 at most.
    const double e = events.name == "affine events" ? 1 : 0.999;
    bounce.contact.restitution = e;
    const LossAndGradient exact = Evaluate("event", bounce);
    bounce.contact.restitution = 1;
    EXPECT_NEAR(at.loss, exact.loss, 1e-12) << events.name;
    EXPECT_NEAR(at.gradient.initial[1], exact.gradient.initial[1], 1e-12);
    EXPECT_NEAR(at.gradient.initial[3], exact.gradient.initial[3], 1e-12);
    if (e == 1) {
      EXPECT_NEAR(at.loss, 1.199, 1e-12);
    }
  }
  ExpectExactLaunches([](const Scene& scene) { return LearnedContact(ProfileEvents(scene, 2)); });
}

// True event functions give the results of `event` to rounding: states and gradients, with impacts between discs.
TEST(EventFunctions, TrueOnesAreEvent) {
  for (const Scene& scene : {ThrowIntoACorner(), ProblemScene("two_balls")}) {
    const LossAndGradient exact = Evaluate("event", scene);
    for (const EventFunctions& events : {AffineEvents(scene), ProfileEvents(scene, 3)}) {
      const LossAndGradient learned = Evaluate(LearnedContact(events), scene);
      EXPECT_NEAR(learned.loss, exact.loss, 1e-10 * (1 + exact.loss)) << events.name;
      for (std::size_t i = 0; i < exact.gradient.initial.size(); ++i) {
        EXPECT_NEAR(learned.gradient.initial[i], exact.gradient.initial[i], 1e-8) << events.name << " " << i;
      }
      for (std::size_t i = 0; i < exact.gradient.control.size(); ++i) {
        EXPECT_NEAR(learned.gradient.control[i], exact.gradient.control[i], 1e-10) << events.name << " " << i;
      }
    }
  }
}

// The model has the properties of every contact model, for contacts that do not last.
TEST(EventFunctions, ConformAsAContactModel) {
  using namespace conformance;  // NOLINT
  const auto contact = [](const Scene& scene) { return LearnedContact(ProfileEvents(scene, 2)); };
  const Model model{*FindContactModel(contact(Scene())),
                    [&](const Scene& scene) { return MakeSimulator(contact(scene), scene, Precision::kDouble); },
                    [&](const Scene& scene) { return ReasonNotApplicable(contact(scene), scene); }};
  for (const auto& check :
       {&CheckFreeFlight, &CheckNeighbours, &CheckMomentum, &CheckSeparation, &CheckFixedDiscs, &CheckGroupsApart}) {
    EXPECT_EQ(check(model), "");
  }
  EXPECT_EQ(CheckDerivative(model, FourDiscs(0.3)), "");
  EXPECT_EQ(CheckSymmetries(model, FourDiscs(0.3)), "");
  EXPECT_EQ(CheckDeterminism(model, FourDiscs(0.3)), "");
}

// Task 2, with friction.
Scene ThrowScene() {
  Scene scene = ProblemScene("ground_wall");
  scene.steps = 60;
  scene.contact.friction = 0.1;
  return scene;
}

// Functions in the middle of learning: no parameter has its first value.
EventFunctions Bent(EventFunctions events) {
  for (std::size_t i = 0; i < events.parameters.size(); ++i) events.parameters[i] += 0.03 * std::sin(1.7 * (i + 1.0));
  return events;
}

TEST(EventFunctions, MotionIsDifferentiatedByTheirParameters) {
  const Scene scene = ThrowScene();
  Recording recording{"times", {}};
  for (double time = 0.03; time < 0.6; time += 0.0471) recording.samples.push_back({.time = time, .sigma = 1});
  for (const EventFunctions& events : {Bent(AffineEvents(scene)), Bent(ProfileEvents(scene, 2))}) {
    const MotionAtSamples motion = MoveFromStart(scene, recording, events);
    ASSERT_TRUE(motion.ok) << motion.reason;
    ASSERT_GE(motion.touches.size(), 2u);
    ExpectDerivativesByParameters(motion, scene, recording, events, 1e-6);
  }
}

// Throws that slide at every impact, as A cannot stick; 12 samples each.
std::vector<Recording> Throws(const Contact& contact, Scene scene, double noise) {
  std::vector<Recording> recordings;
  GeneratedRandom random(4);
  for (int number = 0; number < 12; ++number) {
    scene.bodies[0].position = {random.Uniform(-0.5, 0.2), random.Uniform(0.7, 1.1)};
    scene.bodies[0].velocity = {random.Uniform(4, 6), random.Uniform(-6, -4)};
    recordings.push_back(RecordDisc(contact, scene, 5, noise, &random));
  }
  return recordings;
}

// Exact data determine normals and distances; for the ground also the ratio by which it keeps the tangential velocity,
// 1 - mu (1 + e) of ... along it: mu (1 + e) = 0.192.
TEST(Identify, AffineEventsAreRecovered) {
  const Scene truth = ThrowScene();
  const std::vector<Recording> recordings = Throws("event", truth, 0);
  Scene guess = truth;
  guess.contact.restitution = 0.8;
  guess.contact.friction = 0;
  guess.planes[0] = {"ground", {0, 0.02}, Vec2d(0.02, 1).normalized()};
  guess.planes[1] = {"wall", {1.72, 0}, Vec2d(-1, 0.015).normalized()};
  const IdentifyReport report = Identify("event", guess, recordings, {}, {.events = AffineEvents(guess)});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  const std::vector<double>& w = report.events->functions.parameters;
  const auto normal = [&](int first) { return Vec2d(w[first], w[first + 1]).normalized(); };
  EXPECT_NEAR((normal(0) - Vec2d(0, 1)).norm(), 0, 1e-4);
  EXPECT_NEAR(w[2], 0, 1e-4);
  EXPECT_NEAR((normal(7) - Vec2d(-1, 0)).norm(), 0, 1e-4);
  EXPECT_NEAR(w[9], -1.75, 1e-4);
  EXPECT_NEAR(w[3], 1, 1e-3);
  EXPECT_NEAR(w[4], 0.192, 1e-3);
  EXPECT_NEAR(w[5], 0, 1e-3);
  EXPECT_NEAR(w[6], -0.92, 1e-3);
  ASSERT_GE(report.events->impacts.size(), 20u);
  for (const LearnedImpact& impact : report.events->impacts) {
    const Vec2d n = impact.plane == 0 ? Vec2d(0, 1) : Vec2d(-1, 0);
    EXPECT_NEAR((impact.normal - n).norm(), 0, 1e-4);  // right events could have a wrong gradient
    EXPECT_NEAR(-impact.after.dot(n) / impact.before.dot(n), 0.92, 1e-3);
  }
  // Beside it, on a throw that was not learned from, all is as with `event`.
  Scene other = ProblemScene("ground_wall");
  other.contact.friction = 0.1;
  const LossAndGradient exact = Evaluate("event", other),
                        learned = Evaluate(LearnedContact(report.events->functions), other);
  EXPECT_NEAR(learned.loss, exact.loss, 1e-2);
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(learned.gradient.initial[i], exact.gradient.initial[i], 1e-2) << i;
}

// A floor with a bump, from noisy throws, that no flat plane explains.
TEST(Identify, LearnsASurfaceThatIsNotFlat) {
  Scene scene = BallAboveAFloor(1.2, 120, {1, 0});
  scene.contact.restitution = 0.8;
  EventFunctions truth = ProfileEvents(scene, 2);
  // h = 0.02 (tanh(3 s + 1.5) - tanh(3 s - 1.5)), s in lengths of the scene: 0.04 tanh(1.5) high.
  std::copy_n(std::begin({3.0, 1.5, 3.0, -1.5, 0.02, -0.02}), 6, truth.parameters.begin());
  std::vector<Recording> recordings;
  GeneratedRandom random(5);
  constexpr double kNoise = 5e-4;
  for (int number = 0; number < 12; ++number) {
    scene.bodies[0].position = {random.Uniform(-1.5, 0.5), random.Uniform(0.6, 1.2)};
    scene.bodies[0].velocity = {random.Uniform(-0.5, 1.5), 0};
    recordings.push_back(RecordDisc(LearnedContact(truth), scene, 2, kNoise, &random));
  }
  scene.contact.restitution = 0.7;
  const IdentifyReport report = Identify("event", scene, recordings, {}, {.events = ProfileEvents(scene, 3)});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_LT(report.misfit, 1.1);
  double highest = 0;
  for (const LearnedImpact& at : report.events->impacts) {
    const EventValues true_event = EvaluateEvents(truth, 0, at.position, at.before, 0.05);
    EXPECT_NEAR(true_event.value, 0, 2e-3) << at.position[0];
    EXPECT_NEAR((at.normal - true_event.normal).norm(), 0, 0.02) << at.position[0];
    highest = std::max(highest, at.scene_gap);
  }
  EXPECT_GT(highest, 0.02);
  const IdentifyReport flat = Identify("event", scene, recordings, {{Kind::kRestitution}});
  EXPECT_NE(flat.verdict, FitVerdict::kFits);
}

TEST(EventFunctions, WhatMakesNoSenseIsRefused) {
  const Scene scene = ThrowScene();
  EventFunctions events = AffineEvents(scene);
  EXPECT_EQ(Validate(events, scene), "");
  events.planes.pop_back();
  EXPECT_THAT(Validate(events, scene), HasSubstr("functions of 1 planes, expected of 2"));
  events = AffineEvents(scene);
  events.parameters.push_back(1);
  EXPECT_THAT(Validate(events, scene), HasSubstr("expected 5 of a disc and 15 parameters"));
  events = AffineEvents(scene);
  std::swap(events.planes[0].event, events.planes[0].update);
  EXPECT_THAT(Validate(events, scene), HasSubstr("found 2 residuals"));
  const std::vector<Recording> recordings = Throws("event", scene, 1e-3);
  const auto reason = [&](const Contact& contact, const std::vector<Unknown>& unknowns, bool law) {
    IdentifyOptions options{.events = AffineEvents(scene)};
    if (law) options.law = RestitutionNetwork(2, 5, 0.5);
    const IdentifyReport report = Identify(contact, scene, recordings, unknowns, options);
    EXPECT_EQ(report.verdict, FitVerdict::kNotApplicable);
    return report.reason;
  };
  EXPECT_THAT(reason("lcp", {}, false), HasSubstr("expected event"));
  EXPECT_THAT(reason("event", {{Kind::kRestitution}}, false), HasSubstr("beside event functions, which determine it"));
  EXPECT_THAT(reason("event", {}, true), HasSubstr("expected one of them"));
}

// A ball that comes to rest: contacts that last have no event.
TEST(EventFunctions, KnowNoContactsThatLast) {
  Scene scene = ProblemScene("bounce_once");
  scene.gravity = {0, -9.81};
  scene.contact.restitution = 0.3;
  scene.duration = 5;
  const auto simulator = MakeSimulator(LearnedContact(AffineEvents(scene)), scene, Precision::kDouble);
  EXPECT_FALSE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())));
  EXPECT_THAT(simulator->FailureReason(), HasSubstr("do not support sustained contacts"));
}

}  // namespace
}  // namespace saltus
