// Control problems of ten kinds (control_problems.h), with bounds and without, solved by ceres_phases and compared with
// what knows nothing of it:
//
//   without bounds   ceres_event, by closed arcs: where both converge along the same impacts, their losses are the same
//   with bounds      the best of random starts of Levenberg-Marquardt on the shooting problem, bounds as penalties;
//                    with that also mode_search, which searches by ceres_phases
//
// One line a problem, then how often what was found. Fails where two that should agree do not.
#include <ceres/ceres.h>
#include <gflags/gflags.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>

#include "contact/random_scene.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"

DEFINE_int32(problems, 100, "how many");
DEFINE_int32(seed, 1, "of the first; the next has the next");
DEFINE_int32(iterations, 3000, "of a solver, at most");
DEFINE_int32(starts, 20, "random starts of the penalised solver");

namespace saltus {
namespace {

using testing::RandomScenes;

constexpr int kSteps = 60;

// Nothing if the guess has no impact, or rests or grazes somewhere: there is no sequence to begin with.
std::optional<Scene> Problem(int seed) {
  Scene scene = ControlProblem(seed);
  scene.steps = kSteps;
  const ExactRun run = SimulateExactly(scene, InitialState(scene), InitialControl(scene, kSteps));
  if (!run.ok || !run.only_impacts || run.contacts.empty() || !run.ambiguous.empty()) return std::nullopt;
  return scene;
}

// ------------------------------------------------------------------------------------------------- penalised shooting

class Shot final : public ceres::CostFunction {
 public:
  explicit Shot(SingleShooting* shooting, int rows) : shooting_(shooting) {
    set_num_residuals(rows);
    mutable_parameter_block_sizes()->push_back(shooting->num_variables());
  }
  bool Evaluate(double const* const* z, double* residuals, double** jacobians) const override {
    const std::span<const double> at(z[0], shooting_->num_variables());
    return shooting_->EvaluateResiduals(at, residuals, jacobians != nullptr ? jacobians[0] : nullptr);
  }

 private:
  SingleShooting* shooting_;
};

// sqrt(effort h) u, and weight times what is beyond the bound.
class Penalty final : public ceres::CostFunction {
 public:
  Penalty(double effort, double most, const double* weight, int size) : effort_(effort), most_(most), weight_(weight) {
    set_num_residuals(2 * size);
    mutable_parameter_block_sizes()->push_back(size);
  }
  bool Evaluate(double const* const* z, double* residuals, double** jacobians) const override {
    const int size = parameter_block_sizes()[0];
    if (jacobians != nullptr) std::fill_n(jacobians[0], 2 * size * size, 0.0);
    for (int i = 0; i < size; ++i) {
      const double beyond = std::abs(z[0][i]) - most_;
      residuals[i] = effort_ * z[0][i];
      residuals[size + i] = beyond > 0 ? *weight_ * beyond : 0;
      if (jacobians == nullptr) continue;
      jacobians[0][i * size + i] = effort_;
      if (beyond > 0) jacobians[0][(size + i) * size + i] = *weight_ * (z[0][i] > 0 ? 1 : -1);
    }
    return true;
  }

 private:
  double effort_, most_;
  const double* weight_;
};

// The result of a solve from a random start.
struct Penalised {
  std::vector<double> control;
  ExactRun run;
};
Penalised PenalisedFrom(const Scene& bounded, RandomScenes* random) {
  const double most = bounded.control.max[0];
  Scene scene = bounded;
  scene.control.max.clear();
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  std::vector<double> z = shooting.initial_guess();
  const Vec2d change = random->InSquare(0.7 * most), slope = random->InSquare(most);
  for (size_t i = 0; i < z.size(); ++i) {
    z[i] = std::clamp(z[i] + change[i % 2] + (double(i) / z.size() - 0.5) * slope[i % 2], -most, most);
  }
  const double effort = std::sqrt(scene.objective.effort * scene.dt());
  double weight = effort;
  ceres::Problem problem;
  problem.AddResidualBlock(
      new Shot(&shooting, 2 * static_cast<int>(scene.objective.terminal.size())), nullptr, z.data());
  problem.AddResidualBlock(new Penalty(effort, most, &weight, static_cast<int>(z.size())), nullptr, z.data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.logging_type = ceres::SILENT;
  options.function_tolerance = 1e-10;
  options.max_num_iterations = 60;
  for (int round = 0; round < 3; ++round, weight *= 30) {
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
  }
  for (double& force : z) force = std::clamp(force, -most, most);
  return {z, SimulateExactly(scene, InitialState(scene), z)};
}

// --------------------------------------------------------------------------------------------------------- comparisons

class Campaign {
 public:
  void Run(int seed) {
    const std::optional<Scene> scene = Problem(seed);
    if (!scene) return Count("left out: the guess has no impacts, or other contacts");
    std::printf("%-16s", scene->name.c_str());
    const SolveReport phases = WithoutBounds(*scene);
    RandomScenes random(~static_cast<unsigned>(seed));
    WithBounds(*scene, phases, &random);
    std::printf("\n");
  }

  bool failed() const { return failed_; }
  void Print() const {
    for (const auto& [what, number] : counts_) std::printf("%6d %s\n", number, what.c_str());
  }

 private:
  void Count(const std::string& what) { ++counts_[what]; }
  void Fail(const std::string& what) {
    Count("FAILED " + what);
    failed_ = true;
  }

  static ContactSequence ImpactsOf(const Scene& scene, const SolveReport& report) {
    return SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations)
        .contacts;
  }

  // In the limit of small steps, of which there are as many as the scene says and twice as many.
  static std::optional<double> Limit(const char* solver, Scene scene, const ContactSequence& impacts) {
    std::array<double, 2> losses;
    for (double& loss : losses) {
      const SolveReport report = Solve(solver, {scene, "event"}, {.limits = {.iterations = FLAGS_iterations}});
      if (report.termination != Termination::kConverged || ImpactsOf(scene, report) != impacts) return std::nullopt;
      loss = report.solution.loss;
      scene.steps *= 2;
    }
    return (4 * losses[1] - losses[0]) / 3;
  }

  SolveReport WithoutBounds(Scene scene) {
    scene.steps = 4 * kSteps;
    const SolveReport phases = Solve("ceres_phases", {scene, "event"}, {.limits = {.iterations = FLAGS_iterations}});
    const SolveReport event = Solve("ceres_event", {scene, "event"}, {.limits = {.iterations = FLAGS_iterations}});
    const std::string name = "without bounds: ";
    Note(name + "ceres_phases ", phases);
    Note(name + "ceres_event ", event);
    if (phases.termination != Termination::kConverged || event.termination != Termination::kConverged) return phases;
    const ContactSequence impacts = ImpactsOf(scene, phases);
    if (ImpactsOf(scene, event) != impacts) {
      Count(name + "along other impacts, lower by " +
            (phases.solution.loss < event.solution.loss ? "ceres_phases" : "ceres_event"));
      return phases;
    }
    double difference = 0, gain = 0;
    for (int finer = 0; finer < 2; ++finer, scene.steps *= 4) {  // if steps are shared out otherwise on the two grids
      const auto mine = Limit("ceres_phases", scene, impacts);
      const auto other = Limit("ceres_event", scene, impacts);
      if (!mine || !other) {
        Count(name + "another optimum with finer steps");
        return phases;
      }
      gain = *other - *mine;
      difference = std::abs(gain / *other);
      if (difference <= 1e-7) break;
    }
    std::printf(" differ by %.1e", difference);
    if (difference <= 1e-7) {
      Count(name + "both, and their losses agree to 1e-7");
    } else if (difference > 1e-4) {
      Count(name + "another optimum along the same impacts, lower by " + (gain > 0 ? "ceres_phases" : "ceres_event"));
    } else {
      Fail(name + "losses differ");
    }
    return phases;
  }

  void WithBounds(Scene scene, const SolveReport& free, RandomScenes* random) {
    double largest = 0;
    for (const double force : free.solution.control) largest = std::max(largest, std::abs(force));
    if (free.solution.control.empty() || largest == 0) return;
    scene.control.max.assign(scene.num_controlled(), random->Uniform(0.6, 0.9) * largest);
    const SolveReport report = Solve("ceres_phases", {scene, "event"}, {.limits = {.iterations = FLAGS_iterations}});
    const std::string name = "with bounds: ";
    Note(name, report);
    Penalised found;
    const ExactRun& best = found.run;
    for (int i = 0; i < FLAGS_starts; ++i) {
      Penalised other = PenalisedFrom(scene, random);
      if (other.run.ok && (!best.ok || other.run.loss < best.loss)) found = std::move(other);
    }
    if (!best.ok) return Count(name + "no random start ends well");
    const auto is_worse = [&](const SolveReport& than) { return than.solution.loss > (1 + 1e-4) * best.loss; };
    const SolveReport searched = Solve("mode_search", {scene, "event"}, {});
    std::printf(
        " bounded %.8g, searched %.8g, penalised %.8g", report.solution.loss, searched.solution.loss, best.loss);
    Count(name + "mode_search " + (is_worse(searched) ? "worse than" : "better than, or as good as,") +
          " the best of random starts");
    if (!is_worse(report)) {
      const bool better = report.solution.loss < (1 - 1e-3) * best.loss;
      return Count(name + (better ? "better than" : "as good as") + " the best of random starts");
    }
    // Another optimum: is it one of ceres_phases too?
    SolverOptions options{.limits = {.iterations = FLAGS_iterations}};
    options.guess = ControlGuess{found.control, {}};
    const SolveReport there = Solve("ceres_phases", {scene, "event"}, options);
    const bool same = ImpactsOf(scene, report) == best.contacts;
    Count(name + "worse than the best of random starts, which has " + (same ? "the same" : "other") +
          " impacts; from there " + (is_worse(there) ? "worse too" : "as good or better"));
    std::printf(" WORSE by %.1e, from there %.8g", report.solution.loss / best.loss - 1, there.solution.loss);
  }

  void Note(const std::string& name, const SolveReport& report) {
    const bool converged = report.termination == Termination::kConverged;
    Count(name + TerminationToString(report.termination));
    std::printf(converged ? " ." : " %s (%s)", TerminationToString(report.termination), report.reason.c_str());
    std::fflush(stdout);
    if (EndsWorse(report) && report.termination != Termination::kNotApplicable) {
      Fail(name + "ends worse than it began");
    }
  }

  std::map<std::string, int> counts_;
  bool failed_ = false;
};

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::SetUsageMessage("Generated control problems through impacts: phase_problems [--problems=100] [--seed=1]");
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  saltus::Campaign campaign;
  for (int seed = FLAGS_seed; seed < FLAGS_seed + FLAGS_problems; ++seed) {
    campaign.Run(seed);
  }
  campaign.Print();
  return campaign.failed() ? 1 : 0;
}
