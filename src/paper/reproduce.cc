// `saltus_reproduce`: every table and figure of the paper, compared with its published values.
#include <gflags/gflags.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <iostream>
#include <optional>

#include "base/interrupt.h"
#include "exact/two_disc_optimum.h"
#include "output/page.h"
#include "paper/experiments.h"
#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

DEFINE_string(problems_dir, "", "directory of the scenes of the problems (default: the installed ones)");
DEFINE_string(data_dir, "", "directory of published.csv and constrained_references.json (default: the installed one)");
DEFINE_bool(all_formulations, true,
            "audit every contact model on the three tasks, solve task 3 and fit parameters under each (default)");
DEFINE_bool(every_solver, false, "run every general solver also under the models that the paper does not compare");

namespace saltus {
namespace {

void AddFigure(const PaperFigure& figure, Page* page) { page->AddFigure(figure.figure, figure.caption); }

void AddPublishedTable(const std::vector<PublishedRow>& rows, const std::string& name, Page* page) {
  for (const auto& [table, caption] : PublishedTables()) {
    if (table != name) continue;
    std::vector<std::string> notes;
    const Table printed = PaperTable(rows, name, &notes);
    page->AddTable(printed, caption + ". Above: published; below: ours", notes);
  }
}

void AddTask(const Experiments& experiments, const std::string& problem, Page* page) {
  const bool optimised = experiments.scene(problem).optimize != Optimize::kNone;
  page->AddReplay(ReplayToJson(TaskReplay(experiments, problem)),
                  optimised ? "The motions after gradient descent, each simulated with its contact model. Under exact "
                              "dynamics the same control or velocity may give another motion."
                            : "The motion under each contact model.");
}

std::vector<Tile> Summary(const Experiments& experiments, const std::vector<PublishedRow>& rows, double seconds) {
  const auto count = [&](const auto& holds) { return static_cast<int>(std::ranges::count_if(rows, holds)); };
  const int judged = count([](const PublishedRow& row) { return row.IsJudged(); });
  const int matching = count([](const PublishedRow& row) { return row.IsJudged() && row.Matches(); });
  const int wrong = count([](const PublishedRow& row) {
    return row.verdict == "published_misprint" || row.verdict == "published_error" ||
           row.verdict == "published_unreproducible";
  });
  std::vector<Tile> tiles = {{std::to_string(matching) + " of " + std::to_string(judged),
                              "numbers equal to those of a faithful implementation",
                              matching == judged ? Tone::kGood : Tone::kBad},
                             {std::to_string(wrong), "published numbers that are in error", Tone::kWarning},
                             {Format("%.1f s", seconds), "time of the experiments of the paper", Tone::kPlain}};
  if (const auto optimum = FindTwoDiscOptimum(experiments.scene("two_balls"), TwoDiscSequence::kImpact)) {
    tiles.push_back({Format("%.10f", optimum->loss), "optimal loss of task 3", Tone::kPlain});
  }
  return tiles;
}

// Adds what a section found, its tables and its figures.
void AddSection(const std::string& heading, const std::string& introduction, const Section& section, Page* page) {
  page->AddHeading(heading);
  page->AddParagraph(introduction);
  page->AddList(section.findings);
  for (const CaptionedTable& table : section.tables) page->AddTable(table.table, table.caption);
  for (const PaperFigure& figure : section.figures) AddFigure(figure, page);
}

// The parts of the report.
struct Parts {
  std::vector<PublishedRow> rows;
  std::optional<ComparedSolvers> solvers;
  std::optional<Section> strike, formulations, descents, fits;
  std::optional<PaperFigure> law;
  double seconds = 0;  // the time of the experiments
};

// Writes report.html: all tables and figures with explanations. Throws OutputError if it cannot be written.
void WritePaperReport(const Experiments& experiments, const Parts& parts, const std::string& output_dir) {
  const auto& [rows, solvers, strike, formulations, descents, fits, law, seconds] = parts;
  Page page(
      "Gradients through contact, reproduced",
      "Zhong, Han, Brikis 2022, “Differentiable Physics Simulations with Contacts: Do They Have Correct Gradients "
      "w.r.t. Position, Velocity and Control?” Every table and figure, compared with ours and with exact values");
  page.AddTiles(Summary(experiments, rows, seconds));

  page.AddHeading("What is compared");
  page.AddParagraph(
      "Nine published contact models, implemented anew from their equations, on the paper's three tasks. In the "
      "tables of the paper each cell has the published number above ours, which is computed at the precision of the "
      "published run. The last row has the same quantity under exact event-driven dynamics. Our number is as expected "
      "if it equals that of a faithful implementation within the tolerance in `data/published.csv`. Cells are "
      "coloured where the numbers differ, and the notes below give the reason: yellow, ours is as expected and the "
      "published number is in error; red, ours is not as expected; grey, rounding errors decide the number, and it is "
      "not judged.");
  AddFigure(Trajectories(experiments), &page);

  page.AddHeading("Task 1: one bounce");
  page.AddParagraph(
      "The gradient of the final height with respect to the initial height, the vertical velocity and the first "
      "force. The impact coincides with a node of the time grid. Models that resolve the impact at the end of a step "
      "have the wrong sign in the derivative with respect to the position, however small the step.");
  AddPublishedTable(rows, "T1", &page);
  AddTask(experiments, "bounce_once", &page);

  page.AddHeading("Task 2: ground and wall");
  page.AddParagraph(
      "The launch velocity with which a ball reaches a target after it bounces off the ground and a wall; 1000 "
      "updates of gradient descent at a rate of 0.01. Several solutions exist; the sign of the gradient decides which "
      "one is found.");
  AddPublishedTable(rows, "T2", &page);
  AddFigure(GroundWallLearning(experiments, 0), &page);
  AddPublishedTable(rows, "T4", &page);
  AddFigure(GroundWallLearning(experiments, 0.1), &page);
  AddTask(experiments, "ground_wall", &page);

  page.AddHeading("Task 3: two balls");
  page.AddTable(solvers->headline,
                "Task 3 under exact dynamics (`event`): three solvers compared with the analytic optimum.");
  AddFigure(solvers->controls, &page);
  page.AddParagraph(
      "The force with which one ball hits the other towards the origin, with a penalty on effort; in the paper 1000 "
      "updates at a rate of 10. None of the nine models has a correct gradient in this task, because a force acts at "
      "the moment of impact. A loss below the analytic optimum is an artefact of the time discretisation.");
  AddPublishedTable(rows, "T3", &page);
  AddFigure(TwoBallsLearning(experiments), &page);
  AddPublishedTable(rows, "F5", &page);
  AddFigure(StiffnessLearning(experiments), &page);
  AddTask(experiments, "two_balls", &page);

  if (descents) {
    AddSection(
        "Gradient descent with wrong gradients",
        "A short step against a gradient decreases the exact loss if and only if the angle between this gradient and "
        "the exact one is less than 90 degrees: a gradient that is not exact may still decrease the loss. Where the "
        "angle is larger, the descent decreases the loss under the contact model while the exact loss may increase.",
        *descents,
        &page);
  }

  AddSection(
      "Other solvers",
      "The same problems with other solvers. `loss under the model` is the loss that the solver minimizes; `exact "
      "loss` is that of the same solution under exact dynamics, the only one that may be compared between models, and "
      "`gap` its difference to the optimum. A better solver reaches the optimum of a wrong model sooner; it does not "
      "correct the gradient.",
      *solvers,
      &page);
  AddFigure(SolverLearning(experiments), &page);

  AddSection(
      "Solvers through the impact",
      "The same problem with solvers that shoot through the impact, and with solvers in which the impact time is a "
      "variable; then with bounds on the force. The optima with bounds follow from the minimum principle: the force "
      "is the projection of a linear function of time onto the bounds.",
      *strike,
      &page);

  if (formulations) {
    AddSection(
        "All contact models",
        "All contact models on the same scenes. A correct motion is not sufficient for a correct gradient: the "
        "verdict depends on how a model represents contact. The audit distinguishes a few classes, by the behaviour "
        "of the first contact as steps shrink and by the linearization of its steps, not by the model's name.",
        *formulations,
        &page);
  }

  if (fits) {
    AddSection(
        "Parameter identification with wrong gradients",
        "Gradients are also used to identify parameters from recordings, by nonlinear least squares. In this example a "
        "ball bounces off the floor and hits a second ball, which then reaches a wall; both are observed 60 times a "
        "second with 2 mm of noise. Each model fits the restitution, a mass and the four initial vectors to two "
        "recordings: one of the exact motion, and one of the model's own motion under the true parameters. The second "
        "tests the gradient alone. Plastic models cannot represent a bounce and are left out.",
        *fits,
        &page);
  }
  if (law) {
    page.AddHeading("A learned law of impact");
    page.AddParagraph(
        "The restitution need not be constant. Here it is a small network of the speed of approach in exact events "
        "(`neural_event`), whose weights are unknowns of the same least squares; derivatives pass through the impact "
        "times. The network starts as a constant and has no information on the form of the law.");
    AddFigure(*law, &page);
  }

  page.AddHeading("Optima of the follow-up paper");
  page.AddParagraph(
      "Its analytic optima are minima over a grid of 100 by 100 points; ours are continuous. The second is a local "
      "optimum: the best for its sequence of impacts.");
  AddPublishedTable(rows, "L4DC", &page);

  ThrowIfFailed(page.Write(output_dir + "/report.html"));
}

// Runs work that cannot ask for interrupts. Returns false if interrupted.
bool RunStage(const std::string& name, const std::function<void()>& work) {
  Progress progress(ProgressFromFlags(), stderr, name, 1);
  return RunJobs({name}, 1, &progress, [&](int, const SayNote&) { work(); });
}

std::string GivenOrShipped(const std::string& given, const std::string& folder) {
  return given.empty() ? ShippedFile(folder) : given;
}

int Reproduce() {
  const auto start = std::chrono::steady_clock::now();
  const std::vector<SimulatorCommand> simulators = ReadSimulators();
  if (!simulators.empty() && !FLAGS_all_formulations) {
    throw InputError("--simulate: simulators stand among all formulations; expected no --noall_formulations with it");
  }
  const std::string output_dir = OutputDirFromFlags().empty() ? "report" : OutputDirFromFlags();
  MakeDirectory(output_dir);
  Parts parts;
  parts.rows = ReadPublished(GivenOrShipped(FLAGS_data_dir, "data") + "/published.csv");
  const std::vector<BoundedReference> references =
      ReadBoundedReferences(GivenOrShipped(FLAGS_data_dir, "data") + "/constrained_references.json");
  Experiments experiments(GivenOrShipped(FLAGS_problems_dir, "problems"));
  const InterruptGuard guard;
  // Each stage writes its files as soon as it is done, so that an interrupt leaves those of all stages before it.
  const auto write_table = [&](const std::string& name, const std::string& caption, const Table& table) {
    WriteTextFile(output_dir + "/table_" + name + ".md", "# " + caption + "\n\n" + table.ToMarkdown());
    WriteTextFile(output_dir + "/table_" + name + ".csv", table.ToCsv());
  };
  // Takes the section of a stage; returns false if there is none, as the stage was interrupted.
  const auto take = [&](const auto& section) {
    if (!section) return false;
    for (const CaptionedTable& table : section->tables) write_table(table.name, table.caption, table.table);
    return true;
  };
  const int threads = ThreadsFromFlags();
  const ProgressMode progress = ProgressFromFlags();
  if (!experiments.Run(threads, progress)) return kAnswerFailed;
  const auto elapsed = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  parts.seconds = elapsed();
  const bool published = RunStage("comparison with the published values", [&] {
    CompareWithPublished(experiments, &parts.rows);
    for (const auto& [name, caption] : PublishedTables()) write_table(name, caption, ToTable(parts.rows, name));
    WriteNotebookFiles(experiments, output_dir);
  });
  if (!published) return kAnswerFailed;
  const OtherSolvers others = FLAGS_every_solver       ? OtherSolvers::kEverySolver
                              : FLAGS_all_formulations ? OtherSolvers::kQuick
                                                       : OtherSolvers::kNone;
  parts.solvers = CompareSolvers(experiments, others, threads, progress);
  if (!take(parts.solvers)) return kAnswerFailed;
  parts.strike = CompareStrikes(experiments.scene("two_balls"), references, threads, progress);
  if (!take(parts.strike)) return kAnswerFailed;
  if (FLAGS_all_formulations) {
    const std::vector<std::string> contacts = NameList(AllContactModels());
    parts.formulations = AuditFormulations({{"Task 1: one bounce", experiments.scene("bounce_once")},
                                            {"Task 2: ground and wall", experiments.scene("ground_wall")},
                                            {"Task 3: two balls", experiments.scene("two_balls")}},
                                           contacts,
                                           simulators,
                                           threads,
                                           progress);
    if (!take(parts.formulations)) return kAnswerFailed;
    parts.descents =
        AuditDescents({{"Task 2", experiments.scene("ground_wall")}, {"Task 3", experiments.scene("two_balls")}},
                      contacts,
                      {parts.solvers->slow.begin(), parts.solvers->slow.end()},
                      threads,
                      progress);
    if (!take(parts.descents)) return kAnswerFailed;
    parts.fits = FitParameters(contacts, threads, progress);
    if (!take(parts.fits)) return kAnswerFailed;
    if (!RunStage("a law of impact", [&] { parts.law = LearnALaw(); })) return kAnswerFailed;
  }
  const bool written = RunStage("report", [&] { WritePaperReport(experiments, parts, output_dir); });
  if (!written) return kAnswerFailed;

  int failed = 0;
  for (const PublishedRow& row : parts.rows) {
    if (!row.IsJudged() || row.Matches()) continue;
    ++failed;
    std::cerr << "not reproduced: " << row.table << " " << row.problem << " " << row.contact << " " << row.quantity
              << ": expected " << row.expected << " within " << row.tolerance << ", got "
              << (row.ours ? std::to_string(*row.ours) : "nothing") << std::endl;
  }
  std::cout << parts.rows.size() - failed << " of " << parts.rows.size() << " rows as expected, in " << elapsed()
            << " s\n"
            << output_dir << "/report.html" << std::endl;
  return failed == 0 ? kDone : kAnswerFailed;
}

}  // namespace

int ReproduceMain(int argc, char** argv) { return RunMain(argc, argv, FindProgram("saltus_reproduce"), Reproduce); }

}  // namespace saltus
