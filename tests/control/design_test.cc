// Gradients by the design parameters of a scene, against central differences of fourth order of the loss, and against a
// symmetry: to move a wall along its normal is to move all else the other way.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

SingleShooting Shooting(const Scene& scene, const std::string& contact) {
  return SingleShooting(MakeSimulator(contact, scene, Precision::kDouble),
                        SingleShooting::Variables::kOptimized,
                        [contact](const Scene& other) { return MakeSimulator(contact, other, Precision::kDouble); });
}

void AddDesign(const std::string& names, Scene* scene) {
  std::size_t begin = 0;
  while (begin < names.size()) {
    const std::size_t end = std::min(names.find(' ', begin), names.size());
    const std::vector<SceneParameter> found = ParametersNamed(names.substr(begin, end - begin), *scene);
    EXPECT_FALSE(found.empty()) << names.substr(begin, end - begin);
    for (const SceneParameter& parameter : found) scene->design.push_back({parameter});
    begin = end + 1;
  }
}

// The derivative of the loss by variable i.
double Difference(SingleShooting* shooting, std::vector<double> z, std::size_t i, double step) {
  const double at = z[i];
  double sum = 0;
  for (const auto& [node, weight] : {std::pair(-2, 1. / 12), {-1, -8. / 12}, {1, 8. / 12}, {2, -1. / 12}}) {
    z[i] = at + node * step;
    double loss = 0;
    EXPECT_TRUE(shooting->Evaluate(z, &loss, nullptr)) << shooting->FailureReason();
    sum += weight * loss;
  }
  return sum / step;
}

// Compares the derivatives by all variables; of a control only the first and the last.
void ExpectGradient(const Scene& scene, const std::string& contact, double step, double tolerance) {
  SCOPED_TRACE(contact + " on " + scene.name);
  ASSERT_EQ(ReasonNotApplicable(contact, scene), "");
  SingleShooting shooting = Shooting(scene, contact);
  ASSERT_EQ(shooting.num_design(), static_cast<int>(scene.design.size()));
  std::vector<double> z = shooting.initial_guess(), gradient(z.size());
  const std::size_t first = z.size() - scene.design.size();
  double loss = 0;
  // From a design that is not the scene's.
  for (std::size_t i = first; i < z.size(); ++i) z[i] += 1e-3 * std::cos(3.0 * static_cast<double>(i - first));
  ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data())) << shooting.FailureReason();
  for (std::size_t i = 0; i < z.size(); ++i) {
    if (i > 0 && i + 1 < first) continue;
    SCOPED_TRACE(i < first ? "control " + std::to_string(i) : NameOf(scene.design[i - first].parameter, scene));
    const double expected = Difference(&shooting, z, i, step);
    EXPECT_NEAR(gradient[i], expected, tolerance * std::max(1.0, std::abs(expected)));
    if (i >= first) {
      EXPECT_NE(gradient[i], 0);
    }
  }
}

// A disc is pushed against a fixed one, a plane and a segment, and strikes another.
Scene Obstacles(double friction) {
  Scene scene;
  scene.name = friction > 0 ? "obstacles_with_friction" : "obstacles";
  scene.duration = 1.1;
  scene.steps = 97;
  scene.gravity = {0.3, -1};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 0.8, .position = {-1, 0.6}, .velocity = {2.4, -2}},
                  {.name = "post", .radius = 0.15, .fixed = true, .position = {0.05, 0.62}},
                  {.name = "target", .radius = 0.12, .mass = 1.4, .position = {-0.62, 0.9}, .velocity = {0.2, -0.9}}};
  scene.planes = {{"ground", {0, 0}, {0.1, 1}}};
  scene.segments = {{"gate", {-1.3, 0.2}, {-1.2, 1.4}}};
  scene.contact = {.restitution = 0.8, .friction = friction, .stiffness = 8000, .damping = 3};
  scene.control = {{0}, {{0.3, 0.2}}};
  scene.objective.terminal = {{.body = 0, .target = {0.2, 0.9}, .weight = 1.5},
                              {.body = 2, .target = {-0.4, 0.1}, .weight = 0.7}};
  scene.objective.effort = 0.02;
  scene.optimize = Optimize::kControl;
  return scene;
}

TEST(Design, GradientsOfTheExactModelAreThoseOfTheLoss) {
  Scene scene = Obstacles(0);
  AddDesign(
      "restitution gravity mass.ball mass.target radius.ball radius.post radius.target position.post "
      "offset.ground angle.ground",
      &scene);
  ExpectGradient(scene, "event", 2e-4, 1e-8);
}

TEST(Design, GradientsByFrictionToo) {
  Scene scene = Obstacles(0.2);
  AddDesign("friction restitution mass.ball radius.ball radius.target position.post offset.ground angle.ground",
            &scene);
  ExpectGradient(scene, "event", 2e-4, 1e-8);
}

TEST(Design, GradientsOfSolidDiscsCountTheirInertia) {
  Scene scene = Obstacles(0.05);
  for (Body& body : scene.bodies) {
    if (!body.fixed) body.inertia.kind = Inertia::Kind::kSolid;
  }
  AddDesign("friction mass.ball mass.target radius.ball radius.target position.post offset.ground", &scene);
  ExpectGradient(scene, "event", 2e-5, 1e-8);
}

// One ball between a segment and the ground.
Scene Gate() {
  Scene scene;
  scene.name = "gate";
  scene.duration = 1;
  scene.steps = 83;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {-1, 1}, .velocity = {2, -2}}};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.segments = {{"gate", {0, -0.5}, {0.3, 2}}};
  scene.contact.restitution = 0.7;
  scene.objective.terminal = {{.body = 0, .target = {-0.2, 0.7}}};
  return scene;
}

TEST(Design, GradientsBySegmentsAreThoseOfTheLoss) {
  for (const std::string name : {"offset.gate", "angle.gate"}) {
    Scene scene = Gate();
    AddDesign(name + " offset.ground radius.ball restitution", &scene);
    ExpectGradient(scene, "event", 2e-4, 1e-8);
  }
}

TEST(Design, GradientsOfStepModelsAreThoseOfTheirLoss) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[0].position = {-2, -1.9};
  scene.contact.restitution = 0.9;
  AddDesign("restitution mass.striker mass.target radius.target radius.striker", &scene);
  ExpectGradient(scene, "event", 1e-4, 1e-8);
  ExpectGradient(scene, "direct_toi", 1e-7, 1e-6);
  scene.design.clear();
  scene.contact.damping = 2;
  AddDesign("stiffness damping mass.striker mass.target radius.target", &scene);
  ExpectGradient(scene, "compliant_warp", 1e-5, 1e-6);
}

TEST(Design, MovingThePlaneIsMovingAllElse) {
  Scene scene = BounceOffTheGrid();
  scene.contact.restitution = 0.6;
  AddDesign("offset.ground", &scene);
  SingleShooting shooting = Shooting(scene, "event");
  double loss = 0;
  std::vector<double> z = shooting.initial_guess(), gradient(z.size());
  Sensitivity all;
  ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
  ASSERT_TRUE(shooting.EvaluateAll(z, &loss, &all));
  // The loss is the final height: moved along with the ground, the ball ends as much higher.
  EXPECT_NEAR(gradient.back(), 1 - all.initial[1], 1e-9);
  EXPECT_NEAR(gradient.back(), 1.6, 1e-9);  // in closed form, 1 + e
}

TEST(Design, IsAVariableOfPathCostsInExactDynamicsOnly) {
  Scene scene = ProblemScene("two_balls");
  AddDesign("mass.target", &scene);
  EXPECT_EQ(Shooting(scene, "direct_toi").num_design(), 1);
  scene.objective.via = {{.body = 0, .time = 0.5}};
  EXPECT_EQ(Shooting(scene, "event").num_design(), 1);
  EXPECT_EQ(Shooting(scene, "direct_toi").num_design(), 0);
}

TEST(Design, ValuesOutOfBoundsHaveNoLoss) {
  Scene scene = Gate();
  AddDesign("offset.gate", &scene);
  scene.design[0].max = 0.1;
  SingleShooting shooting = Shooting(scene, "event");
  double loss = 0;
  EXPECT_TRUE(shooting.Evaluate(std::vector{0.1}, &loss, nullptr));
  EXPECT_FALSE(shooting.Evaluate(std::vector{0.1001}, &loss, nullptr));
  EXPECT_EQ(shooting.FailureReason(), "offset.gate is out of its bounds");
}

}  // namespace
}  // namespace saltus
