// Restitution and friction of each pair of materials, in all contact models: against scenes with one of both, against
// closed forms of impacts, and their derivatives against differences.
#include "saltus/scene/materials.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "saltus/contact/impact_law.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/force_model.h"
#include "saltus/simulate/learned_contact.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Kind = SceneParameter::Kind;

constexpr double kRestitution[] = {0.9, 0.5, 0.7};

// Three discs far apart, each of which meets something once: rubber a floor of steel, wood one of wood, and steel a
// fixed disc of wood. The pairs have three restitutions and, if `rough`, three coefficients of friction.
Scene ThreePairs(bool rough, int steps = 240) {
  Scene scene;
  scene.name = "three_pairs";
  scene.duration = 0.5;
  scene.steps = steps;
  const double mu = rough ? 1 : 0;
  scene.materials = {{"rubber", {1, 0.8 * mu}}, {"steel", {0.4, 0.2 * mu}}, {"wood", {0.3, 0.1 * mu}}};
  scene.pairs = {
      {0, 1, kRestitution[0], 0.3 * mu}, {2, 2, kRestitution[1], std::nullopt}, {2, 1, kRestitution[2], 0.05 * mu}};
  scene.bodies = {
      {.name = "a", .radius = 0.2, .mass = 1.5, .position = {0, 0.5}, .velocity = {0.8, -2}, .material = 0},
      {.name = "b", .radius = 0.2, .mass = 0.7, .position = {40, 0.5}, .velocity = {0.9, -2}, .material = 2},
      {.name = "c", .radius = 0.3, .mass = 3, .position = {80, 2}, .velocity = {2, 0.1}, .material = 1},
      {.name = "d", .radius = 0.2, .fixed = true, .position = {80.9, 2.1}, .material = 2}};
  scene.segments = {{"floor", {-5, 0}, {5, 0}, 1}, {"wooden", {35, 0}, {45, 0}, 2}};
  return scene;
}
constexpr int kPairs[] = {4, 9, 8};  // by disc: MaterialPairIndex() of (1, 2), (3, 3), (2, 3)

// Returns the scene without materials, with the numbers of one pair.
Scene OnePair(Scene scene, int pair) {
  const PairContact contact = PairContactsOf(scene)[pair];
  scene.contact.restitution = contact.restitution;
  scene.contact.friction = contact.friction;
  scene.materials.clear();
  scene.pairs.clear();
  for (Body& body : scene.bodies) body.material = -1;
  for (Plane& plane : scene.planes) plane.material = -1;
  for (EdgeSegment& segment : scene.segments) segment.material = -1;
  return scene;
}

struct Rollout {
  std::unique_ptr<Simulator> simulator;
  std::vector<double> end;

  Rollout(const Contact& contact, const Scene& scene)
      : simulator(MakeSimulator(contact, scene, Precision::kDouble)), end(simulator->state_size()) {
    EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())))
        << contact.name() << ": " << simulator->FailureReason();
    simulator->GetState(simulator->num_steps(), end);
  }
  Vec2d Velocity(int body) const {
    const double* at = &end[static_cast<std::size_t>(body) * simulator->body_size() + 2];
    return {at[0], at[1]};
  }
  // The derivatives of a weighted sum of the final state of some disc, or of all of them.
  Sensitivity Gradient(int body = -1) const {
    std::vector<double> cotangent(end.size(), 0.0);
    const int size = simulator->body_size();
    for (int i = 0; i < static_cast<int>(end.size()); ++i) {
      if (body < 0 || i / size == body) cotangent[i] = i % size < 4 ? 1 + 0.3 * (i % size) : 0.0;
    }
    Sensitivity gradient;
    simulator->Adjoint(cotangent, /*with_parameters=*/true, &gradient);
    return gradient;
  }
  double Loss() const {
    double loss = 0;
    const int size = simulator->body_size();
    for (int i = 0; i < static_cast<int>(end.size()); ++i) loss += i % size < 4 ? (1 + 0.3 * (i % size)) * end[i] : 0.0;
    return loss;
  }
};

// Each contact has the numbers of its pair: discs that meet nothing in common move as in a scene where all contacts
// have those of their pair, to the last bit, and so do the derivatives. Models whose forces reach everything couple
// the three.
TEST(Materials, EachPairIsThatOfASceneWithoutMaterials) {
  int models = 0;
  for (const ModelTraits& model : AllContactModels()) {
    const Contact contact(model.name);
    const bool couples = std::isinf(model.push_gap);  // which takes many contacts in each step
    Scene scene = ThreePairs(true, couples ? 24 : 240);
    if (!ReasonNotApplicable(contact, scene).empty()) scene = ThreePairs(false);
    const bool of_planes = !ReasonNotApplicable(contact, scene).empty();  // it takes no walls that end
    if (of_planes) {
      scene = ThreePairs(true);
      scene.segments.clear();
      scene.planes = {{"floor", {0, 0}, {0, 1}, 1}};
    }
    if (!ReasonNotApplicable(contact, scene).empty()) {
      ADD_FAILURE() << model.name << ": " << ReasonNotApplicable(contact, scene);
      continue;
    }
    ++models;
    const Rollout all(contact, scene);
    for (int disc = 0; disc < 3; ++disc) {
      const int pair_of_disc = of_planes && disc == 1 ? kPairs[2] : kPairs[disc];
      const Rollout one(contact, OnePair(scene, pair_of_disc));
      const int size = all.simulator->body_size();
      for (int i = disc * size; i < (disc + 1) * size; ++i) {
        if (couples) {
          EXPECT_NEAR(all.end[i], one.end[i], 1e-6) << model.name << " " << i;
        } else {
          EXPECT_EQ(all.end[i], one.end[i]) << model.name << " " << i;
        }
      }
      if (couples) continue;
      const Sensitivity gradient = all.Gradient(disc), expected = one.Gradient(disc);
      EXPECT_EQ(gradient.initial, expected.initial) << model.name;
      for (int pair = 0; pair < 10; ++pair) {
        const PairConstants<double>& by = gradient.parameters.pairs[pair];
        const bool own = pair == pair_of_disc;
        EXPECT_EQ(by.restitution, own ? expected.parameters.restitution : 0) << model.name << " " << pair;
        EXPECT_EQ(by.friction, own ? expected.parameters.friction : 0) << model.name << " " << pair;
      }
      EXPECT_EQ(gradient.parameters.stiffness, expected.parameters.stiffness) << model.name;
      EXPECT_EQ(gradient.parameters.mass, expected.parameters.mass) << model.name;
    }
  }
  EXPECT_EQ(models, static_cast<int>(AllContactModels().size()));
}

// The closed form of one impact: restitution along the normal, Coulomb's friction along the tangent.
TEST(Materials, ImpactsOfTheEventModelHaveTheClosedForm) {
  const Rollout run("event", ThreePairs(true));
  EXPECT_NEAR(run.Velocity(0)[1], 0.9 * 2, 1e-12);
  EXPECT_NEAR(run.Velocity(0)[0], 0.8 - 0.3 * 1.9 * 2 > 0 ? 0.8 - 0.3 * 1.9 * 2 : 0.0, 1e-12);
  EXPECT_NEAR(run.Velocity(1)[1], 0.5 * 2, 1e-12);
  EXPECT_NEAR(run.Velocity(1)[0], 0.9 - 0.1 * 1.5 * 2, 1e-12);
  // The disc d is fixed; along the normal c leaves it with 0.7 of its speed.
  const Scene scene = ThreePairs(true);
  const std::vector<StepTouch>& touches = run.simulator->touches();
  ASSERT_EQ(touches.size(), 3u);
  const Vec2d v = scene.bodies[2].velocity, apart = scene.bodies[3].position - scene.bodies[2].position;
  const double reach = 0.5, b = apart.dot(v), c = apart.squaredNorm() - reach * reach;
  const double time = (b - std::sqrt(b * b - v.squaredNorm() * c)) / v.squaredNorm();
  const Vec2d normal = (v * time - apart) / reach, tangent = Perpendicular(normal);
  EXPECT_NEAR(run.Velocity(2).dot(normal), -0.7 * v.dot(normal), 1e-12);
  const double slid = v.dot(tangent), drag = 0.05 * 1.7 * std::abs(v.dot(normal));
  EXPECT_NEAR(run.Velocity(2).dot(tangent), std::copysign(std::max(0.0, std::abs(slid) - drag), slid), 1e-12);
}

// Models with restitution come to the exact motion as their steps become short, at every pair.
TEST(Materials, ModelsConvergeToTheEventModel) {
  const Rollout exact("event", ThreePairs(false));
  for (const ModelTraits& model : AllContactModels()) {
    if (model.rebound != Rebound::kRestitution || model.compliant) continue;
    if (!ReasonNotApplicable(model.name, ThreePairs(false)).empty()) continue;
    const Rollout run(Contact(model.name), ThreePairs(false, 8000));
    for (int disc = 0; disc < 2; ++disc) {
      const double rebound = std::pow(kRestitution[disc], model.restitution_power) * 2;
      EXPECT_NEAR(run.Velocity(disc)[1], rebound, 0.02) << model.name;
      if (model.restitution_power == 1) {
        EXPECT_NEAR(run.Velocity(disc)[1], exact.Velocity(disc)[1], 0.02) << model.name;
      }
    }
  }
}

// Two discs on a floor, of which the one behind has no friction: it pushes the other, which brakes both.
TEST(Materials, ContactsOfOneGroupHaveTheirOwnFriction) {
  Scene scene;
  scene.name = "pushed";
  scene.duration = 0.2;
  scene.steps = 960;
  scene.gravity = {0, -9.8};
  scene.bodies = {
      {.name = "front", .radius = 0.1, .mass = 1, .position = {0, 0.1}, .velocity = {2, 0}, .material = 0},
      {.name = "back", .radius = 0.1, .mass = 1, .position = {-0.2, 0.1}, .velocity = {2, 0}, .material = 1}};
  scene.planes = {{"floor", {0, 0}, {0, 1}, 2}};
  scene.contact = {.restitution = 0, .friction = 0};
  scene.materials = {{"rough", {0, 0.3}}, {"smooth", {0, 0}}, {"ground", {0, 0.3}}};
  scene.combine = Combine::kMin;
  Scene alone = scene;
  alone.bodies.pop_back();
  const double lost = 0.3 * 9.8 * scene.duration;  // momentum, by Coulomb's law
  const Rollout exact("event", scene);
  EXPECT_NEAR(exact.Velocity(0)[0] + exact.Velocity(1)[0], 4 - lost, 1e-10);
  EXPECT_NEAR(exact.Velocity(1)[0], 2 - lost / 2, 1e-10);
  for (const ModelTraits& model : AllContactModels()) {
    if (!ReasonNotApplicable(model.name, scene).empty()) continue;
    const Rollout pair(model.name, scene), one(model.name, alone);
    const double braked = 2 - one.Velocity(0)[0], both = 4 - pair.Velocity(0)[0] - pair.Velocity(1)[0];
    EXPECT_NEAR(both, braked, 0.05 * lost) << model.name;
  }
}

// Materials that are all alike change no bit.
TEST(Materials, AllAlikeChangeNothing) {
  Scene scene = OnePair(ThreePairs(true), kPairs[2]);
  scene.gravity = {0.3, -9.8};
  scene.bodies.push_back({.name = "e", .radius = 0.2, .mass = 2, .position = {0.1, 0.95}, .velocity = {0, -1}});
  Scene alike = scene;
  const PairContact same{scene.contact.restitution, scene.contact.friction};
  alike.materials = {{"one", same}, {"two", same}};
  alike.bodies[0].material = 0;
  alike.bodies[2].material = 1;
  alike.segments[0].material = 1;
  for (const Combine combine : {Combine::kMean, Combine::kMin, Combine::kMax}) {
    alike.combine = combine;
    for (const ModelTraits& model : AllContactModels()) {
      if (!ReasonNotApplicable(model.name, scene).empty()) continue;
      const Rollout plain(model.name, scene), with(model.name, alike);
      EXPECT_EQ(plain.end, with.end) << model.name;
      if (combine != Combine::kMean) continue;
      EXPECT_EQ(plain.Gradient().initial, with.Gradient().initial) << model.name;
    }
  }
}

// Derivatives by the numbers of a pair, against differences; as design parameters too.
TEST(Materials, DerivativesOfDifferences) {
  Scene scene = ThreePairs(true);
  scene.gravity = {0.2, -3};
  scene.duration = 0.4;
  scene.segments[1] = {"wooden", {35, 0}, {45, 0.4}, 2};
  for (const char* name : {"restitution.rubber-steel", "friction.wood-wood", "restitution.wood-steel"}) {
    const std::vector<SceneParameter> found = ParametersNamed(name, scene);
    ASSERT_EQ(found.size(), 1u) << name;
    scene.design.push_back({found[0]});
  }
  for (const char* model : {"event", "smooth_compliant", "soft_convex", "convex", "lcp_pgs", "lcp_pgs_adjoint"}) {
    const Sensitivity gradient = Rollout(model, scene).Gradient();
    for (std::size_t i = 0; i < scene.design.size(); ++i) {
      const SceneParameter& parameter = scene.design[i].parameter;
      const double width = 1e-5, value = ValueOf(parameter, scene);
      const auto at = [&](double by) {
        Scene near = scene;
        SetValue(parameter, value + by, &near);
        return Rollout(model, near).Loss();
      };
      const double expected = (at(width) - at(-width)) / (2 * width);
      const double by = ContactDerivative(parameter, gradient.parameters);
      EXPECT_NEAR(by, expected, 1e-6 * (1 + std::abs(expected))) << model << " " << NameOf(parameter, scene);
      EXPECT_EQ(gradient.parameters.design[i], by) << model;
    }
  }
}

TEST(Materials, RulesAndNamesOfPairs) {
  Scene scene = ThreePairs(true);
  scene.contact = {.restitution = 0.6, .friction = 0.5};
  const auto between = [&](int a, int b) { return ContactBetween(scene, a, b); };
  const auto expect = [](const PairContact& found, double restitution, double friction) {
    EXPECT_DOUBLE_EQ(found.restitution, restitution);
    EXPECT_DOUBLE_EQ(found.friction, friction);
  };
  expect(between(0, 1), 0.9, 0.3);  // given
  expect(between(1, 0), 0.9, 0.3);
  expect(between(2, 2), 0.5, 0.1);  // its friction is combined
  expect(between(0, 2), 0.65, 0.45);
  expect(between(-1, 0), 0.8, 0.65);
  expect(between(-1, -1), 0.6, 0.5);
  scene.combine = Combine::kProduct;
  expect(between(0, 2), 0.3, 0.08);
  expect(between(1, 1), 0.16, 0.04);
  expect(between(-1, -1), 0.6, 0.5);
  scene.combine = Combine::kMin;
  expect(between(0, 2), 0.3, 0.1);
  scene.combine = Combine::kMax;
  expect(between(0, 2), 1, 0.8);
  for (int a = 0; a < 6; ++a) {
    for (int b = a; b < 6; ++b) EXPECT_EQ(MaterialsOfPair(MaterialPairIndex(b, a)), std::pair(a, b));
  }
  EXPECT_THAT(PairsInUse(scene), testing::ElementsAre(4, 5, 7, 8, 9));
}

// Models that know one restitution and one friction refuse such scenes, with the reason.
TEST(Materials, WhatKnowsOneOfThemRefuses) {
  const Scene scene = ThreePairs(true);
  EXPECT_THAT(ReasonNotApplicable(LearnedContact(RestitutionNetwork(2, 3, 0.5)), scene),
              HasSubstr("the scene has materials: this model has one restitution"));
}

struct Springs {
  static constexpr auto kName = "springs";
  template <typename T>
  Vec2<T> Force(const Meeting<T>& m) const {  // a damper that only the pair's restitution sets
    return m.gap < 0 ? Vec2<T>((-1e4 * m.gap - 1e2 * m.constants.restitution * Dot(m.normal, m.velocity)) * m.normal)
                     : m.Zero();
  }
};

TEST(Materials, ForcesOfUsersGetThePair) {
  const Scene scene = ThreePairs(false, 2000);
  const Contact springs = ForceContact(Springs());
  const Rollout all(springs, scene);
  for (int disc = 0; disc < 3; ++disc) {
    const Rollout one(springs, OnePair(scene, kPairs[disc]));
    EXPECT_EQ(all.Velocity(disc), one.Velocity(disc));
  }
  EXPECT_GT((all.Velocity(0) - Rollout(springs, OnePair(scene, kPairs[1])).Velocity(0)).norm(), 0.01);
}

}  // namespace
}  // namespace saltus
