#include <algorithm>
#include <cmath>

#include "base/number_text.h"
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
  SolutionReader(const std::string& where, const Scene& scene) : InputReader(where), scene_(scene) {}

  SavedSolution ReadFile(const std::string& flag, const std::string& path) {
    Json document = ReadDocument(path, flag + ": ");
    if (document.contains("runs")) {
      const Json runs = document["runs"];
      if (!runs.is_array() || runs.size() != 1) {
        Fail("runs", "one run, found " + std::to_string(runs.size()) + "; take one of them as a file of its own");
      }
      document = runs[0];
    }
    if (!document.is_object()) Fail("the document", "an object");
    return Read(document);
  }

  SavedSolution Read(const Json& run) {
    ReadRun(run);
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
    const bool three = control && scene_.num_torques() > 0;
    if (!list.is_array() || list.size() != rows) {
      Fail(key,
           "a list of " + std::to_string(rows) + " times [x, y]" +
               (three ? ", or [x, y, torque] of discs with a torque control" : ""));
    }
    std::vector<double> numbers;
    for (size_t i = 0; i < rows; ++i) {
      const std::vector<int>& turned = scene_.control.torque_bodies;
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

  // Returns the numbers of a control of K x C x 2, of K x C x 3 where discs are turned, or of one disc without C.
  std::vector<double> ArrayRows(const Json& rows) const {
    const size_t discs = scene_.num_controlled(), columns = ControlColumns(scene_);
    const auto is_force = [&](const Json& item) { return IsVector(item, columns); };
    for (const Json& row : rows) {
      if (row.size() == discs && std::ranges::all_of(row, is_force)) continue;
      if (discs == 1 && is_force(row)) continue;
      Fail("control", "a shape of (K, " + std::to_string(discs) + ", " + std::to_string(columns) + ")");
    }
    return NumbersIn(rows);
  }

  // Sets the control from rows, and checks them.
  void SetControl(const std::vector<double>& rows) {
    if (const std::string why = ValidateControlRows(scene_, rows); !why.empty()) {
      throw InputError(where() + ": control: " + why);
    }
    solution_.control = ControlOfRows(scene_, rows);
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
    if (const auto rows = run.find("control_rows"); rows != run.end()) SetControl(ArrayRows(*rows));
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

  const Scene& scene_;
  SavedSolution solution_;
};

}  // namespace

SavedSolution ReadSolution(const std::string& flag, const std::string& path, const Scene& scene) {
  return SolutionReader(flag + ": " + path, scene).ReadFile(flag, path);
}

SavedSolution SolutionOf(const std::string& name, const Json& run, const Scene& scene) {
  return SolutionReader(name, scene).Read(run);
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
