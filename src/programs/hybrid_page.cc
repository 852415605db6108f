// The tables and the page of a hybrid problem, made of its document (hybrid_document.cc).
#include <algorithm>
#include <utility>

#include "base/statistics.h"
#include "programs/feedback_study.h"
#include "programs/hybrid_program.h"

namespace saltus {

using nlohmann::literals::operator""_json_pointer;

namespace {

constexpr int kDigitsOfPictures = 7;

// Returns the variables of a motion beside its control, with their places in an input and in a gradient: the states,
// which have the suffix, the parameters and the duration.
std::vector<std::pair<std::string, Json::json_pointer>> VariablesOf(const Json& document, const std::string& suffix) {
  std::vector<std::pair<std::string, Json::json_pointer>> variables;
  const auto add = [&](const Json& names, const Json::json_pointer& list, const std::string& behind) {
    for (std::size_t i = 0; i < names.size(); ++i)
      variables.emplace_back(names[i].get<std::string>() + behind, list / i);
  };
  for (const Json& mode : document["system"]["modes"]) {
    if (mode["name"] == document["guess"]["mode"]) add(mode["states"], "/initial"_json_pointer, suffix);
  }
  add(document["system"]["parameters"], "/parameters"_json_pointer, "");
  variables.emplace_back("duration", "/duration"_json_pointer);
  return variables;
}

// Adds a motion, and rounds its numbers to what its pictures show.
void AddMotion(const std::string& name, Json which, Json* motion, Page* page) {
  page->AddHeading("Motion: " + name);
  if (motion->contains("failed")) {
    page->AddParagraph("The motion ends early: " + (*motion)["failed"].get<std::string>());
  }
  if (motion->contains("remark")) page->AddParagraph((*motion)["remark"]);
  page->AddMotion(std::move(which));
  page->AddTableIfAny(EventsTable(*motion), "Events.");
  for (const char* key : {"states", "guards", "frames"}) {
    if (motion->contains(key)) Round(kDigitsOfPictures, &(*motion)[key]);
  }
}

}  // namespace

NamedStudies StudiesIn(const Json& document) {
  NamedStudies studies;
  for (const Json& run : document["runs"]) {
    if (run.contains("feedback")) studies.emplace_back(run["solver"], run["feedback"]);
  }
  if (document.contains("feedback")) studies.emplace_back("initial guess", document["feedback"]);
  return studies;
}

std::string DescribeLoss(const Json& document) {
  const std::string loss = document.contains("loss") ? CellOf(document["loss"]).Display(12) : "";
  if (!document.contains("failed")) return "Loss " + loss;
  return (loss.empty() ? "No loss: " : "Loss " + loss + ", without a gradient: ") +
         document["failed"].get<std::string>();
}

Table EventsTable(const Json& motion) {
  return TableOf(Json::array({motion}), "/events", "event=#; time:12; mode; guard; next mode");
}

Table GradientTable(const Json& document) {
  Table table(ColumnsOf("variable; value:10; derivative of the loss:10"));
  const Json& gradient = document["gradient"];
  for (const auto& [name, place] : VariablesOf(document, " at the start")) {
    table.AddRow({name, CellOf(document["guess"][place]), CellOf(gradient[place])});
  }
  const std::vector<double> by_control = NumbersIn(gradient["control"]);
  if (!by_control.empty()) table.AddRow({"control (norm)", Cell(), Norm(by_control)});
  return table;
}

Table SolutionTable(const Json& document) {
  std::vector<Column> columns = ColumnsOf("variable; guess:10");
  std::vector<Json> solutions;
  for (const Json& run : document["runs"]) {
    if (!run.contains("solution")) continue;
    columns.push_back({run["solver"], 16});
    solutions.push_back(run["solution"]);
  }
  Table table(columns);
  const auto free = document.value("free", std::vector<std::string>());
  for (const auto& [name, place] : VariablesOf(document, "")) {
    if (solutions.empty() || std::ranges::find(free, name) == free.end()) continue;
    std::vector<Cell> row = {name, CellOf(document["guess"][place])};
    for (const Json& solution : solutions) row.push_back(CellOf(solution[place]));
    table.AddRow(std::move(row));
  }
  return table;
}

Table RunsTable(const Json& document) {
  return TableOf(document["runs"],
                 "",
                 "solver; initial loss:10; final loss:10; iterations; "
                 "gradients=evaluations; seconds:3; termination; certificate=certificate/in_words; remark=reason");
}

Table AuditsTable(const Json& document) {
  Json audits = document.value("audits", Json::array());
  for (Json& audit : audits) {
    for (const Json& part : audit.value("parts", Json::array())) {
      const Json& error = part["levels"].back()["error"];
      if (error.is_number()) audit["finest_error"] = std::max(audit.value("finest_error", 0.0), error.get<double>());
    }
  }
  return TableOf(audits, "", "scheme; verdict; steps; loss:8; exact loss:8; order:3; finest error:3; reason");
}

Page HybridPage(Json document) {
  const std::size_t modes = document["system"]["modes"].size();
  Page page(document["program"], std::to_string(modes) + (modes == 1 ? " mode" : " modes"));
  page.AddParagraph("Initial guess: " + DescribeLoss(document));
  Json& runs = document["runs"];
  if (!runs.empty()) {
    page.AddHeading("Solvers");
    page.AddTable(RunsTable(document), "The runs of the solvers.");
    page.AddTableIfAny(SolutionTable(document), "The variables that solvers change, without the control.");
  }
  if (const NamedStudies studies = StudiesIn(document); !studies.empty()) AddFeedbackSection(studies, &page);
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (runs[i].contains("motion")) AddMotion(runs[i]["solver"], i, &runs[i]["motion"], &page);
  }
  AddMotion("initial guess", nullptr, &document["motion"], &page);
  if (document.contains("gradient")) {
    page.AddHeading("Gradient of the loss at the initial guess");
    page.AddTable(GradientTable(document), "Derivatives of the loss.");
  }
  if (const Table audits = AuditsTable(document); !audits.rows().empty()) {
    page.AddHeading("Audit of time-stepping schemes");
    page.AddTable(audits, "Verdicts on the gradients of the schemes.");
  }
  page.SetWholeResults(std::move(document));
  return page;
}

}  // namespace saltus
