#include <algorithm>
#include <cmath>

#include "base/file.h"
#include "base/number_text.h"
#include "output/npz.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/simulator.h"

namespace saltus {
namespace {

constexpr double kSameStart = 1e-6;  // relative: a start that was rounded to float

class SolutionReader : InputReader {
 public:
  SolutionReader(const std::string& flag, const std::string& path, const Scene& scene)
      : InputReader(flag + ": " + path), flag_(flag), path_(path), scene_(scene) {}

  SavedSolution Read() {
    const StatusOr<std::string> bytes = ReadFile(path_);
    if (!bytes.ok()) throw InputError(flag_ + ": " + bytes.status().message());
    if (!bytes->starts_with("PK")) return Read(*bytes);
    ReadArrays();
    CheckFinite();
    return std::move(solution_);
  }
  SavedSolution Read(const std::string& json) {
    ReadJson(json);
    CheckFinite();
    return std::move(solution_);
  }

 private:
  // A null is a number that was not finite.
  static bool IsVector(const Json& item, size_t size) {
    const auto is_number = [](const Json& number) { return number.is_number(); };
    return item.is_array() && item.size() == size && std::ranges::all_of(item, is_number);
  }

  // The numbers of [[x, y], ...], `rows` of them. With `control` one interval as rows of it have it (control_rows.h):
  // [x, y, torque] of discs that are turned.
  std::vector<double> Vectors(const Json& list, const std::string& key, size_t rows, bool control = false) const {
    const bool three = control && scene_.num_turned() > 0;
    if (!list.is_array() || list.size() != rows) {
      Fail(key,
           "a list of " + std::to_string(rows) + " times [x, y]" +
               (three ? ", or [x, y, torque] of discs with a torque control" : ""));
    }
    std::vector<double> numbers;
    for (size_t i = 0; i < rows; ++i) {
      const std::vector<int>& turned = scene_.control.turned;
      const bool turns = three && std::ranges::find(turned, scene_.control.bodies[i]) != turned.end();
      if (!IsVector(list[i], turns ? 3 : 2)) {
        Fail(key + "[" + std::to_string(i) + "]",
             turns ? "[x, y, torque] of finite numbers" : "[x, y] of finite numbers");
      }
      for (const Json& number : list[i]) numbers.push_back(number.get<double>());
      if (three && !turns) numbers.push_back(0);
    }
    return numbers;
  }

  // Sets the control from rows, and checks them.
  void SetControl(const std::vector<double>& rows) {
    if (const std::string why = WhyNoControl(scene_, rows); !why.empty()) {
      throw InputError(where() + ": control: " + why);
    }
    solution_.control = ControlOfRows(scene_, rows);
  }

  void ReadJson(const std::string& text) {
    Json document = ParseJson(text, where(), "an NPZ file or a JSON object");
    if (document.is_object() && document.contains("solve")) document = Json(document["solve"]);
    if (document.is_object() && document.contains("runs")) {
      const Json runs = document["runs"];
      if (!runs.is_array() || runs.size() != 1) {
        Fail("runs", "one run, found " + std::to_string(runs.size()) + "; take one of them as a file of its own");
      }
      document = runs[0];
    }
    if (!document.is_object()) Fail("the document", "an object");
    ReadRun(document);
  }

  void ReadRun(const Json& run) {
    if (const auto control = run.find("control"); control != run.end()) {
      if (!control->is_array()) Fail("control", "a list of intervals");
      std::vector<double> rows;
      for (size_t k = 0; k < control->size(); ++k) {
        const std::vector<double> row =
            Vectors((*control)[k], "control[" + std::to_string(k) + "]", scene_.num_controlled(), /*control=*/true);
        rows.insert(rows.end(), row.begin(), row.end());
      }
      SetControl(rows);
    }
    if (const auto durations = run.find("durations"); durations != run.end()) {
      if (!durations->is_array()) Fail("durations", "a list of numbers");
      for (const Json& value : *durations) {
        if (!value.is_number()) Fail("durations", "a list of numbers");
        solution_.durations.push_back(value.get<double>());
      }
      CheckDurations();
    }
    if (const auto parameters = run.find("parameters"); parameters != run.end()) {
      if (!parameters->is_object()) Fail("parameters", "an object of numbers by their names");
      for (const auto& [name, value] : parameters->items()) {
        if (!value.is_number()) Fail("parameters." + name, "a finite number");
        solution_.parameters[name] = value.get<double>();
      }
    }
    for (const auto& [key, offset] : {std::pair("position", 0), std::pair("velocity", 2)}) {
      const auto found = run.find(key);
      if (found == run.end()) continue;
      const std::vector<double> numbers = Vectors(*found, key, scene_.num_bodies());
      BeginState();
      for (size_t i = 0; i < numbers.size(); ++i) solution_.initial_state[i / 2 * 4 + offset + i % 2] = numbers[i];
    }
    const auto spins = run.find("angular_velocity");
    if (spins == run.end() || !scene_.Spins()) return;
    const bool fits = spins->is_array() && spins->size() == scene_.bodies.size() &&
                      std::ranges::all_of(*spins, [](const Json& item) { return item.is_number(); });
    if (!fits) Fail("angular_velocity", "a list of " + std::to_string(scene_.num_bodies()) + " finite numbers");
    SetAngularVelocities(spins->get<std::vector<double>>());
  }

  // Sets the initial state, if there is none, to that of the scene with the parameters of the file.
  void BeginState() {
    if (!solution_.initial_state.empty()) return;
    Scene scene = scene_;
    TakeParameters(where(), solution_, &scene);
    solution_.initial_state = InitialState(scene);
  }

  // Sets entry 1 of each rotation of `initial_state`, which begins as the scene's.
  void SetAngularVelocities(const std::vector<double>& numbers) {
    BeginState();
    const size_t moves = 4 * scene_.bodies.size();
    for (size_t i = 0; i < numbers.size(); ++i) solution_.initial_state[moves + kSpin * i + 1] = numbers[i];
  }

  void ReadArrays() {
    const StatusOr<NpzArrays> arrays = ReadNpz(path_);
    if (!arrays.ok()) throw InputError(flag_ + ": " + arrays.status().message());
    const int64_t bodies = scene_.num_bodies(), controlled = scene_.num_controlled();
    if (const auto control = arrays->find("control"); control != arrays->end()) {
      std::vector<int64_t> shape = control->second.shape;
      if (shape.size() == 2 && controlled == 1) shape.insert(shape.begin() + 1, 1);
      const int64_t columns = ControlColumns(scene_);
      if (shape.size() != 3 || shape[1] != controlled || shape[2] != columns) {
        Fail("control", "a shape of (K, " + std::to_string(controlled) + ", " + std::to_string(columns) + ")");
      }
      SetControl(Numbers(control->second, "control"));
    }
    if (const auto durations = arrays->find("durations"); durations != arrays->end()) {
      solution_.durations = Numbers(durations->second, "durations");
      CheckDurations();
    }
    if (const auto initial = arrays->find("initial_state"); initial != arrays->end()) {
      if (initial->second.shape != std::vector<int64_t>{bodies, 4}) {
        Fail("initial_state", "a shape of (" + std::to_string(bodies) + ", 4)");
      }
      const std::vector<double> numbers = Numbers(initial->second, "initial_state");
      solution_.initial_state = InitialState(scene_);
      std::ranges::copy(numbers, solution_.initial_state.begin());
    }
    const auto names = arrays->find("parameter_names"), values = arrays->find("parameters");
    if (names != arrays->end() && values != arrays->end()) {
      const auto* texts = std::get_if<std::vector<std::string>>(&names->second.data);
      const std::vector<double> numbers = Numbers(values->second, "parameters");
      if (texts == nullptr || texts->size() != numbers.size()) Fail("parameter_names", "one name for each parameter");
      for (size_t i = 0; i < numbers.size(); ++i) solution_.parameters[(*texts)[i]] = numbers[i];
    }
    const auto rotation = arrays->find("initial_rotation");
    if (rotation == arrays->end() || !scene_.Spins()) return;
    if (rotation->second.shape != std::vector<int64_t>{bodies, kSpin}) {
      Fail("initial_rotation", "a shape of (" + std::to_string(bodies) + ", 2)");
    }
    const std::vector<double> numbers = Numbers(rotation->second, "initial_rotation");
    std::vector<double> spins;
    for (size_t i = 1; i < numbers.size(); i += kSpin) spins.push_back(numbers[i]);
    SetAngularVelocities(spins);
  }

  void CheckDurations() const {
    const size_t width = scene_.control_width();
    if (solution_.durations.size() * width == solution_.control.size()) return;
    Fail(
        "durations",
        "one number per interval of the control, " + std::to_string(width == 0 ? 0 : solution_.control.size() / width));
  }

  void CheckFinite() const {
    const auto check = [&](const std::vector<double>& numbers, const char* key) {
      const auto bad = [](double value) { return !std::isfinite(value); };
      if (std::ranges::any_of(numbers, bad)) Fail(key, "finite numbers");
    };
    check(solution_.control, "control");
    check(solution_.durations, "durations");
    check(solution_.initial_state, "initial state");
  }

  const std::string &flag_, &path_;
  const Scene& scene_;
  SavedSolution solution_;
};

}  // namespace

SavedSolution ReadSolution(const std::string& flag, const std::string& path, const Scene& scene) {
  return SolutionReader(flag, path, scene).Read();
}

SavedSolution ParseSolution(const std::string& name, const std::string& json, const Scene& scene) {
  return SolutionReader(name, "", scene).Read(json);
}

void TakeParameters(const std::string& flag, const SavedSolution& solution, Scene* scene) {
  std::vector<double> values = DesignOf(*scene);
  for (size_t i = 0; i < values.size(); ++i) {
    const std::string name = NameOf(scene->design[i].parameter, *scene);
    const auto saved = solution.parameters.find(name);
    if (saved == solution.parameters.end()) continue;
    const ParameterRange range = RangeOf(scene->design[i]);
    values[i] = std::clamp(saved->second, range.min, range.max);
    if (std::abs(saved->second - values[i]) <= kSameStart * (1 + std::abs(values[i]))) continue;
    throw InputError(flag + ": parameters." + name + ": found " + ToText(saved->second) + ", expected a value from " +
                     ToText(range.min) + " to " + ToText(range.max) + ", which the scene allows");
  }
  *scene = WithDesign(*scene, values);
}

void StartFrom(const std::string& flag, const SavedSolution& solution, Scene* scene) {
  TakeParameters(flag, solution, scene);
  if (solution.initial_state.empty()) return;
  for (int i = 0; i < scene->num_bodies(); ++i) {
    Body& body = scene->bodies[i];
    const bool is_free = std::ranges::find(scene->free, i) != scene->free.end();
    const double* x = &solution.initial_state[4 * i];
    const auto check = [&](const char* what, double difference, double size) {
      if (!(difference > kSameStart * (1 + size))) return;
      throw InputError(flag + ": the " + what + " of " + body.name +
                       " is not the scene's, and not free: a solution of another scene");
    };
    const auto take = [&](const Vec2d& given, const char* what, bool may_differ, Vec2d* own) {
      if (!may_differ) return check(what, (given - *own).norm(), own->norm());
      *own = given;
    };
    take(Vec2d(x[0], x[1]), "position", is_free && scene->optimize == Optimize::kPosition, &body.position);
    take(Vec2d(x[2], x[3]), "velocity", is_free && scene->optimize == Optimize::kVelocity, &body.velocity);
    if (!body.Spins()) continue;
    const double spin = solution.initial_state[4 * scene->bodies.size() + kSpin * i + 1];
    if (std::ranges::find(scene->free_spin, i) != scene->free_spin.end()) {
      body.angular_velocity = spin;
    } else {
      check("angular velocity", std::abs(spin - body.angular_velocity), std::abs(body.angular_velocity));
    }
  }
}

}  // namespace saltus
