#include "programs/identify_output.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "programs/program.h"
#include "programs/scene_drawing.h"
#include "saltus/simulate/registry.h"

namespace saltus {

namespace {

constexpr const char* kExact = "event";  // beside which the others stand

bool HasMinimum(const IdentifyReport& report) { return !report.residuals.empty(); }

bool IsDetermined(const Estimate& estimate) { return estimate.determination == Determination::kDetermined; }

// The fit that the others are compared with; null if there is none.
const IdentifyReport* ExactFit(const Identified& identified) {
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    if (identified.contacts[i] == kExact && HasMinimum(identified.reports[i])) return &identified.reports[i];
  }
  return nullptr;
}

// What an estimate is more than that of the exact fit; nothing if one of the two is not determined.
std::optional<double> Bias(const IdentifyReport* exact, const IdentifyReport& report, std::size_t parameter) {
  if (exact == nullptr || exact == &report || report.estimates.size() <= parameter) return std::nullopt;
  const Estimate &reference = exact->estimates[parameter], &estimate = report.estimates[parameter];
  if (!IsDetermined(reference) || !IsDetermined(estimate)) return std::nullopt;
  return estimate.value - reference.value;
}

Json EstimatesToJson(const IdentifyReport& report, const IdentifyReport* exact) {
  Json list = Json::array();
  for (std::size_t i = 0; i < report.estimates.size(); ++i) {
    const Estimate& estimate = report.estimates[i];
    const bool determined = IsDetermined(estimate);
    Json item = {{"name", estimate.name}, {"start", NumberToJson(estimate.start)}};
    item["value"] = determined ? NumberToJson(estimate.value) : Json();
    item["standard_error"] = determined ? NumberToJson(estimate.standard_error) : Json();
    item["interval"] = determined ? NumbersToJson({estimate.low, estimate.high}) : Json();
    item["determination"] = DeterminationToString(estimate.determination);
    if (!estimate.with.empty()) item["with"] = estimate.with;
    if (const auto bias = Bias(exact, report, i)) item["bias"] = NumberToJson(*bias);
    list.push_back(std::move(item));
  }
  return list;
}

Json ResidualToJson(const Scene& scene, const std::vector<Recording>& recordings, const SampleResidual& at) {
  const Recording& recording = recordings[at.recording];
  const Sample& sample = recording.samples[at.sample];
  Json item = {{"recording", recording.name}};
  if (sample.line > 0) item["line"] = sample.line;
  item["time"] = NumberToJson(sample.time);
  item["body"] = scene.bodies[sample.body].name;
  item["residual"] = NumbersToJson({at.standardised[0], at.standardised[1]});
  return item;
}

Json LawToJson(const LearnedLaw& learned) {
  Json item = {
      {"name", learned.law.name}, {"parameters", NumbersToJson(learned.law.parameters)}, {"impacts", learned.impacts}};
  item["curve"] = Json::array();
  for (const LawPoint& at : learned.curve) {
    Json point = {{"speed", NumberToJson(at.speed)},
                  {"sliding", NumberToJson(at.sliding)},
                  {"restitution", NumberToJson(at.restitution)},
                  {"standard_error", NumberToJson(at.restitution_error)}};
    if (learned.law.HasFriction()) {
      point["friction"] = NumberToJson(at.friction);
      point["friction_standard_error"] = NumberToJson(at.friction_error);
    }
    item["curve"].push_back(std::move(point));
  }
  return item;
}

Json EventsToJson(const Scene& scene, const LearnedEventFunctions& learned) {
  Json item = {{"name", learned.functions.name}, {"parameters", NumbersToJson(learned.functions.parameters)}};
  item["impacts"] = Json::array();
  for (const LearnedImpact& at : learned.impacts) {
    item["impacts"].push_back({{"segment", at.segment},
                               {"body", scene.bodies[at.body].name},
                               {"plane", scene.planes[at.plane].name},
                               {"position", NumbersToJson({at.position[0], at.position[1]})},
                               {"before", NumbersToJson({at.before[0], at.before[1]})},
                               {"after", NumbersToJson({at.after[0], at.after[1]})},
                               {"normal", NumbersToJson({at.normal[0], at.normal[1]})},
                               {"beyond_plane", NumberToJson(at.scene_gap)}});
  }
  return item;
}

// A quantity of a law over the speed of approach, with its band.
Panel LawPanel(const LearnedLaw& learned, const std::string& quantity, double LawPoint::*value,
               double LawPoint::*error) {
  Panel panel;
  panel.x.label = "speed of approach (m/s)";
  panel.y.label = quantity;
  Series mean{.label = "learned", .x = {}, .y = {}, .colour = "#D55E00", .width = 3};
  Series low{.label = "95 % confidence", .x = {}, .y = {}, .colour = "#999999"};
  Series high = low;
  for (const LawPoint& at : learned.curve) {
    for (Series* series : {&mean, &low, &high}) series->x.push_back(at.speed);
    mean.y.push_back(at.*value);
    low.y.push_back(at.*value - 1.96 * at.*error);
    high.y.push_back(at.*value + 1.96 * at.*error);
  }
  panel.series = {low, high, mean};
  return panel;
}

Series KnownLawSeries(const LearnedLaw& learned, const KnownLaw& known) {
  Series series{.label = "known", .x = {}, .y = {}, .dash = Dash::kDashed};
  for (const LawPoint& at : learned.curve) {
    const std::optional<double> restitution = known.At(at.speed);
    if (!restitution) continue;
    series.x.push_back(at.speed);
    series.y.push_back(*restitution);
  }
  return series;
}

}  // namespace

const LearnedLaw* LawOf(const Identified& identified) {
  for (const IdentifyReport& report : identified.reports) {
    if (report.law && !report.law->curve.empty()) return &*report.law;
  }
  return nullptr;
}

Table LawTable(const Identified& identified) {
  const std::optional<KnownLaw>& known = identified.known_law;
  std::vector<Column> columns = {{"speed", 4},
                                 {"sliding", 4},
                                 {"restitution", 5},
                                 {"standard error", 2},
                                 {"friction", 5},
                                 {"standard error of friction", 2}};
  if (known) columns.push_back({"known restitution", 5});
  Table table(columns);
  const LearnedLaw* learned = LawOf(identified);
  if (learned == nullptr) return table;
  const bool friction = learned->law.HasFriction();
  for (const LawPoint& at : learned->curve) {
    std::vector<Cell> row = {at.speed,
                             at.sliding,
                             at.restitution,
                             at.restitution_error,
                             friction ? Cell(at.friction) : Cell(),
                             friction ? Cell(at.friction_error) : Cell()};
    if (known) row.emplace_back(known->At(at.speed));
    table.AddRow(std::move(row));
  }
  return table;
}

Figure LawFigure(const LearnedLaw& learned, const std::optional<KnownLaw>& known) {
  Figure figure;
  figure.panels = {LawPanel(learned, "restitution", &LawPoint::restitution, &LawPoint::restitution_error)};
  if (known) figure.panels[0].series.push_back(KnownLawSeries(learned, *known));
  if (learned.law.HasFriction()) {
    figure.panels.push_back(LawPanel(learned, "friction", &LawPoint::friction, &LawPoint::friction_error));
  }
  figure.legend = Legend::kBelow;
  return figure;
}

Table EventTable(const Scene& scene, const Identified& identified) {
  Table table({{"plane"},
               {"recording"},
               {"body"},
               {"x", 5},
               {"y", 5},
               {"beyond m", 3},
               {"turned rad", 3},
               {"speed", 4},
               {"speed after", 4},
               {"restitution", 4}},
              3);
  for (const IdentifyReport& report : identified.reports) {
    if (!report.events) continue;
    for (const LearnedImpact& at : report.events->impacts) {
      const Vec2d normal = scene.planes[at.plane].normal.normalized();
      const double closing = -at.before.dot(at.normal), parting = at.after.dot(at.normal);
      table.AddRow({scene.planes[at.plane].name,
                    identified.recordings[report.segment_recording[at.segment]].name,
                    scene.bodies[at.body].name,
                    at.position[0],
                    at.position[1],
                    at.scene_gap,
                    std::atan2(normal[0] * at.normal[1] - normal[1] * at.normal[0], normal.dot(at.normal)),
                    at.before.norm(),
                    at.after.norm(),
                    parting / closing});
    }
  }
  return table;
}

Table EstimateTable(const Identified& identified) {
  Table table({{"contact"},
               {"parameter"},
               {"start", 5},
               {"value", 7},
               {"standard error", 3},
               {"from", 6},
               {"to", 6},
               {"remark"}},
              2);
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const Estimate& estimate : identified.reports[i].estimates) {
      std::string remark;
      if (estimate.determination != Determination::kDetermined) {
        remark = DeterminationToString(estimate.determination);
        for (const std::string& other : estimate.with)
          remark += (&other == &estimate.with[0] ? " with " : ", ") + other;
      }
      const auto known = [&](double value) { return remark.empty() ? Cell(value) : Cell(); };
      table.AddRow({identified.contacts[i],
                    estimate.name,
                    estimate.start,
                    known(estimate.value),
                    known(estimate.standard_error),
                    known(estimate.low),
                    known(estimate.high),
                    remark});
    }
  }
  return table;
}

Table FitTable(const Json& document) {
  return TableOf(
      document["fits"],
      "",
      "contact; verdict; samples; outliers; misfit:4; sigma:3; cost:6; impacts; starts; sequences; iterations; "
      "seconds:3; remark=reason");
}

// Every parameter under every contact model, beside what the exact fit has; empty without that, or others.
Table ComparisonTable(const Identified& identified) {
  Table table({{"parameter"},
               {"contact"},
               {"value", 7},
               {"standard error", 3},
               {"bias", 4},
               {"bias, standard errors of event", 3},
               {"iterations"},
               {"seconds", 3},
               {"verdict"},
               {"remark"}},
              2);
  const IdentifyReport* exact = ExactFit(identified);
  if (exact == nullptr || identified.reports.size() < 2) return table;
  for (std::size_t p = 0; p < exact->estimates.size(); ++p) {
    const Estimate& reference = exact->estimates[p];
    for (std::size_t i = 0; i < identified.reports.size(); ++i) {
      const IdentifyReport& report = identified.reports[i];
      const Estimate* estimate = p < report.estimates.size() ? &report.estimates[p] : nullptr;
      const bool known = estimate != nullptr && IsDetermined(*estimate);
      const std::optional<double> bias = Bias(exact, report, p);
      std::string remark = report.reason;
      if (estimate != nullptr && !known) remark = DeterminationToString(estimate->determination);
      table.AddRow({reference.name,
                    identified.contacts[i],
                    known ? Cell(estimate->value) : Cell(),
                    known ? Cell(estimate->standard_error) : Cell(),
                    bias,
                    bias ? Cell(*bias / reference.standard_error) : Cell(),
                    report.iterations,
                    report.seconds,
                    FitVerdictToString(report.verdict),
                    remark});
    }
  }
  return table;
}

Table OutlierTable(const Json& document) {
  return TableOf(document["fits"],
                 "/outliers",
                 "contact=^contact; recording; line; time:6; body; residual x=residual/0:3; residual y=residual/1:3",
                 3,
                 kMostOutliersNamed);
}

Table ResidualTable(const Scene& scene, const Identified& identified) {
  Table residuals({{"contact"},
                   {"recording"},
                   {"line"},
                   {"time"},
                   {"body"},
                   {"x"},
                   {"y"},
                   {"residual_x"},
                   {"residual_y"},
                   {"outlier"}});
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const SampleResidual& at : identified.reports[i].residuals) {
      const Recording& recording = identified.recordings[at.recording];
      const Sample& sample = recording.samples[at.sample];
      residuals.AddRow({identified.contacts[i],
                        recording.name,
                        sample.line,
                        sample.time,
                        scene.bodies[sample.body].name,
                        at.predicted[0],
                        at.predicted[1],
                        at.standardised[0],
                        at.standardised[1],
                        int{at.outlier}});
    }
  }
  return residuals;
}

Json IdentifiedToJson(const Scene& scene, const Identified& identified) {
  Json list = Json::array();
  const IdentifyReport* exact = ExactFit(identified);
  bool interrupted = identified.reports.size() < identified.contacts.size();
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    const IdentifyReport& report = identified.reports[i];
    interrupted |= report.verdict == FitVerdict::kInterrupted;
    Json item = {{"contact", identified.contacts[i]}, {"verdict", FitVerdictToString(report.verdict)}};
    if (!report.reason.empty()) item["reason"] = report.reason;
    if (HasMinimum(report)) {
      item["cost"] = NumberToJson(report.cost);
      if (report.misfit > 0) item["misfit"] = NumberToJson(report.misfit);
      if (report.sigma > 0) item["sigma"] = NumberToJson(report.sigma);
      item["samples"] = report.residuals.size();
      item["impacts"] = report.impacts;
      item["parameters"] = EstimatesToJson(report, exact);
      item["correlation"] = Json::array();
      for (const std::vector<double>& row : report.correlation) item["correlation"].push_back(NumbersToJson(row));
      if (report.law) item["law"] = LawToJson(*report.law);
      if (report.events) item["events"] = EventsToJson(scene, *report.events);
      item["outliers"] = Json::array();
      for (const SampleResidual& at : report.residuals) {
        if (at.outlier) item["outliers"].push_back(ResidualToJson(scene, identified.recordings, at));
      }
      item["segments"] = Json::array();
      for (std::size_t s = 0; s < report.initial.size(); ++s) {
        item["segments"].push_back({{"recording", identified.recordings[report.segment_recording[s]].name},
                                    {"begin", NumberToJson(report.segment_begin[s])},
                                    {"position", VectorsToJson(scene, report.initial[s], 0)},
                                    {"velocity", VectorsToJson(scene, report.initial[s], 2)}});
      }
    }
    item["starts"] = report.starts;
    item["sequences"] = report.sequences;
    item["iterations"] = report.iterations;
    item["evaluations"] = report.evaluations;
    item["seconds"] = report.seconds;
    list.push_back(std::move(item));
  }
  Json document = {{"scene", scene.name}, {"fits", std::move(list)}};
  if (interrupted) document["interrupted"] = true;
  return document;
}

// ---- Page

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
void AddMotions(const Scene& scene, const Identified& identified, Page* page) {
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
  page->AddFigure(figure,
                  "The samples, and the fitted motions" +
                      std::string(identified.recordings.size() > recordings ? " of the first recordings." : "."));
}

void AddResiduals(const Identified& identified, Page* page) {
  Panel panel;
  panel.x.label = "time (s)";
  panel.y.label = "residual (standard deviations)";
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
  page->AddFigure(figure, "Distance of each sample from the fitted motion, in standard deviations of the noise.");
}

void AddTableIfAny(const Table& table, const std::string& caption, Page* page) {
  if (!table.rows().empty()) page->AddTable(table, caption);
}

}  // namespace

void WriteIdentifyReport(const Request& request, const Identified& identified, const Json& document) {
  if (request.output_dir.empty()) return;
  const Scene& scene = request.scene;
  Page page = StartPage(scene);
  page.AddHeading("Fits");
  AddTableIfAny(FitTable(document), "The fit of each contact model.", &page);
  AddTableIfAny(EstimateTable(identified), "Parameters; `from` and `to` bound the 95 % confidence interval.", &page);
  AddTableIfAny(
      ComparisonTable(identified),
      "Compared with `event`, whose motion and derivatives are exact: the bias is the value less that of `event`.",
      &page);
  const Table law = LawTable(identified);
  if (!law.rows().empty()) {
    page.AddHeading("Law of impact");
    const Figure figure = LawFigure(*LawOf(identified), identified.known_law);
    page.AddFigure(figure, "The law with its 95 % confidence band.");
    page.AddTable(law, "The law at speeds that the impacts had, in m/s.");
  }
  const Table events = EventTable(scene, identified);
  if (!events.rows().empty()) {
    page.AddHeading("Event functions");
    page.AddTable(events,
                  "Impacts by the learned event functions; `beyond` is the distance of the surface from the scene's "
                  "plane, `turned` "
                  "the angle between their normals.");
  }
  page.AddHeading("Motions");
  AddMotions(scene, identified, &page);
  AddResiduals(identified, &page);
  AddTableIfAny(OutlierTable(document),
                "Outliers, at most " + std::to_string(kMostOutliersNamed) + " of them; residuals in sigmas.",
                &page);
  FinishPage(request, document, &page);
}

}  // namespace saltus
