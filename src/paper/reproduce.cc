// `saltus_reproduce`: every table and figure of the paper, compared with its published values.
#include <gflags/gflags.h>

#include <chrono>
#include <functional>
#include <iostream>
#include <optional>

#include "base/interrupt.h"
#include "paper/descent_audit.h"
#include "paper/experiments.h"
#include "paper/formulation_audit.h"
#include "paper/law_example.h"
#include "paper/notebook_files.h"
#include "paper/paper_figures.h"
#include "paper/paper_report.h"
#include "paper/parameter_fits.h"
#include "paper/published.h"
#include "paper/solver_comparison.h"
#include "paper/strike_comparison.h"
#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

DEFINE_string(problems_dir, "", "directory of the scenes of the problems (default: the installed ones)");
DEFINE_string(data_dir, "", "directory of published.csv and constrained_references.json (default: the installed one)");
DEFINE_bool(all_formulations, true,
            "audit every contact model on the three tasks, solve task 3 and fit parameters under each (default)");
DEFINE_bool(every_solver, false, "run every general solver also under the models that the paper does not compare");

namespace saltus {
namespace {

std::vector<std::string> AllContacts() {
  std::vector<std::string> contacts;
  for (const ModelTraits& traits : AllContactModels()) contacts.emplace_back(traits.name);
  return contacts;
}

FormulationAudit AuditFormulations(const Experiments& experiments, std::vector<SimulatorCommand> simulators) {
  return FormulationAudit({{"Task 1: one bounce", experiments.scene("bounce_once")},
                           {"Task 2: ground and wall", experiments.scene("ground_wall")},
                           {"Task 3: two balls", experiments.scene("two_balls")}},
                          AllContacts(),
                          std::move(simulators));
}

DescentAudit AuditDescents(const Experiments& experiments, const SolverComparison& comparison) {
  DescentAudit descents({{"Task 2", experiments.scene("ground_wall")}, {"Task 3", experiments.scene("two_balls")}},
                        AllContacts(),
                        {comparison.slow().begin(), comparison.slow().end()});
  for (const std::string& contact : AllContacts()) descents.Know(1, contact, comparison.IteratesOf(contact));
  return descents;
}

// Draws and writes each figure as SVG and as PNG. False if interrupted.
bool WriteFigures(const std::vector<PaperFigure>& figures, const std::string& output_dir) {
  std::vector<std::string> names;
  for (const PaperFigure& figure : figures) names.push_back(figure.name);
  Progress progress(ProgressFromFlags(), stderr, "figures", names.size());
  return RunJobs(names, ThreadsFromFlags(), &progress, [&](int i, const SayNote&) {
    const std::string path = output_dir + "/" + names[i];
    const Status status = WriteFigure(figures[i].figure, path + ".svg", path + ".png");
    if (!status.ok() && !InterruptGuard::GraceIsOver()) throw OutputError(status.message());
  });
}

// Does what cannot ask for interrupts itself. False if interrupted.
bool RunStage(const std::string& name, const std::function<void()>& work) {
  Progress progress(ProgressFromFlags(), stderr, name, 1);
  return RunJobs({name}, 1, &progress, [&](int, const SayNote&) { work(); });
}

std::string GivenOrShipped(const std::string& given, const std::string& folder) {
  return given.empty() ? ShippedFile(folder) : given;
}

int Reproduce(const std::vector<std::string>& arguments) {
  const auto start = std::chrono::steady_clock::now();
  std::vector<SimulatorCommand> simulators = ReadSimulators(arguments);
  if (!simulators.empty() && !FLAGS_all_formulations) {
    throw InputError("--simulate: simulators stand among all formulations; expected no --noall_formulations with it");
  }
  const std::string output_dir = OutputDirFromFlags().empty() ? "report" : OutputDirFromFlags();
  MakeDirectory(output_dir);
  std::vector<PublishedRow> rows = ReadPublished(GivenOrShipped(FLAGS_data_dir, "data") + "/published.csv");
  std::vector<BoundedReference> references =
      ReadBoundedReferences(GivenOrShipped(FLAGS_data_dir, "data") + "/constrained_references.json");
  Experiments experiments(GivenOrShipped(FLAGS_problems_dir, "problems"));
  const InterruptGuard guard;
  // Each stage writes its files as soon as it is done, so that an interrupt leaves those of all stages before it.
  const auto write_table = [&](const std::string& name, const std::string& caption, const Table& table) {
    WriteTextFile(output_dir + "/table_" + name + ".md", "# " + caption + "\n\n" + table.ToMarkdown());
    WriteTextFile(output_dir + "/table_" + name + ".csv", table.ToCsv());
  };
  const auto write_tables = [&](const std::vector<CaptionedTable>& tables) {
    for (const CaptionedTable& table : tables) write_table(table.name, table.caption, table.table);
  };
  if (!experiments.Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
  const auto elapsed = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  const double experiment_seconds = elapsed();
  const bool compared = RunStage("comparison with the published values", [&] {
    CompareWithPublished(experiments, &rows);
    for (const auto& [name, caption] : PublishedTables()) write_table(name, caption, ToTable(rows, name));
    WriteNotebookFiles(experiments, output_dir);
  });
  if (!compared) return kAnswerFailed;
  using Others = SolverComparison::Others;
  const Others others = FLAGS_every_solver       ? Others::kEverySolver
                        : FLAGS_all_formulations ? Others::kQuick
                                                 : Others::kNone;
  SolverComparison comparison(experiments, others);
  if (!comparison.Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
  write_tables(comparison.Tables());
  StrikeComparison strike(experiments.scene("two_balls"), std::move(references));
  if (!strike.Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
  write_tables(strike.Tables());
  std::optional<FormulationAudit> formulations;
  if (FLAGS_all_formulations) {
    formulations = AuditFormulations(experiments, std::move(simulators));
    if (!formulations->Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
    write_tables({formulations->ToTable()});
  }
  std::optional<DescentAudit> descents;
  if (FLAGS_all_formulations) {
    descents = AuditDescents(experiments, comparison);
    if (!descents->Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
  }
  std::optional<ParameterFits> fits;
  if (FLAGS_all_formulations) {
    fits.emplace(AllContacts());
    if (!fits->Run(ThreadsFromFlags(), ProgressFromFlags())) return kAnswerFailed;
    write_tables({fits->ToTable()});
  }
  std::optional<PaperFigure> law;
  if (FLAGS_all_formulations && !RunStage("a law of impact", [&] { law = LearnALaw(); })) return kAnswerFailed;
  std::vector<PaperFigure> figures;
  if (!RunStage("data of the figures", [&] { figures = MakePaperFigures(experiments); })) return kAnswerFailed;
  if (formulations) figures.push_back(formulations->ToFigure());
  if (descents) figures.push_back(descents->ToFigure());
  if (fits) figures.push_back(fits->ToFigure());
  if (law) figures.push_back(*law);
  for (const std::vector<PaperFigure>& more : {comparison.Figures(), strike.Figures()}) {
    figures.insert(figures.end(), more.begin(), more.end());
  }
  if (!WriteFigures(figures, output_dir)) return kAnswerFailed;
  const bool written = RunStage("report", [&] {
    WritePaperReport(experiments,
                     rows,
                     figures,
                     comparison,
                     strike,
                     formulations,
                     descents,
                     fits,
                     law,
                     experiment_seconds,
                     output_dir);
  });
  if (!written) return kAnswerFailed;

  int failed = 0;
  for (const PublishedRow& row : rows) {
    if (!row.IsJudged() || row.Matches()) continue;
    ++failed;
    std::cerr << "not reproduced: " << row.table << " " << row.problem << " " << row.contact << " " << row.quantity
              << ": expected " << row.expected << " within " << row.tolerance << ", got "
              << (row.ours ? std::to_string(*row.ours) : "nothing") << std::endl;
  }
  std::cout << rows.size() - failed << " of " << rows.size() << " rows as expected, in " << elapsed() << " s\n"
            << output_dir << "/report.html" << std::endl;
  return failed == 0 ? kDone : kAnswerFailed;
}

}  // namespace

int ReproduceMain(int argc, char** argv) {
  const std::vector<std::string> arguments(argv, argv + argc);
  return RunMain(argc, argv, FindProgram("saltus_reproduce"), [&arguments] { return Reproduce(arguments); });
}

}  // namespace saltus
