#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "audit/gradient/step_study.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kWidest = 0.1;  // width of differences, in grid widths (width_sweep.h)
constexpr int kMostDiscs = 16;   // of a scene whose parameters are compared

// Returns the distance that discs move in a step, m.
double LengthOfStep(const Scene& scene, const Simulator& simulator, int most_states = 0) {
  double smallest_radius = scene.bodies[0].radius;
  for (const Body& body : scene.bodies) smallest_radius = std::min(smallest_radius, body.radius);
  return std::max(LargestSpeed(simulator, most_states) * simulator.step(), 1e-3 * smallest_radius);
}

// Returns the size of a small change of a parameter; `length` is the distance that discs move in a step.
double ScaleOf(const SceneParameter& parameter, const Scene& scene, double length) {
  using Kind = SceneParameter::Kind;
  const double value = std::abs(ValueOf(parameter, scene));
  switch (parameter.kind) {
    case Kind::kMass:
    case Kind::kStiffness:
      return value > 0 ? value : 1.0;
    case Kind::kDamping:
      return value > 0 ? value : std::max(1.0, std::sqrt(scene.contact.stiffness));
    case Kind::kGravity:
      return length / (scene.duration * scene.duration);
    case Kind::kRadius:
    case Kind::kPosition:
    case Kind::kPlaneOffset:
    case Kind::kSegmentOffset:
      return length;
    default:
      return 1;
  }
}

}  // namespace

GradientCheck CheckGradient(const Contact& contact, const Scene& scene, const StopRequest& stop, int threads,
                            int most_states) {
  if (!ReasonNotApplicable(contact, scene).empty()) return {};
  struct Loss {
    std::unique_ptr<SingleShooting> shooting;
    std::optional<LossAtGuess> at_guess;
  };
  std::vector<std::array<Loss, 2>> losses(threads);  // by state and by control
  const auto loss_of = [&](int thread, Quantity quantity) -> const LossAtGuess& {
    Loss& loss = losses[thread][quantity == Quantity::kControl ? 1 : 0];
    if (loss.shooting == nullptr) {
      loss.shooting = ShootingBy(quantity, contact, scene, stop);
      loss.at_guess.emplace(loss.shooting.get());
    }
    return *loss.at_guess;
  };
  if (!loss_of(0, Quantity::kPosition).ok) return {};
  const Simulator& simulator = losses[0][0].shooting->simulator();
  const double length = LengthOfStep(scene, simulator, most_states);
  return CompareAlongSums(VariablesOf(scene, length, simulator.num_steps()), threads, loss_of);
}

std::unique_ptr<SingleShooting> ShootingBy(Quantity quantity, const Contact& contact, const Scene& scene,
                                           const StopRequest& stop) {
  using Variables = SingleShooting::Variables;
  const bool control = quantity == Quantity::kControl;
  Scene controlled = scene;
  if (control) controlled.optimize = Optimize::kControl;
  auto shooting = std::make_unique<SingleShooting>(MakeSimulator(contact, controlled, Precision::kDouble),
                                                   control ? Variables::kOptimized : Variables::kInitialState);
  shooting->set_stop(stop);
  return shooting;
}

std::vector<SweptVariable> VariablesOf(const Scene& scene, double length, int steps) {
  std::vector<SweptVariable> variables;
  const double T = scene.duration;
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity, Quantity::kControl}) {
    const bool position = quantity == Quantity::kPosition, control = quantity == Quantity::kControl;
    const std::vector<std::string> names = EntryNames(scene, quantity, 1);
    const int width = static_cast<int>(names.size());
    for (int i = 0; i < width; ++i) {
      SweptVariable& variable = variables.emplace_back();
      variable = {.quantity = quantity, .entry = names[i], .first = static_cast<int>(variables.size()) - 1};
      variable.grid_width = position ? length : length / T;
      if (!control) continue;
      variable.entry.erase(variable.entry.find("[0]"), 3);  // a force in all steps is that of the only interval
      variable.first = i;
      variable.count = steps;
      variable.stride = width;
      const int turned = i - 2 * scene.num_controlled();
      const Body& body = scene.bodies[turned < 0 ? scene.control.bodies[i / 2] : scene.control.torque_bodies[turned]];
      const double mass = turned < 0 ? body.mass : body.MomentOfInertia() / (body.radius * body.radius);  // of the rim
      variable.grid_width = 2 * length * mass / (T * T);
    }
  }
  return variables;
}

std::vector<std::string> ParametersToCompare(const Scene& scene) {
  using Kind = SceneParameter::Kind;
  if (scene.num_bodies() > kMostDiscs) return {};
  std::vector<std::string> names;
  const std::vector<int> pairs = PairsInUse(scene);
  for (const int pair : pairs) names.push_back(NameOf({Kind::kRestitution, -1, pair}, scene));
  names.insert(names.end(), {"stiffness", "damping", "gravity"});
  // At zero friction the loss has only a right derivative with respect to friction.
  for (const int pair : pairs) {
    const SceneParameter friction{Kind::kFriction, -1, pair};
    if (ValueOf(friction, scene) > 0) names.push_back(NameOf(friction, scene));
  }
  for (const Body& body : scene.bodies) {
    if (!body.fixed) names.push_back("mass." + body.name);
  }
  for (const DesignParameter& design : scene.design) names.push_back(NameOf(design.parameter, scene));
  return names;
}

std::vector<ParameterAudit> CompareParameters(const Contact& contact, const Scene& scene,
                                              const std::vector<std::string>& names, const StopRequest& stop) {
  std::vector<ParameterAudit> audits;
  Scene designed = scene;
  designed.optimize = Optimize::kNone;
  designed.design.clear();
  for (const std::string& name : names) {
    for (const SceneParameter& parameter : ParametersNamed(name, scene)) {
      if (!std::ranges::count(designed.design, DesignParameter{parameter})) designed.design.push_back({parameter});
    }
  }
  if (designed.design.empty() || !ReasonNotApplicable(contact, designed).empty()) return audits;
  const auto of_scene = [&](const Scene& other) {
    return ReasonNotApplicable(contact, other).empty() ? MakeSimulator(contact, other, Precision::kDouble) : nullptr;
  };
  SingleShooting shooting(
      MakeSimulator(contact, designed, Precision::kDouble), SingleShooting::Variables::kOptimized, of_scene);
  shooting.set_stop(stop);
  const LossAtGuess loss(&shooting);
  const std::size_t count = designed.design.size();
  if (!loss.ok || loss.gradient.size() != count) return audits;
  const double length = LengthOfStep(scene, shooting.simulator());
  for (std::size_t i = 0; i < count && !shooting.stopped(); ++i) {
    const SceneParameter& parameter = designed.design[i].parameter;
    std::vector<double> along(count, 0.0);
    along[i] = 1;
    const GradientCheck found = CompareAlong(loss, along, kWidest * ScaleOf(parameter, scene, length));
    ParameterAudit audit{NameOf(parameter, scene), found.gradient, std::nullopt};
    if (found.agreement != Agreement::kUndecided) audit.difference = found.difference;
    if (found.gradient == 0 && audit.difference.value_or(0) == 0) continue;
    if (found.agreement == Agreement::kAgrees) audit.verdict = Verdict::kRight;
    if (found.agreement == Agreement::kDiffers) {
      audit.verdict = found.gradient * found.difference < 0 ? Verdict::kWrongSign : Verdict::kWrong;
    }
    audits.push_back(std::move(audit));
  }
  return audits;
}

double LargestSpeed(const Simulator& simulator, int most_states) {
  double largest = 0;
  std::vector<double> x(simulator.state_size());
  const int steps = simulator.num_steps(), stride = most_states > 0 ? std::max(1, steps / most_states) : 1;
  for (int k = steps; k >= 0; k -= stride) {
    simulator.GetState(k, x);
    for (int i = 0; i < simulator.num_bodies(); ++i) {
      const double* v = &x[i * simulator.body_size() + 2];
      largest = std::max(largest, std::hypot(v[0], v[1]));
    }
  }
  return largest;
}

}  // namespace saltus
