#include "paper/paper_report.h"

#include <algorithm>

#include "exact/two_disc_optimum.h"
#include "output/html_report.h"
#include "paper/task_replays.h"

namespace saltus {
namespace {

void AddFigure(const std::vector<DrawnPaperFigure>& figures, const std::string& name, HtmlReport* report) {
  for (const DrawnPaperFigure& figure : figures) {
    if (figure.name == name) report->AddFigure(figure.figure, figure.caption);
  }
}

void AddPublishedTable(const std::vector<PublishedRow>& rows, const std::string& name, HtmlReport* report) {
  for (const auto& [table, caption] : PublishedTables()) {
    if (table == name) report->AddTable(ToTable(rows, name), caption);
  }
}

void AddTask(const Experiments& experiments, const std::string& problem, HtmlReport* report) {
  const bool optimised = experiments.scene(problem).optimize != Optimize::kNone;
  report->AddReplay(TaskReplay(experiments, problem),
                    optimised
                        ? "The motions that gradient descent ends with, each as its contact model sees it. In exact "
                          "dynamics the same control or velocity may lead elsewhere."
                        : "The motion under each contact model.");
}

std::vector<Tile> Summary(const Experiments& experiments, const std::vector<PublishedRow>& rows, double seconds) {
  const auto count = [&](const auto& holds) {
    return static_cast<int>(std::count_if(rows.begin(), rows.end(), holds));
  };
  const int judged = count([](const PublishedRow& row) { return row.IsJudged(); });
  const int matching = count([](const PublishedRow& row) { return row.IsJudged() && row.Matches(); });
  const int wrong = count([](const PublishedRow& row) {
    return row.verdict == "published_misprint" || row.verdict == "published_error" ||
           row.verdict == "published_unreproducible";
  });
  std::vector<Tile> tiles = {{std::to_string(matching) + " of " + std::to_string(judged),
                              "numbers as a faithful implementation gives them",
                              matching == judged ? Tone::kGood : Tone::kBad},
                             {std::to_string(wrong), "printed numbers that are themselves in error", Tone::kWarning},
                             {Format("%.1f s", seconds), "for all experiments", Tone::kPlain}};
  if (const auto optimum = FindTwoDiscOptimum(experiments.scene("two_balls"), TwoDiscSequence::kImpact)) {
    tiles.push_back({Format("%.12f", optimum->loss), "optimal loss of task 3", Tone::kPlain});
  }
  return tiles;
}

void AddFits(const ParameterFits& fits, const std::vector<DrawnPaperFigure>& figures, HtmlReport* report) {
  report->AddHeading(1, "Wrong gradients, wrong parameters");
  report->AddParagraph(
      "What gradients are for besides control: parameters from a recording, by nonlinear least squares. A ball bounces "
      "off the floor and strikes another, which goes on to a wall; both are seen 60 times a second with 2 mm of noise. "
      "Each model fits the restitution, a mass and the four initial vectors to a recording of the exact motion, which "
      "is what the world would give, and to one of its own motion under the true parameters. The second is the fair "
      "question to a gradient: the model has nothing wrong but that. Plastic models, which cannot explain a bounce, "
      "are left "
      "out.");
  report->AddList(fits.Findings());
  AddFigure(figures, "parameter_fits", report);
  const CaptionedTable table = fits.ToTable();
  report->AddTable(table.table, table.caption);
}

void AddLaw(const PaperFigure& law, const std::vector<DrawnPaperFigure>& figures, HtmlReport* report) {
  report->AddHeading(1, "A law of impact, learned");
  report->AddParagraph(
      "A law need not be a number. Here the restitution is a small network of the speed of approach inside exact "
      "events "
      "(`neural_event`), and its weights are unknowns of the same least squares; derivatives pass through the impact "
      "times. It begins as a constant, in whose place `event` is the same model, and does not contain the form of the "
      "law.");
  AddFigure(figures, law.name, report);
}

}  // namespace

void WritePaperReport(const Experiments& experiments, const std::vector<PublishedRow>& rows,
                      const std::vector<DrawnPaperFigure>& figures, const SolverComparison& comparison,
                      const StrikeComparison& strike, const std::optional<FormulationAudit>& formulations,
                      const std::optional<DescentAudit>& descents, const std::optional<ParameterFits>& fits,
                      const std::optional<PaperFigure>& law, double seconds, const std::string& output_dir) {
  HtmlReport report("Gradients through contact, reproduced",
                    "Zhong, Han, Brikis 2022, “Differentiable Physics Simulations with Contacts: Do They Have "
                    "Correct Gradients w.r.t. Position, Velocity and Control?”, every table and figure next to ours "
                    "and to the exact values");
  report.AddTiles(Summary(experiments, rows, seconds));

  report.AddHeading(1, "What is compared");
  report.AddParagraph(
      "Nine published contact models, written anew from their mathematics, on the paper's three tasks. `published` "
      "is the number as printed; `ours` is computed by the programs of this project at the precision of the row; "
      "`exact` is the same quantity under exact event-driven dynamics. A row is as expected if ours equals what a "
      "faithful implementation gives, within a tolerance stated in `data/published.csv`. Where the printed number "
      "itself is in error, the row states this and the reason; it is neither imitated nor silently corrected.");
  report.AddList(
      {"Reproduced: ours is the printed number.",
       "As expected, though not as printed: ours is what a faithful implementation gives, and the print is a misprint "
       "(the authors' own notebooks contradict it), answers another question than the table asks, is not what the "
       "released code gives, or carries the error of an inexact cone solver, where ours solves the cone program "
       "exactly.",
       "Not judged: rounding decides the number, which is shown only."});
  AddFigure(figures, "trajectories", &report);

  report.AddHeading(1, "Task 1: one bounce");
  report.AddParagraph(
      "The gradient of the final height by initial height, vertical velocity and first force. The impact falls "
      "exactly on a node of the time grid. Models that resolve the impact at the end of a step get the sign of the "
      "position's gradient wrong, however small the step.");
  AddPublishedTable(rows, "T1", &report);
  AddTask(experiments, "bounce_once", &report);

  report.AddHeading(1, "Task 2: ground and wall");
  report.AddParagraph(
      "The launch velocity that takes a ball off ground and wall to a target; 1000 updates of gradient descent at "
      "rate 0.01. Several solutions exist; which one is found is decided by the sign of the gradient.");
  AddPublishedTable(rows, "T2", &report);
  AddFigure(figures, "ground_wall_learning", &report);
  AddPublishedTable(rows, "T4", &report);
  AddFigure(figures, "ground_wall_learning_mu", &report);
  AddTask(experiments, "ground_wall", &report);

  report.AddHeading(1, "Task 3: two balls");
  report.AddParagraph(
      "The force that makes one ball strike the other towards the origin, with a penalty on effort; 1000 updates at "
      "rate 10. None of the nine models has the right gradient here, because a force acts at the moment of impact. A "
      "loss below the analytic optimum is possible only because the discrete dynamics are not the real ones.");
  AddPublishedTable(rows, "T3", &report);
  AddFigure(figures, "two_balls_learning", &report);
  AddPublishedTable(rows, "F5", &report);
  AddFigure(figures, "stiffness_learning", &report);
  AddTask(experiments, "two_balls", &report);

  if (descents) {
    report.AddHeading(1, "Along the descent");
    report.AddParagraph(
        "How can optimisation succeed with wrong gradients, and where does it fail? A step against a gradient lowers "
        "the "
        "exact loss, if it is short, wherever the angle between this gradient and the exact one is less than 90 "
        "degrees: "
        "the gradient need not be right, it must point to the right side. Where a model's gradient turns further away, "
        "its descent goes on lowering the loss that the model sees, while the exact loss may rise.");
    report.AddList(descents->Findings());
    AddFigure(figures, "descent_audit", &report);
  }

  report.AddHeading(1, "Better solvers");
  report.AddParagraph(
      "The same problems by other solvers. `loss under the model` is what the solver minimised; `exact loss` is the "
      "same solution re-simulated exactly, the only one that may be compared between models, and `gap` what it leaves "
      "to gain. A better solver finds the wrong model's optimum sooner; it does not repair the gradient.");
  report.AddList(comparison.Findings());
  for (const PaperFigure& figure : comparison.Figures()) AddFigure(figures, figure.name, &report);
  for (const CaptionedTable& table : comparison.Tables()) report.AddTable(table.table, table.caption);
  AddFigure(figures, "solver_learning", &report);

  report.AddHeading(1, "Through the impact");
  report.AddParagraph(
      "The same problem by solvers that shoot over the impact, and by solvers that make its time a variable; then with "
      "bounds on the force. The optima with bounds are known from the minimum principle: the force is that within its "
      "bounds which is nearest to a straight line in time.");
  report.AddList(strike.Findings());
  for (const CaptionedTable& table : strike.Tables()) report.AddTable(table.table, table.caption);
  for (const PaperFigure& figure : strike.Figures()) AddFigure(figures, figure.name, &report);

  if (formulations) {
    report.AddHeading(1, "Every formulation");
    report.AddParagraph(
        "All contact models on the same scenes. A right verdict needs more than a right trajectory: what decides is "
        "how a model makes contact, of which the audit finds a few classes. It recognises them from what the first "
        "contact does as steps shrink, and from the linearization of its steps, not from the model's name.");
    report.AddList(formulations->Classes());
    const CaptionedTable table = formulations->ToTable();
    report.AddTable(table.table, table.caption);
    AddFigure(figures, "formulations", &report);
  }

  if (fits) AddFits(*fits, figures, &report);
  if (law) AddLaw(*law, figures, &report);

  report.AddHeading(1, "Optima of the follow-up paper");
  report.AddParagraph(
      "Its analytic optima are minima over a grid of 100 by 100 points; ours are the continuous ones. The second is "
      "only a local optimum: the best for its sequence of collisions.");
  AddPublishedTable(rows, "L4DC", &report);

  const Status status = report.Write(output_dir + "/report.html");
  if (!status.ok()) throw OutputError(status.message());
}

}  // namespace saltus
