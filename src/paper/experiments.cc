#include "paper/experiments.h"

#include <algorithm>
#include <cmath>

#include "output/npz.h"
#include "programs/parallel.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kStiffnesses[] = {1e2, 1e3, 1e4, 1e5};

void RunSolver(Experiment* experiment, size_t which) {
  const std::string& solver = experiment->solvers[which];
  SolverOptions options;
  options.limits.iterations = kPublishedIterations;
  options.descent.learning_rate = experiment->learning_rate;
  options.keep_iterates = experiment->scene.optimize == Optimize::kVelocity;
  options.monitor.stop = IsStopRequested;
  experiment->runs[which] =
      SolveAndSimulate(solver, {experiment->scene, experiment->contact, experiment->precision}, options);
}

// Returns "1e2" for 100, as in the names of the stiffness experiment.
std::string StiffnessSuffix(double stiffness) { return "1e" + std::to_string(std::lround(std::log10(stiffness))); }

}  // namespace

const CheckedRun* Experiment::Find(const std::string& solver) const {
  for (const CheckedRun& run : runs) {
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
  if (!ReasonNotApplicable(contact, experiment.scene).empty()) return;
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
      experiment.gradient =
          ComputeGradient(experiment.contact, experiment.scene, experiment.precision, IsStopRequested);
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

namespace {

// The authors' name of each model, and the precision of their run.
struct Published {
  const char* name;
  Precision precision;
};

const std::map<std::string, Published>& PublishedNames() {
  static const std::map<std::string, Published>& names = *new std::map<std::string, Published>{
      {"pbd_warp", {"pbd_warp", Precision::kFloat}},
      {"pbd_brax", {"pbd_brax", Precision::kFloat}},
      {"compliant_warp", {"soft_warp", Precision::kDouble}},
      {"compliant_brax", {"soft_brax", Precision::kDouble}},
      {"convex_toi", {"convexopt_diffcosim_symplectic_euler_w_toi", Precision::kDouble}},
      {"convex", {"convexopt_diffcosim_symplectic_euler_wo_toi", Precision::kDouble}},
      {"direct_toi", {"specialized_difftaichi_w_toi", Precision::kDouble}},
      {"direct", {"specialized_difftaichi_wo_toi", Precision::kDouble}},
      {"lcp", {"lcp_nimble", Precision::kDouble}}};
  return names;
}

// Returns the losses in the layout of the notebooks' `loss`: one entry for each update, the loss before it.
NpyArray LossArray(const SolveReport& report) {
  std::vector<double> losses(report.history.losses.begin(), report.history.losses.end() - 1);
  return {{static_cast<int64_t>(losses.size())}, losses};
}

// Returns the positions of the first disc under one iterate, T x 2: before each step, and after the last except for the
// Brax models, whose files do not have it.
std::vector<double> TrajectoryAt(const Experiment& experiment, std::span<const double> z) {
  SingleShooting shooting(MakeSimulator(experiment.contact, experiment.scene, experiment.precision));
  double loss = 0;
  if (!shooting.Evaluate(z, &loss, nullptr)) return {};
  const Simulator& simulator = shooting.simulator();
  const int last = simulator.num_steps() - (simulator.traits().grid_steps > 1 ? 1 : 0);
  std::vector<double> positions, x(simulator.state_size());
  for (int k = 0; k <= last; ++k) {
    simulator.GetState(k, x);
    positions.insert(positions.end(), {x[0], x[1]});
  }
  return positions;
}

// Returns a stiffness as the notebooks spell it: Python's floats, 1000.0, except for the lowest, 100.
std::string StiffnessName(double stiffness) {
  return std::to_string(static_cast<long>(stiffness)) + (stiffness == 100 ? "" : ".0");
}

}  // namespace

void WriteNotebookFiles(const Experiments& experiments, const std::string& output_dir) {
  const std::string results = output_dir + "/results";
  MakeDirectory(results);
  for (const Experiment& experiment : experiments.all()) {
    const auto published = PublishedNames().find(experiment.contact);
    const CheckedRun* run = experiment.Find("gd");
    if (published == PublishedNames().end() || experiment.precision != published->second.precision) continue;
    if (run == nullptr || run->report.history.losses.size() < 2) continue;
    const SolveReport& report = run->report;
    const Scene& scene = experiment.scene;
    const std::string model = published->second.name;
    std::string name = "two_balls_1_" + model;
    NpzArrays arrays = {{"loss", LossArray(report)}};
    if (scene.optimize == Optimize::kVelocity) {
      name = "ground_wall_" + model + (scene.contact.friction > 0 ? "_mu_0.1" : "");
      std::vector<double> velocities;
      for (const std::vector<double>& z : report.history.iterates) {
        velocities.insert(velocities.end(), z.begin(), z.end());
      }
      const std::vector<double> trajectory =
          TrajectoryAt(experiment, report.history.iterates[report.history.iterates.size() - 2]);
      arrays["init_vel"] = {{std::ssize(report.history.iterates), 2}, velocities};
      arrays["last_traj"] = {{std::ssize(trajectory) / 2, 2}, trajectory};
    } else {
      if (experiment.contact == "compliant_warp") name += "_kn_" + StiffnessName(scene.contact.stiffness);
      arrays["ctrls"] = {{std::ssize(report.solution.control) / 2, 2}, report.solution.control};
    }
    ThrowIfFailed(WriteNpz(results + "/" + name + ".npz", arrays));
  }
}

}  // namespace saltus
