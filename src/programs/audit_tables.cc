#include "programs/audit_tables.h"

#include <cstdio>

#include "programs/surrogate_flags.h"

namespace saltus {
namespace {

// One column a component, named as a derivative of the loss: position and velocity of every disc that moves, and the
// first force on every controlled disc, and the first torque.
std::vector<Column> GradientColumns(const Scene& scene) {
  std::vector<Column> columns = {{"contact"}, {"loss", 8}};
  for (const char* quantity : {"p", "v"}) {
    for (const Body& body : scene.bodies) {
      if (body.fixed) continue;
      for (const char* axis : {"x", "y"})
        columns.push_back({"d/d" + std::string(quantity) + axis + " " + body.name, 5});
    }
  }
  for (int body : scene.control.bodies) {
    for (const char* axis : {"x", "y"})
      columns.push_back({"d/du" + std::string(axis) + "[0] " + scene.bodies[body].name, 5});
  }
  for (int body : scene.control.turned) columns.push_back({"d/dtorque[0] " + scene.bodies[body].name, 5});
  columns.push_back({"rel. error", 3});
  columns.push_back({"angle, rad", 3});
  return columns;
}

// The cells of those columns, from derivatives by the initial state (B x 4) and the control.
std::vector<Cell> GradientRow(const Scene& scene, const std::string& name, Cell loss,
                              const std::vector<double>& initial, const std::vector<double>& control) {
  std::vector<Cell> row = {name, std::move(loss)};
  for (int offset : {0, 2}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (scene.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) row.emplace_back(initial[4 * i + offset + j]);
    }
  }
  for (int i = 0; i < 2 * scene.num_controlled(); ++i) row.emplace_back(control[i]);
  for (int t = 0; t < scene.num_turned(); ++t) {
    row.emplace_back(control[scene.TurnIndex(0, t)] / scene.bodies[scene.control.turned[t]].radius);
  }
  return row;
}

std::vector<Cell> GradientRow(const Scene& scene, const std::string& name, const ModelGradient& gradient) {
  return GradientRow(scene, name, gradient.loss, gradient.gradient.initial, gradient.gradient.control);
}

// "consistent, order 0.98" or "wrong, error 0.89": the number that the verdict rests on.
Cell VerdictCell(const QuantityStudy* study) {
  const bool failed = study != nullptr && study->levels.empty();  // in its first rollout
  if (study == nullptr || failed || !study->IsJudged()) return {};
  char text[64];
  const char* verdict = VerdictToString(study->verdict);
  if (study->verdict == Verdict::kConsistent) {
    std::snprintf(text, sizeof text, "%s, order %.2f", verdict, study->order);
  } else if (study->verdict == Verdict::kRight) {
    std::snprintf(text, sizeof text, "%s", verdict);
  } else {
    std::snprintf(text, sizeof text, "%s, error %.2g", verdict, study->decisive);
  }
  return Cell(text).With(ToneOf(study->verdict));
}

}  // namespace

Tone ToneOf(Verdict verdict) {
  switch (verdict) {
    case Verdict::kRight:
    case Verdict::kConsistent:
      return Tone::kGood;
    case Verdict::kWrong:
    case Verdict::kWrongSign:
      return Tone::kBad;
    case Verdict::kBiased:
    case Verdict::kIllConditioned:
    case Verdict::kAmbiguous:
    case Verdict::kOneSided:
      return Tone::kWarning;
    case Verdict::kNotApplicable:
    case Verdict::kUnknown:
      break;
  }
  return Tone::kMuted;
}

Table GradientTable(const Request& request, const AuditReport& report) {
  Table table(GradientColumns(request.scene));
  const auto add = [&](std::vector<Cell> row, const std::optional<GradientError>& error) {
    row.push_back(error ? Cell(error->relative) : Cell());
    row.push_back(error ? Cell(error->angle) : Cell());
    table.AddRow(std::move(row));
  };
  if (report.reference) {
    const bool one = report.reference->ambiguous.empty();
    const std::string name = (one ? "exact (" : "in one order (") + report.reference->contact + ")";
    add(GradientRow(request.scene, name, *report.reference), std::nullopt);
  }
  for (const ModelAudit& audit : report.models) {
    if (!audit.gradient.ok()) continue;
    const ModelGradient& gradient = audit.gradient;
    add(GradientRow(request.scene, LabelOf(gradient.contact, gradient.surrogate), gradient), audit.error);
    if (gradient.initial_error.empty()) continue;
    add(GradientRow(request.scene, "  standard error", {}, gradient.initial_error, gradient.control_error),
        std::nullopt);
  }
  return table;
}

Table VerdictTable(const AuditReport& report) {
  Table table({{"contact"},
               {"verdict"},
               {"class"},
               {"by position"},
               {"by velocity"},
               {"by control"},
               {"first wrong step"},
               {"of"},
               {"wrong in"},
               {"why"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.gradient.ok()) continue;
    std::vector<Cell> row = {LabelOf(audit.gradient.contact, audit.gradient.surrogate),
                             Cell(VerdictToString(audit.verdict)).With(ToneOf(audit.verdict)),
                             audit.recognition ? Cell(ContactClassToString(audit.recognition->contact_class)) : Cell()};
    for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl}) {
      row.push_back(VerdictCell(audit.refinement ? audit.refinement->Find(quantity) : nullptr));
    }
    if (const ContactError* first = audit.FirstWrong()) {
      row.insert(row.end(), {Cell(first->first_step), first->a + " - " + first->b, BlockToString(first->block)});
    } else {
      row.insert(row.end(), 3, Cell());
    }
    row.emplace_back(audit.Why());
    table.AddRow(std::move(row));
  }
  return table;
}

Table EntryTable(const Scene& scene, const AuditReport& report) {
  Table table({{"contact"}, {"quantity"}, {"entry"}, {"exact"}, {"own steps"}, {"converges to"}, {"wrong sign"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.refinement || !audit.refinement->ok()) continue;
    const int intervals = audit.refinement->intervals;
    for (const QuantityStudy& study : audit.refinement->quantities) {
      const std::vector<std::string> names = EntryNames(scene, study.quantity, intervals);
      // The scene's own steps need not be a multiple of the intervals of control.
      std::vector<double> own;
      if (study.quantity != Quantity::kControl || audit.gradient.num_steps % intervals == 0) {
        own = EntriesOf(scene, audit.gradient, study.quantity, intervals);
      }
      for (size_t i = 0; i < names.size(); ++i) {
        const bool flips =
            std::find(study.wrong_signs.begin(), study.wrong_signs.end(), names[i]) != study.wrong_signs.end();
        table.AddRow({audit.gradient.contact,
                      QuantityToString(study.quantity),
                      names[i],
                      study.exact[i],
                      own.empty() ? Cell() : Cell(own[i]),
                      study.finest[i],
                      flips ? "yes" : "no"});
      }
    }
  }
  return table;
}

Table SurrogateTable(const Scene& scene, const AuditReport& report) {
  Table table(
      {{"contact"}, {"surrogate"}, {"biased"}, {"quantity"}, {"entry"}, {"value"}, {"standard error"}, {"exact"}});
  for (const ModelAudit& audit : report.models) {
    const ModelGradient& gradient = audit.gradient;
    if (!gradient.ok() || !gradient.surrogate) continue;
    ModelGradient error = gradient;
    error.gradient.initial = gradient.initial_error;
    error.gradient.control = gradient.control_error;
    for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl}) {
      if (quantity == Quantity::kControl && scene.num_controlled() == 0) continue;
      const int intervals = gradient.num_steps;
      const std::vector<std::string> names = EntryNames(scene, quantity, intervals);
      const std::vector<double> values = EntriesOf(scene, gradient, quantity, intervals);
      std::vector<double> errors, exact;
      if (!gradient.initial_error.empty()) errors = EntriesOf(scene, error, quantity, intervals);
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
                      errors.empty() ? Cell() : Cell(errors[i]),
                      exact.empty() ? Cell() : Cell(exact[i])});
      }
    }
  }
  return table;
}

Table RefinementTable(const AuditReport& report) {
  Table table({{"contact"}, {"quantity"}, {"verdict"}, {"order"}, {"steps"}, {"error"}, {"smallest"}, {"largest"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.refinement) continue;
    for (const QuantityStudy& study : audit.refinement->quantities) {
      for (const RefinementLevel& level : study.levels) {
        table.AddRow({audit.gradient.contact,
                      QuantityToString(study.quantity),
                      VerdictToString(study.verdict),
                      study.order,
                      level.steps,
                      level.error,
                      level.smallest,
                      level.largest});
      }
    }
  }
  return table;
}

Table ContactTable(const AuditReport& report) {
  Table table({{"contact"},
               {"first step"},
               {"last step"},
               {"a"},
               {"b"},
               {"exact impacts"},
               {"error", 3},
               {"stays"},
               {"wrong in"},
               {"why"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.attribution) continue;
    for (const ContactError& error : audit.attribution->contacts) {
      table.AddRow({audit.gradient.contact,
                    error.first_step,
                    error.last_step,
                    error.a,
                    error.b,
                    error.exact_impacts,
                    error.error,
                    error.stays ? "yes" : "no",
                    BlockToString(error.block),
                    error.why});
    }
  }
  return table;
}

Table ClassTable(const AuditReport& report) {
  Table table({{"contact"},
               {"class"},
               {"step"},
               {"a"},
               {"b"},
               {"restitution"},
               {"rebound"},
               {"rebound, finer"},
               {"concentration"},
               {"concentration, finer"},
               {"onset order"},
               {"position from position"},
               {"velocity from position, times step"},
               {"evidence"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.recognition) continue;
    const ContactRecognition& found = *audit.recognition;
    table.AddRow({audit.gradient.contact,
                  ContactClassToString(found.contact_class),
                  found.step < 0 ? Cell() : Cell(found.step),
                  found.a,
                  found.b,
                  found.restitution,
                  found.rebound,
                  found.finer_rebound,
                  found.concentration,
                  found.finer_concentration,
                  found.onset_order,
                  found.position_from_position,
                  found.velocity_from_position,
                  found.words});
  }
  return table;
}

Table BlackBoxTable(const AuditReport& report) {
  Table table({{"simulator"},
               {"reports"},
               {"bits"},
               {"motion"},
               {"e", 3},
               {"keep", 3},
               {"feed", 3},
               {"e, finer", 3},
               {"keep, finer", 3},
               {"feed, finer", 3},
               {"gradient"}});
  const auto add = [](const std::optional<BlackBoxFindings::HeadOn>& impact, std::vector<Cell>* row) {
    for (const auto member :
         {&BlackBoxFindings::HeadOn::e, &BlackBoxFindings::HeadOn::keep, &BlackBoxFindings::HeadOn::feed}) {
      row->push_back(impact ? Cell((*impact).*member) : Cell());
    }
  };
  for (const ModelAudit& audit : report.models) {
    if (!audit.black_box || !audit.gradient.ok()) continue;
    const BlackBoxFindings& found = *audit.black_box;
    std::vector<Cell> row = {audit.gradient.contact, found.says, found.precision_found, MotionToString(found.motion)};
    add(found.head_on, &row);
    add(found.finer, &row);
    row.emplace_back(found.own_gradient ? "its own" : "differences");
    table.AddRow(std::move(row));
  }
  return table;
}

Table PlateauTable(const AuditReport& report) {
  Table table(
      {{"contact"}, {"entry"}, {"gradient", 5}, {"narrow differences", 5}, {"wide differences", 5}, {"finding"}});
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
                    Cell(WidthFindingToString(sweep.finding)).With(tone)});
    }
  }
  return table;
}

Table GivenTable(const std::vector<GivenEntry>& entries) {
  Table table({{"entry"}, {"given", 5}, {"exact", 9}, {"verdict"}});
  for (const GivenEntry& entry : entries) {
    table.AddRow(
        {entry.entry, entry.given, entry.exact, Cell(VerdictToString(entry.verdict)).With(ToneOf(entry.verdict))});
  }
  return table;
}

Table SlopeTable(const AuditReport& report) {
  Table table({{"contact"}, {"quantity"}, {"entry"}, {"grid width"}, {"width"}, {"slope"}, {"gradient"}});
  for (const ModelAudit& audit : report.models) {
    if (!audit.widths) continue;
    for (const WidthSweep& sweep : audit.widths->sweeps) {
      for (size_t i = 0; i < sweep.widths.size(); ++i) {
        table.AddRow({audit.gradient.contact,
                      QuantityToString(sweep.quantity),
                      sweep.entry,
                      sweep.grid_width,
                      sweep.widths[i],
                      sweep.slopes[i],
                      sweep.gradient});
      }
    }
  }
  return table;
}

}  // namespace saltus
