// Limits of further formulations of contact as their parameters go to limits: some tend to exact impacts, some to
// plastic ones, and some to right motions with gradients that do not converge. Values of an independent implementation,
// to the digits it prints.
#include <gtest/gtest.h>

#include <cmath>

#include "saltus/audit/gradients.h"
#include "test_scenes.h"

namespace saltus {
namespace {

ModelGradient At(const std::string& contact, Scene scene, int steps, double stiffness = 1e4) {
  scene.steps = steps;
  scene.contact.stiffness = stiffness;
  const ModelGradient result = ComputeGradient(contact, scene, Precision::kDouble);
  EXPECT_TRUE(result.ok()) << contact << ": " << result.reason;
  return result;
}

constexpr int kPositionX = 0, kPositionY = 1, kVelocityX = 2, kVelocityY = 3, kOther = 4;

constexpr double kElasticLaunchLoss = 8.316138582;  // ground_wall without friction
constexpr double kPlasticStrikeLoss = 2.540735931;  // two_balls

// A contact may not pass on more than kappa: the loss is that of a plastic impact to first order in the step.
TEST(NcpLimits, PlasticToFirstOrder) {
  const Scene scene = ProblemScene("two_balls");
  const ModelGradient coarse = At("ncp:kappa=1e-12", scene, 480), fine = At("ncp:kappa=1e-12", scene, 4800);
  EXPECT_NEAR(coarse.loss, 2.536937, 1e-6);
  EXPECT_NEAR(fine.loss, 2.540356, 1e-6);
  EXPECT_NEAR((kPlasticStrikeLoss - coarse.loss) / (kPlasticStrikeLoss - fine.loss), 10, 0.2);
  EXPECT_NEAR(coarse.gradient.initial[kPositionX], -0.60702, 1e-5);
  EXPECT_NEAR(fine.gradient.initial[kPositionX], -0.60842, 1e-5);
}

// The force sets in with a jump of damping times speed, and what this does to the gradient does not shrink with the
// step: it grows with the stiffness, while the motion becomes exact.
TEST(SoftConvexLimits, RightMotionWrongGradient) {
  const Scene scene = ProblemScene("ground_wall");
  const double loss[] = {9.13, 8.57, 8.39, 8.33}, by_velocity[] = {-5.0, -10.1, -25.4, -135.7};
  for (int i = 0; i < 4; ++i) {
    const ModelGradient at = At("soft_convex:dmin=0.9999:dmax=0.9999", scene, 28800, std::pow(10, 4 + i));
    EXPECT_NEAR(at.loss, loss[i], 0.006);
    EXPECT_NEAR(at.gradient.initial[kVelocityX], by_velocity[i], 0.06);
  }
}

// Without the jump the gradient converges.
TEST(SoftConvexLimits, SmoothOnsetConverges) {
  const Scene scene = ProblemScene("two_balls");
  const std::string contact = "soft_convex:dmin=1e-4:width=0.01";
  const ModelGradient soft = At(contact, scene, 48000), stiff = At(contact, scene, 48000, 1e5);
  EXPECT_NEAR(soft.gradient.initial[kPositionX], -0.4540, 1e-4);
  EXPECT_NEAR(soft.gradient.initial[kOther + kPositionX], -0.3036, 1e-4);
  EXPECT_NEAR(soft.gradient.initial[kVelocityX], -0.5358, 1e-4);
  EXPECT_NEAR(stiff.gradient.initial[kPositionX], -0.4153, 1e-4);
  EXPECT_NEAR(stiff.gradient.initial[kOther + kPositionX], -0.3169, 1e-4);
  const double exact = -0.398668;
  EXPECT_LT(std::abs(stiff.gradient.initial[kPositionX] - exact),
            0.5 * std::abs(soft.gradient.initial[kPositionX] - exact));
}

// Implicit Euler damps less and less: from nearly plastic to elastic, and the gradient with it.
TEST(IpcBarrierLimits, ElasticAsTheStepGoesToZero) {
  const Scene scene = ProblemScene("bounce_once");
  const double loss[] = {0.413, 1.017, 1.184}, by_position[] = {0.69, -0.944, -0.982},
               by_velocity[] = {0.21, -0.834, -0.971};
  for (int i = 0; i < 3; ++i) {
    const ModelGradient at = At("ipc_barrier:substeps=1", scene, 480 * static_cast<int>(std::pow(10, i)));
    EXPECT_NEAR(at.loss, loss[i], 6e-4);
    EXPECT_NEAR(at.gradient.initial[kPositionY], by_position[i], i == 0 ? 6e-3 : 6e-4);
    EXPECT_NEAR(at.gradient.initial[kVelocityY], by_velocity[i], i == 0 ? 6e-3 : 6e-4);
  }
}

// The trapezoidal rule does not damp: within a percent of the exact gradient.
TEST(IpcBarrierLimits, TrapezoidalRuleIsElastic) {
  const std::string contact = "ipc_barrier:trapezoidal=1:substeps=1";
  const ModelGradient at = At(contact, ProblemScene("two_balls"), 48000);
  EXPECT_NEAR(at.loss, 2.05758, 1e-5);
  EXPECT_NEAR(at.gradient.initial[kPositionX], -0.3956, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kOther + kPositionX], -0.3222, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kVelocityX], -0.4948, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kOther + kVelocityX], -0.2230, 1e-4);
}

// Springs with the same dissipation as they stiffen, with so many substeps that these do not matter.
TEST(SmoothCompliantLimits, ExactAsStiffnessGrows) {
  const Scene scene = ProblemScene("two_balls");
  const double loss[] = {2.1958, 2.1049, 2.0761, 2.0657}, first[] = {-0.642, -0.485, -0.4317, -0.4134},
               second[] = {-0.247, -0.296, -0.3115, -0.3156};
  for (int i = 0; i < 4; ++i) {
    // With the exponent 1.5 the law's factor is ten times the stiffness.
    const ModelGradient at = At("smooth_compliant:exponent=1.5:substeps=100", scene, 480, 0.1 * std::pow(10, 3 + i));
    EXPECT_NEAR(at.loss, loss[i], 1e-4);
    EXPECT_NEAR(at.gradient.initial[kPositionX], first[i], i < 2 ? 1e-3 : 1e-4);
    EXPECT_NEAR(at.gradient.initial[kOther + kPositionX], second[i], i < 2 ? 1e-3 : 1e-4);
  }
}

// Projections forget the position, however many substeps there are.
TEST(XpbdLimits, SubstepsDoNotRepairTheGradient) {
  const ModelGradient at = At("xpbd:substeps=1000", ProblemScene("two_balls"), 480);
  EXPECT_NEAR(at.gradient.initial[kPositionX], -0.3600, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kOther + kPositionX], -0.3600, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kVelocityX], -0.4710, 1e-4);
  EXPECT_NEAR(at.gradient.initial[kOther + kVelocityX], -0.2489, 1e-4);
}

// The published bound of friction hangs on the depth of one substep, so its derivative grows with their number.
TEST(XpbdLimits, PublishedFrictionBoundDiverges) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  const int substeps[] = {1, 10, 50, 100};
  const double loss[] = {8.60, 9.51, 8.82, 9.21}, by_velocity[] = {-15, -882, -19562, -87741};
  for (int i = 0; i < 4; ++i) {
    const ModelGradient at = At("xpbd:published_bound=1:substeps=" + std::to_string(substeps[i]), scene, scene.steps);
    EXPECT_NEAR(at.loss, loss[i], 0.006);
    // Ill-conditioned: 1e-8 m/s at the start change it by half a percent with 100 substeps.
    EXPECT_NEAR(at.gradient.initial[kVelocityY], by_velocity[i], i < 2 ? 0.6 : 3e-3 * std::abs(by_velocity[i]));
  }
}

// A step corrects an overlap by a velocity of erp / h times it: its derivative grows with the number of steps.
TEST(LcpPgsLimits, CorrectionOfOverlapsDiverges) {
  const Scene scene = BounceOffTheGrid();
  const double coarse = At("lcp_pgs", scene, 480).gradient.initial[kPositionY];
  const double fine = At("lcp_pgs", scene, 4800).gradient.initial[kPositionY];
  EXPECT_NEAR((fine - 1) / (coarse - 1), 10, 0.1);
}

// With finer impacts the loss becomes exact, and the gradient stays that of frozen impact times.
TEST(LcpKktLimits, RightMotionWrongGradient) {
  const Scene scene = ProblemScene("ground_wall");
  const double loss[] = {8.3084, 8.3135, 8.3140, 8.3141};
  const char* eps[] = {"1e-3", "1e-4", "1e-5", "2e-6"};
  for (int i = 0; i < 4; ++i) {
    const ModelGradient at = At(std::string("lcp_kkt:eps=") + eps[i], scene, scene.steps);
    EXPECT_NEAR(at.loss, loss[i], 1e-4);
    EXPECT_LT(std::abs(at.loss - kElasticLaunchLoss), 0.008);
    EXPECT_NEAR(at.gradient.initial[kVelocityX], 1.57, 0.01);  // exact: -3.17
  }
}

}  // namespace
}  // namespace saltus
