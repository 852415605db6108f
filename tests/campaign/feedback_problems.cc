// Feedback and uncertainty on five plans with impacts.
//
// Of each plan, in open loop and in closed loop and for noise of several sizes: the largest difference between the
// covariance of --samples runs and that of first order, as a multiple of its standard error; the root mean square of
// the final error, of the samples and of first order; the runs whose events are not as planned, and the probability of
// that to first order. Fails if at the smallest noise a difference is above 5 standard errors.
//
// With --count, random scenes with bounces, rest and slides in their place: each motion is planned, or refused with a
// reason. Fails if a plan is not its own undisturbed run, in open loop or in closed loop, if a covariance is not
// finite, or if a disturbed motion with the planned events and without a remark does not end where its linearization
// says.
#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "base/random.h"
#include "campaign/scenes.h"
#include "feedback/bouncing_disc.h"
#include "folders.h"
#include "problems/hybrid_systems.h"
#include "saltus/feedback/closed_loop.h"
#include "saltus/feedback/covariance.h"
#include "saltus/feedback/regulator.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"

DEFINE_int32(samples, 10000, "runs of each plan");
DEFINE_int32(count, 0, "random scenes, in the place of the five plans");
DEFINE_int32(seed, 1, "of the first of them");
DEFINE_int32(seeds, 200, "recordings for the filters");
DEFINE_int32(threads, 0, "of the runs; 0: one per core");

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

bool failed = false;

struct Case {
  const char* name;
  Plan plan;
  LinearMotion linear;
  Regulator regulator = {};
  Noise noise = {};  // standard deviation 1e-3 of states
  std::function<std::unique_ptr<Plant>()> plant = nullptr;
};

Scene ProblemScene(const std::string& name) {
  return std::get<Scene>(LoadSceneFile(SourceFolder() + "/problems/" + name + ".yaml"));
}

Case OfScene(const char* name, const Scene& scene) {
  const auto motion = MakeSimulator({"event"}, scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, motion->num_steps());
  CHECK(motion->Rollout(InitialState(scene), control)) << motion->FailureReason();
  Case at{.name = name, .plan = MakePlan(*motion, control), .linear = Linearize(*motion, control)};
  const int n = motion->state_size(), m = motion->control_width();
  const double step = motion->step();
  at.regulator = Track(at.linear,
                       {.Q = {10 * step * MatrixXd::Identity(n, n)},
                        .R = 1e-3 * step * MatrixXd::Identity(m, m),
                        .QT = 10 * MatrixXd::Identity(n, n)});
  at.noise.initial = 1e-6 * MatrixXd::Identity(n, n);
  at.plant = [scene] { return MakePlant(MakeSimulator({"event"}, scene, Precision::kDouble)); };
  return at;
}

Case OfSystem(const char* name, const HybridProblem& problem, std::vector<MatrixXd> Q) {
  const auto motion = std::make_shared<HybridSimulator>(problem.system, problem.integration);
  CHECK(motion->Rollout(problem.guess)) << motion->FailureReason();
  Case at{.name = name, .plan = MakePlan(*motion, problem.guess), .linear = Linearize(*motion, problem.guess)};
  const Eigen::Index n0 = at.plan.states.front().size(), n = at.plan.states.back().size();
  const int m = problem.system.num_controls();
  at.regulator =
      Track(at.linear, {.Q = std::move(Q), .R = 1e-2 * MatrixXd::Identity(m, m), .QT = 10 * MatrixXd::Identity(n, n)});
  at.noise.initial = 1e-6 * MatrixXd::Identity(n0, n0);
  at.plant = [motion, input = problem.guess] { return MakePlant(*motion, input); };
  return at;
}

void Compare(const Case& at) {
  for (const double size : {0.1, 1.0, 10.0, 30.0}) {
    Noise noise = at.noise;
    noise.initial *= size * size;
    double of_samples[2] = {};
    for (const bool closed : {false, true}) {
      const Covariance first_order = Propagate(at.linear, noise, closed ? &at.regulator : nullptr);
      const MonteCarlo runs = RunMonteCarlo(at.plan,
                                            closed ? at.regulator.gains : std::vector<MatrixXd>(),
                                            noise,
                                            at.plant,
                                            {.samples = FLAGS_samples, .threads = FLAGS_threads});
      const MatrixXd& P = first_order.nodes.back();
      double worst = 0;
      for (Eigen::Index i = 0; i < P.rows() && runs.counted > 1; ++i) {
        for (Eigen::Index j = 0; j <= i; ++j) {
          const double error = std::sqrt((P(i, i) * P(j, j) + P(i, j) * P(i, j)) / runs.counted);
          if (error > 1e-12 * P.trace()) worst = std::max(worst, std::abs(runs.covariance(i, j) - P(i, j)) / error);
        }
      }
      const double rms = runs.counted > 1
                             ? std::sqrt(runs.covariance.trace() + (runs.mean - at.plan.states.back()).squaredNorm())
                             : NAN;
      of_samples[closed] = rms;
      std::printf(
          "%-20s %-6s noise %-7.1g difference %7.2f errors  rms %.4e, first order %.4e  otherwise %.4f, first "
          "order %.4f  failed %d\n",
          at.name,
          closed ? "closed" : "open",
          1e-3 * size,
          worst,
          rms,
          std::sqrt(P.trace()),
          static_cast<double>(runs.off_plan) / FLAGS_samples,
          first_order.change_probability,
          runs.failed);
      failed = failed || (size < 1 && worst > 5);
    }
    std::printf("%-20s ratio of final errors, closed to open: %.4f\n", at.name, of_samples[1] / of_samples[0]);
  }
}

// The filter of scenes beside one without saltation matrices, on recordings of a bouncing disc.
void PrintFilters() {
  const FilterScores scores = CompareFilters(FLAGS_seeds);
  for (const auto& [name, score] : {std::pair("with saltation", scores.salted), std::pair("without", scores.plain)}) {
    std::printf(
        "filter %-15s mean error: position %.4f m, velocity %.4f m/s; in the 95 %% ellipsoid: %.4f, at all times "
        "%.4f; lost %d of %d\n",
        name,
        score.position,
        score.velocity,
        score.covered,
        score.covered_at_all_times,
        score.lost,
        FLAGS_seeds);
  }
}

void ComparePlans() {
  Scene task2 = ProblemScene("ground_wall");
  task2.control.bodies = {0};
  task2.control.initial = {Vec2d(0, 0)};
  Compare(OfScene("ground_wall", task2));
  Compare(OfScene("two_balls", ProblemScene("two_balls")));
  Compare(OfScene("multiple_collisions", ProblemScene("multiple_collisions")));
  Compare(OfSystem(
      "two_mass_hopper", TwoMassHopperProblem(), {0.1 * MatrixXd::Identity(5, 5), 0.1 * MatrixXd::Identity(3, 3)}));
  Compare(OfSystem("cart_pole_walls", CartPoleWallsProblem(), {0.1 * MatrixXd::Identity(4, 4)}));
}

void Fail(const std::string& scene, const std::string& what) {
  failed = true;
  std::printf("%s: %s\n", scene.c_str(), what.c_str());
}

// Returns the reason why the scene has no plan; empty if it has one.
std::string CheckScene(const campaign::NamedScene& named, std::uint32_t seed, int* compared, int* remarked) {
  const Scene& scene = named.scene;
  const std::string name = named.kind + " " + std::to_string(seed);
  const std::vector<double> control =
      scene.control_width() > 0 ? InitialControl(scene, scene.steps) : std::vector<double>();
  const ScenePlan planned = PlanScene(scene, InitialState(scene), control);
  if (!planned.reason.empty()) return planned.reason;
  *remarked += !planned.remark.empty();
  const VectorXd& end = planned.plan.states.back();
  const Eigen::Index n = end.size(), m = planned.plan.num_controls;
  const auto plant = [&] { return MakePlant(Contact("event"), scene, planned.lengths); };
  const std::unique_ptr<Plant> one = plant();
  const double size = 1 + end.norm();
  std::vector<MatrixXd> gains;
  if (m > 0) {
    gains = Track(planned.linear,
                  {.Q = {MatrixXd::Identity(n, n)}, .R = MatrixXd::Identity(m, m), .QT = MatrixXd::Identity(n, n)})
                .gains;
  }
  for (const bool closed : {false, true}) {
    // Where a tie or a graze decides, rounding in the feedback does.
    if (closed && (m == 0 || !planned.remark.empty())) continue;
    const ClosedLoopRun run =
        RunClosedLoop(planned.plan, closed ? gains : std::vector<MatrixXd>(), {}, 1, 0, one.get());
    if (!run.ok || !run.as_planned) Fail(name, "the undisturbed run has other events");
    if (run.ok && (run.final_state - end).norm() > 1e-6 * size) Fail(name, "the undisturbed run ends elsewhere");
  }
  const Noise noise{.initial = 1e-8 * MatrixXd::Identity(n, n)};
  const Covariance covariance = Propagate(planned.linear, noise);
  if (!covariance.nodes.back().allFinite()) Fail(name, "the covariance is not finite");
  if (!(covariance.change_probability >= 0 && covariance.change_probability <= 1)) Fail(name, "no probability");
  RunMonteCarlo(planned.plan, gains, noise, plant, {.samples = 5, .threads = 1});
  if (!planned.remark.empty()) return "";
  // One disturbed motion, as its linearization says.
  NormalStream stream(seed);
  VectorXd change = VectorXd::Zero(n);
  const int body_size = static_cast<int>(n) / scene.num_bodies();
  for (int i = 0; i < n; ++i) {
    const Body& body = scene.bodies[i / body_size];
    if (!body.fixed && (i % body_size < 4 || body.Spins())) change[i] = 1e-8 * stream.Next();
  }
  Plan moved = planned.plan;
  moved.states[0] += change;
  const ClosedLoopRun run = RunClosedLoop(moved, {}, {}, 1, 0, one.get());
  if (!run.as_planned) return "";
  for (const LinearInterval& interval : planned.linear.intervals) change = interval.A * change;
  ++*compared;
  const double error = (run.final_state - end - change).norm();
  if (error > 1e-3 * change.norm() + 1e-10 * size) {
    Fail(name,
         "a disturbed motion ends " + std::to_string(error / change.norm()) + " of its change from its linearization");
  }
  return "";
}

void CheckRandomScenes() {
  std::map<std::string, int> refused;
  int planned = 0, compared = 0, remarked = 0;
  for (int i = 0; i < FLAGS_count; ++i) {
    const auto seed = static_cast<std::uint32_t>(FLAGS_seed + i);
    const std::string reason = CheckScene(
        i % 4 == 3 ? campaign::RandomEdgeScene(seed) : campaign::RandomScene(seed), seed, &compared, &remarked);
    planned += reason.empty();
    if (!reason.empty()) ++refused[reason.substr(0, reason.find_first_of("0123456789"))];
  }
  std::printf("%d scenes: %d planned, %d of them with a remark, %d compared with a disturbed motion\n",
              FLAGS_count,
              planned,
              remarked,
              compared);
  for (const auto& [reason, count] : refused) std::printf("%d refused: %s...\n", count, reason.c_str());
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  if (FLAGS_count > 0) {
    saltus::CheckRandomScenes();
  } else {
    saltus::PrintFilters();
    saltus::ComparePlans();
  }
  return saltus::failed ? 1 : 0;
}
