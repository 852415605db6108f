// Batches against one evaluation after the other.
#include "saltus/control/batch.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <map>
#include <mutex>
#include <set>

#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

constexpr int kPoints = 97;

std::vector<double> ManyPoints(const std::vector<double>& guess) {
  std::vector<double> points;
  for (int i = 0; i < kPoints; ++i) {
    for (size_t j = 0; j < guess.size(); ++j) points.push_back(guess[j] + 0.3 * std::sin(0.7 * i + 0.01 * j));
  }
  return points;
}

class BatchOf : public testing::TestWithParam<std::string> {};

TEST_P(BatchOf, HasTheBitsOfSingleEvaluations) {
  const Scene scene = FourDiscs(0);
  SingleShooting shooting(MakeSimulator(GetParam(), scene, Precision::kDouble));
  const size_t size = shooting.num_variables();
  const std::vector<double> points = ManyPoints(shooting.initial_guess());
  std::vector<double> losses(kPoints), gradients(points.size());
  for (int i = 0; i < kPoints; ++i) {
    ASSERT_TRUE(shooting.Evaluate({&points[i * size], size}, &losses[i], &gradients[i * size]));
  }
  ASSERT_GT(std::set<double>(losses.begin(), losses.end()).size(), 90u);
  for (int threads : {1, 2, 5}) {
    SCOPED_TRACE(threads);
    Batch batch(GetParam(), scene, Precision::kDouble, threads);
    EXPECT_EQ(batch.num_threads(), threads);
    std::vector<double> batch_losses(kPoints), batch_gradients(points.size()), losses_only(kPoints);
    batch.Evaluate(points, batch_losses, batch_gradients);
    EXPECT_EQ(batch_losses, losses);
    EXPECT_EQ(batch_gradients, gradients);
    batch.Evaluate(points, losses_only);
    EXPECT_EQ(losses_only, losses);
  }
}

INSTANTIATE_TEST_SUITE_P(SomeModels, BatchOf, testing::Values("direct_toi", "compliant_warp", "pbd_brax", "event"),
                         [](const auto& test) { return test.param; });

TEST(Batch, PointsWithoutALossAreNaN) {
  const Scene scene = ProblemScene("two_balls");
  Batch batch("direct_toi", scene, Precision::kDouble, 2);
  std::vector<double> points = InitialControl(scene, scene.steps);
  const size_t size = points.size();
  points.resize(3 * size, 1.0);
  points[size + 5] = std::nan("");
  std::vector<double> losses(3), gradients(points.size());
  batch.Evaluate(points, losses, gradients);
  EXPECT_TRUE(std::isfinite(losses[0]) && std::isfinite(losses[2]));
  EXPECT_TRUE(std::isnan(losses[1]) && std::isnan(gradients[size]) && std::isnan(gradients[2 * size - 1]));
  EXPECT_TRUE(std::isfinite(gradients[size - 1]) && std::isfinite(gradients[2 * size]));
}

TEST(Batch, EveryJobRunsOnceAndAlone) {
  Batch batch("direct_toi", ProblemScene("two_balls"), Precision::kDouble, 4);
  std::vector<int> runs(1000);
  std::atomic<int> busy[4] = {};
  std::atomic<bool> shared = false;
  std::map<const SingleShooting*, int> index;
  std::mutex mutex;
  batch.ForEach(1000, [&](SingleShooting* shooting, int i) {
    int at;
    {
      const std::lock_guard lock(mutex);
      at = index.emplace(shooting, static_cast<int>(index.size())).first->second;
    }
    if (busy[at]++ != 0) shared = true;
    ++runs[i];
    --busy[at];
  });
  EXPECT_EQ(runs, std::vector<int>(1000, 1));
  EXPECT_FALSE(shared);
}

}  // namespace
}  // namespace saltus
