#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <span>

#include "base/number_text.h"
#include "output/page.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "programs/scene_drawing.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"

DECLARE_string(scene);
DEFINE_string(output, "replay.html", "HTML page to write");

namespace saltus {

namespace {

constexpr size_t kState = 4;
constexpr size_t kTurning = 6;  // with angle and angular velocity

// Whether the motion of a contact model is the exact motion.
bool IsExact(const std::string& contact) {
  const ModelTraits* model = FindContactModel(contact);
  return model != nullptr && model->event_driven;
}

class ReplayReader : InputReader {
 public:
  ReplayReader(const std::string& path, const std::optional<Scene>& scene)
      : InputReader(path), given_(scene.has_value()) {
    if (scene) replay_.scene = *scene;
  }

  Replay Read() {
    ReadRuns(ReadDocument(where()));
    if (replay_.motions.empty()) {
      Fail("states", "times and states; saltus_solve prints them with --states, and writes them with --output_dir");
    }
    return std::move(replay_);
  }

 private:
  Scene& scene() { return own_ ? *own_ : replay_.scene; }
  const Scene& scene() const { return own_ ? *own_ : replay_.scene; }
  size_t num_discs() const { return scene().bodies.size(); }

  double NumberIn(const Json& value, const std::string& key) const {
    if (!value.is_number()) Fail(key, "a finite number");
    return value.get<double>();
  }

  Vec2d VectorIn(const Json& value, const std::string& key) const {
    if (!value.is_array() || value.size() != 2) Fail(key, "[x, y]");
    return {NumberIn(value[0], key), NumberIn(value[1], key)};
  }

  std::string TextIn(const Json& object, const std::string& key, const std::string& otherwise) const {
    const auto found = object.find(key);
    return found != object.end() && found->is_string() ? found->get<std::string>() : otherwise;
  }

  void Read(const Json& value, const std::string& key, double* number) const { *number = NumberIn(value, key); }
  void Read(const Json& value, const std::string& key, Vec2d* vector) const { *vector = VectorIn(value, key); }
  void Read(const Json& value, const std::string& key, std::vector<Vec2d>* vectors) const {
    for (const Json& item : value) vectors->push_back(VectorIn(item, key));
  }
  void Read(const Json& value, const std::string&, bool* is) const { *is = value.is_boolean() && value.get<bool>(); }
  void Read(const Json& value, const std::string&, std::string* text) const {
    if (value.is_string()) *text = value.get<std::string>();
  }
  void Read(const Json& value, const std::string&, EdgePolygon::Solid* solid) const {
    if (value == "outside") *solid = EdgePolygon::Solid::kOutside;
  }

  void Read(const Json& value, const std::string& key, std::optional<PrescribedMotion>* motion) {
    if (!value.is_object() || !value.contains("times") || !value.contains("positions")) {
      Fail(key, "{ \"times\", \"positions\" }");
    }
    PrescribedMotion& path = motion->emplace();
    for (const Json& time : value["times"]) path.times.push_back(NumberIn(time, key));
    Read(value["positions"], key, &path.positions);
    if (!path.times.empty()) scene().duration = std::min(scene().duration, path.times.back());
  }

  // Reads the discs and the walls. Names, and whether a disc is fixed and where a polygon is solid, may be missing.
  void ReadDrawn(const Json& document) {
    const auto bodies = document.find("bodies");
    if (bodies == document.end() || !bodies->is_array() || bodies->empty()) {
      Fail("bodies", "a list of { \"name\", \"radius\" }, or --scene=FILE");
    }
    VisitDrawn(scene(), [&]<typename T>(const std::string& list, const std::string& noun, std::vector<T>& things) {
      const auto items = document.find(list);
      if (items != document.end() && !items->is_array()) Fail(list, "a list");
      for (size_t i = 0; items != document.end() && i < items->size(); ++i) {
        const Json& item = (*items)[i];
        const std::string place = list + "[" + std::to_string(i) + "]";
        T& thing = things.emplace_back();
        thing.name = noun + " " + std::to_string(i + 1);
        std::string expected;
        bool whole = item.is_object();
        VisitDrawnFields(thing, [&](const std::string& key, const auto&) {
          if (key == "fixed" || key == "solid" || key == "motion") return;
          expected += (expected.empty() ? "{ \"" : ", \"") + key + "\"";
          whole = whole && (key == "name" || item.contains(key));
        });
        if (!whole) Fail(place, expected + " }");
        VisitDrawnFields(thing, [&](const std::string& key, auto& value) {
          if (item.contains(key)) Read(item[key], place + "." + key, &value);
        });
      }
    });
    if (const auto error = ValidateStructure(scene())) throw InputError(where() + ": " + error->ToString());
  }

  void ReadScene(const std::string& text) {
    std::variant<Scene, SceneFileError> scene = ParseScene(text, where() + ": scene");
    if (const auto* error = std::get_if<SceneFileError>(&scene)) throw InputError(error->ToString());
    this->scene() = std::get<Scene>(std::move(scene));
  }

  void ReadRuns(const Json& document) {
    if (!given_) {
      const std::string text = TextIn(document, "scene_file", "");
      has_control_ = !text.empty();
      has_control_ ? ReadScene(text) : ReadDrawn(document);
    }
    const auto runs = document.find("runs");
    if (runs == document.end()) {
      TakeOwnScene(document);
      if (own_) replay_.scene = *std::exchange(own_, std::nullopt);
      return ReadRun(document, "");
    }
    if (!runs->is_array()) Fail("runs", "a list");
    for (size_t i = 0; i < runs->size(); ++i) {
      if (!(*runs)[i].is_object()) Fail("runs[" + std::to_string(i) + "]", "an object");
      TakeOwnScene((*runs)[i]);
      ReadRun((*runs)[i], "runs[" + std::to_string(i) + "].");
    }
  }

  // Takes the scene of a run whose parameters have moved discs or walls: what the run says of them or, where a scene is
  // given, this scene with the parameters.
  void TakeOwnScene(const Json& run) {
    own_.reset();
    if (!run.contains("states") || !run.contains("parameters")) return;
    if (given_) {
      Scene moved = replay_.scene;
      TakeParameters(where(), SolutionOf(where(), {{"parameters", run["parameters"]}}, moved), &moved);
      own_ = std::move(moved);
    } else if (run.contains("bodies")) {
      own_.emplace();
      ReadDrawn(run);
    }
  }

  // Adds the motion under the contact model and the exact one, as far as the run has them: under a model that is exact
  // both are the same, and one will do.
  void ReadRun(const Json& run, const std::string& place) {
    const std::string contact = TextIn(run, "contact", ""), solver = TextIn(run, "solver", "");
    const std::string name = contact + (solver.empty() || solver == kNoSolver ? "" : " " + solver);
    const std::string label = name.empty() ? TextIn(run, "name", "states") : name;
    for (const std::string prefix : {"", "exact_"}) {
      const std::string key = place + prefix;
      if (!run.contains(prefix + "states")) continue;
      if (prefix.empty() && IsExact(contact) && run.contains("exact_states")) continue;
      if (!run.contains(prefix + "times")) Fail(key + "times", "one number for each of the states");
      const std::string exact = prefix.empty() || IsExact(contact) ? "" : ", exact";
      ReplayMotion drawn({}, {}, label + exact, contact);
      drawn.motion.arcs = !prefix.empty();
      for (const Json& time : run[prefix + "times"]) drawn.motion.times.push_back(NumberIn(time, key + "times"));
      ReadStates(run[prefix + "states"], key + "states", &drawn);
      if (run.contains(prefix + "rotations"))
        ReadRotations(run[prefix + "rotations"], key + "rotations", &drawn.motion);
      if (run.contains(prefix + "touches")) ReadTouches(run[prefix + "touches"], key + "touches", &drawn.motion);
      if (has_control_ && run.contains("control_rows") && scene().num_controlled() > 0) ReadControl(run, &drawn);
      Add(std::move(drawn), key);
    }
  }

  void ReadStates(const Json& states, const std::string& key, ReplayMotion* drawn) {
    if (!states.is_array()) Fail(key, "a list");
    Motion& motion = drawn->motion;
    size_t numbers = kState;
    for (size_t k = 0; k < states.size(); ++k) {
      const std::string row = key + "[" + std::to_string(k) + "]";
      if (!states[k].is_array() || states[k].size() != num_discs()) {
        Fail(row, "one list for each of " + std::to_string(num_discs()) + " discs");
      }
      for (const Json& body : states[k]) {
        if (!body.is_array() || (body.size() != 2 && body.size() < kState)) {
          Fail(row, "[p_x, p_y, v_x, v_y] or [p_x, p_y] of each disc");
        }
        numbers = std::min(numbers, body.size());
        const auto number = [&](size_t j) { return j < body.size() ? NumberIn(body[j], row) : 0; };
        for (size_t j = 0; j < kState; ++j) motion.states.push_back(number(j));
        // The angular velocity is not drawn.
        if (body.size() >= kTurning) motion.rotations.insert(motion.rotations.end(), {number(kState), 0});
      }
    }
    if (numbers < kState) DifferenceVelocities(drawn);
    // Angles are left out if some states have none.
    if (kState * motion.rotations.size() != kSpin * motion.states.size()) motion.rotations.clear();
  }

  // Reads angles and angular velocities, which NPZ files of saltus have beside the states.
  void ReadRotations(const Json& rotations, const std::string& key, Motion* motion) const {
    motion->rotations = NumbersIn(rotations);
    if (kState * motion->rotations.size() != kSpin * motion->states.size()) {
      Fail(key, "a shape of (n, " + std::to_string(num_discs()) + ", 2) with the n of the states");
    }
  }

  // Reads the control, which is drawn only if the file has the discs that it belongs to: files with the whole scene.
  void ReadControl(const Json& run, ReplayMotion* drawn) const {
    Json given = {{"control_rows", run["control_rows"]}};
    if (run.contains("durations")) given["durations"] = run["durations"];
    SavedSolution solution = SolutionOf(where(), given, scene());
    const size_t intervals = solution.control.size() / scene().control_width();
    if (solution.durations.empty() && intervals > 0 && !drawn->motion.times.empty()) {
      solution.durations.assign(intervals, drawn->motion.times.back() / static_cast<double>(intervals));
    }
    drawn->input = {{}, std::move(solution.control), std::move(solution.durations)};
  }

  // Sets velocities to the differences of positions across the neighbouring states.
  void DifferenceVelocities(ReplayMotion* drawn) const {
    Motion* motion = &drawn->motion;
    const size_t width = kState * num_discs(), rows = motion->states.size() / width;
    if (rows != motion->times.size()) return;  // refused by Add()
    for (size_t k = 0; k < rows; ++k) {
      const size_t from = k > 0 ? k - 1 : 0, to = std::min(k + 1, rows - 1);
      const double passed = motion->times[to] - motion->times[from];
      for (size_t i = 0; i < width; ++i) {
        if (i % kState < 2) continue;
        const double way = motion->states[to * width + i - 2] - motion->states[from * width + i - 2];
        motion->states[k * width + i] = passed > 0 ? way / passed : 0;
      }
    }
    drawn->remark = "velocities by differences";
  }

  // The number of the disc or, from num_discs() on, of the wall that a touch names or, in an NPZ file, numbers.
  size_t NumberOf(const Json& touch, const std::string& end, const std::string& place) const {
    const auto find = [&](const auto& list, const std::string& name) {
      return std::ranges::find_if(list, [&](const auto& item) { return item.name == name; }) - list.begin();
    };
    const std::vector<WallPart> walls = WallPartsOf(scene());
    if (touch.contains(end) && touch[end].is_number()) {
      const bool is_wall = end == "b" && touch.value("wall", Json()) == true;
      const double number = touch[end].get<double>();
      const double most = static_cast<double>(is_wall ? walls.size() : num_discs());
      if (!(number >= 0 && number < most)) Fail(place + "." + end, "the number of a disc or of a wall");
      return static_cast<size_t>(number) + (is_wall ? num_discs() : 0);
    }
    const std::string name = TextIn(touch, end, "");
    const size_t disc = find(scene().bodies, name), wall = find(walls, name);
    if (disc < num_discs()) return disc;
    if (wall == walls.size()) Fail(place + "." + end, "a body or a wall, found '" + name + "'");
    return num_discs() + wall;
  }

  void ReadTouches(const Json& touches, const std::string& place, Motion* motion) {
    if (!touches.is_array()) Fail(place, "a list");
    for (size_t i = 0; i < touches.size(); ++i) {
      const std::string key = place + "[" + std::to_string(i) + "]";
      const Json& touch = touches[i];
      if (!touch.is_object() || !touch.contains("begin")) Fail(key, "{ \"a\", \"b\", \"begin\" }");
      const size_t a = NumberOf(touch, "a", key), b = NumberOf(touch, "b", key);
      if (a >= num_discs()) Fail(key + ".a", "a disc");
      const bool wall = b >= num_discs();
      TouchSpan read{{static_cast<int>(a), static_cast<int>(wall ? b - num_discs() : b), wall}};
      read.begin = read.end = NumberIn(touch["begin"], key + ".begin");
      if (touch.contains("end")) read.end = NumberIn(touch["end"], key + ".end");
      CheckTouch(read, key + ".end");
      if (touch.contains("impulse")) read.impulse = VectorIn(touch["impulse"], key + ".impulse");
      motion->touches.push_back(read);
    }
  }

  void CheckTouch(const TouchSpan& touch, const std::string& key) const {
    if (!(std::isfinite(touch.begin) && std::isfinite(touch.end))) Fail(key, "finite times");
    if (touch.end < touch.begin) {
      Fail(key, "a time from its begin on, " + ToText(touch.begin) + ", found " + ToText(touch.end));
    }
  }

  void Add(ReplayMotion drawn, const std::string& place) {
    Motion& motion = drawn.motion;
    const size_t rows = motion.states.size() / (kState * num_discs());
    if (rows == 0 || rows != motion.times.size()) {
      Fail(place + "times",
           "as many as states, found " + std::to_string(motion.times.size()) + " and " + std::to_string(rows));
    }
    const auto finite = [](double time) { return std::isfinite(time); };
    if (!std::ranges::all_of(motion.times, finite)) Fail(place + "times", "finite numbers");
    if (!std::ranges::is_sorted(motion.times)) Fail(place + "times", "times that do not fall");
    std::ranges::stable_sort(motion.touches, {}, &TouchSpan::begin);
    drawn.scene = own_;
    replay_.motions.push_back(std::move(drawn));
  }

  bool given_;
  bool has_control_ = false;  // the file has the whole scene
  Replay replay_;
  std::optional<Scene> own_;  // of the run that is read, if parameters have moved its discs or walls
};

std::string StemOf(const std::string& path) { return std::filesystem::path(path).stem().string(); }

// A style for each motion: that of its contact model, unless another motion has it.
void SetStyles(std::vector<ReplayMotion>* motions) {
  const auto has = [&](size_t end, std::string_view model) {
    return std::ranges::any_of(std::span(*motions).first(end), [&](const auto& one) { return one.model == model; });
  };
  size_t next = 1;  // the first is of no contact model
  for (size_t i = 0; i < motions->size(); ++i) {
    ReplayMotion& drawn = (*motions)[i];
    const bool taken = drawn.model.empty() || has(i, drawn.model);
    while (taken && has(motions->size(), ModelStyles()[next].model) && next + 1 < ModelStyles().size()) ++next;
    if (taken) drawn.model = ModelStyles()[next].model;
    drawn.colour = StyleOf(drawn.model).colour;
    drawn.dash = StyleOf(drawn.model).dash;
  }
}

// Keeps every n-th state, where there are more than a page shows.
void Thin(size_t most_rows, ReplayMotion* drawn) {
  Motion& motion = drawn->motion;
  const size_t rows = motion.times.size(), stride = (rows + most_rows - 1) / most_rows;
  if (stride < 2) return;
  for (std::vector<double>* numbers : {&motion.states, &motion.rotations, &motion.times}) {
    const size_t width = numbers->size() / rows;
    std::vector<double> kept;
    for (size_t k = 0; k < rows; ++k) {
      if (k % stride != 0 && k + 1 != rows) continue;
      kept.insert(kept.end(), numbers->begin() + k * width, numbers->begin() + (k + 1) * width);
    }
    *numbers = std::move(kept);
  }
  motion.arcs = false;
  drawn->remark += (drawn->remark.empty() ? "" : "; ") + std::string("every ") + std::to_string(stride) +
                   (stride == 2   ? "nd"
                    : stride == 3 ? "rd"
                                  : "th") +
                   " state";
}

// Returns the motions in some files, whose discs must have the same names. Each is drawn with its own discs and walls,
// or with those of `scene`, if one is given. Throws InputError with file and key.
Replay ReadReplay(const std::vector<std::string>& paths, const std::optional<Scene>& scene) {
  Replay replay;
  for (const std::string& path : paths) {
    Replay file = ReadReplayFile(path, scene);
    if (replay.scene.bodies.empty()) replay.scene = file.scene;
    if (!std::ranges::equal(replay.scene.bodies, file.scene.bodies, {}, &Body::name, &Body::name)) {
      throw InputError(path + ": its discs are not those of " + paths[0]);
    }
    for (ReplayMotion& drawn : file.motions) {
      if (!drawn.scene && !replay.motions.empty()) drawn.scene = file.scene;
      if (paths.size() > 1) drawn.label = StemOf(path) + ": " + drawn.label;
      replay.motions.push_back(std::move(drawn));
    }
  }
  const size_t width = kState * replay.scene.bodies.size(), motions = replay.motions.size();
  for (ReplayMotion& drawn : replay.motions) {
    Thin(std::max<size_t>(2, kMostReplayNumbers / (width * motions)), &drawn);
  }
  SetStyles(&replay.motions);
  return replay;
}

int WriteReplay() {
  const std::vector<std::string>& paths = FilesGiven();
  if (paths.empty()) throw InputError("expected a file to replay; -h describes the formats");
  std::optional<Scene> scene;
  if (!FLAGS_scene.empty()) scene = LoadScene(FLAGS_scene);
  const Replay replay = ReadReplay(paths, scene);
  std::string names;
  for (const std::string& path : paths) names += (names.empty() ? "" : ", ") + StemOf(path);
  Page page(names);
  page.AddReplay(ReplayToJson(replay),
                 "The space bar plays and pauses; arrow keys step, with shift from impact to impact.");
  ThrowIfFailed(page.Write(FLAGS_output));
  std::cout << FLAGS_output << std::endl;
  return kDone;
}

}  // namespace

Replay ReadReplayFile(const std::string& path, const std::optional<Scene>& scene) {
  return ReplayReader(path, scene).Read();
}

int ReplayMain(int argc, char** argv) { return RunMain(argc, argv, FindProgram("saltus_replay"), WriteReplay); }

}  // namespace saltus
