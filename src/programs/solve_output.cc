#include <algorithm>
#include <cmath>
#include <functional>
#include <iostream>
#include <new>
#include <utility>

#include "base/interrupt.h"
#include "control/surrogate_names.h"
#include "output/npz.h"
#include "programs/program.h"
#include "programs/scene_drawing.h"
#include "programs/solve.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"

namespace saltus {

namespace {

bool IsExact(const Contact& contact) { return FindContactModel(contact)->event_driven; }

bool HasCurvature(const Certificate& certificate) { return certificate.IsStationary() && certificate.curvature; }

}  // namespace

Table DesignTable(const Scene& scene, const SolvedRuns& solved) {
  Table table(ColumnsOf("contact; solver; parameter; given:8; found:8; derivative of exact loss:3"), 3);
  const std::vector<double> given = DesignOf(scene);
  for (const SolvedRun& run : solved.runs) {
    for (size_t i = 0; i < run.report.solution.parameters.size(); ++i) {
      const bool certified = run.certificate && i < run.certificate->parameters.size();
      table.AddRow({LabelOf(run.report.contact, run.report.surrogate),
                    run.report.solver,
                    NameOf(scene.design[i].parameter, scene),
                    given[i],
                    run.report.solution.parameters[i],
                    certified ? std::optional(run.certificate->parameters[i].derivative) : std::nullopt});
    }
  }
  return table;
}

Table CertificateTable(const SolvedRuns& solved) {
  Table table(ColumnsOf("contact; solver; exact loss is at; residual:2; smallest curvature:3; what it means"), 2);
  for (const SolvedRun& run : solved.runs) {
    if (!run.certificate) continue;
    const Certificate& certificate = *run.certificate;
    const std::string verdict = VerdictInWords(certificate);
    table.AddRow({LabelOf(run.report.contact, run.report.surrogate),
                  run.report.solver,
                  verdict.empty() ? "not certified" : verdict,
                  ResidualOf(certificate),
                  HasCurvature(certificate) ? std::optional(certificate.curvature->smallest) : std::nullopt,
                  MeaningOf(certificate)});
  }
  return table;
}

bool HasCurvatures(const SolvedRuns& solved) {
  return std::ranges::any_of(solved.runs,
                             [](const SolvedRun& run) { return run.certificate && HasCurvature(*run.certificate); });
}

// ---- States, and NPZ files

namespace {

constexpr size_t kState = 4;  // p_x p_y v_x v_y

// With the rotations, if there are any.
Json StateToJson(const double* x, const double* rotations, size_t bodies) {
  Json state = Json::array();
  for (size_t i = 0; i < bodies; ++i) {
    Json body = Json::array();
    for (size_t j = 0; j < kState; ++j) body.push_back(x[kState * i + j]);
    for (size_t j = 0; j < kSpin && rotations != nullptr; ++j) body.push_back(rotations[kSpin * i + j]);
    state.push_back(std::move(body));
  }
  return state;
}

// Converts numbers in the layout of an initial state.
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

// A solution's motion under its own contact model or, if `exact`, under exact dynamics.
Motion MotionOf(const Request& request, const SolveReport& report, bool exact, const MotionOptions& options) {
  const MotionInput input = InputOf(report);
  MotionOptions own = options;
  own.precision = request.precision;
  own.stop = InterruptGuard::GraceIsOver;
  const Scene scene = WithDesign(request.scene, report.solution.parameters);
  return exact ? SimulateExactMotion(scene, input, own) : SimulateMotion(scene, report.contact, input, own);
}

// The ends of the control intervals of a solution, from 0 on, s: the nodes of its own model's motion.
std::vector<double> NodesOf(const Scene& scene, const SolveReport& report) {
  std::vector<double> nodes = {0};
  for (const double length : report.solution.durations) nodes.push_back(nodes.back() + length);
  if (!report.solution.durations.empty()) return nodes;
  const int steps = scene.steps / FindContactModel(report.contact)->grid_steps;
  for (int k = 1; k <= steps; ++k) nodes.push_back(k * (scene.duration / steps));
  return nodes;
}

// The motion of the run's contact model at the nodes of its control, and that of exact dynamics.
struct Motions {
  Motion own, exact;
};

Motions MotionsOf(const Request& request, const SolvedRun& run) {
  MotionOptions options;
  options.most_bytes = request.options.limits.memory;
  Motions motions{MotionOf(request, run.report, false, options), MotionOf(request, run.report, true, options)};
  if (motions.own.failure.empty()) motions.own = StatesAtNodes(motions.own, NodesOf(request.scene, run.report));
  for (const auto& [name, motion] : {std::pair("", &motions.own), std::pair("exact ", &motions.exact)}) {
    if (motion->failure.empty()) continue;
    std::cerr << "no " << name << "states of " << run.report.contact << " " << run.report.solver << ": "
              << motion->failure << std::endl;
  }
  return motions;
}

// Adds the touches: [a, b, whether b is a plane], their times, and the impulse on a.
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
                       {"begin", touch.begin},
                       {"end", touch.end},
                       {"impulse", touch.impulse}});
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

// Returns the arrays of a run; if `motions` is null, those of the solution only.
NpzArrays ArraysOf(const Request& request, const SolvedRun& run, const Motions* motions) {
  const SolveReport& report = run.report;
  const int64_t bodies = request.scene.num_bodies();
  const int64_t controlled = request.scene.num_controlled(), columns = ControlColumns(request.scene);
  NpzArrays arrays;
  if (!report.history.losses.empty()) {
    arrays["loss"] = {{static_cast<int64_t>(report.history.losses.size())}, report.history.losses};
  }
  const auto add_solution = [&](const std::string& prefix, const Solution& solution) {
    AddInitial(prefix + "initial_", solution.initial_state, bodies, &arrays);
    if (controlled == 0) return;
    const int64_t intervals = static_cast<int64_t>(solution.control.size()) / request.scene.control_width();
    arrays[prefix + "control"] = {{intervals, controlled, columns}, RowsOfControl(request.scene, solution.control)};
    if (!solution.durations.empty()) arrays[prefix + "durations"] = {{intervals}, solution.durations};
  };
  add_solution("", report.solution);
  if (!report.solution.parameters.empty()) {
    std::vector<std::string> names;
    for (const DesignParameter& design : request.scene.design) names.push_back(NameOf(design.parameter, request.scene));
    arrays["parameter_names"] = {{static_cast<int64_t>(names.size())}, names};
    arrays["parameters"] = {{static_cast<int64_t>(names.size())}, report.solution.parameters};
  }
  if (report.history.best && !report.history.best->solution.initial_state.empty()) {
    arrays["best_loss"] = {{1}, std::vector<double>{report.history.best->solution.loss}};
    add_solution("best_", report.history.best->solution);
  }
  if (report.surrogate) arrays["surrogate"] = {{1}, std::vector<std::string>{BiasedName(*report.surrogate)}};
  if (!report.history.standard_error.empty()) {
    arrays["standard_error"] = {{static_cast<int64_t>(report.history.standard_error.size())},
                                report.history.standard_error};
  }
  if (motions != nullptr) {
    AddMotion(motions->own, "", bodies, &arrays);
    AddMotion(motions->exact, "exact_", bodies, &arrays);
  }
  arrays["contact"] = ScalarText(report.contact);
  arrays["solver"] = ScalarText(report.solver);
  arrays["scene"] = ScalarText(WriteScene(WithDesign(request.scene, report.solution.parameters)));
  return arrays;
}

// <scene>_<contact>_<solver>.npz. A solver that was asked for under another name, as auto, has that name where another
// run has its own.
std::string SolutionFileName(const Request& request, const SolvedRuns& solved, const SolvedRun& run) {
  const SolveReport& report = run.report;
  const bool taken = std::ranges::any_of(solved.runs, [&](const SolvedRun& other) {
    return &other != &run && other.report.contact == report.contact && other.asked == report.solver;
  });
  return request.scene.name + "_" + report.contact + "_" + (taken ? run.asked : report.solver) +
         FileSuffix(report.surrogate) + ".npz";
}

void WriteSolution(const Request& request, const SolvedRuns& solved, const SolvedRun& run) {
  const std::string path = request.output_dir + "/" + SolutionFileName(request, solved, run);
  const auto write = [&](const Motions* motions) { ThrowIfFailed(WriteNpz(path, ArraysOf(request, run, motions))); };
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

// Adds what is needed to draw states: discs and planes, and pockets and walls that end, if there are any.
void AddDrawn(const Scene& scene, Json* document) {
  VisitDrawn(scene, [&]<typename T>(const char* key, const char*, const std::vector<T>& things) {
    if (std::is_same_v<T, Pocket> && things.empty()) return;
    const bool ends = !std::is_same_v<T, Body> && !std::is_same_v<T, Plane> && !std::is_same_v<T, Pocket>;
    if (ends && !scene.HasEdges()) return;
    Json& list = (*document)[key] = Json::array();
    for (const T& thing : things) {
      Json& item = list.emplace_back(Json::object());
      VisitDrawnFields(thing, [&](const char* field, const auto& value) {
        if constexpr (requires { value == EdgePolygon::Solid::kInside; }) {
          item[field] = value == EdgePolygon::Solid::kInside ? "inside" : "outside";
        } else if constexpr (requires { value->positions; }) {
          if (value) item[field] = {{"times", value->times}, {"positions", value->positions}};
        } else {
          item[field] = value;
        }
      });
    }
  });
}

// Adds "final_state" and "exact_final_state", and if --states asks for it "times", "states", "exact_times" and
// "exact_states", and discs and walls that parameters have moved. Where states do not fit into --memory_limit they are
// left out, and stderr says so.
void AddStates(const Request& request, const SolvedRun& run, Json* item) {
  const size_t bodies = request.scene.bodies.size();
  if (!run.final_state.empty()) (*item)["final_state"] = StateToJson(run.final_state, bodies);
  if (run.exact.ok) (*item)["exact_final_state"] = StateToJson(run.exact.end, bodies);
  if (!request.states) return;
  if (!run.report.solution.parameters.empty()) {
    AddDrawn(WithDesign(request.scene, run.report.solution.parameters), item);
  }
  const Motions motions = MotionsOf(request, run);
  Reserve(6, item);
  const auto add = [&](const std::string& prefix, const Motion& motion) {
    if (!motion.failure.empty() || InterruptGuard::GraceIsOver()) return;
    (*item)[prefix + "times"] = motion.times;
    (*item)[prefix + "states"] = StatesToJson(motion, bodies);
    (*item)[prefix + "touches"] = TouchesToJson(motion, request.scene);
  };
  add("", motions.own);
  add("exact_", motions.exact);
}

// "contact solver", or the contact model alone where nothing was solved.
std::string LabelOfRun(const SolveReport& report) {
  return LabelOf(report.contact, report.surrogate) + (report.solver == kNoSolver ? "" : " " + report.solver);
}

}  // namespace

NamedStudies StudiesOf(const SolvedRuns& solved) {
  NamedStudies studies;
  for (const SolvedRun& run : solved.runs) {
    if (run.feedback) studies.emplace_back(LabelOfRun(run.report), FeedbackToJson(*run.feedback, /*states=*/false));
  }
  return studies;
}

void WriteSolutions(const Request& request, const SolvedRuns& solved) {
  if (request.output_dir.empty()) return;
  std::vector<std::function<void()>> files;
  for (const SolvedRun& run : solved.runs) {
    if (!run.HasSolution()) continue;
    files.push_back([&] { WriteSolution(request, solved, run); });
  }
  DoAll(files);
}

// ---- Page

namespace {

constexpr size_t kMostMotions = 8;  // in a replay

// Colours tell contact models apart, dashes the solvers.
struct RunStyle {
  std::string colour;
  Dash dash = Dash::kSolid;
};
RunStyle StyleOfRun(const Request& request, const SolveReport& report) {
  const ModelStyle& style = StyleOf(report.contact);
  if (request.solvers.size() < 2) return {std::string(style.colour), style.dash};
  const auto at = std::ranges::find(request.solvers, report.solver);
  return {std::string(style.colour), static_cast<Dash>((at - request.solvers.begin()) % kNumDashes)};
}

// Runs with a solution, the best first: those that meet the constraints, by their exact loss; those without one last.
std::vector<const SolvedRun*> RankedRuns(const SolvedRuns& solved) {
  std::vector<const SolvedRun*> runs;
  for (const SolvedRun& run : solved.runs) {
    if (run.HasSolution()) runs.push_back(&run);
  }
  const auto loss = [](const SolvedRun* run) { return run->exact.ok ? run->exact.loss : HUGE_VAL; };
  const auto rank = [&](const SolvedRun* run) {
    return std::pair(run->report.solution.violation > kFeasible, loss(run));
  };
  std::ranges::stable_sort(runs, [&](const SolvedRun* l, const SolvedRun* r) { return rank(l) < rank(r); });
  return runs;
}

std::vector<Tile> TilesOf(const Request& request, const SolvedRuns& solved) {
  const std::vector<const SolvedRun*> runs = RankedRuns(solved);
  std::vector<Tile> tiles;
  if (!runs.empty() && runs[0]->exact.ok) {
    tiles.push_back({Cell(runs[0]->exact.loss).Display(10), "lowest exact loss, by " + LabelOfRun(runs[0]->report)});
    if (runs[0]->certificate) {
      const Certificate& certificate = *runs[0]->certificate;
      const std::string words = VerdictInWords(certificate);
      const bool good = certificate.IsStationary() && !certificate.IsSaddle();
      tiles.push_back(
          {words.empty() ? "not certified" : words, "verdict of its certificate", good ? Tone::kGood : Tone::kWarning});
    }
  }
  if (!runs.empty() && runs[0]->duration) {
    tiles.push_back({Cell(*runs[0]->duration).Display(6) + " s", "duration, by " + LabelOfRun(runs[0]->report)});
  }
  const auto failed =
      std::ranges::count_if(solved.runs, [](const SolvedRun& run) { return !ReasonNoSolution(run.report).empty(); });
  const auto refused = std::ranges::count_if(
      solved.runs, [](const SolvedRun& run) { return run.report.termination == Termination::kNotApplicable; });
  const auto taken = static_cast<std::ptrdiff_t>(solved.runs.size()) - refused;
  const std::string what = request.solvers.empty() ? "completed simulations" : "successful runs";
  tiles.push_back({std::to_string(taken - failed) + " of " + std::to_string(taken),
                   what + (refused > 0 ? "; " + std::to_string(refused) + " not applicable to this scene" : ""),
                   failed == 0 ? Tone::kGood : Tone::kWarning});
  return tiles;
}

// The covariances of the positions along a plan, at 400 nodes at most.
std::vector<ReplaySpread> SpreadsOf(const Scene& scene, const FeedbackStudy& study) {
  std::vector<ReplaySpread> spreads;
  if (!study.reason.empty()) return spreads;
  const size_t every = study.times.size() / 400 + 1;
  const auto add = [&](const char* label, const Covariance& covariance) {
    ReplaySpread& spread = spreads.emplace_back();
    spread.label = label;
    const Eigen::Index size = study.planned.size() / scene.num_bodies();
    for (size_t k = 0; k < study.times.size(); k += every) {
      spread.times.push_back(study.times[k]);
      const Eigen::MatrixXd& P = covariance.nodes[k];
      for (Eigen::Index i = 0; i < P.rows(); i += size) {
        spread.covariances.insert(spread.covariances.end(), {P(i, i), P(i, i + 1), P(i + 1, i + 1)});
      }
    }
  };
  if (study.closed) add("closed loop", study.closed->covariance);
  add("open loop", study.open.covariance);
  return spreads;
}

// Adds the motions of the best runs: each under its own model, and the best in exact dynamics.
void AddRunReplay(const Request& request, const std::vector<const SolvedRun*>& runs, Page* page) {
  const size_t shown = std::min(runs.size(), kMostMotions);
  if (shown == 0) return;
  const MotionOptions options = ReplayOptions(request.scene, shown + 1);
  Replay replay{WithDesign(request.scene, runs[0]->report.solution.parameters)};
  const auto add = [&](size_t i, bool exact) {
    const SolveReport& run = runs[i]->report;
    Motion motion = MotionOf(request, run, exact, options);
    if (motion.times.empty()) return;
    const RunStyle style = StyleOfRun(request, run);
    const std::string label = LabelOfRun(run) + (exact ? ", in exact dynamics" : "");
    ReplayMotion& drawn = replay.motions.emplace_back(std::move(motion), InputOf(run), label, run.contact);
    drawn.colour = exact ? "#000000" : style.colour;
    drawn.dash = exact ? Dash::kDashed : style.dash;
    drawn.shown = i < 4;
    if (run.solution.parameters != runs[0]->report.solution.parameters) {
      drawn.scene = WithDesign(request.scene, run.solution.parameters);
    }
    if (runs[i]->feedback && (exact || IsExact(run.contact))) {
      drawn.spreads = SpreadsOf(request.scene, *runs[i]->feedback);
    }
  };
  for (size_t i = 0; i < shown; ++i) {
    add(i, false);
    if (i == 0 && !IsExact(runs[0]->report.contact)) add(0, true);
  }
  if (replay.motions.empty()) return;
  page->AddHeading("Replay");
  page->AddReplay(ReplayToJson(replay),
                  "The motions" + std::string(runs.size() > shown ? " of lowest exact loss" : "") +
                      ". Forces are green, impulses red. The space bar plays and pauses; arrow keys step, with shift "
                      "from impact to impact.");
}

// Adds the impacts of a certified run: times, speeds, and the multipliers and residuals of the minimum principle.
void AddImpacts(const Scene& scene, const std::vector<const SolvedRun*>& runs, Page* page) {
  if (runs.empty() || !runs[0]->certificate || runs[0]->certificate->impacts.empty()) return;
  page->AddTable(TableOf(Json::array({CertificateToJson(scene, *runs[0]->certificate)}),
                         "/impacts",
                         "time (s)=time:10; disc=a; other=b; speed (m/s)=speed; multiplier; costate jump:3; on a "
                         "node=on_node"),
                 "Impacts of " + LabelOfRun(runs[0]->report) +
                     ". The multiplier is the jump of the costate along the gradient of the gap; `costate jump` is the "
                     "residual of the jump condition.");
}

}  // namespace

void AddSolveSections(const Request& request, const SolvedRuns& solved, Page* page) {
  const std::vector<const SolvedRun*> runs = RankedRuns(solved);
  page->AddHeading(request.solvers.empty() ? "Simulations" : "Runs");
  page->AddTiles(TilesOf(request, solved));
  page->AddTable(RunTable(solved),
                 "`final loss` is the loss under the contact model, `exact loss` that of the same solution under exact "
                 "dynamics: only "
                 "exact losses may be compared between models.");
  page->AddTableIfAny(DesignTable(request.scene, solved), "Parameters of the scene that were optimized, in SI units.");
  page->AddTableIfAny(CertificateTable(solved),
                      std::string("Certificates of the exact loss. Residuals are relative") +
                          (HasCurvatures(solved) ? "; a curvature of 1 is that of the effort alone." : "."));
  AddImpacts(request.scene, runs, page);
  const NamedStudies studies = StudiesOf(solved);
  if (!studies.empty()) AddFeedbackSection(studies, page);
  AddRunReplay(request, runs, page);
  if (!studies.empty()) {
    page->AddPlot(
        "spreads",
        "Deviations of the positions from the plan, which have a probability of 0.95 in each direction, to first "
        "order. Dotted: impacts.");
  }
  for (const SolvedRun& run : solved.runs) {
    const RunStyle style = StyleOfRun(request, run.report);
    page->AddStyle(LabelOfRun(run.report), style.colour, style.dash);
  }
  if (request.scene.num_controlled() > 0 && !runs.empty()) {
    page->AddHeading("Controls");
    page->AddPlot("controls",
                  "Forces and torques over time. Dotted: impacts of the first motion with exact impact times; dashed: "
                  "bounds.");
  }
  if (std::ranges::any_of(runs, [](const SolvedRun* run) { return run->report.history.losses.size() > 1; })) {
    page->AddHeading("Learning curves");
    page->AddPlot("learning_curves",
                  "The loss that each solver minimizes: that under its contact model, which equals the exact loss only "
                  "under exact dynamics.");
  }
  std::vector<std::string> files;
  for (const SolvedRun* run : runs) {
    files.push_back(SolutionFileName(request, solved, *run));
  }
  if (files.empty()) return;
  page->AddHeading("Files");
  page->AddLinks(files);
}

double LargestDefect(const SolveReport& report) {
  if (report.history.defects.empty()) return 0;
  const std::vector<double>& last = report.history.defects.back();
  return *std::ranges::max_element(last);
}

bool IsConvergence(const SolveReport& report) {
  return report.termination == Termination::kConverged && report.solver != kNoSolver;
}

Json SolveToJson(const Request& request, const SolvedRuns& solved) {
  Json list = Json::array();
  for (const SolvedRun& run : solved.runs) {
    const SolveReport& report = run.report;
    Json item = {{"contact", report.contact}, {"solver", report.solver}};
    AddBias(report.contact, report.surrogate, &item);
    if (run.simulated) {
      item["loss"] = report.solution.loss;
      if (run.exact.ok) item["exact_loss"] = run.exact.loss;
    }
    if (!report.history.losses.empty()) {
      item["initial_loss"] = report.guess.loss;
      item["final_loss"] = report.solution.loss;
      if (run.exact.ok) item["exact_loss"] = run.exact.loss;
      item["losses"] = report.history.losses;
      SALTUS_ADD_MEMBERS(&item, report.work, iterations, evaluations, seconds);
      if (!report.history.defects.empty()) item["defect"] = LargestDefect(report);
      if (report.history.best) {
        item["best_loss"] = report.history.best->solution.loss;
        item["best_iteration"] = report.history.best->iteration;
      }
    }
    item["termination"] = TerminationToString(report.termination);
    if (IsConvergence(report)) item["converged_under"] = report.contact;
    if (!report.reason.empty()) item["reason"] = report.reason;
    item["remarks"] = RemarksToJson(RemarksOn(run));
    if (run.HasSolution()) {
      item["events"] = EventsToJson(run.exact.events);
      AddTies(run.exact.ambiguous, run.exact.spread, &item);
      const auto add_solution = [&](const std::string& prefix, const Solution& solution) {
        item[prefix + "velocity"] = VectorsToJson(request.scene, solution.initial_state, 2);
        if (request.scene.Spins()) {
          item[prefix + "angular_velocity"] = RotationsToJson(request.scene, solution.initial_state, 1);
        }
        item[prefix + "control"] = ControlToJson(request.scene, solution.control);
        if (!solution.parameters.empty()) {
          item[prefix + "parameters"] = DesignToJson(request.scene, solution.parameters);
        }
      };
      add_solution("", report.solution);
      if (!report.history.standard_error.empty()) item["standard_error"] = report.history.standard_error;
      if (run.duration) item["duration"] = *run.duration;
      if (!report.solution.durations.empty()) item["durations"] = report.solution.durations;
      if (report.history.best && !report.history.best->solution.initial_state.empty()) {
        add_solution("best_", report.history.best->solution);
        if (!report.history.best->solution.durations.empty()) {
          item["best_durations"] = report.history.best->solution.durations;
        }
        if (request.scene.optimize == Optimize::kPosition) {
          item["best_position"] = VectorsToJson(request.scene, report.history.best->solution.initial_state, 0);
        }
      }
      if (run.certificate) item["certificate"] = CertificateToJson(request.scene, *run.certificate);
      if (report.continuous) {
        item["continuous_certificate"] = CertificateToJson(request.scene, *report.continuous, "continuous_time");
      }
      if (report.searched) item["searched"] = SearchStatisticsToJson(*report.searched);
      if (!report.optima.empty()) item["optima"] = OptimaToJson(request.scene, report.optima);
      if (request.scene.optimize == Optimize::kPosition) {
        item["position"] = VectorsToJson(request.scene, report.solution.initial_state, 0);
      }
      if (run.feedback) item["feedback"] = FeedbackToJson(*run.feedback, request.states);
      AddStates(request, run, &item);
    }
    list.push_back(std::move(item));
  }
  Json document = {{"scene", request.scene.name}, {"steps", request.scene.steps}};
  Reserve(8, &document);
  document["runs"] = std::move(list);
  if (request.states) AddDrawn(request.scene, &document);
  if (solved.interrupted) document["interrupted"] = true;
  return document;
}

void AddFeedback(const Request& request, int threads, SolvedRun* run) {
  if (!request.feedback || !run->HasSolution()) return;
  const SolveReport& report = run->report;
  run->feedback = StudyFeedback(WithDesign(request.scene, report.solution.parameters),
                                report.solution.initial_state,
                                report.solution.control,
                                report.solution.durations,
                                *request.feedback,
                                threads);
}

void WriteSolveReport(const Request& request, const SolvedRuns& solved) {
  WriteReport(request, [&](Page* page) {
    AddSolveSections(request, solved, page);
    page->SetResults(SolveToJson(OmitStates(request), solved));
  });
}

}  // namespace saltus
