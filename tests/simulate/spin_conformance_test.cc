// Properties of every contact model with discs that spin: one impulse at the points of contact moves and turns them, by
// Coulomb's law; a disc that rolls goes on rolling; energy never grows; and models with the exact law converge to exact
// motion.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "spinning_disc.h"

namespace saltus {
namespace {

constexpr double kRadius = 0.2, kMass = 1.5, kInertia = 0.5 * kMass * kRadius * kRadius;

const Vec2d kNormal(-0.28, 0.96), kAlong(0.96, 0.28);

// A disc that meets a tilted plane at 2 m/s, sliding along it at 1.5 m/s: its rim slides by spin too.
Scene DiscOnPlane(double friction, double spin, int steps = 240) {
  Scene scene;
  scene.name = "disc_on_plane";
  scene.duration = 0.5;
  scene.steps = steps;
  scene.bodies = {Spinning("a", kRadius, kMass, 0.501 * kNormal, -2 * kNormal + 1.5 * kAlong, spin)};
  scene.planes = {{"ground", {0, 0}, kNormal}};
  scene.contact = {.restitution = 0.8, .friction = friction, .stiffness = 1e4, .damping = 0};
  return scene;
}

// Two discs that meet obliquely at 3 m/s.
Scene TwoDiscs(double friction, int steps = 240) {
  const Vec2d along(0.6, 0.8), across(-0.8, 0.6);
  Scene scene;
  scene.name = "two_discs";
  scene.duration = 0.5;
  scene.steps = steps;
  scene.bodies = {Spinning("a", 0.2, 1, -0.5 * along + 0.1 * across, 2 * along, 9),
                  Spinning("b", 0.3, 3, 0.401 * along, -along, -4)};
  scene.contact = {.restitution = 0.8, .friction = friction, .stiffness = 1e4, .damping = 0};
  return scene;
}

struct Ends {
  std::vector<double> start, end;  // states
};

class EveryModelThatSpins : public testing::TestWithParam<std::string> {
 protected:
  const ModelTraits& traits() const { return *FindContactModel(GetParam()); }
  double Friction() const { return traits().friction ? 0.2 : 0.0; }
  // Brax moves angles by friction's correction of positions, without the factor that makes of it what it takes from the
  // slide: the corrections and the impulses are not those of one force.
  bool CorrectsAnglesByItsSource() const { return traits().spins && traits().projects; }
  std::unique_ptr<Simulator> Make(const Scene& scene) const {
    EXPECT_EQ(ReasonNotApplicable(GetParam(), scene), "");
    return MakeSimulator(GetParam(), scene, Precision::kDouble);
  }
  Ends Run(const Scene& scene) const {
    const std::unique_ptr<Simulator> simulator = Make(scene);
    EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())))
        << simulator->FailureReason();
    Ends ends{std::vector<double>(simulator->state_size()), std::vector<double>(simulator->state_size())};
    simulator->GetState(0, ends.start);
    simulator->GetState(simulator->num_steps(), ends.end);
    return ends;
  }
};

double KineticEnergy(const Scene& scene, const std::vector<double>& x) {
  double energy = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const double* q = &x[6 * i];
    energy += 0.5 * scene.bodies[i].mass * (q[2] * q[2] + q[3] * q[3]);
    energy += 0.5 * scene.bodies[i].MomentOfInertia() * q[5] * q[5];
  }
  return energy;
}

double AngularMomentum(const Scene& scene, const std::vector<double>& x) {
  double momentum = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const double* q = &x[6 * i];
    momentum += scene.bodies[i].mass * (q[0] * q[3] - q[1] * q[2]) + scene.bodies[i].MomentOfInertia() * q[5];
  }
  return momentum;
}

// Speed of the rim along t = Perpendicular(n).
double Slip(const double* q) { return Dot(Perpendicular(kNormal), Vec2d(q[2], q[3])) - kRadius * q[5]; }

TEST_P(EveryModelThatSpins, OneImpulseMovesAndTurns) {
  for (const double spin : {30.0, -2.0, -30.0}) {
    const Scene scene = DiscOnPlane(Friction(), spin);
    const Ends ends = Run(scene);
    const double *before = ends.start.data(), *after = ends.end.data();
    const Vec2d impulse = kMass * (Vec2d(after[2], after[3]) - Vec2d(before[2], before[3]));
    const double normal = Dot(kNormal, impulse), tangential = Dot(Perpendicular(kNormal), impulse);
    EXPECT_GT(normal, 0.9 * kMass * 2) << spin;
    if (!CorrectsAnglesByItsSource()) {
      EXPECT_NEAR(kInertia * (after[5] - before[5]), -kRadius * tangential, 1e-9) << spin;
    }
    // The published model applies up to twice the impulse that stops the slip: its friction includes the restitution.
    const double most = kMass / (1 + kRadius * kRadius * kMass / kInertia) * std::abs(Slip(before));
    EXPECT_LE(tangential * Slip(before), 1e-12) << spin;
    EXPECT_LE(std::abs(tangential), 2 * most + 1e-9) << spin;
    EXPECT_LE(std::abs(tangential), Friction() * normal * (1 + 1e-6) + 1e-9) << spin;
    EXPECT_LE(KineticEnergy(scene, ends.end), KineticEnergy(scene, ends.start) * (1 + 1e-3)) << spin;
  }
}

TEST_P(EveryModelThatSpins, AngularMomentumIsLostToOverlapOnly) {
  const Scene scene = TwoDiscs(Friction());
  const Ends ends = Run(scene);
  const double push = 0.75 * 2 * 3;  // N s, at most
  const double overlap = traits().compliant ? 1.5 * 3 * std::sqrt(0.75 / 1e4) + 0.01 : 2.01 * 3 * scene.dt() * 2;
  EXPECT_NEAR(AngularMomentum(scene, ends.end), AngularMomentum(scene, ends.start), push * overlap);
  EXPECT_LE(KineticEnergy(scene, ends.end), KineticEnergy(scene, ends.start) * (1 + 1e-3));
}

TEST_P(EveryModelThatSpins, RollingWithoutSlipStays) {
  Scene scene;
  scene.name = "rolling";
  scene.duration = 0.5;
  scene.steps = 240;
  scene.gravity = {0, -9.81};
  // A barrier needs a gap.
  const double gap = traits().push_gap > 0 && traits().compliant ? 5e-3 : 0;
  scene.bodies = {Spinning("ball", 0.1, 1, {0, 0.1 + gap}, {1, 0}, -10)};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0, .friction = traits().friction ? 0.3 : 0, .stiffness = 1e4, .damping = 20};
  const Ends ends = Run(scene);
  const double slack = CorrectsAnglesByItsSource() ? 0.01 : 1e-9;
  EXPECT_NEAR(ends.end[2], 1, slack);
  EXPECT_NEAR(ends.end[5], -10, 10 * slack);
}

// The derivative of a step with contact, against differences of it. Where it is published, that of velocities by
// velocities alone is meant as one.
TEST_P(EveryModelThatSpins, LinearizesItsStep) {
  for (const double spin : {30.0, -8.5}) {
    const Scene scene = DiscOnPlane(Friction(), spin, 40);
    const std::unique_ptr<Simulator> simulator = Make(scene);
    ASSERT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())));
    ASSERT_FALSE(simulator->touches().empty());
    const int size = simulator->state_size();
    std::vector<double> x(size), force(2), next(size), other(size);
    simulator->GetState(simulator->touches()[0].step, x);
    StepLinearization linearization;
    simulator->Linearize(x, force, /*with_parameters=*/false, &linearization);
    ASSERT_EQ(linearization.islands.size(), 1u);
    Eigen::MatrixXd A, B;
    linearization.ToDense(&A, &B);
    const std::vector<int> all{0, 1, 2, 3, 4, 5}, velocities{2, 3, 5};
    for (const int j : traits().published_jacobian ? velocities : all) {
      const double width = 1e-6;
      std::vector<double> moved = x;
      moved[j] = x[j] + width;
      simulator->Step(moved, force, next);
      moved[j] = x[j] - width;
      simulator->Step(moved, force, other);
      for (const int i : traits().published_jacobian ? velocities : all) {
        const double difference = (next[i] - other[i]) / (2 * width);
        EXPECT_NEAR(A(i, j), difference, 2e-5 * std::max(1.0, std::abs(difference))) << spin << " " << i << " " << j;
      }
    }
  }
}

std::vector<std::string> ModelsThatSpin() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) {
    if (ReasonNotApplicable(model.name, DiscOnPlane(0, 1)).empty()) names.emplace_back(model.name);
  }
  return names;
}

INSTANTIATE_TEST_SUITE_P(Registry, EveryModelThatSpins, testing::ValuesIn(ModelsThatSpin()),
                         [](const auto& tested) { return tested.param; });

TEST(SpinConformance, AllTurnButWhatSticksWhateverTouches) {
  EXPECT_EQ(ModelsThatSpin().size(), AllContactModels().size() - 1);
  EXPECT_NE(ReasonNotApplicable("static_lcp", DiscOnPlane(0, 1)), "");
}

// Whose law of impact is the exact one, with friction.
TEST(SpinConformance, RightModelsHaveTheExactImpulse) {
  for (const char* name : {"event", "lcp", "lcp_kkt", "qcqp", "ncp_restitution", "xpbd"}) {
    for (const double spin : {30.0, -2.0, -8.5}) {
      const Scene scene = DiscOnPlane(0.2, spin);
      const std::unique_ptr<Simulator> simulator = MakeSimulator(name, scene, Precision::kDouble);
      ASSERT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, scene.steps)));
      std::vector<double> start(6), end(6);
      simulator->GetState(0, start);
      simulator->GetState(scene.steps, end);
      const double normal = 1.8 * kMass * 2, slip = Slip(start.data());
      const double stop = kMass / (1 + kRadius * kRadius * kMass / kInertia) * std::abs(slip);
      const double tangential = -std::copysign(std::min(0.2 * normal, stop), slip);
      const Vec2d velocity =
          Vec2d(start[2], start[3]) + (normal * kNormal + tangential * Vec2d(Perpendicular(kNormal))) / kMass;
      EXPECT_NEAR(end[2], velocity[0], 1e-7) << name << " " << spin;
      EXPECT_NEAR(end[3], velocity[1], 1e-7) << name << " " << spin;
      EXPECT_NEAR(end[5], start[5] - kRadius * tangential / kInertia, 1e-6) << name << " " << spin;
    }
  }
}

// Error of the end state over starts that are a part of a step apart, as it depends on where in a step the impact is.
double MeanError(const char* name, int steps) {
  constexpr int kStarts = 16;
  double sum = 0;
  for (int j = 0; j < kStarts; ++j) {
    Scene scene = TwoDiscs(0.2, steps);
    scene.bodies[0].position += (j + 0.5) / kStarts * scene.dt() * scene.bodies[0].velocity;
    std::vector<double> ends[2];
    for (const int exact : {0, 1}) {
      const auto simulator = MakeSimulator(exact ? "event" : name, scene, Precision::kDouble);
      EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, steps))) << simulator->FailureReason();
      ends[exact].resize(simulator->state_size());
      simulator->GetState(steps, ends[exact]);
    }
    double worst = 0;
    for (std::size_t i = 0; i < ends[0].size(); ++i) worst = std::max(worst, std::abs(ends[0][i] - ends[1][i]));
    sum += worst / kStarts;
  }
  return sum;
}

TEST(SpinConformance, RightModelsConvergeToTheExactMotion) {
  for (const char* name : {"lcp", "qcqp", "ncp_restitution", "xpbd"}) {
    const double coarse = MeanError(name, 120), fine = MeanError(name, 960);
    const double order = std::log(coarse / fine) / std::log(8);
    RecordProperty(std::string(name) + "_order", std::to_string(order));
    EXPECT_GT(order, 0.8) << name << " " << coarse << " " << fine;
    EXPECT_LT(order, 1.3) << name << " " << coarse << " " << fine;
    EXPECT_LT(fine, 5e-3) << name;
  }
  EXPECT_LT(MeanError("lcp_kkt", 120), 2e-3);  // the gap in which it bounces
  EXPECT_LT(MeanError("lcp_kkt", 960), 2e-3);
}

}  // namespace
}  // namespace saltus
