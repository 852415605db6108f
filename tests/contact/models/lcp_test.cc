#include "contact/models/lcp.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "base/linear_algebra.h"
#include "contact/one_step.h"
#include "parameter_name.h"
#include "saltus/control/single_shooting.h"
#include "saltus/internal/contact_step.h"
#include "test_scenes.h"

extern template class saltus::ContactStepOf<saltus::Lcp, double>;

namespace saltus {
namespace {

using contact_test::DiscScene;
using contact_test::OneStep;

constexpr double kStep = 1.0 / 480;
const Plane kGround = {"ground", {0, 0}, {0, 1}};
const Plane kWall = {"wall", {0, 0}, {1, 0}};
const std::vector<int> kVelocities = {2, 3};
const std::vector<int> kEverything = {0, 1, 2, 3, 4, 5};

// Reference values of an independent implementation.
TEST(Lcp, LossesGradientsAndImpactSteps) {
  const auto evaluate = [](const Scene& scene, double* loss, Sensitivity* gradient, std::vector<int>* steps) {
    SingleShooting shooting(MakeSimulator("lcp", scene, Precision::kDouble));
    ASSERT_TRUE(shooting.EvaluateAll(shooting.initial_guess(), loss, gradient));
    steps->clear();
    for (const StepTouch& touch : shooting.simulator().touches()) steps->push_back(touch.step);
  };
  double loss;
  Sensitivity gradient;
  std::vector<int> steps;
  evaluate(ProblemScene("bounce_once"), &loss, &gradient, &steps);
  EXPECT_NEAR(loss, 1.1833333333, 1e-10);
  EXPECT_NEAR(gradient.control[1], -kStep * (1 - kStep), 1e-14);
  EXPECT_EQ(steps, std::vector<int>({217}));

  Scene scene = ProblemScene("ground_wall");
  evaluate(scene, &loss, &gradient, &steps);
  EXPECT_NEAR(loss, 8.493499808011151, 1e-12);
  EXPECT_NEAR(gradient.initial[0], -5.336, 1e-8);
  EXPECT_NEAR(gradient.initial[1], -0.53169253, 1e-8);
  EXPECT_NEAR(gradient.initial[3], -0.31901552, 1e-8);
  EXPECT_EQ(steps, std::vector<int>({76, 207}));

  scene.contact.friction = 0.1;
  evaluate(scene, &loss, &gradient, &steps);
  EXPECT_NEAR(loss, 11.66308087525, 1e-11);
  EXPECT_NEAR(gradient.initial[0], -6.26891887, 1e-8);
  EXPECT_NEAR(gradient.initial[1], -0.43264625, 1e-8);
  EXPECT_NEAR(gradient.initial[2], -3.76812318, 1e-8);
  EXPECT_NEAR(gradient.initial[3], -0.7899847, 1e-7);
  EXPECT_EQ(steps, std::vector<int>({76, 251}));

  evaluate(ProblemScene("two_balls"), &loss, &gradient, &steps);
  EXPECT_NEAR(loss, 2.0665260, 1e-7);
  EXPECT_EQ(steps, std::vector<int>({333}));
}

// --- One disc on a plane. The velocity after, and d(velocity)/d(velocity), in closed form.

struct FaceCase {
  double friction, tangential;
  ContactMode mode;

  friend void PrintTo(const FaceCase& face, std::ostream* out) {
    const char* mode = face.mode == ContactMode::kSlip ? "slips" : face.mode == ContactMode::kStick ? "sticks" : "free";
    *out << mode << " friction " << face.friction << (face.tangential < 0 ? " back" : " forth");
  }
};
class LcpFace : public testing::TestWithParam<FaceCase> {};

TEST_P(LcpFace, ClosedForm) {
  const auto& [friction_of_scene, tangential, mode] = GetParam();
  const double mu = mode == ContactMode::kFrictionless ? 0 : friction_of_scene;  // up to 1e-3 there is none
  const double e = 0.8;
  const Vec2d n(0.6, 0.8), t(-0.8, 0.6);
  Scene scene = DiscScene({{.name = "a", .radius = 0.1, .mass = 2}}, {{"slope", {0, 0}, n}});
  scene.contact.restitution = e;
  scene.contact.friction = friction_of_scene;
  scene.bodies[0].position = 0.09 * n;
  scene.bodies[0].velocity = -2 * n + tangential * t;
  OneStep step("lcp", scene);
  step.Run();
  const double normal = (1 + e) * 2;  // m/s
  const double sigma = -std::copysign(mu, tangential);
  const double friction = mode == ContactMode::kStick ? -tangential : sigma * normal;
  const Vec2d after = scene.bodies[0].velocity + normal * n + friction * t;
  for (int j : {0, 1}) {
    EXPECT_NEAR(step.after(0, 2 + j), after[j], 1e-14);
    EXPECT_NEAR(step.after(0, j), scene.bodies[0].position[j] + kStep * scene.bodies[0].velocity[j], 1e-16);
  }
  ASSERT_EQ(step.touches().size(), 1u);
  EXPECT_EQ(step.touches()[0].mode, mode);

  const Eigen::Vector2d nn = n, tt = t;
  Eigen::Matrix2d vv = Eigen::Matrix2d::Identity() - (1 + e) * nn * nn.transpose();
  if (mode == ContactMode::kStick) {
    vv -= tt * tt.transpose();
  } else {
    vv -= (1 + e) * sigma * tt * nn.transpose();
  }
  const Eigen::Matrix2d X = Eigen::Matrix2d::Identity() - (1 + e) * nn * nn.transpose();
  Eigen::MatrixXd A, B;
  step.Linearize(&A, &B);
  EXPECT_LT((A.topLeftCorner<2, 2>() - X).norm(), 1e-14);
  EXPECT_LT((A.topRightCorner<2, 2>() - kStep * X).norm(), 1e-14);
  EXPECT_LT((A.bottomLeftCorner<2, 2>()).norm(), 1e-14);
  EXPECT_LT((A.bottomRightCorner<2, 2>() - vv).norm(), 1e-14);
  EXPECT_LT((B.bottomRows<2>() - kStep / 2 * vv).norm(), 1e-14);
  EXPECT_EQ(B.topRows<2>().norm(), 0);
  step.ExpectDerivative(kVelocities, kEverything, 1e-5, 1e-8);
}
INSTANTIATE_TEST_SUITE_P(Lcp, LcpFace,
                         testing::Values(FaceCase{0, 1, ContactMode::kFrictionless},
                                         FaceCase{5e-4, 1, ContactMode::kFrictionless},
                                         FaceCase{0.3, 3, ContactMode::kSlip}, FaceCase{0.3, -3, ContactMode::kSlip},
                                         FaceCase{0.3, 0.5, ContactMode::kStick}),
                         ParameterName());

// --- Two discs.

class LcpDiscs : public testing::TestWithParam<FaceCase> {};

TEST_P(LcpDiscs, ClosedForm) {
  const auto& [friction_of_scene, tangential, mode] = GetParam();
  const double mu = mode == ContactMode::kFrictionless ? 0 : friction_of_scene;  // up to 1e-3 there is none
  const double e = 0.8, ma = 2, mb = 0.5, distance = 0.29;
  const Vec2d n(-0.6, -0.8), t(0.8, -0.6);
  Scene scene = DiscScene({{.name = "a", .radius = 0.2, .mass = ma, .velocity = Vec2d(-1 * n + tangential * t)},
                           {.name = "b", .radius = 0.1, .mass = mb, .position = -distance * n, .velocity = 1 * n}});
  scene.contact.restitution = e;
  scene.contact.friction = friction_of_scene;
  scene.gravity = {0.5, -9.8};
  OneStep step("lcp", scene);
  step.force(0, 0) = 3;
  step.force(1, 1) = -2;
  step.Run();

  Eigen::Vector4d a, s, free_velocity;
  a << n, -n;
  s << t, -t;
  Eigen::Vector4d inverse_mass(1 / ma, 1 / ma, 1 / mb, 1 / mb);
  for (int i : {0, 1}) {
    for (int j : {0, 1}) {
      free_velocity[2 * i + j] =
          scene.bodies[i].velocity[j] + kStep * (step.force(i, j) * inverse_mass[2 * i] + scene.gravity[j]);
    }
  }
  const double kappa = 1 / ma + 1 / mb;
  const double normal = -(1 + e) * a.dot(free_velocity) / kappa;
  const double sigma = -std::copysign(mu, s.dot(free_velocity));
  const double friction = mode == ContactMode::kStick ? -s.dot(free_velocity) / kappa : sigma * normal;
  const Eigen::Vector4d after = free_velocity + inverse_mass.asDiagonal() * (normal * a + friction * s);
  for (int i : {0, 1}) {
    for (int j : {0, 1}) EXPECT_NEAR(step.after(i, 2 + j), after[2 * i + j], 1e-13);
  }
  ASSERT_EQ(step.touches().size(), 1u);
  EXPECT_EQ(step.touches()[0].mode, mode);

  const Eigen::Matrix4d Gn = s * s.transpose() / distance;
  const Eigen::Matrix4d Gt = -a * s.transpose() / distance;
  const Eigen::RowVector4d vGn = free_velocity.transpose() * Gn, vGt = free_velocity.transpose() * Gt;
  Eigen::Matrix4d vv = Eigen::Matrix4d::Identity(), pv;
  if (mode == ContactMode::kStick) {
    vv -= (inverse_mass / kappa).asDiagonal() * ((1 + e) * a * a.transpose() + s * s.transpose());
    pv = normal * Gn + friction * Gt - ((1 + e) * a * vGn + s * vGt) / kappa;
  } else {
    vv -= ((1 + e) / kappa * inverse_mass).asDiagonal() * (a + sigma * s) * a.transpose();
    pv = normal * (Gn + sigma * Gt) - (1 + e) / kappa * (a + sigma * s) * vGn;
  }
  pv = inverse_mass.asDiagonal() * pv;
  const Eigen::Matrix4d X = Eigen::Matrix4d::Identity() - (2 + e) / 4 * a * a.transpose();

  Eigen::MatrixXd A, B;
  step.Linearize(&A, &B);
  const std::vector<int> p = {0, 1, 4, 5}, v = {2, 3, 6, 7};
  EXPECT_LT((A(p, p) - X).norm(), 1e-13);
  EXPECT_LT((A(p, v) - kStep * X).norm(), 1e-13);
  EXPECT_LT((A(v, p) - pv).norm(), 1e-12);
  EXPECT_LT((A(v, v) - vv).norm(), 1e-13);
  EXPECT_LT((B(v, Eigen::all) - kStep * vv * inverse_mass.asDiagonal()).norm(), 1e-13);
  step.ExpectDerivative(kVelocities, kEverything, 1e-5, 1e-7);
}
INSTANTIATE_TEST_SUITE_P(Lcp, LcpDiscs,
                         testing::Values(FaceCase{0, 1, ContactMode::kFrictionless},
                                         FaceCase{0.3, 5, ContactMode::kSlip}, FaceCase{0.3, -5, ContactMode::kSlip},
                                         FaceCase{0.3, 0.5, ContactMode::kStick}),
                         ParameterName());

// --- What counts as a contact and as a bounce.

TEST(Lcp, DepthWindow) {
  for (const auto& [depth, touches] : {std::pair(-1e-9, false), {0.0, true}, {0.0299, true}, {0.0301, false}}) {
    OneStep step(
        "lcp",
        DiscScene({{.name = "a", .radius = 0.125, .position = {0, 0.125 - depth}, .velocity = {0, -1}}}, {kGround}));
    step.Run();
    EXPECT_EQ(step.after(0, 3), touches ? 1 : -1) << depth;
  }
}

// A contact bounces iff e times the speed of approach exceeds 0.1 m/s; otherwise it is plastic and has no bounce
// matrix.
TEST(Lcp, BounceThresholdAndCap) {
  for (const double speed : {0.19, 0.21, 300.0}) {
    Scene scene = DiscScene({{.name = "a", .radius = 0.1, .position = {0, 0.09}, .velocity = {0, -speed}}}, {kGround});
    scene.contact.restitution = 0.5;
    OneStep step("lcp", scene);
    step.Run();
    const bool bounced = speed > 0.2;
    EXPECT_NEAR(step.after(0, 3), bounced ? std::min(0.5 * speed, 100.0) : 0, 1e-13);
    Eigen::MatrixXd A, B;
    step.Linearize(&A, &B);
    EXPECT_NEAR(A(1, 1), bounced ? -0.5 : 1, 1e-14);
    EXPECT_NEAR(A(1, 3), kStep * A(1, 1), 1e-14);
    EXPECT_NEAR(A(3, 3), bounced ? -0.5 : 0, 1e-14);  // the source's derivative does not know of the cap
  }
}

TEST(Lcp, SeparatingContactIsFree) {
  OneStep step("lcp",
               DiscScene({{.name = "a", .radius = 0.1, .position = {0, 0.09}, .velocity = {2, 0.5}}}, {kGround}));
  step.Run();
  EXPECT_EQ(step.after(0, 3), 0.5);
  EXPECT_TRUE(step.touches().empty());
}

TEST(Lcp, FixedDiscIsAnInfiniteMass) {
  Scene scene = DiscScene({{.name = "post", .radius = 0.2, .fixed = true, .position = {0, 0}},
                           {.name = "b", .radius = 0.1, .mass = 3, .position = {0.232, 0.174}, .velocity = {-2, -1}}});
  scene.contact.restitution = 0.5;
  scene.contact.friction = 0.2;
  OneStep step("lcp", scene);
  step.Run();
  const Vec2d n(0.8, 0.6), t(-0.6, 0.8);
  const double approach = 2.2, slip = Dot(t, Vec2d(-2, -1));
  ASSERT_GT(slip, 0.2 * 1.5 * approach - 1);
  const double friction = std::abs(slip) < 0.2 * 1.5 * approach ? -slip : -std::copysign(0.2 * 1.5 * approach, slip);
  const Vec2d after = Vec2d(-2, -1) + 1.5 * approach * n + friction * t;
  EXPECT_NEAR(step.after(1, 2), after[0], 1e-13);
  EXPECT_NEAR(step.after(1, 3), after[1], 1e-13);
  for (int j = 0; j < 4; ++j) EXPECT_EQ(step.after(0, j), 0);
  Eigen::MatrixXd A, B;
  step.Linearize(&A, &B);
  const Eigen::Vector2d a(n[0], n[1]);
  EXPECT_LT((A.block<2, 2>(4, 4) - (Eigen::Matrix2d::Identity() - 1.5 * a * a.transpose())).norm(), 1e-13);
  EXPECT_EQ(A.topRightCorner(4, 4).norm() + A.bottomLeftCorner(4, 4).norm(), 0);
  EXPECT_EQ(B.leftCols(2).norm() + B.topRows(4).norm(), 0);
  step.ExpectDerivative(kVelocities, kEverything, 1e-5, 1e-7);
}

// --- Several contacts in one step.

// X is the matrix nearest to the identity with a^T X a = -e for each bounce: I - X is a combination of the a a^T.
TEST(Lcp, TwoBouncesInACorner) {
  const double e = 0.6;
  const Vec2d n1(0, 1), n2(0.8, 0.6);
  Scene scene = DiscScene({{.name = "a", .radius = 0.1, .velocity = {-0.9, -2}}},
                          {{"ground", {0, 0}, n1}, {"slope", {0, 0}, n2}});
  scene.contact.restitution = e;
  scene.bodies[0].position = {0.095 * 0.5, 0.095};
  OneStep step("lcp", scene);
  step.Run();
  ASSERT_EQ(step.touches().size(), 2u);
  const Vec2d after(step.after(0, 2), step.after(0, 3));
  EXPECT_NEAR(Dot(n1, after), e * 2, 1e-13);
  EXPECT_NEAR(Dot(n2, after), e * 1.92, 1e-13);
  Eigen::MatrixXd A, B;
  step.Linearize(&A, &B);
  const Eigen::Matrix2d X = A.topLeftCorner<2, 2>();
  const Eigen::Vector2d a1 = n1, a2 = n2;
  EXPECT_NEAR(a1.dot(X * a1), -e, 1e-13);
  EXPECT_NEAR(a2.dot(X * a2), -e, 1e-13);
  // Perpendicular to both a a^T is what maps (a1^T Y a1, a2^T Y a2) to zero; I - X must not contain it.
  const Eigen::Matrix2d removed = Eigen::Matrix2d::Identity() - X;
  Eigen::Matrix<double, 2, 4> W;
  W << Eigen::Matrix2d(a1 * a1.transpose()).reshaped().transpose(),
      Eigen::Matrix2d(a2 * a2.transpose()).reshaped().transpose();
  const Eigen::MatrixXd kernel = NullSpace(W);
  EXPECT_LT((kernel.transpose() * removed.reshaped()).norm(), 1e-13);
  EXPECT_LT((A.topRightCorner<2, 2>() - kStep * X).norm(), 1e-14);
  step.ExpectDerivative(kVelocities, kEverything, 1e-5, 1e-7);
}

// Discs in a row and a plane, struck together: velocities follow from the complementarity conditions.
TEST(Lcp, ChainOnAPlane) {
  for (const double friction : {0.0, 0.2, 0.8}) {
    Scene scene = DiscScene({{.name = "a", .radius = 0.1, .mass = 2, .position = {0, 0.095}, .velocity = {3, -1}},
                             {.name = "b", .radius = 0.1, .mass = 1, .position = {0.19, 0.097}, .velocity = {-1, -1}},
                             {.name = "c", .radius = 0.1, .mass = 5, .position = {0.37, 0.15}, .velocity = {-2, 0.3}},
                             {.name = "far", .radius = 0.1, .position = {9, 9}, .velocity = {-2, 1}}},
                            {kGround});
    scene.contact.restitution = 0.4;
    scene.contact.friction = friction;
    scene.gravity = {0, -9.8};
    OneStep step("lcp", scene);
    step.Run();
    EXPECT_GE(step.touches().size(), 3u);
    EXPECT_EQ(step.after(3, 3), 1 - 9.8 * kStep);
    step.ExpectDerivative(kVelocities, kEverything, 1e-5, 1e-6);
    if (friction > 0) continue;
    // Restitution holds at each contact with an impulse.
    const auto after = [&](int i) { return Vec2d(step.after(i, 2), step.after(i, 3)); };
    for (const Touch& touch : step.touches()) {
      const Candidate& c = touch.candidate;
      Vec2d n(0, 1), v0 = scene.bodies[c.a].velocity, v1 = after(c.a);
      double fall = 9.8 * kStep;
      if (!c.plane) {
        n = (scene.bodies[c.a].position - scene.bodies[c.b].position).normalized();
        v0 -= scene.bodies[c.b].velocity;
        v1 -= after(c.b);
        fall = 0;
      }
      EXPECT_NEAR(Dot(n, v1), 0.4 * (fall - Dot(n, v0)), 1e-12);
    }
  }
}

// The dense stack that rests on the ground stays at rest.
TEST(Lcp, StackAtRest) {
  std::vector<Body> bodies;
  for (int row = 0; row < 4; ++row) {
    for (int i = 0; i < 4 - row; ++i) {
      bodies.push_back({.name = "d" + std::to_string(bodies.size()),
                        .radius = 0.1,
                        .mass = 1.0 + row,
                        .position = {0.1999 * i + 0.09995 * row, 0.0999 + row * 0.1731}});
    }
  }
  Scene scene = DiscScene(bodies, {kGround, kWall, {"right", {0.7997, 0}, {-1, 0}}});
  for (Body& body : scene.bodies) body.position[0] += 0.1;
  scene.gravity = {0, -9.8};
  for (const double friction : {0.0, 0.5}) {
    scene.contact.friction = friction;
    OneStep step("lcp", scene);
    step.Run();
    for (int i = 0; i < scene.num_bodies(); ++i) {
      EXPECT_NEAR(step.after(i, 2), 0, 1e-5);
      EXPECT_NEAR(step.after(i, 3), 0, 1e-5);
    }
  }
}

// --- Step with Jets: the derivative of the code's own update, parameters included.

TEST(Lcp, ParameterDerivatives) {
  for (const double tangential : {0.3, 4.0}) {
    const auto scene_with = [&](int parameter, double shift) {
      Scene scene = DiscScene(
          {{.name = "a", .radius = 0.2, .mass = 2, .velocity = {1, 0.5 * tangential}},
           {.name = "b", .radius = 0.1, .mass = 0.5, .position = {0.29, 0.01}, .velocity = {-1, -tangential}}});
      scene.contact.restitution = 0.8 + (parameter == 0 ? shift : 0);
      scene.contact.friction = 0.3 + (parameter == 1 ? shift : 0);
      scene.bodies[0].mass += parameter == 4 ? shift : 0;
      scene.bodies[1].mass += parameter == 5 ? shift : 0;
      return scene;
    };
    const auto after = [&](int parameter, double shift) {
      OneStep step("lcp", scene_with(parameter, shift));
      step.Run();
      Eigen::VectorXd next(8);
      for (int i = 0; i < 8; ++i) next[i] = step.after(i / 4, i % 4);
      return next;
    };
    const Eigen::MatrixXd P = OneStep("lcp", scene_with(-1, 0)).ParameterDerivatives();
    ASSERT_EQ(P.cols(), 6);
    for (int parameter : {0, 1, 4, 5}) {
      const Eigen::VectorXd expected = (after(parameter, 1e-6) - after(parameter, -1e-6)) / 2e-6;
      EXPECT_LT((P.col(parameter) - expected).norm(), 1e-8) << parameter;
    }
  }
}

TEST(Lcp, JetsAgreeWithThePublishedVelocityBlocks) {
  using Jet = StepJet<double>;
  std::byte buffer[1 << 14];
  std::pmr::monotonic_buffer_resource scratch(buffer, sizeof buffer);
  const std::vector<BodyConstants<double>> bodies = {{2, 0.5, 0.2, false}, {0.5, 2, 0.1, false}};
  const std::vector<Wall<double>> planes = {{Vec2d(0, 1), -0.19}};
  const std::vector<Candidate> candidates = {{0, 1, false}, {0, 0, true}};
  std::vector<BodyState<double, 0>> x = {{{0, 0}, {1, -1}}, {{0.2, 0.21}, {-1, -2}}}, next(2);
  const std::vector<Vec2d> force(2, Vec2d::Zero());
  StepInput<double> in{kStep, {0, -9.8}, {0.5, 0.2, 0, 0}, bodies, planes, force, candidates, &scratch};
  Eigen::MatrixXd A(8, 8), B(8, 4);
  const ContactStep<double, 0>& lcp = ContactStepOf<Lcp, double>(Lcp());
  lcp.Linearize(in, x, A, B);
  lcp.Step(in, x, next);

  std::vector<BodyConstants<Jet>> jet_bodies;
  for (const auto& body : bodies) jet_bodies.push_back({Jet(body.mass), Jet(body.inverse_mass), body.radius, false});
  const std::vector<Vec2<Jet>> jet_force(2, Vec2<Jet>::Zero());
  for (int column = 0; column < 8; ++column) {
    std::vector<BodyState<Jet, 0>> jets(2), jet_next(2);
    for (int i = 0; i < 2; ++i) {
      jets[i] = {x[i].p.cast<Jet>(), x[i].v.cast<Jet>()};
      if (column / 4 == i) (column % 4 < 2 ? jets[i].p : jets[i].v)[column % 2].v[0] = 1;
    }
    const StepInput<Jet> jet_in{
        kStep, {0, -9.8}, {Jet(0.5), Jet(0.2), Jet(0), Jet(0)}, jet_bodies, planes, jet_force, candidates, &scratch};
    lcp.Step(jet_in, jets, jet_next);
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        EXPECT_EQ(jet_next[i].v[j].a, next[i].v[j]);
        EXPECT_EQ(jet_next[i].p[j].a, next[i].p[j]);
        EXPECT_NEAR(jet_next[i].v[j].v[0], A(4 * i + 2 + j, column), 1e-11);
        const double free = column == 4 * i + j ? 1 : column == 4 * i + 2 + j ? kStep : 0;
        EXPECT_EQ(jet_next[i].p[j].v[0], free);
      }
    }
  }
}

}  // namespace
}  // namespace saltus
