#include "programs/solve_report.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "programs/certificate_table.h"
#include "programs/replay_scene.h"
#include "programs/report_parts.h"
#include "programs/scene_panel.h"
#include "programs/simulated_run.h"
#include "programs/solution_files.h"
#include "programs/surrogate_flags.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

constexpr size_t kMostMotions = 8;       // in a replay
constexpr size_t kMostImpacts = 8;       // marked in a figure
constexpr size_t kMostIntervals = 1000;  // of a control in a figure
constexpr size_t kMostCurvePoints = 2000;

std::string LabelOfRun(const SolveReport& report) {
  return LabelOf(report.contact, report.surrogate) + (report.solver == kNoSolver ? "" : " " + report.solver);
}

// Colours tell contact models apart, dashes the solvers.
struct RunStyle {
  std::string colour;
  Dash dash = Dash::kSolid;
};
RunStyle StyleOfRun(const Request& request, const SolveReport& report) {
  const ModelStyle& style = StyleOf(report.contact);
  if (request.solvers.size() < 2) return {std::string(style.colour), style.dash};
  static constexpr Dash kDashes[] = {Dash::kSolid, Dash::kDashed, Dash::kDotted, Dash::kDashDotted};
  const auto at = std::find(request.solvers.begin(), request.solvers.end(), report.solver);
  return {std::string(style.colour), kDashes[(at - request.solvers.begin()) % 4]};
}

// Runs with a solution, the best first: those that meet the constraints, by their exact loss; those without one last.
std::vector<const SolvedRun*> RankedRuns(const SolvedRuns& solved) {
  std::vector<const SolvedRun*> runs;
  for (const SolvedRun& run : solved.runs) {
    if (run.HasSolution()) runs.push_back(&run);
  }
  const auto loss = [](const SolvedRun* run) { return run->exact.ok ? run->exact.loss : HUGE_VAL; };
  const auto rank = [&](const SolvedRun* run) { return std::pair(run->report.final_violation > kFeasible, loss(run)); };
  std::stable_sort(runs.begin(), runs.end(), [&](const SolvedRun* l, const SolvedRun* r) { return rank(l) < rank(r); });
  return runs;
}

std::vector<Tile> TilesOf(const Request& request, const SolvedRuns& solved) {
  const std::vector<const SolvedRun*> runs = RankedRuns(solved);
  std::vector<Tile> tiles;
  if (!runs.empty() && runs[0]->exact.ok) {
    tiles.push_back({Cell(runs[0]->exact.loss).Display(10), "least exact loss, by " + LabelOfRun(runs[0]->report)});
    if (runs[0]->certificate) {
      const Certificate& certificate = *runs[0]->certificate;
      const std::string words = VerdictInWords(certificate);
      const bool good = certificate.IsStationary() && !certificate.IsSaddle();
      tiles.push_back({words.empty() ? "not certified" : words,
                       "what its certificate reports",
                       good ? Tone::kGood : Tone::kWarning});
    }
  }
  const auto failed = std::count_if(
      solved.runs.begin(), solved.runs.end(), [](const SolvedRun& run) { return !WhyNoAnswer(run.report).empty(); });
  const auto refused = std::count_if(solved.runs.begin(), solved.runs.end(), [](const SolvedRun& run) {
    return run.report.termination == Termination::kNotApplicable;
  });
  const auto taken = static_cast<std::ptrdiff_t>(solved.runs.size()) - refused;
  const std::string what = request.solvers.empty() ? "simulations that ran" : "runs that are an answer";
  tiles.push_back({std::to_string(taken - failed) + " of " + std::to_string(taken),
                   what + (refused > 0 ? "; " + std::to_string(refused) + " refused the scene" : ""),
                   failed == 0 ? Tone::kGood : Tone::kWarning});
  return tiles;
}

bool IsExact(const SolveReport& report) { return FindContactModel(report.contact)->event_driven; }

MotionInput InputOf(const SolveReport& report) { return {report.initial_state, report.control, report.durations}; }

// The motions that are shown, of the best runs: each under its own model, and the best in exact dynamics.
struct RunMotions {
  std::vector<Motion> own;
  Motion exact;
};

RunMotions MotionsOf(const Request& request, const std::vector<const SolvedRun*>& runs) {
  RunMotions motions;
  const size_t shown = std::min(runs.size(), kMostMotions);
  const MotionOptions options = ReplayOptions(request.scene, shown + 1);
  for (size_t i = 0; i < shown; ++i) motions.own.push_back(MotionOf(request, runs[i]->report, false, options));
  if (shown == 0) return motions;
  const SolveReport& best = runs[0]->report;
  motions.exact = IsExact(best) ? motions.own[0] : MotionOf(request, best, true, options);
  return motions;
}

void AddRunReplay(const Request& request, const std::vector<const SolvedRun*>& runs, const RunMotions& motions,
                  HtmlReport* report) {
  Replay replay = ReplayOf(request.scene);
  const auto add = [&](size_t i, const Motion& motion, bool exact) {
    if (motion.times.empty()) return;
    const SolveReport& run = runs[i]->report;
    const RunStyle style = StyleOfRun(request, run);
    ReplayMotion drawn = ToReplayMotion(
        request.scene, motion, InputOf(run), LabelOfRun(run) + (exact ? ", in exact dynamics" : ""), run.contact);
    drawn.colour = exact ? "#000000" : style.colour;
    drawn.dash = exact ? Dash::kDashed : style.dash;
    drawn.shown = i < 4;
    replay.motions.push_back(std::move(drawn));
  };
  for (size_t i = 0; i < motions.own.size(); ++i) {
    add(i, motions.own[i], false);
    if (i == 0 && !IsExact(runs[0]->report)) add(0, motions.exact, true);
  }
  if (replay.motions.empty()) return;
  report->AddHeading(1, "Replay");
  report->AddReplay(replay,
                    "The motions" + std::string(runs.size() > motions.own.size() ? " of least exact loss" : "") +
                        ". Space plays and pauses, arrows step, with shift from impact to impact. Forces are green, "
                        "impulses red.");
}

// Each run under its own model, and dashed in black the best in exact dynamics.
void AddTrajectories(const Request& request, const std::vector<const SolvedRun*>& runs, const RunMotions& motions,
                     HtmlReport* report) {
  Panel panel = ScenePanel(request.scene, "");
  for (size_t i = 0; i < motions.own.size(); ++i) {
    const RunStyle style = StyleOfRun(request, runs[i]->report);
    AddPaths(request.scene, motions.own[i], LabelOfRun(runs[i]->report), style.colour, style.dash, &panel);
  }
  AddPaths(request.scene, motions.exact, "the best, in exact dynamics", "#000000", Dash::kDashed, &panel);
  Figure figure;
  figure.panels = {panel};
  figure.panel_height = 520;
  AddFigureOrReason(figure, "The scene to scale, and trajectories. Filled dots are targets.", report);
}

// Forces are constant over intervals: two points each.
Series StepsOf(const Scene& scene, const SolveReport& run, size_t column, const RunStyle& style) {
  ControlGuess control{run.control, run.durations};
  const size_t width = scene.control_width();
  const double duration = DurationOf(control, scene);
  if (control.control.size() / width > kMostIntervals) {
    control.control = MeanOverSteps(control, scene.control_width(), kMostIntervals);
    control.durations.assign(kMostIntervals, duration / kMostIntervals);
  }
  Series series{.label = LabelOfRun(run), .x = {}, .y = {}, .colour = style.colour, .dash = style.dash};
  double time = 0;
  const std::vector<double> lengths = LengthsOf(control, scene);
  for (size_t k = 0; k < lengths.size(); ++k) {
    for (const double end : {time, time + lengths[k]}) {
      series.x.push_back(end);
      series.y.push_back(control.control[k * width + column]);
    }
    time += lengths[k];
  }
  return series;
}

// A panel of one number of the rows of a control, times `factor`.
Panel ControlPanel(const Request& request, const std::vector<const SolvedRun*>& runs, size_t column,
                   const std::string& title, const std::string& label, double factor = 1) {
  Panel panel;
  panel.title = title;
  panel.x.label = "time (s)";
  panel.y.label = label;
  for (size_t i = 0; i < std::min(runs.size(), kMostMotions); ++i) {
    panel.series.push_back(StepsOf(request.scene, runs[i]->report, column, StyleOfRun(request, runs[i]->report)));
    for (double& y : panel.series.back().y) y *= factor;
  }
  const std::vector<Event>& events = runs[0]->exact.events;
  for (size_t e = 0; e < std::min(events.size(), kMostImpacts); ++e) {
    panel.reference_lines.push_back({.value = events[e].time,
                                     .label = events[e].a + " meets " + events[e].b,
                                     .vertical = true,
                                     .colour = "#6e7781",
                                     .dash = Dash::kDotted});
  }
  return panel;
}

void AddControls(const Request& request, const std::vector<const SolvedRun*>& runs, HtmlReport* report) {
  const Scene& scene = request.scene;
  if (scene.num_controlled() == 0 || runs.empty()) return;
  Figure figure;
  constexpr int kMostDiscs = 4;
  for (int c = 0; c < std::min(scene.num_controlled(), kMostDiscs); ++c) {
    const std::string& name = scene.bodies[scene.control.bodies[c]].name;
    for (const int j : {0, 1}) {
      const std::string label = std::string(j == 0 ? "force x" : "force y") + " (N)";
      figure.panels.push_back(ControlPanel(request, runs, 2 * c + j, name, label));
    }
  }
  for (int t = 0; t < std::min(scene.num_turned(), kMostDiscs); ++t) {
    const Body& body = scene.bodies[scene.control.turned[t]];
    figure.panels.push_back(ControlPanel(request, runs, scene.TurnIndex(0, t), body.name, "torque (N m)", body.radius));
  }
  figure.columns = 2;
  figure.width = 1100;
  figure.legend = Legend::kBelow;
  report->AddHeading(1, "Controls");
  AddFigureOrReason(figure,
                    std::string(scene.num_turned() > 0 ? "Forces and torques" : "Forces") +
                        " over time. Dotted: impacts of the run of least exact loss, in exact dynamics.",
                    report);
}

void AddLearningCurves(const Request& request, const std::vector<const SolvedRun*>& runs, HtmlReport* report) {
  Panel panel;
  panel.x.label = "iteration";
  panel.y.label = "loss under the contact model";
  bool positive = true;
  for (const SolvedRun* run : runs) {
    const std::vector<double>& losses = run->report.losses;
    if (losses.size() < 2) continue;
    const RunStyle style = StyleOfRun(request, run->report);
    Series series{.label = LabelOfRun(run->report), .x = {}, .y = {}, .colour = style.colour, .dash = style.dash};
    const size_t stride = losses.size() / kMostCurvePoints + 1;
    for (size_t k = 0; k < losses.size(); ++k) {
      if (k % stride != 0 && k + 1 != losses.size()) continue;
      series.x.push_back(static_cast<double>(k));
      series.y.push_back(losses[k]);
      positive = positive && losses[k] > 0;
    }
    panel.series.push_back(std::move(series));
  }
  if (panel.series.empty()) return;
  panel.y.log = positive;
  Figure figure;
  figure.panels = {panel};
  figure.legend = panel.series.size() > kMostMotions ? Legend::kBelow : Legend::kRight;
  report->AddHeading(1, "Learning curves");
  AddFigureOrReason(
      figure, "The loss that each solver has minimised, which only under exact dynamics is the real one.", report);
}

// Of the impacts of a certified run: when, how fast, and what the conditions of the minimum principle give.
void AddImpacts(const std::vector<const SolvedRun*>& runs, HtmlReport* report) {
  if (runs.empty() || !runs[0]->certificate || runs[0]->certificate->impacts.empty()) return;
  Table table({{"time (s)", 10},
               {"disc"},
               {"meets"},
               {"speed (m/s)", 6},
               {"multiplier", 6},
               {"costate jump", 3},
               {"on a node"}});
  for (const ImpactCertificate& impact : runs[0]->certificate->impacts) {
    table.AddRow(
        {impact.time, impact.a, impact.b, impact.speed, impact.multiplier, impact.jump, impact.on_node ? "yes" : "no"});
  }
  report->AddTable(table,
                   "Impacts of " + LabelOfRun(runs[0]->report) +
                       ". The multiplier is the jump of the costate along the contact's gap; what is left of the "
                       "jump condition is in the column beside it.");
}

}  // namespace

void AddSolveSections(const Request& request, const SolvedRuns& solved, HtmlReport* report) {
  const std::vector<const SolvedRun*> runs = RankedRuns(solved);
  report->AddHeading(1, request.solvers.empty() ? "Simulations" : "Runs");
  report->AddTiles(TilesOf(request, solved));
  report->AddTable(
      RunTable(solved),
      "`final loss` is under the contact model, `exact loss` of the same solution under exact dynamics: the "
      "only one that may be compared between models.");
  const Table certificates = CertificateTable(solved);
  if (!certificates.rows().empty()) {
    report->AddTable(certificates,
                     "Certificates of the exact loss. Residuals are relative; a curvature of 1 is that of "
                     "the effort alone.");
  }
  AddImpacts(runs, report);
  const RunMotions motions = MotionsOf(request, runs);
  AddRunReplay(request, runs, motions, report);
  if (!runs.empty()) {
    report->AddHeading(1, "Trajectories");
    AddTrajectories(request, runs, motions, report);
  }
  AddControls(request, runs, report);
  AddLearningCurves(request, runs, report);
  std::vector<Link> links;
  for (const SolvedRun* run : runs) {
    const std::string file = SolutionFileName(request.scene, run->report);
    links.push_back({file, file});
  }
  if (links.empty()) return;
  report->AddHeading(1, "Files");
  report->AddLinks(links);
}

void WriteSolveReport(const Request& request, const SolvedRuns& solved) {
  if (request.output_dir.empty()) return;
  HtmlReport report = StartReport(request.scene);
  AddSolveSections(request, solved, &report);
  FinishReport(request, &report);
}

}  // namespace saltus
