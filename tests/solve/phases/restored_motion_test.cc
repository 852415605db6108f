// The report of a run that had to look for a motion that meets its constraints at all.
#include <ceres/autodiff_cost_function.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <variant>

#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

// A striker is to send a puck past a post; `terminal` is what the scene itself asks for at the end.
Scene AirHockey(const std::string& terminal) {
  const std::string text = R"(
name: air_hockey
duration: 1.5
steps: 150
bodies:
  - {name: striker, radius: 0.08, mass: 0.3, position: [0.3, -0.2]}
  - {name: puck, radius: 0.05, mass: 0.1, position: [0.9, 0.1], velocity: [-0.3, -0.1]}
  - {name: post, radius: 0.12, fixed: true, position: [1.4, 0.0]}
planes:
  - {name: top, point: [0, 0.5], normal: [0, -1]}
  - {name: bottom, point: [0, -0.5], normal: [0, 1]}
  - {name: back, point: [0, 0], normal: [1, 0]}
contact: {restitution: 0.9}
control: {bodies: [striker], initial: [[1.0, 0.5]], max: 4.0}
objective:
  terminal:
)" + terminal + R"(
  effort: 0.01
  duration: {free: true, min: 0.3, max: 3, weight: 1.0}
no_contact: [[puck, post], [striker, post]]
optimize: control
)";
  return std::get<Scene>(ParseScene(text, "air_hockey"));
}

struct BehindTheLine {
  template <typename T>
  bool operator()(const T* x, T* r) const {
    r[0] = 2.0 - x[0];
    r[1] = x[1] - 0.15;
    r[2] = -0.15 - x[1];
    return true;
  }
};
struct Slow {
  template <typename T>
  bool operator()(const T* x, T* r) const {
    r[0] = x[2] * x[2] + x[3] * x[3] - 0.09;
    return true;
  }
};

TEST(RestoredMotion, HasTheLossOfItsExactSimulation) {
  const Scene point = AirHockey(
      "    - {body: puck, quantity: position, target: [2.0, 0.0], hard: true}\n"
      "    - {body: striker, quantity: velocity, target: [0, 0], weight: 0.01}");
  const Scene scene = AirHockey("    - {body: striker, quantity: velocity, target: [0, 0], weight: 1.0e-9}");
  const SolveReport first = Solve("ceres_phases", {.scene = point, .contact = "event"}, {});
  UserTerm goal{.name = "goal", .role = UserTerm::Role::kInequality, .states = {1}};
  goal.function = std::make_shared<ceres::AutoDiffCostFunction<BehindTheLine, 3, 4>>(new BehindTheLine);
  UserTerm slow{.name = "slow", .role = UserTerm::Role::kInequality, .states = {0}};
  slow.function = std::make_shared<ceres::AutoDiffCostFunction<Slow, 1, 4>>(new Slow);
  for (const char* along : {"striker-puck", "striker-puck,puck-top"}) {
    SolverOptions options{.guess = ControlGuess{first.solution.control, first.solution.durations}};
    options.sequences.search = false;
    ASSERT_EQ(ParseContactSequence(scene, along, &options.sequences.given.emplace()), "");
    const SolveReport report =
        Solve("ceres_phases", {.scene = scene, .contact = "event", .terms = {goal, slow}}, options);
    const ExactRun run =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(run.ok) << run.reason;
    EXPECT_NEAR(report.solution.loss, run.loss, 1e-9) << along << ": " << report.reason;
    if (report.reason.find("is not physical") == std::string::npos) continue;
    EXPECT_NE(report.reason.find(ContactSequenceToString(scene, run.contacts)), std::string::npos) << report.reason;
  }
}

}  // namespace
}  // namespace saltus
