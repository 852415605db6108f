#include <algorithm>
#include <cmath>
#include <tuple>

#include "audit/attribution/perturbed_flow.h"
#include "base/interrupt.h"
#include "programs/audit.h"
#include "programs/program.h"
#include "programs/scene_drawing.h"
#include "saltus/simulate/registry.h"

namespace saltus {

namespace {

constexpr Quantity kShown[] = {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl};

// One number of every level of a study.
std::vector<double> LevelValues(const std::vector<RefinementLevel>& levels, double RefinementLevel::*number) {
  std::vector<double> numbers;
  for (const RefinementLevel& level : levels) numbers.push_back(level.*number);
  return numbers;
}

// ---- JSON, under the keys that the reference documents

constexpr std::size_t kMostAfterInterrupt = std::size_t{1} << 16;  // numbers of a derivative by the control

// After an interrupt a long derivative by the control is left out: its text takes a second for each million steps.
Json DerivativesToJson(const Scene& scene, const Sensitivity& gradient) {
  if (gradient.control.size() <= kMostAfterInterrupt || !InterruptGuard::Interrupted()) {
    return GradientToJson(scene, gradient);
  }
  Json item = GradientToJson(scene, {.initial = gradient.initial, .control = {}, .parameters = gradient.parameters});
  item["control"] = nullptr;
  return item;
}

Json RefinementToJson(const RefinementStudy& study) {
  Json quantities = Json::array();
  for (const QuantityStudy& quantity : study.quantities) {
    Json& item = quantities.emplace_back(Json{{"quantity", QuantityToString(quantity.quantity)}});
    item.update(JudgementToJson(quantity));
    item["steps"] = LevelValues(quantity.levels, &RefinementLevel::steps);
    item["error"] = LevelValues(quantity.levels, &RefinementLevel::error);
    item["smallest"] = LevelValues(quantity.levels, &RefinementLevel::smallest);
    item["largest"] = LevelValues(quantity.levels, &RefinementLevel::largest);
  }
  return {{"control_intervals", study.intervals}, {"quantities", std::move(quantities)}};
}

Json ContactsToJson(const Attribution& attribution) {
  Json contacts = Json::array();
  for (const ContactError& error : attribution.contacts) {
    Json& item = contacts.emplace_back();
    SALTUS_ADD_MEMBERS(&item, error, first_step, last_step, a, b, exact_impacts, error, stays);
    item["block"] = BlockToString(error.block);
    item["why"] = error.cause;
  }
  return contacts;
}

Json RecognitionToJson(const ContactRecognition& found) {
  Json evidence = {{"restitution", found.restitution}, {"words", found.words}};
  if (found.step >= 0) {
    evidence["step"] = found.step;
    evidence["bodies"] = {found.a, found.b};
  }
  SALTUS_ADD_MEMBERS(&evidence,
                     found,
                     rebound,
                     finer_rebound,
                     concentration,
                     finer_concentration,
                     onset_order,
                     position_from_position,
                     velocity_from_position);
  return evidence;
}

void AddBlackBox(const BlackBoxFindings& found, Json* item) {
  Json& to = *item;
  to["black_box"] = true;
  if (!found.reported_name.empty()) to["says"] = found.reported_name;
  if (found.precision_found > 0) SALTUS_ADD_MEMBERS(item, found, precision_found, own_gradient);
  if (found.motion != BlackBoxFindings::Motion::kUnknown) to["motion"] = MotionToString(found.motion);
  const auto add = [](const BlackBoxFindings::HeadOn& of, Json* json) {
    SALTUS_ADD_MEMBERS(json, of, e);
    AddMember("keep", of.retention, json);
    AddMember("feed", of.velocity_feedback, json);
  };
  if (found.head_on) add(*found.head_on, item);
  if (found.finer) add(*found.finer, &to["finer"]);
  if (!found.levels.empty()) {
    to["loss_error"] = {{"steps", LevelValues(found.levels, &RefinementLevel::steps)},
                        {"error", LevelValues(found.levels, &RefinementLevel::error)}};
  }
  if (!found.remarks.empty()) to["findings"] = found.remarks;
}

Json ModelToJson(const Scene& scene, const ModelAudit& audit) {
  Json item = {{"contact", audit.gradient.contact}};
  Reserve(64, &item);
  if (audit.black_box) AddBlackBox(*audit.black_box, &item);
  AddBias(audit.gradient.contact, audit.gradient.surrogate, &item);
  if (!audit.gradient.ok()) {
    item["termination"] = audit.interrupted               ? "interrupted"
                          : IsNotApplicable(audit, scene) ? "not_applicable"
                                                          : "failed";
    item["reason"] = audit.gradient.reason;
    return item;
  }
  if (audit.interrupted) item["termination"] = "interrupted";
  item["loss"] = audit.gradient.loss;
  item["gradient"] = DerivativesToJson(scene, audit.gradient.gradient);
  if (!audit.gradient.one_sided.empty()) item["one_sided"] = OneSidedToJson(scene, audit.gradient.one_sided);
  if (!audit.gradient.initial_error.empty()) {
    item["standard_error"] = {{"position", VectorsToJson(scene, audit.gradient.initial_error, 0)},
                              {"velocity", VectorsToJson(scene, audit.gradient.initial_error, 2)},
                              {"control", ControlGradientToJson(scene, audit.gradient.control_error)}};
  }
  if (audit.error) {
    item["relative_error"] = audit.error->relative;
    item["angle"] = audit.error->angle;
    if (audit.error->in_standard_errors) {
      item["error_in_standard_errors"] = *audit.error->in_standard_errors;
    }
  }
  item["verdict"] = VerdictToString(audit.verdict);
  if (audit.refinement) AddConditioning(*audit.refinement, &item);
  if (audit.gradient_check && audit.gradient_check->agreement != Agreement::kUndecided) {
    item["agrees_with_differences"] = audit.gradient_check->agreement == Agreement::kAgrees;
  }
  for (const ParameterAudit& parameter : audit.parameters) {
    item["parameters"].push_back({{"name", parameter.name},
                                  {"gradient", parameter.gradient},
                                  {"difference", parameter.difference ? Json(*parameter.difference) : Json()},
                                  {"verdict", VerdictToString(parameter.verdict)}});
  }
  AddTies(audit.ambiguous, audit.spread, &item);
  if (audit.recognition) {
    item["class"] = ContactClassToString(audit.recognition->contact_class);
    item["class_evidence"] = RecognitionToJson(*audit.recognition);
  }
  if (const ContactError* first = audit.FirstWrong()) {
    item["first_wrong_step"] = first->first_step;
    item["first_wrong_contact"] = {first->a, first->b};
    item["block"] = BlockToString(first->block);
  }
  if (const std::string why = audit.VerdictReason(); !why.empty()) item["why"] = why;
  if (audit.refinement && audit.refinement->ok()) item["refinement"] = RefinementToJson(*audit.refinement);
  if (audit.attribution && audit.attribution->ok()) {
    item["contacts"] = ContactsToJson(*audit.attribution);
    item["sequence"] = audit.attribution->sequence;
    if (!audit.attribution->limit.empty()) item["attribution_limit"] = audit.attribution->limit;
  }
  if (audit.widths && audit.widths->ok()) item["width_sweep"] = WidthsToJson(*audit.widths);
  return item;
}

}  // namespace

bool IsNotApplicable(const ModelAudit& audit, const Scene& scene) {
  return audit.black_box ? audit.black_box->refused : IsNotApplicable(audit.gradient, scene);
}

bool IsNotApplicable(const ModelGradient& gradient, const Scene& scene) {
  if (!ReasonNotApplicable(gradient.contact, scene).empty()) return true;
  return gradient.surrogate && !ReasonNotApplicable(*gradient.surrogate, gradient.contact, scene).empty();
}

Json AuditToJson(const Request& request, const AuditReport& report) {
  Json document = {{"scene", request.scene.name},
                   {"steps", request.scene.steps},
                   {"precision", request.precision == Precision::kFloat ? "float" : "double"}};
  Reserve(64, &document);
  if (report.reference) {
    Json& reference =
        document["reference"] = {{"contact", report.reference->contact}, {"loss", report.reference->loss}};
    Reserve(64, &reference);
    reference["gradient"] = DerivativesToJson(request.scene, report.reference->gradient);
    reference["events"] = EventsToJson(report.reference->events);
    AddTies(report.reference->ambiguous, report.reference->spread, &document["reference"]);
    reference["remarks"] = RemarksToJson(RemarksOn(request.scene, *report.reference));
  }
  if (report.reference && !report.reference->one_sided.empty()) {
    document["reference"]["one_sided"] = OneSidedToJson(request.scene, report.reference->one_sided);
  }
  Json audits = Json::array();
  for (const ModelAudit& audit : report.models) audits.push_back(ModelToJson(request.scene, audit));
  document["audits"] = std::move(audits);
  const bool interrupted =
      report.models.size() < request.contacts.size() || std::ranges::any_of(report.models, &ModelAudit::interrupted);
  if (interrupted) document["interrupted"] = true;
  return document;
}

// ---- Files

namespace {

// Returns the entries by equal parts of the control, or none if the steps of the gradient are no multiple of these.
std::vector<double> EntriesIn(const Scene& scene, const ModelGradient& gradient, Quantity quantity, int intervals) {
  if (quantity == Quantity::kControl && gradient.num_steps % intervals != 0) return {};
  return EntriesOf(scene, gradient, quantity, intervals);
}

Cell CellAt(const std::vector<double>& entries, size_t i) { return entries.empty() ? Cell() : Cell(entries[i]); }

// Every entry of the gradient beside the exact one, and what it converges to. One row an entry and model.
Table EntryTable(const Scene& scene, const AuditReport& report) {
  Table table(ColumnsOf("contact; quantity; entry; exact; own steps; converges to; wrong sign"));
  for (const ModelAudit& audit : report.models) {
    if (!audit.refinement || !audit.refinement->ok()) continue;
    const int intervals = audit.refinement->intervals;
    for (const QuantityStudy& study : audit.refinement->quantities) {
      const std::vector<std::string>& names = study.entries;
      const std::vector<double> own = EntriesIn(scene, audit.gradient, study.quantity, intervals);
      for (size_t i = 0; i < names.size(); ++i) {
        const bool flips = std::ranges::find(study.wrong_signs, names[i]) != study.wrong_signs.end();
        table.AddRow({audit.gradient.contact,
                      QuantityToString(study.quantity),
                      names[i],
                      study.exact[i],
                      CellAt(own, i),
                      study.finest[i],
                      flips ? "yes" : "no"});
      }
    }
  }
  return table;
}

// Every entry of the surrogates beside the exact gradient, one row an entry and model.
Table SurrogateTable(const Scene& scene, const AuditReport& report) {
  Table table(ColumnsOf("contact; surrogate; biased; quantity; entry; value; standard error; exact"));
  for (const ModelAudit& audit : report.models) {
    const ModelGradient& gradient = audit.gradient;
    if (!gradient.ok() || !gradient.surrogate) continue;
    for (const Quantity quantity : kShown) {
      if (quantity == Quantity::kControl && scene.num_controlled() == 0) continue;
      const int intervals = gradient.num_steps;
      const std::vector<std::string> names = EntryNames(scene, quantity, intervals);
      const std::vector<double> values = EntriesOf(scene, gradient, quantity, intervals);
      std::vector<double> errors, exact;
      if (!gradient.initial_error.empty()) {
        errors = EntriesOf(scene, StandardErrorsOf(gradient), quantity, intervals);
      }
      if (report.reference && report.reference->num_steps % intervals == 0) {
        exact = EntriesOf(scene, *report.reference, quantity, intervals);
      }
      for (size_t i = 0; i < names.size(); ++i) {
        table.AddRow({gradient.contact,
                      SurrogateToString(gradient.surrogate->kind),
                      "yes",
                      QuantityToString(quantity),
                      names[i],
                      values[i],
                      CellAt(errors, i),
                      CellAt(exact, i)});
      }
    }
  }
  return table;
}

bool HasWidths(const AuditReport& report) {
  return std::ranges::any_of(report.models, [](const ModelAudit& audit) { return audit.widths.has_value(); });
}

}  // namespace

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
  const Json audits = AuditToJson(request, report)["audits"];
  const auto write = [&](const std::string& suffix, const std::string& list, const std::string& columns) {
    WriteTextFile(path + suffix, TableOf(audits, list, columns).ToCsv());
  };
  write("_refinement.csv",
        "/refinement/quantities",
        "contact=^contact; quantity; verdict; order; steps=steps[]; error=error[]; smallest=smallest[]; "
        "largest=largest[]");
  write("_contacts.csv",
        "/contacts",
        "contact=^contact; first step; last step; a; b; exact impacts; error; stays; wrong in=block; why");
  write("_classes.csv",
        "/class_evidence",
        "contact=^contact; class=^class; step; a=bodies/0; b=bodies/1; restitution; rebound; rebound, "
        "finer=finer_rebound; concentration; concentration, finer=finer_concentration; onset order; position from "
        "position; velocity from position, times step=velocity_from_position; evidence=words");
  WriteTextFile(path + "_verdicts.md", VerdictTable(report).ToMarkdown());
  if (!HasWidths(report)) return;
  write("_widths.csv",
        "/width_sweep/sweeps",
        "contact=^contact; quantity; entry; grid width; width=widths[]; slope=slopes[]; gradient");
}

// ---- Page

namespace {

constexpr size_t kMostModelMotions = 24;  // in a replay
constexpr size_t kShownMotions = 4;       // of these, at first
constexpr size_t kMostFlows = 6;          // drawn
constexpr size_t kModelsAbreast = 8;      // columns of gradients
constexpr size_t kManyNumbers = 1000;     // of a table that opens when asked

MotionInput StartOf(const Scene& scene) { return {InitialState(scene), InitialControl(scene, scene.steps), {}}; }

std::vector<Tile> TilesOf(const AuditReport& audit) {
  int right = 0, wrong = 0, judged = 0;
  for (const ModelAudit& model : audit.models) {
    const Tone tone = ToneOf(model.verdict);
    right += tone == Tone::kGood;
    wrong += tone == Tone::kBad;
    judged += model.gradient.ok();
  }
  return {{std::to_string(right), "gradients that are right", right > 0 ? Tone::kGood : Tone::kPlain},
          {std::to_string(wrong), "gradients that are wrong", wrong > 0 ? Tone::kBad : Tone::kPlain},
          {std::to_string(judged), "contact models that support the scene"}};
}

void AddMotions(const Request& request, const AuditReport& audit, Page* page) {
  const Scene& scene = request.scene;
  const MotionInput start = StartOf(scene);
  Replay replay{scene};
  const MotionOptions options = ReplayOptions(scene, std::min(audit.models.size() + 1, kMostModelMotions));
  const auto add = [&](Motion motion, const std::string& label, const std::string& style) {
    if (motion.times.empty() || replay.motions.size() == kMostModelMotions) return;
    replay.motions.emplace_back(std::move(motion), start, label, style);
    replay.motions.back().shown = replay.motions.size() <= kShownMotions;
  };
  add(SimulateExactMotion(scene, start, options), "exact dynamics", "analytic");
  for (const ModelAudit& model : audit.models) {
    const std::string& contact = model.gradient.contact;
    // Whatever a simulator of somebody else is called, its motion is not that of a contact model.
    if (!model.gradient.ok() || model.black_box || FindContactModel(contact)->event_driven) continue;
    MotionOptions own = options;
    own.precision = request.precision;
    add(SimulateMotion(scene, contact, start, own), contact, contact);
  }
  if (replay.motions.empty()) return;
  page->AddHeading("Motions");
  page->AddReplay(ReplayToJson(replay),
                  "The motion from the initial guess under each contact model. A correct motion does not imply a "
                  "correct gradient.");
}

Series Line(const PerturbedFlow& flow, const std::vector<double>& values, const std::string& colour, Dash dash,
            double width) {
  return {.label = "", .x = flow.times, .y = values, .colour = colour, .dash = dash, .width = width};
}

// The flows of PerturbAtContact() over time.
Panel PerturbedFlowPanel(const Scene& scene, const Contact& contact, const ContactError& error) {
  const PerturbedFlows flows = PerturbAtContact(scene, contact, error, InterruptGuard::GraceIsOver);
  Panel panel{.title = contact.name() + ": " + error.a + " displaced, at " + error.b,
              .x = {.label = "time (s)"},
              .y = {.label = "displacement along the normal"}};
  const std::string colour = ColourOf(contact.name());
  for (const auto& [flow, ink, dash] : {std::tuple(&flows.exact, std::string("#000000"), Dash::kDashed),
                                        std::tuple(&flows.model, colour, Dash::kSolid)}) {
    panel.series.push_back(Line(*flow, flow->first, ink, dash, 2.5));
    if (!flow->second.empty()) panel.series.push_back(Line(*flow, flow->second, ink, dash, 1));
  }
  return panel;
}

// Adds the cause of the first wrong contact of each wrong model, with its step in the replay.
void AddWrongSteps(const Request& request, const AuditReport& audit, Page* page) {
  std::vector<Page::Moment> moments;
  Figure flows;
  for (const ModelAudit& model : audit.models) {
    const ContactError* contact = model.FirstWrong();
    if (contact == nullptr) continue;
    const std::string& name = model.gradient.contact;
    const double step = request.scene.duration / model.gradient.num_steps;
    moments.push_back(
        {"`" + name + "`: " + model.VerdictReason(), model.black_box ? "" : name, step * contact->first_step});
    if (flows.panels.size() == kMostFlows || model.black_box || InterruptGuard::GraceIsOver()) continue;
    Panel flow = PerturbedFlowPanel(request.scene, name, *contact);
    if (!flow.series.front().x.empty()) flows.panels.push_back(std::move(flow));
  }
  if (moments.empty()) return;
  page->AddHeading("Where gradients go wrong");
  page->AddMoments(moments);
  if (flows.panels.empty()) return;
  page->AddFigure(
      flows,
      "How the first wrong contact of a model changes a perturbation: the first disc is displaced by 1 along "
      "the normal before the contact. Solid: under the model; dashed: under exact dynamics; thin: the "
      "displacement of the second disc.");
}

}  // namespace

void AddAuditSections(const Request& request, const AuditReport& audit, Page* page) {
  page->AddHeading("Which gradients are right");
  page->AddTiles(TilesOf(audit));
  page->AddTable(VerdictTable(audit), "Verdicts on the gradients of the loss at the initial guess.");
  Table gradients = GradientTable(request.scene, audit);
  const size_t entries = gradients.columns().size(), models = gradients.rows().size();
  if (entries > 12 && models <= kModelsAbreast) gradients = gradients.Transposed("entry", audit.reference ? 2 : 1);
  page->AddTable(gradients, "Gradients of the loss at the initial guess.", {}, entries * models > kManyNumbers);
  page->AddTableIfAny(PlateauTable(audit), "Finite differences of the loss.");
  AddMotions(request, audit, page);
  if (request.options.surrogate) return;
  AddWrongSteps(request, audit, page);
  const bool refined = std::ranges::any_of(
      audit.models, [](const ModelAudit& model) { return model.refinement && !model.refinement->quantities.empty(); });
  if (!refined && !HasWidths(audit)) return;
  page->AddHeading("Errors by step and width");
  Json styles = Json::object();
  for (const ModelAudit& model : audit.models) styles[model.gradient.contact] = StyleOf(model.gradient.contact);
  page->AddPlot("refinement",
                "Relative error of the gradient as the time step shrinks.",
                {{"duration", request.scene.duration}, {"right", RefinementOptions().tolerance}, {"styles", styles}});
  page->AddPlot(
      "widths",
      "Finite differences of the loss, from narrower to wider than a time step.",
      {{"untelling", {WidthFindingToString(WidthFinding::kUndecided), WidthFindingToString(WidthFinding::kFarther)}},
       {"styles", std::move(styles)}});
}

}  // namespace saltus
