// Figures of the comparison of solvers.
#include <algorithm>
#include <array>
#include <optional>
#include <string_view>

#include "exact/two_disc_optimum.h"
#include "paper/solver_comparison.h"

namespace saltus {
namespace {

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

}  // namespace

std::vector<PaperFigure> SolverComparison::Figures() const { return {LearningCurves(), ControlProfiles(), Defects()}; }

PaperFigure SolverComparison::LearningCurves() const {
  Figure figure;
  for (const Task* task : {&launch_, &strike_}) {
    Panel panel;
    panel.title = task->title;
    panel.x.label = "iteration, the initial guess being the first";
    panel.y.label = "loss - optimum (m²)";
    panel.x.log = panel.y.log = true;
    for (const SolvedRun& run : task->runs) {
      if (run.report.contact != exact_) continue;
      std::vector<double> x, y;
      for (double loss : run.report.losses) {
        x.push_back(static_cast<double>(x.size() + 1));
        y.push_back(loss - task->optimum);
      }
      if (!x.empty()) panel.series.push_back(SolverSeries(run.report.solver, x, y));
    }
    figure.panels.push_back(panel);
  }
  figure.columns = 2;
  figure.width = 1200;
  figure.legend = Legend::kBelow;
  return {
      "solver_comparison",
      "All solvers under exact dynamics. In task 2 least squares end in a few steps. In task 3 those on a fixed "
      "grid stall where the impact meets a node of the grid, each of which is a local minimum; `ceres_shooting` then "
      "moves it from node to node.",
      figure};
}

PaperFigure SolverComparison::ControlProfiles() const {
  Panel panel;
  panel.x.label = "time (s)";
  panel.y.label = "horizontal force on the striker (N)";
  for (const SolvedRun& run : strike_.runs) {
    if (run.report.contact != exact_ || run.report.losses.empty()) continue;
    std::vector<double> x, y;
    const size_t intervals = run.report.control.size() / 2;
    double start = 0;
    for (size_t k = 0; k < intervals; ++k) {
      const double duration =
          run.report.durations.empty() ? strike_.scene.duration / intervals : run.report.durations[k];
      for (const double time : {start, start + duration}) {
        x.push_back(time);
        y.push_back(run.report.control[2 * k]);
      }
      start += duration;
    }
    panel.series.push_back(SolverSeries(run.report.solver, x, y));
  }
  if (const auto optimum = FindTwoDiscOptimum(strike_.scene, TwoDiscSequence::kImpact)) {
    Series analytic = Series::ForModel("analytic", {}, {});
    for (int i = 0; i <= 1000; ++i) {
      analytic.x.push_back(1e-3 * i * strike_.scene.duration);
      analytic.y.push_back(optimum->Control(analytic.x.back())[0]);
    }
    panel.series.push_back(analytic);
  }
  Figure figure;
  figure.panels = {panel};
  return {"solver_controls",
          "Task 3: the force that each solver learns under exact dynamics, beside the analytic optimum. After the "
          "impact a force is wasted.",
          figure};
}

PaperFigure SolverComparison::Defects() const {
  Figure figure;
  for (const std::string& contact : {exact_, std::string("compliant_warp")}) {
    const SolvedRun* run = strike_.Find(contact, "ceres_lagrangian");
    if (run == nullptr || run->report.defects.empty()) continue;
    Panel panel;
    panel.title = contact;
    panel.x.label = "time (s)";
    panel.y.label = "largest defect of a step (relative)";
    panel.y.log = true;
    panel.y.min = 1e-6;
    const auto& rounds = run->report.defects;
    const std::pair<const char*, size_t> shown[] = {{"after the first round", 0},
                                                    {"after the second", std::min<size_t>(1, rounds.size() - 1)},
                                                    {"at the end", rounds.size() - 1}};
    for (size_t i = 0; i < std::size(shown); ++i) {
      Series series;
      series.label = shown[i].first;
      series.y = rounds[shown[i].second];
      const double interval = strike_.scene.duration / static_cast<double>(series.y.size());
      for (size_t k = 0; k < series.y.size(); ++k) series.x.push_back((static_cast<double>(k) + 0.5) * interval);
      series.colour = RampColour(0.5 * static_cast<double>(i));
      panel.series.push_back(std::move(series));
    }
    for (const Event& event : run->exact.events) {
      panel.reference_lines.push_back({.value = event.time, .label = "impact of the rollout", .vertical = true});
    }
    figure.panels.push_back(std::move(panel));
  }
  figure.columns = 2;
  figure.width = 1200;
  figure.legend = Legend::kBelow;
  return {
      "defects",
      "Task 3 by the augmented Lagrangian: the defects of the steps, relative to the scene's length and speed. At "
      "first "
      "every step has one, because that costs less than a force. The multipliers should close all defects, and do not: "
      "with `event` the remaining ones jump at the impact and are largest after it, with `compliant_warp` they are "
      "largest at the contact.",
      figure};
}

}  // namespace saltus
