// Options of contact models, set behind their names.
#include "saltus/simulate/registry.h"

#include <gmock/gmock.h>

#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

TEST(Registry, NamesWithOptions) {
  EXPECT_EQ(Validate("event"), "");
  EXPECT_EQ(Validate("ncp:kappa=1e-6:kappa_grad=1e-4"), "");
  EXPECT_EQ(Validate("lcp_kkt:released_backward=1"), "");
  EXPECT_EQ(FindContactModel("ncp:kappa=1e-6")->name, "ncp");
  EXPECT_EQ(FindContactModel("nc:kappa=1e-6"), nullptr);
  EXPECT_TRUE(OptionsOf("event").empty());
  EXPECT_EQ(OptionsOf("ncp")[0].name, "kappa");
  EXPECT_EQ(OptionsOf("ncp")[0].initial, 1e-8);
}

TEST(Registry, SaysWhatIsWrong) {
  EXPECT_THAT(Validate("evnt"), HasSubstr("found 'evnt', expected a contact model: lcp, "));
  EXPECT_THAT(Validate("event:x=1"), HasSubstr("found 'x', expected no options of event"));
  EXPECT_THAT(Validate("ncp:kapa=1"), HasSubstr("found 'kapa', expected one of the options kappa, kappa_grad"));
  EXPECT_THAT(Validate("ncp:kappa"), HasSubstr("found 'kappa', expected kappa= and a number in 1e-12..1"));
  EXPECT_THAT(Validate("ncp:"), HasSubstr("found ''"));
  for (const char* wrong : {"xpbd:substeps=",
                            "xpbd:substeps=1.5",
                            "xpbd:substeps=0",
                            "xpbd:substeps=2x",
                            "xpbd:substeps=nan",
                            "xpbd:substeps=10001"}) {
    EXPECT_THAT(Validate(wrong), HasSubstr("a whole number in 1..10000")) << wrong;
  }
}

TEST(Registry, BiasIsThatOfTheValuesSet) {
  EXPECT_FALSE(HasBiasedDerivative("lcp_kkt"));
  EXPECT_FALSE(HasBiasedDerivative("lcp_kkt:force_once=1"));
  EXPECT_FALSE(HasBiasedDerivative("lcp_kkt:released_backward=0"));
  EXPECT_TRUE(HasBiasedDerivative("lcp_kkt:force_once=1:released_backward=1"));
  EXPECT_TRUE(HasBiasedDerivative("ncp:kappa_grad=1e-4"));
}

// Every option reaches its model, and the model's name its simulators.
TEST(Registry, OptionsChangeTheRollout) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  scene.steps = 9600;
  scene.bodies[0].velocity = {0.5, -5};  // slides slowly enough for smoothed friction to matter
  for (const ModelTraits& model : AllContactModels()) {
    for (const ListedOption& option : OptionsOf(model.name)) {
      EXPECT_GE(option.initial, option.low) << model.name << ":" << option.name;
      EXPECT_LE(option.initial, option.high) << model.name << ":" << option.name;
    }
  }
  const auto end_of = [&](const std::string& contact) {
    const auto simulator = MakeSimulator(contact, scene, Precision::kDouble);
    EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()))) << contact;
    std::vector<double> x(simulator->state_size());
    simulator->GetState(simulator->num_steps(), x);
    return x;
  };
  for (const char* contact : {"lcp_kkt:eps=1e-3",

                              "lcp_kkt:force_once=1",
                              "lcp_pgs:erp=0",
                              "lcp_pgs:cfm=0.1",
                              "lcp_pgs_adjoint:erp=0",
                              "ncp:kappa=1e-6",
                              "ncp_restitution:kappa=1e-6",
                              "soft_convex:damping=9",
                              "soft_convex:tangential_damping=9",
                              "soft_convex:impratio=3",
                              "soft_convex:dmin=0.5",
                              "soft_convex:dmax=0.9",
                              "soft_convex:width=0.01",
                              "smooth_compliant:exponent=2",
                              "smooth_compliant:reference_depth=0.02",
                              "smooth_compliant:reference_speed=1",

                              "smooth_compliant:substeps=2",
                              "ipc_barrier:range=0.005",
                              "ipc_barrier:kappa=1e4",
                              "ipc_barrier:substeps=2",
                              "ipc_barrier:trapezoidal=1",
                              "xpbd:compliance=1e-4",
                              "xpbd:substeps=2",
                              "xpbd:published_bound=1"}) {
    EXPECT_EQ(Validate(contact), "");
    EXPECT_NE(end_of(contact), end_of(std::string(FindContactModel(contact)->name))) << contact;
  }
}

}  // namespace
}  // namespace saltus
