#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "blackbox/session.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {
namespace {

constexpr std::size_t kMostSessions = 3;
constexpr std::size_t kShortLine = 1 << 20, kDigits = 40;  // characters of a line, and of a number

// Returns the scene without the data that each question states again.
Scene RemoveMotion(Scene scene) {
  scene.name = "scene";
  scene.duration = scene.steps = 1;
  for (Body& body : scene.bodies) {
    if (!body.fixed) body.position = body.velocity = Vec2d::Zero();
  }
  std::fill(scene.control.initial.begin(), scene.control.initial.end(), Vec2d::Zero());
  scene.objective = {};
  scene.optimize = Optimize::kNone;
  scene.free.clear();
  return scene;
}

// Returns the step of a motion from a state in which `first` steps of the grid have passed.
BlackBoxRequest StepOf(const Scene& scene, const BlackBoxRequest& motion, int first, int steps,
                       std::vector<double> state) {
  std::vector<double> forces(2 * scene.num_bodies());
  const std::size_t width = scene.control_width(), row = first * width;
  for (std::size_t i = 0; i < width && row + i < motion.control.size(); ++i) {
    forces[2 * scene.control.bodies[i / 2] + i % 2] = motion.control[row + i];
  }
  return {BlackBoxRequest::Kind::kStep,
          steps,
          motion.duration * steps / motion.steps,
          std::move(state),
          std::move(forces),
          {}};
}

// Returns the request of a question, whose answer becomes `answer`. A command that knows single steps only is asked for
// one after the other.
Session::Request RequestOf(const Scene& scene, const BlackBoxRequest& question, const BlackBoxTraits& traits,
                           BlackBoxAnswer* answer) {
  const std::size_t steps = question.steps + 1;
  Session::Request request{
      Describe(question), {}, kShortLine + kDigits * steps * (4 * scene.num_bodies() + scene.control_width()), nullptr};
  if (traits.simulate || question.kind == BlackBoxRequest::Kind::kStep) {
    request.asked = RequestToJson(scene, question, traits);
    request.take = [&scene, &question, &traits, answer](const ProtocolJson& json, ProtocolJson*) {
      *answer = ParseAnswer(json, scene, question, traits);
      return false;
    };
    return request;
  }
  const auto step_from = [&scene, &question, &traits](int k, std::vector<double> state) {
    return StepOf(scene, question, k * traits.grid_steps, traits.grid_steps, std::move(state));
  };
  request.asked = RequestToJson(scene, step_from(0, question.initial), traits);
  request.take = [=, &scene, &question, &traits, k = 0](const ProtocolJson& json, ProtocolJson* asked) mutable {
    const BlackBoxAnswer after = ParseAnswer(json, scene, step_from(0, {}), traits);
    if (question.states && k == 0) answer->states = question.initial;
    if (question.states) answer->states.insert(answer->states.end(), after.final.begin(), after.final.end());
    answer->error = after.error;
    answer->final = after.final;
    if (++k * traits.grid_steps >= question.steps || !after.error.empty()) return false;
    *asked = RequestToJson(scene, step_from(k, after.final), traits);
    return true;
  };
  return request;
}

}  // namespace

CommandBox::CommandBox(CommandOptions options) : options_(std::move(options)) {}

CommandBox::~CommandBox() = default;

Session* CommandBox::SessionOf(const Scene& scene) {
  const Scene still = RemoveMotion(scene);
  const auto known = std::ranges::find(sessions_, still, &std::pair<Scene, Session>::first);
  if (known != sessions_.end()) {
    sessions_.splice(sessions_.end(), sessions_, known);
  } else if (broken_.empty()) {
    if (sessions_.size() == kMostSessions) sessions_.pop_front();
    sessions_.emplace_back(
        std::piecewise_construct, std::forward_as_tuple(still), std::forward_as_tuple(HelloOf(scene), options_));
    broken_ = sessions_.back().second.broken();
  }
  if (!broken_.empty()) sessions_.clear();
  return broken_.empty() ? &sessions_.back().second : nullptr;
}

BlackBoxTraits CommandBox::Describe(const Scene& scene) {
  const std::lock_guard lock(mutex_);
  if (const Session* session = SessionOf(scene)) return session->traits();
  BlackBoxTraits traits;
  traits.error = broken_;
  return traits;
}

std::vector<BlackBoxAnswer> CommandBox::Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& questions,
                                                 const StopRequest& stop) {
  const std::lock_guard lock(mutex_);
  std::vector<BlackBoxAnswer> answers(questions.size());
  std::string failure;
  if (Session* session = SessionOf(scene)) {
    std::vector<Session::Request> requests;
    for (std::size_t i = 0; i < questions.size(); ++i) {
      requests.push_back(RequestOf(scene, questions[i], session->traits(), &answers[i]));
    }
    if (!session->Evaluate(std::move(requests), stop)) broken_ = session->broken();
    if (!broken_.empty()) sessions_.clear();
    failure = kStopped;
  }
  if (!broken_.empty()) failure = broken_;
  for (BlackBoxAnswer& answer : answers) {
    if (answer.final.empty() && answer.error.empty()) answer.error = failure;
  }
  return answers;
}

namespace {

constexpr std::size_t kMostCharacters = 1 << 20;  // of an answer

}  // namespace

CommandScheme::CommandScheme(const HybridSystem& system, CommandOptions options, const ProtocolJson& scene)
    : system_(system), name_(options.name), session_(HelloOf(system, scene), options) {}

int CommandScheme::Evaluate(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  *error = session_.traits().not_applicable;
  if (error->empty()) *error = session_.traits().error;
  if (!error->empty()) return -1;
  int mode = -1;
  const auto take = [&](const ProtocolJson& reply, ProtocolJson*) {
    *error = ErrorIn(reply);
    if (!error->empty()) return false;
    const ProtocolJson name = reply.value("mode", ProtocolJson());
    for (mode = 0; mode < system_.num_modes() && name != system_.ModeName(mode);) ++mode;
    if (mode == system_.num_modes()) throw ProtocolError("found mode " + name.dump() + ", which does not exist");
    const std::size_t size = system_.state_size(mode),
                      columns = system_.state_size(step.mode) + system_.num_controls() + system_.num_parameters();
    const std::vector<double> state = NumbersAt(reply, "state", {size});
    std::ranges::copy(state, next);
    for (const double number : state) is_float32_ = is_float32_ && number == static_cast<float>(number);
    if (jacobian != nullptr) std::ranges::copy(NumbersAt(reply, "jacobian", {size, columns}), jacobian);
    knows_precision_ = true;
    return false;
  };
  session_.Evaluate({{"step", StepToJson(system_, step, jacobian != nullptr), kMostCharacters, take}});
  if (!session_.broken().empty()) *error = session_.broken();
  return error->empty() ? mode : -1;
}

int CommandScheme::Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  if (jacobian == nullptr || HasJacobian()) return Evaluate(step, next, jacobian, error);
  const StepFunction ask = [this](const SchemeStep& at, double* after, std::string* why) {
    return Evaluate(at, after, nullptr, why);
  };
  if (!knows_precision_ && Evaluate(step, next, nullptr, error) < 0) return -1;
  const double precision = is_float32_ ? std::numeric_limits<float>::epsilon() : std::numeric_limits<double>::epsilon();
  return DifferenceStep(system_, step, ask, next, jacobian, error, precision);
}

}  // namespace saltus
