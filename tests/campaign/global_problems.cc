// Small random problems (small_problems.h): is the loss of any control below the lower bound of them all? Controls are
// drawn at random, optimized, and drawn around the best. The bound knows only a larger loss than theirs.
//
// One line a problem, then how many controls there were. Fails if a control has a loss below the bound.
#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "base/random.h"
#include "campaign/small_problems.h"
#include "saltus/global/global_bound.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

DEFINE_int32(problems, 300, "how many");
DEFINE_int32(seed, 1, "of the first; the next has the next");
DEFINE_int32(controls, 340, "of each problem");
DEFINE_int32(boxes, 400, "of the bound, for each problem");
DEFINE_double(known, 1.5, "the loss that the bound knows, relative to the least of the controls");

namespace saltus {
namespace {

constexpr double kRounding = 1e-9;  // of the loss of a simulation, relative

class Controls {
 public:
  Controls(const Scene& scene, Random* random)
      : scene_(scene), random_(*random), initial_(InitialState(scene)), best_(scene.steps * scene.control_width(), 0) {}

  void Simulate(int count) {
    Meet(best_);
    for (int i = 1; i < count; ++i) {
      if (i % 50 == 5) {
        Optimize();
      } else if (i % 3 == 0) {
        Meet(Around(best_, std::pow(10, 1 - 4 * random_.Unit())));
      } else {
        Meet(Drawn());
      }
    }
  }
  double least() const { return least_; }
  int simulated() const { return simulated_; }

 private:
  void Meet(const std::vector<double>& control) {
    const ExactRun run = SimulateExactly(scene_, initial_, control);
    if (!run.ok || !run.ambiguous.empty()) return;
    ++simulated_;
    if (!(run.loss < least_)) return;
    least_ = run.loss;
    best_ = control;
  }

  std::vector<double> Around(std::vector<double> control, double width) {
    for (double& force : control) force += width * random_.Symmetric();
    return control;
  }

  std::vector<double> Drawn() {
    const double strength = std::pow(10, 2 * random_.Unit() - 0.5);
    const Vec2d mean(strength * random_.Symmetric(), strength * random_.Symmetric());
    std::vector<double> control(best_.size());
    for (size_t i = 0; i < control.size(); ++i) control[i] = mean[i % 2];
    return Around(control, 0.5 * strength * random_.Unit());
  }

  void Optimize() {
    SolverOptions options{.limits = {.iterations = 40}};
    options.guess = ControlGuess{random_.UniformIndex(2) == 0 ? Drawn() : best_, {}};
    const SolveReport report = Solve("ceres_lm", {scene_, "event"}, options);
    if (report.solution.control.size() == best_.size()) Meet(report.solution.control);
  }

  const Scene& scene_;
  Random& random_;
  const std::vector<double> initial_;
  std::vector<double> best_;
  double least_ = INFINITY;
  int simulated_ = 0;
};

int Run() {
  int bounded = 0, failures = 0;
  long long simulated = 0;
  double tightness = 0;
  for (int seed = FLAGS_seed; bounded < FLAGS_problems; ++seed) {
    Random random(static_cast<std::uint64_t>(seed));
    const Scene scene = SmallProblem(&random);
    if (Validate(scene)) continue;
    ++bounded;
    Controls controls(scene, &random);
    controls.Simulate(FLAGS_controls);
    simulated += controls.simulated();
    const double known = FLAGS_known * controls.least();
    const GlobalBound bound =
        BoundGlobally(scene, known, {.gap = 1e-6 * known, .boxes = static_cast<std::size_t>(FLAGS_boxes)});
    const bool failed = bound.lower > controls.least() * (1 + kRounding);
    failures += failed;
    tightness += bound.lower / controls.least();
    std::printf("seed %d: least %.9g of %d controls, bound %.9g after %zu boxes%s\n",
                seed,
                controls.least(),
                controls.simulated(),
                bound.lower,
                bound.boxes,
                failed ? " FAILED" : "");
    std::fflush(stdout);
  }
  std::printf("%d problems, %lld controls, the bound is %.3f of the least loss on average, %d failures\n",
              bounded,
              simulated,
              tightness / bounded,
              failures);
  return failures > 0 ? 1 : 0;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::SetUsageMessage(
      "Small random problems for the global bound: global_problems [--problems=300] [--controls=340]");
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  return saltus::Run();
}
