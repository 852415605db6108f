#include "programs/audit.h"

#include <iostream>

#include "programs/parallel.h"
#include "saltus/dynamics/registry.h"
#include "saltus/io/table.h"

namespace saltus {
namespace {

// One column a component, named as a derivative of the loss: position and velocity of every disc that moves, and the
// first force on every controlled disc.
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
  columns.push_back({"rel. error", 3});
  columns.push_back({"angle, rad", 3});
  return columns;
}

std::vector<Cell> GradientRow(const Scene& scene, const ModelGradient& gradient) {
  std::vector<Cell> row = {gradient.contact, gradient.loss};
  for (int offset : {0, 2}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (scene.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) row.emplace_back(gradient.gradient.initial[4 * i + offset + j]);
    }
  }
  for (int i = 0; i < 2 * scene.num_controlled(); ++i) row.emplace_back(gradient.gradient.control[i]);
  return row;
}

}  // namespace

AuditReport RunAudit(const Request& request) {
  AuditReport report;
  report.reference = ExactGradientOf(request.scene);
  report.models.resize(request.contacts.size());
  Progress progress(request.progress, stderr, "audit " + request.scene.name, request.contacts.size());
  RunJobs(request.contacts.size(), request.threads, &progress, [&](int i) {
    ModelAudit& audit = report.models[i];
    audit.gradient = ComputeGradient(request.contacts[i], request.scene, request.precision);
    if (audit.gradient.ok() && report.reference) audit.error = CompareGradients(audit.gradient, *report.reference);
  });
  return report;
}

Json AuditToJson(const Request& request, const AuditReport& report) {
  Json document = {{"scene", request.scene.name},
                   {"steps", request.scene.steps},
                   {"precision", request.precision == Precision::kFloat ? "float" : "double"}};
  if (report.reference) {
    document["reference"] = {{"contact", report.reference->contact},
                             {"loss", report.reference->loss},
                             {"gradient", GradientToJson(request.scene, report.reference->gradient)},
                             {"events", EventsToJson(report.reference->events)}};
  }
  Json audits = Json::array();
  for (const ModelAudit& audit : report.models) {
    Json item = {{"contact", audit.gradient.contact}};
    if (!audit.gradient.ok()) {
      item["termination"] =
          WhyNotApplicable(audit.gradient.contact, request.scene).empty() ? "failed" : "not_applicable";
      item["reason"] = audit.gradient.reason;
    } else {
      item["loss"] = NumberToJson(audit.gradient.loss);
      item["gradient"] = GradientToJson(request.scene, audit.gradient.gradient);
      if (audit.error) {
        item["relative_error"] = NumberToJson(audit.error->relative);
        item["angle"] = NumberToJson(audit.error->angle);
      }
    }
    audits.push_back(std::move(item));
  }
  document["audits"] = std::move(audits);
  return document;
}

void PrintAuditTable(const Request& request, const AuditReport& report) {
  Table table(GradientColumns(request.scene));
  const auto add = [&](const ModelGradient& gradient, const std::optional<GradientError>& error) {
    std::vector<Cell> row = GradientRow(request.scene, gradient);
    row.push_back(error ? std::optional(error->relative) : std::nullopt);
    row.push_back(error ? std::optional(error->angle) : std::nullopt);
    table.AddRow(row);
  };
  for (const ModelAudit& audit : report.models) {
    if (audit.gradient.ok()) add(audit.gradient, audit.error);
  }
  if (report.reference) {
    ModelGradient exact = *report.reference;
    exact.contact = "exact (" + exact.contact + ")";
    add(exact, std::nullopt);
  }
  std::cout << request.scene.name << ": gradient of the loss at the initial guess\n\n" << table.ToText() << "\n";
  for (const ModelAudit& audit : report.models) {
    if (!audit.gradient.ok()) std::cout << audit.gradient.contact << ": " << audit.gradient.reason << "\n";
  }
  std::cout << std::endl;
}

int AuditExitCode(const Request& request, const AuditReport& report) {
  bool failed = false;
  for (const ModelAudit& audit : report.models) {
    if (audit.gradient.ok()) continue;
    const bool not_applicable = !WhyNotApplicable(audit.gradient.contact, request.scene).empty();
    if (not_applicable && report.models.size() == 1) {
      std::cerr << "error: " << audit.gradient.contact << ": " << audit.gradient.reason << std::endl;
      return kWrongInput;
    }
    failed = failed || !not_applicable;
  }
  return failed ? kAnswerFailed : kDone;
}

int AuditMain(int argc, char** argv) {
  return RunMain(
      argc, argv, "Gradients against the exact one: saltus_audit --scene=FILE [--contact=LIST] [--json]", [] {
        Request request;
        if (!ReadRequest({}, &request)) return kDone;
        const AuditReport report = RunAudit(request);
        if (request.json) {
          PrintJson(AuditToJson(request, report), request.precision);
        } else {
          PrintAuditTable(request, report);
        }
        return AuditExitCode(request, report);
      });
}

}  // namespace saltus
