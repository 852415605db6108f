// Makes a simulator a command for `saltus_audit --simulate=COMMAND`: copy this file, write a World, call Serve.
//
// The protocol is JSON, one object a line, answers in the order of the requests. The first line brings the scene, each
// one after it asks for a simulation:
//   -> {"saltus": 1, "scene": {...}}
//   <- {"name": "...", "can": ["states"]}, with "not_applicable": "reason" if the simulator cannot take the scene
//   -> {"id": 1, "simulate": {"steps": 480, "duration": 1, "initial": [[px, py, vx, vy], ...], "control": [[[fx, fy],
//   ...], ...]}}
//   <- {"id": 1, "final": [[px, py, vx, vy], ...]}
// Boxes, and discs that turn, are those of a hybrid system (saltus_bodies), whose steps are asked for one by one:
//   -> {"saltus": 1, "hybrid": {...}, "scene": {...}}
//   -> {"id": 1, "step": {"mode": "ooo", "t": 0, "h": 0.01, "state": [q, v], "parameters": [restitution, friction,
//       gravity x, gravity y]}}
//   <- {"id": 1, "mode": "ooo", "state": [q, v]}
// with x, y and the angle of each body that moves in q, and their rates in v.
// A control has a row of forces a step (or one row for all steps), one force a controlled disc.
#pragma once

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace engines {

using Json = nlohmann::json;
using Vec2 = std::array<double, 2>;
using State = std::array<double, 4>;  // px py vx vy, in m and m/s

// A disc or, if it has no radius, a box.
struct Body {
  double radius = 0;  // m
  double mass = 1;    // kg
  bool fixed = false;
  Vec2 half{};         // m, half the width and the height of a box
  double inertia = 0;  // kg m^2; 0: it does not turn
  double angle = 0;    // rad, at the start
  double spin = 0;     // rad/s, at the start
  Vec2 position{};     // m, of a fixed one
};

// Discs stay on the side of `point` that `normal` points to.
struct Plane {
  Vec2 point{};
  Vec2 normal{};  // of length 1
};

struct Scene {
  Vec2 gravity{};  // m/s^2
  std::vector<Body> bodies;
  std::vector<Plane> planes;
  double restitution = 1;
  double friction = 0;
  std::vector<int> controlled;
  bool frictionless = false;  // of a hybrid system: whatever its parameters say
};

// A simulation at work.
class World {
 public:
  virtual ~World() = default;
  // A force in N on the centre of a body that is not fixed, in the next step only.
  virtual void Push(int body, double fx, double fy) = 0;
  // h: s.
  virtual void Step(double h) = 0;
  virtual State Get(int body) const = 0;
  // Angle and angular velocity, of worlds in which bodies turn.
  virtual Vec2 Turn(int) const { return {}; }
};

struct Simulator {
  std::string name;
  // A new world, with nothing left of an earlier one. h: s, the length of all of its steps.
  std::function<std::unique_ptr<World>(const Scene&, const std::vector<State>& initial, double h)> make;
  // Why the simulator cannot take a scene; empty if it can.
  std::function<std::string(const Scene&)> refusal = [](const Scene&) { return std::string(); };
  bool boxes = false;  // whether its worlds have boxes, and bodies that turn
};

// A scene that asks for what no Scene holds: the reason.
struct NotApplicable : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// What is not among `known` must be empty, 0 or false: else it may act on the motion.
inline void RefuseUnknown(const Json& object, const std::string& where, const std::vector<std::string>& known) {
  for (const auto& [key, value] : object.items()) {
    const bool nothing = value.is_null() || value == false || value == 0 || value == "" ||
                         ((value.is_array() || value.is_object()) && value.empty());
    if (!nothing && std::find(known.begin(), known.end(), key) == known.end()) {
      throw NotApplicable(where + ": this driver does not support \"" + key + "\"");
    }
  }
}

// `hybrid`: a scene of saltus_bodies.
inline Scene ReadScene(const Json& in, bool hybrid) {
  RefuseUnknown(in,
                "scene",
                {"name",
                 "duration",
                 "steps",
                 "gravity",
                 "bodies",
                 "planes",
                 "contact",
                 "control",
                 "objective",
                 "optimize",
                 "free",
                 "no_contact",
                 hybrid ? "frictionless" : "name"});
  Scene scene;
  scene.frictionless = hybrid && in.value("frictionless", false);
  scene.gravity = in.value("gravity", Vec2{});
  std::vector<std::string> names;
  for (const Json& body : in.at("bodies")) {
    std::vector<std::string> known = {"name", "radius", "mass", "fixed", "position", "velocity"};
    if (hybrid) known.insert(known.end(), {"box", "inertia", "angle"});
    RefuseUnknown(body, "a body", known);
    Body& added = scene.bodies.emplace_back();
    added.fixed = body.value("fixed", false);
    if (!added.fixed) added.mass = body.at("mass").get<double>();
    if (hybrid) {
      added.inertia = added.fixed ? 0 : body.at("inertia").get<double>();
      added.angle = body.at("angle").get<double>();
      added.position = body.at("position").get<Vec2>();
    }
    if (hybrid && body.contains("box")) {
      added.half = body["box"].get<Vec2>();
    } else {
      added.radius = body.at("radius").get<double>();
    }
    names.push_back(body.at("name").get<std::string>());
  }
  for (const Json& plane : in.value("planes", Json::array())) {
    RefuseUnknown(plane, "a plane", {"name", "point", "normal"});
    Vec2 normal = plane.at("normal").get<Vec2>();
    const double length = std::hypot(normal[0], normal[1]);
    scene.planes.push_back({plane.at("point").get<Vec2>(), {normal[0] / length, normal[1] / length}});
  }
  const Json contact = in.value("contact", Json::object());
  RefuseUnknown(contact, "contact", {"restitution", "friction", "stiffness", "damping"});
  scene.restitution = contact.value("restitution", 1.0);
  scene.friction = contact.value("friction", 0.0);
  if (in.contains("control") && in["control"].is_object()) {
    for (const std::string& name : in["control"].value("bodies", std::vector<std::string>())) {
      const auto found = std::find(names.begin(), names.end(), name);
      if (found == names.end()) throw std::runtime_error("control: no body is named " + name);
      scene.controlled.push_back(static_cast<int>(found - names.begin()));
    }
  }
  return scene;
}

// All states of the world; throws if one is not finite.
inline std::vector<State> States(const World& world, const Scene& scene, const std::vector<State>& initial) {
  std::vector<State> states = initial;
  for (std::size_t i = 0; i < states.size(); ++i) {
    if (scene.bodies[i].fixed) continue;
    states[i] = world.Get(static_cast<int>(i));
    for (const double number : states[i]) {
      if (!std::isfinite(number)) throw std::runtime_error("the state of body " + std::to_string(i) + " is not finite");
    }
  }
  return states;
}

// The answer to one "simulate", without its id.
inline Json Simulate(const Simulator& simulator, const Scene& scene, const Json& request) {
  const int steps = request.at("steps").get<int>();
  const double h = request.at("duration").get<double>() / steps;
  const auto initial = request.at("initial").get<std::vector<State>>();
  const auto control = request.value("control", std::vector<std::vector<Vec2>>());
  if (steps < 1 || !(h > 0)) throw std::runtime_error("steps and duration must be positive");
  if (initial.size() != scene.bodies.size()) {
    throw std::runtime_error("initial: expected " + std::to_string(scene.bodies.size()) + " rows, one a body");
  }
  const std::size_t rows = control.size();
  if (!scene.controlled.empty() && rows != 1 && rows != static_cast<std::size_t>(steps)) {
    throw std::runtime_error("control: expected 1 or " + std::to_string(steps) + " rows, not " + std::to_string(rows));
  }
  for (const auto& row : control) {
    if (row.size() != scene.controlled.size()) {
      throw std::runtime_error("control: expected " + std::to_string(scene.controlled.size()) + " forces a row");
    }
  }
  const bool all = request.value("states", false);
  const std::unique_ptr<World> world = simulator.make(scene, initial, h);
  Json answer = Json::object();
  if (all) answer["states"].push_back(initial);
  for (int k = 0; k < steps; ++k) {
    for (std::size_t c = 0; c < scene.controlled.size(); ++c) {
      const Vec2& force = control[rows == 1 ? 0 : static_cast<std::size_t>(k)][c];
      world->Push(scene.controlled[c], force[0], force[1]);
    }
    world->Step(h);
    if (all) answer["states"].push_back(States(*world, scene, initial));
  }
  answer["final"] = States(*world, scene, initial);
  return answer;
}

// The answer to one "step", without its id.
inline Json Step(const Simulator& simulator, Scene scene, const Json& step) {
  const auto before = step.at("state").get<std::vector<double>>(), p = step.at("parameters").get<std::vector<double>>();
  const std::size_t n = before.size() / 2;
  std::size_t moving = 0;
  for (const Body& body : scene.bodies) moving += body.fixed ? 0 : 1;
  if (n != 3 * moving || before.size() != 2 * n || p.size() != 4) throw std::runtime_error("a state of another size");
  scene.restitution = std::max(p[0], 0.0);
  scene.friction = scene.frictionless ? 0 : std::max(p[1], 0.0);
  scene.gravity = {p[2], p[3]};
  std::vector<State> initial;
  auto at = before.begin();
  for (Body& body : scene.bodies) {
    if (body.fixed) {
      initial.push_back({body.position[0], body.position[1], 0, 0});
      continue;
    }
    initial.push_back({at[0], at[1], at[n], at[n + 1]});
    body.angle = at[2];
    body.spin = at[n + 2];
    at += 3;
  }
  const double h = step.at("h").get<double>();
  const std::unique_ptr<World> world = simulator.make(scene, initial, h);
  world->Step(h);
  const std::vector<State> states = States(*world, scene, initial);
  std::vector<double> after;
  for (const bool of_rates : {false, true}) {
    for (std::size_t i = 0; i < states.size(); ++i) {
      if (scene.bodies[i].fixed) continue;
      const auto turn = world->Turn(static_cast<int>(i));
      after.insert(after.end(), {states[i][of_rates ? 2 : 0], states[i][of_rates ? 3 : 1], turn[of_rates ? 1 : 0]});
      // Some worlds have angles from -pi to pi only.
      const double jump = of_rates ? 0 : after.back() - scene.bodies[i].angle;
      if (std::abs(jump) > M_PI) after.back() -= 2 * M_PI * std::round(jump / (2 * M_PI));
    }
  }
  return {{"mode", step.at("mode")}, {"state", after}};
}

// The answer to one line. `scene` is that of the first line, once it has come.
inline Json Answer(const Simulator& simulator, const std::string& line, Scene& scene) {
  Json answer = Json::object();
  try {
    const Json request = Json::parse(line);
    if (request.contains("id")) answer["id"] = request["id"];
    if (request.contains("saltus")) {
      answer = {{"name", simulator.name}, {"can", {"states"}}};
      const bool hybrid = request.contains("hybrid");
      if (hybrid && !simulator.boxes) throw NotApplicable("this driver has discs that do not turn only");
      if (hybrid && !request.contains("scene")) throw NotApplicable("this driver has bodies only, in a \"scene\"");
      if (hybrid) answer.erase("can");
      scene = ReadScene(request.at("scene"), hybrid);
      const std::string refusal = simulator.refusal(scene);
      if (!refusal.empty()) throw NotApplicable(refusal);
    } else if (request.contains("simulate")) {
      answer.update(Simulate(simulator, scene, request["simulate"]));
    } else if (request.contains("step")) {
      answer.update(Step(simulator, scene, request["step"]));
    } else {
      throw std::runtime_error("expected \"saltus\", \"step\" or \"simulate\"");
    }
  } catch (const NotApplicable& reason) {
    answer["not_applicable"] = reason.what();
  } catch (const std::exception& error) {
    answer["error"] = error.what();
  }
  return answer;
}

// Answers standard input until it ends. Returns the exit code. What the simulator itself prints goes to standard error.
inline int Serve(const Simulator& simulator) {
  std::FILE* answers = fdopen(dup(STDOUT_FILENO), "w");
  if (!answers || dup2(STDERR_FILENO, STDOUT_FILENO) < 0) return 1;
  Scene scene;
  for (std::string line; std::getline(std::cin, line);) {
    const std::string answer = Answer(simulator, line, scene).dump() + "\n";
    if (std::fputs(answer.c_str(), answers) < 0 || std::fflush(answers) != 0) return 1;
  }
  return 0;
}

// Whether `name` is among the arguments of the program; any other is an error, of which it exits.
inline bool HasFlag(int argc, char** argv, const std::string& name) {
  bool found = false;
  for (int i = 1; i < argc; ++i) {
    if (argv[i] != name) {
      std::cerr << argv[0] << ": unknown argument " << argv[i] << "; there is " << name << "\n";
      std::exit(2);
    }
    found = true;
  }
  return found;
}

}  // namespace engines
