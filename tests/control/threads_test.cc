// Several threads at once: steps of one simulator, solvers and audits side by side, and the studies of one audit, with
// the bits of one thread. What it does not notice by itself, ThreadSanitizer does (preset tsan).
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "audit/gradient/step_study.h"
#include "saltus/audit/attribution.h"
#include "saltus/audit/audit.h"
#include "saltus/audit/refinement.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

constexpr int kThreads = 4;

// job(0), ..., job(kThreads - 1), each on a thread of its own.
void OnThreads(const std::function<void(int)>& job) {
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) threads.emplace_back(job, i);
  for (std::thread& thread : threads) thread.join();
}

std::vector<std::string> AllNames() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) names.emplace_back(model.name);
  return names;
}

class SharedSimulator : public testing::TestWithParam<std::string> {};

// A step and its linearization as numbers.
std::vector<double> StepAt(const Simulator& simulator, std::span<const double> x, std::span<const double> force) {
  std::vector<double> numbers(simulator.state_size());
  simulator.Step(x, force, numbers);
  StepLinearization linearization;
  simulator.Linearize(x, force, /*with_parameters=*/true, &linearization);
  for (const StepLinearization::Island& island : linearization.islands) {
    numbers.insert(numbers.end(), island.A.data(), island.A.data() + island.A.size());
    numbers.insert(numbers.end(), island.P.data(), island.P.data() + island.P.size());
  }
  return numbers;
}

TEST_P(SharedSimulator, StepsAndLinearizesOnSeveralThreads) {
  const Scene scene = ProblemScene("two_balls");
  const std::unique_ptr<Simulator> simulator = MakeSimulator(GetParam(), scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
  ASSERT_FALSE(simulator->touches().empty());
  const int contact = simulator->touches().front().step;
  std::vector<double> force(2 * simulator->num_bodies());
  simulator->ExpandForce(control, 0, force);
  // Each thread has another step: in flight, and about the contact.
  std::vector<std::vector<double>> x(kThreads, std::vector<double>(simulator->state_size()));
  for (int i = 0; i < kThreads; ++i) simulator->GetState(i == 0 ? 0 : contact + i - 1, x[i]);
  std::vector<std::vector<double>> alone, together(kThreads);
  for (int i = 0; i < kThreads; ++i) alone.push_back(StepAt(*simulator, x[i], force));
  OnThreads([&](int i) {
    for (int repetition = 0; repetition < 5; ++repetition) together[i] = StepAt(*simulator, x[i], force);
  });
  EXPECT_EQ(together, alone);
}

INSTANTIATE_TEST_SUITE_P(AllModels, SharedSimulator, testing::ValuesIn(AllNames()),
                         [](const auto& test) { return test.param; });

TEST(Threads, SolversSideBySide) {
  const Scene scene = ProblemScene("two_balls");
  const struct {
    const char *solver, *contact;
  } runs[kThreads] = {{"gd", "lcp"}, {"ceres_lbfgs", "event"}, {"ceres_lm", "event"}, {"hmp", "event"}};
  const auto losses = [&](int i) {
    return Solve(runs[i].solver,
                 {scene, runs[i].contact},
                 {.limits = {.iterations = 8}, .descent = {.learning_rate = 10}})
        .history.losses;
  };
  std::vector<std::vector<double>> alone, together(kThreads);
  for (int i = 0; i < kThreads; ++i) alone.push_back(losses(i));
  OnThreads([&](int i) { together[i] = losses(i); });
  EXPECT_EQ(together, alone);
  for (const std::vector<double>& each : alone) EXPECT_FALSE(each.empty());
}

TEST(Threads, AuditsSideBySide) {
  Scene scene = ProblemScene("bounce_once");
  scene.steps = 60;
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  ASSERT_TRUE(exact);
  const char* contacts[kThreads] = {"direct", "direct_toi", "compliant_warp", "lcp_pgs"};
  const auto audit = [&](int i) {
    const ModelAudit result = AuditModel(contacts[i], scene, Precision::kDouble, exact, {});
    return std::pair(result.verdict, result.VerdictReason());
  };
  std::vector<std::pair<Verdict, std::string>> alone, together(kThreads);
  for (int i = 0; i < kThreads; ++i) alone.push_back(audit(i));
  OnThreads([&](int i) { together[i] = audit(i); });
  EXPECT_EQ(together, alone);
  EXPECT_EQ(alone[0].first, Verdict::kWrongSign);
}

TEST(Threads, RefinementOfOneModel) {
  const Scene scene = ProblemScene("multiple_collisions");
  RefinementOptions options;
  const RefinementStudy one = StudyRefinement("compliant_warp", scene, options);
  options.threads = kThreads;
  const RefinementStudy several = StudyRefinement("compliant_warp", scene, options);
  ASSERT_TRUE(one.ok()) << one.reason;
  ASSERT_EQ(several.quantities.size(), one.quantities.size());
  for (size_t q = 0; q < one.quantities.size(); ++q) {
    EXPECT_EQ(several.quantities[q].finest, one.quantities[q].finest);
    ASSERT_EQ(several.quantities[q].levels.size(), one.quantities[q].levels.size());
    for (size_t i = 0; i < one.quantities[q].levels.size(); ++i) {
      EXPECT_EQ(several.quantities[q].levels[i].error, one.quantities[q].levels[i].error);
    }
  }
}

TEST(Threads, RefinementAsksBeforeEachLevelHowMany) {
  const Scene scene = ProblemScene("bounce_once");
  RefinementOptions options;
  int asked = 0;
  options.threads_now = [&] { return 1 + asked++ % kThreads; };
  const RefinementStudy study = StudyRefinement("direct", scene, options);
  ASSERT_TRUE(study.ok()) << study.reason;
  EXPECT_EQ(asked, static_cast<int>(study.quantities[0].levels.size()));
  EXPECT_EQ(study.quantities[0].finest, StudyRefinement("direct", scene).quantities[0].finest);
}

TEST(Threads, OwnDifferencesOfOneModel) {
  for (const char* problem : {"two_balls", "multiple_collisions"}) {
    for (const char* contact : {"lcp", "direct", "event", "lcp_pgs"}) {
      const GradientCheck one = CheckGradient(contact, ProblemScene(problem));
      for (int threads = 2; threads <= kThreads; ++threads) {
        const GradientCheck several = CheckGradient(contact, ProblemScene(problem), nullptr, threads);
        EXPECT_EQ(several.agreement, one.agreement) << contact;
        EXPECT_EQ(several.quantity, one.quantity) << contact;
        EXPECT_EQ(several.gradient, one.gradient) << contact;
        EXPECT_EQ(several.difference, one.difference) << contact;
      }
    }
  }
}

TEST(Threads, AttributionOfOneModel) {
  for (const char* problem : {"ground_wall", "multiple_collisions"}) {
    for (const char* contact : {"direct", "compliant_warp", "pbd_brax"}) {
      const Scene scene = ProblemScene(problem);
      const Attribution one = AttributeError(contact, scene);
      int said = 0;  // by one thread at a time
      const Attribution several =
          AttributeError(contact, scene, {.status = [&](const std::string&) { ++said; }, .threads = kThreads});
      ASSERT_TRUE(one.ok()) << one.reason;
      EXPECT_GT(one.contacts.size(), 1u);
      EXPECT_EQ(several.first_wrong, one.first_wrong);
      EXPECT_EQ(several.sequence, one.sequence);
      EXPECT_EQ(several.limit, "");
      EXPECT_GE(said, static_cast<int>(one.contacts.size()));
      ASSERT_EQ(several.contacts.size(), one.contacts.size());
      for (std::size_t i = 0; i < one.contacts.size(); ++i) {
        EXPECT_EQ(several.contacts[i].first_step, one.contacts[i].first_step);
        EXPECT_EQ(several.contacts[i].error, one.contacts[i].error);
        EXPECT_EQ(several.contacts[i].stays, one.contacts[i].stays);
        EXPECT_EQ(several.contacts[i].cause, one.contacts[i].cause);
      }
    }
  }
}

// Whenever it is stopped: the first contacts, without a gap, as one thread finds them; or all, and no limit.
TEST(Threads, AttributionThatIsStopped) {
  const Scene scene = ProblemScene("multiple_collisions");
  const Attribution all = AttributeError("direct", scene);
  int most = 0;
  for (int allowed = 1; allowed < 4000; allowed = allowed * 5 / 4 + 1) {
    std::atomic<int> asked = 0;
    const auto stop = [&] { return ++asked > allowed; };
    const Attribution cut = AttributeError("direct", scene, {.stop = stop, .threads = kThreads});
    if (!cut.ok()) continue;
    ASSERT_LE(cut.contacts.size(), all.contacts.size());
    most = std::max(most, static_cast<int>(cut.contacts.size()));
    EXPECT_TRUE(cut.contacts.size() == all.contacts.size() || !cut.limit.empty()) << allowed;
    for (std::size_t i = 0; i < cut.contacts.size(); ++i) {
      EXPECT_EQ(cut.contacts[i].first_step, all.contacts[i].first_step);
      EXPECT_EQ(cut.contacts[i].error, all.contacts[i].error);
    }
  }
  EXPECT_GT(most, 0);
}

}  // namespace
}  // namespace saltus
