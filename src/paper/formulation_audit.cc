#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "base/number_text.h"
#include "base/statistics.h"
#include "base/table.h"
#include "paper/experiments.h"
#include "programs/audit.h"
#include "programs/parallel.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr std::string_view kUnit = "direct";
// Times are medians over rounds in which the models take turns.
constexpr int kRounds = 7;
constexpr double kTurn = 3e-4;  // s, at least
// Smaller errors are rounding, and are shown on this line of the figure.
constexpr double kLeastErrorShown = 1e-4;
// Step counts in each level of refinement: fewer than in an audit, for the sake of the slow models.
constexpr int kSamples = 5;

// A rollout and its gradient by initial state and control, to be timed.
class Work {
 public:
  Work(const std::string& contact, const Scene& scene)
      : simulator_(MakeSimulator(contact, scene, Precision::kDouble)),
        initial_(InitialState(scene)),
        control_(InitialControl(scene, simulator_->num_steps())),
        end_(simulator_->state_size()),
        cotangent_(end_.size()),
        by_initial_(initial_.size()),
        by_control_(control_.size()) {}

  void Do() {
    if (!simulator_->Rollout(initial_, control_)) return;
    simulator_->GetState(simulator_->num_steps(), end_);
    TerminalGradient(simulator_->scene().objective, end_, simulator_->body_size(), cotangent_);
    simulator_->AdjointInto(cotangent_, {by_initial_, by_control_, nullptr});
  }

  // Returns the time of one call, s.
  double Time() {
    const double start = ThreadTime();
    double time = 0;
    int calls = 0;
    for (int batch = 1; time < kTurn; batch *= 2) {
      for (int i = 0; i < batch; ++i) Do();
      calls += batch;
      time = ThreadTime() - start;
    }
    return time / calls;
  }

 private:
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> initial_, control_, end_, cotangent_, by_initial_, by_control_;
};

// Returns the cost of a step of the scene's grid with its gradient, relative to kUnit; 0 where a model is not
// applicable.
std::vector<double> MeasureCosts(const std::vector<std::string>& contacts, const Scene& scene) {
  std::vector<std::unique_ptr<Work>> works;
  for (const std::string& contact : contacts) {
    const bool can = ReasonNotApplicable(contact, scene).empty();
    works.push_back(can ? std::make_unique<Work>(contact, scene) : nullptr);
  }
  std::vector<std::vector<double>> times(contacts.size());
  for (int round = 0; round < kRounds; ++round) {
    for (size_t i = 0; i < works.size(); ++i) {
      if (works[i] != nullptr) times[i].push_back(works[i]->Time());
    }
  }
  const size_t unit = std::ranges::find(contacts, kUnit) - contacts.begin();
  const double unit_time = Median(times[unit]);
  std::vector<double> costs;
  for (const std::vector<double>& of_model : times)
    costs.push_back(of_model.empty() ? 0.0 : Median(of_model) / unit_time);
  return costs;
}

// The results of one task.
struct Results {
  TitledScene task;
  AuditReport report;
  std::vector<double> costs;  // of each model, in those of `direct`; 0 if it cannot take the scene
};

// Returns |g - g_exact| / |g_exact| over initial positions and velocities.
double ErrorByInitialState(const Results& results, size_t model) {
  const ModelGradient& gradient = results.report.models[model].gradient;
  if (!gradient.ok() || !results.report.reference) return std::nan("");
  return RelativeError(gradient.gradient.initial, results.report.reference->gradient.initial);
}

// Returns the classes of a model, and the numbers of the tasks in which it is of each.
std::vector<std::pair<ContactClass, std::vector<std::string>>> ClassesOf(const std::vector<Results>& all,
                                                                         size_t model) {
  std::vector<std::pair<ContactClass, std::vector<std::string>>> classes;
  for (size_t task = 0; task < all.size(); ++task) {
    const ModelAudit& audit = all[task].report.models[model];
    if (!audit.recognition) continue;
    const ContactClass found = audit.recognition->contact_class;
    auto known = std::ranges::find_if(classes, [&](const auto& entry) { return entry.first == found; });
    if (known == classes.end()) known = classes.insert(classes.end(), {found, {}});
    known->second.push_back(std::to_string(task + 1));
  }
  return classes;
}

// Returns "continuous force" or, where tasks differ, "continuous force (1), force with a jump (2, 3)".
std::string ClassesInWords(const std::vector<Results>& all, size_t model) {
  const auto classes = ClassesOf(all, model);
  std::vector<std::string> words;
  for (const auto& [found, tasks] : classes) {
    words.push_back(ContactClassToString(found) + (classes.size() > 1 ? " (" + Joined(tasks) + ")" : ""));
  }
  return Joined(words);
}

// Returns the geometric mean of the cost over the tasks.
double CostOf(const std::vector<Results>& all, size_t model) {
  double sum = 0;
  int count = 0;
  for (const Results& results : all) {
    if (results.costs[model] <= 0) continue;
    sum += std::log(results.costs[model]);
    ++count;
  }
  return count > 0 ? std::exp(sum / count) : std::nan("");
}

CaptionedTable TableOf(const std::vector<Results>& all, const std::vector<std::string>& contacts) {
  std::vector<Column> columns = ColumnsOf("contact; class");
  for (size_t task = 1; task <= all.size(); ++task) {
    const std::string number = ", task " + std::to_string(task);
    columns.push_back({"loss" + number, 7});
    columns.push_back({"error" + number, 2});
    columns.push_back({"verdict" + number});
  }
  columns.push_back({"cost of a step"});
  Table table(columns);
  for (size_t model = 0; model < contacts.size(); ++model) {
    std::vector<Cell> row = {contacts[model], ClassesInWords(all, model)};
    for (const Results& results : all) {
      const ModelAudit& audit = results.report.models[model];
      if (!audit.gradient.ok()) {
        row.insert(row.end(), {Cell(), Cell(), Cell(audit.gradient.reason).WithTone(Tone::kMuted)});
        continue;
      }
      row.insert(row.end(),
                 {audit.gradient.loss,
                  ErrorByInitialState(results, model),
                  Cell(VerdictToString(audit.verdict)).WithTone(ToneOf(audit.verdict))});
    }
    const double cost = CostOf(all, model);
    row.push_back(std::isnan(cost) ? Cell() : Cell(RoundedTo(2, cost)));
    table.AddRow(std::move(row));
  }
  std::vector<Cell> exact = {"exact", Cell()};
  for (const Results& results : all) {
    exact.insert(exact.end(), {results.report.reference->loss, Cell(), Cell()});
  }
  exact.emplace_back();
  table.AddRow(std::move(exact));
  return {
      "formulations",
      "Every contact model on the three tasks, at their own steps and initial guess: its loss, the relative error of "
      "its gradient by the initial state, and the verdict, which rests on smaller steps too. The class is "
      "recognised from what the first contact does as steps shrink. The cost of a step, with its gradient, is in "
      "those of `direct`, and the mean over the tasks.",
      std::move(table)};
}

PaperFigure FigureOf(const std::vector<Results>& all, const std::vector<std::string>& contacts) {
  Figure figure;
  for (const Results& results : all) {
    Panel panel{.title = results.task.title,
                .x = {.label = "cost of a step and its gradient (direct = 1)", .log = true, .min = 0.8},
                .y = {.label = "relative error of the gradient", .log = true, .min = kLeastErrorShown / 2}};
    for (size_t model = 0; model < contacts.size(); ++model) {
      const double error = ErrorByInitialState(results, model);
      if (std::isnan(error) || results.costs[model] <= 0) continue;
      Series series = Series::ForModel(contacts[model], {results.costs[model]}, {std::max(error, kLeastErrorShown)});
      series.line = false;
      panel.series.push_back(std::move(series));
    }
    panel.reference_lines.push_back({.value = kLeastErrorShown, .label = "exact to rounding", .colour = "#999999"});
    figure.panels.push_back(std::move(panel));
  }
  return {
      "Time of a step with its gradient, and error of the gradient, at the steps of the scenes. The best models "
      "are at the lower left.",
      figure};
}

std::vector<std::string> FindingsOf(const std::vector<Results>& all, const std::vector<std::string>& contacts) {
  std::map<ContactClass, std::vector<std::string>> members;
  for (size_t model = 0; model < contacts.size(); ++model) {
    const auto classes = ClassesOf(all, model);
    for (const auto& [found, tasks] : classes) {
      const std::string where = classes.size() > 1 ? " in task " + Joined(tasks, " and ") : "";
      members[found].push_back("`" + contacts[model] + "`" + where);
    }
  }
  std::vector<std::string> classes;
  for (const auto& [found, names] : members) {
    classes.push_back(std::string(ContactClassToString(found)) + " (" + Joined(names, ", ") + "): " + MeaningOf(found));
  }
  return classes;
}

}  // namespace

std::optional<Section> AuditFormulations(const std::vector<TitledScene>& tasks, std::vector<std::string> contacts,
                                         const std::vector<SimulatorCommand>& simulators, int threads,
                                         ProgressMode mode) {
  CHECK(std::ranges::find(contacts, kUnit) != contacts.end());
  const std::vector<std::string> models = contacts;
  for (const SimulatorCommand& simulator : simulators) contacts.push_back(simulator.name);
  std::vector<Results> all;
  for (const TitledScene& task : tasks) {
    all.push_back({task, {ComputeExactGradient(task.scene), {}}, {}});
    all.back().report.models.resize(contacts.size());
  }
  const int count = static_cast<int>(all.size() * contacts.size());
  std::vector<std::string> names, costs;
  // Jobs begin with the last model: slow models are the last, and no core should wait for them in the end.
  const auto model_of = [&](int i) { return contacts.size() - 1 - i / all.size(); };
  for (int i = 0; i < count; ++i) {
    names.push_back(all[i % all.size()].task.scene.name + " " + contacts[model_of(i)]);
  }
  for (const Results& results : all) costs.push_back("times of " + results.task.scene.name);
  Progress progress(mode, stderr, "all formulations", count + all.size());
  AuditOptions options;
  options.refinement.samples = kSamples;
  options.refinement.parameters = false;  // they enter no verdict, and take most of the time
  options.attribution = false;
  options.stop = IsStopRequested;
  const bool audited = RunJobs(names, threads, &progress, [&](int i, const SayNote&) {
    const size_t model = model_of(i);
    auto& [task, report, unused] = all[i % all.size()];
    report.models[model] = model < models.size()
                               ? AuditModel(models[model], task.scene, Precision::kDouble, report.reference, options)
                               : AuditBlackBox(OpenSimulator(simulators[model - models.size()], /*copies=*/1),
                                               task.scene,
                                               report.reference,
                                               options);
  });
  if (!audited) return std::nullopt;
  // The costs are measured on one thread, so that nothing else of this program disturbs them.
  const bool measured = RunJobs(costs, 1, &progress, [&](int i, const SayNote&) {
    all[i].costs = MeasureCosts(models, all[i].task.scene);
    all[i].costs.resize(contacts.size());
  });
  if (!measured) return std::nullopt;
  return Section{FindingsOf(all, contacts), {TableOf(all, contacts)}, {FigureOf(all, contacts)}};
}

}  // namespace saltus
