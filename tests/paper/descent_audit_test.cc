// The audit along gradient descent, on a ball that is thrown, bounces once and should end at a place: exact losses and
// gradients in closed form, those of contact models by differences of their losses.
#include <gmock/gmock.h>

#include <cmath>
#include <numbers>

#include "paper/experiments.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;

constexpr double kHeight = 1.2, kRadius = 0.25, kGravity = 8, kRestitution = 0.8;
constexpr double kTarget[2] = {2.9, 1};
constexpr double kRate = 0.01;  // of the published descent in velocities

Scene Thrown() {
  Scene scene;
  scene.name = "thrown";
  scene.duration = 1;
  scene.steps = 61;
  scene.gravity = {0, -kGravity};
  Body ball;
  ball.name = "ball";
  ball.radius = kRadius;
  ball.mass = 1;
  ball.position = {0, kHeight};
  ball.velocity = {3, 0.2};
  scene.bodies = {ball};
  Plane ground;
  ground.name = "ground";
  ground.point = {0, 0};
  ground.normal = {0, 1};
  scene.planes = {ground};
  scene.contact.restitution = kRestitution;
  TerminalTerm term;
  term.body = 0;
  term.target = {kTarget[0], kTarget[1]};
  scene.objective.terminal = {term};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  return scene;
}

double ExactLoss(const std::vector<double>& v) {
  const double impact = (v[1] + std::sqrt(v[1] * v[1] + 2 * kGravity * (kHeight - kRadius))) / kGravity;
  const double rebound = kRestitution * (kGravity * impact - v[1]), left = 1 - impact;
  const double x = v[0], y = kRadius + rebound * left - kGravity / 2 * left * left;
  return (x - kTarget[0]) * (x - kTarget[0]) + (y - kTarget[1]) * (y - kTarget[1]);
}

template <typename Loss>
std::vector<double> Differences(const Loss& loss, const std::vector<double>& z) {
  std::vector<double> gradient;
  for (size_t i = 0; i < z.size(); ++i) {
    std::vector<double> more = z, less = z;
    more[i] += 1e-6;
    less[i] -= 1e-6;
    gradient.push_back((loss(more) - loss(less)) / 2e-6);
  }
  return gradient;
}

// Degrees.
double Angle(const std::vector<double>& a, const std::vector<double>& b) {
  return std::abs(std::atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])) * 180 / std::numbers::pi;
}

class Along : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const auto audit =
        AuditDescents({{"Throw", Thrown()}}, {"event", "direct", "pbd_warp", "ncp"}, {"ncp"}, 2, ProgressMode::kNone);
    ASSERT_TRUE(audit.has_value());
    audit_ = new Section(*audit);
  }

  // Returns a series of the panel 0 (angles), 1 (exact losses) or 2 (losses).
  static Series Find(size_t panel, const std::string& contact) {
    for (const Series& series : audit_->figures.at(0).figure.panels.at(panel).series) {
      if (series.label == contact) return series;
    }
    return {};
  }

  static Section* audit_;
};

Section* Along::audit_ = nullptr;

TEST_F(Along, ExactDynamicsFollowTheClosedForm) {
  const Series exact = Find(1, "event"), own = Find(2, "event"), angle = Find(0, "event");
  ASSERT_GT(exact.x.size(), 20u);
  EXPECT_EQ(exact.x.back(), 1001);
  std::vector<double> z = {3, 0.2};
  size_t next = 0;
  for (int k = 1; k <= 1001; ++k) {
    if (next < exact.x.size() && exact.x[next] == k) {
      EXPECT_NEAR(exact.y[next], ExactLoss(z), 1e-7) << k;
      EXPECT_NEAR(own.y[next], exact.y[next], 1e-12) << k;
      if (exact.y[next] > 1e-6) {
        EXPECT_NEAR(angle.y[next], 0, 1e-4) << k;
      }
      ++next;
    }
    const std::vector<double> gradient = Differences(ExactLoss, z);
    for (size_t i = 0; i < z.size(); ++i) z[i] -= kRate * gradient[i];
  }
  EXPECT_EQ(next, exact.x.size());
}

TEST_F(Along, AnglesOfModelsAreThoseOfTheirDifferences) {
  for (const std::string contact : {"direct", "pbd_warp"}) {
    SCOPED_TRACE(contact);
    SingleShooting shooting(MakeSimulator(contact, Thrown(), Precision::kDouble));
    const auto loss = [&](const std::vector<double>& z) {
      double value = 0;
      EXPECT_TRUE(shooting.Evaluate(z, &value, nullptr));
      return value;
    };
    const Series angle = Find(0, contact), exact = Find(1, contact), own = Find(2, contact);
    ASSERT_GT(angle.x.size(), 20u);
    std::vector<double> z = {3, 0.2};
    for (size_t k = 0; k < 3; ++k) {  // the first of them are all looked at
      ASSERT_EQ(angle.x[k], static_cast<double>(k + 1));
      const std::vector<double> gradient = Differences(loss, z);
      EXPECT_NEAR(angle.y[k], Angle(gradient, Differences(ExactLoss, z)), 1e-3);
      EXPECT_NEAR(own.y[k], loss(z), 1e-7);
      EXPECT_NEAR(exact.y[k], ExactLoss(z), 1e-7);
      for (size_t i = 0; i < z.size(); ++i) z[i] -= kRate * gradient[i];
    }
    EXPECT_GT(angle.y[0], 0.1);  // both are wrong here
  }
}

TEST_F(Along, WhatIsSaidIsWhatTheNumbersSay) {
  EXPECT_TRUE(Find(0, "ncp").x.empty());
  const std::vector<std::string> findings = audit_->findings;
  EXPECT_THAT(findings, Contains(AllOf(HasSubstr("Left out"), HasSubstr("`ncp`"))));
  const auto named_before = [](const std::string& text, const std::string& contact, const std::string& mark) {
    return text.find("`" + contact + "`") < text.find(mark);
  };
  for (const std::string contact : {"event", "direct", "pbd_warp"}) {
    EXPECT_EQ(named_before(findings[0], contact, ", and larger"), Find(0, contact).y.front() < 90) << contact;
    const Series exact = Find(1, contact);
    double least = exact.y.front();
    for (const std::string other : {"event", "direct", "pbd_warp"}) {
      for (const double loss : Find(1, other).y) least = std::min(least, loss);
    }
    const bool gained = exact.y.front() - exact.y.back() >= 0.95 * (exact.y.front() - least);
    EXPECT_EQ(named_before(findings[1], contact, "; and"), gained) << contact;
  }
}

}  // namespace
}  // namespace saltus
