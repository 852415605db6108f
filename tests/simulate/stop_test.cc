// Simulators that are told to stop.
#include <gtest/gtest.h>

#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

TEST(Stop, EveryModelStopsInTheMiddleAndRunsAsBeforeAfterwards) {
  const Scene scene = ProblemScene("two_balls");
  for (const ModelTraits& model : AllContactModels()) {
    const auto make = [&] { return MakeSimulator(model.name, scene, Precision::kDouble); };
    SingleShooting fresh(make()), stopped(make());
    const std::vector<double>& z = fresh.initial_guess();
    double expected_loss = 0, loss = 0;
    std::vector<double> expected(z.size()), gradient(z.size());
    ASSERT_TRUE(fresh.Evaluate(z, &expected_loss, expected.data()));

    int asked = 0, most = 1 << 30;
    const auto count = [&] { return ++asked > most; };
    stopped.set_stop(count);
    ASSERT_TRUE(stopped.Evaluate(z, &loss, nullptr));
    const int by_rollout = asked;
    asked = 0;
    ASSERT_TRUE(stopped.Evaluate(z, &loss, gradient.data()));
    const int by_both = asked;
    EXPECT_GT(by_rollout, 1) << model.name;
    EXPECT_GT(by_both, by_rollout) << model.name;  // the adjoint asks too

    for (most = 0; most < by_both; most += 1 + most / 2) {
      asked = 0;
      EXPECT_FALSE(stopped.Evaluate(z, &loss, gradient.data())) << model.name << " at question " << most;
      EXPECT_LE(asked, most + 4) << model.name;  // it does not go on
    }
    stopped.set_stop(nullptr);
    ASSERT_TRUE(stopped.Evaluate(z, &loss, gradient.data()));
    EXPECT_EQ(loss, expected_loss) << model.name;
    EXPECT_EQ(gradient, expected) << model.name;
  }
}

}  // namespace
}  // namespace saltus
