#include "programs/reproduce.h"

#include <gflags/gflags.h>

#include <chrono>
#include <iostream>

#include "programs/experiments.h"
#include "programs/notebook_files.h"
#include "programs/paper_figures.h"
#include "programs/paper_report.h"
#include "programs/published.h"
#include "programs/solver_comparison.h"

DEFINE_string(problems_dir, SALTUS_PROBLEMS_DIR, "directory of the problem scenes");
DEFINE_string(data_dir, SALTUS_DATA_DIR, "directory of published.csv");

namespace saltus {
namespace {

int Reproduce() {
  const auto start = std::chrono::steady_clock::now();
  const std::string output_dir = OutputDirFromFlags().empty() ? "report" : OutputDirFromFlags();
  MakeDirectory(output_dir);
  std::vector<PublishedRow> rows = ReadPublished(FLAGS_data_dir + "/published.csv");
  Experiments experiments(FLAGS_problems_dir);
  if (!experiments.Run(ThreadsFromFlags(), ProgressFromFlags())) {
    std::cerr << "interrupted" << std::endl;
    return kAnswerFailed;
  }
  const auto elapsed = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  const double experiment_seconds = elapsed();
  SolverComparison comparison(experiments);
  if (!comparison.Run(ThreadsFromFlags(), ProgressFromFlags())) {
    std::cerr << "interrupted" << std::endl;
    return kAnswerFailed;
  }
  CompareWithPublished(experiments, &rows);
  WriteNotebookFiles(experiments, output_dir);
  const std::vector<PaperFigure> figures = MakePaperFigures(experiments);
  for (const auto& written : {figures, comparison.Figures()}) {
    for (const PaperFigure& figure : written) {
      const std::string path = output_dir + "/" + figure.name;
      const Status status = WriteFigure(figure.figure, path + ".svg", path + ".png");
      if (!status.ok()) throw InputError(status.message());
    }
  }
  WritePaperReport(experiments, rows, figures, comparison, experiment_seconds, output_dir);

  const auto write_table = [&](const std::string& name, const std::string& caption, const Table& table) {
    WriteTextFile(output_dir + "/table_" + name + ".md", "# " + caption + "\n\n" + table.ToMarkdown());
    WriteTextFile(output_dir + "/table_" + name + ".csv", table.ToCsv());
  };
  for (const auto& [name, caption] : PublishedTables()) write_table(name, caption, ToTable(rows, name));
  for (const CaptionedTable& table : comparison.Tables()) write_table(table.name, table.caption, table.table);

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
  return RunMain(argc, argv, "Every table and figure of the paper: saltus_reproduce --output_dir=DIR", Reproduce);
}

}  // namespace saltus
