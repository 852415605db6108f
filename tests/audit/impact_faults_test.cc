// The closed form of one impact against the event-driven model, which knows nothing of it.
#include <gtest/gtest.h>

#include "audit/attribution/step_map.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kStep = 0.05;

// Two discs (the second may be fixed) or a disc and a plane, which meet `before` seconds into a step of kStep.
struct Meeting {
  bool plane = false;
  bool fixed = false;
  double restitution = 0.8, friction = 0;
  Vec2d velocity = {1, -2};  // of the first at the impact
  double before = 0.02;
  bool spins = false;
};

struct Case {
  PairImpact impact;
  Eigen::MatrixXd exact;  // over the discs that move, from the event-driven model
  ContactMode mode;
};

Case Build(const Meeting& meeting) {
  const Vec2d force_a(2, -3), force_b(-1, 0.5), gravity(0.3, -4);
  Scene scene;
  scene.name = "meeting";
  scene.duration = kStep;
  scene.gravity = gravity;
  scene.contact.restitution = meeting.restitution;
  scene.contact.friction = meeting.friction;
  scene.bodies = {{.name = "a", .radius = 0.3, .mass = 1.5, .position = {0, 9}},
                  {.name = "b", .radius = 0.2, .mass = 0.7, .fixed = meeting.fixed, .position = {30, 40}}};
  if (meeting.plane) scene.planes = {{"slope", {0, 0}, {0.6, 0.8}}};
  if (meeting.spins) {
    scene.bodies[0].inertia = {Inertia::Kind::kSolid};
    if (!meeting.fixed) scene.bodies[1].inertia = {Inertia::Kind::kGiven, 0.02};
  }
  scene.control = {{0}, {force_a}};
  if (!meeting.fixed) scene.control = {{0, 1}, {force_a, force_b}};

  Case out;
  PairImpact& impact = out.impact;
  impact.normal = {0.6, 0.8};
  impact.restitution = meeting.restitution;
  impact.friction = meeting.friction;
  impact.before = meeting.before;
  impact.after = kStep - meeting.before;
  impact.step = kStep;
  impact.inverse_mass_a = 1 / 1.5;
  impact.velocity_a = meeting.velocity;
  impact.acceleration_a = force_a / 1.5 + gravity;
  impact.velocity_b = impact.acceleration_b = Vec2d::Zero();
  Vec2d at_a(0.3 * impact.normal), at_b(30, 40);
  if (!meeting.plane) {
    at_a = Vec2d(1, 2);
    at_b = at_a - 0.5 * impact.normal;
    impact.inverse_distance = 2;
  }
  if (!meeting.plane && !meeting.fixed) {
    impact.inverse_mass_b = 1 / 0.7;
    impact.velocity_b = {0.4, 0.3};
    impact.acceleration_b = force_b / 0.7 + gravity;
  }
  // Back to the begin of the step.
  const double t = meeting.before;
  const auto begin = [t](const Vec2d& p, const Vec2d& v, const Vec2d& a) {
    return std::array<double, 4>{
        p[0] - t * v[0] + 0.5 * t * t * a[0], p[1] - t * v[1] + 0.5 * t * t * a[1], v[0] - t * a[0], v[1] - t * a[1]};
  };
  std::vector<double> x;
  for (double value : begin(at_a, impact.velocity_a, impact.acceleration_a)) x.push_back(value);
  if (meeting.spins) x.insert(x.end(), {0.3, 4});
  for (double value : begin(at_b, impact.velocity_b, impact.acceleration_b)) x.push_back(value);
  if (meeting.spins) x.insert(x.end(), {-0.1, meeting.fixed ? 0.0 : 3.0});
  if (meeting.spins) {
    impact.spins = true;
    impact.radius = {0.3, meeting.plane ? 0.0 : 0.2};
    impact.inverse_inertia[0] = 1 / (0.5 * 1.5 * 0.3 * 0.3);
    impact.spin[0] = 4;
    if (impact.inverse_mass_b > 0) impact.inverse_inertia[1] = 1 / 0.02;
    if (impact.inverse_mass_b > 0) impact.spin[1] = 3;
  }
  const std::vector<double> force = {force_a[0], force_a[1], force_b[0], force_b[1]};

  const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
  std::vector<double> next(x.size());
  std::vector<Touch> touches;
  simulator->Step(x, force, next, &touches);
  EXPECT_EQ(touches.size(), 1u);
  if (touches.empty()) return out;
  EXPECT_NEAR(touches[0].time, meeting.before, 1e-12);
  impact.mode = out.mode = touches[0].mode;
  StepLinearization linearization;
  simulator->Linearize(x, force, false, &linearization);
  Eigen::MatrixXd A, B;
  linearization.ToDense(&A, &B);
  const int size = (meeting.spins ? 6 : 4) * impact.num_moving();
  out.exact = A.topLeftCorner(size, size);
  return out;
}

TEST(ImpactFaults, TheClosedFormIsThatOfTheEventDrivenModel) {
  for (const bool plane : {false, true}) {
    for (const bool fixed : {false, true}) {
      if (plane && fixed) continue;
      for (const double restitution : {1.0, 0.6, 0.2}) {
        for (const double friction : {0.0, 0.03, 5.0}) {
          for (const bool spins : {false, true}) {
            const Case c = Build(
                {.plane = plane, .fixed = fixed, .restitution = restitution, .friction = friction, .spins = spins});
            EXPECT_EQ(c.mode,
                      friction == 0   ? ContactMode::kFrictionless
                      : friction == 5 ? ContactMode::kStick
                                      : ContactMode::kSlip);
            const Eigen::MatrixXd closed = LinearizeImpact(c.impact, ExactTerms(c.impact));
            EXPECT_LT((closed - c.exact).norm(), 1e-10 * c.exact.norm())
                << "plane " << plane << " fixed " << fixed << " e " << restitution << " mu " << friction << " spins "
                << spins;
          }
        }
      }
    }
  }
}

TEST(ImpactFaults, AnExactMapHasNoFault) {
  const Case c = Build({});
  Eigen::MatrixXd almost = c.exact;
  almost(0, 1) += 1e-9;
  EXPECT_EQ(RecogniseFault(c.impact, almost, 1), std::nullopt);
}

// Dropped terms of spin are named too, for impacts that stick.
TEST(ImpactFaults, NamesWhatWasDroppedOfSpin) {
  const Case c = Build({.restitution = 0.7, .friction = 5, .spins = true});
  const auto recognise = [&](const auto& drop) {
    ImpactTerms terms = ExactTerms(c.impact);
    drop(&terms);
    const Eigen::MatrixXd map = LinearizeImpact(c.impact, terms);
    return RecogniseFault(c.impact, map + 0.02 * (map - c.exact).cwiseAbs(), 1).value_or("none");
  };
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->turns = false; }), "friction does not turn the discs");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->rims = false; }), "friction follows the centres and not the rims");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->turns = t->rims = false; }), "spin has no part in friction");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->restitution = 0; }), "restitution ignored");
}

// Faults are recognised below a model's own error of first order, and told apart from each other.
TEST(ImpactFaults, NamesWhatWasDropped) {
  const Case c = Build({.restitution = 0.7});
  const auto recognise = [&](const auto& drop) {
    ImpactTerms terms = ExactTerms(c.impact);
    drop(&terms);
    const Eigen::MatrixXd map = LinearizeImpact(c.impact, terms);
    return RecogniseFault(c.impact, map + 0.05 * (map - c.exact).cwiseAbs(), 1).value_or("none");
  };
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->acceleration = false; }), "acceleration at the impact ignored");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->restitution = 0.49; }), "restitution squared");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->restitution = 0; }), "restitution ignored");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->normal = ImpactTerms::Normal::kFrozen; }), "normal frozen");
  EXPECT_EQ(recognise([](ImpactTerms* t) {
              t->restitution = 0;
              t->normal = ImpactTerms::Normal::kFrozen;
            }),
            "restitution ignored; normal frozen");
  EXPECT_EQ(recognise([](ImpactTerms* t) { t->position_shift = -3; }), "none");
}

TEST(ImpactFaults, NamesForgottenFriction) {
  const Case c = Build({.friction = 0.4});
  ImpactTerms terms = ExactTerms(c.impact);
  terms.law = ImpactTerms::Friction::kNone;
  EXPECT_EQ(RecogniseFault(c.impact, LinearizeImpact(c.impact, terms), 1), "friction ignored");
}

}  // namespace
}  // namespace saltus
