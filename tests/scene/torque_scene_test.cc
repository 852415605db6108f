// Scene files whose controls have torques: read, written, in other units, and what is wrong with them.
#include <gmock/gmock.h>

#include <string>
#include <variant>

#include "saltus/control/control_rows.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/simulator.h"
#include "scene/units.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::string Text(const std::string& control) {
  return "name: turned\nduration: 1\nsteps: 2\nbodies:\n"
         "  - {name: a, radius: 0.5, mass: 1, position: [0, 0]}\n"
         "  - {name: b, radius: 0.25, mass: 2, position: [2, 0], inertia: solid}\n"
         "  - {name: c, radius: 0.5, mass: 2, position: [4, 0], inertia: 0.125}\n"
         "control: {" +
         control +
         "}\nobjective: {terminal: [{body: c, quantity: angle, target: 1}], effort: 0.5}\noptimize: control\n";
}

constexpr char kControl[] =
    "bodies: [c, a, b], torque: [b, c], initial: [[1, 2, 0.75], [3, 4], [5, 6, -0.5]], max_torque: [0.5, 2]";

Scene SceneOf(const std::string& text) {
  const auto parsed = ParseScene(text, "turned.yaml");
  if (const auto* error = std::get_if<SceneFileError>(&parsed)) {
    ADD_FAILURE() << error->ToString();
    return {};
  }
  return std::get<Scene>(parsed);
}

SceneFileError ErrorOf(const std::string& control) {
  const auto parsed = ParseScene(Text(control), "turned.yaml");
  if (const auto* error = std::get_if<SceneFileError>(&parsed)) return *error;
  ADD_FAILURE() << "no error";
  return {};
}

TEST(TorqueScene, IsReadAndWritten) {
  const Scene scene = SceneOf(Text(kControl));
  EXPECT_THAT(scene.control.torque_bodies, ElementsAre(1, 2));
  EXPECT_THAT(scene.control.initial_torque, ElementsAre(-0.5, 0.75));
  EXPECT_THAT(scene.control.max_torque, ElementsAre(0.5, 2));
  EXPECT_EQ(scene.control.initial[0], Vec2d(1, 2));
  EXPECT_EQ(scene.control_width(), 8);
  // Forces in the order of the bodies, then torque / radius in the order of the torques.
  EXPECT_THAT(InitialControl(scene, 1), ElementsAre(1, 2, 3, 4, 5, 6, -2, 1.5));
  EXPECT_EQ(SceneOf(WriteScene(scene)), scene);
  const Scene one = SceneOf(Text("bodies: [b, c], torque: [b, c], initial: [[0, 0, 1], [0, 0, 2]], max_torque: 3"));
  EXPECT_THAT(one.control.max_torque, ElementsAre(3, 3));
}

TEST(TorqueScene, RowsHaveThreeColumns) {
  const Scene scene = SceneOf(Text(kControl));
  const std::vector<double> control = InitialControl(scene, 2), rows = RowsOfControl(scene, control);
  EXPECT_EQ(ControlColumns(scene), 3);
  EXPECT_THAT(std::vector<double>(rows.begin(), rows.begin() + 9), ElementsAre(1, 2, 0.75, 3, 4, 0, 5, 6, -0.5));
  EXPECT_EQ(rows.size(), 18u);
  EXPECT_EQ(ControlOfRows(scene, rows), control);
  // d/dtorque = d/d(torque / radius) / radius.
  EXPECT_THAT(RowsOfGradient(scene, std::vector<double>{1, 2, 3, 4, 5, 6, 7, 8}),
              ElementsAre(1, 2, 16, 3, 4, 0, 5, 6, 28));
  EXPECT_EQ(ValidateControlRows(scene, rows), "");
  std::vector<double> wrong = rows;
  wrong[9 + 5] = 1;
  EXPECT_EQ(ValidateControlRows(scene, wrong), "found a torque on a in interval 1, expected 0: it is not turned");
  wrong.pop_back();
  EXPECT_THAT(ValidateControlRows(scene, wrong), HasSubstr("expected a multiple of 9"));
}

// In any units it is the same motion and the same loss.
TEST(TorqueScene, HasUnits) {
  const Scene scene = SceneOf(Text(kControl));
  Units units;
  units.length = 8;
  units.time = 0.25;
  units.mass = 4;
  units.loss = 2;
  const Scene other = ToUnits(scene, units);
  // N m = kg m^2 / s^2.
  EXPECT_EQ(other.control.initial_torque[1], 0.75 * 0.25 * 0.25 / (4 * 8 * 8));
  EXPECT_EQ(other.control.max_torque[0], 0.5 * 0.25 * 0.25 / (4 * 8 * 8));
  EXPECT_EQ(ToUnits(other, {}), scene);
}

TEST(TorqueScene, SaysWhatIsWrong) {
  struct Case {
    const char* control;
    const char* key;
    const char* message;
  };
  const Case cases[] = {
      {"bodies: [a, b], torque: [a], initial: [[0, 0, 0], [0, 0]]",
       "control.torque[0]",
       "found a, which has no inertia"},
      {"bodies: [a], torque: [b], initial: [[0, 0]]", "control.torque[0]", "found b, expected one of control.bodies"},
      {"bodies: [b], torque: [b, b], initial: [[0, 0, 0]]", "control.torque[1]", "found b twice"},
      {"bodies: [b], torque: [d], initial: [[0, 0, 0]]", "control.torque[0]", "the name of a body"},
      {"bodies: [b], torque: b, initial: [[0, 0, 0]]", "control.torque", "a list"},
      {"bodies: [b], torque: [b], initial: [[0, 0]]", "control.initial[0]", "[x, y, torque]"},
      {"bodies: [b], initial: [[0, 0, 1]]", "control.initial[0]", "a vector [x, y]"},
      {"bodies: [b], torque: [b], initial: [[0, 0, 1]], max_torque: 0", "control.max_torque[0]", "a positive number"},
      {"bodies: [b], torque: [b], initial: [[0, 0, 1]], max_torque: [1, 2]",
       "control.max_torque",
       "found 2 bounds, expected one number, or one for each of the 1 bodies in control.torque"},
      {"bodies: [b], torque: [b], initial: [[0, 0, 1e30]]", "control.initial[0]", "magnitude at most 1e24"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.control);
    const SceneFileError error = ErrorOf(c.control);
    EXPECT_EQ(error.key, c.key);
    EXPECT_EQ(error.line, 8);
    EXPECT_THAT(error.message, HasSubstr(c.message));
  }
}

}  // namespace
}  // namespace saltus
