// Steps and forward derivatives of a contact model on a scene, for tests: a plain loop over all pairs that knows
// nothing of broad phases, islands and adjoints. And the problems with their losses and gradients. The steps are those
// that the library has: a test says `extern template` of its models, and does not compile them again.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <memory_resource>
#include <string>
#include <vector>

#include "saltus/audit/gradients.h"
#include "saltus/simulate/user_contact.h"
#include "test_scenes.h"

namespace saltus::testing {

using Model = ContactStep<double, 0>;

// A contact model with these options; the others have their defaults.
template <ContactModel M>
ContactStepOf<M, double> Compiled(std::initializer_list<OptionValue> options = {}) {
  return ContactStepOf<M, double>(internal::WithOptions(M(), {options.begin(), options.size()}));
}

// All that a step depends on, as scalars that can carry derivatives.
template <typename T>
struct StepArguments {
  std::vector<BodyState<T, 0>> x;
  std::vector<Vec2<T>> force;
  ContactConstants<T> contact;
  std::vector<T> mass;

  // Every scalar: four of a disc's state, two of its force, its mass; then the contact constants.
  std::vector<T*> Scalars() {
    std::vector<T*> scalars;
    for (BodyState<T, 0>& body : x) scalars.insert(scalars.end(), {&body.p[0], &body.p[1], &body.v[0], &body.v[1]});
    for (Vec2<T>& f : force) scalars.insert(scalars.end(), {&f[0], &f[1]});
    for (T& m : mass) scalars.push_back(&m);
    scalars.insert(scalars.end(), {&contact.restitution, &contact.friction, &contact.stiffness, &contact.damping});
    return scalars;
  }
};

// The initial state of a scene under its initial control.
template <typename T>
StepArguments<T> Arguments(const Scene& scene) {
  using S = Base<T>;
  const auto lift = [](double value) { return T(static_cast<S>(value)); };
  const auto lift2 = [&](const Vec2d& value) { return Vec2<T>(lift(value[0]), lift(value[1])); };
  StepArguments<T> arguments;
  for (const Body& body : scene.bodies) {
    arguments.x.push_back({lift2(body.position), lift2(body.fixed ? Vec2d(0, 0) : body.velocity)});
    arguments.force.push_back(lift2(Vec2d(0, 0)));
    arguments.mass.push_back(lift(body.mass));
  }
  for (std::size_t i = 0; i < scene.control.bodies.size(); ++i) {
    arguments.force[scene.control.bodies[i]] = lift2(scene.control.initial[i]);
  }
  arguments.contact = {lift(scene.contact.restitution),
                       lift(scene.contact.friction),
                       lift(scene.contact.stiffness),
                       lift(scene.contact.damping)};
  return arguments;
}

// One step from `arguments` in the scene's time step, gravity, radii and planes. Every pair is a candidate.
template <typename T>
std::vector<BodyState<T, 0>> StepOnce(const Model& model, const Scene& scene, const StepArguments<T>& arguments,
                                      std::vector<Touch>* touches = nullptr) {
  using S = Base<T>;
  const int count = scene.num_bodies();
  std::vector<BodyConstants<T>> bodies;
  for (int i = 0; i < count; ++i) {
    const bool fixed = scene.bodies[i].fixed;
    const T inverse = fixed ? T(S(0)) : Divide(S(1), arguments.mass[i]);
    bodies.push_back({arguments.mass[i], inverse, static_cast<S>(scene.bodies[i].radius), fixed});
  }
  std::vector<Wall<S>> planes;
  for (const Plane& plane : scene.planes) {
    const Vec2d normal = plane.normal.normalized();
    planes.push_back({normal.cast<S>(), static_cast<S>(normal.dot(plane.point))});
  }
  std::vector<Candidate> candidates;
  for (int a = 0; a < count; ++a) {
    for (int b = a + 1; b < count; ++b) {
      if (!scene.bodies[a].fixed || !scene.bodies[b].fixed) candidates.push_back({a, b, false});
    }
  }
  for (int a = 0; a < count; ++a) {
    for (int b = 0; b < static_cast<int>(planes.size()); ++b) {
      if (!scene.bodies[a].fixed) candidates.push_back({a, b, true});
    }
  }
  std::pmr::monotonic_buffer_resource scratch;
  const StepInput<T> in = {static_cast<S>(scene.dt()),
                           scene.gravity.cast<S>(),
                           arguments.contact,
                           bodies,
                           planes,
                           arguments.force,
                           candidates,
                           &scratch,
                           touches};
  std::vector<BodyState<T, 0>> next(count);
  model.Step(in, std::span<const BodyState<T, 0>>(arguments.x), std::span<BodyState<T, 0>>(next));
  return next;
}

inline std::vector<BodyState<double, 0>> StepOnce(const Model& model, const Scene& scene,
                                                  std::vector<Touch>* touches = nullptr) {
  return StepOnce(model, scene, Arguments<double>(scene), touches);
}

// Jets give the bits of the scalar step, and finite derivatives.
inline void ExpectJetsHaveScalarBits(const Model& model, const Scene& scene) {
  using J = StepJet<double>;
  StepArguments<J> arguments = Arguments<J>(scene);
  const std::vector<J*> scalars = arguments.Scalars();
  for (std::size_t i = 0; i < scalars.size(); ++i) scalars[i]->v[i % kJetWidth] = 1;
  const std::vector<BodyState<J, 0>> with_jets = StepOnce(model, scene, arguments);
  const std::vector<BodyState<double, 0>> plain = StepOnce(model, scene);
  for (std::size_t i = 0; i < plain.size(); ++i) {
    for (int k = 0; k < 2; ++k) {
      EXPECT_EQ(with_jets[i].p[k].a, plain[i].p[k]);
      EXPECT_EQ(with_jets[i].v[k].a, plain[i].v[k]);
      EXPECT_TRUE(with_jets[i].p[k].v.allFinite());
      EXPECT_TRUE(with_jets[i].v[k].v.allFinite());
    }
  }
}

// The step's derivative with respect to everything, against central differences. Precondition: no event within 1e-6.
inline void ExpectStepDerivative(const Model& model, const Scene& scene) {
  using J = StepJet<double>;
  const std::size_t count = Arguments<double>(scene).Scalars().size();
  double largest = 0;
  for (std::size_t input = 0; input < count; ++input) {
    SCOPED_TRACE("input " + std::to_string(input));
    StepArguments<J> arguments = Arguments<J>(scene);
    arguments.Scalars()[input]->v[0] = 1;
    const std::vector<BodyState<J, 0>> exact = StepOnce(model, scene, arguments);
    const auto moved = [&](double by) {
      StepArguments<double> at = Arguments<double>(scene);
      *at.Scalars()[input] += by;
      return StepOnce(model, scene, at);
    };
    const double by = 1e-7 * std::max(1.0, std::abs(*Arguments<double>(scene).Scalars()[input]));
    const std::vector<BodyState<double, 0>> up = moved(by), down = moved(-by);
    for (std::size_t i = 0; i < exact.size(); ++i) {
      for (int k = 0; k < 2; ++k) {
        const double p = (up[i].p[k] - down[i].p[k]) / (2 * by), v = (up[i].v[k] - down[i].v[k]) / (2 * by);
        EXPECT_NEAR(exact[i].p[k].v[0], p, 1e-6 * std::max(1.0, std::abs(p)));
        EXPECT_NEAR(exact[i].v[k].v[0], v, 2e-6 * std::max(1.0, std::abs(v)));
        largest = std::max(largest, std::abs(v));
      }
    }
  }
  EXPECT_GT(largest, 0.1);
}

inline Vec2d Momentum(const Scene& scene, const std::vector<BodyState<double, 0>>& x) {
  Vec2d sum(0, 0);
  for (std::size_t i = 0; i < x.size(); ++i) sum += scene.bodies[i].mass * x[i].v;
  return sum;
}

inline Scene TwoBalls() { return ProblemScene("two_balls"); }

inline Scene GroundWall(double friction) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = friction;
  return scene;
}

// Loss and gradient at the initial guess.
inline ModelGradient Gradient(const Model& model, const Scene& scene, Precision precision = Precision::kDouble) {
  return ComputeGradient(model.traits().name, scene, precision);
}

inline double InitialLoss(const Model& model, const Scene& scene, Precision precision = Precision::kDouble) {
  return Gradient(model, scene, precision).loss;
}

// Two discs of 1 kg and 3 kg that meet obliquely, 2.8 mm before contact, or 11 mm after it if they overlap.
inline Scene ObliqueCollision(bool overlap = false) {
  Scene scene;
  scene.duration = 0.01;
  scene.steps = 1;
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {0.002, 0.001}, .velocity = {1, 0.2}},
                  {.name = "b", .radius = 0.3, .mass = 3, .position = {0.404, 0.303}, .velocity = {-1, -0.1}}};
  if (overlap) scene.bodies[1].position = {0.394, 0.293};
  scene.contact = {.restitution = 0.7, .friction = 0.2, .stiffness = 2e3, .damping = 5};
  scene.control = {{0, 1}, {Vec2d(2, -1), Vec2d(0.5, 3)}};
  return scene;
}

// A disc that meets the ground and the wall in the next step, sliding on both; or overlaps them.
inline Scene Corner(bool overlap = false) {
  Scene scene;
  scene.duration = 0.01;
  scene.steps = 1;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 2, .position = {0.895, 0.103}, .velocity = {1.5, -1}}};
  scene.planes = {{.name = "ground", .point = {0, 0}, .normal = {0, 1}},
                  {.name = "wall", .point = {1, 0}, .normal = {-1, 0}}};
  if (overlap) scene.bodies[0].position = {0.91, 0.094};
  scene.contact = {.restitution = 0.7, .friction = 0.2, .stiffness = 2e3, .damping = 5};
  return scene;
}

// The change of disc i by contact: its step less that of a scene without the others and without planes.
inline BodyState<double, 0> ContactChange(const Model& model, const Scene& scene, int i) {
  Scene alone = scene;
  alone.planes.clear();
  for (int j = 0; j < scene.num_bodies(); ++j) {
    if (j != i) alone.bodies[j].position += Vec2d(100.0 * (j + 1), 0);
  }
  const BodyState<double, 0> with = StepOnce(model, scene)[i], without = StepOnce(model, alone)[i];
  return {with.p - without.p, with.v - without.v};
}

inline void ExpectNear(const Vec2d& a, const Vec2d& b, double tolerance) {
  EXPECT_NEAR(a[0], b[0], tolerance);
  EXPECT_NEAR(a[1], b[1], tolerance);
}

// A fixed disc does not move, and acts on the other as a disc that is very heavy and at rest does.
inline void ExpectFixedActsAsHeavy(const Model& model, Scene scene) {
  scene.bodies[1].velocity = {0, 0};
  scene.control = {{0}, {Vec2d(2, -1)}};
  scene.bodies[1].mass = 1e12;
  const std::vector<BodyState<double, 0>> heavy = StepOnce(model, scene);
  scene.bodies[1].fixed = true;
  const std::vector<BodyState<double, 0>> fixed = StepOnce(model, scene);
  EXPECT_EQ(fixed[1].p, scene.bodies[1].position);
  EXPECT_EQ(fixed[1].v, Vec2d(0, 0));
  ExpectNear(fixed[0].p, heavy[0].p, 1e-9);
  ExpectNear(fixed[0].v, heavy[0].v, 1e-9);
  EXPECT_GT((fixed[0].v - scene.bodies[0].velocity).norm(), 0.1);
}

// With a third disc that hits disc 0 from behind: the change of disc 0 is the sum of its changes by either neighbour
// alone.
inline void ExpectContactsAdd(const Model& model, Scene scene) {
  scene.bodies.push_back({.name = "c", .radius = 0.1, .mass = 0.5, .position = {-0.29, 0.04}, .velocity = {3, 0}});
  const BodyState<double, 0> both = ContactChange(model, scene, 0);
  Scene first = scene, second = scene;
  first.bodies[2].position = {-50, 0};
  second.bodies[1].position = {50, 0};
  const BodyState<double, 0> one = ContactChange(model, first, 0), other = ContactChange(model, second, 0);
  EXPECT_GT(one.v.norm(), 0.1);
  EXPECT_GT(other.v.norm(), 0.1);
  ExpectNear(both.v, one.v + other.v, 1e-12);
  ExpectNear(both.p, one.p + other.p, 1e-12);
  std::vector<Touch> touches;
  const std::vector<BodyState<double, 0>> next = StepOnce(model, scene, &touches);
  ASSERT_EQ(touches.size(), 2u);
  EXPECT_EQ(touches[0].candidate, (Candidate{0, 1, false}));
  EXPECT_EQ(touches[1].candidate, (Candidate{0, 2, false}));
}

// Momentum changes by the forces only.
inline void ExpectMomentumConserved(const Model& model, const Scene& scene) {
  Vec2d expected(0, 0);
  for (const Body& body : scene.bodies) expected += body.mass * body.velocity;
  for (const Vec2d& force : scene.control.initial) expected += scene.dt() * force;
  ExpectNear(Momentum(scene, StepOnce(model, scene)), expected, 1e-12);
}

}  // namespace saltus::testing
