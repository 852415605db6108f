// Control problems of ten kinds (control_problems.h), solved by mode_search from the scene's own guess with its own
// limits, and with --starts compared with the best of all that is tried for long:
//
//   ceres_lm, ceres_lbfgs, gd    from the guess and from so many random constant forces
//   ceres_phases                 from the guess and from the best ends of these
//   mode_search                  from four times so many starts, with another seed and without a limit of time
//
// One line a problem, then how many are solved and what they take of one core. Fails where a search ends worse than it
// begins, or gives no answer.
#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"
#include "solve/search/search_starts.h"

DEFINE_int32(problems, 200, "how many");
DEFINE_int32(seed, 0, "of the first; the next has the next");
DEFINE_int32(starts, 0, "random starts of the solvers that it is compared with; 0: there are none");
DEFINE_bool(search, true, "measure mode_search itself, too");
DEFINE_double(seconds, 10, "of one core, for each search; 0: no limit");

namespace saltus {
namespace {

constexpr double kSolved = 1e-6;  // relative, to the best loss known

double CpuSeconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Returns the exact loss of a control, whatever the solver reports.
double ExactLoss(const Scene& scene, const SolveReport& report) {
  if (report.solution.control.empty()) return INFINITY;
  const ExactRun run = SimulateExactly(scene, InitialState(scene), report.solution.control, report.solution.durations);
  return run.ok ? run.loss : INFINITY;
}

struct Outcome {
  double loss = INFINITY;
  std::string who;
  std::vector<double> control, durations;
  void Meet(const Scene& scene, const std::string& solver, const SolveReport& report) {
    const double now = ExactLoss(scene, report);
    if (!(now < loss)) return;
    loss = now;
    who = solver;
    control = report.solution.control;
    durations = report.solution.durations;
  }
};

Outcome BestOfMany(const Scene& scene) {
  Outcome best;
  std::vector<Outcome> ends;
  for (int i = -1; i < FLAGS_starts; ++i) {
    Scene from = scene;
    if (i >= 0) from.control.initial = SearchStart(scene, 777, i);
    ends.emplace_back();
    for (const char* solver : {"ceres_lm", "ceres_lbfgs", "gd"}) {
      SolverOptions options;
      options.limits.iterations = 300;
      options.limits.impacts = 1000;
      ends.back().Meet(scene, solver, Solve(solver, {from, "event"}, options));
    }
  }
  std::sort(ends.begin(), ends.end(), [](const Outcome& a, const Outcome& b) { return a.loss < b.loss; });
  best.Meet(scene, "ceres_phases", Solve("ceres_phases", {scene, "event"}, {.limits = {.iterations = 3000}}));
  double last = 0;
  int tried = 0;
  for (const Outcome& end : ends) {
    if (end.loss < best.loss) best = end;
    if (tried == 4 || end.control.empty() || end.loss < 1.01 * last) continue;  // the same again
    ++tried;
    last = end.loss;
    SolverOptions options{.limits = {.iterations = 3000}};
    options.guess = ControlGuess{end.control, end.durations};
    best.Meet(scene, "ceres_phases", Solve("ceres_phases", {scene, "event"}, options));
  }
  SolverOptions options{.limits = {.iterations = 2500}};
  options.sequences.limits = {.work = 0, .starts = 4 * FLAGS_starts, .seed = 778};
  best.Meet(scene, "mode_search", Solve("mode_search", {scene, "event"}, options));
  return best;
}

class Campaign {
 public:
  void Run(int seed) {
    const Scene scene = ControlProblem(seed);
    std::printf("%-16s", scene.name.c_str());
    double found = INFINITY;
    if (FLAGS_search) found = Search(scene);
    if (FLAGS_starts > 0) Compare(scene, found);
    std::printf("\n");
    std::fflush(stdout);
  }

  void Print() {
    if (!seconds_.empty()) {
      std::sort(seconds_.begin(), seconds_.end());
      std::printf("%zu searches, of one core %.2f s in the median, %.2f s at most\n",
                  seconds_.size(),
                  seconds_[seconds_.size() / 2],
                  seconds_.back());
      if (FLAGS_starts > 0) std::printf("%d solved to %g of the best known\n", solved_, kSolved);
    }
    std::printf("%d failures\n", failures_);
  }
  bool failed() const { return failures_ > 0; }

 private:
  double Search(const Scene& scene) {
    const double begin = CpuSeconds();
    SolverOptions options;
    options.sequences.limits.work = 0;
    if (FLAGS_seconds > 0) options.monitor.stop = [&] { return CpuSeconds() - begin > FLAGS_seconds; };
    const SolveReport report = Solve("mode_search", {scene, "event"}, options);
    seconds_.push_back(CpuSeconds() - begin);
    const double loss = ExactLoss(scene, report);
    const bool no_answer = report.solution.control.empty() || !std::isfinite(loss);
    const bool worse = loss > (1 + 1e-9) * report.guess.loss;
    if (no_answer || worse ||
        (report.termination != Termination::kConverged && report.reason.empty() &&
         report.termination != Termination::kInterrupted)) {
      ++failures_;
      std::printf(" FAILED");
    }
    std::printf(" %.12g from %.6g in %.2f s, %zu solves, %s",
                loss,
                report.guess.loss,
                seconds_.back(),
                report.history.losses.size(),
                TerminationToString(report.termination));
    if (report.termination != Termination::kConverged) std::printf(" (%s)", report.reason.c_str());
    return loss;
  }

  void Compare(const Scene& scene, double found) {
    const double begin = CpuSeconds();
    const Outcome best = BestOfMany(scene);
    std::printf(" ; best of all others %.12g by %s in %.1f s", best.loss, best.who.c_str(), CpuSeconds() - begin);
    if (!FLAGS_search) return;
    if (found <= best.loss + kSolved * std::abs(best.loss)) {
      ++solved_;
    } else {
      std::printf(" MISSED by %.1e", found / best.loss - 1);
    }
  }

  std::vector<double> seconds_;
  int solved_ = 0, failures_ = 0;
};

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::SetUsageMessage("Generated control problems for the search: search_problems [--problems=200] [--starts=16]");
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  saltus::Campaign campaign;
  for (int seed = FLAGS_seed; seed < FLAGS_seed + FLAGS_problems; ++seed) campaign.Run(seed);
  campaign.Print();
  return campaign.failed() ? 1 : 0;
}
