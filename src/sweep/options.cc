#include <glog/logging.h>

#include <algorithm>
#include <cstdio>
#include <limits>
#include <type_traits>
#include <variant>

#include "saltus/scene/scene_parameter.h"
#include "saltus/solve/hybrid_solver.h"
#include "scene/control_problems.h"
#include "sweep/study.h"

namespace saltus {
namespace {

// A number of a request that an option sets; whole numbers without a sign must not be negative.
using Place = std::variant<double*, int*, uint64_t*>;

struct NumberOption {
  const char* name;
  SweepOptionKind kind;
  Place (*find)(Request* request);
};

constexpr SweepOptionKind kReal = SweepOptionKind::kReal;
constexpr SweepOptionKind kInteger = SweepOptionKind::kInteger;

Surrogate& SurrogateOf(Request* request) {
  if (!request->options.surrogate) throw InputError("the numbers of a surrogate need --surrogate");
  return *request->options.surrogate;
}

FeedbackOptions& FeedbackOf(Request* request) {
  if (!request->feedback) throw InputError("the numbers of feedback need --feedback");
  return *request->feedback;
}

uint64_t NotNegative(const std::string& name, double value) {
  if (value < 0) throw InputError(name + " must not be negative");
  return static_cast<uint64_t>(value);
}

constexpr const char* kSearchMemory = "search_memory";  // MiB

constexpr NumberOption kNumbers[] = {
    {kSeedOption, kInteger, nullptr},  // makes the scene
    {"stiffness", kReal, [](Request* r) -> Place { return &r->scene.contact.stiffness; }},
    {"damping", kReal, [](Request* r) -> Place { return &r->scene.contact.damping; }},
    {"restitution", kReal, [](Request* r) -> Place { return &r->scene.contact.restitution; }},
    {"friction", kReal, [](Request* r) -> Place { return &r->scene.contact.friction; }},
    {"steps", kInteger, [](Request* r) -> Place { return &r->scene.steps; }},
    {"duration", kReal, [](Request* r) -> Place { return &r->scene.duration; }},
    {"gravity_x", kReal, [](Request* r) -> Place { return &r->scene.gravity[0]; }},
    {"gravity_y", kReal, [](Request* r) -> Place { return &r->scene.gravity[1]; }},
    {"effort", kReal, [](Request* r) -> Place { return &r->scene.objective.effort; }},
    {"learning_rate", kReal, [](Request* r) -> Place { return &r->options.descent.learning_rate; }},
    {"iterations", kInteger, [](Request* r) -> Place { return &r->options.limits.iterations; }},
    {"search_work", kReal, [](Request* r) -> Place { return &r->options.sequences.limits.work; }},
    {"search_seconds", kReal, [](Request* r) -> Place { return &r->options.sequences.limits.seconds; }},
    {kSearchMemory, kInteger, [](Request* r) -> Place { return &r->options.sequences.limits.memory; }},
    {"search_starts", kInteger, [](Request* r) -> Place { return &r->options.sequences.limits.starts; }},
    {"search_seed", kInteger, [](Request* r) -> Place { return &r->options.sequences.limits.seed; }},
    {"surrogate_sigma", kReal, [](Request* r) -> Place { return &SurrogateOf(r).sigma; }},
    {"surrogate_samples", kInteger, [](Request* r) -> Place { return &SurrogateOf(r).samples; }},
    {"surrogate_seed", kInteger, [](Request* r) -> Place { return &SurrogateOf(r).seed; }},
    {"surrogate_segments", kInteger, [](Request* r) -> Place { return &SurrogateOf(r).segments; }},
    {"feedback_scale", kReal, [](Request* r) -> Place { return &FeedbackOf(r).scale; }},
    {"feedback_samples", kInteger, [](Request* r) -> Place { return &FeedbackOf(r).samples; }},
    {"feedback_seed", kInteger, [](Request* r) -> Place { return &FeedbackOf(r).seed; }},
};

const NumberOption* FindNumber(const std::string& name) {
  const auto* found = std::ranges::find(kNumbers, name, &NumberOption::name);
  return found == std::end(kNumbers) ? nullptr : found;
}

void SetNumber(const NumberOption& option, double value, Request* request) {
  const std::string name = option.name;
  if (name == kSeedOption) {
    request->scene = ControlProblem(NotNegative(name, value));
    return ApplySceneFlags(&request->scene);
  }
  if (name.starts_with("feedback_")) NotNegative(name, value);
  const double unit = name == kSearchMemory ? 1 << 20 : 1;
  std::visit(
      [&]<typename T>(T* place) {
        if (std::is_unsigned_v<T>) NotNegative(name, value);
        *place = static_cast<T>(unit * value);
      },
      option.find(request));
}

// Returns the number of a body that "<body>.<field>" names, null if there is none. Names of bodies may have dots too,
// fields have none.
template <typename SceneOrConst>
auto* FindBodyNumber(const std::string& name, SceneOrConst& scene) {
  using Number = std::remove_reference_t<decltype((scene.bodies[0].mass))>;
  constexpr Number* kNone = nullptr;
  const size_t dot = name.rfind('.');
  const auto body = std::ranges::find(scene.bodies, name.substr(0, dot), &Body::name);
  if (dot == std::string::npos || body == scene.bodies.end()) return kNone;
  const auto index_in = [&](const std::vector<int>& bodies) {
    return std::ranges::find(bodies, static_cast<int>(body - scene.bodies.begin())) - bodies.begin();
  };
  const auto pushed = index_in(scene.control.bodies), turned = index_in(scene.control.torque_bodies);
  const std::string field = name.substr(dot + 1);
  if (field == "mass") return &body->mass;
  if (field == "radius") return &body->radius;
  for (const int j : {0, 1}) {
    const std::string axis = j == 0 ? "_x" : "_y";
    if (field == "position" + axis) return &body->position[j];
    if (field == "velocity" + axis) return &body->velocity[j];
    if (field == "force" + axis && pushed < std::ssize(scene.control.bodies)) return &scene.control.initial[pushed][j];
  }
  if (field == "torque" && turned < std::ssize(scene.control.torque_bodies))
    return &scene.control.initial_torque[turned];
  return kNone;
}

// Restitution or friction of a pair of materials, "restitution.rubber-steel", or the drag of a disc, "drag.ball".
std::optional<SceneParameter> FindParameter(const std::string& name, const Scene& scene) {
  const bool named = name.starts_with("restitution.") || name.starts_with("friction.") || name.starts_with("drag.");
  const std::vector<SceneParameter> found = named ? ParametersNamed(name, scene) : std::vector<SceneParameter>();
  return found.empty() ? std::nullopt : std::optional(found[0]);
}

bool IsWord(const std::string& name) { return name == "contact" || name == "solver" || name == "precision"; }

void SetWord(const std::string& name, const std::string& word, Request* request) {
  if (name == "contact") request->contacts = {word};
  if (name == "solver") request->solvers = {word};
  if (name == "precision") request->precision = word == "float" ? Precision::kFloat : Precision::kDouble;
}

std::optional<SweepProgram> kept_program;

std::optional<SweepOptionKind> FindProgramOption(const std::string& name) {
  const std::vector<std::string>& own = kept_program->names;
  const std::vector<std::string> all = SweepOptionNames();
  if (std::ranges::find(own, name) != own.end()) return kReal;
  if (std::ranges::find(all, name) == all.end()) return std::nullopt;
  return name == "solver" ? SweepOptionKind::kWord : FindNumber(name)->kind;
}

}  // namespace

double ToNumber(const SweepValue& value) {
  return value.is_number() ? value.get<double>() : std::numeric_limits<double>::quiet_NaN();
}

void KeepProgram(SweepProgram program) { kept_program = std::move(program); }

const SweepProgram* KeptProgram() { return kept_program ? &*kept_program : nullptr; }

Json RunProgram(const std::string& arguments, double seconds) {
  const std::string limit = seconds > 0 ? "timeout " + std::to_string(seconds) + " " : "";
  const std::string command = limit + kept_program->command + " " + arguments + " --json 2>&1";
  std::string text;
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) throw InputError("'" + command + "' cannot be started");
  char part[4096];
  for (size_t size; (size = fread(part, 1, sizeof part, pipe)) > 0;) text.append(part, size);
  pclose(pipe);
  // The program may write more than the document, on standard error.
  const size_t begin = text.find('{'), end = text.rfind('}');
  if (begin != std::string::npos && end != std::string::npos && begin < end) {
    Json document = Json::parse(text.substr(begin, end - begin + 1), nullptr, /*allow_exceptions=*/false);
    if (document.is_object()) return document;
  }
  if (text.starts_with("error: ")) text.erase(0, 7);
  text = text.substr(0, text.find('\n'));
  throw InputError(text.empty() ? "'" + command + "' printed nothing" : text);
}

std::optional<SweepOptionKind> FindSweepOption(const std::string& name, const Scene& scene) {
  if (kept_program) return FindProgramOption(name);
  if (IsWord(name)) return SweepOptionKind::kWord;
  const bool of_contact = name == "restitution" || name == "friction";  // of all contacts, or of a pair of materials
  if (of_contact && !scene.materials.empty()) return std::nullopt;
  if (const NumberOption* option = FindNumber(name)) return option->kind;
  if (FindParameter(name, scene)) return kReal;
  return FindBodyNumber(name, scene) != nullptr ? std::optional(kReal) : std::nullopt;
}

std::vector<std::string> SweepOptionNames() {
  if (kept_program) {
    std::vector<std::string> names = {"solver", "steps", "iterations", "learning_rate"};
    names.insert(names.end(), kept_program->names.begin(), kept_program->names.end());
    if (kept_program->feedback) names.insert(names.end(), {"feedback_scale", "feedback_samples", "feedback_seed"});
    return names;
  }
  std::vector<std::string> names = NameList(kNumbers);
  names.insert(names.begin(), {"contact", "solver", "precision"});
  return names;
}

std::vector<std::string> SweepWords(const std::string& name) {
  CHECK(name == "solver" || name == "precision") << name;
  if (name == "solver") return kept_program ? NameList(HybridSolvers()) : NameList(AllSolvers());
  return {"double", "float"};
}

void SetSweepOption(const std::string& name, const SweepValue& value, Request* request) {
  if (IsWord(name)) {
    SetWord(name, value.get<std::string>(), request);
  } else if (const NumberOption* option = FindNumber(name)) {
    SetNumber(*option, ToNumber(value), request);
  } else if (const auto of_pair = FindParameter(name, request->scene)) {
    SetValue(*of_pair, ToNumber(value), &request->scene);
  } else {
    double* number = FindBodyNumber(name, request->scene);
    CHECK(number != nullptr) << name;
    *number = ToNumber(value);
  }
  if (request->options.limits.iterations < 0) throw InputError("iterations must not be negative");
  if (const std::string why = Validate(request->options.sequences.limits); !why.empty()) throw InputError(why);
  if (!(request->options.descent.learning_rate > 0)) throw InputError("learning_rate must be positive");
  if (!request->options.surrogate) return;
  if (const std::string why = Validate(*request->options.surrogate); !why.empty()) {
    throw InputError("surrogate_" + why);
  }
}

}  // namespace saltus
