// Control problems of ten kinds (control_problems.h) as scenes of discs and as problems of hybrid systems, by one
// solver: how often both reach the same loss, which takes how much time, and which minima of discs, by their
// certificate, that of hybrid systems denies: its residuals are relative to each component, and those of discs to the
// largest costate.
#include <gflags/gflags.h>
#include <glog/logging.h>

#include <cmath>
#include <cstdio>
#include <ctime>
#include <numeric>

#include "saltus/control/scene_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"

DEFINE_int32(problems, 100, "how many");
DEFINE_int32(seed, 1, "of the first; the next has the next");
DEFINE_int32(steps, 60, "control intervals");
DEFINE_string(solver, "ceres_phases", "of both");

namespace saltus {
namespace {

constexpr double kSame = 1e-7;  // relative, of losses

double CpuTime() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

// Whether the hybrid problem has the optimum of the discs, if they have a minimum.
bool HasTheMinimum(const HybridProblem& problem, const SolveReport& discs) {
  if (!discs.certificate || VerdictInWords(*discs.certificate) != "minimum") return true;
  HybridInput input = problem.guess;
  input.control = discs.solution.control;
  input.lengths = discs.solution.durations;
  if (!input.lengths.empty()) input.duration = std::accumulate(input.lengths.begin(), input.lengths.end(), 0.0);
  return Certify(problem, input).IsStationary();
}

void Run() {
  int same = 0, lower = 0, higher = 0, denied = 0;
  double seconds[2] = {0, 0};
  for (int seed = FLAGS_seed; seed < FLAGS_seed + FLAGS_problems; ++seed) {
    Scene scene = ControlProblem(seed);
    scene.steps = FLAGS_steps;
    if (!UnsupportedByHybridProblem(scene).empty()) continue;
    const HybridProblem problem = MakeHybridProblem(scene);
    const double begin = CpuTime();
    const SolveReport discs = Solve(FLAGS_solver, {scene, "event"}, {});
    const double middle = CpuTime();
    const SolveReport hybrid = Solve(FLAGS_solver, problem, {});
    seconds[0] += middle - begin;
    seconds[1] += CpuTime() - middle;
    if (discs.history.losses.empty() || hybrid.history.losses.empty()) continue;
    const bool has = HasTheMinimum(problem, discs);
    denied += !has;
    const double change = (hybrid.solution.loss - discs.solution.loss) / std::abs(discs.solution.loss);
    ++(std::abs(change) <= kSame ? same : change < 0 ? lower : higher);
    std::printf("%-15s discs %.9g %s, hybrid %.9g %s%s\n",
                scene.name.c_str(),
                discs.solution.loss,
                TerminationToString(discs.termination),
                hybrid.solution.loss,
                TerminationToString(hybrid.termination),
                has ? "" : ", not stationary as a hybrid system");
  }
  std::printf("same loss %d, lower as a hybrid system %d, higher %d; minima denied %d; %.2f s and %.2f s of CPU time\n",
              same,
              lower,
              higher,
              denied,
              seconds[0],
              seconds[1]);
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  google::InitGoogleLogging(argv[0]);
  FLAGS_minloglevel = google::GLOG_FATAL;
  saltus::Run();
}
