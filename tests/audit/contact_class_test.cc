// How models make contact, recognised from what they do. What they are is what their headers and sources say.
#include "saltus/audit/contact_class.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr auto kBoundary = ContactClass::kImpulseAtStepBoundary;
constexpr auto kResolved = ContactClass::kImpactTimeResolved;

Scene WithFriction() {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  return scene;
}

std::vector<Scene> Tasks() {
  return {ProblemScene("bounce_once"), ProblemScene("ground_wall"), WithFriction(), ProblemScene("two_balls")};
}

// Independent of task: those whose law has neither damping nor a jump that only some scenes bring out.
TEST(ContactClass, IsWhatTheFormulationSays) {
  const std::map<std::string, ContactClass> classes = {{"convex", kBoundary},
                                                       {"convex_toi", kResolved},
                                                       {"direct", kBoundary},
                                                       {"direct_toi", kResolved},
                                                       {"compliant_brax", kBoundary},
                                                       {"pbd_warp", ContactClass::kProjection},
                                                       {"pbd_brax", ContactClass::kProjection},
                                                       {"toi_velocity", kResolved},
                                                       {"event", kResolved},
                                                       {"lcp_kkt", kBoundary},
                                                       {"lcp_pgs", ContactClass::kDepthFeedback},
                                                       {"lcp_pgs_adjoint", ContactClass::kDepthFeedback},
                                                       {"ncp", ContactClass::kNoRestitution},
                                                       {"ncp_restitution", kBoundary},
                                                       {"qcqp", kBoundary},
                                                       {"smooth_compliant", ContactClass::kContinuousForce},
                                                       {"ipc_barrier", ContactClass::kContinuousForce},
                                                       {"xpbd", ContactClass::kProjection},
                                                       {"position_qp", ContactClass::kNoRestitution},
                                                       {"primal_descent", ContactClass::kContinuousForce},
                                                       {"dual_descent", ContactClass::kContinuousForce},
                                                       {"static_lcp", ContactClass::kNoRestitution}};
  for (const auto& [contact, expected] : classes) {
    ASSERT_NE(FindContactModel(contact), nullptr) << contact;
    for (const Scene& scene : Tasks()) {
      if (!ReasonNotApplicable(contact, scene).empty()) continue;
      const ContactRecognition found = RecogniseContact(contact, scene);
      EXPECT_STREQ(ContactClassToString(found.contact_class), ContactClassToString(expected))
          << contact << " in " << scene.name << ": " << found.words;
    }
  }
}

// The class follows the law, under whatever name it goes.
TEST(ContactClass, OptionsThatChangeTheLawChangeTheClass) {
  const Scene scene = ProblemScene("two_balls");
  const auto class_of = [&](const char* contact) {
    return ContactClassToString(RecogniseContact(contact, scene).contact_class);
  };
  EXPECT_STREQ(class_of("lcp_pgs:erp=0"), "impulse at a step boundary");
  EXPECT_STREQ(class_of("lcp_pgs:erp=0.02"), "depth feedback");
  // The velocity pass leaves the rest of an overlap that is hardly corrected.
  EXPECT_STREQ(class_of("xpbd:compliance=1e-4"), "impulse at a step boundary");
  EXPECT_STREQ(class_of("soft_convex:damping=200"), "no restitution");
  EXPECT_STREQ(class_of("soft_convex:dmin=1e-4:width=0.01"), "continuous force");
  EXPECT_STREQ(class_of("smooth_compliant:exponent=1"), "continuous force");
  EXPECT_STREQ(class_of("ipc_barrier:trapezoidal=1"), "continuous force");
  EXPECT_STREQ(class_of("position_qp:restitution=1"), "projection");
}

// One model under scenes that let its law jump or not: the class is a property of the contact in simulation.
TEST(ContactClass, ADamperMakesASpringJump) {
  Scene scene = ProblemScene("bounce_once");
  const ContactRecognition spring = RecogniseContact("compliant_warp", scene);
  EXPECT_EQ(spring.contact_class, ContactClass::kContinuousForce) << spring.words;
  EXPECT_NEAR(*spring.onset_order, 2, 0.2);
  scene.contact.damping = 5;
  const ContactRecognition damped = RecogniseContact("compliant_warp", scene);
  EXPECT_EQ(damped.contact_class, ContactClass::kForceWithJump) << damped.words;
  EXPECT_NEAR(*damped.onset_order, 1, 0.2);
}

// Without a force or damping there is nothing that jumps.
TEST(ContactClass, AForceFedThroughTheContactJumps) {
  EXPECT_EQ(RecogniseContact("soft_convex", ProblemScene("bounce_once")).contact_class, ContactClass::kContinuousForce);
  for (const char* problem : {"ground_wall", "two_balls"}) {
    const ContactRecognition found = RecogniseContact("soft_convex", ProblemScene(problem));
    EXPECT_EQ(found.contact_class, ContactClass::kForceWithJump) << problem << found.words;
  }
}

TEST(ContactClass, TheEvidenceIsThatOfTheLaw) {
  const Scene scene = ProblemScene("ground_wall");
  const ContactRecognition feedback = RecogniseContact("lcp_pgs", scene);
  EXPECT_NEAR(*feedback.velocity_from_position, -0.1, 1e-3);  // the part of an overlap that it corrects
  const ContactRecognition exact = RecogniseContact("event", scene);
  EXPECT_NEAR(*exact.position_from_position, -0.92, 1e-3);
  EXPECT_NEAR(*exact.finer_rebound, 0.92, 1e-2);
  EXPECT_EQ(exact.step, 74);
  EXPECT_EQ(exact.b, "ground");
  const ContactRecognition squared = RecogniseContact("pbd_brax", scene);
  EXPECT_NEAR(*squared.rebound, 0.92 * 0.92, 1e-2);
}

// A barrier that is plastic at coarse steps is not at fine ones.
TEST(ContactClass, LostEnergyOfCoarseStepsIsNoClass) {
  Scene scene = ProblemScene("bounce_once");
  scene.steps = 60;
  const ContactRecognition found = RecogniseContact("ipc_barrier", scene);
  EXPECT_LT(*found.rebound, 0.4);
  EXPECT_EQ(found.contact_class, ContactClass::kContinuousForce) << found.words;
}

// The published Jacobian of two discs is that of half the restitution, which is none of the classes.
TEST(ContactClass, WhatFitsNoClassIsUnclear) {
  const ContactRecognition found = RecogniseContact("lcp", ProblemScene("two_balls"));
  EXPECT_EQ(found.contact_class, ContactClass::kUnclear);
  EXPECT_NEAR(*found.position_from_position, -0.5, 1e-3);
  Scene apart = ProblemScene("bounce_once");
  apart.duration = 0.1;
  EXPECT_THAT(RecogniseContact("direct", apart).words, HasSubstr("no two bodies meet"));
}

// A ball that strikes a row comes to rest although the restitution is 1. A later contact tells.
TEST(ContactClass, ContactsOfSeveralAtOnceAreNotJudged) {
  Scene scene = ProblemScene("two_balls");
  scene.control = {};
  scene.bodies[0].position = {-1, 0};
  scene.bodies[0].velocity = {4, 0};
  scene.bodies[1].position = {0, 0};
  scene.bodies.push_back(scene.bodies[1]);
  scene.bodies[2].name = "third";
  scene.bodies[2].position = {0.4, 0};
  const ContactRecognition row = RecogniseContact("event", scene);
  EXPECT_EQ(row.contact_class, ContactClass::kUnclear) << row.words;
  scene.planes = {{"wall", {1.2, 0}, {-1, 0}}};
  const ContactRecognition wall = RecogniseContact("event", scene);
  EXPECT_EQ(wall.contact_class, kResolved) << wall.words;
  EXPECT_EQ(wall.b, "wall");
}

TEST(ContactClass, StepsOfOtherLengthsGiveTheSame) {
  for (const double times : {0.1, 8.0}) {
    Scene scene = ProblemScene("two_balls");
    scene.steps = static_cast<int>(scene.steps * times);
    EXPECT_EQ(RecogniseContact("qcqp", scene).contact_class, kBoundary) << times;
    EXPECT_EQ(RecogniseContact("direct_toi", scene).contact_class, kResolved) << times;
    EXPECT_EQ(RecogniseContact("lcp_pgs", scene).contact_class, ContactClass::kDepthFeedback) << times;
    EXPECT_EQ(RecogniseContact("smooth_compliant", scene).contact_class, ContactClass::kContinuousForce) << times;
    EXPECT_EQ(RecogniseContact("soft_convex", scene).contact_class, ContactClass::kForceWithJump) << times;
  }
}

}  // namespace
}  // namespace saltus
