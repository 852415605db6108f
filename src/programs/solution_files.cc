#include "programs/solution_files.h"

#include <functional>
#include <iostream>
#include <new>

#include "base/interrupt.h"
#include "output/npz.h"
#include "programs/simulated_run.h"
#include "programs/surrogate_flags.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/walls.h"

namespace saltus {
namespace {

constexpr size_t kState = 4;  // p_x p_y v_x v_y

// With the rotations, if there are any.
Json StateToJson(const double* x, const double* rotations, size_t bodies) {
  Json state = Json::array();
  for (size_t i = 0; i < bodies; ++i) {
    Json body = Json::array();
    for (size_t j = 0; j < kState; ++j) body.push_back(NumberToJson(x[kState * i + j]));
    for (size_t j = 0; j < kSpin && rotations != nullptr; ++j) body.push_back(NumberToJson(rotations[kSpin * i + j]));
    state.push_back(std::move(body));
  }
  return state;
}

// Of numbers in the shape of an initial state.
Json StateToJson(const std::vector<double>& x, size_t bodies) {
  return StateToJson(x.data(), x.size() > kState * bodies ? &x[kState * bodies] : nullptr, bodies);
}

Json StatesToJson(const Motion& motion, size_t bodies) {
  Json states = Json::array();
  for (size_t k = 0; k < motion.times.size(); ++k) {
    const double* rotations = motion.rotations.empty() ? nullptr : &motion.rotations[k * bodies * kSpin];
    states.push_back(StateToJson(&motion.states[k * bodies * kState], rotations, bodies));
  }
  return states;
}

// Of the run's own model at the nodes of its control, and of exact dynamics.
struct Motions {
  Motion own, exact;
};

Motions MotionsOf(const Request& request, const SolvedRun& run) {
  MotionOptions options;
  options.most_bytes = request.options.memory_limit;
  Motions motions{MotionOf(request, run.report, false, options), MotionOf(request, run.report, true, options)};
  if (motions.own.failure.empty()) motions.own = AtNodes(motions.own, NodesOf(request.scene, run.report));
  for (const auto& [name, motion] : {std::pair("", &motions.own), std::pair("exact ", &motions.exact)}) {
    if (motion->failure.empty()) continue;
    std::cerr << "no " << name << "states of " << run.report.contact << " " << run.report.solver << ": "
              << motion->failure << std::endl;
  }
  return motions;
}

// Who touched: [a, b, whether b is a plane], when, and the impulse on a.
void AddTouches(const Motion& motion, const std::string& prefix, NpzArrays* arrays) {
  const int64_t rows = static_cast<int64_t>(motion.touches.size());
  std::vector<int64_t> pairs;
  std::vector<double> times, impulses;
  for (const TouchSpan& touch : motion.touches) {
    pairs.insert(pairs.end(), {touch.contact.a, touch.contact.b, touch.contact.plane});
    times.insert(times.end(), {touch.begin, touch.end});
    impulses.insert(impulses.end(), {touch.impulse[0], touch.impulse[1]});
  }
  (*arrays)[prefix + "touch_pairs"] = {{rows, 3}, pairs};
  (*arrays)[prefix + "touch_times"] = {{rows, 2}, times};
  (*arrays)[prefix + "touch_impulses"] = {{rows, 2}, impulses};
}

Json TouchesToJson(const Motion& motion, const Scene& scene) {
  const std::vector<std::string> walls = WallNamesOf(scene);
  Json touches = Json::array();
  for (const TouchSpan& touch : motion.touches) {
    const Candidate& c = touch.contact;
    touches.push_back({{"a", scene.bodies[c.a].name},
                       {"b", c.plane ? walls[c.b] : scene.bodies[c.b].name},
                       {"begin", NumberToJson(touch.begin)},
                       {"end", NumberToJson(touch.end)},
                       {"impulse", {NumberToJson(touch.impulse[0]), NumberToJson(touch.impulse[1])}}});
  }
  return touches;
}

void AddMotion(const Motion& motion, const std::string& prefix, int64_t bodies, NpzArrays* arrays) {
  if (!motion.failure.empty()) return;
  AddTouches(motion, prefix, arrays);
  const int64_t rows = static_cast<int64_t>(motion.times.size());
  (*arrays)[prefix + "times"] = {{rows}, motion.times};
  (*arrays)[prefix + "states"] = {{rows, bodies, static_cast<int64_t>(kState)}, motion.states};
  if (!motion.rotations.empty()) (*arrays)[prefix + "rotations"] = {{rows, bodies, kSpin}, motion.rotations};
}

NpyArray ScalarText(const std::string& text) { return {{}, std::vector<std::string>{text}}; }

// An initial state: positions and velocities, and the rotations, if there are any.
void AddInitial(const std::string& prefix, const std::vector<double>& initial, int64_t bodies, NpzArrays* arrays) {
  const auto moves = initial.begin() + static_cast<std::ptrdiff_t>(kState) * bodies;
  (*arrays)[prefix + "state"] = {{bodies, static_cast<int64_t>(kState)}, std::vector<double>(initial.begin(), moves)};
  if (moves == initial.end()) return;
  (*arrays)[prefix + "rotation"] = {{bodies, kSpin}, std::vector<double>(moves, initial.end())};
}

// Without what the motions are, only the solution.
NpzArrays ArraysOf(const Request& request, const SolvedRun& run, const Motions* motions) {
  const SolveReport& report = run.report;
  const int64_t bodies = request.scene.num_bodies();
  const int64_t controlled = request.scene.num_controlled(), columns = ControlColumns(request.scene);
  NpzArrays arrays;
  if (!report.losses.empty()) arrays["loss"] = {{static_cast<int64_t>(report.losses.size())}, report.losses};
  AddInitial("initial_", report.initial_state, bodies, &arrays);
  if (controlled > 0) {
    const int64_t intervals = static_cast<int64_t>(report.control.size()) / request.scene.control_width();
    arrays["control"] = {{intervals, controlled, columns}, RowsOfControl(request.scene, report.control)};
    if (!report.durations.empty()) arrays["durations"] = {{intervals}, report.durations};
  }
  if (report.best && !report.best->initial_state.empty()) {
    arrays["best_loss"] = {{1}, std::vector<double>{report.best->loss}};
    AddInitial("best_initial_", report.best->initial_state, bodies, &arrays);
    if (controlled > 0) {
      const int64_t intervals = static_cast<int64_t>(report.best->control.size()) / request.scene.control_width();
      arrays["best_control"] = {{intervals, controlled, columns}, RowsOfControl(request.scene, report.best->control)};
      if (!report.best->durations.empty()) arrays["best_durations"] = {{intervals}, report.best->durations};
    }
  }
  if (report.surrogate) arrays["surrogate"] = {{1}, std::vector<std::string>{BiasedName(*report.surrogate)}};
  if (!report.standard_error.empty()) {
    arrays["standard_error"] = {{static_cast<int64_t>(report.standard_error.size())}, report.standard_error};
  }
  if (motions != nullptr) {
    AddMotion(motions->own, "", bodies, &arrays);
    AddMotion(motions->exact, "exact_", bodies, &arrays);
  }
  arrays["contact"] = ScalarText(report.contact);
  arrays["solver"] = ScalarText(report.solver);
  arrays["scene"] = ScalarText(WriteScene(request.scene));
  return arrays;
}

void WriteSolution(const Request& request, const SolvedRun& run) {
  const std::string path = request.output_dir + "/" + SolutionFileName(request.scene, run.report);
  const auto write = [&](const Motions* motions) {
    const Status status = WriteNpz(path, ArraysOf(request, run, motions));
    if (!status.ok()) throw OutputError(status.message());
  };
  try {
    const Motions motions = MotionsOf(request, run);
    return write(&motions);
  } catch (const std::bad_alloc&) {
  }
  // States are most of a file: where there is no memory for them, the solution is written.
  HoldMemoryBackAgain();
  write(nullptr);
  throw std::bad_alloc();
}

}  // namespace

void AddStates(const Request& request, const SolvedRun& run, Json* item) {
  const size_t bodies = request.scene.bodies.size();
  if (!run.final_state.empty()) (*item)["final_state"] = StateToJson(run.final_state, bodies);
  if (run.exact.ok) (*item)["exact_final_state"] = StateToJson(run.exact.end, bodies);
  if (!request.states) return;
  const Motions motions = MotionsOf(request, run);
  const auto add = [&](const std::string& prefix, const Motion& motion) {
    if (!motion.failure.empty() || InterruptGuard::GraceIsOver()) return;
    (*item)[prefix + "times"] = NumbersToJson(motion.times);
    (*item)[prefix + "states"] = StatesToJson(motion, bodies);
    (*item)[prefix + "touches"] = TouchesToJson(motion, request.scene);
  };
  add("", motions.own);
  add("exact_", motions.exact);
}

void AddDrawn(const Scene& scene, Json* document) {
  const auto list = [&](const char* key) -> Json& { return (*document)[key] = Json::array(); };
  const auto pair = [](const Vec2d& v) { return Json{NumberToJson(v[0]), NumberToJson(v[1])}; };
  Json& bodies = list("bodies");
  for (const Body& body : scene.bodies) {
    bodies.push_back({{"name", body.name}, {"radius", NumberToJson(body.radius)}, {"fixed", body.fixed}});
  }
  Json& planes = list("planes");
  for (const Plane& plane : scene.planes) {
    planes.push_back({{"name", plane.name}, {"point", pair(plane.point)}, {"normal", pair(plane.normal)}});
  }
  if (!scene.pockets.empty()) {
    Json& pockets = list("pockets");
    for (const Pocket& pocket : scene.pockets) {
      pockets.push_back(
          {{"name", pocket.name}, {"position", pair(pocket.position)}, {"radius", NumberToJson(pocket.radius)}});
    }
  }
  if (!scene.HasEdges()) return;
  Json& segments = list("segments");
  for (const EdgeSegment& segment : scene.segments) {
    segments.push_back({{"name", segment.name}, {"from", pair(segment.from)}, {"to", pair(segment.to)}});
  }
  Json& polygons = list("polygons");
  for (const EdgePolygon& polygon : scene.polygons) {
    Json points = Json::array();
    for (const Vec2d& point : polygon.points) points.push_back(pair(point));
    const bool inside = polygon.solid == EdgePolygon::Solid::kInside;
    polygons.push_back({{"name", polygon.name}, {"points", points}, {"solid", inside ? "inside" : "outside"}});
  }
  Json& arcs = list("arcs");
  for (const EdgeArc& arc : scene.arcs) {
    arcs.push_back({{"name", arc.name},
                    {"center", pair(arc.center)},
                    {"radius", NumberToJson(arc.radius)},
                    {"from", NumberToJson(arc.from)},
                    {"to", NumberToJson(arc.to)}});
  }
}

std::string SolutionFileName(const Scene& scene, const SolveReport& report) {
  return scene.name + "_" + report.contact + "_" + report.solver + FileSuffix(report.surrogate) + ".npz";
}

void WriteSolutions(const Request& request, const SolvedRuns& solved) {
  if (request.output_dir.empty()) return;
  std::vector<std::function<void()>> files;
  for (const SolvedRun& run : solved.runs) {
    if (!run.HasSolution()) continue;
    files.push_back([&] { WriteSolution(request, run); });
  }
  DoAll(files);
}

}  // namespace saltus
