#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "base/table.h"
#include "paper/experiments.h"
#include "programs/parallel.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kMostOfIt = 0.95;
constexpr double kAhead = 90;  // degrees: beyond, the step climbs the exact loss

double AngleBetween(const std::vector<double>& x, const std::vector<double>& y) {
  const Eigen::Map<const Eigen::VectorXd> a(x.data(), std::ssize(x)), b(y.data(), std::ssize(y));
  const double cosine = a.dot(b) / (a.norm() * b.norm());  // not a number where a gradient vanishes
  return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180 / std::numbers::pi;
}

// Returns the shooting function of exact dynamics with the control intervals of the contact model.
SingleShooting ExactShooting(const Scene& scene, int num_steps) {
  Scene exact = scene;
  exact.steps = num_steps;
  return SingleShooting(MakeSimulator(ExactModel()->name, exact, Precision::kDouble));
}

// One descent, examined at some of its iterates.
struct Descent {
  size_t task = 0;
  std::string contact;
  std::vector<double> iterations, angles, exact_losses, losses;  // angles in degrees
};

// Returns the iterations that are examined: 0, 1, 2, 3, 5, 8, ... to the last, about equally many in every power of
// ten.
std::vector<int> ExaminedIterations() {
  std::vector<int> at;
  for (double k = 0; k < kPublishedIterations; k = std::max(k + 1, 1.15 * k)) at.push_back(static_cast<int>(k));
  at.push_back(kPublishedIterations);
  return at;
}

void Follow(const Scene& scene, Descent* descent) {
  SingleShooting own(MakeSimulator(descent->contact, scene, Precision::kDouble));
  SingleShooting exact = ExactShooting(scene, own.simulator().num_steps());
  own.set_stop(IsStopRequested);
  const double rate = DefaultLearningRate(scene);
  std::vector<double> z = own.initial_guess(), gradient(z.size()), exact_gradient(z.size());
  int k = 0;
  double loss = 0, exact_loss = 0;
  if (!own.Evaluate(z, &loss, gradient.data())) return;
  for (const int examined : ExaminedIterations()) {
    for (; k < examined; ++k) {
      for (size_t i = 0; i < z.size(); ++i) z[i] -= rate * gradient[i];
      if (!own.Evaluate(z, &loss, gradient.data())) return;
    }
    if (!exact.Evaluate(z, &exact_loss, exact_gradient.data())) return;
    descent->iterations.push_back(k + 1);  // on a logarithmic axis
    descent->angles.push_back(AngleBetween(gradient, exact_gradient));
    descent->losses.push_back(loss);
    descent->exact_losses.push_back(exact_loss);
  }
}

PaperFigure FigureOf(const std::vector<TitledScene>& tasks, const std::vector<Descent>& descents) {
  Figure figure;
  for (size_t number = 0; number < tasks.size(); ++number) {
    const TitledScene& task = tasks[number];
    const Axis iteration{.label = "iteration, from 1", .log = true};
    Panel angle{.title = task.title + ": angle to the exact gradient",
                .x = iteration,
                .y = {.label = "angle (degrees)", .min = 0.0, .max = 180.0},
                .reference_lines = {{.value = kAhead, .label = "beyond, a step climbs"}}};
    Panel loss{.title = task.title + ": exact loss", .x = iteration, .y = {.label = "exact loss", .log = true}};
    Panel own{.title = task.title + ": loss under the model",
              .x = iteration,
              .y = {.label = "loss under the model", .log = true}};
    for (const Descent& descent : descents) {
      if (descent.task != number) continue;
      angle.series.push_back(Series::ForModel(descent.contact, descent.iterations, descent.angles));
      loss.series.push_back(Series::ForModel(descent.contact, descent.iterations, descent.exact_losses));
      own.series.push_back(Series::ForModel(descent.contact, descent.iterations, descent.losses));
    }
    figure.panels.insert(figure.panels.end(), {angle, loss, own});
  }
  return {
      "Gradient descent as in the paper: the angle between each model's gradient and the exact gradient of the exact "
      "loss at the same iterate, the exact loss there, and the loss under the model.",
      figure};
}

std::vector<std::string> FindingsOf(const std::vector<TitledScene>& tasks, const std::vector<Descent>& descents,
                                    const std::vector<std::string>& left_out) {
  std::vector<std::string> findings;
  for (size_t number = 0; number < tasks.size(); ++number) {
    double least = std::numeric_limits<double>::infinity();
    for (const Descent& descent : descents) {
      if (descent.task != number) continue;
      for (const double loss : descent.exact_losses) least = std::min(least, loss);
    }
    std::vector<std::string> right, wrong_side, succeed, fail;
    for (const Descent& descent : descents) {
      if (descent.task != number || descent.angles.empty()) continue;
      (descent.angles.front() < kAhead ? right : wrong_side).push_back(descent.contact);
      const double first = descent.exact_losses.front(), last = descent.exact_losses.back();
      const bool gained = first - last >= kMostOfIt * (first - least);
      (gained ? succeed : fail).push_back(descent.contact);
    }
    findings.push_back(tasks[number].title +
                       ": at the start the angle between the gradient and the exact one is less than " +
                       Cell(kAhead).Display(2) + " degrees under " + JoinedNames(right) + ", and larger under " +
                       JoinedNames(wrong_side) + ".");
    findings.push_back(tasks[number].title + ": after the last iteration the exact loss has decreased by at least " +
                       Cell(100 * kMostOfIt).Display(3) + " % of the largest decrease under " + JoinedNames(succeed) +
                       "; and by less under " + JoinedNames(fail) + ".");
  }
  if (!left_out.empty()) findings.push_back("Left out, as their gradients take long: " + JoinedNames(left_out) + ".");
  return findings;
}

}  // namespace

std::optional<Section> AuditDescents(const std::vector<TitledScene>& tasks, const std::vector<std::string>& contacts,
                                     const std::vector<std::string>& slow, int threads, ProgressMode mode) {
  std::vector<Descent> descents;
  for (size_t task = 0; task < tasks.size(); ++task) {
    for (const std::string& contact : contacts) {
      if (std::ranges::find(slow, contact) != slow.end()) continue;
      if (!ReasonNotApplicable(contact, tasks[task].scene).empty()) continue;
      descents.push_back({task, contact, {}, {}, {}, {}});
    }
  }
  // Jobs begin with the last model, because slow models are the last in the registry.
  std::vector<Descent*> jobs;
  for (Descent& descent : descents) jobs.push_back(&descent);
  std::ranges::reverse(jobs);
  std::vector<std::string> names;
  for (const Descent* job : jobs) names.push_back(tasks[job->task].scene.name + " " + job->contact);
  Progress progress(mode, stderr, "descent beside the exact gradient", jobs.size());
  const auto follow = [&](int i, const SayNote&) { Follow(tasks[jobs[i]->task].scene, jobs[i]); };
  if (!RunJobs(names, threads, &progress, follow)) return std::nullopt;
  return Section{FindingsOf(tasks, descents, slow), {}, {FigureOf(tasks, descents)}};
}

}  // namespace saltus
