// Scenes whose numbers are extreme: whatever is accepted runs, or says why it cannot.
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <string>
#include <vector>

#include "fuzz/targets.h"
#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"
#include "simulate/flight.h"

namespace saltus::fuzz {
namespace {

// With every key that has a number, some of them in two ways.
constexpr std::string_view kScenes[] = {
    R"(name: pushed
duration: 1
steps: 4
gravity: [0.5, -9.8]
bodies:
  - {name: a, radius: 0.1, mass: 1.5, inertia: solid, position: [-0.5, 1], velocity: [5, -5], angle: 0.5, angular_velocity: 20}
  - {name: b, radius: 0.2, mass: 2.5, inertia: 0.01, position: [0.5, 1], velocity: [0.1, 0.2]}
  - {name: post, radius: 0.1, fixed: true, position: [0.5, 2]}
planes:
  - {name: ground, point: [0, 0], normal: [0, 1]}
contact: {restitution: 0.9, friction: 0.1, stiffness: 1.0e4, damping: 10.0}
control: {bodies: [a, b], torque: [a], initial: [[1, 2, 0.5], [1, 1]], max: [30, 40], max_norm: 50, max_torque: 2}
objective:
  terminal:
    - {body: a, quantity: position, target: [-2, 1.5], weight: 1.0}
    - {body: a, quantity: velocity, component: x, weight: -1}
    - {body: b, quantity: position, target: [1, 1], hard: true}
    - {body: a, quantity: angular_velocity, target: 0.1, weight: 1.0e-3}
    - {body: a, quantity: angle, target: 0.1, weight: 1.0e-3}
  running:
    - {body: a, quantity: position, target: [[0, 1, 2], [0.5, 2, 3]], weight: 2}
  via:
    - {body: b, quantity: velocity, time: 0.5, target: [1, 2], weight: 3}
  effort: 0.01
  duration: {free: true, min: 0.75, max: 2, weight: 0.5}
optimize: control
)",
    R"(name: struck
duration: 1
steps: 4
bodies:
  - {name: a, radius: 0.1, mass: 1, position: [-1, 0.02]}
  - {name: b, radius: 0.1, mass: 1, position: [0, 0]}
control: {bodies: [a], initial: [[3, 0]]}
objective:
  terminal:
    - {body: b, quantity: position, target: [1, 0.5]}
  effort: 0.01
optimize: control
)",
    R"(name: walled
duration: 2
steps: 4
bodies:
  - {name: a, radius: 0.1, mass: 1, position: [0.5, 1], velocity: [3, -1]}
  - {name: b, radius: 0.2, mass: 2, position: [1.5, 1]}
segments:
  - {name: s, from: [3, 0.5], to: [3, 2]}
polygons:
  - {name: p, points: [[5, 1], [6, 1], [5.5, 2]], solid: inside}
arcs:
  - {name: r, center: [-2, 1], radius: 0.5, from: -1, to: 1}
pockets:
  - {name: h, position: [2, 3], radius: 0.25}
table: {friction: 0.1, gravity: 9.81}
contact: {restitution: 0.5, friction: 0.2}
objective:
  terminal:
    - {body: b, quantity: position, target: [2.5, 1.5], weight: 1.0}
optimize: velocity
free: [a]
)",
    R"(name: rolling
duration: 0.5
steps: 4
gravity: [0, -10]
bodies:
  - {name: ball, radius: 0.25, mass: 1, inertia: solid, position: [0, 0.25], velocity: [1, 0], angular_velocity: -2}
planes:
  - {name: ground, point: [0, 0], normal: [0.5, 1]}
  - {name: wall, point: [2, 0], normal: [-1, 0]}
contact: {restitution: 0, friction: 0.25}
objective:
  terminal:
    - {body: ball, quantity: velocity, target: [0, 0]}
optimize: none
)"};
constexpr std::string_view kSpecial[] = {"0", "-0.0", "1e308", "-1e308", "5e-324", "1e400", ".inf", ".nan", "1e72"};
constexpr int kMostChanges = 6, kMostSteps = 4, kMostImpacts = 50, kMostTouches = 200;
constexpr int kLargestExponent = 40;

struct Place {
  std::size_t at, length;
};

std::vector<Place> NumbersIn(std::string_view text) {
  constexpr std::string_view kBefore = " [", kIn = "+-.0123456789e";
  std::vector<Place> places;
  for (std::size_t i = 1; i < text.size(); ++i) {
    const bool digit = text[i] >= '0' && text[i] <= '9', sign = text[i] == '-' && text[i + 1] != ' ';
    if (kBefore.find(text[i - 1]) == std::string_view::npos || !(digit || sign)) continue;
    const std::size_t end = text.find_first_not_of(kIn, i);
    places.push_back({i, end - i});
    i = end;
  }
  return places;
}

// A number of any size out of two bytes.
std::string NumberOf(unsigned char mantissa, unsigned char exponent) {
  constexpr int kExponents = 2 * kLargestExponent + 1;
  if (exponent >= 3 * kExponents) return std::string(kSpecial[exponent % std::size(kSpecial)]);
  constexpr const char* kMantissas[] = {"1", "-1", "2.5", "-7.25", "9.99999"};
  return kMantissas[mantissa % std::size(kMantissas)] + std::string("e") +
         std::to_string(exponent % kExponents - kLargestExponent);
}

// The first byte chooses a scene, every three further ones a number in it and what takes its place.
std::string SceneOf(std::string_view bytes) {
  const auto byte = [&](std::size_t i) { return i < bytes.size() ? static_cast<unsigned char>(bytes[i]) : 0U; };
  const std::string_view scene = kScenes[byte(0) % std::size(kScenes)];
  const std::vector<Place> places = NumbersIn(scene);
  std::vector<std::string> numbers(places.size());
  for (std::size_t i = 1; i + 2 < bytes.size() && i < 3 * kMostChanges; i += 3) {
    numbers[byte(i) % numbers.size()] = NumberOf(byte(i + 1), byte(i + 2));
  }
  std::string text;
  std::size_t from = 0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    text += scene.substr(from, places[i].at - from);
    text += numbers[i].empty() ? scene.substr(places[i].at, places[i].length) : numbers[i];
    from = places[i].at + places[i].length;
  }
  return text + std::string(scene.substr(from));
}

bool AllFinite(std::span<const double> numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](double number) { return std::isfinite(number); });
}

void RunModel(const Contact& contact, const Scene& scene, Precision precision, std::span<const double> initial,
              std::span<const double> control) {
  const std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, precision);
  simulator->set_stop([&] { return simulator->touches().size() > kMostTouches; });
  if (!simulator->Rollout(initial, control)) {
    CHECK(simulator->stopped() || !simulator->FailureReason().empty()) << contact.name();
    return;
  }
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);
  CHECK(AllFinite(end)) << contact.name();
  Sensitivity sensitivity;
  simulator->Adjoint(std::vector<double>(end.size(), 1.0), /*with_parameters=*/true, &sensitivity);
}

void RunExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control) {
  const ExactRun run = SimulateUpTo(kMostImpacts, scene, initial, control);
  if (!run.ok) {
    CHECK(!run.reason.empty());
    return;
  }
  CHECK(AllFinite(run.end));
  if (scene.optimize != Optimize::kControl) return;
  const Certificate certificate = Certify(scene, initial, control);
  CHECK(certificate.verdict != Certificate::Verdict::kNotApplicable || !certificate.reason.empty());
}

}  // namespace

void RunsExtremes(std::string_view bytes) {
  const std::string text = SceneOf(bytes);
  const std::variant<Scene, SceneFileError> read = ParseScene(text, "input");
  if (const auto* error = std::get_if<SceneFileError>(&read)) {
    CHECK(!error->key.empty() && error->message.find("expected") != std::string::npos) << error->ToString();
    return;
  }
  Scene scene = std::get<Scene>(read);
  const std::variant<Scene, SceneFileError> again = ParseScene(WriteScene(scene), "output");
  CHECK(std::holds_alternative<Scene>(again) && std::get<Scene>(again) == scene) << text;
  scene.steps = std::min(scene.steps, kMostSteps);
  const Scene natural = ToNaturalUnits(scene);
  const std::optional<SceneError> error = ValidateStructure(natural);
  CHECK(!error) << error->ToString() << "\n" << text;
  for (const ModelTraits& model : AllContactModels()) {
    const std::string reason_not_applicable = ReasonNotApplicable(model.name, scene);
    CHECK_EQ(reason_not_applicable.empty(), ReasonNotApplicable(model.name, natural).empty())
        << model.name << ": " << reason_not_applicable;
    if (!reason_not_applicable.empty() || scene.steps % model.grid_steps != 0) continue;
    const std::vector<double> initial = InitialState(scene),
                              control = InitialControl(scene, scene.steps / model.grid_steps);
    for (const Precision precision : {Precision::kDouble, Precision::kFloat}) {
      RunModel(model.name, scene, precision, initial, control);
    }
  }
  RunExactly(scene, InitialState(scene), InitialControl(scene, scene.steps));
}

std::span<const Target> Targets() {
  static constexpr Target kTargets[] = {{"extremes", RunsExtremes}};
  return kTargets;
}

}  // namespace saltus::fuzz
