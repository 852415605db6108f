// A user's own running cost and own constraint, solved by an installed saltus through a collision. Exit code 0 if the
// constraint holds on the exact motion, and matters.
#include <ceres/autodiff_cost_function.h>

#include <cmath>
#include <iostream>

#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace {

// 0.05 |v|^2 of the striker, integrated over time.
struct Drag {
  template <typename T>
  bool operator()(const T* x, const T* h, T* residuals) const {
    using std::sqrt;
    for (int j = 0; j < 2; ++j) residuals[j] = sqrt(0.05 * h[0]) * x[2 + j];
    return true;
  }
};

// The target ends no faster than this.
constexpr double kFastest = 2.0;  // m/s
struct SlowEnough {
  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    residuals[0] = x[2] * x[2] + x[3] * x[3] - kFastest * kFastest;
    return true;
  }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: own_terms two_balls.yaml\n";
    return 2;
  }
  const auto scene = saltus::LoadSceneFile(argv[1]);
  if (const auto* error = std::get_if<saltus::SceneFileError>(&scene)) {
    std::cerr << error->ToString() << '\n';
    return 2;
  }
  using saltus::OwnTerm;
  OwnTerm drag{.name = "drag", .at = OwnTerm::At::kEachStep, .states = {0}, .with_length = true};
  drag.function = std::make_shared<ceres::AutoDiffCostFunction<Drag, 2, 4, 1>>(new Drag);
  OwnTerm slow{.name = "slow", .role = OwnTerm::Role::kInequality, .states = {1}};
  slow.function = std::make_shared<ceres::AutoDiffCostFunction<SlowEnough, 1, 4>>(new SlowEnough);

  bool all_converged = true;
  const auto final_speed = [&](const std::vector<OwnTerm>& terms) {
    const saltus::SolveRequest request{.scene = std::get<saltus::Scene>(scene), .contact = "event", .terms = terms};
    const saltus::SolveReport report = saltus::Solve("ceres_phases", request, {});
    const saltus::ExactRun run =
        saltus::SimulateExactly(request.scene, report.initial_state, report.control, report.durations);
    all_converged = all_converged && report.termination == saltus::Termination::kConverged;
    const double speed = std::hypot(run.end[6], run.end[7]);
    std::cout << terms.size() << " own terms: loss " << report.final_loss << ", the target ends at " << speed
              << " m/s, " << saltus::TerminationToString(report.termination) << " " << report.reason << '\n';
    return speed;
  };
  const double free = final_speed({drag}), bounded = final_speed({drag, slow});
  return all_converged && free > 1.01 * kFastest && std::abs(bounded - kFastest) < 1e-8 ? 0 : 1;
}
