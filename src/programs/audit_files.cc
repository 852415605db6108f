#include "programs/audit_files.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "base/interrupt.h"
#include "programs/audit_tables.h"
#include "programs/surrogate_flags.h"

namespace saltus {
namespace {

constexpr Quantity kShown[] = {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl};

// Errors of right gradients are rounding; below this line of the figure they would squeeze all others.
constexpr double kLowestError = 1e-7;

Panel RefinementPanel(const Scene& scene, const AuditReport& report, Quantity quantity) {
  Panel panel;
  panel.title = std::string("by ") + QuantityToString(quantity);
  panel.x.label = "time step (s)";
  panel.y.label = "relative error of the gradient";
  panel.x.log = panel.y.log = true;
  double highest = 1;
  for (const ModelAudit& audit : report.models) {
    const QuantityStudy* study = audit.refinement ? audit.refinement->Find(quantity) : nullptr;
    if (study == nullptr) continue;
    std::vector<double> x, y;
    for (const RefinementLevel& level : study->levels) {
      x.push_back(scene.duration / level.steps);
      y.push_back(level.error);
      highest = std::max(highest, level.error);
    }
    Series series = Series::ForModel(audit.gradient.contact, x, y);
    // One label a model, whatever the panel.
    const QuantityStudy* named = audit.refinement->Find(Quantity::kPosition);
    char order[32];
    std::snprintf(order, sizeof order, " (%.1f)", std::abs(named->order) < 0.05 ? 0.0 : named->order);
    series.label += named->verdict == Verdict::kRight ? " (right)" : order;
    panel.series.push_back(std::move(series));
  }
  panel.y.min = kLowestError;
  panel.y.max = 2 * highest;
  panel.reference_lines.push_back({.value = RefinementOptions().tolerance, .label = "right"});
  return panel;
}

// The entry of a quantity in which gradient and wide differences of any model are farthest apart; -1 without sweeps.
int TellingEntry(const AuditReport& report, Quantity quantity) {
  int telling = -1;
  double largest = -1;
  for (const ModelAudit& audit : report.models) {
    if (!audit.widths) continue;
    for (size_t i = 0; i < audit.widths->sweeps.size(); ++i) {
      const WidthSweep& sweep = audit.widths->sweeps[i];
      if (sweep.quantity != quantity) continue;
      const double miss = std::abs(sweep.gradient - sweep.wide);
      if (sweep.finding == WidthFinding::kUndecided || miss <= largest) continue;
      largest = miss;
      telling = static_cast<int>(i);
    }
  }
  return telling;
}

// The exact derivative along the direction of a sweep.
std::optional<double> ExactAlong(const Scene& scene, const AuditReport& report, const WidthSweep& sweep) {
  if (!report.reference) return std::nullopt;
  if (sweep.quantity == Quantity::kControl) {
    const std::vector<double> sums = EntriesOf(scene, *report.reference, Quantity::kControl, 1);
    const std::vector<std::string> names = EntryNames(scene, Quantity::kControl, 1);
    for (size_t i = 0; i < names.size(); ++i) {
      // "ux[0] striker" is the only interval of "ux striker".
      if (names[i].substr(0, 2) + names[i].substr(5) == sweep.entry) return sums[i];
    }
    return std::nullopt;
  }
  const std::vector<std::string> names = EntryNames(scene, sweep.quantity, 1);
  const auto at = std::find(names.begin(), names.end(), sweep.entry);
  if (at == names.end()) return std::nullopt;
  return EntriesOf(scene, *report.reference, sweep.quantity, 1)[at - names.begin()];
}

void WriteFigureFiles(const Figure& figure, const std::string& path) {
  const Status status = WriteFigure(figure, path + ".svg", path + ".png");
  if (!status.ok() && !InterruptGuard::GraceIsOver()) throw OutputError(status.message());
}

}  // namespace

Figure RefinementFigure(const Scene& scene, const AuditReport& report) {
  Figure figure;
  figure.title = scene.name + ": error against the exact gradient (order by position)";
  for (const Quantity quantity : kShown) {
    Panel panel = RefinementPanel(scene, report, quantity);
    if (!panel.series.empty()) figure.panels.push_back(std::move(panel));
  }
  figure.columns = static_cast<int>(figure.panels.size());
  figure.width = 460 * figure.columns + 200;
  return figure;
}

Figure WidthFigure(const Scene& scene, const AuditReport& report) {
  Figure figure;
  figure.title = scene.name + ": differences of the loss, from narrower to wider than a step";
  for (const Quantity quantity : kShown) {
    const int entry = TellingEntry(report, quantity);
    if (entry < 0) continue;
    Panel panel;
    panel.x.label = "width / grid width";
    panel.x.log = true;
    for (const ModelAudit& audit : report.models) {
      if (!audit.widths || !audit.widths->ok()) continue;
      const WidthSweep& sweep = audit.widths->sweeps[entry];
      panel.title = "d loss / d " + sweep.entry;
      std::vector<double> x = sweep.widths;
      for (double& width : x) width /= sweep.grid_width;
      panel.series.push_back(Series::ForModel(audit.gradient.contact, x, sweep.slopes));
      if (const std::optional<double> exact = ExactAlong(scene, report, sweep);
          exact && panel.reference_lines.empty()) {
        panel.reference_lines.push_back({.value = *exact, .label = "exact"});
      }
    }
    // Single differences across an impact that changes step would hide the levels.
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const ModelAudit& audit : report.models) {
      if (!audit.widths || !audit.widths->ok()) continue;
      const WidthSweep& sweep = audit.widths->sweeps[entry];
      low = std::min({low, sweep.narrow, sweep.wide});
      high = std::max({high, sweep.narrow, sweep.wide});
    }
    const double size = std::max(std::abs(low), std::abs(high));
    const double margin = size > 0 ? std::max(0.25 * (high - low), 1e-6 * size) : 1;
    panel.y = {.label = "slope", .min = low - margin, .max = high + margin};
    figure.panels.push_back(std::move(panel));
  }
  figure.columns = std::max<int>(1, figure.panels.size());
  figure.width = 460 * figure.columns + 200;
  return figure;
}

void WriteAuditFiles(const Request& request, const AuditReport& report) {
  if (request.output_dir.empty()) return;
  const std::optional<Surrogate>& surrogate = request.options.surrogate;
  const std::string path = request.output_dir + "/" + request.scene.name + FileSuffix(surrogate);
  if (surrogate) {
    WriteTextFile(path + "_gradients.csv", SurrogateTable(request.scene, report).ToCsv());
    WriteTextFile(path + "_verdicts.md", VerdictTable(report).ToMarkdown());
    return;
  }
  WriteTextFile(path + "_gradients.csv", EntryTable(request.scene, report).ToCsv());
  WriteTextFile(path + "_refinement.csv", RefinementTable(report).ToCsv());
  WriteTextFile(path + "_contacts.csv", ContactTable(report).ToCsv());
  WriteTextFile(path + "_classes.csv", ClassTable(report).ToCsv());
  WriteTextFile(path + "_verdicts.md", VerdictTable(report).ToMarkdown());
  const bool swept =
      std::any_of(report.models.begin(), report.models.end(), [](const ModelAudit& audit) { return audit.widths; });
  if (swept) WriteTextFile(path + "_widths.csv", SlopeTable(report).ToCsv());
  if (InterruptGuard::Interrupted()) return;
  const Figure refinement = RefinementFigure(request.scene, report);
  if (!refinement.panels.empty()) WriteFigureFiles(refinement, path + "_refinement");
  if (!swept) return;
  const Figure widths = WidthFigure(request.scene, report);
  if (!widths.panels.empty()) WriteFigureFiles(widths, path + "_widths");
}

}  // namespace saltus
