// The effect of a displacement before a contact, beside that of the exact impact: two equal discs exchange it.
#include "audit/attribution/perturbed_flow.h"

#include <gtest/gtest.h>

#include "test_scenes.h"

namespace saltus {
namespace {

ContactError FirstWrong(const Scene& scene, const std::string& contact) {
  const Attribution attribution = AttributeError(contact, scene);
  EXPECT_GE(attribution.first_wrong, 0) << attribution.reason;
  return attribution.first_wrong < 0 ? ContactError() : attribution.contacts[attribution.first_wrong];
}

TEST(PerturbedFlow, EqualDiscsExchangeADisplacementAndAnImpulseAtAStepBoundaryDoesNot) {
  const Scene scene = ProblemScene("two_balls");
  const PerturbedFlows flows = PerturbAtContact(scene, "direct", FirstWrong(scene, "direct"));
  ASSERT_EQ(flows.exact.times.size(), flows.model.times.size());
  ASSERT_GT(flows.exact.times.size(), 4u);
  for (const PerturbedFlow* flow : {&flows.exact, &flows.model}) {
    EXPECT_DOUBLE_EQ(flow->first.front(), 1);
    EXPECT_EQ(flow->second.front(), 0);
  }
  // The force that is no longer on what moves on, and a normal that turns, add a little in the steps that follow.
  EXPECT_NEAR(flows.exact.first.back(), 0, 0.1);
  EXPECT_NEAR(flows.exact.second.back(), 1, 0.1);
  EXPECT_NEAR(flows.model.first.back(), 1, 0.1);
  EXPECT_NEAR(flows.model.second.back(), 0, 0.1);
}

TEST(PerturbedFlow, AWallHasNoSecondDisc) {
  const Scene scene = ProblemScene("ground_wall");
  const PerturbedFlows flows = PerturbAtContact(scene, "direct", FirstWrong(scene, "direct"));
  ASSERT_FALSE(flows.exact.times.empty());
  EXPECT_TRUE(flows.exact.second.empty());
  // The displacement that was ahead comes back behind, times the restitution.
  EXPECT_LT(flows.exact.first.back(), 0);
  EXPECT_GT(flows.model.first.back(), 0);
}

}  // namespace
}  // namespace saltus
