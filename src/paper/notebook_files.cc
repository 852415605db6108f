#include "paper/notebook_files.h"

#include <map>

#include "output/npz.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"

namespace saltus {
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

// The first `count` entries of the losses: the notebooks' `loss` has one entry an update, the loss before it.
NpyArray LossArray(const SolveReport& report) {
  std::vector<double> losses(report.losses.begin(), report.losses.end() - 1);
  return {{static_cast<int64_t>(losses.size())}, losses};
}

void WriteVelocityRun(const Experiment& experiment, const SolveReport& report, const std::string& path) {
  std::vector<double> velocities;
  for (const std::vector<double>& z : report.iterates) velocities.insert(velocities.end(), z.begin(), z.end());
  const std::vector<double> trajectory = TrajectoryAt(experiment, report.iterates[report.iterates.size() - 2]);
  const Status status = WriteNpz(path,
                                 {{"loss", LossArray(report)},
                                  {"init_vel", {{static_cast<int64_t>(report.iterates.size()), 2}, velocities}},
                                  {"last_traj", {{static_cast<int64_t>(trajectory.size() / 2), 2}, trajectory}}});
  if (!status.ok()) throw OutputError(status.message());
}

void WriteControlRun(const SolveReport& report, const std::string& path) {
  const Status status = WriteNpz(
      path,
      {{"loss", LossArray(report)}, {"ctrls", {{static_cast<int64_t>(report.control.size() / 2), 2}, report.control}}});
  if (!status.ok()) throw OutputError(status.message());
}

// As the notebooks spell it: Python's floats, 1000.0, but for the lowest, 100.
std::string StiffnessName(double stiffness) {
  return std::to_string(static_cast<long>(stiffness)) + (stiffness == 100 ? "" : ".0");
}

}  // namespace

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

void WriteNotebookFiles(const Experiments& experiments, const std::string& output_dir) {
  const std::string results = output_dir + "/results";
  MakeDirectory(results);
  for (const Experiment& experiment : experiments.all()) {
    const auto published = PublishedNames().find(experiment.contact);
    const SolvedRun* run = experiment.Find("gd");
    if (published == PublishedNames().end() || run == nullptr || run->report.losses.size() < 2) continue;
    const std::string name = published->second.name;
    const Scene& scene = experiment.scene;
    if (scene.optimize == Optimize::kVelocity) {
      if (experiment.precision != published->second.precision) continue;
      const std::string suffix = scene.contact.friction > 0 ? "_mu_0.1" : "";
      WriteVelocityRun(experiment, run->report, results + "/ground_wall_" + name + suffix + ".npz");
    } else if (experiment.contact == "compliant_warp") {
      if (experiment.precision != published->second.precision) continue;
      const std::string suffix = "_kn_" + StiffnessName(scene.contact.stiffness);
      WriteControlRun(run->report, results + "/two_balls_1_" + name + suffix + ".npz");
    } else if (experiment.precision == published->second.precision) {
      WriteControlRun(run->report, results + "/two_balls_1_" + name + ".npz");
    }
  }
}

}  // namespace saltus
