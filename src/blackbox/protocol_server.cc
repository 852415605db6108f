#include "blackbox/protocol_server.h"

#include <glog/logging.h>

#include <cmath>
#include <variant>

#include "saltus/scene/materials.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"

namespace saltus {
namespace {

constexpr int kNumbers = 4;  // of a disc

double Number(const ProtocolJson& question, const char* key) {
  const auto found = question.find(key);
  if (found == question.end() || !found->is_number() || !(found->get<double>() > 0)) {
    throw ProtocolError("expected a positive number as \"" + std::string(key) + "\"");
  }
  return found->get<double>();
}

// Returns position and velocity of each disc, without rotation that only the model has.
std::vector<double> Plain(const std::vector<double>& state, int body_size) {
  std::vector<double> plain;
  for (std::size_t i = 0; i < state.size(); i += body_size) {
    plain.insert(plain.end(), state.begin() + i, state.begin() + i + kNumbers);
  }
  return plain;
}

std::vector<double> StateAt(const Simulator& simulator, int k) {
  std::vector<double> state(simulator.state_size());
  simulator.GetState(k, state);
  return Plain(state, simulator.body_size());
}

// Returns the derivatives of the last rollout by parameters of the scene, by name.
ProtocolJson ParameterDerivativesToJson(Simulator* simulator, const std::vector<double>& cotangent) {
  Sensitivity gradient;
  simulator->Adjoint(cotangent, /*with_parameters=*/true, &gradient);
  const ParameterGradient& by = gradient.parameters;
  ProtocolJson named = {
      {"stiffness", by.stiffness}, {"damping", by.damping}, {"gravity.x", by.gravity[0]}, {"gravity.y", by.gravity[1]}};
  const Scene& scene = simulator->scene();
  for (const int pair : PairsInUse(scene)) {
    for (const auto kind : {SceneParameter::Kind::kRestitution, SceneParameter::Kind::kFriction}) {
      const SceneParameter parameter{kind, -1, pair};
      named[NameOf(parameter, scene)] = ContactDerivative(parameter, by);
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].fixed) named["mass." + scene.bodies[i].name] = by.mass[i];
  }
  for (std::size_t i = 0; i < by.design.size(); ++i) named[NameOf(scene.design[i].parameter, scene)] = by.design[i];
  return named;
}

ProtocolJson Wrong(const std::string& why) { return {{"error", why}}; }

}  // namespace

ProtocolServer::ProtocolServer(const Contact& contact, Precision precision, const ServerCapabilities& offer)
    : contact_(contact),
      precision_(precision),
      offer_(offer),
      grid_steps_(CHECK_NOTNULL(FindContactModel(contact))->grid_steps) {}

std::string ProtocolServer::ComputeAnswer(const std::string& line) {
  const ProtocolJson request = ProtocolJson::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!request.is_object()) return Wrong("found " + Excerpt(line) + ", expected a JSON object").dump();
  ProtocolJson answer = ProtocolJson::object();
  if (request.contains("id")) answer["id"] = request["id"];
  try {
    if (request.contains("scene")) {
      answer.update(Greet(request["scene"]));
    } else if (!scene_) {
      answer.update(Wrong("expected \"scene\" before anything else"));
    } else if (request.contains("simulate")) {
      answer.update(Simulate(request["simulate"], /*with_gradient=*/false));
    } else if (offer_.gradient && request.contains("gradient")) {
      answer.update(Simulate(request["gradient"], /*with_gradient=*/true));
    } else if (offer_.step && request.contains("step")) {
      answer.update(TakeStep(request["step"]));
    } else {
      answer.update(Wrong("found " + Excerpt(line) + ", expected \"simulate\" or what was offered"));
    }
  } catch (const ProtocolError& error) {
    answer.update(Wrong(error.what()));
  }
  return answer.dump();
}

ProtocolJson ProtocolServer::Greet(const ProtocolJson& scene) {
  std::variant<Scene, SceneFileError> read = ParseScene(scene.dump(), "scene");
  if (const auto* error = std::get_if<SceneFileError>(&read)) return Wrong(error->ToString());
  scene_ = std::get<Scene>(std::move(read));
  simulator_ = nullptr;
  ProtocolJson greeting = {{"name", "saltus " + contact_.name()}, {"can", ProtocolJson::array()}};
  if (offer_.gradient) greeting["can"].push_back("gradient");
  if (offer_.step) greeting["can"].push_back("step");
  if (offer_.states) greeting["can"].push_back("states");
  if (grid_steps_ > 1) greeting["grid_steps"] = grid_steps_;
  Scene asked = *scene_;
  asked.steps = grid_steps_;  // each question has its own
  if (const std::string why = ReasonNotApplicable(contact_, asked); !why.empty()) greeting["not_applicable"] = why;
  if (asked.Spins()) greeting["not_applicable"] = "discs that spin: the protocol has no angles";
  return greeting;
}

Simulator& ProtocolServer::SimulatorOf(int steps, double duration) {
  if (simulator_ != nullptr && simulated_ == std::pair(steps, duration)) return *simulator_;
  Scene scene = *scene_;
  scene.steps = steps;
  scene.duration = duration;
  if (const std::string why = ReasonNotApplicable(contact_, scene); !why.empty()) throw ProtocolError(why);
  if (scene.Spins()) throw ProtocolError("discs that spin: the protocol has no angles");
  simulator_ = MakeSimulator(contact_, scene, precision_);
  simulated_ = {steps, duration};
  return *simulator_;
}

std::vector<double> ProtocolServer::OwnControl(const ProtocolJson& question, int steps) const {
  const std::size_t width = scene_->control_width();
  if (width == 0) return {};
  const auto rows = question.find("control");
  const bool one = rows != question.end() && rows->is_array() && rows->size() == 1;
  const std::size_t count = one ? 1 : steps;
  const std::vector<double> given = NumbersAt(question, "control", {count, width / 2, 2});
  std::vector<double> own(steps / grid_steps_ * width, 0.0);
  for (std::size_t i = 0; i < steps * width; ++i) {
    own[i / width / grid_steps_ * width + i % width] += given[one ? i % width : i] / grid_steps_;
  }
  return own;
}

ProtocolJson ProtocolServer::Simulate(const ProtocolJson& question, bool with_gradient) {
  const double asked = Number(question, "steps");
  if (asked != std::floor(asked) || asked > kMaxSteps) throw ProtocolError("expected a whole number of \"steps\"");
  const int steps = static_cast<int>(asked);
  Simulator& simulator = SimulatorOf(steps, Number(question, "duration"));
  const std::size_t discs = simulator.num_bodies();
  const std::vector<double> initial = NumbersAt(question, "initial", {discs, kNumbers});
  const std::vector<double> control = OwnControl(question, steps);
  if (!simulator.Rollout(initial, control)) throw ProtocolError(simulator.FailureReason());
  const int K = simulator.num_steps();
  ProtocolJson answer = {{"final", RowsToJson(StateAt(simulator, K), kNumbers)}};
  if (!with_gradient && offer_.states && question.value("states", true)) {
    ProtocolJson states = ProtocolJson::array();
    for (int k = 0; k <= K; ++k) states.push_back(RowsToJson(StateAt(simulator, k), kNumbers));
    answer["states"] = std::move(states);
  }
  if (!with_gradient) return answer;

  const std::vector<double> final_cotangent = NumbersAt(question, "of_final", {discs, kNumbers});
  std::vector<double> cotangent(simulator.state_size(), 0.0);
  for (std::size_t i = 0; i < final_cotangent.size(); ++i) {
    cotangent[i / kNumbers * simulator.body_size() + i % kNumbers] = final_cotangent[i];
  }
  Sensitivity gradient;
  simulator.Adjoint(cotangent, /*with_parameters=*/false, &gradient);
  std::vector<double> by_control;
  const std::size_t width = scene_->control_width();
  for (std::size_t i = 0; i < steps * width; ++i) {
    by_control.push_back(gradient.control[i / width / grid_steps_ * width + i % width] / grid_steps_);
  }
  answer["initial"] = RowsToJson(gradient.initial, kNumbers);
  answer["control"] = ControlRowsToJson(by_control, scene_->num_controlled());
  if (question.value("parameters", false)) answer["parameters"] = ParameterDerivativesToJson(&simulator, cotangent);
  return answer;
}

ProtocolJson ProtocolServer::TakeStep(const ProtocolJson& question) {
  const Simulator& simulator = SimulatorOf(grid_steps_, Number(question, "h"));
  const std::size_t discs = simulator.num_bodies();
  const std::vector<double> initial = NumbersAt(question, "state", {discs, kNumbers});
  const std::vector<double> force = NumbersAt(question, "force", {discs, 2});
  std::vector<double> state(simulator.state_size()), next(state.size());
  simulator.ExpandInitial(initial, state);
  simulator.Step(state, force, next);
  for (const double value : next) {
    if (!std::isfinite(value)) throw ProtocolError("the state after the step is not finite");
  }
  return {{"state", RowsToJson(Plain(next, simulator.body_size()), kNumbers)}};
}

}  // namespace saltus
