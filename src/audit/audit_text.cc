#include "audit/audit_text.h"

#include <utility>
#include <vector>

#include "control/surrogate_names.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr Quantity kShown[] = {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl};

// One column a component, named as a derivative of the loss: position and velocity of every disc that moves, and the
// first force on every controlled disc, and the first torque.
std::vector<Column> GradientColumns(const Scene& scene) {
  std::vector<Column> columns = ColumnsOf("contact; loss:8");
  for (const Quantity quantity : kShown) {
    std::vector<std::string> names = EntryNames(scene, quantity, 1);
    if (quantity == Quantity::kControl) names.resize(2 * scene.num_controlled());
    for (const std::string& name : names) columns.push_back({"d/d" + name, 5});
  }
  for (int body : scene.control.torque_bodies) columns.push_back({"d/dtorque[0] " + scene.bodies[body].name, 5});
  columns.insert(columns.end(), {{"rel. error", 3}, {"angle, rad", 3}});
  return columns;
}

// The cells of those columns except the last two.
std::vector<Cell> GradientRow(const Scene& scene, const std::string& name, Cell loss, const ModelGradient& gradient) {
  std::vector<Cell> row = {name, std::move(loss)};
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
    for (const double entry : EntriesOf(scene, gradient, quantity, 1)) row.emplace_back(entry);
  }
  const std::vector<double>& control = gradient.gradient.control;
  for (int i = 0; i < 2 * scene.num_controlled(); ++i) row.emplace_back(control[i]);
  for (int t = 0; t < scene.num_torques(); ++t) {
    row.emplace_back(control[scene.TorqueIndex(0, t)] / scene.bodies[scene.control.torque_bodies[t]].radius);
  }
  return row;
}

// "consistent, order 0.98" or "wrong, error 0.89": the number that the verdict rests on.
Cell VerdictCell(const QuantityStudy* study) {
  const bool failed = study != nullptr && study->levels.empty();  // in its first rollout
  if (study == nullptr || failed || !study->IsJudged()) return {};
  std::string text = VerdictToString(study->verdict);
  if (study->verdict == Verdict::kConsistent) {
    text += Format(", order %.2f", study->order);
  } else if (study->verdict != Verdict::kRight) {
    text += Format(", error %.2g", study->decisive);
  }
  return Cell(text).WithTone(ToneOf(study->verdict));
}

// "d/dpy puck"
std::string NameOf(const Scene& scene, const OneSided& entry) {
  const char* quantity = entry.quantity == OneSided::Quantity::kPosition ? "p" : "v";
  return "d/d" + std::string(quantity) + (entry.component == 0 ? "x " : "y ") + scene.bodies[entry.body].name;
}

const char* ReasonNotJudged(OneSided::Side side) {
  constexpr const char* kReasons[] = {"the exact one exists from above only, and is not judged",
                                      "the exact one exists from below only, and is not judged",
                                      "the exact one does not exist"};
  return kReasons[static_cast<int>(side)];
}

}  // namespace

// With the standard errors of an estimate in place of its entries.
ModelGradient StandardErrorsOf(ModelGradient gradient) {
  gradient.gradient.initial = gradient.initial_error;
  gradient.gradient.control = gradient.control_error;
  return gradient;
}

Tone ToneOf(Verdict verdict) {
  using enum Tone;
  constexpr Tone kTones[] = {
      kGood, kGood, kBad, kBad, kMuted, kWarning, kWarning, kMuted, kWarning, kWarning};  // in the order of the enum
  return kTones[static_cast<int>(verdict)];
}

Table GradientTable(const Scene& scene, const AuditReport& report) {
  Table table(GradientColumns(scene));
  const auto add = [&](std::vector<Cell> row, const std::optional<GradientError>& error) {
    row.push_back(error ? Cell(error->relative) : Cell());
    row.push_back(error ? Cell(error->angle) : Cell());
    table.AddRow(std::move(row));
  };
  if (report.reference) {
    const bool one = report.reference->ambiguous.empty();
    const std::string name = (one ? "exact (" : "in one order (") + report.reference->contact + ")";
    add(GradientRow(scene, name, report.reference->loss, *report.reference), std::nullopt);
  }
  for (const ModelAudit& audit : report.models) {
    if (!audit.gradient.ok()) continue;
    const ModelGradient& gradient = audit.gradient;
    const std::string name = LabelOf(gradient.contact, gradient.surrogate);
    add(GradientRow(scene, name, gradient.loss, gradient), audit.error);
    if (gradient.initial_error.empty()) continue;
    add(GradientRow(scene, "  standard error", {}, StandardErrorsOf(gradient)), std::nullopt);
  }
  return table;
}

Table VerdictTable(const AuditReport& report) {
  Table table(
      ColumnsOf("contact; verdict; class; by position; by velocity; by control; first wrong step; of; wrong in; why"));
  for (const ModelAudit& audit : report.models) {
    if (!audit.gradient.ok()) continue;
    std::vector<Cell> row = {LabelOf(audit.gradient.contact, audit.gradient.surrogate),
                             Cell(VerdictToString(audit.verdict)).WithTone(ToneOf(audit.verdict)),
                             audit.recognition && !audit.ContradictsItself()
                                 ? Cell(ContactClassToString(audit.recognition->contact_class))
                                 : Cell()};
    for (const Quantity quantity : kShown) {
      row.push_back(VerdictCell(audit.refinement ? audit.refinement->Find(quantity) : nullptr));
    }
    if (const ContactError* first = audit.FirstWrong()) {
      row.insert(row.end(), {Cell(first->first_step), first->a + " - " + first->b, BlockToString(first->block)});
    } else {
      row.insert(row.end(), 3, Cell());
    }
    row.emplace_back(audit.VerdictReason());
    table.AddRow(std::move(row));
  }
  return table;
}

Table BlackBoxTable(const AuditReport& report) {
  Table table(ColumnsOf(
      "simulator; reports; bits; motion; e:3; keep:3; feed:3; e, finer:3; keep, finer:3; feed, finer:3; gradient"));
  const auto add = [](const std::optional<BlackBoxFindings::HeadOn>& impact, std::vector<Cell>* row) {
    for (const auto member : {&BlackBoxFindings::HeadOn::e,
                              &BlackBoxFindings::HeadOn::retention,
                              &BlackBoxFindings::HeadOn::velocity_feedback}) {
      row->push_back(impact ? Cell((*impact).*member) : Cell());
    }
  };
  for (const ModelAudit& audit : report.models) {
    if (!audit.black_box || !audit.gradient.ok()) continue;
    const BlackBoxFindings& found = *audit.black_box;
    std::vector<Cell> row = {
        audit.gradient.contact, found.reported_name, found.precision_found, MotionToString(found.motion)};
    add(found.head_on, &row);
    add(found.finer, &row);
    row.emplace_back(found.own_gradient ? "its own" : "differences");
    table.AddRow(std::move(row));
  }
  return table;
}

Table PlateauTable(const AuditReport& report) {
  Table table(ColumnsOf("contact; entry; gradient:5; narrow differences:5; wide differences:5; exact:5; finding"));
  for (const ModelAudit& audit : report.models) {
    if (!audit.widths) continue;
    for (const WidthSweep& sweep : audit.widths->sweeps) {
      const bool against = sweep.finding == WidthFinding::kOnlyOfItsSteps || sweep.finding == WidthFinding::kOfNeither;
      const Tone tone = against ? Tone::kBad : sweep.finding == WidthFinding::kNothing ? Tone::kGood : Tone::kMuted;
      table.AddRow({audit.gradient.contact,
                    sweep.entry,
                    sweep.gradient,
                    sweep.narrow,
                    sweep.wide,
                    sweep.exact,
                    Cell(WidthFindingToString(sweep.finding)).WithTone(tone)});
    }
  }
  return table;
}

std::string AuditText(const Scene& scene, const AuditReport& report, const std::optional<Surrogate>& surrogate,
                      const TextLayout& layout) {
  const std::string& name = scene.name;
  std::string text;
  for (const ModelAudit& audit : report.models) {
    const bool deceives = audit.black_box && audit.black_box->own_gradient && IsWrong(audit.verdict) &&
                          audit.gradient_check && audit.gradient_check->agreement == Agreement::kAgrees;
    if (!deceives) continue;
    text += Paragraph("The gradient of " + audit.gradient.contact + " AGREES WITH DIFFERENCES, AND IS WRONG.",
                      layout.width) +
            "\n";
  }
  Table gradients = GradientTable(scene, report);
  // A row an entry, whose exact value is beside it wherever it goes on.
  if (!gradients.FitsOneLine(layout.width)) gradients = gradients.Transposed("entry", report.reference ? 2 : 1);
  const std::string what = surrogate ? "surrogate of the gradient (" + BiasedName(*surrogate) + ")" : "gradient";
  const std::pair<std::string, Table> tables[] = {{what + " of the loss at the initial guess", std::move(gradients)},
                                                  {"verdicts", VerdictTable(report)},
                                                  {"differences of the loss", PlateauTable(report)},
                                                  {"black boxes, from a head-on impact", BlackBoxTable(report)}};
  for (const auto& [caption, table] : tables) {
    if (!table.rows().empty())
      text += Paragraph(name + ": " + caption, layout.width) + "\n" + table.ToText(layout) + "\n";
  }
  std::string remarks;
  const auto remark = [&](const std::string& of, const std::string& sentence) {
    remarks += Paragraph(of + ": " + sentence, layout.width);
  };
  if (report.reference) {
    for (const auto side : {OneSided::Side::kAbove, OneSided::Side::kBelow, OneSided::Side::kNone}) {
      std::string names;
      for (const OneSided& entry : report.reference->one_sided) {
        if (entry.side == side) names += (names.empty() ? "" : ", ") + NameOf(scene, entry);
      }
      if (!names.empty()) remark(names, ReasonNotJudged(side));
    }
  }
  for (const ModelAudit& audit : report.models) {
    const std::string& contact = audit.gradient.contact;
    if (audit.black_box) {
      for (const std::string& finding : audit.black_box->remarks) remark(contact, finding);
    }
    if (!audit.gradient.ok()) remark(contact, audit.gradient.reason);
    if (audit.gradient.ok() && audit.interrupted) remark(contact, "interrupted; the rest of its audit is missing");
    if (audit.attribution && !audit.attribution->sequence.empty()) remark(contact, audit.attribution->sequence);
    if (audit.attribution && !audit.attribution->limit.empty()) {
      remark(contact, "traced no further by --attribution_seconds: " + audit.attribution->limit);
    }
  }
  return text + remarks + (remarks.empty() ? "" : "\n");
}

}  // namespace saltus
