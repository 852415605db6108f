#include "paper/experiments.h"

#include <algorithm>
#include <cmath>

#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kStiffnesses[] = {1e2, 1e3, 1e4, 1e5};

void RunSolver(Experiment* experiment, size_t which) {
  const std::string& solver = experiment->solvers[which];
  SolverOptions options;
  options.iterations = kPublishedIterations;
  options.learning_rate = experiment->learning_rate;
  options.keep_iterates = experiment->scene.optimize == Optimize::kVelocity;
  options.stop = AskedToStop;
  experiment->runs[which] =
      SolveAndSimulate(solver, {experiment->scene, experiment->contact, experiment->precision}, options);
}

// Returns "1e2" for 100, as in the names of the stiffness experiment.
std::string StiffnessSuffix(double stiffness) { return "1e" + std::to_string(std::lround(std::log10(stiffness))); }

}  // namespace

const SolvedRun* Experiment::Find(const std::string& solver) const {
  for (const SolvedRun& run : runs) {
    if (run.report.solver == solver) return &run;
  }
  return nullptr;
}

Experiments::Experiments(const std::string& problems_dir) {
  for (const std::string problem :
       {"bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"}) {
    scenes_[problem] = LoadScene(problems_dir + "/" + problem + ".yaml");
  }
  const double friction = 0.1;
  for (const ModelTraits& traits : AllContactModels()) {
    if (!traits.compared && !traits.event_driven) continue;
    const std::string contact(traits.name);
    for (const Precision precision : {Precision::kDouble, Precision::kFloat}) {
      if (precision == Precision::kFloat && traits.event_driven) continue;
      for (const char* problem : {"bounce_once", "ground_wall", "two_balls"}) Add(problem, 0, contact, precision, 0);
      Add("ground_wall", friction, contact, precision, 0);
    }
  }
  for (const double stiffness : kStiffnesses) Add("two_balls", 0, "compliant_warp", Precision::kDouble, stiffness);
}

void Experiments::Add(const std::string& problem, double friction, const std::string& contact, Precision precision,
                      double stiffness) {
  Experiment experiment;
  experiment.scene = scenes_.at(problem);
  experiment.scene.contact.friction = friction;
  std::string name = contact;
  if (stiffness > 0) {
    experiment.scene.contact.stiffness = stiffness;
    name += "_kn" + StiffnessSuffix(stiffness);
  }
  if (!WhyNotApplicable(contact, experiment.scene).empty()) return;
  experiment.contact = contact;
  experiment.precision = precision;
  if (experiment.scene.optimize != Optimize::kNone) {
    experiment.learning_rate = DefaultLearningRate(experiment.scene);
    experiment.solvers = {"gd"};
    if (precision == Precision::kDouble && stiffness == 0) experiment.solvers = {"gd", "ceres_lbfgs", "ceres_lm"};
    experiment.runs.resize(experiment.solvers.size());
  }
  experiment.name = name;
  experiments_.push_back(std::move(experiment));
}

bool Experiments::Run(int threads, ProgressMode mode) {
  // There is one job for each gradient and one for each solver.
  std::vector<std::function<void()>> jobs;
  std::vector<std::string> names;
  for (Experiment& experiment : experiments_) {
    jobs.push_back([&experiment] {
      experiment.gradient = ComputeGradient(experiment.contact, experiment.scene, experiment.precision, AskedToStop);
    });
    const std::string name = experiment.scene.name + " " + experiment.contact;
    names.push_back(name);
    for (size_t i = 0; i < experiment.solvers.size(); ++i) {
      jobs.push_back([&experiment, i] { RunSolver(&experiment, i); });
      names.push_back(name + " " + experiment.solvers[i]);
    }
  }
  Progress progress(mode, stderr, "experiments", jobs.size());
  return RunJobs(names, threads, &progress, [&](int i, const SayNote&) { jobs[i](); });
}

const Experiment* Experiments::Find(const std::string& problem, double friction, const std::string& contact,
                                    Precision precision) const {
  const auto found = std::ranges::find_if(experiments_, [&](const Experiment& one) {
    return one.scene.name == problem && one.scene.contact.friction == friction && one.name == contact &&
           one.precision == precision;
  });
  return found == experiments_.end() ? nullptr : &*found;
}

const Experiment* Experiments::Exact(const std::string& problem, double friction) const {
  return Find(problem, friction, std::string(ExactModel()->name), Precision::kDouble);
}

}  // namespace saltus
