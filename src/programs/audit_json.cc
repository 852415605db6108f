// The audit as JSON, under the keys that the README promises.
#include <algorithm>

#include "base/interrupt.h"
#include "programs/audit.h"
#include "programs/surrogate_flags.h"

namespace saltus {
namespace {

constexpr std::size_t kMostAfterInterrupt = std::size_t{1} << 16;  // numbers of a derivative by the control

// Room for all keys that an object will have. One that has to grow copies what it holds, its keys being constant: of a
// long horizon, gradients of millions of numbers.
void MakeRoom(Json* object) { object->get_ref<Json::object_t&>().reserve(64); }

// After an interrupt without a long derivative by the control, whose text alone takes a second for each million steps.
Json DerivativesToJson(const Scene& scene, const Sensitivity& gradient) {
  if (gradient.control.size() <= kMostAfterInterrupt || !InterruptGuard::Interrupted()) {
    return GradientToJson(scene, gradient);
  }
  Json item = GradientToJson(scene, {.initial = gradient.initial, .control = {}, .parameters = gradient.parameters});
  item["control"] = nullptr;
  return item;
}

Json RefinementToJson(const Scene& scene, const RefinementStudy& study) {
  Json quantities = Json::array();
  for (const QuantityStudy& quantity : study.quantities) {
    std::vector<double> steps, errors;
    for (const RefinementLevel& level : quantity.levels) {
      steps.push_back(level.steps);
      errors.push_back(level.error);
    }
    quantities.push_back({{"quantity", QuantityToString(quantity.quantity)},
                          {"verdict", VerdictToString(quantity.verdict)},
                          {"order", NumberToJson(quantity.order)},
                          {"steps", NumbersToJson(steps)},
                          {"error", NumbersToJson(errors)},
                          {"entries", EntryNames(scene, quantity.quantity, study.intervals)},
                          {"exact", NumbersToJson(quantity.exact)},
                          {"converges_to", NumbersToJson(quantity.finest)},
                          {"one_sided", quantity.one_sided},
                          {"wrong_signs", quantity.wrong_signs}});
  }
  return {{"control_intervals", study.intervals}, {"quantities", std::move(quantities)}};
}

Json ContactsToJson(const Attribution& attribution) {
  Json contacts = Json::array();
  for (const ContactError& error : attribution.contacts) {
    contacts.push_back({{"first_step", error.first_step},
                        {"last_step", error.last_step},
                        {"a", error.a},
                        {"b", error.b},
                        {"exact_impacts", error.exact_impacts},
                        {"error", NumberToJson(error.error)},
                        {"stays", error.stays},
                        {"block", BlockToString(error.block)},
                        {"why", error.why}});
  }
  return contacts;
}

Json RecognitionToJson(const ContactRecognition& found) {
  Json evidence = {{"restitution", NumberToJson(found.restitution)}, {"words", found.words}};
  if (found.step >= 0) {
    evidence["step"] = found.step;
    evidence["bodies"] = {found.a, found.b};
  }
  const auto add = [&](const char* key, const std::optional<double>& value) {
    if (value) evidence[key] = NumberToJson(*value);
  };
  add("rebound", found.rebound);
  add("finer_rebound", found.finer_rebound);
  add("concentration", found.concentration);
  add("finer_concentration", found.finer_concentration);
  add("onset_order", found.onset_order);
  add("position_from_position", found.position_from_position);
  add("velocity_from_position", found.velocity_from_position);
  return evidence;
}

Json WidthsToJson(const WidthSweepStudy& study) {
  Json sweeps = Json::array();
  for (const WidthSweep& sweep : study.sweeps) {
    sweeps.push_back({{"quantity", QuantityToString(sweep.quantity)},
                      {"entry", sweep.entry},
                      {"gradient", NumberToJson(sweep.gradient)},
                      {"narrow", NumberToJson(sweep.narrow)},
                      {"wide", NumberToJson(sweep.wide)},
                      {"finding", WidthFindingToString(sweep.finding)},
                      {"grid_width", NumberToJson(sweep.grid_width)},
                      {"widths", NumbersToJson(sweep.widths)},
                      {"slopes", NumbersToJson(sweep.slopes)}});
  }
  return {{"verdict", VerdictToString(study.verdict)}, {"summary", study.Summary()}, {"sweeps", std::move(sweeps)}};
}

void AddBlackBox(const BlackBoxFindings& found, Json* item) {
  Json& to = *item;
  to["black_box"] = true;
  if (!found.says.empty()) to["says"] = found.says;
  if (found.precision_found > 0) to["precision_found"] = found.precision_found;
  if (found.precision_found > 0) to["own_gradient"] = found.own_gradient;
  if (found.motion != BlackBoxFindings::Motion::kUnknown) to["motion"] = MotionToString(found.motion);
  const auto add = [](const BlackBoxFindings::HeadOn& impact, Json* measured) {
    (*measured)["e"] = NumberToJson(impact.e);
    (*measured)["keep"] = NumberToJson(impact.keep);
    (*measured)["feed"] = NumberToJson(impact.feed);
  };
  if (found.head_on) add(*found.head_on, item);
  if (found.finer) add(*found.finer, &to["finer"]);
  if (!found.levels.empty()) {
    std::vector<double> steps, errors;
    for (const RefinementLevel& level : found.levels) {
      steps.push_back(level.steps);
      errors.push_back(level.error);
    }
    to["loss_error"] = {{"steps", NumbersToJson(steps)}, {"error", NumbersToJson(errors)}};
  }
  if (!found.remarks.empty()) to["findings"] = found.remarks;
}

Json ModelToJson(const Scene& scene, const ModelAudit& audit) {
  Json item = {{"contact", audit.gradient.contact}};
  MakeRoom(&item);
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
  item["loss"] = NumberToJson(audit.gradient.loss);
  item["gradient"] = DerivativesToJson(scene, audit.gradient.gradient);
  if (!audit.gradient.one_sided.empty()) item["one_sided"] = OneSidedToJson(scene, audit.gradient.one_sided);
  if (!audit.gradient.initial_error.empty()) {
    item["standard_error"] = {{"position", VectorsToJson(scene, audit.gradient.initial_error, 0)},
                              {"velocity", VectorsToJson(scene, audit.gradient.initial_error, 2)},
                              {"control", ControlGradientToJson(scene, audit.gradient.control_error)}};
  }
  if (audit.error) {
    item["relative_error"] = NumberToJson(audit.error->relative);
    item["angle"] = NumberToJson(audit.error->angle);
    if (audit.error->in_standard_errors) {
      item["error_in_standard_errors"] = NumberToJson(*audit.error->in_standard_errors);
    }
  }
  item["verdict"] = VerdictToString(audit.verdict);
  if (audit.refinement && audit.refinement->conditioning) {
    item["condition"] = NumberToJson(audit.refinement->conditioning->condition);
    item["rounding"] = NumberToJson(audit.refinement->conditioning->rounding);
  }
  if (audit.own && audit.own->agreement != Agreement::kUndecided) {
    item["agrees_with_differences"] = audit.own->agreement == Agreement::kAgrees;
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
  if (const std::string why = audit.Why(); !why.empty()) item["why"] = why;
  if (audit.refinement && audit.refinement->ok()) item["refinement"] = RefinementToJson(scene, *audit.refinement);
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
  if (!WhyNotApplicable(gradient.contact, scene).empty()) return true;
  return gradient.surrogate && !WhyNotApplicable(*gradient.surrogate, gradient.contact, scene).empty();
}

Json AuditToJson(const Request& request, const AuditReport& report) {
  Json document = {{"scene", request.scene.name},
                   {"steps", request.scene.steps},
                   {"precision", request.precision == Precision::kFloat ? "float" : "double"}};
  MakeRoom(&document);
  if (report.reference) {
    Json& reference =
        document["reference"] = {{"contact", report.reference->contact}, {"loss", report.reference->loss}};
    MakeRoom(&reference);
    reference["gradient"] = DerivativesToJson(request.scene, report.reference->gradient);
    reference["events"] = EventsToJson(report.reference->events);
    AddTies(report.reference->ambiguous, report.reference->spread, &document["reference"]);
  }
  if (report.reference && !report.reference->one_sided.empty()) {
    document["reference"]["one_sided"] = OneSidedToJson(request.scene, report.reference->one_sided);
  }
  Json audits = Json::array();
  for (const ModelAudit& audit : report.models) audits.push_back(ModelToJson(request.scene, audit));
  document["audits"] = std::move(audits);
  const bool interrupted = report.models.size() < request.contacts.size() ||
                           std::any_of(report.models.begin(), report.models.end(), [](const ModelAudit& audit) {
                             return audit.interrupted;
                           });
  if (interrupted) document["interrupted"] = true;
  return document;
}

}  // namespace saltus
