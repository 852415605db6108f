#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <set>
#include <string_view>

#include "exact/two_disc_optimum.h"
#include "paper/experiments.h"
#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr int kShootingIterations = 150;   // by then it has ended, or creeps
constexpr int kLagrangianIterations = 60;  // by then it has stalled or gone astray
constexpr int kFineSteps = 1000;
// The time of a gradient above which a model is slow, s: gradient descent would take seconds.
constexpr double kSlow = 6e-4;
constexpr int kSlowIterations = 40;
constexpr double kNearOptimum = 0.01;

// Returns the solvers that run under every contact model; the others require exact dynamics, or are shown once.
const std::set<std::string>& GeneralSolvers() {
  static const std::set<std::string> solvers = {"gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting"};
  return solvers;
}

CheckedRun Planned(const std::string& contact, const std::string& solver) {
  CheckedRun run;
  run.report.contact = contact;
  run.report.solver = solver;
  return run;
}

// Returns the CPU time of the thread for a gradient of a scene, s.
double GradientTime(const std::string& contact, const Scene& scene) {
  const double start = ThreadTime();
  ComputeGradient(contact, scene, Precision::kDouble);
  return ThreadTime() - start;
}

void SolveOne(const Scene& scene, int iterations, CheckedRun* run) {
  SolverOptions options;
  options.limits.iterations = iterations;
  options.descent.learning_rate = DefaultLearningRate(scene);
  if (run->report.solver == "ceres_shooting") options.limits.iterations = kShootingIterations;
  if (run->report.solver == "ceres_lagrangian") options.limits.iterations = kLagrangianIterations;
  options.monitor.stop = IsStopRequested;
  *run = SolveAndSimulate(run->report.solver, {scene, run->report.contact}, options);
}

Tone ToneOfGap(double gap) {
  if (gap < 1e-3) return Tone::kGood;
  return gap < 1e-1 ? Tone::kWarning : Tone::kBad;
}

// One scene and the runs on it.
struct Task {
  std::string name;  // of its table
  std::string title;
  Scene scene;
  double optimum = 0;            // of the exact loss
  std::vector<CheckedRun> runs;  // contact models outermost; planned ones have names only

  const CheckedRun* Find(const std::string& contact, const std::string& solver) const {
    for (const CheckedRun& run : runs) {
      if (run.report.contact == contact && run.report.solver == solver) return &run;
    }
    return nullptr;
  }

  // Returns the gap to the optimum of the best exact loss by some solvers under a model.
  double SmallestGap(const std::string& contact, const std::set<std::string>& solvers = GeneralSolvers()) const {
    double smallest = std::numeric_limits<double>::infinity();
    for (const CheckedRun& run : runs) {
      if (!run.exact.ok || run.report.contact != contact || !solvers.contains(run.report.solver)) continue;
      smallest = std::min(smallest, run.exact.loss - optimum);
    }
    return smallest;
  }
};

struct Tasks {
  std::string exact{ExactModel()->name};  // the event-driven contact model
  std::set<std::string> slow;             // models whose gradient takes long
  Task launch, launch_with_friction, strike, strike_on_fine_grid;
  Task others;  // task 3 under the models that are not in the experiments
};

void PlanOthers(bool every_solver, Tasks* all) {
  Task& others = all->others;
  others.name = "comparison_formulations";
  others.title = "Task 3 under the models that the published comparisons do not report";
  others.scene = all->strike.scene;
  others.optimum = all->strike.optimum;
  std::vector<std::string> solvers = {"gd", "ceres_lbfgs", "ceres_lm"};
  if (every_solver) solvers.push_back("ceres_shooting");
  for (const ModelTraits& traits : AllContactModels()) {
    const std::string contact(traits.name);
    if (traits.compared || traits.event_driven || !ReasonNotApplicable(contact, others.scene).empty()) continue;
    const bool slow = !every_solver && GradientTime(contact, others.scene) > kSlow;
    if (slow) all->slow.insert(contact);
    for (const std::string& solver : solvers) {
      if (!slow || solver != "gd") others.runs.push_back(Planned(contact, solver));
    }
  }
}

Tasks PlanTasks(const Experiments& experiments, OtherSolvers others) {
  Tasks all;
  const auto make =
      [&](const std::string& problem, double friction, const std::string& name, const std::string& title) {
        Task task;
        task.name = name;
        task.title = title;
        task.scene = experiments.scene(problem);
        task.scene.contact.friction = friction;
        for (const ModelTraits& traits : AllContactModels()) {
          const std::string contact(traits.name);
          const Experiment* known = experiments.Find(problem, friction, contact, Precision::kDouble);
          if (known == nullptr) continue;
          for (const SolverEntry& entry : AllSolvers()) {
            const std::string solver(entry.name);
            if (solver == "auto" || solver == "ipopt") continue;  // no rows of the tables
            if (!traits.event_driven && GeneralSolvers().count(solver) == 0) continue;
            const CheckedRun* run = known->Find(solver);
            task.runs.push_back(run != nullptr ? *run : Planned(contact, solver));
          }
        }
        return task;
      };
  all.launch = make("ground_wall", 0, "comparison_ground_wall", "Task 2 without friction");
  all.launch_with_friction = make("ground_wall", 0.1, "comparison_ground_wall_mu", "Task 2 with friction 0.1");
  all.strike = make("two_balls", 0, "comparison_two_balls", "Task 3");
  if (const auto optimum = FindTwoDiscOptimum(all.strike.scene, TwoDiscSequence::kImpact)) {
    all.strike.optimum = optimum->loss;
  }

  all.strike_on_fine_grid.name = "step_shooting";
  all.strike_on_fine_grid.scene = all.strike.scene;
  all.strike_on_fine_grid.scene.steps = kFineSteps;
  all.strike_on_fine_grid.optimum = all.strike.optimum;
  all.strike_on_fine_grid.runs.push_back(Planned(all.exact, "ceres_shooting"));
  for (const ModelTraits& traits : AllContactModels()) {
    const std::string contact(traits.name);
    if (!traits.event_driven && experiments.Find("two_balls", 0, contact, Precision::kDouble) != nullptr) {
      all.strike.runs.push_back(Planned(contact, "ceres_lagrangian"));
    }
  }
  if (others != OtherSolvers::kNone) PlanOthers(others == OtherSolvers::kEverySolver, &all);
  return all;
}

bool RunAll(Tasks* tasks, int threads, ProgressMode mode) {
  Tasks& all = *tasks;
  std::vector<std::pair<const Scene*, CheckedRun*>> jobs;
  for (Task* task : {&all.others, &all.strike_on_fine_grid, &all.strike, &all.launch, &all.launch_with_friction}) {
    for (CheckedRun& run : task->runs) {
      if (run.report.history.losses.empty()) jobs.push_back({&task->scene, &run});
    }
  }
  // Long jobs come first, so that no core waits for them in the end.
  std::ranges::stable_partition(jobs, [](const auto& job) {
    return job.second->report.solver == "ceres_lagrangian" || job.second->report.solver == "ceres_shooting";
  });
  std::vector<std::string> names;
  for (const auto& [scene, run] : jobs) {
    names.push_back(scene->name + " " + run->report.contact + " " + run->report.solver);
  }
  Progress progress(mode, stderr, "comparison of solvers", jobs.size());
  return RunJobs(names, threads, &progress, [&](int i, const SayNote&) {
    const auto& [scene, run] = jobs[i];
    const bool slow = all.slow.count(run->report.contact) > 0;
    SolveOne(*scene, slow ? kSlowIterations : SolverOptions().limits.iterations, run);
  });
}

Table HeadlineOf(const Tasks& all) {
  Table table(ColumnsOf("solver; method; exact loss:10; above the optimum:3; gradients; milliseconds:3"));
  table.AddRow({"optimum", "hybrid minimum principle, in continuous time", all.strike.optimum, Cell(), Cell(), Cell()});
  constexpr std::pair<const char*, const char*> kSolvers[] = {
      {"mode_search", "search over sequences of impacts, with lower bounds"},
      {"ceres_phases", "phases between impacts, whose times are variables"},
      {"gd", "gradient descent, 1000 updates as in the paper"}};
  for (const auto& [solver, method] : kSolvers) {
    const CheckedRun* run = all.strike.Find(all.exact, solver);
    if (run == nullptr || !run->exact.ok) continue;
    const double gap = run->exact.loss - all.strike.optimum;
    table.AddRow({solver,
                  method,
                  run->exact.loss,
                  Cell(gap).WithTone(ToneOfGap(gap)),
                  run->report.work.evaluations,
                  1e3 * run->report.work.seconds});
  }
  return table;
}

Table TaskTable(const Tasks& all, const Task& task) {
  Table table(
      ColumnsOf("contact; solver; loss under the model:7; exact loss:7; gap:3; iterations; gradients; milliseconds:3; "
                "termination"));
  for (const CheckedRun& run : task.runs) {
    const SolveReport& report = run.report;
    if (report.history.losses.empty() || (report.solver == "ceres_lagrangian" && report.contact != all.exact)) continue;
    Cell exact, gap;
    if (run.exact.ok) {
      exact = run.exact.loss;
      gap = Cell(run.exact.loss - task.optimum).WithTone(ToneOfGap(run.exact.loss - task.optimum));
    }
    table.AddRow({report.contact,
                  report.solver,
                  report.solution.loss,
                  exact,
                  gap,
                  report.work.iterations,
                  report.work.evaluations,
                  1e3 * report.work.seconds,
                  TerminationToString(report.termination)});
  }
  return table;
}

Table StepShootingTable(const Tasks& all) {
  Table table(
      ColumnsOf("contact; feasible path, 480:8; termination, 480; feasible path, 1000:8; termination, 1000; "
                "Lagrangian:8; open:2; termination"));
  const auto exact = [](const CheckedRun* run) { return run->exact.ok ? Cell(run->exact.loss) : Cell(); };
  for (const CheckedRun& coarse : all.strike.runs) {
    if (coarse.report.solver != "ceres_shooting") continue;
    const CheckedRun* lagrangian = all.strike.Find(coarse.report.contact, "ceres_lagrangian");
    if (lagrangian == nullptr) continue;
    const CheckedRun* fine = all.strike_on_fine_grid.Find(coarse.report.contact, "ceres_shooting");
    table.AddRow({coarse.report.contact,
                  exact(&coarse),
                  TerminationToString(coarse.report.termination),
                  fine == nullptr ? Cell() : exact(fine),
                  fine == nullptr ? Cell() : Cell(TerminationToString(fine->report.termination)),
                  exact(lagrangian),
                  LargestDefect(lagrangian->report),
                  TerminationToString(lagrangian->report.termination)});
  }
  return table;
}

std::vector<CaptionedTable> TablesOf(const Tasks& all) {
  std::vector<CaptionedTable> tables;
  for (const Task* task : {&all.launch, &all.launch_with_friction, &all.strike}) {
    tables.push_back(
        {task->name,
         task->title + ": every contact model with every solver. `gap` is the exact loss less the optimum.",
         TaskTable(all, *task)});
  }
  if (!all.others.runs.empty()) {
    tables.push_back({all.others.name,
                      all.others.title + ". Models whose gradient takes more than " + Format("%g", 1e3 * kSlow) +
                          " ms run " + std::to_string(kSlowIterations) +
                          " iterations of Ceres and no gradient descent, and none step shooting, unless "
                          "`--every_solver` is given.",
                      TaskTable(all, all.others)});
  }
  tables.push_back(
      {all.strike_on_fine_grid.name,
       "Task 3 by step shooting: along a feasible path on 480 steps, and in exact dynamics on 1000, and by an "
       "augmented Lagrangian (480 steps). Exact losses; `open` is the largest defect that is left.",
       StepShootingTable(all)});
  return tables;
}

std::string FindingOnOthers(const Tasks& all) {
  std::vector<std::pair<double, std::string>> gaps;
  for (const CheckedRun& run : all.others.runs) {
    const std::string& contact = run.report.contact;
    const bool known = std::ranges::any_of(gaps, [&](const auto& gap) { return gap.second == contact; });
    if (known) continue;
    gaps.emplace_back(all.others.SmallestGap(contact, {"ceres_lbfgs", "ceres_lm"}), contact);
  }
  std::ranges::sort(gaps);
  std::vector<std::string> near, far;
  for (const auto& [gap, contact] : gaps) {
    (gap < kNearOptimum ? near : far).push_back("`" + contact + "` (" + Format("%.2g", gap) + ")");
  }
  return "Of the formulations that the paper does not compare, Ceres comes within " + Format("%g", kNearOptimum) +
         " of the optimum of task 3 with " + (near.empty() ? "none" : Joined(near)) +
         (far.empty() ? "" : "; not with " + Joined(far)) + ". In brackets: the gap of the exact loss.";
}

std::vector<std::string> FindingsOf(const Tasks& all) {
  std::vector<std::string> findings;
  const auto gap = [&](const Task& task, const std::string& solver) -> std::optional<double> {
    const CheckedRun* run = task.Find(all.exact, solver);
    if (run == nullptr || !run->exact.ok) return std::nullopt;
    return run->exact.loss - task.optimum;
  };
  const auto say = [](const std::optional<double>& value) { return value ? Format("%.2g", *value) : "(no run)"; };

  std::string other;
  double best_other = std::numeric_limits<double>::infinity();
  for (const ModelTraits& traits : AllContactModels()) {
    const std::string contact(traits.name);
    if (contact == all.exact || contact == "toi_velocity" || !(all.strike.SmallestGap(contact) < best_other)) continue;
    best_other = all.strike.SmallestGap(contact);
    other = contact;
  }
  findings.push_back(
      "Which contact model: `" + all.exact + "`. In task 3 the best of the four general solvers ends " +
      say(all.strike.SmallestGap(all.exact)) + " above the optimum with it, " +
      say(all.strike.SmallestGap("toi_velocity")) + " with `toi_velocity`, and " + say(best_other) +
      " with the best of the others, `" + other +
      "`: a better solver does not repair a wrong gradient. Under some models least squares end without a "
      "collision; a loss of 2 is that without a force.");
  const CheckedRun* launch = all.launch.Find(all.exact, "ceres_lm");
  if (launch != nullptr && launch->exact.ok) {
    findings.push_back("Which solver, for few unknowns (task 2): `ceres_lm`. It reaches the target in " +
                       std::to_string(launch->report.work.iterations) + " iterations, to a loss of " +
                       Format("%.1g", launch->exact.loss) + "; gradient descent is at " + say(gap(all.launch, "gd")) +
                       " after 1000.");
  }
  findings.push_back(
      "Which solver, for a force through a collision (task 3): on a fixed grid the loss has a kink wherever the impact "
      "crosses a node, so that gradients do not vanish at a minimum, and each node near the best is a minimum of its "
      "own. Gaps to the optimum: gradient descent " +
      say(gap(all.strike, "gd")) + ", `ceres_lbfgs` " + say(gap(all.strike, "ceres_lbfgs")) + ", `ceres_lm` " +
      say(gap(all.strike, "ceres_lm")) + ", `ceres_shooting`, which moves the impact from node to node, " +
      say(gap(all.strike, "ceres_shooting")) + "; the best that the grid allows is " +
      say(gap(all.strike, "grid_optimum")) + ".");
  if (gap(all.strike, "ceres_event")) {
    findings.push_back("Where the impact time is a variable, there is no kink: `ceres_event` ends at " +
                       say(gap(all.strike, "ceres_event")) +
                       (gap(all.strike, "hmp") ? ", `hmp` at " + say(gap(all.strike, "hmp")) : "") +
                       ". Use these where the sequence of collisions is known.");
  }
  const CheckedRun* lagrangian = all.strike.Find(all.exact, "ceres_lagrangian");
  if (lagrangian != nullptr && lagrangian->exact.ok) {
    findings.push_back(
        "Multiple shooting with open defects should not be trusted through a collision: the augmented Lagrangian ends "
        "at an exact loss of " +
        Format("%.4f", lagrangian->exact.loss) + ", its largest defect " +
        Format("%.1g", LargestDefect(lagrangian->report)) +
        ". A feasible path (`ceres_shooting`: every iterate is a rollout) does not have this problem.");
  }
  if (!all.others.runs.empty()) findings.push_back(FindingOnOthers(all));
  return findings;
}

struct SolverStyle {
  std::string_view solver, colour;
  Dash dash;
};
// Colours of Okabe and Ito, "Color Universal Design" (2008).
constexpr std::array<SolverStyle, 10> kStyles = {{{"gd", "#999999", Dash::kSolid},
                                                  {"ceres_lbfgs", "#E69F00", Dash::kSolid},
                                                  {"ceres_lm", "#56B4E9", Dash::kSolid},
                                                  {"ceres_shooting", "#0072B2", Dash::kDashed},
                                                  {"ceres_lagrangian", "#D55E00", Dash::kDashDotted},
                                                  {"grid_optimum", "#009E73", Dash::kDotted},
                                                  {"ceres_event", "#CC79A7", Dash::kDashed},
                                                  {"ceres_phases", "#A6761D", Dash::kDotted},
                                                  {"hmp", "#882255", Dash::kDotted},
                                                  {"mode_search", "#117733", Dash::kDashDotted}}};

Series SolverSeries(const std::string& solver, std::vector<double> x, std::vector<double> y) {
  Series series{.label = solver, .x = std::move(x), .y = std::move(y)};
  for (const SolverStyle& style : kStyles) {
    if (style.solver != solver) continue;
    series.colour = style.colour;
    series.dash = style.dash;
  }
  if (series.x.size() < 4) series.marker = Marker::kCircle;
  return series;
}

PaperFigure LearningCurves(const Tasks& all) {
  Figure figure;
  for (const Task* task : {&all.launch, &all.strike}) {
    Panel panel{.title = task->title,
                .x = {.label = "iteration, the initial guess being the first", .log = true},
                .y = {.label = "loss - optimum (m²)", .log = true}};
    for (const CheckedRun& run : task->runs) {
      if (run.report.contact != all.exact) continue;
      std::vector<double> x, y;
      for (double loss : run.report.history.losses) {
        x.push_back(static_cast<double>(x.size() + 1));
        y.push_back(loss - task->optimum);
      }
      if (!x.empty()) panel.series.push_back(SolverSeries(run.report.solver, x, y));
    }
    figure.panels.push_back(panel);
  }
  return {
      "All solvers under exact dynamics. In task 2 least squares end in a few steps. In task 3 those on a fixed "
      "grid stall where the impact meets a node of the grid, each of which is a local minimum; `ceres_shooting` then "
      "moves it from node to node.",
      figure};
}

PaperFigure ControlProfiles(const Tasks& all) {
  Panel panel{.x = {.label = "time (s)"}, .y = {.label = "horizontal force on the striker (N)"}};
  for (const CheckedRun& run : all.strike.runs) {
    if (run.report.contact != all.exact || run.report.history.losses.empty()) continue;
    const Series force = ForceOf(run.report, all.strike.scene);
    panel.series.push_back(SolverSeries(run.report.solver, force.x, force.y));
  }
  panel.series.push_back(OptimalForce(all.strike.scene));
  Figure figure{.panels = {panel}};
  return {
      "Task 3: the force that each solver learns under exact dynamics, beside the analytic optimum. After the "
      "impact a force only adds effort.",
      figure};
}

PaperFigure Defects(const Tasks& all) {
  Figure figure;
  for (const std::string& contact : {all.exact, std::string("compliant_warp")}) {
    const CheckedRun* run = all.strike.Find(contact, "ceres_lagrangian");
    if (run == nullptr || run->report.history.defects.empty()) continue;
    Panel panel{.title = contact,
                .x = {.label = "time (s)"},
                .y = {.label = "largest defect of a step (relative)", .log = true, .min = 1e-6}};
    const auto& rounds = run->report.history.defects;
    const std::pair<const char*, size_t> shown[] = {{"after the first round", 0},
                                                    {"after the second", std::min<size_t>(1, rounds.size() - 1)},
                                                    {"at the end", rounds.size() - 1}};
    for (size_t i = 0; i < std::size(shown); ++i) {
      Series series;
      series.label = shown[i].first;
      series.y = rounds[shown[i].second];
      const double interval = all.strike.scene.duration / static_cast<double>(series.y.size());
      for (size_t k = 0; k < series.y.size(); ++k) series.x.push_back((static_cast<double>(k) + 0.5) * interval);
      series.colour = RampColour(0.5 * static_cast<double>(i));
      panel.series.push_back(std::move(series));
    }
    for (const Event& event : run->exact.events) {
      panel.reference_lines.push_back({.value = event.time, .label = "impact of the rollout", .vertical = true});
    }
    figure.panels.push_back(std::move(panel));
  }
  return {
      "Task 3 by the augmented Lagrangian: the defects of the steps, relative to the scene's length and speed. At "
      "first "
      "every step has one, because that costs less than a force. The multipliers should close all defects, and do not: "
      "with `event` the remaining ones jump at the impact and are largest after it, with `compliant_warp` they are "
      "largest at the contact.",
      figure};
}

}  // namespace

std::optional<ComparedSolvers> CompareSolvers(const Experiments& experiments, OtherSolvers others, int threads,
                                              ProgressMode mode) {
  Tasks all = PlanTasks(experiments, others);
  if (!RunAll(&all, threads, mode)) return std::nullopt;
  return ComparedSolvers{{FindingsOf(all), TablesOf(all), {LearningCurves(all), Defects(all)}},
                         HeadlineOf(all),
                         ControlProfiles(all),
                         all.slow};
}

}  // namespace saltus
