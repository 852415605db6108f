#include "programs/identify_report.h"

#include <algorithm>
#include <map>

#include "programs/identify_tables.h"
#include "programs/report_parts.h"
#include "programs/scene_panel.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr std::size_t kMostModels = 8, kMostRecordings = 6;  // in a figure
constexpr std::size_t kMostPoints = 1500;                    // of a model

// The fits that have residuals, at most so many.
std::vector<std::size_t> ShownFits(const Identified& identified) {
  std::vector<std::size_t> shown;
  for (std::size_t i = 0; i < identified.reports.size() && shown.size() < kMostModels; ++i) {
    if (!identified.reports[i].residuals.empty()) shown.push_back(i);
  }
  return shown;
}

// Samples as dots, and where each fit has them as lines, which end where a segment does.
void AddMotions(const Scene& scene, const Identified& identified, HtmlReport* report) {
  Panel panel = ScenePanel(scene, "");
  panel.circles.clear();
  const std::size_t recordings = std::min(identified.recordings.size(), kMostRecordings);
  for (const std::size_t i : ShownFits(identified)) {
    std::map<std::pair<int, int>, Series> paths;  // by recording and disc
    for (const SampleResidual& at : identified.reports[i].residuals) {
      if (static_cast<std::size_t>(at.recording) >= recordings) continue;
      const int body = identified.recordings[at.recording].samples[at.sample].body;
      Series& path =
          paths.try_emplace({at.recording, body}, Series::ForModel(identified.contacts[i], {}, {})).first->second;
      path.x.push_back(at.predicted[0]);
      path.y.push_back(at.predicted[1]);
    }
    for (auto& [key, path] : paths) {
      path.marker = Marker::kNone;
      panel.series.push_back(std::move(path));
    }
  }
  Series samples{.label = "samples", .x = {}, .y = {}, .colour = "#000000"};
  samples.line = false;
  samples.marker = Marker::kCross;
  for (std::size_t i = 0; i < recordings; ++i) {
    for (const Sample& sample : identified.recordings[i].samples) {
      samples.x.push_back(sample.position[0]);
      samples.y.push_back(sample.position[1]);
    }
  }
  panel.series.push_back(std::move(samples));
  Figure figure;
  figure.panels = {panel};
  figure.panel_height = 520;
  AddFigureOrReason(figure,
                    "The scene to scale, the samples, and where each fit has them" +
                        std::string(identified.recordings.size() > recordings ? ", of the first recordings." : "."),
                    report);
}

void AddResiduals(const Identified& identified, HtmlReport* report) {
  Panel panel;
  panel.x.label = "time (s)";
  panel.y.label = "residual (sigmas)";
  for (const std::size_t i : ShownFits(identified)) {
    const std::vector<SampleResidual>& residuals = identified.reports[i].residuals;
    Series series = Series::ForModel(identified.contacts[i], {}, {});
    series.line = false;
    const std::size_t stride = residuals.size() / kMostPoints + 1;
    for (std::size_t k = 0; k < residuals.size(); k += stride) {
      const SampleResidual& at = residuals[k];
      series.x.push_back(identified.recordings[at.recording].samples[at.sample].time);
      series.y.push_back(at.standardised.norm());
    }
    panel.series.push_back(std::move(series));
  }
  if (panel.series.empty()) return;
  Figure figure;
  figure.panels = {panel};
  AddFigureOrReason(figure, "How far each sample is from the fitted motion.", report);
}

void AddTableIfAny(const Table& table, const std::string& caption, HtmlReport* report) {
  if (!table.rows().empty()) report->AddTable(table, caption);
}

}  // namespace

void WriteIdentifyReport(const Request& request, const Identified& identified) {
  if (request.output_dir.empty()) return;
  const Scene& scene = request.scene;
  HtmlReport report = StartReport(scene);
  report.AddHeading(1, "Fits");
  AddTableIfAny(FitTable(identified), "How each fit went.", &report);
  AddTableIfAny(EstimateTable(identified), "Parameters; 95 % confidence is from ... to.", &report);
  AddTableIfAny(ComparisonTable(identified),
                "Beside `event`, whose motion and derivatives are exact: bias is what a value is more.",
                &report);
  const Table law = LawTable(identified);
  if (!law.rows().empty()) {
    report.AddHeading(1, "Law of impact");
    const Figure figure = LawFigure(*LawOf(identified), identified.known_law);
    AddFigureOrReason(figure, "The law, with a band of 95 % confidence.", &report);
    report.AddTable(law, "The law at speeds that the impacts had, in m/s.");
  }
  const Table events = EventTable(scene, identified);
  if (!events.rows().empty()) {
    report.AddHeading(1, "Event functions");
    report.AddTable(events,
                    "Impacts by the learned event functions; beyond is how far the surface is from the scene's plane, "
                    "turned by how much its normal is.");
  }
  report.AddHeading(1, "Motions");
  AddMotions(scene, identified, &report);
  AddResiduals(identified, &report);
  AddTableIfAny(OutlierTable(scene, identified),
                "Outliers, at most " + std::to_string(kMostOutliersNamed) + " of them; residuals in sigmas.",
                &report);
  FinishReport(request, &report);
}

}  // namespace saltus
