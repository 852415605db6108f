// The report of a run that had to look for a motion that meets its constraints at all.
#include <gtest/gtest.h>

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

TEST(RestoredMotion, HasTheLossOfItsExactSimulation) {
  const Scene point = AirHockey(
      "    - {body: puck, quantity: position, target: [2.0, 0.0], hard: true}\n"
      "    - {body: striker, quantity: velocity, target: [0, 0], weight: 0.01}");
  const Scene scene = AirHockey(
      "    - {body: puck, quantity: position, min: [2, -0.15], max: [null, 0.15]}\n"
      "    - {body: striker, quantity: velocity, target: [0, 0], weight: 1.0e-9}\n"
      "  limits:\n"
      "    - {body: striker, speed: {max: 0.3}, at: end}");
  const SolveReport first = Solve("ceres_phases", {.scene = point, .contact = "event"}, {});
  for (const char* along : {"striker-puck", "striker-puck,puck-top"}) {
    SolverOptions options{.guess = ControlGuess{first.solution.control, first.solution.durations}};
    options.sequences.search = false;
    ASSERT_EQ(ParseContactSequence(scene, along, &options.sequences.given.emplace()), "");
    const SolveReport report = Solve("ceres_phases", {.scene = scene, .contact = "event"}, options);
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
