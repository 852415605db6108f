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

std::vector<double> ManyPoints(const std::vector<double>& guess, int count) {
  std::vector<double> points;
  for (int i = 0; i < count; ++i) {
    for (size_t j = 0; j < guess.size(); ++j) points.push_back(guess[j] + 0.3 * std::sin(0.7 * i + 0.01 * j));
  }
  return points;
}

// A batch of the first so many points.
struct Results {
  std::vector<double> losses, gradients;
  bool operator==(const Results&) const = default;
};
Results Evaluate(Batch* batch, const std::vector<double>& points, int count, bool with_gradients) {
  const size_t size = count * static_cast<size_t>(batch->num_variables());
  Results results{std::vector<double>(count), std::vector<double>(with_gradients ? size : 0)};
  batch->Evaluate(std::span(points).first(size), results.losses, results.gradients);
  return results;
}

// Batches of any size have the bits of single evaluations, with and without gradients, for any number of threads.
void ExpectSameBits(const std::string& contact, const Scene& scene, std::size_t memory_limit = std::size_t{1} << 30) {
  constexpr int kPoints = 11;
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble));
  const size_t size = shooting.num_variables();
  const std::vector<double> points = ManyPoints(shooting.initial_guess(), kPoints);
  Results single{std::vector<double>(kPoints), std::vector<double>(points.size())};
  for (int i = 0; i < kPoints; ++i) {
    ASSERT_TRUE(shooting.Evaluate({&points[i * size], size}, &single.losses[i], &single.gradients[i * size]));
  }
  ASSERT_GT(std::set<double>(single.losses.begin(), single.losses.end()).size(), 9u);
  for (int threads : {1, 2, 5}) {
    Batch batch(contact, scene, Precision::kDouble, threads);
    batch.set_memory_limit(memory_limit);
    EXPECT_EQ(batch.num_threads(), threads);
    for (int count : {1, 2, 3, 4, 6, kPoints}) {
      if (threads > 1 && count < kPoints) continue;
      SCOPED_TRACE(testing::Message() << count << " points on " << threads << " threads");
      const auto first = [&](const std::vector<double>& all, size_t n) {
        return std::vector<double>(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(n));
      };
      const std::vector<double> losses = first(single.losses, count);
      EXPECT_TRUE(Evaluate(&batch, points, count, true) == (Results{losses, first(single.gradients, count * size)}));
      EXPECT_TRUE(Evaluate(&batch, points, count, false) == (Results{losses, {}}));
    }
  }
}

class BatchOf : public testing::TestWithParam<std::string> {};

TEST_P(BatchOf, HasTheBitsOfSingleEvaluations) {
  Scene scene = FourDiscs(0);
  if (std::isinf(FindContactModel(GetParam())->push_gap)) {  // every step has a system of equations
    scene.duration *= 60.0 / scene.steps;
    scene.steps = 60;
  }
  ExpectSameBits(GetParam(), scene);
}

std::vector<std::string> AllModels() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) names.emplace_back(model.name);
  return names;
}
INSTANTIATE_TEST_SUITE_P(AllModels, BatchOf, testing::ValuesIn(AllModels()),
                         [](const auto& test) { return test.param; });

// In units that are not those of the model, and where states that do not fit into memory are simulated again.
TEST(Batch, HasTheBitsOfSingleEvaluationsOfTaskThree) {
  for (const std::string contact : {"direct_toi", "event"}) {
    for (const std::size_t memory_limit : {std::size_t{1}, std::size_t{1} << 30}) {
      SCOPED_TRACE(testing::Message() << contact << " within " << memory_limit << " bytes");
      Scene scene = ProblemScene("two_balls");
      ExpectSameBits(contact, scene, memory_limit);
      scene.bodies[0].mass = 1.3;
      scene.bodies[0].radius = 0.17;
      scene.gravity = {0.1, -0.2};
      ExpectSameBits(contact, scene, memory_limit);
    }
  }
}

TEST(Batch, HasTheBitsOfSingleEvaluationsByInitialVelocities) {
  Scene scene = FourDiscs(0);
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  ExpectSameBits("direct_toi", scene);
  ExpectSameBits("event", scene);
}

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
