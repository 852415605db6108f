#include "programs/identification.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>

#include "base/csv.h"
#include "base/number_text.h"
#include "programs/scene_drawing.h"
#include "scene/units.h"

namespace saltus {
namespace {

constexpr const char* kExact = "event";  // beside which the others stand
constexpr std::size_t kMostOutliersNamed = 20;

// Whether fits are of a scene under contact models, or of a hybrid system.
bool IsOfScene(const Json& document) { return document["fits"].empty() || document["fits"][0].contains("contact"); }

bool HasMinimum(const IdentifyReport& report) { return !report.residuals.empty(); }

bool IsDetermined(const Estimate& estimate) { return estimate.determination == Determination::kDetermined; }
bool IsDetermined(const Json& parameter) {
  return parameter["determination"] == DeterminationToString(Determination::kDetermined);
}

// One at its bound has a value, but no standard error.
bool HasValue(const Estimate& estimate) {
  return IsDetermined(estimate) || estimate.determination == Determination::kAtBound;
}

// The fit that the others are compared with; null if there is none.
const IdentifyReport* ExactFit(const Identified& identified) {
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    if (identified.contacts[i] == kExact && HasMinimum(identified.reports[i])) return &identified.reports[i];
  }
  return nullptr;
}

// Returns the difference of an estimate from that of the exact fit; std::nullopt if one of them is not determined.
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
    Json item = {{"name", estimate.name}, {"start", estimate.start}};
    item["value"] = HasValue(estimate) ? Json(estimate.value) : Json();
    item["standard_error"] = determined ? Json(estimate.standard_error) : Json();
    item["interval"] = determined ? Json({estimate.low, estimate.high}) : Json();
    item["determination"] = DeterminationToString(estimate.determination);
    if (!estimate.with.empty()) item["with"] = estimate.with;
    if (const auto bias = Bias(exact, report, i)) item["bias"] = *bias;
    list.push_back(std::move(item));
  }
  return list;
}

// The fit itself. A scene's recordings and bodies are the experiments and quantities of a hybrid system.
void AddFit(const IdentifyReport& report, const IdentifyReport* exact, bool of_scene, Json* item) {
  (*item)["verdict"] = FitVerdictToString(report.verdict);
  if (!report.reason.empty()) (*item)["reason"] = report.reason;
  if (!report.remarks.empty()) (*item)["remarks"] = report.remarks;
  if (!HasMinimum(report)) return;
  (*item)["cost"] = report.cost;
  if (report.misfit > 0) (*item)["misfit"] = report.misfit;
  if (report.sigma > 0 && of_scene) (*item)["sigma"] = report.sigma;
  for (std::size_t q = 0; q < report.sigmas.size(); ++q) (*item)["sigma"][report.quantities[q]] = report.sigmas[q];
  (*item)["samples"] = report.residuals.size();
  (*item)[of_scene ? "impacts" : "events"] = report.impacts;
  (*item)["parameters"] = EstimatesToJson(report, exact);
  (*item)["correlation"] = report.correlation;
  Json& outliers = (*item)["outliers"] = Json::array();
  for (const SampleResidual& at : report.residuals) {
    if (!at.outlier) continue;
    Json outlier = {{of_scene ? "recording" : "experiment", report.recordings[at.recording]}};
    if (at.line > 0) outlier["line"] = at.line;
    outlier["time"] = at.time;
    outlier[of_scene ? "body" : "quantity"] = report.quantities[at.quantity];
    outlier["residual"] = at.standardised;
    outliers.push_back(std::move(outlier));
  }
}

void AddWork(const IdentifyReport& report, Json* item) {
  SALTUS_ADD_MEMBERS(item, report, starts, sequences, iterations, evaluations, seconds);
}

Json LawToJson(const LearnedLaw& learned, const std::optional<KnownLaw>& known) {
  Json item = {{"name", learned.law.name}, {"parameters", learned.law.parameters}, {"impacts", learned.impacts}};
  item["curve"] = Json::array();
  for (const LawPoint& at : learned.curve) {
    Json point;
    SALTUS_ADD_MEMBERS(&point, at, speed, sliding, restitution);
    point["standard_error"] = at.restitution_error;
    if (learned.law.HasFriction()) {
      point["friction"] = at.friction;
      point["friction_standard_error"] = at.friction_error;
    }
    if (const auto restitution = known ? known->RestitutionAt(at.speed) : std::nullopt)
      point["known_restitution"] = *restitution;
    item["curve"].push_back(std::move(point));
  }
  return item;
}

// The impacts have the angle between the surface and the scene's plane, and their own restitution.
Json EventsToJson(const Scene& scene, const IdentifyReport& report) {
  const LearnedEventFunctions& learned = *report.events;
  Json item = {{"name", learned.functions.name}, {"parameters", learned.functions.parameters}};
  item["impacts"] = Json::array();
  for (const LearnedImpact& at : learned.impacts) {
    const Plane& plane = scene.planes[at.plane];
    const Vec2d normal = plane.normal.normalized();
    Json& impact = item["impacts"].emplace_back(Json{{"segment", at.segment}, {"body", scene.bodies[at.body].name}});
    impact["recording"] = report.recordings[report.segment_recording[at.segment]];
    impact["plane"] = plane.name;
    SALTUS_ADD_MEMBERS(&impact, at, position, before, after, normal);
    impact["beyond_plane"] = at.scene_gap;
    impact["turned"] = std::atan2(normal[0] * at.normal[1] - normal[1] * at.normal[0], normal.dot(at.normal));
    impact["speed"] = at.before.norm();
    impact["speed_after"] = at.after.norm();
    impact["restitution"] = -at.after.dot(at.normal) / at.before.dot(at.normal);
  }
  return item;
}

// A quantity of a law over the speed of approach, with its band.
Panel LawPanel(const LearnedLaw& learned, const std::string& quantity, double LawPoint::*value,
               double LawPoint::*error) {
  Panel panel{.x = {.label = "speed of approach (m/s)"}, .y = {.label = quantity}};
  Series mean{.label = "learned", .colour = "#D55E00", .width = 3};
  Series low{.label = "95 % confidence", .colour = "#999999"};
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
  Series series{.label = "known", .dash = Dash::kDashed};
  for (const LawPoint& at : learned.curve) {
    const std::optional<double> restitution = known.RestitutionAt(at.speed);
    if (!restitution) continue;
    series.x.push_back(at.speed);
    series.y.push_back(*restitution);
  }
  return series;
}

}  // namespace

Figure LawFigure(const LearnedLaw& learned, const std::optional<KnownLaw>& known) {
  Figure figure{.panels = {LawPanel(learned, "restitution", &LawPoint::restitution, &LawPoint::restitution_error)}};
  if (known) figure.panels[0].series.push_back(KnownLawSeries(learned, *known));
  if (learned.law.HasFriction()) {
    figure.panels.push_back(LawPanel(learned, "friction", &LawPoint::friction, &LawPoint::friction_error));
  }
  return figure;
}

namespace {

Table EstimateTable(const Json& document) {
  Json fits = document["fits"];
  for (Json& fit : fits) {
    if (!fit.contains("parameters")) continue;
    for (Json& parameter : fit["parameters"]) {
      if (IsDetermined(parameter)) continue;
      std::string remark = parameter["determination"];
      const auto with = parameter.value("with", std::vector<std::string>());
      if (!with.empty()) remark += " with " + Joined(with);
      parameter["remark"] = remark;
    }
  }
  const std::string by = IsOfScene(document) ? "contact" : "system";
  return TableOf(fits,
                 "/parameters",
                 by + "=^" + by +
                     "; parameter=name; start:5; value:7; standard error:3; from=interval/0:6; to=interval/1:6; remark",
                 2);
}

Table FitTable(const Json& document) {
  return TableOf(
      document["fits"],
      "",
      std::string(IsOfScene(document) ? "contact; verdict; samples; outliers; misfit:4; sigma:3; cost:6; impacts"
                                      : "system; verdict; samples; outliers; misfit:4; cost:6; events") +
          "; starts; sequences; iterations; seconds:3; remark=reason");
}

Table ComparisonTable(const Json& document) {
  const Json& fits = document["fits"];
  const auto exact = std::ranges::find_if(
      fits, [](const Json& fit) { return fit.value("contact", "") == kExact && fit.contains("parameters"); });
  Json rows = Json::array();
  for (std::size_t p = 0; exact != fits.end() && fits.size() > 1 && p < (*exact)["parameters"].size(); ++p) {
    const Json& reference = (*exact)["parameters"][p];
    for (const Json& fit : fits) {
      Json& row = rows.emplace_back(fit.value(Json::json_pointer("/parameters") / p, Json::object()));
      const bool known = row.empty() || IsDetermined(row);
      row["remark"] = known ? Json(fit.value("reason", "")) : Json(row["determination"]);
      if (row.contains("bias")) row["biases"] = row["bias"].get<double>() / reference["standard_error"].get<double>();
      row["parameter"] = reference["name"];
      for (const char* key : {"contact", "iterations", "seconds", "verdict"}) row[key] = fit[key];
    }
  }
  return TableOf(rows,
                 "",
                 "parameter; contact; value:7; standard error:3; bias:4; bias, standard errors of event=biases:3; "
                 "iterations; seconds:3; verdict; remark",
                 2);
}

Table OutlierTable(const Json& document) {
  const char* columns =
      IsOfScene(document)
          ? "contact=^contact; recording; line; time:6; body; residual x=residual/0:3; residual y=residual/1:3"
          : "system=^system; experiment; quantity; time:6; residual=residual/0:3";
  return TableOf(document["fits"], "/outliers", columns, 3, kMostOutliersNamed);
}

Table LawTable(const Json& document) {
  bool known = false;  // the law that the learned one stands beside
  for (const Json& fit : document["fits"]) {
    for (const Json& point : fit.value(Json::json_pointer("/law/curve"), Json::array())) {
      known |= point.contains("known_restitution");
    }
  }
  return TableOf(document["fits"],
                 "/law/curve",
                 "speed:4; sliding:4; restitution:5; standard error:2; friction:5; "
                 "standard error of friction=friction_standard_error:2" +
                     std::string(known ? "; known restitution:5" : ""));
}

}  // namespace

std::vector<CaptionedTable> FitTables(const Json& document) {
  return {{"fits", IsOfScene(document) ? "The fit of each contact model" : "The fit", FitTable(document)},
          {"parameters", "Parameters; 95 % confidence is from ... to", EstimateTable(document)},
          {"beside_event",
           "Beside event, whose motion and derivatives are exact: bias is what a value is more",
           ComparisonTable(document)},
          {"law", "Law of impact, at speeds that the impacts had, in m/s", LawTable(document)},
          {"events",
           "Impacts by the learned event functions; beyond is how far the surface is from the scene's plane, turned by "
           "how much its normal is",
           TableOf(document["fits"],
                   "/events/impacts",
                   "plane; recording; body; x=position/0:5; y=position/1:5; beyond m=beyond_plane:3; "
                   "turned rad=turned:3; speed:4; speed after:4; restitution:4",
                   3)},
          {"outliers",
           "Outliers, at most " + std::to_string(kMostOutliersNamed) + " of them, residuals in sigmas",
           OutlierTable(document)}};
}

std::vector<std::string> FitRemarks(const Identified& identified) {
  std::vector<std::string> remarks;
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const std::string& remark : identified.reports[i].remarks) {
      remarks.push_back(identified.contacts[i] + ": " + remark);
    }
  }
  return remarks;
}

Table ResidualTable(const Identified& identified) {
  Table residuals(ColumnsOf("contact; recording; line; time; body; x; y; residual_x; residual_y; outlier"));
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    const IdentifyReport& report = identified.reports[i];
    for (const SampleResidual& at : report.residuals) {
      residuals.AddRow({identified.contacts[i],
                        report.recordings[at.recording],
                        at.line,
                        at.time,
                        report.quantities[at.quantity],
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
    Json item = {{"contact", identified.contacts[i]}};
    AddFit(report, exact, /*of_scene=*/true, &item);
    if (HasMinimum(report)) {
      if (report.law) item["law"] = LawToJson(*report.law, identified.known_law);
      if (report.events) item["events"] = EventsToJson(scene, report);
      item["segments"] = Json::array();
      for (std::size_t s = 0; s < report.initial.size(); ++s) {
        item["segments"].push_back({{"recording", report.recordings[report.segment_recording[s]]},
                                    {"begin", report.segment_begin[s]},
                                    {"position", VectorsToJson(scene, report.initial[s], 0)},
                                    {"velocity", VectorsToJson(scene, report.initial[s], 2)}});
      }
    }
    AddWork(report, &item);
    list.push_back(std::move(item));
  }
  Json document = {{"scene", scene.name}, {"fits", std::move(list)}};
  if (interrupted) document["interrupted"] = true;
  return document;
}

// ---- Page

namespace {

// The law of impact that was learned; null if none was.
const LearnedLaw* LawOf(const Identified& identified) {
  for (const IdentifyReport& report : identified.reports) {
    if (report.law && !report.law->curve.empty()) return &*report.law;
  }
  return nullptr;
}

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

void AddTable(const std::vector<CaptionedTable>& tables, const std::string& name, Page* page) {
  const auto found = std::ranges::find(tables, name, &CaptionedTable::name);
  page->AddTableIfAny(found->table, found->caption + ".");
}

void AddFits(const Identified& identified, const std::vector<CaptionedTable>& tables, Page* page) {
  page->AddHeading("Fits");
  AddTable(tables, "fits", page);
  if (const std::vector<std::string> remarks = FitRemarks(identified); !remarks.empty()) page->AddList(remarks);
  AddTable(tables, "parameters", page);
  AddTable(tables, "beside_event", page);
}

// Draws samples as dots, the motion of each fit as lines, which end where a segment does, and the walls of the first
// fit.
void AddMotions(const Scene& scene, const Identified& identified, Page* page) {
  const std::vector<std::size_t> shown = ShownFits(identified);
  Panel panel = ScenePanel(shown.empty() ? scene : FittedScene(scene, identified.reports[shown[0]].estimates), "");
  panel.circles.clear();
  const std::size_t recordings = std::min(identified.recordings.size(), kMostRecordings);
  for (const std::size_t i : shown) {
    std::map<std::pair<int, int>, Series> paths;  // by recording and disc
    for (const SampleResidual& at : identified.reports[i].residuals) {
      if (static_cast<std::size_t>(at.recording) >= recordings) continue;
      Series& path = paths.try_emplace({at.recording, at.quantity}, Series::ForModel(identified.contacts[i], {}, {}))
                         .first->second;
      path.x.push_back(at.predicted[0]);
      path.y.push_back(at.predicted[1]);
    }
    for (auto& [key, path] : paths) {
      path.marker = Marker::kNone;
      panel.series.push_back(std::move(path));
    }
  }
  Series samples{.label = "samples", .colour = "#000000"};
  samples.line = false;
  samples.marker = Marker::kCross;
  for (std::size_t i = 0; i < recordings; ++i) {
    for (const Sample& sample : identified.recordings[i].samples) {
      samples.x.push_back(sample.position[0]);
      samples.y.push_back(sample.position[1]);
    }
  }
  panel.series.push_back(std::move(samples));
  const Figure figure{.panels = {panel}};
  page->AddFigure(figure,
                  "The samples, and the fitted motions" +
                      std::string(identified.recordings.size() > recordings ? " of the first recordings." : ".") +
                      (shown.size() > 1 ? " Walls are those of `" + identified.contacts[shown[0]] + "`." : ""));
}

void AddResidualsAndOutliers(const Identified& identified, const std::vector<CaptionedTable>& tables, Page* page) {
  Panel panel{.x = {.label = "time (s)"}, .y = {.label = "residual (standard deviations)"}};
  for (const std::size_t i : ShownFits(identified)) {
    const std::vector<SampleResidual>& residuals = identified.reports[i].residuals;
    Series series = Series::ForModel(identified.contacts[i], {}, {});
    series.line = false;
    const std::size_t stride = residuals.size() / kMostPoints + 1;
    for (std::size_t k = 0; k < residuals.size(); k += stride) {
      const SampleResidual& at = residuals[k];
      series.x.push_back(at.time);
      series.y.push_back(Eigen::Map<const Eigen::VectorXd>(at.standardised.data(), std::ssize(at.standardised)).norm());
    }
    panel.series.push_back(std::move(series));
  }
  if (panel.series.empty()) return;
  Figure figure{.panels = {panel}};
  page->AddFigure(figure, "Distance of each sample from the fitted motion, in standard deviations of the noise.");
  AddTable(tables, "outliers", page);
}

void AddSections(const Scene& scene, const Identified& identified, const Json& document, Page* page) {
  const std::vector<CaptionedTable> tables = FitTables(document);
  AddFits(identified, tables, page);
  if (const LearnedLaw* law = LawOf(identified)) {
    page->AddHeading("Law of impact");
    page->AddFigure(LawFigure(*law, identified.known_law), "The law with its 95 % confidence band.");
    AddTable(tables, "law", page);
  }
  if (std::ranges::any_of(identified.reports, [](const auto& report) { return report.events.has_value(); })) {
    page->AddHeading("Event functions");
    AddTable(tables, "events", page);
  }
  page->AddHeading("Motions");
  AddMotions(scene, identified, page);
  AddResidualsAndOutliers(identified, tables, page);
}

}  // namespace

Json HybridFitToJson(const Identified& identified) {
  Json item = {{identified.by, identified.contacts[0]}};
  AddFit(identified.reports[0], nullptr, /*of_scene=*/false, &item);
  AddWork(identified.reports[0], &item);
  return {{"fits", Json::array({std::move(item)})}};
}

void WriteHybridFitPage(const Identified& identified, const Json& document, const std::string& path) {
  const IdentifyReport& report = identified.reports[0];
  Page page("Fit", std::to_string(report.recordings.size()) + " experiments");
  const std::vector<CaptionedTable> tables = FitTables(document);
  AddFits(identified, tables, &page);
  page.AddHeading("Motions");
  for (std::size_t q = 0; q < report.quantities.size(); ++q) {
    Panel panel{.x = {.label = "time (s)"}, .y = {.label = report.quantities[q]}};
    Series measured{.label = "measured", .colour = "#000000"};
    measured.line = false;
    measured.marker = Marker::kCross;
    std::map<int, Series> fitted;  // by experiment
    for (const SampleResidual& at : report.residuals) {
      if (at.quantity != static_cast<int>(q)) continue;
      Series& motion = fitted.try_emplace(at.recording, Series{.label = "fitted", .colour = "#D55E00"}).first->second;
      motion.x.push_back(at.time);
      motion.y.push_back(at.predicted[0]);
      measured.x.push_back(at.time);
      measured.y.push_back(at.measured[0]);
    }
    for (auto& [experiment, motion] : fitted) panel.series.push_back(std::move(motion));
    panel.series.push_back(std::move(measured));
    page.AddFigure({.panels = {panel}}, "What was measured, and the fitted motion of each experiment at these times.");
  }
  AddResidualsAndOutliers(identified, tables, &page);
  page.SetResults(document);
  ThrowIfFailed(page.Write(path));
}

namespace {

constexpr int kLawUnits = 4, kProfileUnits = 3, kMostUnits = 16;
constexpr double kInside = 1e-3;  // how near to its bounds a law may begin

// Returns the units of "kind:N", or `usual` of "kind"; 0 of other texts and if N is no number of units.
int UnitsOf(const std::string& text, const std::string& kind, int usual) {
  if (text == kind) return usual;
  for (int units = 1; units <= kMostUnits; ++units) {
    if (text == kind + ":" + std::to_string(units)) return units;
  }
  return 0;
}

std::string Expected(const std::string& kinds) {
  return "expected " + kinds + " with N in 1.." + std::to_string(kMostUnits);
}

}  // namespace

std::optional<RobustLoss> ParseRobustLoss(const std::string& name) {
  if (name == "none") return RobustLoss::kNone;
  if (name == "huber") return RobustLoss::kHuber;
  if (name == "cauchy") return RobustLoss::kCauchy;
  return std::nullopt;
}

std::variant<ImpactLaw, std::string> ParseLaw(const std::string& text, const Scene& scene) {
  const double speed = NaturalUnits(scene).speed();
  const double restitution = std::clamp(scene.contact.restitution, kInside, 1 - kInside);
  if (const int units = UnitsOf(text, "network", kLawUnits)) return RestitutionNetwork(units, speed, restitution);
  if (const int units = UnitsOf(text, "impulse", kLawUnits)) {
    return ImpulseNetwork(units, speed, restitution, std::max(scene.contact.friction, kInside));
  }
  return Expected("network or impulse, and maybe :N");
}

std::variant<EventFunctions, std::string> ParseEvents(const std::string& text, const Scene& scene) {
  if (const int units = UnitsOf(text, "profile", kProfileUnits)) return ProfileEvents(scene, units);
  if (text == "affine") return AffineEvents(scene);
  return Expected("affine or profile, which maybe has :N");
}

// ---- A law that is known

namespace {

double ReadNumber(const std::string& text, const std::string& where) {
  if (const std::optional<double> value = FromText<double>(text)) return *value;
  throw InputError(where + ": found '" + text + "', expected a finite number");
}

}  // namespace

std::optional<double> KnownLaw::RestitutionAt(double at) const {
  const auto above = std::ranges::lower_bound(speed, at);
  if (above == speed.end() || at < speed.front()) return std::nullopt;
  const auto i = std::max<std::ptrdiff_t>(1, above - speed.begin());
  const double share = (at - speed[i - 1]) / (speed[i] - speed[i - 1]);
  return restitution[i - 1] + share * (restitution[i] - restitution[i - 1]);
}

KnownLaw ReadKnownLaw(const std::string& path) {
  const StatusOr<CsvDocument> csv = ReadCsv(path);
  if (!csv.ok()) throw InputError(csv.status().message());
  const auto speed = csv->Find("speed"), restitution = csv->Find("restitution");
  if (!speed || !restitution) throw InputError(path + ": expected the columns speed and restitution");
  KnownLaw law;
  for (std::size_t i = 0; i < csv->rows.size(); ++i) {
    const std::string line = path + ":" + std::to_string(csv->lines[i]) + ": ";
    const double v = ReadNumber(csv->rows[i][*speed], line + "speed");
    const double e = ReadNumber(csv->rows[i][*restitution], line + "restitution");
    if (v < 0 || (i > 0 && v <= law.speed.back())) throw InputError(line + "speed: expected speeds >= 0 that rise");
    if (e < 0 || e > 1) throw InputError(line + "restitution: expected a number in [0, 1]");
    law.speed.push_back(v);
    law.restitution.push_back(e);
  }
  if (law.speed.size() < 2)
    throw InputError(path + ": found fewer than two rows, expected a law at two speeds or more");
  return law;
}

// ---- Recordings in NPZ files

namespace {

// Reads arrays; what is wrong is thrown.
Recording ReadArrays(const NpzArrays& arrays, const std::string& name, const Scene& scene) {
  struct {
    const std::string& file;
    [[noreturn]] void operator()(const std::string& message) const { throw RecordingError{file, 0, message}; }
  } const fail{name};
  constexpr std::string_view kKnown[] = {"time", "body", "position", "velocity", "sigma", "sigma_v"};
  for (const auto& [key, array] : arrays) {
    if (std::ranges::find(kKnown, key) != std::end(kKnown)) continue;
    fail("found the array '" + key + "', expected time, body, position and maybe velocity, sigma, sigma_v");
  }
  for (const std::string needed : {"time", "body", "position"}) {
    if (!arrays.contains(needed)) fail("found no array " + needed + ", expected time, body and position");
  }
  const NpyArray &times = arrays.at("time"), &bodies = arrays.at("body");
  if (times.shape.size() != 1) fail("time: expected one dimension");
  const int64_t n = times.shape[0];
  // Returns n x width numbers; a scalar stands for n rows of one. Empty if the array is not there.
  const auto numbers_of = [&](const std::string& key, int64_t width) -> std::vector<double> {
    const auto found = arrays.find(key);
    if (found == arrays.end()) return {};
    const auto* numbers = std::get_if<std::vector<double>>(&found->second.data);
    if (numbers == nullptr) fail(key + ": expected float64");
    if (!std::ranges::all_of(*numbers, [](double number) { return std::isfinite(number); })) {
      fail(key + ": found a number that is not finite");
    }
    const std::vector<int64_t>& shape = found->second.shape;
    if (shape.empty() && width == 1) return std::vector<double>(static_cast<std::size_t>(n), numbers->front());
    if (shape != (width == 1 ? std::vector<int64_t>{n} : std::vector<int64_t>{n, width})) {
      fail(key + ": expected " + std::to_string(n) + (width == 1 ? "" : " x 2") + " numbers");
    }
    return *numbers;
  };
  const std::vector<double> time = numbers_of("time", 1), position = numbers_of("position", 2);
  const std::vector<double> velocity = numbers_of("velocity", 2);
  const std::vector<double> sigma = numbers_of("sigma", 1), sigma_v = numbers_of("sigma_v", 1);
  if (bodies.shape != times.shape) fail("body: expected one name or index for each time");
  const auto* indices = std::get_if<std::vector<int64_t>>(&bodies.data);
  const auto* names = std::get_if<std::vector<std::string>>(&bodies.data);
  if (indices == nullptr && names == nullptr) fail("body: expected names or int64 indices");
  Recording recording{name, {}};
  for (std::size_t i = 0; i < time.size(); ++i) {
    const std::string row = " of row " + std::to_string(i);
    const int64_t body = indices != nullptr
                             ? (*indices)[i]
                             : std::ranges::find(scene.bodies, (*names)[i], &Body::name) - scene.bodies.begin();
    if (body < 0 || body >= scene.num_bodies()) {
      fail("body" + row + (indices != nullptr ? ": none of the scene" : ": found '" + (*names)[i] + "'"));
    }
    Sample sample{.time = time[i], .body = static_cast<int>(body), .position = {position[2 * i], position[2 * i + 1]}};
    if (!velocity.empty()) sample.velocity = Vec2d(velocity[2 * i], velocity[2 * i + 1]);
    if (!sigma.empty()) sample.sigma = sigma[i];
    if (!velocity.empty() && !sigma_v.empty()) sample.sigma_velocity = sigma_v[i];
    if ((!sigma.empty() && sigma[i] <= 0) || (!sigma_v.empty() && sigma_v[i] <= 0)) {
      fail("sigma" + row + ": expected a number > 0");
    }
    recording.samples.push_back(sample);
  }
  return recording;
}

}  // namespace

std::variant<Recording, RecordingError> RecordingFromArrays(const NpzArrays& arrays, const std::string& name,
                                                            const Scene& scene) {
  try {
    Recording recording = ReadArrays(arrays, name, scene);
    if (const auto error = CheckRecording(scene, &recording)) return *error;
    return recording;
  } catch (const RecordingError& error) {
    return error;
  }
}

std::variant<Recording, RecordingError> LoadAnyRecording(const std::string& path, const Scene& scene) {
  if (!path.ends_with(".npz")) return LoadRecording(path, scene);
  const StatusOr<NpzArrays> arrays = ReadNpz(path);
  if (!arrays.ok()) return RecordingError{path, 0, arrays.status().message()};
  return RecordingFromArrays(*arrays, path, scene);
}

void WriteIdentifyReport(const Request& request, const Identified& identified, const Json& document) {
  WriteReport(request, [&](Page* page) {
    AddSections(request.scene, identified, document, page);
    page->SetResults(document);
  });
}

}  // namespace saltus
