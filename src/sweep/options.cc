#include <glog/logging.h>

#include <algorithm>
#include <cstdio>
#include <limits>

#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/hybrid_solver.h"
#include "scene/control_problems.h"
#include "sweep/study.h"

namespace saltus {
namespace {

struct NumberOption {
  const char* name;
  SweepOptionKind kind;
  void (*set)(double value, Request* request);
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

uint64_t NotNegative(const char* name, double value) {
  if (value < 0) throw InputError(std::string(name) + " must not be negative");
  return static_cast<uint64_t>(value);
}

void TakeControlProblem(double seed, Request* request) {
  request->scene = ControlProblem(NotNegative("seed", seed));
  ApplySceneFlags(&request->scene);
}

constexpr NumberOption kNumbers[] = {
    {kSeedOption, kInteger, TakeControlProblem},
    {"stiffness", kReal, [](double value, Request* r) { r->scene.contact.stiffness = value; }},
    {"damping", kReal, [](double value, Request* r) { r->scene.contact.damping = value; }},
    {"restitution", kReal, [](double value, Request* r) { r->scene.contact.restitution = value; }},
    {"friction", kReal, [](double value, Request* r) { r->scene.contact.friction = value; }},
    {"steps", kInteger, [](double value, Request* r) { r->scene.steps = static_cast<int>(value); }},
    {"duration", kReal, [](double value, Request* r) { r->scene.duration = value; }},
    {"gravity_x", kReal, [](double value, Request* r) { r->scene.gravity[0] = value; }},
    {"gravity_y", kReal, [](double value, Request* r) { r->scene.gravity[1] = value; }},
    {"effort", kReal, [](double value, Request* r) { r->scene.objective.effort = value; }},
    {"learning_rate", kReal, [](double value, Request* r) { r->options.learning_rate = value; }},
    {"iterations", kInteger, [](double value, Request* r) { r->options.iterations = static_cast<int>(value); }},
    {"search_work", kReal, [](double value, Request* r) { r->options.search_options.work = value; }},
    {"search_seconds", kReal, [](double value, Request* r) { r->options.search_options.seconds = value; }},
    {"search_memory",
     kInteger,
     [](double value, Request* r) { r->options.search_options.memory = NotNegative("search_memory", value) << 20; }},
    {"search_starts",
     kInteger,
     [](double value, Request* r) { r->options.search_options.starts = static_cast<int>(value); }},
    {"search_seed",
     kInteger,
     [](double value, Request* r) { r->options.search_options.seed = NotNegative("search_seed", value); }},
    {"surrogate_sigma", kReal, [](double value, Request* r) { SurrogateOf(r).sigma = value; }},
    {"surrogate_samples", kInteger, [](double value, Request* r) { SurrogateOf(r).samples = static_cast<int>(value); }},
    {"surrogate_seed", kInteger, [](double value, Request* r) { SurrogateOf(r).seed = static_cast<int>(value); }},
    {"surrogate_segments",
     kInteger,
     [](double value, Request* r) { SurrogateOf(r).segments = static_cast<int>(value); }},
    {"feedback_scale",
     kReal,
     [](double value, Request* r) {
       if (!(value >= 0)) throw InputError("feedback_scale must not be negative");
       FeedbackOf(r).scale = value;
     }},
    {"feedback_samples",
     kInteger,
     [](double value, Request* r) {
       FeedbackOf(r).samples = static_cast<int>(NotNegative("feedback_samples", value));
     }},
    {"feedback_seed",
     kInteger,
     [](double value, Request* r) { FeedbackOf(r).seed = NotNegative("feedback_seed", value); }},
};

struct BodyOption {
  const char* field;
  void (*set)(double value, Body* body);
};

constexpr BodyOption kBodyNumbers[] = {
    {"mass", [](double value, Body* b) { b->mass = value; }},
    {"radius", [](double value, Body* b) { b->radius = value; }},
    {"position_x", [](double value, Body* b) { b->position[0] = value; }},
    {"position_y", [](double value, Body* b) { b->position[1] = value; }},
    {"velocity_x", [](double value, Body* b) { b->velocity[0] = value; }},
    {"velocity_y", [](double value, Body* b) { b->velocity[1] = value; }},
};

const NumberOption* FindNumber(const std::string& name) {
  const auto* found = std::ranges::find(kNumbers, name, &NumberOption::name);
  return found == std::end(kNumbers) ? nullptr : found;
}

const BodyOption* FindBodyNumber(const std::string& field) {
  const auto* found = std::ranges::find(kBodyNumbers, field, &BodyOption::field);
  return found == std::end(kBodyNumbers) ? nullptr : found;
}

// "<body>.<field>", looked up in a scene. Names of bodies may have dots too, fields have none.
struct BodyField {
  int body = -1;
  std::string field;
};

std::optional<BodyField> FindBodyField(const std::string& name, const Scene& scene) {
  const size_t dot = name.rfind('.');
  if (dot == std::string::npos) return std::nullopt;
  BodyField found;
  found.field = name.substr(dot + 1);
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].name == name.substr(0, dot)) found.body = i;
  }
  if (found.body < 0) return std::nullopt;
  return found;
}

// Restitution or friction of a pair of materials, "restitution.rubber-steel".
std::optional<SceneParameter> FindOfPair(const std::string& name, const Scene& scene) {
  const bool of_pair = name.starts_with("restitution.") || name.starts_with("friction.");
  const std::vector<SceneParameter> found = of_pair ? ParametersNamed(name, scene) : std::vector<SceneParameter>();
  return found.empty() ? std::nullopt : std::optional(found[0]);
}

// Where a body stands in a list of controlled ones; -1 if it does not.
int FindIn(const std::vector<int>& bodies, int body) {
  const auto found = std::ranges::find(bodies, body);
  return found == bodies.end() ? -1 : static_cast<int>(found - bodies.begin());
}

bool IsForce(const std::string& field) { return field == "force_x" || field == "force_y"; }

bool IsWord(const std::string& name) { return name == "contact" || name == "solver" || name == "precision"; }

void SetWord(const std::string& name, const std::string& word, Request* request) {
  if (name == "contact") request->contacts = {word};
  if (name == "solver") request->solvers = {word};
  if (name == "precision") request->precision = word == "float" ? Precision::kFloat : Precision::kDouble;
}

void SetBodyField(const BodyField& found, double value, Scene* scene) {
  if (const BodyOption* option = FindBodyNumber(found.field)) {
    option->set(value, &scene->bodies[found.body]);
  } else if (found.field == "torque") {
    const int torque = FindIn(scene->control.turned, found.body);
    CHECK_GE(torque, 0);
    scene->control.initial_torque[torque] = value;
  } else {
    const int force = FindIn(scene->control.bodies, found.body);
    CHECK_GE(force, 0);
    scene->control.initial[force][found.field == "force_x" ? 0 : 1] = value;
  }
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
  if (FindOfPair(name, scene)) return kReal;
  const std::optional<BodyField> found = FindBodyField(name, scene);
  if (!found) return std::nullopt;
  const bool known = FindBodyNumber(found->field) != nullptr ||
                     (IsForce(found->field) && FindIn(scene.control.bodies, found->body) >= 0) ||
                     (found->field == "torque" && FindIn(scene.control.turned, found->body) >= 0);
  return known ? std::optional(kReal) : std::nullopt;
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
    option->set(ToNumber(value), request);
  } else if (const auto of_pair = FindOfPair(name, request->scene)) {
    SetValue(*of_pair, ToNumber(value), &request->scene);
  } else {
    const std::optional<BodyField> found = FindBodyField(name, request->scene);
    CHECK(found) << name;
    SetBodyField(*found, ToNumber(value), &request->scene);
  }
  if (request->options.iterations < 0) throw InputError("iterations must not be negative");
  if (const std::string why = WhyNotValid(request->options.search_options); !why.empty()) throw InputError(why);
  if (!(request->options.learning_rate > 0)) throw InputError("learning_rate must be positive");
  if (!request->options.surrogate) return;
  if (const std::string why = WhyNotValid(*request->options.surrogate); !why.empty()) {
    throw InputError("surrogate_" + why);
  }
}

}  // namespace saltus
